"""The files of spec/vectors that each abuse the format in one way, and those that look odd but are right.

`spec_vectors.py` writes them. Each file, its checksum included, is right except for the one thing that its name says.
"""

from __future__ import annotations

import math
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import rawfile
from rawfile import (
    ENCODER,
    ERRORS,
    RANS,
    SOURCE,
    SURFACE,
    ZSTD,
    build,
    fields,
    frame,
    head,
    length,
    record,
    seal,
)

from cndhf_codec.format import ControlMesh, rans
from cndhf_codec.format.surface import connectivity, positions
from cndhf_codec.format.surface.section import encode_surface

SIZES = [4, 2, 4, 2, 4, 2]  # tensors of the smallest record
TENSORS = [
    np.array(v, dtype=np.int32) for v in ([0, -1, 1, -2], [2, -3], [3, -4, 4, -5], [5, -6], [6, -7, 7, -8], [8, -9])
]
RAW = bytes(range(rawfile.SIZE))  # the same as one byte a symbol
ME = (ENCODER, b"me")
VALID = build([fields(), ME])
CODED = rans.encode(TENSORS)
LARGEST = 1.7976931348623157e308
BIG = record(width=128, hidden=8)
BIG_SIZE = 8 * 128 * 129 + 5 * 128 + 2


def weights(body: bytes, kind: int = ZSTD, records: bytes | None = None, n_dhfs: int = 1) -> bytes:
    return build([fields(records, body, kind, n_dhfs)])


def unsealed(*parts: bytes, **changes: Any) -> bytes:
    """A file with a correct checksum whose sections are written out."""
    return seal(head(**changes) + b"".join(parts))


