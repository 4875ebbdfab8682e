"""The surface section: bytes <-> ControlMesh. See spec/cndhf.md, section 4."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...errors import FieldError, OptionError, PayloadError, SectionError
from .. import constants as c
from ..bfloat16 import bits_above, from_bits
from ..container import ControlMesh
from .connectivity import decode_connectivity, encode_connectivity, limits_for
from .manifold import Ints
from .marks import decode_marks, encode_marks
from .positions import EIGHTHS, best_eighths, code_positions, repeated_share, told_of, walk_of
from .range_coder import RangeDecoder, RangeEncoder

HEAD_SIZE = 3  # flags, step
QUATERNION_SIZE = 8
ROTATED = 0x10  # flag: a quaternion follows the step
REPEATS = 0x20  # flag: coordinates are first compared with those nearby
# Share of coordinates. Where fewer are repeated, to say of each whether it is takes more bits than are saved: .29 per
# coordinate at least, and the repeated ones have 6 at most on average.
FEW_REPEATED = 1 / 20
# Positions that take so much less one way are coded that way ever after, for a control mesh whose positions are varied.
CLEARLY_LESS = 0.96
UNTURNED = (0, 0, 0, c.QUATERNION_ONE)
LEAST_STEP, MOST_STEP = 2.0**-30, 1.0  # normalised units


def encode_surface(mesh: ControlMesh) -> bytes:
    """The body of the section. Vertices and faces come back in another order (see `encode_connectivity`).

    Raises MeshError where the mesh is not a two-manifold, LimitError where it or a position is too large, and
    OptionError for sharp edges or vertices that it does not have.
    """
    return PositionEncoder(mesh).body(mesh)


class Coding(NamedTuple):
    """How positions are coded. eighths: of the prediction. repeats: whether repeated coordinates are said. n_bytes: of
    the section."""

    eighths: int
    repeats: bool
    n_bytes: int


class PositionEncoder:
    """The section of control meshes that differ in positions, step and frame alone: the rest is coded once.

    mesh: one of them. Raises as `encode_surface` does. Whether repeated coordinates are said is tried both ways until
    one is clearly better. start: the range encoder after connectivity and marks. walk: over the vertices as they are
    decoded. told: as `told_of` has it.
    """

    def __init__(self, mesh: ControlMesh) -> None:
        _check_numbers(mesh)
        self.start = RangeEncoder()
        numbering = encode_connectivity(self.start, mesh.faces)
        faces = np.empty_like(mesh.faces)
        faces[numbering.faces] = numbering.vertices[mesh.faces]
        faces = _least_first(faces)
        encode_marks(self.start, faces, numbering.vertices[mesh.sharp])
        self._vertices, self.walk = numbering.vertices, walk_of(faces)
        self.told = told_of(self.walk)
        self._ways: tuple[bool, ...] = (False, True)

    def body(self, mesh: ControlMesh) -> bytes:
        """The body of the section."""
        streams: dict[bool, bytes] = {}

        def n_bytes(eighths: int, repeats: bool, positions: Ints) -> int:
            encoder = self.start.copy()
            code_positions(encoder, self.walk, eighths, repeats, positions)
            streams[repeats] = encoder.finish()
            return len(streams[repeats])

        coding = self.choose(mesh, n_bytes)
        turned = _is_turned(mesh)
        try:
            step = bits_above(mesh.step)
            if from_bits(step) != mesh.step:
                raise OptionError(f"field step of the control mesh is {mesh.step}, which is no bfloat16")
            flags = coding.eighths | (REPEATS if coding.repeats else 0) | (ROTATED if turned else 0)
            head = struct.pack("<BH", flags, step)
            head += struct.pack("<4h", *mesh.quaternion) if turned else b""
        except struct.error as exc:
            raise OptionError(f"the control mesh does not fit the format: {exc}") from exc
        return head + streams[coding.repeats]

    def choose(self, mesh: ControlMesh, n_bytes: Callable[[int, bool, Ints], int]) -> Coding:
        """How a mesh is coded. n_bytes: the length of a stream with these eighths, repeats and positions (V, 3), which
        are in the order of decoded vertices. After a way that is clearly better, later calls take that one alone."""
        positions = np.empty_like(mesh.positions)
        positions[self._vertices] = mesh.positions
        eighths = best_eighths(self.told, positions)
        few = repeated_share(self.told, positions) <= FEW_REPEATED
        sizes = {way: n_bytes(eighths, way, positions) for way in ((False,) if few else self._ways)}
        repeats = min(sizes, key=lambda way: sizes[way])
        if sizes[repeats] < CLEARLY_LESS * max(sizes.values()):
            self._ways = (repeats,)
        return Coding(eighths, repeats, HEAD_SIZE + (QUATERNION_SIZE if _is_turned(mesh) else 0) + sizes[repeats])


def decode_surface(body: bytes) -> ControlMesh:
    """Read the section. Raises a subclass of FormatError."""
    if len(body) < HEAD_SIZE:
        raise SectionError(f"the surface section has {len(body)} bytes; it has at least {HEAD_SIZE}")
    flags, step_bits = struct.unpack_from("<BH", body)
    step = from_bits(step_bits)
    eighths, at = flags & 0x0F, HEAD_SIZE
    if flags & ~(0x0F | ROTATED | REPEATS):
        raise FieldError(f"surface: field flags is {flags}; bits 6 and 7 are reserved")
    if eighths > EIGHTHS:
        raise FieldError(f"surface: field eighths is {eighths}; 0 to {EIGHTHS} are allowed")
    if not LEAST_STEP <= step <= MOST_STEP:
        raise FieldError(f"surface: field step is {step}; {LEAST_STEP:g} to {MOST_STEP:g} are allowed")
    quaternion = UNTURNED
    if flags & ROTATED:
        if len(body) < at + QUATERNION_SIZE:
            raise SectionError("the surface section ends inside its quaternion")
        quaternion = struct.unpack_from("<4h", body, at)
        at += QUATERNION_SIZE
        check_quaternion(quaternion, "surface")
    decoder = RangeDecoder(body[at:])
    faces = _least_first(decode_connectivity(decoder, limits_for(len(body))))
    if not faces.size:
        raise PayloadError("the surface section holds no faces; a surface has at least one")
    sharp = decode_marks(decoder, faces)
    positions = code_positions(decoder, walk_of(faces), eighths, bool(flags & REPEATS))
    decoder.finish()
    return ControlMesh(quaternion, step, positions, faces, sharp)


def _is_turned(mesh: ControlMesh) -> bool:
    return tuple(mesh.quaternion) != UNTURNED


def _check_numbers(mesh: ControlMesh) -> None:
    """Raise OptionError where faces or sharp edges name vertices without a position, or none names the last."""
    n = len(mesh.positions)
    for name, numbers in (("faces", mesh.faces), ("sharp", mesh.sharp)):
        if numbers.min(initial=0) < 0 or numbers.max(initial=-1) >= n:
            raise OptionError(f"field {name} of the control mesh names a vertex that is not one of its {n} positions")
    if n > 1 + mesh.faces.max(initial=-1):
        raise OptionError(f"vertex {n - 1} of the control mesh has no faces; leave it out")


def _least_first(faces: Ints) -> Ints:
    """Turn each face so that its least vertex comes first: the encoder does not know how the decoder will find it."""
    first = np.argmin(faces, axis=1)[:, None]
    return np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)


def check_quaternion(quaternion: tuple[int, int, int, int], name: str) -> None:
    """Raise FieldError where a quaternion of integers has a wrong norm."""
    square = sum(x * x for x in quaternion)
    if not c.QUATERNION_MIN_NORM**2 <= square <= c.QUATERNION_MAX_NORM**2:
        norm = math.sqrt(square)
        raise FieldError(f"{name}: field quaternion has norm {norm:.0f}; it must be near {c.QUATERNION_ONE}")
