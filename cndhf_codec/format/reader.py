"""Bytes -> Container. Every count is checked before anything of its size is allocated."""

from __future__ import annotations

import math
import struct
import zlib
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
    TrailingDataError,
    TruncatedError,
    VersionError,
)
from . import constants as c
from . import rans
from .container import Container, DhfRecord, Metadata, Symbols, tensor_shapes
from .surface.section import check_quaternion, decode_surface


@dataclass(frozen=True)
class Section:
    """One row of the section table, with the place of its bytes in the file."""

    kind: int
    codec: int
    offset: int
    length: int


@dataclass(frozen=True)
class Header:
    """What can be read without decompressing anything."""

    version: tuple[int, int]
    n_dhfs: int
    centre: tuple[float, float, float]
    scale: float
    sections: tuple[Section, ...]


def loads(data: bytes) -> Container:
    """Read and check a whole file. Raises a subclass of FormatError that says what is wrong."""
    header = read_header(data)
    surface = _surface_section(header)
    if surface is not None:
        meta = _sole(header, c.KIND_METADATA, (c.CODEC_RAW,), "metadata", optional=True)
        metadata = Metadata() if meta is None else _read_metadata(_body(data, meta))
        mesh = decode_surface(_body(data, surface))
        return Container(header.centre, header.scale, metadata=metadata, surface=mesh)
    records, weights, meta = _sections(header)
    drafts = _read_records(_body(data, records), header.n_dhfs)
    read = _read_zstd if weights.codec == c.CODEC_ZSTD else _read_rans
    dhfs = _records(drafts, read(_body(data, weights), drafts))
    metadata = Metadata() if meta is None else _read_metadata(_body(data, meta))
    return Container(header.centre, header.scale, dhfs, metadata, weights.codec)


def loads_prefix(data: bytes, n_dhfs: int | None = None) -> Container:
    """Read the first `n_dhfs` DHFs, or as many as are complete, from the first bytes of a file.

    The records must be complete, and must come before the weights, as the writer puts them. The weights must have codec
    2: those of codec 1 can only be read as a whole. All fields of what is used are checked. The checksum, which comes
    last, is not, so damage may go unseen. Metadata is left out, because its errors are those of the whole solid.
    Raises a subclass of FormatError: TruncatedError when the bytes do not hold one DHF, or not `n_dhfs`.
    """
    header = _read_head(data)
    _check_head(header)
    if _surface_section(header) is not None:
        raise SectionError("the file holds a surface, which can only be read as a whole")
    records, weights, _ = _sections(header)
    if weights.codec != c.CODEC_RANS:
        raise SectionError(f"the weights section has codec {weights.codec}; only codec 2 can be read from its start on")
    if weights.offset < records.offset:
        raise SectionError("the weights section comes before the records, so that it cannot be read from its start on")
    if len(data) < records.offset + records.length:
        raise TruncatedError(f"the file ends after {len(data)} bytes, before or inside its records")
    drafts = _read_records(_body(data, records), header.n_dhfs)
    wanted = len(drafts) if n_dhfs is None else n_dhfs
    if not 1 <= wanted <= len(drafts):
        raise OptionError(f"there are no {wanted} DHFs; the file has {len(drafts)}")
    ends = np.cumsum([len(d.sizes()) for d in drafts[:wanted]])
    tensors = rans.decode_prefix(_body(data, weights), _rans_sizes(drafts), int(ends[-1]))
    count = int(np.count_nonzero(ends <= len(tensors)))
    if count == 0 or (n_dhfs is not None and count < wanted):
        raise TruncatedError(f"the file ends after {len(data)} bytes, before DHF {count} is complete")
    return Container(header.centre, header.scale, _records(drafts[:count], tensors), Metadata(), weights.codec)


def read_header(data: bytes) -> Header:
    """Read and check signature, version, checksum, counts, normalisation and section table."""
    header = _read_head(data)
    last = header.sections[-1]
    offset = last.offset + last.length
    if len(data) < offset + c.CRC_SIZE:
        raise TruncatedError(f"the file has {len(data)} bytes; its header announces {offset + c.CRC_SIZE}")
    if len(data) > offset + c.CRC_SIZE:
        raise TrailingDataError(f"the file has {len(data)} bytes; its header announces {offset + c.CRC_SIZE}")
    (crc,) = struct.unpack_from("<I", data, offset)
    if zlib.crc32(memoryview(data)[:offset]) != crc:
        raise ChecksumError("the checksum does not match: the file was damaged after it was written")
    _check_head(header)
    return header