def bomb(declared: int, blocks: int) -> bytes:
    """A frame that declares `declared` bytes and whose 4-byte run-length blocks hold 128 KiB each."""
    out = bytes([0xA0]) + struct.pack("<I", declared)
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
    damaged = "damaged or incomplete"
    old = bytes.fromhex("89444846 0d0a1a0a 0002 0100") + bytes(24) + bytes.fromhex("0000803f") + bytes(30)
    out = {
        "empty": (b"", "TruncatedError", "after 0 bytes"),
        "cut-in-signature": (VALID[:3], "TruncatedError", "inside the signature"),
        "cut-before-version": (VALID[:4], "TruncatedError", "inside its header"),
        "cut-in-centre": (VALID[:9], "TruncatedError", "inside its header"),
        "cut-in-scale": (seal(VALID[:21]), "TruncatedError", "inside its header"),
        "cut-in-far-centre": (seal(head(flags=1)[:30]), "TruncatedError", "inside its header"),
        "cut-in-a-section": (VALID[:40], "ChecksumError", damaged),
        "cut-in-checksum": (VALID[:-1], "ChecksumError", damaged),
        "other-png": (b"\x89PNG\r\n\x1a\n" + bytes(60), "SignatureError", "not a .cndhf file"),
        "other-ply": (b"ply\nformat ascii 1.0\n", "SignatureError", "not a .cndhf file"),
        "other-zeros": (bytes(100), "SignatureError", "not a .cndhf file"),
        "text-seven-bit": (bytes(b & 0x7F for b in VALID), "TextModeError", "transfer of text"),
        "text-latin-1-to-utf-8": (VALID.decode("latin-1").encode(), "TextModeError", "transfer of text"),
        "text-replacement-character": (VALID.decode("utf-8", "replace").encode(), "TextModeError", "transfer of text"),
        "text-lf-to-crlf": (build([fields(), (SOURCE, b"a\nb")]).replace(b"\n", b"\r\n"), "ChecksumError", damaged),
        "checksum-flipped": (VALID[:-4] + bytes(b ^ 0xFF for b in VALID[-4:]), "ChecksumError", damaged),
        "checksum-zero": (VALID[:-4] + bytes(4), "ChecksumError", damaged),
        "checksum-of-another-file": (VALID[:-4] + build()[-4:], "ChecksumError", damaged),
        "trailing-zero": (VALID + b"\0", "ChecksumError", damaged),
        "trailing-newline": (VALID + b"\n", "ChecksumError", damaged),
        "trailing-second-file": (VALID + VALID, "ChecksumError", damaged),
        "flags-bit-1": (unsealed(flags=2), "FieldError", "field flags is 2"),
        "flags-bit-7": (unsealed(flags=128), "FieldError", "field flags is 128"),
        "version-0.1": (old[:9] + b"\x01" + old[10:], "VersionError", "format 0.x; encode the source mesh again"),
        "version-0.2": (old, "VersionError", "format 0.x; encode the source mesh again"),
        "version-0.2-cut": (old[:5], "VersionError", "format 0.x; encode the source mesh again"),
        # A newer file may have another layout: the version has to be said before anything else is looked at.
        "version-2-of-another-layout": (VALID[:4] + b"\x02", "VersionError", "version 2; this decoder reads 1"),
    }
    for version in (0, 2, 10, 255):
        out[f"version-{version}"] = (build(version=version), "VersionError", f"version {version}; this decoder reads 1")
    for name, value in (
        ("nan", math.nan),
        ("inf", math.inf),
        ("minus-inf", -math.inf),
        ("largest-float", LARGEST),
        ("below-2-100", -(2.0**100) * 1.000001),
    ):
        for axis in range(3):
            centre = [value if k == axis else 0.0 for k in range(3)]
            out[f"far-centre-{'xyz'[axis]}-{name}"] = (build(centre=centre, flags=1), "FieldError", "field centre is")
            if value != LARGEST:
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
        return build([fields(body, n_dhfs=n_dhfs)])

    wrong: dict[str, tuple[dict, str, str]] = {
        "width-0": ({"width": 0}, "LimitError", "width is 0"),
        "width-129": ({"width": 129}, "LimitError", "width is 129"),
        "width-255": ({"width": 255}, "LimitError", "width is 255"),
        "hidden-0": ({"hidden": 0}, "LimitError", "hidden_layers is 0"),
        "hidden-9": ({"hidden": 9}, "LimitError", "hidden_layers is 9"),
        "hidden-255": ({"hidden": 255, "codes": b""}, "LimitError", "hidden_layers is 255"),
        "fold-4": ({"fold": 4}, "FieldError", "fold is 4"),
        "fold-255": ({"fold": 255}, "FieldError", "fold is 255"),
        "quaternion-zero": ({"quaternion": (0, 0, 0, 0)}, "FieldError", "quaternion has norm 0"),
        "quaternion-short": ({"quaternion": (0, 0, 0, 31999)}, "FieldError", "quaternion has norm 31999"),
        "quaternion-long": ({"quaternion": (20000, 20000, 20000, 20000)}, "FieldError", "quaternion has norm 40000"),
        "quaternion-just-short": ({"quaternion": (19200, 25599, 226, 11)}, "FieldError", "quaternion has norm 32000"),
        "quaternion-just-long": ({"quaternion": (26400, 19800, 1, 0)}, "FieldError", "quaternion has norm 33000"),
        "quaternion-longest": ({"quaternion": (-32768,) * 4}, "FieldError", "quaternion has norm 65536"),
        "box-u-empty": ({"box": (5, 5, -1, 1, -1, 1)}, "FieldError", "along u"),
        "box-v-reversed": ({"box": (-1, 1, 2, 1, -1, 1)}, "FieldError", "along v"),
        "box-z-empty": ({"box": (-1, 1, -1, 1, 0, 0)}, "FieldError", "along z"),
        "box-z-reversed": ({"box": (-1, 1, -1, 1, 32767, -32768)}, "FieldError", "along z"),
        "omega-first-0": ({"omegas": (0, 30)}, "FieldError", "omega is zero"),
        "omega-hidden-0": ({"omegas": (30, 0)}, "FieldError", "omega is zero"),
    }
    out = {f"record-{name}": (with_records(record(**f)), error, words) for name, (f, error, words) in wrong.items()}
    two = record() * 2
    out |= {
        "n-dhfs-0": (with_records(record(), 0), "LimitError", "n_dhfs is 0"),
        "n-dhfs-65": (with_records(record() * 65, 65), "LimitError", "n_dhfs is 65"),
        "n-dhfs-255": (with_records(record(), 255), "LimitError", "n_dhfs is 255"),
        "record-wrong-in-the-second": (with_records(record() + record(fold=7), 2), "FieldError", "DHF 1"),
        # The second record is taken for a frame, or the frame for the third record.
        "records-one-more": (with_records(two), "PayloadError", "frame descriptor of the weights is 0"),
        "records-one-less": (with_records(two, 3), "TruncatedError", "end inside DHF 2"),
        "records-empty": (build([(ZSTD, b"")]), "TruncatedError", "end before DHF 0"),
        "records-missing": (build([(ZSTD, b"\x01")]), "TruncatedError", "end inside DHF 0"),
        "records-cut-in-head": (build([(ZSTD, b"\x01" + record()[:24])]), "TruncatedError", "end inside DHF 0"),
        "records-cut-in-steps": (build([(ZSTD, b"\x01" + record()[:-1])]), "TruncatedError", "end inside DHF 0"),
        "parameters-too-many": (with_records(BIG * 8, 8), "LimitError", "1061904 parameters"),
        "parameters-64-of-the-largest": (with_records(BIG * 64, 64), "LimitError", "8495232 parameters"),
    }
    return out


