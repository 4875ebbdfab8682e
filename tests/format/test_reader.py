"""Every way a file can be wrong has its named error, and a valid one means what the bytes say."""

from __future__ import annotations

import math
import struct
import tracemalloc

import numpy as np
import pytest
import rawfile
import zstandard
from rawfile import build, entry, frame, record, sections

from cndhf_codec.errors import (
    ChecksumError,
    FieldError,
    FormatError,
    LimitError,
    PayloadError,
    SectionError,
    SignatureError,
    TextModeError,
    TrailingDataError,
    TruncatedError,
    VersionError,
)
from cndhf_codec.format import Metadata, loads, read_header

VALID = build(sections(metadata=entry(1, b"me")))


def test_reads_hand_made_bytes():
    box = (-100, 200, -300, 400, -500, 600)
    data = build(
        sections(
            record(quaternion=(32767, 0, 0, 0), box=box, omegas=(31, 7), codes=bytes([1, 2, 3, 4, 5, 127])),
            metadata=entry(1, b"me 1.0") + entry(2, struct.pack("<3f", 0.25, 0.5, 2)) + entry(3, "ü".encode()),
        ),
        centre=(1.5, -2.0, 1e6),
        scale=0.125,
    )
    c = loads(data)
    assert (c.centre, c.scale) == ((1.5, -2.0, 1e6), 0.125)
    assert c.metadata == Metadata("me 1.0", 0.25, 0.5, 2.0, "ü")
    (d,) = c.dhfs
    assert (d.quaternion, d.box) == ((32767, 0, 0, 0), box)
    assert (d.width, d.hidden_layers, d.omega_first, d.omega_hidden) == (2, 1, 31, 7)
    assert d.step_codes == (1, 2, 3, 4, 5, 127)
    # Bytes 0, 1, 2, ... are the symbols 0, -1, 1, -2, 2, ... in the order W0, b0, W1, b1, W2, b2.
    assert [s.tolist() for s in d.symbols] == [
        [[0, -1], [1, -2]],
        [2, -3],
        [[3, -4], [4, -5]],
        [5, -6],
        [[6, -7], [7, -8]],
        [8, -9],
    ]
    # A step code of 4 k is a step of 2^-k; here 2 * 2^(-1/2) and -3 * 2^(-1/2).
    assert d.weights()[1] == pytest.approx([2 * 2**-0.5, -3 * 2**-0.5])


def test_high_bytes_of_wide_tensors_follow_all_low_bytes():
    # Tensors 1 and 5 (two symbols each) are wide; zigzag 0x0100 is 128, 0x0201 is -257, 0xfffe is 32767.
    low = bytearray(rawfile.SIZE)
    low[4:6] = b"\x00\x01"
    low[16:18] = b"\xfe\xfd"
    raw = bytes(low) + b"\x01\x02" + b"\xff\xff"
    codes = bytes([20, 20 | 0x80, 20, 20, 20, 20 | 0x80])
    (d,) = loads(build(sections(record(codes=codes), frame(raw)))).dhfs
    assert d.symbols[1].tolist() == [128, -257]
    assert d.symbols[5].tolist() == [32767, -32767]
    assert d.step_codes == (20,) * 6


def test_symbol_below_the_range_is_refused():
    codes = bytes([20] * 5 + [0x80 | 20])
    raw = bytes(rawfile.SIZE - 2) + b"\x00\xff" + b"\x00\xff"  # zigzag 0xffff is -32768
    with pytest.raises(FieldError, match="symbol"):
        loads(build(sections(record(codes=codes), frame(raw))))


def test_read_header_needs_no_decompression():
    header = read_header(build(sections(weights=b"not zstd at all"), centre=(1, 2, 3), scale=4))
    assert header.version == (0, 1)
    assert (header.n_dhfs, header.centre, header.scale) == (1, (1, 2, 3), 4)
    assert [(s.kind, s.codec, s.offset, s.length) for s in header.sections] == [(1, 0, 52, 32), (2, 1, 84, 15)]


