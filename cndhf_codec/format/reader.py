"""Bytes -> Container. Every count is checked before anything of its size is allocated."""

from __future__ import annotations

import math
import struct
import zlib
from collections import Counter
from dataclasses import dataclass

import numpy as np
import zstandard

from ..errors import (
    ChecksumError,
    FieldError,
    LimitError,
    OptionError,
    PayloadError,
    SectionError,
    SignatureError,
    TextModeError,
    TruncatedError,
    VersionError,
)
from . import constants as c
from . import rans
from .bfloat16 import INFINITY, from_bits
from .container import Container, DhfRecord, Metadata, Symbols, tensor_shapes
from .surface.section import check_quaternion, decode_surface

Centre = tuple[float, float, float]


@dataclass(frozen=True)
class Section:
    """A section's kind, and the place of its body in the file."""

    kind: int
    offset: int
    length: int


@dataclass(frozen=True)
class Header:
    """What can be read without decompressing anything."""

    centre: Centre
    scale: float
    sections: tuple[Section, ...]

    @property
    def shape(self) -> Section:
        """The section that holds the shape."""
        return next(s for s in self.sections if s.kind in c.SHAPES)


def loads(data: bytes) -> Container:
    """Read and check a whole file. Raises a subclass of FormatError that says what is wrong."""
    header = read_header(data)
    shape = header.shape
    body = _body(data, shape)
    metadata = _read_metadata({s.kind: _body(data, s) for s in header.sections})
    if shape.kind == c.KIND_SURFACE:
        return Container(header.centre, header.scale, metadata=metadata, surface=decode_surface(body))
    drafts, end = _read_records(body)
    read = _read_zstd if shape.kind == c.KIND_ZSTD else _read_rans
    dhfs = _records(drafts, read(body[end:], drafts))
    return Container(header.centre, header.scale, dhfs, metadata, shape.kind)


def loads_prefix(data: bytes, n_dhfs: int | None = None) -> Container:
    """Read the first `n_dhfs` DHFs, or as many as are complete, from the first bytes of a file.

    The records must be complete. The weights must have codec 2: those of codec 1 can only be read as a whole. All
    fields of what is used are checked. The checksum, which comes last, is not, so damage may go unseen. Metadata is
    left out, because its errors are those of the whole solid.
    Raises a subclass of FormatError: TruncatedError when the bytes do not hold one DHF, or not `n_dhfs`.
    """
    _check_start(data)
    centre, scale, at = _frame(data)
    sections, _ = _sections(data, at, to_shape=True)
    if not sections or sections[-1].kind not in c.SHAPES:
        raise TruncatedError(f"the file ends after {len(data)} bytes, before its shape")
    _check_kinds(sections)
    shape = sections[-1]
    if shape.kind == c.KIND_SURFACE:
        raise SectionError("the file holds a surface, which can only be read as a whole")
    if shape.kind == c.KIND_ZSTD:
        raise SectionError("the weights have codec 1; only those of codec 2 can be read from their start on")
    body = _body(data, shape)
    drafts, end = _read_records(body)
    wanted = len(drafts) if n_dhfs is None else n_dhfs
    if not 1 <= wanted <= len(drafts):
        raise OptionError(f"there are no {wanted} DHFs; the file has {len(drafts)}")
    ends = np.cumsum([len(d.sizes()) for d in drafts[:wanted]])
    tensors = rans.decode_prefix(body[end:], _rans_sizes(drafts), int(ends[-1]))
    count = int(np.count_nonzero(ends <= len(tensors)))
    if count == 0 or (n_dhfs is not None and count < wanted):
        raise TruncatedError(f"the file ends after {len(data)} bytes, before DHF {count} is complete")
    return Container(centre, scale, _records(drafts[:count], tensors), Metadata(), shape.kind)


