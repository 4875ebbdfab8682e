"""Sharp marks come back as they were, cost little where they form lines, and no bytes do harm."""

from __future__ import annotations

import manifolds
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cndhf_codec.errors import FormatError, OptionError
from cndhf_codec.format.surface.manifold import edges_of
from cndhf_codec.format.surface.marks import decode_marks, encode_marks
from cndhf_codec.format.surface.range_coder import RangeDecoder, RangeEncoder

FROZEN = "80 71 34 5a"


def encoded(faces: np.ndarray, sharp: np.ndarray) -> bytes:
    encoder = RangeEncoder()
    encode_marks(encoder, faces, sharp)
    return encoder.finish()


def decoded(body: bytes, faces: np.ndarray) -> np.ndarray:
    decoder = RangeDecoder(body)
    sharp = decode_marks(decoder, faces)
    decoder.finish()
    return sharp


def interior(faces: np.ndarray) -> np.ndarray:
    edges = edges_of(faces)
    return edges.vertices[edges.n_faces == 2]


def lines(n: int, every: int) -> tuple[np.ndarray, np.ndarray]:
    """A sheet of n by n squares, sharp along every so many of its columns."""
    faces = manifolds.grid(n, n)
    edges = interior(faces)
    column, row = edges // (n + 1), edges % (n + 1)
    return faces, edges[(column[:, 0] == column[:, 1]) & (column[:, 0] % every == 0) & (row[:, 0] != row[:, 1])]


@given(st.sampled_from(sorted(manifolds.KINDS)), st.integers(0, 2**32 - 1), st.sampled_from([0, 0.02, 0.3, 0.9, 1]))
@settings(max_examples=150, deadline=None)
def test_round_trip(kind, seed, share):
    rng = np.random.default_rng(seed)
    faces = manifolds.shuffled(manifolds.without(manifolds.KINDS[kind], rng, 0.1), rng)
    edges = interior(faces)
    sharp = edges[rng.random(len(edges)) < share]
    mixed = rng.permutation(sharp, axis=0)[:, :: int(rng.choice([-1, 1]))]
    body = encoded(faces, mixed)
    back = decoded(body, faces)
    np.testing.assert_array_equal(back, sharp)
    assert back.dtype == np.int32
    assert encoded(faces, back) == body


@pytest.mark.parametrize("kind", manifolds.KINDS)
def test_none_and_all_cost_nothing(kind):
    faces = manifolds.KINDS[kind]
    assert len(encoded(faces, np.zeros((0, 2), dtype=np.int32))) == 0
    assert len(encoded(faces, interior(faces))) <= 1


def test_lines_are_cheap():
    faces, sharp = lines(30, 5)
    assert len(sharp) == 150
    scattered = np.random.default_rng(0).permutation(interior(faces))[:150]
    assert len(encoded(faces, sharp)) < 60
    assert len(encoded(faces, scattered)) > 80


def test_frozen_bytes():
    faces, sharp = lines(8, 3)
    assert encoded(faces, sharp).hex(" ") == FROZEN


@pytest.mark.parametrize("edge", [(0, 1), (3, 3), (0, 40), (0, 500)])
def test_only_interior_edges_can_be_marked(edge):
    with pytest.raises(OptionError, match="no interior edge"):
        encoded(manifolds.grid(8, 5), np.array([edge]))


def test_no_bytes_do_harm():
    faces, sharp = lines(8, 3)
    body = encoded(faces, sharp)
    rng = np.random.default_rng(0)
    streams = [body[:end] for end in range(len(body))] + [rng.bytes(int(rng.integers(60))) for _ in range(1000)]
    for stream in streams:
        try:
            back = decoded(stream, faces)
        except FormatError:
            continue
        assert len(back) <= len(interior(faces))
        decoded(encoded(faces, back), faces)


@pytest.mark.parametrize("none", [np.zeros((0, 3), dtype=np.int32), manifolds.KINDS["triangles"]])
def test_without_interior_edges_nothing_is_read(none):
    assert decode_marks(RangeDecoder(b"\xff" * 9), none).shape == (0, 2)
    assert decoded(encoded(none, np.zeros((0, 2))), none).shape == (0, 2)
