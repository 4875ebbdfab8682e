"""Products of small matrices with long ones, and sines, in explicit vector instructions.

The compiler's code for plain loops reaches a third of the processor's speed on matrices of some twenty by twenty: it
keeps no block of the result in registers. Here every number of a result is summed in the order written, by fused
multiply-adds, so that results do not depend on what else is compiled.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding
import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from ....arrays import F32

# Evidence for these constants: ADR 020.
LANES = 16  # numbers in a vector; processors with shorter vectors use several
# Whether numba compiles for a processor with vectors of 16 numbers, and 32 registers for them.
HAS_AVX512 = "+avx512f" in (numba.config.CPU_FEATURES or llvmlite.binding.get_host_cpu_features().flatten())
PRODUCT_ROWS, PRODUCT_VECTORS = 4, 4 if HAS_AVX512 else 1  # in a block of a product, as many as registers hold
DOWN, ACROSS = (4, 4) if HAS_AVX512 else (2, 4)  # rows and columns of a block of an outer product


_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_VECTOR = ir.VectorType(_FLOAT, LANES)
_INTEGERS = ir.VectorType(_INT, LANES)
_SUMS = ir.VectorType(_FLOAT, DOWN * ACROSS)  # one number per sum in a block of an outer product


def _lanes(b: Any, first: Any, second: Any, lanes: list[int]) -> Any:
    """Pick lanes of two vectors, counted through the first and then the second."""
    return b.shuffle_vector(first, second, ir.Constant(ir.VectorType(_INT, len(lanes)), lanes))


def _spread(b: Any, number: Any) -> Any:
    """Make a vector of equal numbers."""
    none = ir.Constant(_VECTOR, ir.Undefined)
    return _lanes(b, b.insert_element(none, number, ir.Constant(_INT, 0)), none, [0] * LANES)


def _fused(b: Any, x: Any, y: Any, z: Any) -> Any:
    """x y + z."""
    kind = ir.FunctionType(z.type, [z.type] * 3)
    return b.call(cgutils.get_or_insert_function(b.module, kind, f"llvm.fma.v{z.type.count}f32"), [x, y, z])


def _no_further(b: Any, place: Any, end: Any) -> Any:
    """Replace lines beyond the last by the last. Their results are not stored."""
    return b.select(b.icmp_signed("<", place, end), place, b.sub(end, ir.Constant(end.type, 1)))


class _Array:
    """A one- or two-dimensional float32 array in the code that is being generated."""

    def __init__(self, context: Any, builder: Any, kind: Any, value: Any) -> None:
        array = context.make_array(kind)(context, builder, value)
        self._b, self._data = builder, builder.bitcast(array.data, ir.IntType(8).as_pointer())
        self._strides = cgutils.unpack_tuple(builder, array.strides, kind.ndim)
        self.shape = cgutils.unpack_tuple(builder, array.shape, kind.ndim)

    def _at(self, places: tuple[Any, ...], kind: Any) -> Any:
        offset = self._b.mul(places[0], self._strides[0])
        for place, stride in zip(places[1:], self._strides[1:], strict=True):
            offset = self._b.add(offset, self._b.mul(place, stride))
        return self._b.bitcast(self._b.gep(self._data, [offset]), kind.as_pointer())

    def number(self, *places: Any) -> Any:
        return self._b.load(self._at(places, _FLOAT))

    def vector(self, *places: Any, kind: Any = _VECTOR) -> Any:
        """Load the numbers from there on; those of the last dimension lie side by side."""
        loaded = self._b.load(self._at(places, kind))
        loaded.align = 4
        return loaded

    def put_number(self, number: Any, *places: Any) -> None:
        self._b.store(number, self._at(places, _FLOAT))

    def put_vector(self, vector: Any, *places: Any) -> None:
        self._b.store(vector, self._at(places, _VECTOR)).align = 4


def _block_of_product(vectors: int) -> Any:
    @intrinsic
    def block(typing: Any, W: Any, x: Any, start: Any, scale: Any, z: Any, j: Any, t: Any) -> Any:
        """Set z[r, c] = scale (start[r] + W[r] x[:, c]) for at most PRODUCT_ROWS rows from j on and vectors * LANES
        columns from t on."""

        def generate(context: Any, b: Any, signature: Any, args: Any) -> Any:
            W, x, start, z = (_Array(context, b, signature.args[i], args[i]) for i in (0, 1, 2, 4))
            scale, (j, t), (rows, terms) = args[3], args[5:], W.shape
            whole = lambda n: ir.Constant(t.type, n)  # noqa: E731
            places = [b.add(j, whole(r)) for r in range(PRODUCT_ROWS)]
            lines = [_no_further(b, p, rows) for p in places]
            columns = [b.add(t, whole(v * LANES)) for v in range(vectors)]
            sums = [[cgutils.alloca_once(b, _VECTOR) for _ in columns] for _ in lines]
            for line, of_line in zip(lines, sums, strict=True):
                first = _spread(b, start.number(line))
                for s in of_line:
                    b.store(first, s)
            with cgutils.for_range(b, terms) as loop:
                inputs = [x.vector(loop.index, c) for c in columns]
                for line, of_line in zip(lines, sums, strict=True):
                    weight = _spread(b, W.number(line, loop.index))
                    for s, v in zip(of_line, inputs, strict=True):
                        b.store(_fused(b, weight, v, b.load(s)), s)
            factor = _spread(b, scale)
            for place, of_line in zip(places, sums, strict=True):
                with b.if_then(b.icmp_signed("<", place, rows)):
                    for s, c in zip(of_line, columns, strict=True):
                        z.put_vector(b.fmul(factor, b.load(s)), place, c)
            return context.get_dummy_value()

        return types.void(W, x, start, scale, z, j, t), generate

    return block


@intrinsic
def _block_of_outer(typing: Any, d: Any, x: Any, G: Any, j: Any, i: Any, n: Any) -> Any:
    """Add d[j:, :n] x[i:, :n]^T to G[j:, i:], for at most DOWN rows and ACROSS columns."""

    def generate(context: Any, b: Any, signature: Any, args: Any) -> Any:
        d, x, G = (_Array(context, b, signature.args[k], args[k]) for k in range(3))
        (j, i, n), (rows, columns) = args[3:], G.shape
        whole = lambda k: ir.Constant(n.type, k)  # noqa: E731
        places = [(b.add(j, whole(r)), b.add(i, whole(c))) for r in range(DOWN) for c in range(ACROSS)]
        d_lines = [_no_further(b, b.add(j, whole(r)), rows) for r in range(DOWN)]
        x_lines = [_no_further(b, b.add(i, whole(c)), columns) for c in range(ACROSS)]
        sums = [cgutils.alloca_once(b, _SUMS) for _ in places]
        for s in sums:
            b.store(ir.Constant(_SUMS, [0.0] * _SUMS.count), s)
        with cgutils.for_range_slice(b, whole(0), n, whole(_SUMS.count), n.type) as (t, _):
            left = [d.vector(line, t, kind=_SUMS) for line in d_lines]
            right = [x.vector(line, t, kind=_SUMS) for line in x_lines]
            for k, s in enumerate(sums):
                b.store(_fused(b, left[k // ACROSS], right[k % ACROSS], b.load(s)), s)
        # Add lanes two by two, of two vectors at once, until lane k is the sum of vector k.
        parts, even = [b.load(s) for s in sums], list(range(0, 2 * _SUMS.count, 2))
        while len(parts) > 1:
            parts = [
                b.fadd(_lanes(b, p, q, even), _lanes(b, p, q, [k + 1 for k in even]))
                for p, q in zip(parts[::2], parts[1::2], strict=True)
            ]
        for k, (row, column) in enumerate(places):
            with b.if_then(b.and_(b.icmp_signed("<", row, rows), b.icmp_signed("<", column, columns))):
                total = b.extract_element(parts[0], ir.Constant(_INT, k))
                G.put_number(b.fadd(G.number(row, column), total), row, column)
        return context.get_dummy_value()

    return types.void(d, x, G, j, i, n), generate


# pi / 2 in three parts, of which the first two leave the low bits of their multiples empty; polynomials of sine and
# cosine up to pi / 4: Moshier's Cephes library (sinf, cosf).
_QUARTER = 1.5703125, 4.837512969970703e-4, 7.549789948768648e-8
_SINE = -1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1
_COSINE = 2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2
# Of sine up to pi / 2: the polynomial of least largest error, 5e-9.
_HALF_SINE = 2.60005465e-6, -1.98066151e-4, 8.33301729e-3, -1.66666571e-1


def _constant(value: float) -> Any:
    return ir.Constant(_VECTOR, [float(np.float32(value))] * LANES)


def _polynomial(b: Any, x: Any, coefficients: tuple[float, ...]) -> Any:
    """Evaluate a polynomial, highest power first."""
    total = _constant(coefficients[0])
    for c in coefficients[1:]:
        total = _fused(b, total, x, _constant(c))
    return total


def _reduced(b: Any, a: Any, quarters: int) -> tuple[Any, Any, Any]:
    """Subtract from a the nearest multiple, k, of `quarters` * pi / 2. Returns k as integers, the rest, and its
    square."""
    rint = cgutils.get_or_insert_function(b.module, ir.FunctionType(_VECTOR, [_VECTOR]), f"llvm.rint.v{LANES}f32")
    k = b.call(rint, [b.fmul(a, _constant(2 / (quarters * np.pi)))])
    for part in _QUARTER:
        a = _fused(b, k, _constant(-quarters * part), a)
    return b.fptosi(k, _INTEGERS), a, b.fmul(a, a)


def _negative_where(b: Any, x: Any, bits: Any, bit: int) -> Any:
    """Change the sign of x where that bit is set."""
    whole = lambda n: ir.Constant(_INTEGERS, [n] * LANES)  # noqa: E731
    sign = b.shl(b.and_(bits, whole(1 << bit)), whole(31 - bit))
    return b.bitcast(b.xor(b.bitcast(x, _INTEGERS), sign), _VECTOR)


def _odd(b: Any, r: Any, q: Any, coefficients: tuple[float, ...]) -> Any:
    """r + r q polynomial(q), q the square of r."""
    return _fused(b, b.fmul(r, q), _polynomial(b, q, coefficients), r)


@intrinsic
def _sine_block(typing: Any, z: Any, j: Any, t: Any) -> Any:
    def generate(context: Any, b: Any, signature: Any, args: Any) -> Any:
        array = _Array(context, b, z, args[0])
        k, r, q = _reduced(b, array.vector(*args[1:]), 2)
        array.put_vector(_negative_where(b, _odd(b, r, q, _HALF_SINE), k, 0), *args[1:])
        return context.get_dummy_value()

    return types.void(z, j, t), generate


@intrinsic
def _sine_and_cosine_block(typing: Any, z: Any, sine: Any, cosine: Any, j: Any, t: Any) -> Any:
    def generate(context: Any, b: Any, signature: Any, args: Any) -> Any:
        arrays = [_Array(context, b, signature.args[i], args[i]) for i in range(3)]
        at = args[3:]
        k, r, q = _reduced(b, arrays[0].vector(*at), 1)
        s = _odd(b, r, q, _SINE)
        c = _fused(b, q, _constant(-0.5), _constant(1))
        c = _fused(b, b.fmul(q, q), _polynomial(b, q, _COSINE), c)
        one = ir.Constant(_INTEGERS, [1] * LANES)
        swapped = b.icmp_signed("==", b.and_(k, one), one)
        arrays[1].put_vector(_negative_where(b, b.select(swapped, c, s), k, 1), *at)
        arrays[2].put_vector(_negative_where(b, b.select(swapped, s, c), b.add(k, one), 1), *at)
        return context.get_dummy_value()

    return types.void(z, sine, cosine, j, t), generate


@numba.njit(nogil=True)
def sine_in_place(z: F32, n: int) -> None:
    """Replace z[:, :n] by its sine, to 1e-7 for |z| < 1000. n is a multiple of LANES."""
    for j in range(z.shape[0]):
        for t in range(0, n, LANES):
            _sine_block(z, j, t)


@numba.njit(nogil=True)
def sine_and_cosine(z: F32, sine: F32, cosine: F32, n: int) -> None:
    """Set sine and cosine to those of z[:, :n], to 1e-7 for |z| < 1000. n is a multiple of LANES."""
    for j in range(z.shape[0]):
        for t in range(0, n, LANES):
            _sine_and_cosine_block(z, sine, cosine, j, t)


_wide_block, _narrow_block = _block_of_product(PRODUCT_VECTORS), _block_of_product(1)


@numba.njit(nogil=True)
def set_product(W: F32, x: F32, start: F32, scale: np.float32, z: F32, n: int) -> None:
    """Set z[:, :n] = scale (start + W x[:, :n]); start is added to every column. n is a multiple of LANES."""
    rows = len(W)
    t = 0
    while t + PRODUCT_VECTORS * LANES <= n:
        for j in range(0, rows, PRODUCT_ROWS):
            _wide_block(W, x, start, scale, z, j, t)
        t += PRODUCT_VECTORS * LANES
    while t < n:
        for j in range(0, rows, PRODUCT_ROWS):
            _narrow_block(W, x, start, scale, z, j, t)
        t += LANES


@numba.njit(nogil=True)
def add_outer(d: F32, x: F32, G: F32, n: int) -> None:
    """Add d[:, :n] x[:, :n]^T to G. n is a multiple of LANES."""
    rows, columns = G.shape
    for j in range(0, rows, DOWN):
        for i in range(0, columns, ACROSS):
            _block_of_outer(d, x, G, j, i, n)
