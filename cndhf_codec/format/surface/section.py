"""The surface section: bytes <-> ControlMesh. See spec/cndhf.md, section 4."""

from __future__ import annotations

import math
import struct

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


class PositionEncoder:
    """The section of control meshes that differ in positions, step and frame alone: the rest is coded once.

    mesh: one of them. Raises as `encode_surface` does. Whether repeated coordinates are said is tried both ways until
    one is clearly better.
    """

    def __init__(self, mesh: ControlMesh) -> None:
        _check_numbers(mesh)
        self._encoder = RangeEncoder()
        numbering = encode_connectivity(self._encoder, mesh.faces)
        faces = np.empty_like(mesh.faces)
        faces[numbering.faces] = numbering.vertices[mesh.faces]
        faces = _least_first(faces)
        encode_marks(self._encoder, faces, numbering.vertices[mesh.sharp])
        self._vertices, self._walk = numbering.vertices, walk_of(faces)
        self._told = told_of(self._walk)
        self._ways: tuple[int, ...] = (0, REPEATS)

    def body(self, mesh: ControlMesh) -> bytes:
        """The body of the section."""
        turned = tuple(mesh.quaternion) != UNTURNED
        positions = np.empty_like(mesh.positions)
        positions[self._vertices] = mesh.positions
        eighths = best_eighths(self._told, positions)
        few = repeated_share(self._told, positions) <= FEW_REPEATED
        streams = {way: self._stream(eighths, bool(way), positions) for way in ((0,) if few else self._ways)}
        repeats = min(streams, key=lambda way: len(streams[way]))
        stream = streams[repeats]
        if len(stream) < CLEARLY_LESS * max(map(len, streams.values())):
            self._ways = (repeats,)
        try:
            step = bits_above(mesh.step)
            if from_bits(step) != mesh.step:
                raise OptionError(f"field step of the control mesh is {mesh.step}, which is no bfloat16")
            head = struct.pack("<BH", eighths | repeats | (ROTATED if turned else 0), step)
            head += struct.pack("<4h", *mesh.quaternion) if turned else b""
        except struct.error as exc:
            raise OptionError(f"the control mesh does not fit the format: {exc}") from exc
        return head + stream

    def _stream(self, eighths: int, repeats: bool, positions: Ints) -> bytes:
        encoder = self._encoder.copy()
        code_positions(encoder, self._walk, eighths, repeats, positions)
        return encoder.finish()


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
        if len(body) < at + 8:
            raise SectionError("the surface section ends inside its quaternion")
        quaternion = struct.unpack_from("<4h", body, at)
        at += 8
        check_quaternion(quaternion, "surface")
    decoder = RangeDecoder(body[at:])
    faces = _least_first(decode_connectivity(decoder, limits_for(len(body))))
    if not faces.size:
        raise PayloadError("the surface section holds no faces; a surface has at least one")
    sharp = decode_marks(decoder, faces)
    positions = code_positions(decoder, walk_of(faces), eighths, bool(flags & REPEATS))
    decoder.finish()
    return ControlMesh(quaternion, step, positions, faces, sharp)


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
