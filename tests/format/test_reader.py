"""Valid files are read as the specification says. Invalid ones are in must_fail/, see test_must_fail.py."""

from __future__ import annotations

import pytest
import rawfile
from rawfile import ENCODER, ERRORS, SOURCE, build, fields, frame, record

from cndhf_codec.errors import (
    ChecksumError,
    LimitError,
)
from cndhf_codec.format import Metadata, dumps, loads, read_header

VALID = build([fields(), (ENCODER, b"me")])


def test_reads_hand_made_bytes():
    box = (-100, 200, -300, 400, -500, 600)
    data = build(
        [
            fields(record(quaternion=(32767, 0, 0, 0), box=box, omegas=(31, 7), codes=bytes([1, 2, 3, 4, 5, 127]))),
            (ENCODER, b"me 1.0"),
            (ERRORS, bytes.fromhex("803e 003f 0140")),
            (SOURCE, "ü".encode()),
        ],
        centre=(1.5, -2.0, 1e6),
        scale=0.125,
    )
    c = loads(data)
    assert (c.centre, c.scale) == ((1.5, -2.0, 1e6), 0.125)
    assert c.metadata == Metadata("me 1.0", 0.25, 0.5, 2 + 2.0**-6, "ü")
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
    (d,) = loads(build([fields(record(codes=codes), frame(raw))])).dhfs
    assert d.symbols[1].tolist() == [128, -257]
    assert d.symbols[5].tolist() == [32767, -32767]
    assert d.step_codes == (20,) * 6


def test_read_header_needs_no_decompression():
    parts = [(0x90, bytes(130)), fields(weights=b"not zstd at all"), (ENCODER, b"me")]
    header = read_header(build(parts, centre=(1, 2, 3), scale=4))
    assert (header.centre, header.scale) == ((1, 2, 3), 4)
    assert [(s.kind, s.offset, s.length) for s in header.sections] == [(0x90, 25, 130), (1, 157, 47), (0x81, 206, 2)]
    assert header.shape is header.sections[1]


def test_a_far_centre_has_all_digits():
    centre = (1e7 + 1e-7, -1 / 3, 2.0**-1000)
    assert loads(build(flags=1, centre=centre)).centre == centre
    # Written again, a centre of float32 values takes 12 bytes less.
    near = loads(build(flags=1, centre=(0.5, -0.25, 1e6)))
    assert len(dumps(near)) == len(build())
    assert loads(dumps(near)).centre == near.centre
    assert dumps(loads(build(flags=1, centre=centre))) == build(flags=1, centre=centre)


def test_a_flipped_bit_is_a_checksum_error():
    for at in range(5, len(VALID)):
        for bit in range(8):
            damaged = bytearray(VALID)
            damaged[at] ^= 1 << bit
            with pytest.raises(ChecksumError):
                loads(bytes(damaged))


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 32000), (0, 0, 0, -32768), (16384, 16384, -16384, 16384)])
def test_quaternions_near_unit_length_are_read(quaternion):
    assert loads(build([fields(record(quaternion=quaternion))])).dhfs[0].quaternion == quaternion


def test_the_largest_file_is_bounded():
    with pytest.raises(LimitError, match="bytes"):
        read_header(build([fields(), (0xFF, bytes(16 * 2**20))]))