def test_every_truncation_is_named():
    for length in range(len(VALID)):
        with pytest.raises(TruncatedError):
            loads(VALID[:length])


@pytest.mark.parametrize("extra", [b"\0", b"\n", VALID])
def test_trailing_bytes(extra):
    with pytest.raises(TrailingDataError):
        loads(VALID + extra)


def test_a_flipped_byte_is_found_everywhere():
    for at in range(len(VALID)):
        damaged = bytearray(VALID)
        damaged[at] ^= 0xFF
        with pytest.raises(FormatError):
            loads(bytes(damaged))


def test_a_flipped_bit_behind_the_table_is_a_checksum_error():
    for at in range(12, 40):  # centre and scale
        for bit in range(8):
            damaged = bytearray(VALID)
            damaged[at] ^= 1 << bit
            with pytest.raises(ChecksumError):
                loads(bytes(damaged))


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data.replace(b"\r\n", b"\n"),
        lambda data: data.replace(b"\n", b"\r\n"),
        lambda data: data.replace(b"\r", b"\n"),
        lambda data: bytes(b & 0x7F for b in data),
        lambda data: data.split(b"\x1a")[0],  # DOS end of file
    ],
    ids=["crlf-to-lf", "lf-to-crlf", "cr-to-lf", "seven-bit", "dos-eof"],
)
def test_text_mode_damage(damage):
    with pytest.raises((TextModeError, TruncatedError)) as caught:
        loads(damage(VALID))
    if len(damage(VALID)) > 8:
        assert caught.type is TextModeError


@pytest.mark.parametrize("data", [b"PNG", b"ply\nformat ascii 1.0\n", b"\x89PNG\r\n\x1a\n" + bytes(60), bytes(100)])
def test_other_files(data):
    with pytest.raises(SignatureError) as caught:
        loads(data)
    assert caught.type is SignatureError


@pytest.mark.parametrize("version", [(1, 0), (255, 0), (0, 0), (0, 2)])
def test_unknown_version(version):
    with pytest.raises(VersionError, match=rf"version {version[0]}\.{version[1]}"):
        loads(build(version=version))


def test_version_is_named_even_when_the_rest_makes_no_sense():
    # A newer file may have another layout: the version has to be said before anything else is looked at.
    with pytest.raises(VersionError):
        loads(build(version=(3, 0), n_sections=0)[:60])


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({"n_dhfs": 0}, "n_dhfs"),
        ({"n_dhfs": 65}, "n_dhfs"),
        ({"parts": [], "n_sections": 0}, "n_sections"),
        ({"parts": sections() + [(0x90, 0, b"")] * 15}, "n_sections"),
    ],
)
def test_counts_in_the_header(fields, name):
    with pytest.raises(LimitError, match=name):
        loads(build(**fields))


@pytest.mark.parametrize("scale", [0.0, -1.0, math.nan, math.inf, -math.inf])
def test_scale(scale):
    with pytest.raises(FieldError, match="scale"):
        loads(build(scale=scale))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("axis", range(3))
def test_centre(value, axis):
    centre = [0.0, 0.0, 0.0]
    centre[axis] = value
    with pytest.raises(FieldError, match="centre"):
        loads(build(centre=centre))


@pytest.mark.parametrize(
    ("fields", "error", "name"),
    [
        ({"width": 0}, LimitError, "width"),
        ({"width": 129}, LimitError, "width"),
        ({"hidden": 0}, LimitError, "hidden_layers"),
        ({"hidden": 9}, LimitError, "hidden_layers"),
        ({"role": 1}, FieldError, "role"),
        ({"part": 1}, FieldError, "part"),
        ({"quaternion": (0, 0, 0, 0)}, FieldError, "quaternion"),
        ({"quaternion": (0, 0, 0, 31999)}, FieldError, "quaternion"),
        ({"quaternion": (20000, 20000, 20000, 20000)}, FieldError, "quaternion"),
        ({"box": (5, 5, -1, 1, -1, 1)}, FieldError, "along u"),
        ({"box": (-1, 1, 2, 1, -1, 1)}, FieldError, "along v"),
        ({"box": (-1, 1, -1, 1, 0, 0)}, FieldError, "along z"),
        ({"omegas": (0, 30)}, FieldError, "omega"),
        ({"omegas": (30, 0)}, FieldError, "omega"),
    ],
)
def test_fields_of_a_record(fields, error, name):
    with pytest.raises(error, match=name):
        loads(build(sections(record(**fields))))


