"""Other mesh files made of given ones, whose containers still fit: lengths, checksums and compression are made anew.

Blind mutation of bytes hardly ever gets past the checks of a ZIP archive or a compressed file, nor changes a number of
a text to one that is worth trying.
"""

from __future__ import annotations

import bz2
import copy
import gzip
import io
import json
import lzma
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import mesh_target
import zstandard
from mesh_seeds import PACKERS, pack_glb, pack_zip

Bytes = Callable[[bytes, int], bytes]  # (data, most bytes) -> other data: the fuzzer's own mutation
Change = Callable[[bytes, random.Random, Bytes, Sequence[bytes]], bytes]
MOST = 2**13  # bytes that are taken out of a compressed file: more would take the time of many others
TOKENS = re.compile(rb"[\w.+\-]+|\s+|[^\w.+\-\s]", re.ASCII)
NUMBER = re.compile(rb"[+-]?\d[\w.+\-]*")
EXTREMES = (
    *(b"-1", b"0", b"1", b"2", b"3", b"1e308", b"-1e308", b"nan", b"inf", b"99999999999", b"2147483648", b"4294967295"),
    *(
        b"-0.0",
        b"1e-320",
        b"1e39",
        b"3e-31",
        b"0.5",
        b"1_0",
        b"1,5",
        b"9" * 19,
        b"9" * 400,
        b"-2",
        b"255",
        b"65535",
        b"1e5",
    ),
)
WORDS = {
    "obj": b"v f fo vt vn l p o g s usemtl mtllib # \\ / // curv call 1/1/1 -1/-1 f\t v\t",
    "ply": b"ply format ascii binary_little_endian binary_big_endian 1.0 comment obj_info element vertex face "
    b"tristrips property list char uchar short ushort int uint float double int8 uint64 vertex_indices vertex_index x "
    b"y z end_header edge",
    "stl": b"solid facet normal outer loop vertex endloop endfacet endsolid",
    "off": b"OFF COFF NOFF STOFF STCN4OFF 4OFF nOFF BINARY #",
    "glb": b'{ } [ ] , : " null true false',
    "gltf": b'{ } [ ] , : " null true false data:,%00 data:;base64,AAAA a.bin ../a.bin',
    "3mf": b"object model mesh vertices vertex triangles triangle components component resources build item transform "
    b"objectid id type support other p:path p:UUID requiredextensions xmlns xmlns:b v1 v2 v3 x y z metadata "
    b"beamlattice "
    b'< > / = " &amp; <!DOCTYPE&#x0;',
}
VALUES: tuple[Any, ...] = (
    *(-1, 0, 1, 2, 3, 4, 5, 6, 7, 12, 16, 252, 255, 2**16, 2**31, 2**32, 2**53, 99999999999, 10**400, 0.5, -0.0, 1e308),
    *(
        -1e308,
        1e-320,
        1e30,
        1e39,
        1e200,
        float("nan"),
        float("inf"),
        None,
        True,
        False,
        "",
        "x\ny\x1b",
        "2.0",
        [],
        {},
        [0],
        [[]],
    ),
    *([{}], [1, 2, 3], [0, 0, 0, 0], [1e308] * 3, [1e308] * 4, [1e200] * 16, [float("nan")] * 3, {"": 0}),
)
KINDS = (5120, 5121, 5122, 5123, 5125, 5126)
ENTRIES: tuple[tuple[str, tuple[Any, ...]], ...] = (
    ("componentType", KINDS),
    ("type", ("SCALAR", "VEC2", "VEC3", "VEC4", "MAT4", "MAT3")),
    ("mode", tuple(range(8))),
    ("normalized", (True, False)),
    ("byteStride", (0, 2, 3, 4, 8, 12, 16, 24, 252, 256)),
    ("byteOffset", (0, 1, 2, 4, 12, 48, 1000)),
    ("byteLength", (0, 1, 8, 48, 10**9)),
    ("count", (0, 1, 2, 3, 4, 5, 12, 2**16, 2**17, 2**31)),
    ("bufferView", (0, 1, 2, 3)),
    ("buffer", (0, 1)),
    ("indices", (0, 1, 2, {"bufferView": 0, "componentType": 5123}, {"bufferView": 1, "componentType": 5121})),
    ("values", ({"bufferView": 0}, {"bufferView": 1, "byteOffset": 4})),
    ("sparse", ({"count": 1, "indices": {"bufferView": 1, "componentType": 5121}, "values": {"bufferView": 0}}, {})),
    ("POSITION", (0, 1, 2)),
    ("JOINTS_0", (0, 1, 2)),
    ("WEIGHTS_0", (0, 1, 2)),
    ("JOINTS_1", (1, 2)),
    ("WEIGHTS_1", (1, 2)),
    ("TRANSLATION", (0, 1, 2)),
    ("ROTATION", (1, 2, 3)),
    ("SCALE", (0, 1, 2)),
    ("targets", ([{"POSITION": 0}], [{"POSITION": 0}] * 3, [{}])),
    ("weights", ([1], [0.5, -1], [1e308, 1e308], [0])),
    ("matrix", ([1e308] * 16, [0] * 16, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1], list(range(16)))),
    ("translation", ([1, 2, 3], [1e308, -1e308, 0], [1e30, 0, 0])),
    ("rotation", ([0, 0, 0, 0], [1e200, 0, 0, 1], [0, 0, 0, 2], [1e-320, 0, 0, 0])),
    ("scale", ([0, 0, 0], [-1, 1, 1], [1e308, 1, 1], [1e-200] * 3)),
    ("children", ([0], [1, 2], [1, 1], [])),
    ("skin", (0, 1)),
    ("skins", ([{"joints": [0]}], [{"joints": [0, 1], "inverseBindMatrices": 0}])),
    ("joints", ([0], [0, 1], [])),
    ("inverseBindMatrices", (0, 3, 4)),
    ("scene", (0, 1)),
    ("mesh", (0, 1)),
    ("min", ([0, 0, 0], [1], [1e308] * 3, [float("nan")] * 3)),
    ("max", ([1, 1, 1], [0, 0, 0], [-1e308] * 3)),
    ("uri", ("a.bin", "b.bin", "data:;base64,AAAA", "data:,%00%ff%e9", "data:", "data:;base64,AAA\u20ac")),
    ("extensionsRequired", (["KHR_mesh_quantization"], ["x\n"], ["KHR_draco_mesh_compression"], [0])),
    (
        "extensions",
        (
            {"KHR_node_visibility": {"visible": False}},
            {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}},
            {
                "EXT_meshopt_compression": {
                    "buffer": 0,
                    "byteLength": 8,
                    "count": 4,
                    "byteStride": 12,
                    "mode": "ATTRIBUTES",
                }
            },
            {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}},
            {"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": 0, "ROTATION": 1}}},
        ),
    ),
)


