"""The reference decoder of `.cndhf` files: spec/cndhf.md in its order and in its words, slow, with no other purpose.

Bytes to numbers; section 4 is in reference_surface.py, and section 6, numbers to shapes, in reference_shape.py. They
need numpy and zstandard. `python spec/reference.py FILE ...` says what files hold.
"""

from __future__ import annotations

import math
import struct
import sys
import zlib

import numpy as np
import zstandard
from reference_surface import RefusedError, bf16, check_quaternion, need, surface

# 1. Layout


def decode(data):
    """What a file holds: centre, scale, encoder, source, errors; `dhfs`, or `mesh`."""
    need(data[:4] == b"\x89DHF", "signature")
    need(data[4:5] == b"\x01", "version")
    need(26 <= len(data) <= 2**24, "size of the file")
    end = len(data) - 4
    need(zlib.crc32(data[:end]) == int.from_bytes(data[end:], "little"), "checksum")
    need(data[5] <= 1, "flags")
    layout, at = ("<3df", 34) if data[5] else ("<4f", 22)
    need(at <= end, "end inside the header")
    *centre, scale = struct.unpack(layout, data[6:at])
    need(all(-(2.0**100) <= x <= 2.0**100 for x in centre), "centre")
    need(2.0**-100 <= scale <= 2.0**100, "scale")
    count, bodies = 0, {}
    while at < end:
        kind, length, shift, byte = data[at], 0, 0, 128
        while byte >= 128:
            at += 1
            need(at < end and shift < 28, "length of a section")
            byte = data[at]
            length += byte % 128 << shift
            shift += 7
        need(byte > 0 or shift == 7, "length in more bytes than it needs")
        at += 1 + length
        count += 1
        need(at <= end and count <= 16, "section beyond the end, or the 17th")
        if kind in (1, 2, 3, 0x81, 0x82, 0x83):
            need(kind not in bodies, "section twice")
            bodies[kind] = data[at - length : at]
        else:
            need(kind & 0x80, "kind of a section")
    shapes = [kind for kind in bodies if kind < 4]
    need(len(shapes) == 1, "number of shapes")
    kind, body = shapes[0], bodies[shapes[0]]
    shape = {"mesh": surface(body)} if kind == 3 else {"dhfs": height_fields(body, kind)}
    return {"centre": np.array(centre), "scale": scale, **metadata(bodies), **shape}


# 2. Double height fields: records


def height_fields(body, kind):
    need(body and 1 <= body[0] <= 64, "n_dhfs")
    at, dhfs = 1, []
    for _ in range(body[0]):
        need(len(body) >= at + 25, "end inside a record")
        fold, *numbers, width, layers, first, hidden = struct.unpack_from("<B10h4B", body, at)
        quaternion, box = numbers[:4], numbers[4:]
        need(fold <= 3 and 1 <= width <= 128 and 1 <= layers <= 8 and first and hidden, "field of a record")
        check_quaternion(quaternion)
        need(all(box[k] < box[k + 1] for k in (0, 2, 4)), "box")
        shapes = [(width, 2), (width,), *[(width, width), (width,)] * layers, (2, width), (2,)]
        at += 25 + len(shapes)
        need(len(body) >= at, "end inside a record")
        dhfs.append(
            {
                "fold": fold,
                "quaternion": quaternion,
                "box": np.array(box).reshape(3, 2) / 2**14,
                "omegas": [first] + [hidden] * layers,
                "steps": body[at - len(shapes) : at],
                "shapes": shapes,
            }
        )
    sizes = [math.prod(shape) for d in dhfs for shape in d["shapes"]]
    steps = [step for d in dhfs for step in d["steps"]]
    need(sum(sizes) <= 2**20, "number of weights and biases")
    symbols = iter((zstd_symbols if kind == 1 else rans_symbols)(body[at:], sizes, steps))
    for d in dhfs:
        d["tensors"] = [
            (np.array(next(symbols)) * 2.0 ** (-(step % 128) / 4)).astype(np.float32).reshape(shape)
            for step, shape in zip(d["steps"], d["shapes"], strict=True)
        ]
    return dhfs


# 3. Double height fields: weights


