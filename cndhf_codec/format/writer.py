"""Container -> bytes. Deterministic: equal containers give equal bytes."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import zstandard

from ..errors import OptionError
from . import constants as c
from . import rans
from .container import Container, DhfRecord, Metadata, Symbols, tensor_shapes
from .reader import loads
from .surface.section import encode_surface

ZSTD_LEVEL = 22


def dumps(container: Container) -> bytes:
    """Bytes of a `.cndhf` file.

    Raises OptionError when the container holds what the format cannot express or a reader would refuse, so that no
    unreadable file is ever written.
    """
    if container.surface is None:
        sections, minor = _dhf_sections(container), c.MINOR_DHF
    else:
        sections = [(c.KIND_SURFACE, c.CODEC_RANGE, encode_surface(container.surface))]
        minor = c.MINOR
    metadata = pack_metadata(container.metadata)
    if metadata:
        sections.append((c.KIND_METADATA, c.CODEC_RAW, metadata))
    try:
        head = c.SIGNATURE + struct.pack(
            "<4B3df", c.MAJOR, minor, len(sections), len(container.dhfs), *container.centre, container.scale
        )
    except (struct.error, OverflowError) as exc:
        raise OptionError(f"the container does not fit the format: {exc}") from exc
    table = b"".join(struct.pack("<BBI", kind, codec, len(body)) for kind, codec, body in sections)
    data = head + table + b"".join(body for _, _, body in sections)
    data += struct.pack("<I", zlib.crc32(data))
    try:
        loads(data)
    except Exception as exc:
        raise OptionError(f"the container does not fit the format: {exc}") from exc
    return data


def _dhf_sections(container: Container) -> list[tuple[int, int, bytes]]:
    """Kind, codec and body of the sections of double height fields."""
    zstd = container.codec == c.CODEC_ZSTD
    if not zstd and container.codec != c.CODEC_RANS:
        raise OptionError(f"the weights codec is {container.codec}; there are {c.CODEC_ZSTD} and {c.CODEC_RANS}")
    records = b"".join(_record(d, mark_wide=zstd) for d in container.dhfs)
    if zstd:
        weights = _compress(pack_symbols(container.dhfs))
    else:
        weights = rans.encode([s for d in container.dhfs for s in d.symbols])
    return [(c.KIND_RECORDS, c.CODEC_RAW, records), (c.KIND_WEIGHTS, container.codec, weights)]


def is_wide(symbols: Symbols) -> bool:
    """Whether a tensor's symbols need two bytes each."""
    return symbols.size > 0 and int(zigzag(symbols).max()) > 0xFF


def zigzag(symbols: Symbols) -> np.ndarray:
    """Signed to unsigned, small magnitudes first: 0, -1, 1, -2, ... -> 0, 1, 2, 3, ..."""
    s = symbols.astype(np.int64)
    return np.where(s < 0, -2 * s - 1, 2 * s)


def pack_symbols(dhfs: tuple[DhfRecord, ...]) -> bytes:
    """One byte per symbol: the low bytes of every tensor, then the high bytes of the wide ones."""
    low, high = [], []
    for dhf in dhfs:
        for symbols in dhf.symbols:
            u = zigzag(symbols).ravel()
            if u.size and u.max() > 0xFFFF:
                raise OptionError(f"a symbol is larger than {c.MAX_SYMBOL}; use a coarser step")
            low.append((u & 0xFF).astype(np.uint8))
            if is_wide(symbols):
                high.append((u >> 8).astype(np.uint8))
    return b"".join(plane.tobytes() for plane in low + high)


def _record(dhf: DhfRecord, mark_wide: bool) -> bytes:
    # Checked here because the reader could not tell: it would read another container than this one.
    if not all(0 <= code <= c.STEP_CODE_MASK for code in dhf.step_codes):
        raise OptionError(f"a step code is outside 0 to {c.STEP_CODE_MASK}")
    shapes = tensor_shapes(dhf.width, dhf.hidden_layers)
    if [s.shape for s in dhf.symbols] != shapes or len(dhf.step_codes) != len(shapes):
        raise OptionError(f"a DHF needs symbols of shapes {shapes} and a step code for each")
    codes = bytes(
        code | (c.STEP_WIDE if mark_wide and is_wide(s) else 0)
        for code, s in zip(dhf.step_codes, dhf.symbols, strict=True)
    )
    try:
        head = struct.pack(
            "<2B4h6h4B",
            dhf.role,
            dhf.fold,
            *dhf.quaternion,
            *dhf.box,
            dhf.width,
            dhf.hidden_layers,
            dhf.omega_first,
            dhf.omega_hidden,
        )
    except struct.error as exc:
        raise OptionError(f"a DHF does not fit the format: {exc}") from exc
    return head + codes


def _compress(raw: bytes) -> bytes:
    params = zstandard.ZstdCompressionParameters.from_level(
        ZSTD_LEVEL, source_size=len(raw), write_content_size=True, write_checksum=False, write_dict_id=False
    )
    frame = zstandard.ZstdCompressor(compression_params=params).compress(raw)
    return frame.removeprefix(c.ZSTD_MAGIC)


def pack_metadata(meta: Metadata) -> bytes:
    """Body of the metadata section; empty when there is nothing to say."""
    out = b""
    if meta.encoder is not None:
        out += _tlv(c.TAG_ENCODER, _utf8(meta.encoder))
    errors = (meta.mean_error, meta.p99_error, meta.max_error)
    if any(e is not None for e in errors):
        if any(e is None for e in errors):
            raise OptionError("metadata: give the mean, p99 and maximum error together or none of them")
        try:
            out += _tlv(c.TAG_ERROR, struct.pack("<3f", *errors))
        except OverflowError as exc:
            raise OptionError(f"metadata: an error does not fit the format: {exc}") from exc
    if meta.source is not None:
        out += _tlv(c.TAG_SOURCE, _utf8(meta.source))
    return out


def _utf8(text: str) -> bytes:
    try:
        return text.encode()
    except UnicodeEncodeError as exc:
        raise OptionError(f"metadata: a text cannot be written as UTF-8: {exc}") from exc


def _tlv(tag: int, value: bytes) -> bytes:
    if len(value) > 255:
        raise OptionError(f"metadata: a value of {len(value)} bytes does not fit; 255 is the most")
    return struct.pack("<BB", tag, len(value)) + value
