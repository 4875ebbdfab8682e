"""Damage that gets past the checksum: mutations of `.cndhf` bytes that know the layout of the container.

Blind mutation of bytes hardly ever changes anything but the error: the CRC-32 refuses it. Here the parts of a file are
taken apart, some are changed, and lengths and checksum are made to fit again (most of the time).
"""

from __future__ import annotations

import contextlib
import math
import random
import struct
import zlib
from collections.abc import Callable, Sequence

import numpy as np
import zstandard

from cndhf_codec.format import rans
from cndhf_codec.format.container import tensor_shapes
from cndhf_codec.format.writer import varint

Bytes = Callable[[bytes, int], bytes]  # (data, most bytes) -> other data: the fuzzer's own mutation
BYTES = (0, 1, 2, 3, 7, 8, 9, 16, 30, 59, 60, 63, 64, 65, 127, 128, 129, 254, 255)
SHORTS = (0, 1, -1, 2, 16384, -16384, 23170, 31999, 32000, 32767, -32767, -32768)
LENGTHS = (0, 1, 2, 24, 25, 26, 127, 128, 255, 2**14, 2**16, 2**21, 2**24, 2**28 - 1, 2**28, 2**35)
FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-310, 2.0**-149, 1e30, 3.4e38, 1e308, math.inf, -math.inf, math.nan)
SINGLES = FLOATS[:8] + FLOATS[9:]
RECORD = struct.Struct("<B4h6h4B")
HEAD = RECORD.size
ZSTD, RANS, SURFACE = 1, 2, 3


class Parts:
    """What stands before a file's sections, and these as lists of kind and body; `dumps` puts them together whatever
    they are."""

    def __init__(self, data: bytes) -> None:
        data = data + bytes(max(0, 38 - len(data)))
        at, end = 34 if data[5] & 1 else 22, len(data) - 4
        self.head = bytearray(data[:at])
        self.sections: list[list] = []
        while at < end and len(self.sections) < 20:
            kind, length, shift = data[at], 0, 0
            while at + 1 < end:
                at += 1
                length |= (data[at] & 0x7F) << shift
                shift += 7
                if data[at] < 0x80:
                    break
            at += 1
            self.sections.append([kind, data[at : min(at + length, end)]])
            at += length

    def section(self, *kinds: int) -> list | None:
        return next((s for s in self.sections if s[0] in kinds), None)

    def dumps(self, rng: random.Random | None = None) -> bytes:
        """The file; with `rng` a section has a length that does not fit."""
        wrong = rng.randrange(len(self.sections)) if rng and self.sections else -1
        out = bytes(self.head)
        for k, (kind, body) in enumerate(self.sections):
            length = varint(len(body))
            if k == wrong and rng:
                length = rng.choice((varint(rng.choice(LENGTHS)), varint(len(body) + 1), _longer(length)))
            out += bytes([kind & 0xFF]) + length + body
        return seal(out)


def _longer(length: bytes) -> bytes:
    """The same number in one byte more than it needs."""
    return length[:-1] + bytes([length[-1] | 0x80, 0])


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
    out = parts.dumps(rng if rng.random() < 0.05 else None)
    return out if len(out) <= most else data[:most]


