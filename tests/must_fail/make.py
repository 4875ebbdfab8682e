"""Make the files that must fail and those that must load: `python tests/must_fail/make.py`.

Only new ones: it never overwrites a file, and no test runs it. A test that made its own files would follow the code.
Each file, its checksum included, is right except for the one thing that its name says.

must_fail/index.tsv   file, error class, words of its message
must_load/index.tsv   file, why it must load; all of them decode to the same weights as valid.cndhf
"""

from __future__ import annotations

import math
import struct
import sys
import zlib
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

import rawfile  # noqa: E402
from rawfile import (  # noqa: E402
    METADATA,
    RANGE,
    RANS,
    RECORDS,
    SURFACE,
    WEIGHTS,
    build,
    build_surface,
    entry,
    frame,
    record,
    sections,
)

from cndhf_codec.format import ControlMesh, rans  # noqa: E402
from cndhf_codec.format.surface import connectivity, positions  # noqa: E402
from cndhf_codec.format.surface.section import encode_surface  # noqa: E402

SIZES = [4, 2, 4, 2, 4, 2]  # tensors of the smallest record
TENSORS = [
    np.array(v, dtype=np.int32) for v in ([0, -1, 1, -2], [2, -3], [3, -4, 4, -5], [5, -6], [6, -7, 7, -8], [8, -9])
]
RAW = bytes(range(rawfile.SIZE))  # the same as one byte a symbol
VALID = build(sections(metadata=entry(1, b"me")))
CODED = rans.encode(TENSORS)
BIG = record(width=128, hidden=8)
BIG_SIZE = 8 * 128 * 129 + 5 * 128 + 2


def weights(body: bytes, codec: int = rawfile.ZSTD, records: bytes | None = None, n_dhfs: int = 1) -> bytes:
    return build([(RECORDS, 0, record() if records is None else records), (WEIGHTS, codec, body)], n_dhfs=n_dhfs)


def patched(data: bytes, at: int, new: bytes) -> bytes:
    """`data` with other bytes at `at` and a checksum to match."""
    body = data[:at] + new + data[at + len(new) : -4]
    return body + struct.pack("<I", zlib.crc32(body))


def bomb(declared: int, blocks: int) -> bytes:
    """A frame that declares `declared` bytes and whose 4-byte run-length blocks hold 128 KiB each."""
    out = bytes([0x80, 7 << 3]) + struct.pack("<I", declared)  # 4-byte content size, 128 KiB window
    block = struct.pack("<I", (2**17 << 3) | 2)[:3] + b"\0"
    last = struct.pack("<I", (2**17 << 3) | 3)[:3] + b"\0"
    return out + block * (blocks - 1) + last


def beyond_the_largest_symbol(first: int = 0) -> bytes:
    largest, rans.MAX_SYMBOL = rans.MAX_SYMBOL, 65535
    try:
        return rans.encode([*TENSORS[:5], np.array([first, 32768], dtype=np.int32)])
    finally:
        rans.MAX_SYMBOL = largest