def read_header(data: bytes) -> Header:
    """Read and check signature, version, checksum, centre and scale, and which sections there are."""
    _check_start(data)
    # Before anything else is read: every file that is damaged, cut short or lengthened is told here.
    end = len(data) - c.CRC_SIZE
    (crc,) = struct.unpack_from("<I", data, end)
    if zlib.crc32(memoryview(data)[:end]) != crc:
        raise ChecksumError("the checksum does not match: the file is damaged or incomplete; copy it again, as binary")
    centre, scale, at = _frame(data[:end])
    sections, reached = _sections(data[:end], at)
    if reached != end:
        raise TruncatedError("the last section goes on beyond the end of the file")
    _check_kinds(sections)
    if not any(s.kind in c.SHAPES for s in sections):
        raise SectionError("the file holds no shape: there is no section of kind 1 to 3")
    return Header(centre, scale, tuple(sections))


def _check_start(data: bytes) -> None:
    """Check signature, version and size. The version comes before all that may differ in another one."""
    n = len(c.SIGNATURE)
    if not data.startswith(c.SIGNATURE):
        if c.SIGNATURE.startswith(data):
            raise TruncatedError(f"the file ends after {len(data)} bytes, inside the signature")
        if c.SIGNATURE[1:] in data[: n + 2]:
            raise TextModeError("the signature is damaged as by a transfer of text; copy the file as binary")
        raise SignatureError("this is not a .cndhf file (wrong signature)")
    if len(data) > n and data[n] == c.VERSION_0:
        raise VersionError("the file was written by format 0.x; encode the source mesh again with this version")
    if len(data) > n and data[n] != c.VERSION:
        raise VersionError(
            f"the file has format version {data[n]}; this decoder reads {c.VERSION}: use a newer one, or encode the "
            "mesh again"
        )
    if len(data) < c.FRAME_AT + c.CRC_SIZE:
        raise TruncatedError(f"the file ends after {len(data)} bytes, inside its header")
    if len(data) > c.MAX_FILE_SIZE:
        raise LimitError(f"the file has {len(data)} bytes; {c.MAX_FILE_SIZE} are allowed")


def _frame(data: bytes) -> tuple[Centre, float, int]:
    """Read centre and scale; return them and where they end."""
    flags = data[c.FLAGS_AT]
    if flags & ~c.FAR_CENTRE:
        raise FieldError(f"field flags is {flags}; 0 and {c.FAR_CENTRE} are allowed")
    layout = "<3df" if flags & c.FAR_CENTRE else "<4f"
    end = c.FRAME_AT + struct.calcsize(layout)
    if len(data) < end:
        raise TruncatedError(f"the file ends after {len(data)} bytes, inside its header")
    x, y, z, scale = struct.unpack_from(layout, data, c.FRAME_AT)
    if not all(abs(v) <= c.MAX_CENTRE for v in (x, y, z)):  # false for NaN too
        raise FieldError(f"field centre is {x}, {y}, {z}; -2^100 to 2^100 are allowed")
    if not c.MIN_SCALE <= scale <= c.MAX_SCALE:
        raise FieldError(f"field scale is {scale}; 2^-100 to 2^100 are allowed")
    return (x, y, z), scale, end


def _sections(data: bytes, at: int, to_shape: bool = False) -> tuple[list[Section], int]:
    """Read the sections from `at` on, or those up to the shape; return them and where the last one ends.

    That may be beyond the end of the data, which may end in a section's head, too.
    """
    found: list[Section] = []
    while at < len(data):
        kind, length, shift = data[at], 0, 0
        while True:
            at += 1
            if at >= len(data):
                return found, len(data) + 1
            byte = data[at]
            length |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                break
            if shift == 7 * c.MAX_LENGTH_BYTES:
                raise SectionError(f"the length of a section of kind {kind} has more than {shift // 7} bytes")
        if byte == 0 and shift > 7:
            raise SectionError(f"the length of a section of kind {kind} has more bytes than it needs")
        at += 1
        if len(found) == c.MAX_SECTIONS:
            raise LimitError(f"the file has more than {c.MAX_SECTIONS} sections")
        found.append(Section(kind, at, length))
        at += length
        if to_shape and kind in c.SHAPES:
            break
    return found, at


def _check_kinds(sections: list[Section]) -> None:
    """Refuse sections that are unknown and not optional, or repeated."""
    counts = Counter(s.kind for s in sections)
    for kind, count in counts.items():
        known = kind in c.SHAPES + c.METADATA
        if not known and not kind & c.OPTIONAL:
            raise SectionError(f"a section has kind {kind}, which this decoder does not know; use a newer one")
        if known and count > 1:
            raise SectionError(f"there are {count} sections of kind {kind}; one is allowed")
    if sum(counts[kind] for kind in c.SHAPES) > 1:
        raise SectionError("the file holds two shapes; one is allowed")