def containers() -> dict[str, tuple[bytes, str, str]]:
    kind, body = fields()
    beyond = "goes on beyond the end"
    whole = bytes([kind]) + length(len(body)) + body
    out = {
        "no-sections": (build([]), "SectionError", "holds no shape"),
        "only-metadata": (build([ME]), "SectionError", "holds no shape"),
        "only-unknown": (build([(0x90, b"hello")]), "SectionError", "holds no shape"),
        "kind-without-length": (unsealed(whole, b"\x90"), "TruncatedError", beyond),
        "length-cut": (unsealed(whole, b"\x90\x80"), "TruncatedError", beyond),
        "length-one-more": (unsealed(bytes([kind]), length(len(body) + 1), body), "TruncatedError", beyond),
        "length-into-the-checksum": (unsealed(bytes([kind]), length(len(body) + 4), body), "TruncatedError", beyond),
        "length-2-28": (unsealed(whole, b"\x90\xff\xff\xff\x7f"), "TruncatedError", beyond),
        "length-of-five-bytes": (unsealed(whole, b"\x90\x80\x80\x80\x80\x00"), "SectionError", "more than 4 bytes"),
        "length-of-endless-bytes": (unsealed(whole, b"\x90" + b"\xff" * 40), "SectionError", "more than 4 bytes"),
        "length-not-shortest": (unsealed(whole, b"\x90\x80\x00"), "SectionError", "more bytes than it needs"),
        "length-of-the-shape-not-shortest": (
            unsealed(bytes([kind, len(body) | 0x80, 0x80, 0]), body),
            "SectionError",
            "more bytes than it needs",
        ),
        "17-sections": (build([fields()] + [(0x90, b"")] * 16), "LimitError", "more than 16 sections"),
        "zero-behind-the-sections": (unsealed(whole, b"\0"), "TruncatedError", beyond),
        "two-shapes-zstd-and-rans": (build([fields(), fields(weights=CODED, kind=RANS)]), "SectionError", "two shapes"),
        "shape-twice": (build([fields(), fields()]), "SectionError", "2 sections of kind 1"),
        "length-one-less": (
            unsealed(bytes([kind]), length(len(body) - 1), body[:-1], bytes([0x90, 0])),
            "PayloadError",
            "do not decompress",
        ),
    }
    for kind in (0x00, 0x04, 0x7F):
        out[f"mandatory-{kind:02x}"] = (build([fields(), (kind, b"hello")]), "SectionError", f"kind {kind}, which")
    for name, kind, value in (("encoder", ENCODER, b"me"), ("errors", ERRORS, bytes(6)), ("source", SOURCE, b"a.obj")):
        twice = build([fields(), (kind, value), (kind, value)])
        out[f"twice-{name}"] = (twice, "SectionError", f"2 sections of kind {kind}")
    return {f"sections-{name}": row for name, row in out.items()}