def headers() -> dict[str, tuple[bytes, str, str]]:
    out = {
        "empty": (b"", "TruncatedError", "after 0 bytes"),
        "other-png": (b"\x89PNG\r\n\x1a\n" + bytes(60), "SignatureError", "not a .cndhf file"),
        "other-ply": (b"ply\nformat ascii 1.0\n", "SignatureError", "not a .cndhf file"),
        "other-zeros": (bytes(100), "SignatureError", "not a .cndhf file"),
        "text-crlf-to-lf": (VALID.replace(b"\r\n", b"\n"), "TextModeError", "text-mode"),
        "text-lf-to-crlf": (VALID.replace(b"\n", b"\r\n"), "TextModeError", "text-mode"),
        "text-cr-to-lf": (VALID.replace(b"\r", b"\n"), "TextModeError", "text-mode"),
        "text-seven-bit": (bytes(b & 0x7F for b in VALID), "TextModeError", "text-mode"),
        "text-dos-end": (VALID.split(b"\x1a")[0], "TruncatedError", "inside the signature"),
        "checksum-flipped": (VALID[:-4] + bytes(b ^ 0xFF for b in VALID[-4:]), "ChecksumError", "damaged"),
        "checksum-zero": (VALID[:-4] + bytes(4), "ChecksumError", "damaged"),
        "checksum-of-another-file": (VALID[:-4] + build()[-4:], "ChecksumError", "damaged"),
        "trailing-zero": (VALID + b"\0", "TrailingDataError", "announces"),
        "trailing-newline": (VALID + b"\n", "TrailingDataError", "announces"),
        "trailing-second-file": (VALID + VALID, "TrailingDataError", "announces"),
        "n-dhfs-0": (build(n_dhfs=0), "LimitError", "n_dhfs is 0"),
        "n-dhfs-65": (build(n_dhfs=65), "LimitError", "n_dhfs is 65"),
        "n-dhfs-255": (build(n_dhfs=255), "LimitError", "n_dhfs is 255"),
        "n-sections-0": (build([]), "LimitError", "n_sections is 0"),
        "n-sections-17": (build(sections() + [(0x90, 0, b"")] * 15), "LimitError", "n_sections is 17"),
        "n-sections-255": (build(n_sections=255), "LimitError", "n_sections is 255"),
        "n-sections-one-more": (build(n_sections=3), "TruncatedError", "announces"),
        "n-sections-one-less": (build(n_sections=1), "TrailingDataError", "announces"),
    }
    for major, minor in ((1, 0), (255, 0), (0, 0), (0, 3), (0, 255)):
        data = build(version=(major, minor))
        out[f"version-{major}-{minor}"] = (data, "VersionError", f"version {major}.{minor}")
    # A newer file may have another layout: the version has to be said before anything else is looked at.
    out["version-3-0-of-another-layout"] = (build(version=(3, 0), n_sections=0)[:60], "VersionError", "version 3.0")
    for name, value in (
        ("nan", math.nan),
        ("inf", math.inf),
        ("minus-inf", -math.inf),
        ("largest-float", 1.7976931348623157e308),
        ("below-2-100", -(2.0**100) * 1.0000001),
    ):
        for axis in range(3):
            centre = [value if k == axis else 0.0 for k in range(3)]
            out[f"centre-{'xyz'[axis]}-{name}"] = (build(centre=centre), "FieldError", "field centre is")
        if not math.isfinite(value):
            out[f"scale-{name}"] = (build(scale=value), "FieldError", "field scale is")
    beyond = {"zero": 0.0, "minus-zero": -0.0, "minus-one": -1.0, "below-2-100": 2.0**-101, "above-2-100": 2.0**101}
    beyond |= {"least-float": 2.0**-149, "largest-float": 3.4028234e38}
    for name, value in beyond.items():
        out[f"scale-{name}"] = (build(scale=value), "FieldError", "field scale is")
    return out


def records() -> dict[str, tuple[bytes, str, str]]:
    def with_records(body: bytes, n_dhfs: int = 1) -> bytes:
        return build(sections(body), n_dhfs=n_dhfs)

    fields: dict[str, tuple[dict, str, str]] = {
        "width-0": ({"width": 0}, "LimitError", "width is 0"),
        "width-129": ({"width": 129}, "LimitError", "width is 129"),
        "width-255": ({"width": 255}, "LimitError", "width is 255"),
        "hidden-0": ({"hidden": 0}, "LimitError", "hidden_layers is 0"),
        "hidden-9": ({"hidden": 9}, "LimitError", "hidden_layers is 9"),
        "hidden-255": ({"hidden": 255, "codes": b""}, "LimitError", "hidden_layers is 255"),
        "role-1": ({"role": 1}, "FieldError", "role is 1"),
        "role-255": ({"role": 255}, "FieldError", "role is 255"),
        "fold-4": ({"fold": 4}, "FieldError", "fold is 4"),
        "fold-255": ({"fold": 255}, "FieldError", "fold is 255"),
        "quaternion-zero": ({"quaternion": (0, 0, 0, 0)}, "FieldError", "quaternion has norm 0"),
        "quaternion-short": ({"quaternion": (0, 0, 0, 31999)}, "FieldError", "quaternion has norm 31999"),
        "quaternion-long": ({"quaternion": (20000, 20000, 20000, 20000)}, "FieldError", "quaternion has norm 40000"),
        "quaternion-longest": ({"quaternion": (-32768,) * 4}, "FieldError", "quaternion has norm 65536"),
        "box-u-empty": ({"box": (5, 5, -1, 1, -1, 1)}, "FieldError", "along u"),
        "box-v-reversed": ({"box": (-1, 1, 2, 1, -1, 1)}, "FieldError", "along v"),
        "box-z-empty": ({"box": (-1, 1, -1, 1, 0, 0)}, "FieldError", "along z"),
        "box-z-reversed": ({"box": (-1, 1, -1, 1, 32767, -32768)}, "FieldError", "along z"),
        "omega-first-0": ({"omegas": (0, 30)}, "FieldError", "omega is zero"),
        "omega-hidden-0": ({"omegas": (30, 0)}, "FieldError", "omega is zero"),
    }
    out = {f"record-{name}": (with_records(record(**f)), error, words) for name, (f, error, words) in fields.items()}
    two = sections(record() * 2, frame(bytes(2 * rawfile.SIZE)))
    out |= {
        "record-wrong-in-the-second": (with_records(record() + record(role=7), 2), "FieldError", "DHF 1"),
        "records-one-more": (build(two), "SectionError", "32 bytes after its last DHF"),
        "records-one-less": (build(two, n_dhfs=3), "SectionError", "ends inside DHF 2"),
        "records-empty": (with_records(b""), "SectionError", "ends inside DHF 0"),
        "records-cut-in-head": (with_records(record()[:25]), "SectionError", "ends inside DHF 0"),
        "records-cut-in-steps": (with_records(record()[:-1]), "SectionError", "ends inside DHF 0"),
        "records-trailing-zero": (with_records(record() + b"\0"), "SectionError", "1 bytes after its last DHF"),
        "parameters-too-many": (with_records(BIG * 8, 8), "LimitError", "1061904 parameters"),
        "parameters-64-of-the-largest": (with_records(BIG * 64, 64), "LimitError", "8495232 parameters"),
    }
    return out


