"""Valid files are read as the specification says. Invalid ones are in must_fail/, see test_must_fail.py."""

from __future__ import annotations

import struct

import pytest
import rawfile
from rawfile import build, entry, frame, record, sections

from cndhf_codec.errors import (
    ChecksumError,
    LimitError,
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


def test_read_header_needs_no_decompression():
    header = read_header(build(sections(weights=b"not zstd at all"), centre=(1, 2, 3), scale=4))
    assert header.version == (0, 1)
    assert (header.n_dhfs, header.centre, header.scale) == (1, (1, 2, 3), 4)
    assert [(s.kind, s.codec, s.offset, s.length) for s in header.sections] == [(1, 0, 52, 32), (2, 1, 84, 15)]


def test_a_flipped_bit_behind_the_table_is_a_checksum_error():
    for at in range(12, 40):  # centre and scale
        for bit in range(8):
            damaged = bytearray(VALID)
            damaged[at] ^= 1 << bit
            with pytest.raises(ChecksumError):
                loads(bytes(damaged))


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 32000), (0, 0, 0, -32768), (16384, 16384, -16384, 16384)])
def test_quaternions_near_unit_length_are_read(quaternion):
    assert loads(build(sections(record(quaternion=quaternion)))).dhfs[0].quaternion == quaternion


def test_the_largest_file_is_bounded():
    with pytest.raises(LimitError, match="bytes"):
        read_header(build([*sections(), (0xFF, 0, bytes(16 * 2**20))]))


def test_unknown_metadata_is_skipped():
    c = loads(build(sections(metadata=entry(200, b"new") + entry(1, b"") + entry(201, bytes(255)))))
    assert c.metadata == Metadata(encoder="")