def zstd_weights() -> dict[str, tuple[bytes, str, str]]:
    good = frame(RAW)
    eight = bytes([0xE0]) + struct.pack("<Q", 2**60) + b"\x01\x00\x00"  # eight bytes of content size
    window = bytes([0x40, 0x38]) + struct.pack("<H", 0) + good[2:]  # not one segment: it has a window
    descriptor = "frame descriptor of the weights is"
    wide = weights(frame(bytes(rawfile.SIZE - 2) + b"\x00\xff" * 2), records=record(codes=bytes([20] * 5 + [0x94])))
    bodies = {
        "empty": (b"", "descriptor of the weights is missing"),
        "one-byte": (b"\x20", "not a zstd frame"),
        "garbage": (b"garbage garbage garbage", f"{descriptor} 103"),
        "with-magic": (b"\x28\xb5\x2f\xfd" + good, f"{descriptor} 40"),
        "with-checksum": (frame(RAW, checksum=True), f"{descriptor} 36"),
        "with-a-window": (window, f"{descriptor} 64"),
        "unused-bit": (bytes([0x30]) + good[1:], f"{descriptor} 48"),
        "reserved-bit": (bytes([0x28]) + good[1:], f"{descriptor} 40"),
        "cut": (good[:-1], "do not decompress"),
        "trailing-zero": (good + b"\0", "do not decompress"),
        "twice": (good * 2, "do not decompress"),
        "second-frame": (good + b"\x28\xb5\x2f\xfd" + frame(b"more"), "do not decompress"),
        "skippable-frame-after": (good + b"\x50\x2a\x4d\x18\0\0\0\0", "do not decompress"),
        "no-content-size": (frame(RAW, content_size=False), f"{descriptor} 0"),
        "one-less": (frame(RAW[:-1]), "declares 17 bytes"),
        "one-more": (frame(RAW + b"\0"), "declares 19 bytes"),
        "too-large": (frame(bytes(2**16)), "declares 65536 bytes"),
        "needs-a-dictionary": (bytes([good[0] | 1, 7, *good[1:]]), f"{descriptor} 33"),
        "bomb-small-claim": (bomb(rawfile.SIZE, 2000), "do not decompress"),
        "bomb-large-claim": (bomb(2**31, 20), "declares 2147483648 bytes"),
        "bomb-2-60": (eight, f"{descriptor} 224"),
    }
    out = {f"zstd-{name}": (weights(body), "PayloadError", words) for name, (body, words) in bodies.items()}
    # Seven of the largest networks: large enough for whole blocks to pass one by one.
    seven = weights(bomb(7 * BIG_SIZE, 2000), records=BIG * 7, n_dhfs=7)
    out["zstd-bomb-that-outgrows-its-claim"] = (seven, "PayloadError", "do not decompress")
    out["zstd-symbol-32768"] = (wide, "FieldError", "symbol is below -32767")
    out["zstd-body-is-rans"] = (weights(CODED), "PayloadError", "weights")
    return out


