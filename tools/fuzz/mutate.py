"""Damage that gets past the checksum: mutations of `.cndhf` bytes that know the layout of the container.

Blind mutation of bytes hardly ever changes anything but the error: the CRC-32 refuses it. Here the parts of a file are
taken apart, some are changed, and lengths and checksum are made to fit again (most of the time).
"""

from __future__ import annotations

import math
import random
import struct
import zlib
from collections.abc import Callable, Sequence

import numpy as np
import zstandard

from cndhf_codec.format import rans
from cndhf_codec.format.container import tensor_shapes

Bytes = Callable[[bytes, int], bytes]  # (data, most bytes) -> other data: the fuzzer's own mutation
BYTES = (0, 1, 2, 3, 7, 8, 9, 16, 30, 59, 60, 63, 64, 65, 127, 128, 129, 254, 255)
SHORTS = (0, 1, -1, 2, 16384, -16384, 23170, 31999, 32000, 32767, -32767, -32768)
LENGTHS = (0, 1, 2, 25, 26, 27, 255, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-310, 2.0**-149, 1e30, 3.4e38, 1e308, math.inf, -math.inf, math.nan)
RECORD = struct.Struct("<2B4h6h4B")


class Parts:
    """A file's header fields and sections; `dumps` puts them together whatever they are."""

    def __init__(self, data: bytes) -> None:
        data = data + bytes(max(0, 44 - len(data)))
        self.signature = data[:8]
        self.head = bytearray(data[8:40])  # major, minor, n_sections, n_dhfs, centre, scale
        self.sections: list[list] = []
        n = min(self.head[2], 20)
        at = 40 + 6 * n
        for row in range(40, 40 + 6 * n, 6):
            if row + 6 <= len(data):
                kind, codec, length = struct.unpack_from("<BBI", data, row)
                self.sections.append([kind, codec, data[at : min(at + length, len(data) - 4)]])
                at += length

    def section(self, kind: int) -> list | None:
        return next((s for s in self.sections if s[0] == kind), None)

    def dumps(self) -> bytes:
        self.head[2] = min(len(self.sections), 255)
        table = b"".join(struct.pack("<BBI", kind, codec, len(body)) for kind, codec, body in self.sections)
        return seal(self.signature + bytes(self.head) + table + b"".join(body for _, _, body in self.sections))