def mutate(data: bytes, most: int, seed: int, blind: Bytes, others: Sequence[bytes]) -> bytes:
    """Another input, of at most `most` bytes. `others`: valid inputs to take parts from."""
    rng = random.Random(seed)
    if rng.random() < 0.05 or len(data) < 2:
        data = rng.choice(others)
    kind, body = data[:1], data[1:]
    if rng.random() < 0.05:
        kind = bytes([rng.randrange(len(mesh_target.KINDS))])
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        body = changed(body, rng, blind, others)
    if rng.random() < 0.01:
        body = rng.choice(list(PACKERS.values()))(body[:MOST])
    out = kind + body
    return out if len(out) <= most else out[:most] if rng.random() < 0.2 else data[:most]


def changed(body: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    """One change, inside the container that the bytes are."""
    if rng.random() < 0.06:
        return blind(body, len(body) + 64)
    packed = next((magic for magic in PACKERS if body.startswith(magic)), None)
    if packed is not None:
        return _repacked(body, packed, rng, blind, others)
    if body.startswith(b"glTF"):
        return _glb(body, rng, blind, others)
    if body.startswith(b"PK"):
        return _zip(body, rng, blind, others)
    if body.startswith(b"{"):
        return _json(body, rng, blind, others)
    if body.startswith(b"ply") and b"format binary" in body[:200]:
        return _ply_binary(body, rng, blind, others)
    if len(body) >= 84 and b"\0" in body[:84]:
        return _stl_binary(body, rng, blind, others)
    return _text(body, rng, blind, others)


# Containers.


def _repacked(body: bytes, magic: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    try:
        inside = _unpacked(body, magic)
    except (OSError, EOFError, zlib.error, lzma.LZMAError, zstandard.ZstdError, MemoryError):
        return blind(body, len(body) + 64)
    chance = rng.random()
    if chance < 0.1:  # several streams one after another
        return body + PACKERS[magic](inside[: rng.randint(0, len(inside))])
    if chance < 0.2:
        magic = rng.choice(list(PACKERS))
    elif chance < 0.25:
        return inside
    elif chance < 0.3:
        inside += inside[-64:] * rng.choice((10, 100, 1000))
    else:
        inside = changed(inside, rng, blind, others)
    return PACKERS[magic](inside[:MOST])


def _unpacked(body: bytes, magic: bytes) -> bytes:
    if magic == b"\x28\xb5\x2f\xfd":
        return zstandard.ZstdDecompressor().decompress(body, max_output_size=MOST)
    opener: Any = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\0": lzma.open}[magic]
    return opener(io.BytesIO(body)).read(MOST)


def _glb(body: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    chunks, at = [], 12
    while at + 8 <= len(body) and len(chunks) < 8:
        size, name = struct.unpack_from("<I4s", body, at)
        chunks.append((name, body[at + 8 : at + 8 + size]))
        at += 8 + size
    chance = rng.random()
    if not chunks or chance < 0.02:
        return blind(body, len(body) + 64)
    if chance < 0.04:
        rng.shuffle(chunks)
    elif chance < 0.06:
        chunks.insert(rng.randint(0, len(chunks)), (rng.choice((b"JSON", b"BIN\0", b"CAD ")), blind(b"{}", 64)))
    elif chance < 0.08:
        del chunks[rng.randrange(len(chunks))]
    else:
        k = 0 if chance < 0.75 else len(chunks) - 1
        name, data = chunks[k]
        if name == b"JSON":
            data = _json(data.rstrip(b" "), rng, blind, others)
            if rng.random() < 0.5:  # the buffer's length follows from the chunk
                binary = dict(chunks).get(b"BIN\0", b"")
                data = re.sub(rb'("buffers": \[\{"byteLength": )\d+', rb"\g<1>%d" % len(binary), data)
        else:
            data = _numbers(data, rng, blind, others)
        chunks[k] = (name, data)
    out = pack_glb(chunks, 1 if rng.random() < 0.01 else 2)
    if rng.random() < 0.02:
        out = out[:8] + struct.pack("<I", rng.choice((0, 12, 20, len(out) - 1, len(out) + 1, 2**32 - 1))) + out[12:]
    return out + b"more" if rng.random() < 0.01 else out


def _zip(body: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive:
            parts = {i.filename: archive.open(i).read(MOST) for i in archive.infolist()[:8]}
    except Exception:  # whatever a damaged archive raises
        return blind(body, len(body) + 64)
    method = rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED))
    chance = rng.random()
    if not parts:
        return body
    name = rng.choice(list(parts))
    if chance < 0.03:
        parts[_text(name.encode("utf-8", "replace"), rng, blind, others).decode("latin-1")] = parts.pop(name)
    elif chance < 0.05:
        parts[rng.choice(("3D/3dmodel.model", "3D/b.model", "a\n.model", "[Content_Types].xml"))] = parts[name]
    elif chance < 0.07:
        del parts[name]
    elif chance < 0.12:  # of the archive itself: a field of an entry
        out = bytearray(pack_zip(parts, method))
        entry = out.rfind(b"PK\x01\x02")
        at = rng.choice((0, max(entry, 0))) + rng.choice((4, 6, 8, 10, 14, 18, 22, 24, 26, 28, 30, 42))
        width = rng.choice((1, 2, 4))
        out[at : at + width] = rng.choice((0, 1, 8, 12, 14, 64, 255, 2**16, 2**31, rng.getrandbits(32))).to_bytes(
            5, "little"
        )[:width]
        return bytes(out)
    else:
        parts[name] = _text(parts[name], rng, blind, others)
    if rng.random() < 0.05:
        method = rng.choice((zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    out = pack_zip(parts, method)
    if rng.random() < 0.05:  # within the compressed bytes
        at = rng.randrange(len(out))
        out = out[:at] + bytes([rng.randrange(256)]) + out[at + 1 :]
    return out


def _ply_binary(body: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    head, mark, rest = body.partition(b"end_header\n")
    if rng.random() < 0.5:
        return _text(head, rng, blind, others) + mark + rest
    return head + mark + _numbers(rest, rng, blind, others)


def _stl_binary(body: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    rest = _numbers(body[84:], rng, blind, others)
    count = len(rest) // 50
    if rng.random() < 0.1:
        count = rng.choice((0, 1, count - 1, count + 1, 2**31, 2**32 - 1)) % 2**32
    elif rng.random() < 0.8:
        rest = rest[: 50 * count]
    return body[:80] + struct.pack("<I", count) + rest


def _numbers(data: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    """A number of a table of binary ones."""
    chance = rng.random()
    if chance < 0.3 or len(data) < 8:
        return blind(data, len(data) + 64)
    if chance < 0.4:
        return data[: rng.randrange(len(data))]
    if chance < 0.5:
        at = 4 * rng.randrange(len(data) // 4)
        return data[:at] + data[at : at + rng.choice((4, 12, 50))] * rng.choice((2, 10, 100)) + data[at:]
    value = rng.choice((0.0, -0.0, 1.0, -1.0, 1e-45, 1e-31, 1e30, 3e38, float("inf"), float("nan"), 0.5))
    whole = rng.choice((0, 1, 2, 3, 4, 127, 128, 255, 256, 32767, 32768, 65535, 2**31 - 1, 2**31, 2**32 - 1))
    order = rng.choice("<<>")
    kind, number = rng.choice((("f", value), ("d", value), ("I", whole), ("H", whole % 2**16), ("B", whole % 256)))
    fresh = struct.pack(order + kind, number)
    at = rng.choice((1, 2, 4)) * rng.randrange(len(data) // 4)
    return data[:at] + fresh + data[at + len(fresh) :]


# JSON.


def _json(data: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    if rng.random() < 0.1:
        return _text(data, rng, blind, others)
    try:
        root = json.loads(data)
        for _ in range(rng.choice((1, 1, 2, 3))):
            _change_value(root, rng)
        return json.dumps(root).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):
        return _text(data, rng, blind, others)


def _change_value(root: Any, rng: random.Random) -> None:
    """One place of a document, any as likely as the others: another value, another key, once more, or gone."""
    places = list(_places(root))
    if not places:
        return
    owner, key = rng.choice(places)
    here, (other, other_key) = owner[key], rng.choice(places)
    chance = rng.random()
    if chance < 0.2:
        owner[key] = copy.deepcopy(rng.choice(VALUES))
    elif chance < 0.45 and isinstance(here, (int, float)) and not isinstance(here, bool):
        owner[key] = rng.choice((here + 1, here - 1, -here, rng.randrange(8), rng.choice(VALUES[:22])))
    elif chance < 0.65:
        name, values = rng.choice(ENTRIES)
        known = dict(ENTRIES).get(key) if isinstance(owner, dict) else None
        if known and rng.random() < 0.6:
            owner[key] = copy.deepcopy(rng.choice(known))
        else:
            target = here if isinstance(here, dict) else owner if isinstance(owner, dict) else root
            if isinstance(target, dict):
                target[name] = copy.deepcopy(rng.choice(values))
    elif chance < 0.75:
        del owner[key]
    elif chance < 0.85:
        owner[key] = copy.deepcopy(other[other_key])  # what holds itself would have no end
    elif isinstance(owner, list):
        owner[key:key] = [copy.deepcopy(here) for _ in range(rng.choice((1, 1, 2, 30)))]
    else:
        owner[key], other[other_key] = copy.deepcopy(other[other_key]), copy.deepcopy(here)


def _places(value: Any) -> Any:
    for key in range(len(value)) if isinstance(value, list) else list(value) if isinstance(value, dict) else ():
        yield value, key
        yield from _places(value[key])


# Text.


def _text(data: bytes, rng: random.Random, blind: Bytes, others: Sequence[bytes]) -> bytes:
    tokens = TOKENS.findall(data[:MOST]) or [b"0"]
    chance, at, other = rng.random(), rng.randrange(len(tokens)), rng.randrange(len(tokens))
    numbers = [k for k, token in enumerate(tokens) if NUMBER.fullmatch(token)]
    if chance < 0.35 and numbers:
        k = rng.choice(numbers)
        tokens[k] = rng.choice(EXTREMES) if rng.random() < 0.6 else tokens[rng.choice(numbers)]
    elif chance < 0.43:
        tokens[at], tokens[other] = tokens[other], tokens[at]
    elif chance < 0.5:
        tokens.insert(at, tokens[at])
    elif chance < 0.58:
        del tokens[at]
    elif chance < 0.65:
        tokens[at] = rng.choice(rng.choice(list(WORDS.values())).split())
    elif chance < 0.7:
        tokens.insert(
            at,
            rng.choice((b"\n", b"\r", b" ", b"\t", b"\0", b"\\\n", b"#", b"\x0b", b"\x85", b"\xa0", b"\xef\xbb\xbf")),
        )
    elif chance < 0.9:
        return _lines(data, rng, others)
    elif chance < 0.94:  # more of the same
        tokens[at:at] = tokens[at : at + rng.choice((1, 2, 4))] * rng.choice((2, 10, 100))
    else:
        return blind(data, len(data) + 64)
    return b"".join(tokens)


def _lines(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    lines = data.splitlines(keepends=True) or [b"\n"]
    chance, at, other = rng.random(), rng.randrange(len(lines)), rng.randrange(len(lines))
    if chance < 0.3:
        lines.insert(at, lines[other])
    elif chance < 0.5:
        del lines[at]
    elif chance < 0.7:
        lines[at], lines[other] = lines[other], lines[at]
    elif chance < 0.8:
        lines[at:at] = lines[other : other + rng.choice((1, 2, 5))] * rng.choice((1, 5, 20))
    else:
        theirs = rng.choice(others)[1:].splitlines(keepends=True)
        lines[at:at] = theirs[rng.randrange(len(theirs) or 1) :][: rng.choice((1, 1, 4))]
    return b"".join(lines)
