"""Edit a fitted control mesh: edges are flipped, collapsed and split where that lowers the error by more than it costs.

Quadrics place control vertices for the error of the polyhedron; the limit surface has another. Hoppe et al. (1993)
optimise meshes so, one edge after the other; here many that lie apart are tried at once. All are made, the surface is
fitted for a few rounds, and each is kept or taken back by what became of the error around it. The error falls about as
1 / bits, so that a bit is worth error / bits (`to_size.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numba as nb
import numpy as np
import scipy.sparse as sp

from ...arrays import F64, I64, Mask
from ...decoder.surface.normals import unit
from ...decoder.surface.subdivision import Topology, topology_of
from ..deadline import Deadline, Pace
from .basis import Basis, coarsest_basis
from .creases import Fitted
from .cut import Manifold
from .fit import fit, mean_errors
from .target import Target

# Evidence for these constants: ADR 036.
FLIPS = 5  # batches of flips for one of collapses and one of splits
TRIAL_ROUNDS = 2  # with one, a third of what pays is seen
# An uneven degree costs its bits of connectivity, and about as many again, for vertices are foretold worse around it.
DEGREE_WEIGHT = 2.0
MARGIN = 1.0  # bits that an edit must be worth beyond its cost: errors are those of samples
LEAST_BATCH = 4  # a smaller one is not worth its fit
LEAST_GAIN = 0.02  # of the error, by a cycle: mechanical parts, where flat places are met already, gain less
FLATTEST, TURN = 0.5, 0.3  # least cosines between faces of a flipped edge, and of a face before and after
LARGEST_DEGREE = 20  # larger ones cost as much


class Edited(NamedTuple):
    mesh: Manifold
    fitted: Fitted


class _Control(NamedTuple):
    """A control mesh between two edits.

    names: (V,) of the vertices, which stay when others go. sharp: (S, 2). errors: (F,) mean errors of the faces.
    topology: of the faces, with the sharp edges.
    """

    faces: I64
    names: I64
    control: F64
    sharp: I64
    basis: Basis
    errors: F64
    topology: Topology

    @property
    def is_polyhedron(self) -> bool:
        """Whether all edges are sharp."""
        return len(self.sharp) > 0 and bool(self.topology.sharp.all())


class _Edges(NamedTuple):
    """Edges between two faces that look the same way.

    rows: (E, 6) their ends x and y, the third corners p and q of their faces, and these faces f, in which y follows x,
    and g. sharp: (E,).
    """

    rows: I64
    sharp: Mask


def edited(
    fitted: Fitted,
    mesh: Manifold,
    target: Target,
    levels: int,
    bits: int,
    cycles: int,
    deadline: Deadline,
    on_cycle: Callable[[int, float], None],
) -> Edited:
    """Edit for some cycles. bits: of the file, which say what an edit's are worth. on_cycle: told the number of cycles
    that are over and the mean error."""
    now = _Control(
        mesh.faces,
        np.arange(len(mesh.vertices)),
        fitted.control,
        fitted.sharp,
        fitted.basis,
        mean_errors(fitted.basis, target, fitted.control),
        topology_of(mesh.faces, len(mesh.vertices), fitted.sharp),
    )
    editor = _Editor(target, levels, bits)
    kinds: list[_Kind] = [_Collapses(), _Splits(), *[_Flips() for _ in range(FLIPS)]]
    error = float(now.errors.sum())
    pace = Pace(deadline)
    for k in range(cycles):
        for kind in kinds:
            if not pace.more:
                break
            now = editor.batch(now, kind)
            pace.done()
        before, error = error, float(now.errors.sum())
        on_cycle(k + 1, error)
        if error > (1 - LEAST_GAIN) * before:
            break
    return Edited(Manifold(now.control, now.faces), Fitted(now.basis, now.sharp, now.control, error))


class _Made(NamedTuple):
    """A mesh after edits. place: (V,) where each vertex of the old mesh and each new one stands, -1 for none."""

    faces: I64
    names: I64
    control: F64
    sharp: I64
    place: I64


class _Editor:
    def __init__(self, target: Target, levels: int, bits: int) -> None:
        self._target, self._levels, self._bits = target, levels, bits
        self._rng = np.random.default_rng(0)
        self._tried: set[tuple[str, int, int]] = set()
        self._next_name = 1 << 40

    def batch(self, old: _Control, kind: _Kind) -> _Control:
        """Try many edits of one kind; keep those that pay."""
        edges = _edges(old)
        degrees = np.bincount(old.faces.ravel(), minlength=len(old.control))
        allowed = kind.allowed(old, edges, degrees)
        rows, names = edges.rows, old.names
        keys = np.sort(names[rows[:, kind.key]], axis=1)
        fresh = [(kind.name, a, b) not in self._tried for a, b in keys.tolist()]
        allowed &= np.array(fresh, dtype=bool)
        order = kind.order(old, rows, self._rng)
        chosen = _apart(rows, order[allowed[order]], *_neighbours(old.faces, len(names)), kind.wide)
        if len(chosen) < LEAST_BATCH:
            return old
        self._tried.update((kind.name, a, b) for a, b in keys[chosen].tolist())
        edits = rows[chosen]
        made = self._made(old, kind, edits)
        basis = coarsest_basis(made.faces, len(made.control), made.sharp, self._levels)
        control = fit(basis, self._target, made.control, TRIAL_ROUNDS)
        errors = mean_errors(basis, self._target, control)
        around = edits[:, :4]
        new = np.column_stack([around, len(names) + np.arange(len(edits))]) if kind.adds else around
        before = _sums(old.faces, len(names), around, old.errors)
        after = _sums(made.faces, len(control), made.place[new], errors)
        bit = old.errors.sum() / self._bits
        each = self._bits / len(names)
        cost = kind.vertices * each + DEGREE_WEIGHT * _degree_bits(degrees, kind.degrees(degrees[around]))
        kept = edits[after + bit * (cost + MARGIN) < before]
        if len(kept) == 0:
            return old
        result = self._made(old, kind, kept)
        # The trial's fit has found places for the vertices of what is kept.
        moved = np.unique(kept[:, :4])
        moved = moved[(made.place[moved] >= 0) & (result.place[moved] >= 0)]
        result.control[result.place[moved]] = control[made.place[moved]]
        basis = coarsest_basis(result.faces, len(result.control), result.sharp, self._levels)
        control = fit(basis, self._target, result.control, 1)
        errors = mean_errors(basis, self._target, control)
        topology = topology_of(result.faces, len(control), result.sharp)
        return _Control(result.faces, result.names, control, result.sharp, basis, errors, topology)

    def _made(self, old: _Control, kind: _Kind, edits: I64) -> _Made:
        faces, control = kind.applied(old.faces.copy(), old.control, edits)
        names = old.names
        if kind.adds:
            names = np.concatenate([names, self._next_name + np.arange(len(edits))])
            self._next_name += len(edits)
        used = np.unique(faces)
        place = np.full(len(control), -1)
        place[used] = np.arange(len(used))
        if kind.vertices < 0:  # what is collapsed stands where the edge has gone
            place[edits[:, 1]] = place[edits[:, 0]]
        faces, control = place[faces], control[used]
        # A flipped edge of a polyhedron is as sharp as all others.
        sharp = _inner(faces, len(control)) if old.is_polyhedron else place[old.sharp]
        return _Made(faces, names[used], control, np.sort(sharp, axis=1), place)


class _Flips:
    """The edge between p and q in place of that between x and y."""

    name, key, wide, vertices, adds = "flip", [2, 3], False, 0, False

    def allowed(self, old: _Control, edges: _Edges, degrees: I64) -> Mask:
        x, y, p, q, _, _ = edges.rows.T
        n = len(old.control)
        there = old.topology.edges
        joined = np.isin(np.minimum(p, q) * n + np.maximum(p, q), there[:, 0] * n + there[:, 1])
        # A crease stays; in a polyhedron all edges are alike.
        free = ~edges.sharp | old.is_polyhedron
        ok = free & ~joined & (p != q) & (degrees[x] > 3) & (degrees[y] > 3)
        a, b, c, d = (old.control[v] for v in (x, y, p, q))
        f, g = unit(np.cross(b - a, c - a)), unit(np.cross(a - b, d - b))
        first, second = unit(np.cross(d - c, b - c)), unit(np.cross(a - c, d - c))
        ok &= _dot(f, g) > FLATTEST
        for new in (first, second):
            for one in (f, g):
                ok &= _dot(new, one) > TURN
        return np.asarray(ok)

    def order(self, old: _Control, rows: I64, rng: np.random.Generator) -> I64:
        return rng.permutation(len(rows))

    def degrees(self, around: I64) -> tuple[I64, I64]:
        return around, around + np.array([-1, -1, 1, 1])

    def applied(self, faces: I64, control: F64, edits: I64) -> tuple[I64, F64]:
        x, y, p, q, f, g = edits.T
        faces[f], faces[g] = np.column_stack([p, q, y]), np.column_stack([q, p, x])
        return faces, control


class _Collapses:
    """y goes, and x to the middle of the edge."""

    name, key, wide, vertices, adds = "collapse", [0, 1], True, -1, False

    def allowed(self, old: _Control, edges: _Edges, degrees: I64) -> Mask:
        x, y, p, q, _, _ = edges.rows.T
        n = len(old.control)
        topology = old.topology
        smooth = np.ones(n, dtype=bool)
        smooth[topology.edges[topology.sharp]] = False
        ok = smooth[x] & smooth[y] & (p != q) & (degrees[p] > 3) & (degrees[q] > 3) & (degrees[x] + degrees[y] > 6)
        # The link condition: p and q are all that x and y have in common.
        a, b = topology.edges.T
        joined = sp.csr_matrix((np.ones(2 * len(a)), (np.append(a, b), np.append(b, a))), shape=(n, n))
        common = np.asarray(joined[x].multiply(joined[y]).sum(axis=1)).ravel()
        return np.asarray(ok & (common == 2) & ~_turned(old.faces, old.control, edges.rows, *_corners(old.faces, n)))

    def order(self, old: _Control, rows: I64, rng: np.random.Generator) -> I64:
        at = np.bincount(old.faces.ravel(), np.repeat(old.errors, 3), len(old.control))
        return np.argsort(at[rows[:, 0]] + at[rows[:, 1]], kind="stable")

    def degrees(self, around: I64) -> tuple[I64, I64]:
        x, y, p, q = around.T
        # One vertex less: what it would have cost stands on its own (`vertices`), at the most usual degree.
        return around, np.column_stack([x + y - 4, np.full(len(x), 6), p - 1, q - 1])

    def applied(self, faces: I64, control: F64, edits: I64) -> tuple[I64, F64]:
        x, y, _, _, f, g = edits.T
        to = np.arange(len(control))
        to[y] = x
        kept = np.ones(len(faces), dtype=bool)
        kept[f] = kept[g] = False
        control = control.copy()
        control[x] = (control[x] + control[y]) / 2
        return to[faces[kept]], control


class _Splits:
    """A new vertex on the edge, joined to p and q: where subdivision would put it."""

    name, key, wide, vertices, adds = "split", [0, 1], False, 1, True

    def allowed(self, old: _Control, edges: _Edges, degrees: I64) -> Mask:
        return ~edges.sharp & (edges.rows[:, 2] != edges.rows[:, 3])

    def order(self, old: _Control, rows: I64, rng: np.random.Generator) -> I64:
        return np.argsort(-(old.errors[rows[:, 4]] + old.errors[rows[:, 5]]), kind="stable")

    def degrees(self, around: I64) -> tuple[I64, I64]:
        n = len(around)
        more = np.column_stack([around[:, 2:] + 1, np.full(n, 4)])
        return np.column_stack([around[:, 2:], np.full(n, 6)]), more

    def applied(self, faces: I64, control: F64, edits: I64) -> tuple[I64, F64]:
        x, y, p, q, f, g = edits.T
        v = len(control) + np.arange(len(edits))
        faces[f], faces[g] = np.column_stack([x, v, p]), np.column_stack([y, v, q])
        faces = np.concatenate([faces, np.column_stack([v, y, p]), np.column_stack([v, x, q])])
        return faces, np.concatenate([control, 3 / 8 * (control[x] + control[y]) + 1 / 8 * (control[p] + control[q])])


_Kind = _Flips | _Collapses | _Splits


def _edges(mesh: _Control) -> _Edges:
    faces, topology = mesh.faces, mesh.topology
    of = topology.face_edges.ravel()
    count = np.bincount(of)
    halves = np.argsort(of, kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]])[count == 2]
    one, other = halves[first], halves[first + 1]
    f, k, g, m = one // 3, one % 3, other // 3, other % 3
    x, y, p = faces[f, k], faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
    alike = faces[g, m] == y
    rows = np.column_stack([x, y, p, faces[g, (m + 2) % 3], f, g])[alike]
    return _Edges(rows, topology.sharp[count == 2][alike])


def _inner(faces: I64, n: int) -> I64:
    """(E, 2) the edges of two faces."""
    topology = topology_of(faces, n, np.zeros((0, 2), dtype=np.int64))
    return np.asarray(topology.edges[~topology.sharp], dtype=np.int64)


def _corners(faces: I64, n: int) -> tuple[I64, I64]:
    """Faces at each vertex: those of v are the second array's from first[v] to first[v + 1]."""
    first = np.concatenate([[0], np.cumsum(np.bincount(faces.ravel(), minlength=n))])
    return first, np.argsort(faces.ravel(), kind="stable") // 3