def _read_head(data: bytes) -> Header:
    """Read the header and the section table, before the checksum is checked."""
    _check_signature(data)
    if len(data) < c.HEADER_SIZE + c.CRC_SIZE:
        raise TruncatedError(f"the file ends after {len(data)} bytes, inside the header")
    major, minor, n_sections, n_dhfs, cx, cy, cz, scale = struct.unpack_from("<4B3df", data, 8)
    if major != c.MAJOR:
        raise VersionError(
            f"the file has format version {major}.{minor}; this decoder reads {c.MAJOR}.x: "
            "use the release that wrote it, or a newer one"
        )
    if minor not in (c.MINOR_DHF, c.MINOR):
        raise VersionError(
            f"the file has the experimental format version {major}.{minor}; this decoder reads only "
            f"{c.MAJOR}.{c.MINOR_DHF} and {c.MAJOR}.{c.MINOR}: encode the mesh again"
        )
    if len(data) > c.MAX_FILE_SIZE:
        raise LimitError(f"the file has {len(data)} bytes; the format allows {c.MAX_FILE_SIZE}")
    if not 1 <= n_sections <= c.MAX_SECTIONS:
        raise LimitError(f"field n_sections is {n_sections}; 1 to {c.MAX_SECTIONS} are allowed")
    table_end = c.HEADER_SIZE + n_sections * c.TABLE_ENTRY_SIZE
    if len(data) < table_end + c.CRC_SIZE:
        raise TruncatedError(f"the file ends after {len(data)} bytes, inside the section table")
    sections, offset = [], table_end
    for i in range(n_sections):
        kind, codec, length = struct.unpack_from("<BBI", data, c.HEADER_SIZE + i * c.TABLE_ENTRY_SIZE)
        sections.append(Section(kind, codec, offset, length))
        offset += length
    return Header((major, minor), n_dhfs, (cx, cy, cz), scale, tuple(sections))


def _check_head(header: Header) -> None:
    least = 0 if header.version[1] >= c.MINOR and any(s.kind == c.KIND_SURFACE for s in header.sections) else 1
    if not least <= header.n_dhfs <= c.MAX_DHFS:
        raise LimitError(f"field n_dhfs is {header.n_dhfs}; {least} to {c.MAX_DHFS} are allowed")
    if not all(abs(x) <= c.MAX_CENTRE for x in header.centre):  # false for NaN too
        cx, cy, cz = header.centre
        raise FieldError(
            f"field centre is {cx}, {cy}, {cz}; it must be finite and within {c.MAX_CENTRE:g} of the origin"
        )
    if not c.MIN_SCALE <= header.scale <= c.MAX_SCALE:
        raise FieldError(f"field scale is {header.scale}; {c.MIN_SCALE:g} to {c.MAX_SCALE:g} are allowed")


def _surface_section(header: Header) -> Section | None:
    """The section of a file that holds a surface, or None for one of double height fields. Raises SectionError."""
    surface = None
    if header.version[1] >= c.MINOR:
        surface = _sole(header, c.KIND_SURFACE, (c.CODEC_RANGE,), "surface", optional=True)
    if surface is None:
        return None
    for section in header.sections:
        if section.kind in (c.KIND_RECORDS, c.KIND_WEIGHTS):
            raise SectionError("the file holds a surface and double height fields; a file holds one of them")
        if section.kind not in (c.KIND_SURFACE, c.KIND_METADATA) and not section.kind & c.OPTIONAL:
            raise SectionError(f"section kind {section.kind} is mandatory and unknown to this decoder")
    if header.n_dhfs != 0:
        raise FieldError(f"field n_dhfs is {header.n_dhfs}; a file that holds a surface has 0")
    return surface


def _sections(header: Header) -> tuple[Section, Section, Section | None]:
    """The sections with records, weights and metadata. Raises SectionError."""
    for section in header.sections:
        known = section.kind in (c.KIND_RECORDS, c.KIND_WEIGHTS, c.KIND_METADATA)
        if not known and not section.kind & c.OPTIONAL:
            raise SectionError(f"section kind {section.kind} is mandatory and unknown to this decoder")
    records = _sole(header, c.KIND_RECORDS, (c.CODEC_RAW,), "records")
    weights = _sole(header, c.KIND_WEIGHTS, (c.CODEC_ZSTD, c.CODEC_RANS), "weights")
    assert records is not None
    assert weights is not None
    return records, weights, _sole(header, c.KIND_METADATA, (c.CODEC_RAW,), "metadata", optional=True)


@dataclass(frozen=True)
class _Draft:
    role: int
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
    """Bytes of each section of a valid file; their sum is the file's size. Raises FormatError.

    "layout" is the header, the section table and the checksum; "other" is the sections that this decoder skips.
    """
    names = {
        c.KIND_RECORDS: "records",
        c.KIND_WEIGHTS: "weights",
        c.KIND_SURFACE: "surface",
        c.KIND_METADATA: "metadata",
    }
    sections = read_header(data).sections
    out = {"layout": len(data) - sum(s.length for s in sections)}
    for section in sections:
        name = names.get(section.kind, "other")
        out[name] = out.get(name, 0) + section.length
    return out


def _check_signature(data: bytes) -> None:
    if data[:8] == c.SIGNATURE:
        return
    if c.SIGNATURE.startswith(data):
        raise TruncatedError(f"the file ends after {len(data)} bytes, inside the signature")
    if data[1:4] == c.SIGNATURE[1:4]:
        raise TextModeError("the signature is damaged as by a text-mode transfer; copy the file as binary")
    raise SignatureError("this is not a .cndhf file (wrong signature)")