def rans_weights() -> dict[str, tuple[bytes, str, str]]:
    n = len(SIZES)
    one_more = rans.encode([*TENSORS, np.array([1], dtype=np.int32)])
    wide_step = record(codes=bytes([20, 148, 20, 20, 20, 20]))
    bodies = {
        "empty": (b"", "end inside their scale codes"),
        "cut-in-scale-codes": (CODED[: n - 1], "end inside their scale codes"),
        "cut-in-state": (CODED[: n + 3], "end inside their scale codes"),
        "cut-in-symbols": (CODED[:-1], "end inside their symbols"),
        "no-stream": (CODED[: n + 4], "end inside their symbols"),
        "trailing-zero": (CODED + b"\0", "go on after their last symbol"),
        "twice": (CODED * 2, "go on after their last symbol"),
        "scale-code-60": (bytes([60]) + CODED[1:], "scale code of the weights is 60"),
        "scale-code-255": (CODED[: n - 1] + b"\xff" + CODED[n:], "scale code of the weights is 127"),
        "state-zero": (CODED[:n] + bytes(4) + CODED[n + 4 :], "impossible state"),
        "state-below": (CODED[:n] + struct.pack("<I", 2**23 - 1) + CODED[n + 4 :], "impossible state"),
        "state-above": (CODED[:n] + struct.pack("<I", 2**31) + CODED[n + 4 :], "impossible state"),
        "one-symbol-too-many": (one_more[:n] + one_more[n + 1 :], "go on after their last symbol"),
        "all-ones": (b"\x3b" * n + b"\xff\xff\xff\x7f" + b"\xff" * 60, "symbol is beyond 32767"),
        "symbol-32768": (beyond_the_largest_symbol(), "symbol is beyond 32767"),
        "rising-beyond-32767": (beyond_the_largest_symbol(16384), "symbol is beyond 32767"),
        "body-is-zstd": (frame(RAW), "weights"),
    }
    out = {f"rans-{name}": (weights(b, RANS), "PayloadError", words) for name, (b, words) in bodies.items()}
    out["rans-wide-step"] = (weights(CODED, RANS, wide_step), "FieldError", "bit 7 set")
    out["rans-many-symbols-in-few-bytes"] = (weights(bytes(100), RANS, BIG), "LimitError", "132738 symbols")
    many = weights(bytes(60), RANS, BIG * 7, 7)
    out["rans-most-symbols-in-few-bytes"] = (many, "LimitError", "929166 symbols")
    return out


