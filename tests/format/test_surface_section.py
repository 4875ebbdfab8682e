"""Files that hold a surface: every control mesh comes back as it was, and no bytes do harm."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from dataclasses import replace

import manifolds
import numpy as np
import pytest
import rawfile
from hypothesis import given, settings
from hypothesis import strategies as st
from rawfile import SURFACE, build

from cndhf_codec.errors import ChecksumError, FormatError, OptionError, SectionError, TruncatedError
from cndhf_codec.format import Container, ControlMesh, Metadata, dumps, loads, loads_prefix, read_header, section_sizes
from cndhf_codec.format.surface import section
from cndhf_codec.format.surface.manifold import edges_of, fault
from cndhf_codec.format.surface.positions import MAX_POSITION
from cndhf_codec.format.surface.section import REPEATS, PositionEncoder, encode_surface
from cndhf_codec.format.writer import other_bytes

UNTURNED = (0, 0, 0, 32767)
Point = tuple[int, ...]


def geometry(mesh: ControlMesh) -> tuple[Counter, Counter]:
    """The triangles of a mesh with their orientation, and its sharp edges, by positions: without any numbering."""
    at: list[Point] = [tuple(p) for p in mesh.positions.tolist()]
    triangles = Counter(least_first(*(at[v] for v in face)) for face in mesh.faces.tolist())
    return triangles, Counter(tuple(sorted(at[v] for v in edge)) for edge in mesh.sharp.tolist())


def least_first(a: Point, b: Point, c: Point) -> tuple[Point, Point, Point]:
    return min((a, b, c), (b, c, a), (c, a, b))


def same_shape(one: ControlMesh, other: ControlMesh) -> bool:
    frames = (tuple(one.quaternion), one.step) == (tuple(other.quaternion), other.step)
    return frames and geometry(one) == geometry(other)


def control_mesh(
    faces: np.ndarray,
    seed: int,
    *,
    largest: int = 100,
    sharp: float = 0.2,
    turned: bool = False,
    step: float = 2.0**-9,
) -> ControlMesh:
    """A control mesh with random positions; of the interior edges the share `sharp` is sharp."""
    rng = np.random.default_rng(seed)
    edges = edges_of(faces)
    interior = edges.vertices[edges.n_faces == 2]
    positions = rng.integers(-largest, largest, (int(faces.max()) + 1, 3), endpoint=True).astype(np.int32)
    quaternion = UNTURNED
    if turned:
        q = rng.normal(size=4)
        x, y, z, w = (int(i) for i in np.round(q / np.linalg.norm(q) * 32767))
        quaternion = (x, y, z, w)
    return ControlMesh(quaternion, step, positions, faces, interior[rng.random(len(interior)) < sharp])


def container(mesh: ControlMesh) -> Container:
    return Container((1.0, -2.0, 1e5), 0.5, metadata=Metadata("test", 0.1, 0.2, 0.3, "mesh"), surface=mesh)


def check(mesh: ControlMesh) -> bytes:
    """Write and read a mesh, and check everything that is promised; return the bytes."""
    data = dumps(container(mesh))
    back = loads(data)
    assert back.dhfs == ()
    assert (back.centre, back.scale) == ((1.0, -2.0, 1e5), 0.5)
    assert back.metadata.encoder == "test"
    assert back.surface is not None
    assert same_shape(back.surface, mesh)
    assert all(a.dtype == np.int32 for a in (back.surface.positions, back.surface.faces, back.surface.sharp))
    assert (np.diff(back.surface.sharp) > 0).all()
    assert dumps(back) == data
    return data


def harmless(data: bytes) -> bool:
    """Whether a file is read: it must then hold a mesh that can be written. Anything but a FormatError is a failure."""
    try:
        back = loads(data)
    except FormatError:
        return False
    assert back.surface is not None
    assert fault(back.surface.faces, edges_of(back.surface.faces)) is None
    again = loads(dumps(back)).surface
    assert again is not None
    assert same_shape(again, back.surface)
    return True


def sealed(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


@pytest.mark.parametrize("kind", manifolds.KINDS)
def test_round_trip(kind):
    faces = manifolds.KINDS[kind]
    check(control_mesh(faces, 0))
    mixed = manifolds.shuffled(faces, np.random.default_rng(1))
    check(control_mesh(mixed, 2, turned=True, sharp=1.0))
    check(control_mesh(manifolds.turned(mixed, np.random.default_rng(3), 0.3), 4, largest=MAX_POSITION, sharp=0.0))


@st.composite
def meshes(draw) -> ControlMesh:
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    faces = manifolds.KINDS[draw(st.sampled_from(sorted(manifolds.KINDS)))]
    faces = manifolds.with_flips(faces, rng, draw(st.sampled_from([0, 0, 30])))
    faces = manifolds.without(faces, rng, draw(st.sampled_from([0, 0.05, 0.4])))
    faces = manifolds.turned(faces, rng, draw(st.sampled_from([0, 0, 0.02, 0.5])))
    return control_mesh(
        manifolds.shuffled(faces, rng),
        seed,
        largest=draw(st.sampled_from([0, 1, 60, 5000, MAX_POSITION])),
        sharp=draw(st.sampled_from([0, 0.05, 0.5, 1])),
        turned=draw(st.booleans()),
        step=draw(st.sampled_from([2.0**-30, 2.0**-9, 1.0])),
    )


@given(meshes())
@settings(max_examples=60, deadline=None)
def test_random_meshes(mesh):
    check(mesh)


def test_coordinates_that_repeat_are_nearly_free():
    # A box of cubes with three values of each coordinate, and with as many as can be.
    faces = manifolds.voxels(np.ones((6, 5, 4), dtype=bool))
    mesh = control_mesh(faces, 1, sharp=0.0)
    rng = np.random.default_rng(2)
    few = replace(mesh, positions=(1000 * rng.integers(0, 3, mesh.positions.shape)).astype(np.int32))
    many = replace(mesh, positions=(few.positions + rng.integers(-99, 99, few.positions.shape)).astype(np.int32))
    repeated, plain = encode_surface(few), encode_surface(many)
    assert (repeated[0] & REPEATS, plain[0] & REPEATS) == (REPEATS, 0)
    assert len(repeated) < 0.5 * len(plain)
    for each in few, many:
        back = loads(dumps(Container((0.0, 0.0, 0.0), 1.0, surface=each))).surface
        assert back is not None
        assert same_shape(back, each)


@pytest.mark.parametrize(
    ("values", "ways"),
    [(1000 * np.arange(3), [True]), (np.arange(8), [False]), (np.array([0, 1, 2, 4, 6]), [False, True])],
)
def test_one_way_is_coded_when_it_is_clearly_better(monkeypatch, values, ways):
    mesh = control_mesh(manifolds.voxels(np.ones((6, 5, 4), dtype=bool)), 1, sharp=0.0)
    mesh = replace(mesh, positions=np.random.default_rng(2).choice(values, mesh.positions.shape).astype(np.int32))
    coded, code = [], section.code_positions
    monkeypatch.setattr(section, "code_positions", lambda *given: [coded.append(given[3]), code(*given)][1])
    encoder = PositionEncoder(mesh)
    assert encoder.body(mesh) == encoder.body(mesh) == encode_surface(mesh)
    assert coded == [False, True, *ways, False, True]


@pytest.mark.parametrize("seed", range(20))
def test_the_order_of_faces_and_corners_does_not_change_the_shape(seed):
    # Encoder and decoder walk the same faces when positions are coded, however the input has them.
    mesh = control_mesh(manifolds.KINDS["parts"], 0)
    rng = np.random.default_rng(seed)
    faces = np.stack([np.roll(f, k) for f, k in zip(mesh.faces, rng.integers(3, size=len(mesh.faces)), strict=True)])
    check(replace(mesh, faces=rng.permutation(faces)))


def test_sharp_edges_may_be_given_in_any_order():
    mesh = control_mesh(manifolds.KINDS["sheet"], 0, sharp=0.3)
    assert dumps(container(replace(mesh, sharp=mesh.sharp[::-1, ::-1]))) == dumps(container(mesh))


def test_the_parts_of_a_file():
    data = check(control_mesh(manifolds.TETRAHEDRON, 0))
    header = read_header(data)
    assert [s.kind for s in header.sections] == [0x03, 0x82, 0x81, 0x83]
    sizes = section_sizes(data)
    assert sum(sizes.values()) == len(data)
    assert sizes == {"layout": 22 + 4 * 2 + 4, "surface": header.shape.length, "metadata": 6 + 4 + 4}
    # What is not the shape: 45 bytes with the version of an encoder, and the head of the section 3 more.
    named = Metadata("1.0.0", 0.1, 0.2, 0.3)
    container_named = replace(loads(data), metadata=named)
    assert len(dumps(container_named)) - header.shape.length == other_bytes((0.0, 0.0, 0.0), named, 100) == 43


def test_sections_of_later_versions_are_skipped():
    body = encode_surface(control_mesh(manifolds.TETRAHEDRON, 0))
    data = build([(0xC0, b"unknown"), (0x83, b"a"), (SURFACE, body)])
    assert loads(data).metadata == Metadata(source="a")


def test_a_surface_has_no_prefix():
    data = check(control_mesh(manifolds.TETRAHEDRON, 0))
    with pytest.raises(SectionError, match="surface, which can only be read as a whole"):
        loads_prefix(data)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"positions": np.full((4, 3), MAX_POSITION + 1, dtype=np.int32)}, "beyond 262144 grid units"),
        ({"step": 2.0}, "field step"),
        ({"step": 0.0}, "field step"),
        ({"step": 1e39}, "does not fit the format"),
        ({"step": 0.1}, "no bfloat16"),
        ({"step": float("nan")}, "does not fit the format"),
        ({"quaternion": (0, 0, 0, 1)}, "quaternion has norm 1"),
        ({"quaternion": (0, 0, 0, 40000)}, "does not fit the format"),
        ({"faces": np.zeros((0, 3), dtype=np.int32), "positions": np.zeros((0, 3), dtype=np.int32)}, "no faces"),
        ({"faces": np.array([(0, 1, 2), (0, 2, 1), (0, 1, 3)], dtype=np.int32)}, "two-manifold"),
        ({"faces": manifolds.TETRAHEDRON + 1}, "field faces .* not one of its 4 positions"),
        ({"faces": manifolds.TETRAHEDRON - 1}, "field faces .* not one of its 4 positions"),
        ({"faces": manifolds.TETRAHEDRON[:1]}, "vertex 3 of the control mesh has no faces"),
        ({"sharp": np.array([(0, 9)], dtype=np.int32)}, "field sharp .* not one of its 4 positions"),
        ({"sharp": np.array([(3, 3)], dtype=np.int32)}, "no interior edge"),
    ],
)
def test_what_no_reader_would_read_is_not_written(changes, words):
    mesh = replace(control_mesh(manifolds.TETRAHEDRON, 0, sharp=0), **changes)
    with pytest.raises(Exception, match=words) as caught:
        dumps(container(mesh))
    assert type(caught.value).__module__ == "cndhf_codec.errors"


def test_a_container_holds_fields_or_a_surface():
    fields = loads(rawfile.build())
    with pytest.raises(OptionError, match="either double height fields or a surface"):
        dumps(replace(fields, surface=control_mesh(manifolds.TETRAHEDRON, 0)))
    with pytest.raises(OptionError, match="either double height fields or a surface"):
        dumps(replace(fields, dhfs=()))


@pytest.fixture(scope="module")
def small() -> ControlMesh:
    faces = manifolds.together(manifolds.grid(2, 2), manifolds.TETRAHEDRON)
    return control_mesh(manifolds.turned(faces, np.random.default_rng(0), 0.2), 0, turned=True)


def test_truncations(small):
    data = check(small)
    for length in range(len(data)):
        with pytest.raises((TruncatedError, ChecksumError)):
            loads(data[:length])
    body = encode_surface(small)
    read = [harmless(build([(SURFACE, body[:length])])) for length in range(len(body))]
    # A shorter stream can by chance be that of another mesh, but hardly ever is.
    assert sum(read) <= 2


def test_every_byte_flipped(small):
    data = check(small)[:-4]
    read = 0
    for at in range(len(data)):
        for mask in (1, 2, 4, 8, 16, 32, 64, 128, 255):
            read += harmless(sealed(data[:at] + bytes([data[at] ^ mask]) + data[at + 1 :]))
    assert read > 0  # a changed centre is another valid file: the checksum was mended


@pytest.mark.parametrize("seed", range(4))
def test_random_streams(seed):
    rng = np.random.default_rng(seed)
    for _ in range(150):
        stream = rng.bytes(int(rng.integers(80)))
        harmless(build([(SURFACE, bytes([int(rng.integers(9)), 0x80, 0x3C]) + stream)]))