def section_tables() -> dict[str, tuple[bytes, str, str]]:
    full = sections(metadata=entry(1, b"me"))
    names = ("records", "weights", "metadata")
    out = {
        "section-length-over-the-end": (patched(VALID, 42, b"\xff\xff\xff\xff"), "TruncatedError", "announces"),
        "section-length-2-31": (patched(VALID, 42, b"\0\0\0\x80"), "TruncatedError", "announces"),
        "section-length-0": (patched(VALID, 42, bytes(4)), "TrailingDataError", "announces"),
        # The sum is right, but the records take a byte of the weights or leave them one of theirs.
        "sections-overlap-by-one": (
            patched(patched(build(), 42, struct.pack("<I", 33)), 48, struct.pack("<I", len(full[1][2]) - 1)),
            "SectionError",
            "1 bytes after its last DHF",
        ),
        "sections-gap-of-one": (
            patched(patched(build(), 42, struct.pack("<I", 31)), 48, struct.pack("<I", len(full[1][2]) + 1)),
            "SectionError",
            "ends inside DHF 0",
        ),
        "section-only-metadata": (build(full[2:]), "SectionError", "records section is missing"),
    }
    for kind in (0x00, 0x03, 0x7F):
        out[f"section-mandatory-{kind:02x}"] = (build([*full, (kind, 0, b"hello")]), "SectionError", f"kind {kind} is")
    for k, name in enumerate(names):
        if name != "metadata":
            gone = build([s for j, s in enumerate(full) if j != k])
            out[f"section-missing-{name}"] = (gone, "SectionError", f"the {name} section is missing")
        twice = build([*full, full[k]])
        out[f"section-twice-{name}"] = (twice, "SectionError", f"the {name} section appears 2 times")
        for codec in (3, 255):
            other = build([(s[0], codec, s[2]) if j == k else s for j, s in enumerate(full)])
            out[f"section-codec-{name}-{codec}"] = (other, "SectionError", f"the {name} section has codec {codec}")
    return out


