"""The vector instructions against numpy."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

from cndhf_codec.encoder.dhf.network import vectors
from cndhf_codec.encoder.dhf.network.vectors import LANES

pytestmark = pytest.mark.encode

SIZES = [1, 2, 4, 5, 16, 35]
COLUMNS = [LANES, 3 * LANES, 9 * LANES]  # fewer than a wide block has, and some more than one or two


def numbers(*shape: int) -> np.ndarray:
    return np.random.default_rng(len(shape)).uniform(-1, 1, shape).astype(np.float32)


@pytest.mark.parametrize("rows", SIZES)
@pytest.mark.parametrize("terms", SIZES)
def test_a_product_is_numpy_s_and_nothing_else_changes(rows, terms):
    W, x, start = numbers(rows, terms), numbers(terms, 10 * LANES), numbers(rows)
    for n in COLUMNS:
        for matrix in (W, np.ascontiguousarray(W.T).T):  # stored by rows, by columns
            z = np.full((rows + 1, 10 * LANES), 7, np.float32)
            vectors.set_product(matrix, x, start, np.float32(3), z, n)
            expected = 3 * (start[:, None] + W.astype(float) @ x[:, :n])
            np.testing.assert_allclose(z[:rows, :n], expected, atol=1e-5)
            assert (z[rows:] == 7).all()
            assert (z[:, n:] == 7).all()


@pytest.mark.parametrize("rows", SIZES)
@pytest.mark.parametrize("columns", SIZES)
def test_an_outer_product_is_added(rows, columns):
    d, x = numbers(rows, 10 * LANES), numbers(columns, 10 * LANES)
    for n in COLUMNS:
        G = np.ones((rows + 1, columns + 1), np.float32)
        vectors.add_outer(d, x, G[:rows, :columns], n)
        np.testing.assert_allclose(G[:rows, :columns], 1 + d[:, :n].astype(float) @ x[:, :n].T, atol=1e-5)
        assert (G[rows:] == 1).all()
        assert (G[:, columns:] == 1).all()


def test_sines_and_cosines():
    z = np.linspace(-1000, 1000, 3 * 2100 * LANES, dtype=np.float32).reshape(3, -1)
    sine, cosine = np.empty_like(z), np.empty_like(z)
    vectors.sine_and_cosine(z, sine, cosine, z.shape[1])
    np.testing.assert_allclose(sine, np.sin(z.astype(float)), atol=2e-7)
    np.testing.assert_allclose(cosine, np.cos(z.astype(float)), atol=2e-7)
    alone = z.copy()
    vectors.sine_in_place(alone, z.shape[1])
    np.testing.assert_allclose(alone, np.sin(z.astype(float)), atol=2e-7)


def test_only_the_first_columns_are_looked_at():
    z = np.zeros((2, 3 * LANES), np.float32)
    z[:, LANES:] = 2
    vectors.sine_in_place(z, LANES)
    assert (z[:, LANES:] == 2).all()


RESULTS = """
import sys
import numpy as np
from cndhf_codec.encoder.dhf.network import vectors
rng = np.random.default_rng(0)
W, x, start, z, G, d = (
    rng.uniform(-1, 1, n).astype(np.float32) for n in ((35, 21), (21, 160), 35, (35, 160), (35, 21), (35, 160))
)
vectors.set_product(W, x, start, np.float32(20), z, 160)
vectors.add_outer(d, x, G, 160)
sine, cosine = np.empty_like(z), np.empty_like(z)
vectors.sine_and_cosine(z, sine, cosine, 160)
vectors.sine_in_place(z, 160)
sys.stdout.buffer.write(b"".join(a.tobytes() for a in (z, sine, cosine, G)) + bytes([vectors.HAS_AVX512]))
"""


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names an x86 processor")
def test_a_processor_of_short_vectors_gives_the_same():
    old = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "+sse2"}  # it has no fused multiplication, either
    here, there = (
        subprocess.run([sys.executable, "-c", RESULTS], capture_output=True, env={**os.environ, **e}, check=True).stdout
        for e in ({}, old)
    )
    assert there[-1] == 0
    outer = 4 * 35 * 21
    assert here[: -outer - 1] == there[: -outer - 1]
    # The sums of outer products are taken in as many parts as a vector has numbers.
    np.testing.assert_allclose(*(np.frombuffer(b[-outer - 1 : -1], np.float32) for b in (here, there)), atol=1e-5)
