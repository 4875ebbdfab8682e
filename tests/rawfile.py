"""Build raw `.cndhf` bytes from parts, with every number written out: independent of the package's own writer."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import zstandard

ZSTD, RANS, SURFACE = 0x01, 0x02, 0x03  # kinds of sections
ENCODER, ERRORS, SOURCE = 0x81, 0x82, 0x83
BOX = (-16384, 16384, -16384, 16384, -16384, 16384)
SIZE = 18  # parameters of the smallest record below: width 2, one hidden layer

Section = tuple[int, bytes]  # kind, body


def record(
    fold: int = 0,
    quaternion: Sequence[int] = (0, 0, 0, 32767),
    box: Sequence[int] = BOX,
    width: int = 2,
    hidden: int = 1,
    omegas: Sequence[int] = (30, 30),
    codes: bytes | None = None,
) -> bytes:
    head = struct.pack("<B4h6h4B", fold, *quaternion, *box, width, hidden, *omegas)
    return head + (bytes([20] * 2 * (hidden + 2)) if codes is None else codes)


def frame(raw: bytes, content_size: bool = True, checksum: bool = False) -> bytes:
    """A zstd frame without its magic number, as the file holds it."""
    return zstandard.ZstdCompressor(write_content_size=content_size, write_checksum=checksum).compress(raw)[4:]


def fields(
    records: bytes | None = None, weights: bytes | None = None, kind: int = ZSTD, n_dhfs: int | None = 1
) -> Section:
    """A section of double height fields; without their number when `n_dhfs` is None."""
    count = b"" if n_dhfs is None else bytes([n_dhfs])
    records = record() if records is None else records
    return kind, count + records + (frame(bytes(range(SIZE))) if weights is None else weights)


def length(value: int) -> bytes:
    """A length as a section has it."""
    groups = [value & 0x7F]
    while value := value >> 7:
        groups.append(value & 0x7F)
    return bytes([g | 0x80 for g in groups[:-1]] + groups[-1:])


def head(version: int = 1, flags: int = 0, centre: Sequence[float] = (0.0, 0.0, 0.0), scale: float = 1.0) -> bytes:
    layout = "<3df" if flags & 1 else "<4f"
    return b"\x89DHF" + bytes([version, flags]) + struct.pack(layout, *centre, scale)


def seal(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


def build(parts: Sequence[Section] | None = None, **changes: Any) -> bytes:
    """A file with a correct checksum, whatever is wrong with the rest of it. changes: of `head`."""
    parts = [fields()] if parts is None else parts
    return seal(head(**changes) + b"".join(bytes([kind]) + length(len(body)) + body for kind, body in parts))


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
    return build([fields(body * n_dhfs, frame(low), n_dhfs=n_dhfs)])