def zstd_symbols(body, sizes, steps):  # 3.1
    need(body[:1] in (b"\x20", b"\x60", b"\xa0"), "frame descriptor")
    digits = {0x20: 1, 0x60: 2, 0xA0: 4}[body[0]]
    content = int.from_bytes(body[1 : 1 + digits], "little") + (256 if digits == 2 else 0)
    n_low = sum(sizes)
    need(content == n_low + sum(n for n, step in zip(sizes, steps, strict=True) if step >= 128), "content size")
    try:
        raw = zstandard.ZstdDecompressor().decompress(b"\x28\xb5\x2f\xfd" + body, allow_extra_data=False)
    except zstandard.ZstdError as exc:
        raise RefusedError("frame") from exc
    need(len(raw) == content, "content of the frame")
    low, high, tensors = iter(raw[:n_low]), iter(raw[n_low:]), []
    for size, step in zip(sizes, steps, strict=True):
        unsigned = [next(low) + (256 * next(high) if step >= 128 else 0) for _ in range(size)]
        tensors.append([-(u + 1) // 2 if u % 2 else u // 2 for u in unsigned])
        need(min(tensors[-1]) >= -32767, "symbol")
    return tensors


def rans_symbols(body, sizes, steps):  # 3.2
    need(all(step < 128 for step in steps), "wide step")
    need(sum(sizes) <= 32768 + 4 * len(body), "number of symbols")
    need(len(body) >= len(sizes) + 4, "end inside the scale codes or the state")
    need(all(byte % 128 < 60 for byte in body[: len(sizes)]), "scale code")
    state, stream = int.from_bytes(body[len(sizes) : len(sizes) + 4], "little"), iter(body[len(sizes) + 4 :])
    need(2**23 <= state < 2**31, "state")

    def decode_one(bits, freq):
        nonlocal state
        part, start, a = state % 2**bits, 0, 0
        while start + freq[a] <= part:
            start += freq[a]
            a += 1
        state = freq[a] * (state // 2**bits) + part - start
        while state < 2**23:
            byte = next(stream, None)
            need(byte is not None, "end of the stream")
            state = 256 * state + byte
        return a

    def uniform(bits):
        return decode_one(bits, [1] * 2**bits) if bits else 0

    tensors = []
    for size, byte in zip(sizes, body, strict=False):
        c, rising, symbol, freq, tensor = byte % 128, byte >= 128, 0, table(byte % 128), []
        low = max(0, c // 4 - 5)
        for _ in range(size):
            bucket = decode_one(14, freq)
            magnitude = 256 * uniform(8) + uniform(8) if bucket == 63 else bucket * 2**low + uniform(low)
            if rising:
                symbol += magnitude
            else:
                symbol = -magnitude if magnitude and uniform(1) else magnitude
            need(abs(symbol) <= 32767, "symbol")
            tensor.append(symbol)
        tensors.append(tensor)
    need(state == 2**23 and next(stream, None) is None, "end of the weights")
    return tensors


RATIOS = (
    5628,
    58611,
    307285,
    991630,
    2270549,
    4078822,
    6171993,
    8272320,
    10175896,
    11780768,
    13066109,
    14058751,
    14805841,
    15357953,
    15760736,
    16051906,
    16261035,
    16410554,
    16517109,
    16592872,
    16646655,
    16684790,
    16711808,
    16730939,
    16517109,
    16592872,
    16646655,
    16684790,
)
CHANGES = (2, 205, *RATIOS[:22], *RATIOS[24:])


def table(c):
    row = c if c < 24 else 24 + c % 4
    ratio, value, weight = RATIOS[row], 2**24, [2**23 if c < 24 else 2**24]
    for _ in range(62):
        value = value * ratio // 2**24
        ratio = ratio * CHANGES[row] // 2**24
        weight.append(value)
    freq = [1 + w * (2**14 - 64) // sum(weight) for w in [*weight, 0]]
    freq[0] += 2**14 - sum(freq)
    return freq


# 5. Metadata


def metadata(bodies):
    errors = bodies.get(0x82, bytes(6))
    need(len(errors) == 6 and all(bits < 0x7F80 for bits in struct.unpack("<3H", errors)), "errors")
    found = {"errors": [bf16(errors[k : k + 2]) for k in (0, 2, 4)] if 0x82 in bodies else None}
    for name, kind in (("encoder", 0x81), ("source", 0x83)):
        need(len(bodies.get(kind, b"")) <= 255, name)
        try:
            found[name] = bodies[kind].decode("utf-8") if kind in bodies else None
        except UnicodeDecodeError as exc:
            raise RefusedError(name) from exc
    return found


if __name__ == "__main__":
    for path in sys.argv[1:]:
        with open(path, "rb") as file:
            content = file.read()
        try:
            print(path, decode(content))
        except RefusedError as refused:
            print(path, "refused:", refused)