def _sole(header: Header, kind: int, codecs: tuple[int, ...], name: str, optional: bool = False) -> Section | None:
    found = [s for s in header.sections if s.kind == kind]
    if len(found) > 1:
        raise SectionError(f"the {name} section appears {len(found)} times; once is allowed")
    if not found:
        if optional:
            return None
        raise SectionError(f"the {name} section is missing")
    if found[0].codec not in codecs:
        raise SectionError(f"the {name} section has codec {found[0].codec}; this decoder reads {list(codecs)}")
    return found[0]


def _body(data: bytes, section: Section) -> bytes:
    return data[section.offset : section.offset + section.length]


def _read_records(body: bytes, n_dhfs: int) -> list[_Draft]:
    drafts, at = [], 0
    for i in range(n_dhfs):
        if len(body) < at + c.RECORD_HEAD_SIZE:
            raise SectionError(f"the records section ends inside DHF {i}")
        f = struct.unpack_from("<2B4h6h4B", body, at)
        at += c.RECORD_HEAD_SIZE
        width, hidden = f[12], f[13]
        if not 1 <= width <= c.MAX_WIDTH:
            raise LimitError(f"DHF {i}: field width is {width}; 1 to {c.MAX_WIDTH} are allowed")
        if not 1 <= hidden <= c.MAX_HIDDEN_LAYERS:
            raise LimitError(f"DHF {i}: field hidden_layers is {hidden}; 1 to {c.MAX_HIDDEN_LAYERS} are allowed")
        n_codes = 2 * (hidden + 2)
        if len(body) < at + n_codes:
            raise SectionError(f"the records section ends inside DHF {i}")
        draft = _Draft(f[0], f[1], f[2:6], f[6:12], width, hidden, f[14], f[15], body[at : at + n_codes])
        at += n_codes
        _check_draft(draft, i)
        drafts.append(draft)
    if at != len(body):
        raise SectionError(f"the records section has {len(body) - at} bytes after its last DHF")
    total = sum(sum(d.sizes()) for d in drafts)
    if total > c.MAX_PARAMETERS:
        raise LimitError(f"the networks have {total} parameters; {c.MAX_PARAMETERS} are allowed")
    return drafts


def _check_draft(d: _Draft, i: int) -> None:
    if d.role != c.ROLE_INTERSECT:
        raise FieldError(f"DHF {i}: field role is {d.role}; this version of the format defines only 0")
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
            role=d.role,
            fold=d.fold,
        )
        for d in drafts
    )


def _rans_sizes(drafts: list[_Draft]) -> list[int]:
    if any(code & c.STEP_WIDE for d in drafts for code in d.codes):
        raise FieldError("a step byte has bit 7 set, which codec 2 of the weights section does not use")
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
    frame = c.ZSTD_MAGIC + body
    try:
        declared = zstandard.get_frame_parameters(frame).content_size
    except zstandard.ZstdError as exc:
        raise PayloadError(f"the weights section is not a zstd frame ({exc})") from exc
    if declared != size:
        said = "no size" if declared == zstandard.CONTENTSIZE_UNKNOWN else f"{declared} bytes"
        raise PayloadError(f"the weights frame declares {said}; the DHF records need {size} bytes")
    try:
        # In one call, into a buffer of the declared size. Where a frame's blocks hold more than its header says, this
        # stops; a stream could go on for gigabytes.
        raw = zstandard.ZstdDecompressor().decompress(frame, allow_extra_data=False)
    except zstandard.ZstdError as exc:
        raise PayloadError(f"the weights section does not decompress ({exc})") from exc
    if len(raw) != size:
        raise PayloadError(f"the weights frame holds {len(raw)} bytes; the DHF records need {size} bytes")
    return raw


def _read_metadata(body: bytes) -> Metadata:
    values: dict[int, bytes] = {}
    at = 0
    while at < len(body):
        if at + 2 > len(body) or at + 2 + body[at + 1] > len(body):
            raise SectionError("the metadata section ends inside an entry")
        tag, length = body[at], body[at + 1]
        if tag in values:
            raise SectionError(f"the metadata section has tag {tag} twice")
        values[tag] = body[at + 2 : at + 2 + length]
        at += 2 + length
    errors: tuple[float | None, float | None, float | None] = (None, None, None)
    if c.TAG_ERROR in values:
        if len(values[c.TAG_ERROR]) != 12:
            raise FieldError("metadata: the error entry does not have 12 bytes")
        mean, p99, top = struct.unpack("<3f", values[c.TAG_ERROR])
        if not all(math.isfinite(e) and e >= 0 for e in (mean, p99, top)):
            raise FieldError("metadata: an error is negative or not finite")
        errors = (mean, p99, top)
    return Metadata(_text(values.get(c.TAG_ENCODER)), *errors, _text(values.get(c.TAG_SOURCE)))


def _text(value: bytes | None) -> str | None:
    if value is None:
        return None
    try:
        return value.decode("utf-8")
    except UnicodeDecodeError as exc:
        raise FieldError("metadata: a text is not UTF-8") from exc