def header(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    field = rng.randrange(6)
    wide = len(parts.head) == 34
    if field == 0:
        parts.head[rng.choice((4, 5))] = rng.choice(BYTES)
    elif field == 1:  # the centre becomes one of the other type
        x, y, z, scale = struct.unpack("<3df" if wide else "<4f", parts.head[6:])
        with contextlib.suppress(OverflowError):
            parts.head[5:] = bytes([not wide]) + struct.pack("<4f" if wide else "<3df", x, y, z, scale)
    elif field < 5:
        layout, values = ("<d", FLOATS) if wide else ("<f", SINGLES)
        struct.pack_into(layout, parts.head, 6 + struct.calcsize(layout) * (field - 2), rng.choice(values))
    else:
        struct.pack_into("<f", parts.head, len(parts.head) - 4, rng.choice(SINGLES))


def table(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    what = rng.randrange(5)
    if what == 0 or not parts.sections:
        body = blind(b"hello", 64)
        kind = rng.choice((0, 1, 2, 3, 4, 0x7F, 0x80, 0x81, 0x82, 0x83, 0xFE, 0xFF))
        parts.sections.insert(rng.randint(0, len(parts.sections)), [kind, body])
        return
    section = rng.choice(parts.sections)
    if what == 1:
        parts.sections.remove(section)
    elif what == 2:
        parts.sections.append(list(section))
    elif what == 3:
        rng.shuffle(parts.sections)
    else:
        section[0] = rng.choice(BYTES)


def section_bytes(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    if parts.sections:
        section = rng.choice(parts.sections)
        section[1] = blind(section[1], 4096)


def exchange(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Take a whole section of another file."""
    theirs = Parts(others[rng.randrange(len(others))])
    if theirs.sections and parts.sections:
        parts.sections[rng.randrange(len(parts.sections))] = rng.choice(theirs.sections)


def record_field(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    section = parts.section(ZSTD, RANS)
    if section is None or len(section[1]) < 1 + HEAD:
        return
    at = rng.choice(_records(section[1]))
    body = bytearray(section[1])
    fields = list(RECORD.unpack_from(body, at))
    k = rng.randrange(len(fields))
    fields[k] = rng.choice(SHORTS if 1 <= k < 11 else BYTES)
    RECORD.pack_into(body, at, *fields)
    if rng.random() < 0.1:
        body[0] = rng.choice(BYTES)
    if rng.random() < 0.3:
        body[rng.randrange(len(body))] = rng.choice(BYTES)
    section[1] = bytes(body)
    if rng.random() < 0.5:
        fitting_weights(parts, rng, blind, others)


def fresh_records(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Records of networks of other sizes, with weights to match."""
    section = parts.section(ZSTD, RANS)
    if section is None:
        return
    n = rng.choice((1, 1, 1, 2, 2, 3, 3, 64))
    body = bytes([n])
    for _ in range(n):
        width, hidden = rng.choice((1, 2, 3, 5, 8) if n > 3 else (1, 2, 8, 16, 127, 128)), rng.choice((1, 1, 2, 7, 8))
        box = [v for _ in range(3) for v in sorted(rng.sample(range(-32768, 32768), 2))]
        turn = rng.choice(((0, 0, 0, 32767), (32767, 0, 0, 0), (16384, 16384, -16384, 16384)))
        codes = bytes(rng.choice((0, 1, 20, 40, 127, 128 + 20)) for _ in range(2 * (hidden + 2)))
        body += (
            RECORD.pack(rng.randrange(4), *turn, *box, width, hidden, rng.choice(BYTES[1:]), rng.choice(BYTES[1:]))
            + codes
        )
    section[1] = body
    fitting_weights(parts, rng, blind, others)


def fitting_weights(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Weights of exactly the symbols that the records call for."""
    section = parts.section(ZSTD, RANS)
    if section is None:
        return
    sizes, wide, end = _tensors(section[1])
    total = sum(sizes)
    if 0 in sizes or not 0 < total <= 2**20 or (total > 5000 and rng.random() < 0.8):  # large ones take long
        return
    values = np.random.default_rng(rng.randrange(2**32))
    records = bytearray(section[1][:end])
    if rng.random() < 0.06 and total < 2000:  # coding takes long
        limit = rng.choice((0, 1, 3, 20, 1000, 32767))
        tensors = [values.integers(-limit, limit, n, endpoint=True).astype(np.int32) for n in sizes]
        tensors = [np.sort(abs(t)) if rng.random() < 0.3 else t for t in tensors]
        if rng.random() < 0.8:
            for at in _records(bytes(records)):
                for k in range(at + HEAD, min(at + HEAD + 2 * (records[at + HEAD - 3] + 2), len(records))):
                    records[k] &= 0x7F
        section[:] = [RANS, bytes(records) + rans.encode(tensors)]
    else:
        high = sum(n for n, w in zip(sizes, wide, strict=True) if w)
        limit = rng.choice((1, 2, 256))
        raw = values.integers(0, limit, total + high).astype(np.uint8).tobytes()
        frame = zstandard.ZstdCompressor(level=1, write_checksum=rng.random() < 0.05).compress(raw)[4:]
        section[:] = [ZSTD, bytes(records) + frame]


def weights_inside(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Damage below the compression (zstd), or in the scale codes, state and stream one by one (rANS)."""
    section = parts.section(ZSTD, RANS)
    if section is None:
        return
    sizes, _, end = _tensors(section[1])
    records, weights = section[1][:end], section[1][end:]
    if not weights:
        return
    if section[0] == ZSTD:
        try:
            raw = zstandard.ZstdDecompressor().decompress(b"\x28\xb5\x2f\xfd" + weights, max_output_size=2**16)
        except (zstandard.ZstdError, MemoryError):
            return
        fresh = (blind(raw, 4096) + raw)[: len(raw)] if rng.random() < 0.8 else blind(raw, 4096)
        weights = zstandard.ZstdCompressor(level=1, write_content_size=rng.random() < 0.95).compress(fresh)[4:]
    else:
        body, n = bytearray(weights), len(sizes)
        if rng.random() < 0.4:
            body[rng.randrange(max(1, min(n, len(body))))] = rng.randrange(62) | rng.choice((0, 0x80))
        elif rng.random() < 0.5:
            body[n : n + 4] = struct.pack(
                "<I", rng.choice((0, 2**23 - 1, 2**23, 2**31 - 1, 2**31, rng.getrandbits(31)))
            )
        else:
            body[n + 4 :] = blind(bytes(body[n + 4 :]), 4096)
        weights = bytes(body)
    section[1] = records + weights


def surface_inside(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    """Damage in the head of a surface, or in its stream."""
    section = parts.section(SURFACE)
    if section is None or len(section[1]) < 4:
        return
    body, start = section[1], 11 if section[1][0] & 16 else 3
    if rng.random() < 0.3:
        flags, step = rng.choice((*range(10), 16, 24, 32)), rng.choice((0x3080, 0x307F, 0x3C80, 0x3F80, 0x3F81, 0x7FC0))
        turn = rng.choice(((0, 0, 0, 32767), (16384, 16384, -16384, 16384), (0, 0, 0, 1)))
        head = struct.pack("<BH", flags, step) + (struct.pack("<4h", *turn) if flags & 16 else b"")
        section[1] = head + body[start:]
    else:
        section[1] = body[:start] + blind(body[start:], 4096)


def metadata(parts: Parts, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> None:
    kind = rng.choice((0x81, 0x82, 0x83, 0x84))
    value = blind(rng.choice((b"name", bytes.fromhex("803f00408040"), b"\xc3\xa9", b"")), 300)
    if rng.random() < 0.5:
        value = struct.pack("<3H", *(rng.choice((0, 1, 0x3F80, 0x7F7F, 0x7F80, 0x7FC0, 0x8000)) for _ in range(3)))
    section = parts.section(kind)
    if section is None:
        parts.sections.append([kind, value])
    else:
        section[1] = value


MUTATIONS = (
    header, table, section_bytes, exchange, record_field, record_field, fresh_records, fitting_weights, weights_inside,
    weights_inside, surface_inside, surface_inside, metadata,
)  # fmt: skip


def _records(body: bytes) -> list[int]:
    """Where the records start, as far as they can be told."""
    starts, at = [], 1
    while at + HEAD <= len(body) and len(starts) < min(body[0], 64):
        starts.append(at)
        at += HEAD + 2 * (body[at + HEAD - 3] + 2)
    return starts or [1]


def _tensors(body: bytes) -> tuple[list[int], list[bool], int]:
    """Sizes of the tensors, which of them are wide, and where the records end."""
    sizes: list[int] = []
    wide: list[bool] = []
    end = 1
    for at in _records(body):
        if at + HEAD > len(body) or body[at + HEAD - 4] > 128 or body[at + HEAD - 3] > 8:
            break
        shapes = tensor_shapes(body[at + HEAD - 4], body[at + HEAD - 3])
        sizes += [math.prod(shape) for shape in shapes]
        codes = body[at + HEAD : at + HEAD + len(shapes)]
        wide += [bool(code & 0x80) for code in codes] + [False] * (len(shapes) - len(codes))
        end = at + HEAD + len(shapes)
    return sizes, wide, end