@dataclass(frozen=True)
class _Draft:
    fold: int
    quaternion: tuple[int, int, int, int]
    box: tuple[int, int, int, int, int, int]
    width: int
    hidden_layers: int
    omega_first: int
    omega_hidden: int
    codes: bytes

    def sizes(self) -> list[int]:
        return [math.prod(shape) for shape in tensor_shapes(self.width, self.hidden_layers)]


def section_sizes(data: bytes) -> dict[str, int]:
    """Bytes of each part of a valid file; their sum is the file's size. Raises FormatError.

    "layout" is the header, the heads of sections and the checksum; "other" is the sections that this decoder skips.
    """
    header = read_header(data)
    out = {"layout": len(data) - sum(s.length for s in header.sections)}
    for section in header.sections:
        if section.kind == c.KIND_SURFACE:
            sizes = {"surface": section.length}
        elif section.kind in c.SHAPES:
            _, end = _read_records(_body(data, section))
            sizes = {"records": end, "weights": section.length - end}
        else:
            sizes = {"metadata" if section.kind in c.METADATA else "other": section.length}
        for name, size in sizes.items():
            out[name] = out.get(name, 0) + size
    return out


def _body(data: bytes, section: Section) -> bytes:
    return data[section.offset : section.offset + section.length]


def _read_records(body: bytes) -> tuple[list[_Draft], int]:
    """Read the number of DHFs and their records; return these and where they end."""
    if not body:
        raise TruncatedError("the records end before DHF 0")
    n_dhfs = body[0]
    if not 1 <= n_dhfs <= c.MAX_DHFS:
        raise LimitError(f"field n_dhfs is {n_dhfs}; 1 to {c.MAX_DHFS} are allowed")
    drafts, at = [], 1
    for i in range(n_dhfs):
        if len(body) < at + c.RECORD_HEAD_SIZE:
            raise TruncatedError(f"the records end inside DHF {i}")
        f = struct.unpack_from("<B4h6h4B", body, at)
        at += c.RECORD_HEAD_SIZE
        width, hidden = f[11], f[12]
        if not 1 <= width <= c.MAX_WIDTH:
            raise LimitError(f"DHF {i}: field width is {width}; 1 to {c.MAX_WIDTH} are allowed")
        if not 1 <= hidden <= c.MAX_HIDDEN_LAYERS:
            raise LimitError(f"DHF {i}: field hidden_layers is {hidden}; 1 to {c.MAX_HIDDEN_LAYERS} are allowed")
        n_codes = 2 * (hidden + 2)
        if len(body) < at + n_codes:
            raise TruncatedError(f"the records end inside DHF {i}")
        draft = _Draft(f[0], f[1:5], f[5:11], width, hidden, f[13], f[14], body[at : at + n_codes])
        at += n_codes
        _check_draft(draft, i)
        drafts.append(draft)
    total = sum(sum(d.sizes()) for d in drafts)
    if total > c.MAX_PARAMETERS:
        raise LimitError(f"the networks have {total} parameters; {c.MAX_PARAMETERS} are allowed")
    return drafts, at


def _check_draft(d: _Draft, i: int) -> None:
    if d.fold > c.MAX_FOLD:
        raise FieldError(f"DHF {i}: field fold is {d.fold}; 0 to {c.MAX_FOLD} are allowed")
    check_quaternion(d.quaternion, f"DHF {i}")
    for axis, lo, hi in zip("uvz", d.box[0::2], d.box[1::2], strict=True):
        if lo >= hi:
            raise FieldError(f"DHF {i}: field box is empty along {axis} ({lo} >= {hi})")
    if d.omega_first == 0 or d.omega_hidden == 0:
        raise FieldError(f"DHF {i}: field omega is zero")