def zstd_weights() -> dict[str, tuple[bytes, str, str]]:
    good = frame(RAW)
    eight = bytes([0xE0]) + struct.pack("<Q", 2**60) + b"\x01\x00\x00"  # eight bytes of content size
    wide = weights(frame(bytes(rawfile.SIZE - 2) + b"\x00\xff" * 2), records=record(codes=bytes([20] * 5 + [0x94])))
    no_size = "declares no size"
    bodies = {
        "empty": (b"", "not a zstd frame"),
        "one-byte": (b"\x20", "not a zstd frame"),
        "garbage": (b"garbage garbage garbage", "declares 26215 bytes"),
        "with-magic": (b"\x28\xb5\x2f\xfd" + good, "weights"),
        "cut": (good[:-1], "does not decompress"),
        "trailing-zero": (good + b"\0", "does not decompress"),
        "twice": (good * 2, "does not decompress"),
        "second-frame": (good + b"\x28\xb5\x2f\xfd" + frame(b"more"), "does not decompress"),
        "skippable-frame-after": (good + b"\x50\x2a\x4d\x18\0\0\0\0", "does not decompress"),
        "no-content-size": (frame(RAW, content_size=False), no_size),
        "one-less": (frame(RAW[:-1]), "declares 17 bytes"),
        "one-more": (frame(RAW + b"\0"), "declares 19 bytes"),
        "too-large": (frame(bytes(2**24)), "declares 16777216 bytes"),
        "needs-a-dictionary": (bytes([good[0] | 1, 7, *good[1:]]), "does not decompress"),
        "bomb-small-claim": (bomb(rawfile.SIZE, 2000), "does not decompress"),
        "bomb-large-claim": (bomb(2**31, 2000), "declares 2147483648 bytes"),
        "bomb-2-60": (eight, "declares 1152921504606846976 bytes"),
    }
    out = {f"zstd-{name}": (weights(body), "PayloadError", words) for name, (body, words) in bodies.items()}
    # Seven of the largest networks: large enough for whole blocks to pass one by one.
    seven = weights(bomb(7 * BIG_SIZE, 2000), records=BIG * 7, n_dhfs=7)
    out["zstd-bomb-that-outgrows-its-claim"] = (seven, "PayloadError", "does not decompress")
    out["zstd-symbol-32768"] = (wide, "FieldError", "symbol is below -32767")
    out["zstd-body-is-rans"] = (weights(CODED), "PayloadError", "weights")
    return out


def rans_weights() -> dict[str, tuple[bytes, str, str]]:
    n = len(SIZES)
    one_more = rans.encode([*TENSORS, np.array([1], dtype=np.int32)])
    wide_step = record(codes=bytes([20, 148, 20, 20, 20, 20]))
    bodies = {
        "empty": (b"", "ends inside its scale codes"),
        "cut-in-scale-codes": (CODED[: n - 1], "ends inside its scale codes"),
        "cut-in-state": (CODED[: n + 3], "ends inside its scale codes"),
        "cut-in-symbols": (CODED[:-1], "ends inside its symbols"),
        "no-stream": (CODED[: n + 4], "ends inside its symbols"),
        "trailing-zero": (CODED + b"\0", "goes on after its last symbol"),
        "twice": (CODED * 2, "goes on after its last symbol"),
        "scale-code-60": (bytes([60]) + CODED[1:], "scale code of the weights section is 60"),
        "scale-code-255": (CODED[: n - 1] + b"\xff" + CODED[n:], "scale code of the weights section is 127"),
        "state-zero": (CODED[:n] + bytes(4) + CODED[n + 4 :], "impossible state"),
        "state-below": (CODED[:n] + struct.pack("<I", 2**23 - 1) + CODED[n + 4 :], "impossible state"),
        "state-above": (CODED[:n] + struct.pack("<I", 2**31) + CODED[n + 4 :], "impossible state"),
        "one-symbol-too-many": (one_more[:n] + one_more[n + 1 :], "goes on after its last symbol"),
        "all-ones": (b"\x3b" * n + b"\xff\xff\xff\x7f" + b"\xff" * 60, "symbol is beyond 32767"),
        "symbol-32768": (beyond_the_largest_symbol(), "symbol is beyond 32767"),
        "rising-beyond-32767": (beyond_the_largest_symbol(16384), "symbol is beyond 32767"),
        "body-is-zstd": (frame(RAW), "weights section"),
    }
    out = {f"rans-{name}": (weights(b, RANS), "PayloadError", words) for name, (b, words) in bodies.items()}
    out["rans-wide-step"] = (weights(CODED, RANS, wide_step), "FieldError", "bit 7 set")
    out["rans-many-symbols-in-few-bytes"] = (weights(bytes(100), RANS, BIG), "LimitError", "132738 symbols")
    many = weights(bytes(60), RANS, BIG * 7, 7)
    out["rans-most-symbols-in-few-bytes"] = (many, "LimitError", "929166 symbols")
    return out