def _neighbours(faces: I64, n: int) -> tuple[I64, I64]:
    """Corners of the faces at each vertex, in the same way."""
    first, at = _corners(faces, n)
    return 3 * first, faces[at].ravel()


def _degree_bits(degrees: I64, change: tuple[I64, I64]) -> F64:
    """(K,) bits that K edits add by their changes of degrees: a degree costs the logarithm of how rare it is."""
    count = np.bincount(np.minimum(degrees, LARGEST_DEGREE), minlength=LARGEST_DEGREE + 1) + 1.0
    bits = -np.log2(count / count.sum())
    before, after = (bits[np.clip(d, 0, LARGEST_DEGREE)].sum(axis=1) for d in change)
    return np.asarray(after - before)


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(np.sum(a * b, axis=1))


@nb.njit(cache=True)
def _apart(rows: I64, order: I64, first: I64, neighbours: I64, wide: bool) -> I64:
    """Take edges in an order, leaving out those of which a corner is taken. wide: with all neighbours of their ends."""
    taken = np.zeros(len(first) - 1, dtype=np.bool_)
    chosen = np.empty(len(order), dtype=np.int64)
    n = 0
    for e in order:
        if taken[rows[e, 0]] or taken[rows[e, 1]] or taken[rows[e, 2]] or taken[rows[e, 3]]:
            continue
        for k in range(4):
            taken[rows[e, k]] = True
        if wide:
            for k in range(2):
                for i in range(first[rows[e, k]], first[rows[e, k] + 1]):
                    taken[neighbours[i]] = True
        chosen[n] = e
        n += 1
    return chosen[:n]


