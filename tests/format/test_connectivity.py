"""Connectivity: every two-manifold comes back as it was, anything else is refused, and no bytes do harm."""

from __future__ import annotations

import manifolds
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cndhf_codec.errors import FormatError, LimitError, MeshError, PayloadError
from cndhf_codec.format.surface.connectivity import (
    FREE_FACES,
    MAX_FACES,
    Limits,
    decode_connectivity,
    encode_connectivity,
    limits_for,
)
from cndhf_codec.format.surface.manifold import edges_of, fault
from cndhf_codec.format.surface.range_coder import RangeDecoder, RangeEncoder

FROZEN = {
    "triangle": "fc",
    "tetrahedron": "ba",
    "klein bottle": "25 3d ce ad 2c 9a 5d 26 93 b1 aa d6 20 c0 33 d6 67 09",
}


def encoded(faces: np.ndarray) -> bytes:
    encoder = RangeEncoder()
    encode_connectivity(encoder, faces)
    return encoder.finish()


def decoded(body: bytes) -> np.ndarray:
    decoder = RangeDecoder(body)
    faces = decode_connectivity(decoder, limits_for(len(body)))
    decoder.finish()
    return faces


def smallest_first(faces: np.ndarray) -> np.ndarray:
    """The faces with their corners rotated."""
    return faces[np.arange(len(faces))[:, None], (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3]


def check(faces: np.ndarray) -> bytes:
    """Code a mesh and check everything that is promised; return the bytes."""
    encoder = RangeEncoder()
    numbering = encode_connectivity(encoder, faces)
    body = encoder.finish()
    back = decoded(body)
    wanted = np.empty_like(back)
    wanted[numbering.faces] = numbering.vertices[faces]
    np.testing.assert_array_equal(smallest_first(back), smallest_first(wanted))
    first = np.unique(back, return_index=True)[1]
    assert (np.diff(first) > 0).all()  # numbered by first appearance
    assert back.dtype == np.int32
    assert encoded(back) == body
    return body


@pytest.mark.parametrize("kind", manifolds.KINDS)
def test_round_trip(kind):
    faces = manifolds.KINDS[kind]
    assert fault(faces, edges_of(faces)) is None
    check(faces)
    check(manifolds.shuffled(faces, np.random.default_rng(0)))
    check(manifolds.turned(faces, np.random.default_rng(1), 0.3))


@st.composite
def meshes(draw) -> np.ndarray:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    faces = manifolds.KINDS[draw(st.sampled_from(sorted(manifolds.KINDS)))]
    faces = manifolds.with_flips(faces, rng, draw(st.sampled_from([0, 10, 300])))
    faces = manifolds.without(faces, rng, draw(st.sampled_from([0, 0.05, 0.3, 0.8])))
    faces = manifolds.turned(faces, rng, draw(st.sampled_from([0, 0, 0.01, 0.5])))
    return manifolds.shuffled(faces, rng)


@given(meshes())
@settings(max_examples=150, deadline=None)
def test_random_meshes(faces):
    check(faces)


def test_no_faces_at_all():
    assert decoded(encoded(np.zeros((0, 3), dtype=np.int32))).shape == (0, 3)


@pytest.mark.parametrize("kind", FROZEN)
def test_frozen_bytes(kind):
    assert encoded(manifolds.KINDS[kind]).hex(" ") == FROZEN[kind]


def test_sizes():
    # Bits per vertex; a plane grid is the most regular mesh, and flips at random are about the worst.
    torus = manifolds.grid(40, 40, wrap=True, wrap_other=True)
    flipped = manifolds.with_flips(torus, np.random.default_rng(0), 2000)
    triangles = manifolds.KINDS["triangles"]
    assert len(check(manifolds.grid(60, 60))) < 32
    assert 8 * len(check(torus)) / 1600 < 0.1
    assert 8 * len(check(flipped)) / 1600 < 3.2
    assert len(check(triangles)) < 8
    # Turned faces cost nothing where none are, and little where few are.
    rng = np.random.default_rng(0)
    assert len(check(manifolds.turned(flipped, rng, 0.01))) < len(check(flipped)) + 50


@pytest.mark.parametrize(
    ("faces", "words"),
    [
        ([(0, 1, 1)], "face 0 has a vertex twice"),
        ([(0, 1, 3)], "vertex 2 has no faces"),
        ([(0, 1, 2), (1, 0, 3), (0, 1, 4)], r"the edge of vertices \[0, 1\] has 3 faces"),
        ([(0, 1, 2), (1, 3, 2), (0, 2, 1)], r"the edge of vertices \[1, 2\] has 3 faces"),
        ([(0, 1, 2), (0, 2, 1)], r"faces \[0, 1\] have the same vertices"),
        ([(0, 1, 2), (0, 3, 4)], "the faces at vertex 0 are 2 fans"),
        ([*manifolds.TETRAHEDRON.tolist(), (0, 4, 5)], "the faces at vertex 0 are 2 fans"),
    ],
)
def test_what_is_no_manifold_is_refused(faces, words):
    with pytest.raises(MeshError, match=words):
        encoded(np.array(faces, dtype=np.int32))


@pytest.mark.parametrize("kind", ["sheet", "moebius strip", "genus 2", "parts"])
def test_truncations(kind):
    body = encoded(manifolds.KINDS[kind])
    for end in range(len(body)):
        harmless(body[:end])


def harmless(body: bytes) -> None:
    """Decode: an error by name, or a mesh that can be coded."""
    try:
        faces = decoded(body)
    except FormatError:
        return
    assert fault(faces, edges_of(faces)) is None
    check(faces)


@pytest.mark.parametrize("seed", range(8))
def test_damage(seed):
    rng = np.random.default_rng(seed)
    kinds = sorted(manifolds.KINDS)
    for _ in range(400):
        body = bytearray(encoded_kind(kinds[rng.integers(len(kinds))]))
        for _ in range(rng.integers(1, 4)):
            body[rng.integers(len(body))] = rng.integers(256)
        harmless(bytes(body))
        harmless(rng.bytes(int(rng.integers(1, 60))))


_BODIES: dict[str, bytes] = {}


def encoded_kind(kind: str) -> bytes:
    if kind not in _BODIES:
        _BODIES[kind] = encoded(manifolds.turned(manifolds.KINDS[kind], np.random.default_rng(0), 0.1))
    return _BODIES[kind]


class Script:
    """A coder that says what it is told, and then one bit for ever: a stream of any length in no bytes."""

    def __init__(self, bits: list[int], rest: int) -> None:
        self.bits = bits
        self.rest = rest
        self.asked = 0

    def bit(self, context, bit=0):
        self.asked += 1
        return self.bits[self.asked - 1] if self.asked <= len(self.bits) else self.rest

    def raw(self, n_bits, value=0):
        return sum(self.bit(None) << k for k in range(n_bits))


@pytest.mark.parametrize("rest", [0, 1])
@pytest.mark.parametrize("start", range(64))
def test_no_stream_goes_on_for_ever(start, rest):
    script = Script([start >> k & 1 for k in range(6)], rest)
    try:
        faces = decode_connectivity(script, Limits(500, 500))
    except FormatError:
        pass
    else:
        assert len(faces) <= 500
    assert script.asked < 20_000


def test_limits():
    body = encoded(manifolds.TORUS)
    with pytest.raises(LimitError, match="more than 83 faces"):
        decode_connectivity(RangeDecoder(body), Limits(1000, 83))
    with pytest.raises(LimitError, match="more than 41 vertices"):
        decode_connectivity(RangeDecoder(body), Limits(41, 1000))
    assert len(decode_connectivity(RangeDecoder(body), Limits(42, 84))) == 84
    assert limits_for(0).faces == FREE_FACES
    assert limits_for(10**6).faces == MAX_FACES


def test_large_meshes_are_refused(monkeypatch):
    monkeypatch.setattr("cndhf_codec.format.surface.connectivity.MAX_FACES", 83)
    with pytest.raises(LimitError, match="more than 83 faces"):
        encoded(manifolds.TORUS)


# Bits: oriented, no caps, a component. Its border has three nodes, so that the other end is not asked about.
TRIANGLE = [1, 0, 1]


@pytest.mark.parametrize(
    ("bits", "rest", "words"),
    [
        # No closing, a join: not far, on the first side, no nodes between: the pivot itself.
        ([0, 1, 0, 0], 0, "a node of the gate"),
        # No closing, a new vertex; then no closing, a join, which reaches R round the border of four nodes.
        ([0, 0, 0, 0, 1, 0, 0], 0, "a node of the gate"),
        ([0, 1, 0, 0], 1, "nodes away; at most 64"),
        ([0, 1, 1], 1, "a node that is not on the border"),
    ],
)
def test_a_join_must_name_a_node_of_the_border(bits, rest, words):
    with pytest.raises(PayloadError, match=words):
        decode_connectivity(Script(TRIANGLE + bits, rest), Limits(99, 99))
