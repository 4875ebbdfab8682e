"""Container -> bytes. Deterministic: equal containers give equal bytes."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import zstandard

from ..errors import OptionError
from . import constants as c
from . import rans
from .bfloat16 import bits_above
from .container import Container, DhfRecord, Metadata, Symbols, tensor_shapes
from .reader import loads
from .surface.section import encode_surface

ZSTD_LEVEL = 22


def dumps(container: Container, body: bytes | None = None) -> bytes:
    """Bytes of a `.cndhf` file. body: of the surface's section, where it has been encoded already.

    Raises as `written` does.
    """
    return written(container, body)[0]


def written(container: Container, body: bytes | None = None) -> tuple[bytes, Container]:
    """Bytes of a `.cndhf` file, and what a reader reads from them.

    Raises OptionError when the container holds what the format cannot express or a reader would refuse, so that no
    unreadable file is ever written.
    """
    if container.surface is None:
        shape = section(container.codec, _height_fields(container))
    else:
        shape = section(c.KIND_SURFACE, encode_surface(container.surface) if body is None else body)
    data = _head(container.centre, container.scale) + shape + pack_metadata(container.metadata)
    data += struct.pack("<I", zlib.crc32(data))
    try:
        return data, loads(data)
    except Exception as exc:
        raise OptionError(f"the container does not fit the format: {exc}") from exc


def other_bytes(centre: tuple[float, float, float], metadata: Metadata, size: int | None) -> int:
    """Bytes of a file of `size` bytes besides the body of its shape; of one of up to 2 MiB where that is unknown."""
    head = 1 + len(varint(c.MAX_FILE_SIZE // 8 - 1 if size is None else size))
    return len(_head(centre, 1.0)) + head + len(pack_metadata(metadata)) + c.CRC_SIZE


def _head(centre: tuple[float, float, float], scale: float) -> bytes:
    """Signature, version, flags, centre and scale."""
    try:
        single = struct.pack("<3f", *centre)
        far = struct.unpack("<3f", single) != tuple(centre)
    except OverflowError:
        far = True
    try:
        return (
            c.SIGNATURE
            + bytes([c.VERSION, c.FAR_CENTRE if far else 0])
            + (struct.pack("<3d", *centre) if far else single)
            + struct.pack("<f", scale)
        )
    except (struct.error, OverflowError) as exc:
        raise OptionError(f"the container does not fit the format: {exc}") from exc


def section(kind: int, body: bytes) -> bytes:
    """A section: its kind, its length, its body."""
    return bytes([kind]) + varint(len(body)) + body


def varint(value: int) -> bytes:
    """An unsigned integer in groups of seven bits, the lowest first (LEB128).

    >>> varint(300).hex()
    'ac02'
    """
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _height_fields(container: Container) -> bytes:
    """The body of a section of double height fields."""
    zstd = container.codec == c.CODEC_ZSTD
    if not zstd and container.codec != c.CODEC_RANS:
        raise OptionError(f"the weights codec is {container.codec}; there are {c.CODEC_ZSTD} and {c.CODEC_RANS}")
    if len(container.dhfs) > c.MAX_DHFS:
        raise OptionError(f"there are {len(container.dhfs)} DHFs; {c.MAX_DHFS} are allowed")
    records = b"".join(_record(d, mark_wide=zstd) for d in container.dhfs)
    if zstd:
        weights = _compress(pack_symbols(container.dhfs))
    else:
        weights = rans.encode([s for d in container.dhfs for s in d.symbols])
    return bytes([len(container.dhfs)]) + records + weights


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
            "<B4h6h4B",
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
    """The sections of metadata; empty when there is nothing to say. Raises OptionError."""
    out = b""
    errors = [e for e in (meta.mean_error, meta.p99_error, meta.max_error) if e is not None]
    if errors:
        if len(errors) < 3:
            raise OptionError("metadata: give the mean, p99 and maximum error together or none of them")
        out += section(c.KIND_ERRORS, struct.pack("<3H", *map(bits_above, errors)))
    for kind, text in ((c.KIND_ENCODER, meta.encoder), (c.KIND_SOURCE, meta.source)):
        if text is not None:
            out += section(kind, _utf8(text))
    return out


def _utf8(text: str) -> bytes:
    try:
        out = text.encode()
    except UnicodeEncodeError as exc:
        raise OptionError(f"metadata: a text cannot be written as UTF-8: {exc}") from exc
    if len(out) > c.MAX_TEXT:
        raise OptionError(f"metadata: a text of {len(out)} bytes does not fit; {c.MAX_TEXT} is the most")
    return out