def _records(drafts: list[_Draft], tensors: list[Symbols]) -> tuple[DhfRecord, ...]:
    rest = iter(tensors)
    return tuple(
        DhfRecord(
            quaternion=d.quaternion,
            box=d.box,
            width=d.width,
            hidden_layers=d.hidden_layers,
            omega_first=d.omega_first,
            omega_hidden=d.omega_hidden,
            step_codes=tuple(code & c.STEP_CODE_MASK for code in d.codes),
            symbols=tuple(next(rest).reshape(shape) for shape in tensor_shapes(d.width, d.hidden_layers)),
            fold=d.fold,
        )
        for d in drafts
    )


def _rans_sizes(drafts: list[_Draft]) -> list[int]:
    if any(code & c.STEP_WIDE for d in drafts for code in d.codes):
        raise FieldError("a step byte has bit 7 set, which codec 2 does not use")
    return [n for d in drafts for n in d.sizes()]


def _read_rans(body: bytes, drafts: list[_Draft]) -> list[Symbols]:
    return rans.decode(body, _rans_sizes(drafts))


def _read_zstd(body: bytes, drafts: list[_Draft]) -> list[Symbols]:
    wide = [bool(code & c.STEP_WIDE) for d in drafts for code in d.codes]
    sizes = [n for d in drafts for n in d.sizes()]
    n_low = sum(sizes)
    n_high = sum(n for n, w in zip(sizes, wide, strict=True) if w)
    raw = np.frombuffer(_decompress(body, n_low + n_high), dtype=np.uint8)
    symbols, low, high = [], 0, n_low
    for n, w in zip(sizes, wide, strict=True):
        u = raw[low : low + n].astype(np.int32)
        low += n
        if w:
            u |= raw[high : high + n].astype(np.int32) << 8
            high += n
        s = np.where(u & 1, -((u + 1) >> 1), u >> 1).astype(np.int32)
        if s.size and s.min() < -c.MAX_SYMBOL:
            raise FieldError(f"a weight symbol is below -{c.MAX_SYMBOL}")
        symbols.append(s)
    return symbols


def _decompress(body: bytes, size: int) -> bytes:
    if not body or body[0] not in c.ZSTD_DESCRIPTORS:
        said = f"is {body[0]}" if body else "is missing"
        raise PayloadError(f"the frame descriptor of the weights {said}; {[*c.ZSTD_DESCRIPTORS]} are allowed")
    frame = c.ZSTD_MAGIC + body
    try:
        declared = zstandard.get_frame_parameters(frame).content_size
    except zstandard.ZstdError as exc:
        raise PayloadError(f"the weights are not a zstd frame ({exc})") from exc
    if declared != size:
        raise PayloadError(f"the weights frame declares {declared} bytes; the DHF records need {size} bytes")
    try:
        # In one call, into a buffer of the declared size. Where a frame's blocks hold more than its header says, this
        # stops; a stream could go on for gigabytes.
        raw = zstandard.ZstdDecompressor().decompress(frame, allow_extra_data=False)
    except zstandard.ZstdError as exc:
        raise PayloadError(f"the weights do not decompress ({exc})") from exc
    if len(raw) != size:
        raise PayloadError(f"the weights frame holds {len(raw)} bytes; the DHF records need {size} bytes")
    return raw


def _read_metadata(bodies: dict[int, bytes]) -> Metadata:
    errors: tuple[float | None, float | None, float | None] = (None, None, None)
    if c.KIND_ERRORS in bodies:
        body = bodies[c.KIND_ERRORS]
        if len(body) != 6:
            raise FieldError(f"metadata: the errors have {len(body)} bytes; they have 6")
        mean, p99, top = bits = struct.unpack("<3H", body)
        if max(bits) >= INFINITY:
            raise FieldError("metadata: an error is negative or not finite")
        errors = (from_bits(mean), from_bits(p99), from_bits(top))
    return Metadata(_text(bodies.get(c.KIND_ENCODER)), *errors, _text(bodies.get(c.KIND_SOURCE)))


def _text(value: bytes | None) -> str | None:
    if value is None:
        return None
    if len(value) > c.MAX_TEXT:
        raise FieldError(f"metadata: a text has {len(value)} bytes; {c.MAX_TEXT} are allowed")
    try:
        return value.decode("utf-8")
    except UnicodeDecodeError as exc:
        raise FieldError("metadata: a text is not UTF-8") from exc