@nb.njit(cache=True)
def _turned(faces: I64, control: F64, rows: I64, first: I64, at: I64) -> Mask:
    """(E,) whether a face would turn too far, were both ends of an edge in its middle."""
    out = np.zeros(len(rows), dtype=np.bool_)
    for e in range(len(rows)):
        middle = (control[rows[e, 0]] + control[rows[e, 1]]) / 2
        for k in range(2):
            v, other = rows[e, k], rows[e, 1 - k]
            for i in range(first[v], first[v + 1]):
                f = at[i]
                c = 0
                while faces[f, c] != v:
                    c += 1
                s, t = faces[f, (c + 1) % 3], faces[f, (c + 2) % 3]
                if s == other or t == other:
                    continue
                before = np.cross(control[s] - control[v], control[t] - control[v])
                after = np.cross(control[s] - middle, control[t] - middle)
                if np.sum(before * after) <= TURN * np.sqrt(np.sum(before * before) * np.sum(after * after)):
                    out[e] = True
    return out


def _sums(faces: I64, n: int, around: I64, errors: F64) -> F64:
    """(K,) the errors of all faces at vertices (K, C), each face once."""
    first, at = _corners(faces, n)
    return np.asarray(_summed(around, first, at, errors))


@nb.njit(cache=True)
def _summed(around: I64, first: I64, at: I64, errors: F64) -> F64:
    last = np.full(len(errors), -1)
    out = np.zeros(len(around))
    for i in range(len(around)):
        for v in around[i]:
            for k in range(first[v], first[v + 1]):
                if last[at[k]] != i:
                    last[at[k]] = i
                    out[i] += errors[at[k]]
    return out