def seal(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


def mutate(data: bytes, most: int, seed: int, blind: Bytes, others: Sequence[bytes]) -> bytes:
    """Another file, of at most `most` bytes. `others`: valid files to take parts from."""
    rng = random.Random(seed)
    chance = rng.random()
    if chance < 0.02:
        return blind(data, most)
    if chance < 0.10:
        return seal(blind(data[:-4], most - 4))
    if chance < 0.15:
        data = others[rng.randrange(len(others))]
    parts = Parts(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        rng.choice(MUTATIONS)(parts, rng, blind, others)
    out = parts.dumps()
    if rng.random() < 0.05 and parts.sections:  # a length that does not fit
        row = 42 + 6 * rng.randrange(len(parts.sections))
        out = seal(out[:row] + struct.pack("<I", rng.choice(LENGTHS)) + out[row + 4 : -4])
    return out if len(out) <= most else data[:most]


def header(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    field = rng.randrange(6)
    if field == 0:
        parts.head[rng.choice((0, 1))] = rng.choice(BYTES)
    elif field == 1:
        parts.head[3] = rng.choice(BYTES)
    elif field < 5:
        struct.pack_into("<d", parts.head, 4 + 8 * (field - 2), rng.choice(FLOATS))
    else:
        struct.pack_into("<f", parts.head, 28, rng.choice(FLOATS[:8] + FLOATS[9:]))


def table(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    what = rng.randrange(6)
    if what == 0 or not parts.sections:
        body = blind(b"hello", 64)
        kind = rng.choice((0, 1, 2, 3, 0x7F, 0x80, 0x81, 0xFE, 0xFF))
        parts.sections.insert(rng.randint(0, len(parts.sections)), [kind, rng.choice(BYTES), body])
        return
    section = rng.choice(parts.sections)
    if what == 1:
        parts.sections.remove(section)
    elif what == 2:
        parts.sections.append(list(section))
    elif what == 3:
        rng.shuffle(parts.sections)
    elif what == 4:
        section[1] = rng.choice(BYTES)
    else:
        section[0] = rng.choice(BYTES)


def section_bytes(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    if parts.sections:
        section = rng.choice(parts.sections)
        section[2] = blind(section[2], 4096)


def exchange(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Take a whole section of another file."""
    theirs = Parts(others[rng.randrange(len(others))])
    if theirs.sections and parts.sections:
        parts.sections[rng.randrange(len(parts.sections))] = rng.choice(theirs.sections)


def record_field(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    section = parts.section(1)
    if section is None or len(section[2]) < 26:
        return
    starts = _records(section[2])
    at = rng.choice(starts)
    body = bytearray(section[2])
    fields = list(RECORD.unpack_from(body, at))
    k = rng.randrange(len(fields))
    fields[k] = rng.choice(SHORTS if 2 <= k < 12 else BYTES)
    RECORD.pack_into(body, at, *fields)
    if rng.random() < 0.3:
        body[rng.randrange(len(body))] = rng.choice(BYTES)
    section[2] = bytes(body)
    if rng.random() < 0.5:
        fitting_weights(parts, rng, blind, others)


def fresh_records(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Records of networks of other sizes, with weights to match."""
    section = parts.section(1)
    if section is None:
        return
    n = rng.choice((1, 1, 1, 2, 2, 3, 3, 64))
    body = b""
    for _ in range(n):
        width, hidden = rng.choice((1, 2, 3, 5, 8) if n > 3 else (1, 2, 8, 16, 127, 128)), rng.choice((1, 1, 2, 7, 8))
        box = [v for _ in range(3) for v in sorted(rng.sample(range(-32768, 32768), 2))]
        turn = rng.choice(((0, 0, 0, 32767), (32767, 0, 0, 0), (16384, 16384, -16384, 16384)))
        codes = bytes(rng.choice((0, 1, 20, 40, 127, 128 + 20)) for _ in range(2 * (hidden + 2)))
        body += (
            RECORD.pack(0, rng.randrange(4), *turn, *box, width, hidden, rng.choice(BYTES[1:]), rng.choice(BYTES[1:]))
            + codes
        )
    section[2] = body
    parts.head[3] = n
    fitting_weights(parts, rng, blind, others)


def fitting_weights(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """A weights section of exactly the symbols that the records call for."""
    records, weights = parts.section(1), parts.section(2)
    if records is None or weights is None:
        return
    sizes, wide = _tensors(records[2], parts.head[3])
    total = sum(sizes)
    if 0 in sizes or not 0 < total <= 2**20 or (total > 5000 and rng.random() < 0.8):  # large ones take long
        return
    values = np.random.default_rng(rng.randrange(2**32))
    if rng.random() < 0.06 and total < 2000:  # coding takes long
        limit = rng.choice((0, 1, 3, 20, 1000, 32767))
        tensors = [values.integers(-limit, limit, n, endpoint=True).astype(np.int32) for n in sizes]
        tensors = [np.sort(abs(t)) if rng.random() < 0.3 else t for t in tensors]
        weights[1:] = [2, rans.encode(tensors)]
        if rng.random() < 0.8:
            codes = bytearray(records[2])
            for at in _records(records[2]):
                for k in range(at + 26, min(at + 26 + 2 * (codes[at + 23] + 2), len(codes))):
                    codes[k] &= 0x7F
            records[2] = bytes(codes)
    else:
        high = sum(n for n, w in zip(sizes, wide, strict=True) if w)
        limit = rng.choice((1, 2, 256))
        raw = values.integers(0, limit, total + high).astype(np.uint8).tobytes()
        weights[1:] = [1, zstandard.ZstdCompressor(level=1, write_checksum=rng.random() < 0.2).compress(raw)[4:]]


def weights_inside(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Damage below the compression (zstd), or in the scale codes, state and stream one by one (rANS)."""
    section = parts.section(2)
    if section is None or not section[2]:
        return
    if section[1] == 1:
        try:
            raw = zstandard.ZstdDecompressor().decompress(b"\x28\xb5\x2f\xfd" + section[2], max_output_size=2**16)
        except (zstandard.ZstdError, MemoryError):
            return
        fresh = (blind(raw, 4096) + raw)[: len(raw)] if rng.random() < 0.8 else blind(raw, 4096)
        section[2] = zstandard.ZstdCompressor(level=1, write_content_size=rng.random() < 0.9).compress(fresh)[4:]
    else:
        body = bytearray(section[2])
        records = parts.section(1)
        n = len(_tensors(records[2], parts.head[3])[0]) if records else 6
        if rng.random() < 0.4:
            body[rng.randrange(max(1, min(n, len(body))))] = rng.randrange(62) | rng.choice((0, 0x80))
        elif rng.random() < 0.5:
            body[n : n + 4] = struct.pack(
                "<I", rng.choice((0, 2**23 - 1, 2**23, 2**31 - 1, 2**31, rng.getrandbits(31)))
            )
        else:
            body[n + 4 :] = blind(bytes(body[n + 4 :]), 4096)
        section[2] = bytes(body)


def surface_inside(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Damage in the head of a surface section, or in its stream."""
    section = parts.section(3)
    if section is None or len(section[2]) < 6:
        return
    body, start = section[2], 13 if section[2][0] & 16 else 5
    if rng.random() < 0.3:
        flags, step = rng.choice((*range(10), 16, 24, 32)), rng.choice((2.0**-30, 2.0**-6, 1.0, math.nan))
        turn = rng.choice(((0, 0, 0, 32767), (16384, 16384, -16384, 16384), (0, 0, 0, 1)))
        head = struct.pack("<Bf", flags, step) + (struct.pack("<4h", *turn) if flags & 16 else b"")
        section[2] = head + body[start:]
    else:
        section[2] = body[:start] + blind(body[start:], 4096)


def metadata(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    section = parts.section(0x81)
    if section is None:
        section = [0x81, 0, b""]
        parts.sections.append(section)
    value = blind(rng.choice((b"name", struct.pack("<3f", 1, 2, 3), b"\xc3\xa9", b"")), 255)
    if rng.random() < 0.5:
        value = struct.pack("<3f", *(rng.choice(FLOATS[:8] + FLOATS[9:]) for _ in range(3)))
    length = len(value) if rng.random() < 0.9 else rng.choice(BYTES)
    section[2] += bytes([rng.choice((1, 2, 3, 4, 255)), length]) + value


MUTATIONS = (
    header, table, section_bytes, exchange, record_field, record_field, fresh_records, fitting_weights, weights_inside,
    weights_inside, surface_inside, surface_inside, metadata,
)  # fmt: skip


def _records(body: bytes) -> list[int]:
    """Where the records start, as far as they can be told."""
    starts, at = [], 0
    while at + 26 <= len(body) and len(starts) < 64:
        starts.append(at)
        at += 26 + 2 * (body[at + 23] + 2)
    return starts or [0]


def _tensors(body: bytes, n_dhfs: int) -> tuple[list[int], list[bool]]:
    sizes: list[int] = []
    wide: list[bool] = []
    for at in _records(body)[:n_dhfs]:
        if at + 26 > len(body) or body[at + 22] > 128 or body[at + 23] > 8:
            break
        shapes = tensor_shapes(body[at + 22], body[at + 23])
        sizes += [math.prod(shape) for shape in shapes]
        codes = body[at + 26 : at + 26 + len(shapes)]
        wide += [bool(code & 0x80) for code in codes] + [False] * (len(shapes) - len(codes))
    return sizes, wide