def test_the_record_that_is_wrong_is_numbered():
    with pytest.raises(FieldError, match="DHF 1"):
        loads(build(sections(record() + record(role=7)), n_dhfs=2))


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 32000), (0, 0, 0, -32768), (16384, 16384, -16384, 16384)])
def test_quaternions_near_unit_length_are_read(quaternion):
    assert loads(build(sections(record(quaternion=quaternion)))).dhfs[0].quaternion == quaternion


def test_parameter_limit_is_checked_before_the_weights():
    # Eight networks of 128 x 128 x 8 hidden layers: 1,062,160 parameters, 16 bytes of weights.
    big = record(width=128, hidden=8)
    with pytest.raises(LimitError, match="parameters"):
        loads(build(sections(big * 8, b"x" * 16), n_dhfs=8))


@pytest.mark.parametrize("n_dhfs", [1, 3])
def test_records_of_another_count_than_announced(n_dhfs):
    with pytest.raises(SectionError, match="records"):
        loads(build(sections(record() * 2, frame(bytes(2 * rawfile.SIZE))), n_dhfs=n_dhfs))


def test_records_cut_short():
    for length in range(len(record())):
        with pytest.raises(SectionError, match="records"):
            loads(build(sections(record()[:length])))


@pytest.mark.parametrize("gone", [0, 1])
def test_missing_section(gone):
    with pytest.raises(SectionError, match="missing"):
        loads(build([s for k, s in enumerate(sections()) if k != gone]))


@pytest.mark.parametrize("twice", [0, 1, 2])
def test_repeated_section(twice):
    parts = sections(metadata=b"")
    with pytest.raises(SectionError, match="2 times"):
        loads(build([*parts, parts[twice]]))


@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("codec", [3, 255])
def test_unknown_codec(which, codec):
    parts = sections(metadata=b"")
    parts[which] = (parts[which][0], codec, parts[which][2])
    with pytest.raises(SectionError, match=f"codec {codec}"):
        loads(build(parts))


@pytest.mark.parametrize("kind", [0x00, 0x03, 0x7F])
def test_unknown_mandatory_section_is_refused(kind):
    with pytest.raises(SectionError, match=f"kind {kind}"):
        loads(build([*sections(), (kind, 0, b"hello")]))


def test_unknown_optional_sections_are_skipped_wherever_they_stand():
    records, weights, metadata = sections(metadata=entry(3, b"a.obj"))
    extra = (0xFE, 9, b"something of a later version")
    c = loads(build([extra, weights, extra, metadata, records, (0x80, 0, b"")]))
    assert c.metadata.source == "a.obj"
    assert c.dhfs[0].symbols[0].tolist() == [[0, -1], [1, -2]]


@pytest.mark.parametrize(
    "weights",
    [
        b"",
        b"\x20",
        b"garbage garbage garbage",
        frame(bytes(rawfile.SIZE))[:-1],
        frame(bytes(rawfile.SIZE)) + b"\0",
        frame(bytes(rawfile.SIZE)) * 2,
        frame(bytes(rawfile.SIZE)) + b"\x28\xb5\x2f\xfd" + frame(b"more"),
        frame(bytes(rawfile.SIZE), content_size=False),
        frame(bytes(rawfile.SIZE - 1)),
        frame(bytes(rawfile.SIZE + 1)),
        frame(bytes(2**24)),
    ],
)
def test_damaged_weights(weights):
    with pytest.raises(PayloadError, match="weights"):
        loads(build(sections(weights=weights)))