def metadata() -> dict[str, tuple[bytes, str, str]]:
    unusual = "an error is negative or not finite"
    bodies = {
        "encoder-not-utf8": (ENCODER, b"\xff\xfe", "not UTF-8"),
        "encoder-256-bytes": (ENCODER, b"x" * 256, "256 bytes"),
        "source-surrogate": (SOURCE, b"\xed\xa0\x80", "not UTF-8"),
        "source-256-bytes": (SOURCE, b"x" * 256, "256 bytes"),
        "errors-empty": (ERRORS, b"", "0 bytes"),
        "errors-5-bytes": (ERRORS, bytes(5), "5 bytes"),
        "errors-7-bytes": (ERRORS, bytes(7), "7 bytes"),
        "errors-negative": (ERRORS, struct.pack("<3H", 0x3F80, 0xBF80, 0x4000), unusual),
        "errors-minus-zero": (ERRORS, struct.pack("<3H", 0x8000, 0x3F80, 0x4000), unusual),
        "errors-nan": (ERRORS, struct.pack("<3H", 0x3F80, 0x4000, 0x7FC0), unusual),
        "errors-inf": (ERRORS, struct.pack("<3H", 0x7F80, 0x3F80, 0x4000), unusual),
    }
    return {
        f"metadata-{name}": (build([fields(), (kind, body)]), "FieldError", f"metadata.*{words}")
        for name, (kind, body, words) in bodies.items()
    }


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
    rest = good[3:]

    def head(flags: int = 0, step: int = 0x3C80, quaternion: tuple[int, ...] = ()) -> bytes:
        return struct.pack("<BH", flags, step) + struct.pack(f"<{len(quaternion)}h", *quaternion) + rest

    bodies = {
        "flags-bit-6": (head(0x40), "FieldError", "field flags is 64"),
        "flags-bit-7": (head(0x80), "FieldError", "field flags is 128"),
        "eighths-9": (head(9), "FieldError", "field eighths is 9"),
        "eighths-15": (head(15), "FieldError", "field eighths is 15"),
        "step-zero": (head(step=0), "FieldError", "field step is 0"),
        "step-nan": (head(step=0x7FC0), "FieldError", "field step is nan"),
        "step-inf": (head(step=0x7F80), "FieldError", "field step is inf"),
        "step-negative": (head(step=0xBC80), "FieldError", "field step is -0.01"),
        "step-too-large": (head(step=0x3F81), "FieldError", "field step is 1.0"),
        "step-too-small": (head(step=0x307F), "FieldError", "field step is 9.2"),
        "quaternion-zero": (head(16, quaternion=(0, 0, 0, 0)), "FieldError", "quaternion has norm 0"),
        "quaternion-long": (head(16, quaternion=(20000,) * 4), "FieldError", "quaternion has norm 40000"),
        "empty": (b"", "SectionError", "has 0 bytes"),
        "cut-in-head": (good[:2], "SectionError", "has 2 bytes"),
        "cut-in-quaternion": (head(16, quaternion=(0, 0, 0))[:9], "SectionError", "inside its quaternion"),
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
    section = (SURFACE, good)
    out = {name: (build([(SURFACE, body)]), error, words) for name, (body, error, words) in bodies.items()}
    out |= {
        "and-fields": (build([section, fields()]), "SectionError", "two shapes"),
        "twice": (build([section, section]), "SectionError", "2 sections of kind 3"),
        "mandatory-04": (build([section, (4, b"hello")]), "SectionError", "kind 4, which"),
    }
    return {f"surface-{name}": row for name, row in out.items()}


def accepted() -> dict[str, tuple[bytes, str]]:
    zstd, source = fields(), (SOURCE, b"a.obj")
    extra = (0xFE, b"something of a later version")
    large = (0xFE, bytes(200))

    def of(**changes: Any) -> bytes:
        return build([fields(record(**changes))])

    return {
        "valid": (VALID, "nothing is wrong with it"),
        "optional-unknown": (build([zstd, source, extra]), "an unknown optional section is skipped"),
        "optional-unknown-repeated-anywhere": (
            build([extra, source, large, extra, zstd, ME, (0x80, b"")]),
            "sections stand in any order, unknown optional ones may repeat",
        ),
        "optional-most": (build([zstd] + [(0xFF, b"x")] * 15), "16 sections are the most"),
        "no-metadata": (build(), "metadata is optional"),
        "texts-empty": (build([zstd, (ENCODER, b""), (SOURCE, b"")]), "texts may be empty"),
        "texts-longest": (build([zstd, (ENCODER, b"x" * 255), (SOURCE, b"x" * 255)]), "the longest texts"),
        "errors-zero": (build([zstd, (ERRORS, bytes(6))]), "errors may be zero"),
        "errors-largest": (build([zstd, (ERRORS, b"\x7f\x7f" * 3)]), "the largest errors"),
        "scale-smallest": (build(scale=2.0**-100), "the least scale"),
        "scale-largest": (build(scale=2.0**100), "the largest scale"),
        "centre-largest": (build(centre=(2.0**100, -(2.0**100), 2.0**100)), "the largest centre"),
        "far-centre-largest": (build(centre=(2.0**100, -(2.0**100), 1e-300), flags=1), "the largest centre, in f64"),
        "quaternion-32000": (of(quaternion=(0, 0, 0, 32000)), "the shortest quaternion"),
        "quaternion-33000": (of(quaternion=(19800, 0, 0, 26400)), "the longest quaternion"),
        "quaternion-minus-32768": (of(quaternion=(0, 0, 0, -32768)), "the least int16"),
        "box-widest": (of(box=(-32768, 32767) * 3), "the widest box"),
        "box-narrowest": (of(box=(0, 1) * 3), "the narrowest box"),
        "fold-both": (of(fold=3), "mirrored in u and in v"),
        "omega-255": (of(omegas=(255, 255)), "the largest omegas"),
        "rans": (weights(CODED, RANS), "codec 2"),
        "zstd-size-of-4-bytes": (
            weights(bytes([0xA0]) + struct.pack("<I", rawfile.SIZE) + frame(RAW)[2:]),
            "a frame may state its size in 4 bytes",
        ),
    }


def refused() -> dict[str, tuple[bytes, str, str, str]]:
    """By name: the file, the section of the specification that refuses it, the error's class, words of its message."""
    groups = {"1.1": headers, "1.2": containers, "2": records, "3.1": zstd_weights, "3.2": rans_weights, "4": surfaces}
    groups["5"] = metadata
    out = {}
    for section, group in groups.items():
        for name, (data, error, words) in group().items():
            out[name] = data, "1.3" if error == "ChecksumError" else section, error, words
    return out