def metadata() -> dict[str, tuple[bytes, str, str]]:
    bodies = {
        "tag-twice": (entry(1, b"a") + entry(1, b"b"), "SectionError", "tag 1 twice"),
        "unknown-tag-twice": (entry(77, b"a") * 2, "SectionError", "tag 77 twice"),
        "ends-after-tag": (b"\x01", "SectionError", "ends inside an entry"),
        "ends-inside-value": (b"\x01\x05abcd", "SectionError", "ends inside an entry"),
        "ends-inside-second": (entry(1, b"a") + b"\x03\x01", "SectionError", "ends inside an entry"),
        "encoder-not-utf8": (entry(1, b"\xff\xfe"), "FieldError", "not UTF-8"),
        "source-surrogate": (entry(3, b"\xed\xa0\x80"), "FieldError", "not UTF-8"),
        "error-11-bytes": (entry(2, bytes(11)), "FieldError", "does not have 12 bytes"),
        "error-16-bytes": (entry(2, bytes(16)), "FieldError", "does not have 12 bytes"),
        "error-negative": (entry(2, struct.pack("<3f", 1, -1, 2)), "FieldError", "negative or not finite"),
        "error-nan": (entry(2, struct.pack("<3f", 1, math.nan, 2)), "FieldError", "negative or not finite"),
        "error-inf": (entry(2, struct.pack("<3f", math.inf, 1, 2)), "FieldError", "negative or not finite"),
    }
    return {f"metadata-{n}": (build(sections(metadata=b)), e, f"metadata.*{w}") for n, (b, e, w) in bodies.items()}


def control_mesh(faces: list[tuple[int, int, int]], largest: int = 60) -> bytes:
    """A surface section with these faces, whatever the encoder says of them."""
    at = np.arange(3 * (1 + max((max(f) for f in faces), default=-1)), dtype=np.int32).reshape(-1, 3) % 7
    at[-1:] = largest
    sharp = np.zeros((0, 2), dtype=np.int32)
    mesh = ControlMesh((0, 0, 0, 32767), 2.0**-6, at, np.array(faces, dtype=np.int32).reshape(-1, 3), sharp)
    fault, most = connectivity.fault, positions.MAX_POSITION
    connectivity.fault, positions.MAX_POSITION = lambda *_: None, 2 * most
    try:
        return encode_surface(mesh)
    finally:
        connectivity.fault, positions.MAX_POSITION = fault, most


def surfaces() -> dict[str, tuple[bytes, str, str]]:
    good = control_mesh([(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)])
    section, rest = (SURFACE, RANGE, good), good[5:]

    def head(flags: int = 0, step: float = 2.0**-6, quaternion: tuple[int, ...] = ()) -> bytes:
        return struct.pack("<Bf", flags, step) + struct.pack(f"<{len(quaternion)}h", *quaternion) + rest

    bodies = {
        "flags-bit-5": (head(0x20), "FieldError", "field flags is 32"),
        "flags-bit-6": (head(0x40), "FieldError", "field flags is 64"),
        "flags-bit-7": (head(0x80), "FieldError", "field flags is 128"),
        "eighths-9": (head(9), "FieldError", "field eighths is 9"),
        "eighths-15": (head(15), "FieldError", "field eighths is 15"),
        "step-zero": (head(step=0.0), "FieldError", "field step is 0"),
        "step-nan": (head(step=math.nan), "FieldError", "field step is nan"),
        "step-inf": (head(step=math.inf), "FieldError", "field step is inf"),
        "step-negative": (head(step=-(2.0**-6)), "FieldError", "field step is -0.01"),
        "step-too-large": (head(step=1.0000001), "FieldError", "field step is 1.0"),
        "step-too-small": (head(step=2.0**-31), "FieldError", "field step is 4.6"),
        "quaternion-zero": (head(16, quaternion=(0, 0, 0, 0)), "FieldError", "quaternion has norm 0"),
        "quaternion-long": (head(16, quaternion=(20000,) * 4), "FieldError", "quaternion has norm 40000"),
        "empty": (b"", "SectionError", "has 0 bytes"),
        "cut-in-head": (good[:4], "SectionError", "has 4 bytes"),
        "cut-in-quaternion": (head(16, quaternion=(0, 0, 0))[:11], "SectionError", "inside its quaternion"),
        "cut-in-the-stream": (good[:-6], "TruncatedError", "ends inside its symbols"),
        "trailing-zero": (good + b"\0", "PayloadError", "goes on after its last symbol"),
        "twice-in-one": (good + rest, "PayloadError", "goes on after its last symbol"),
        "no-faces": (control_mesh([]), "PayloadError", "no faces"),
        "faces-back-to-back": (
            control_mesh([(0, 1, 2), (0, 2, 1)]),
            "PayloadError",
            "not a two-manifold.*same vertices",
        ),
        "position-beyond": (
            control_mesh([(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)], 2**18 + 1),
            "PayloadError",
            "beyond 262144 grid units",
        ),
    }
    out = {
        name: (build_surface([(SURFACE, RANGE, body)]), error, words) for name, (body, error, words) in bodies.items()
    }
    parts = sections()
    out |= {
        "n-dhfs-1": (build_surface([section], n_dhfs=1), "FieldError", "n_dhfs is 1"),
        "in-version-0-1": (build([section]), "SectionError", "kind 3 is"),
        "and-records": (build_surface([section, parts[0]]), "SectionError", "a surface and double height fields"),
        "and-all-of-dhfs": (build_surface([*parts, section], n_dhfs=1), "SectionError", "a surface and double height"),
        "missing": (build_surface([(METADATA, 0, entry(1, b"me"))]), "LimitError", "n_dhfs is 0"),
        "missing-of-one-dhf": (
            build_surface([(METADATA, 0, entry(1, b"me"))], n_dhfs=1),
            "SectionError",
            "records section is missing",
        ),
        "codec-0": (build_surface([(SURFACE, 0, good)]), "SectionError", "surface section has codec 0"),
        "codec-2": (build_surface([(SURFACE, 2, good)]), "SectionError", "surface section has codec 2"),
        "twice": (build_surface([section, section]), "SectionError", "surface section appears 2 times"),
        "mandatory-04": (build_surface([section, (4, 0, b"hello")]), "SectionError", "kind 4 is"),
    }
    return {f"surface-{name}": row for name, row in out.items()}


