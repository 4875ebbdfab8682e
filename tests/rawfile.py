"""Build raw `.cndhf` bytes from parts, with every number written out: independent of the package's own writer."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import numpy as np
import zstandard

RECORDS, WEIGHTS, SURFACE, METADATA = 0x01, 0x02, 0x03, 0x81
RAW, ZSTD, RANS, RANGE = 0, 1, 2, 3
BOX = (-16384, 16384, -16384, 16384, -16384, 16384)
SIZE = 18  # parameters of the smallest record below: width 2, one hidden layer

Section = tuple[int, int, bytes]  # kind, codec, body


def record(
    role: int = 0,
    fold: int = 0,
    quaternion: Sequence[int] = (0, 0, 0, 32767),
    box: Sequence[int] = BOX,
    width: int = 2,
    hidden: int = 1,
    omegas: Sequence[int] = (30, 30),
    codes: bytes | None = None,
) -> bytes:
    head = struct.pack("<2B4h6h4B", role, fold, *quaternion, *box, width, hidden, *omegas)
    return head + (bytes([20] * 2 * (hidden + 2)) if codes is None else codes)


def frame(raw: bytes, content_size: bool = True, checksum: bool = False) -> bytes:
    """A zstd frame without its magic number, as the file holds it."""
    return zstandard.ZstdCompressor(write_content_size=content_size, write_checksum=checksum).compress(raw)[4:]


def entry(tag: int, value: bytes) -> bytes:
    return struct.pack("<BB", tag, len(value)) + value


def sections(
    records: bytes | None = None, weights: bytes | None = None, metadata: bytes | None = None
) -> list[Section]:
    out = [
        (RECORDS, RAW, record() if records is None else records),
        (WEIGHTS, ZSTD, frame(bytes(range(SIZE))) if weights is None else weights),
    ]
    return out if metadata is None else [*out, (METADATA, RAW, metadata)]


def build(
    parts: Sequence[Section] | None = None,
    *,
    version: tuple[int, int] = (0, 1),
    n_sections: int | None = None,
    n_dhfs: int = 1,
    centre: Sequence[float] = (0.0, 0.0, 0.0),
    scale: float = 1.0,
) -> bytes:
    """A file with a correct checksum, whatever is wrong with the rest of it."""
    parts = sections() if parts is None else parts
    n = len(parts) if n_sections is None else n_sections
    data = b"\x89DHF\r\n\x1a\n" + struct.pack("<4B3df", *version, n, n_dhfs, *centre, scale)
    data += b"".join(struct.pack("<BBI", kind, codec, len(body)) for kind, codec, body in parts)
    data += b"".join(body for _, _, body in parts)
    return data + struct.pack("<I", zlib.crc32(data))


def build_surface(parts: Sequence[Section], n_dhfs: int = 0) -> bytes:
    """A file of the version that knows surfaces."""
    return build(parts, version=(0, 2), n_dhfs=n_dhfs)


def noise(n_dhfs: int = 1, width: int = 8, hidden: int = 2) -> bytes:
    """A valid file that costs as much as it can: the widest boxes, and heights that jump from node to node."""
    rng = np.random.default_rng(0)
    matrices = [2 * width, *[width * width] * hidden, 2 * width]
    biases = [width] * (hidden + 1) + [2]
    low = b""
    for _ in range(n_dhfs):
        for matrix, bias in zip(matrices, biases, strict=True):
            low += rng.integers(0, 40, matrix).astype(np.uint8).tobytes()
            # The last bias puts near below far: symbols -127 and 126 of 2^-6.
            low += b"\xfd\xfc" if bias == 2 else rng.integers(0, 40, bias).astype(np.uint8).tobytes()
    codes = bytes([20] * (2 * hidden + 3) + [24])
    body = record(box=(-32768, 32767) * 3, width=width, hidden=hidden, omegas=(255, 30), codes=codes)
    return build(sections(body * n_dhfs, frame(low)), n_dhfs=n_dhfs)