def _bomb(declared: int, blocks: int) -> bytes:
    """A frame that declares `declared` bytes and whose 4-byte run-length blocks hold 128 KiB each."""
    out = bytes([0x80, 7 << 3]) + struct.pack("<I", declared)  # 4-byte content size, 128 KiB window
    block = struct.pack("<I", (2**17 << 3) | 2)[:3] + b"\0"
    last = struct.pack("<I", (2**17 << 3) | 3)[:3] + b"\0"
    return out + block * (blocks - 1) + last


@pytest.mark.parametrize(
    "weights",
    [
        _bomb(rawfile.SIZE, 2000),
        _bomb(2**31, 2000),
        bytes([0xE0]) + struct.pack("<Q", 2**60) + b"\x01\x00\x00",  # eight bytes of content size
    ],
)
def test_a_bomb_is_refused_before_memory_is_taken(weights):
    data = build(sections(weights=weights))
    tracemalloc.start()
    try:
        with pytest.raises(PayloadError):
            loads(data)
        assert tracemalloc.get_traced_memory()[1] < 2**21
    finally:
        tracemalloc.stop()


def test_a_frame_whose_blocks_outgrow_its_declared_size_is_stopped_there():
    # Seven of the largest networks need 929,390 bytes: large enough for whole blocks to pass one by one.
    n = 8 * 128 * 129 + 5 * 128 + 2
    data = build(sections(record(width=128, hidden=8) * 7, _bomb(7 * n, 2000)), n_dhfs=7)
    tracemalloc.start()
    try:
        with pytest.raises(PayloadError):
            loads(data)
        assert tracemalloc.get_traced_memory()[1] < 16 * 2**20  # 250 MiB are on offer
    finally:
        tracemalloc.stop()


def test_the_largest_file_is_bounded():
    with pytest.raises(LimitError, match="bytes"):
        read_header(build([*sections(), (0xFF, 0, bytes(16 * 2**20))]))


def test_a_section_length_near_four_gigabytes_is_a_truncation():
    data = bytearray(VALID)
    data[42:46] = b"\xff\xff\xff\xff"
    with pytest.raises(TruncatedError):
        loads(bytes(data))


@pytest.mark.parametrize(
    ("metadata", "error"),
    [
        (entry(1, b"a") + entry(1, b"b"), SectionError),
        (entry(77, b"a") + entry(77, b"a"), SectionError),
        (b"\x01", SectionError),
        (b"\x01\x05abcd", SectionError),
        (entry(1, b"a") + b"\x03\x01", SectionError),
        (entry(1, b"\xff\xfe"), FieldError),
        (entry(3, b"\xed\xa0\x80"), FieldError),  # a lone surrogate
        (entry(2, bytes(11)), FieldError),
        (entry(2, bytes(16)), FieldError),
        (entry(2, struct.pack("<3f", 1, -1, 2)), FieldError),
        (entry(2, struct.pack("<3f", 1, math.nan, 2)), FieldError),
        (entry(2, struct.pack("<3f", math.inf, 1, 2)), FieldError),
    ],
)
def test_damaged_metadata(metadata, error):
    with pytest.raises(error, match="metadata"):
        loads(build(sections(metadata=metadata)))


def test_unknown_metadata_is_skipped():
    c = loads(build(sections(metadata=entry(200, b"new") + entry(1, b"") + entry(201, bytes(255)))))
    assert c.metadata == Metadata(encoder="")


def test_damaged_weights_never_raise_anything_else():
    # The checksum is right, so that the damage reaches the decompressor and the symbols.
    rng = np.random.default_rng(0)
    good = frame(rng.integers(0, 40, rawfile.SIZE).astype(np.uint8).tobytes())
    refused = 0
    for _ in range(300):
        bad = bytearray(good)
        bad[rng.integers(len(bad))] = rng.integers(256)
        try:
            loads(build(sections(weights=bytes(bad))))
        except FormatError:
            refused += 1
    assert refused > 0


def test_frames_with_a_checksum_of_their_own_are_read():
    raw = bytes(range(rawfile.SIZE))
    weights = zstandard.ZstdCompressor(write_checksum=True).compress(raw)[4:]
    assert loads(build(sections(weights=weights))).dhfs[0].symbols[5].tolist() == [8, -9]