def must_load() -> dict[str, tuple[bytes, str]]:
    rec, zstd, meta = sections(metadata=entry(3, b"a.obj"))
    extra = (0xFE, 9, b"something of a later version")
    unknown_tags = entry(200, b"new") + entry(1, b"") + entry(201, bytes(255))
    return {
        "valid": (VALID, "nothing is wrong with it"),
        "optional-unknown": (build([rec, zstd, meta, extra]), "an unknown optional section is skipped"),
        "optional-unknown-repeated-anywhere": (
            build([extra, zstd, extra, meta, rec, (0x80, 0, b"")]),
            "sections stand in any order, unknown optional ones may repeat",
        ),
        "optional-most": (build([rec, zstd] + [(0xFF, 255, b"x")] * 14), "16 sections are the most"),
        "no-metadata": (build([rec, zstd]), "metadata is optional"),
        "metadata-empty": (build([rec, zstd, (0x81, 0, b"")]), "metadata may be empty"),
        "metadata-unknown-tags": (build(sections(metadata=unknown_tags)), "unknown tags are skipped"),
        "scale-smallest": (build(scale=2.0**-100), "the least scale"),
        "scale-largest": (build(scale=2.0**100), "the largest scale"),
        "centre-largest": (build(centre=(2.0**100, -(2.0**100), 2.0**100)), "the largest centre"),
        "quaternion-32000": (build(sections(record(quaternion=(0, 0, 0, 32000)))), "the shortest quaternion"),
        "quaternion-minus-32768": (build(sections(record(quaternion=(0, 0, 0, -32768)))), "the least int16"),
        "box-widest": (build(sections(record(box=(-32768, 32767) * 3))), "the widest box"),
        "box-narrowest": (build(sections(record(box=(0, 1) * 3))), "the narrowest box"),
        "fold-both": (build(sections(record(fold=3))), "mirrored in u and in v"),
        "omega-255": (build(sections(record(omegas=(255, 255)))), "the largest omegas"),
        "rans": (weights(CODED, RANS), "codec 2"),
        "zstd-with-checksum": (weights(frame(RAW, checksum=True)), "a frame may have a checksum of its own"),
    }


def write(folder: Path, rows: dict[str, tuple]) -> None:
    folder.mkdir(exist_ok=True)
    for name, (data, *_) in rows.items():
        path = folder / f"{name}.cndhf"
        if not path.exists():  # a frozen file stays, though this code and the writer's may make other bytes today
            path.write_bytes(data)
    lines = sorted("\t".join([f"{name}.cndhf", *rest]) for name, (_, *rest) in rows.items())
    (folder / "index.tsv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    groups = (headers(), records(), section_tables(), zstd_weights(), rans_weights(), surfaces(), metadata())
    write(HERE, {name: row for group in groups for name, row in group.items()})
    write(HERE.parent / "must_load", must_load())
