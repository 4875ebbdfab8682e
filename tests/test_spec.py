"""The specification's walk-through against the code, and against a decoder written from the text alone."""

from __future__ import annotations

import math
import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard

from cndhf_codec import loads
from cndhf_codec.format import Container, ControlMesh, DhfRecord, Metadata, dumps, rans
from cndhf_codec.format.surface import connectivity, models, positions, range_coder, section

SPEC = Path(__file__).parent.parent / "spec" / "cndhf.md"


@pytest.fixture(scope="module")
def text() -> str:
    return SPEC.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def printed(text: str) -> bytes:
    return printed_bytes(text, 0)


@pytest.fixture(scope="module")
def printed_surface(text: str) -> bytes:
    return printed_bytes(text, 1)


def printed_bytes(text: str, example: int) -> bytes:
    block = text.split("```")[2 * example + 1]
    # A row is hex pairs, two or more spaces, a note.
    return b"".join(bytes.fromhex(line.split("  ")[0]) for line in block.strip().splitlines())


@pytest.fixture(scope="module")
def heights(text: str) -> list[list[float]]:
    rows = re.findall(r"^\| (-?[\d.]+), (-?[\d.]+) \| (-?[\d.]+) \| (-?[\d.]+) \|$", text, re.MULTILINE)
    assert len(rows) == 2
    return [[float(x) for x in row] for row in rows]


def test_the_writer_gives_the_printed_bytes(printed: bytes) -> None:
    def symbols(*rows: object) -> np.ndarray:
        return np.array(rows, dtype=np.int32)

    record = DhfRecord(
        quaternion=(0, 0, 0, 32767),
        box=(-8192, 8192, -4096, 4096, -8192, 8192),
        width=1,
        hidden_layers=1,
        omega_first=30,
        omega_hidden=30,
        step_codes=(24, 24, 24, 24, 24, 4),
        symbols=(symbols([1, 0]), symbols(0), symbols([-2]), symbols(300), symbols([3], [-3]), symbols(-1, 1)),
    )
    container = Container((10.0, 0.0, -2.5), 2.0, (record,), Metadata("spec", 0.001, 0.004, 0.0078125))
    assert dumps(container).hex(" ") == printed.hex(" ")


def test_the_reader_gives_the_printed_heights(printed: bytes, heights: list[list[float]]) -> None:
    model = loads(printed)
    for u, v, near, far in heights:
        assert model.heights(0, [u, v]) == pytest.approx([near, far], abs=2e-6)


def test_a_decoder_written_from_the_text_agrees(printed: bytes, heights: list[list[float]]) -> None:
    assert printed[:6] == bytes.fromhex("8944 4846 0100")
    assert struct.unpack("<I", printed[-4:])[0] == zlib.crc32(printed[:-4])
    sections, at = {}, 22
    while at < len(printed) - 4:
        kind, length = printed[at], printed[at + 1]
        at += 2
        sections[kind] = printed[at : at + length]
        at += length
    n_dhfs, record = sections[1][0], sections[1][1:]
    width, hidden, omega_first, omega_hidden = record[21:25]
    assert (n_dhfs, width, hidden) == (1, 1, 1)
    steps, weights = record[25:31], record[31:]
    raw = zstandard.ZstdDecompressor().decompress(b"\x28\xb5\x2f\xfd" + weights)
    sizes = [2, 1, 1, 1, 2, 2]
    low, high, tensors = 0, sum(sizes), []
    for size, code in zip(sizes, steps, strict=True):
        values = []
        for j in range(size):
            u = raw[low + j] + (256 * raw[high + j] if code & 0x80 else 0)
            values.append((u // 2 if u % 2 == 0 else -(u + 1) // 2) * 2 ** (-(code & 0x7F) / 4))
        low += size
        high += size if code & 0x80 else 0
        tensors.append(values)
    W0, b0, W1, b1, W2, b2 = tensors
    for u, v, near, far in heights:
        x = math.sin(omega_first * (W0[0] * u + W0[1] * v + b0[0]))
        x = math.sin(omega_hidden * (W1[0] * x + b1[0]))
        assert W2[0] * x + b2[0] == pytest.approx(near, abs=2e-6)
        assert W2[1] * x + b2[1] == pytest.approx(far, abs=2e-6)


def example_section(text: str) -> str:
    return text.split("### 7.2 Surface")[1].split("\n## ")[0]


def test_the_writer_gives_the_printed_bytes_of_a_surface(printed_surface: bytes) -> None:
    mesh = ControlMesh(
        quaternion=(0, 0, 0, 32767),
        step=2.0**-6,
        positions=np.array([[0, 0, 64], [0, 60, -21], [52, -30, -21], [-52, -30, -21]], dtype=np.int32),
        faces=np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]], dtype=np.int32),
        sharp=np.array([[0, 1], [1, 2]], dtype=np.int32),
    )
    container = Container((10.0, 0.0, -2.5), 2.0, metadata=Metadata(encoder="spec"), surface=mesh)
    assert dumps(container).hex(" ") == printed_surface.hex(" ")


def test_the_reader_gives_the_printed_control_mesh(text: str, printed_surface: bytes) -> None:
    mesh = loads(printed_surface).container.surface
    assert mesh is not None
    rows = re.findall(r"^\| \d \| ([-\d, ]+) \| \d \| ([\d, ]+) \|$", example_section(text), re.MULTILINE)
    printed = [[[int(x) for x in cell.split(",")] for cell in column] for column in zip(*rows, strict=True)]
    assert [mesh.positions.tolist(), mesh.faces.tolist()] == printed
    sharp = re.findall(r"(\d)-(\d) and (\d)-(\d):", example_section(text))
    assert mesh.sharp.ravel().tolist() == [int(v) for v in sharp[0]]


def test_the_printed_bits_of_the_surface_are_read(
    text: str, printed_surface: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[tuple[int, int, int]] = []

    class Recorder(range_coder.RangeDecoder):
        def bit(self, context: range_coder.Context, bit: int = 0) -> int:
            before = self._range, context.zero
            read.append((*before, super().bit(context)))
            return read[-1][2]

    monkeypatch.setattr(section, "RangeDecoder", Recorder)
    loads(printed_surface)
    rows = [row for row in example_section(text).splitlines() if row.count("|") == 9][2:]
    cells = [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows]
    printed = [tuple(int(x) for x in row[k + 1 : k + 4]) for k in (0, 4) for row in cells]
    assert len(printed) == 16
    assert read[:16] == printed


def test_the_printed_numbers_of_the_surface_are_the_code_s(text: str) -> None:
    def listed(chances: tuple[int, ...]) -> str:
        return ", ".join(str(x) for x in chances)

    for sentence in (
        f"closing of {listed(connectivity.PIVOT_CLOSES)} for each kind",
        f"closing of {listed(connectivity.OTHER_CLOSES)} |",
        f"as (65536 - 1024 c, {connectivity.PRIOR})",
        f"min(count + 1, {range_coder.LIMIT})",
        f"while digits < {models.MAX_DIGITS} and",
        f"learnt = min(digits - 1, {models.LEARNT})",
        f"more than {connectivity.MAX_STEPS} are",
        f"at most {connectivity.MAX_VERTICES:,} vertices",
        f"min({connectivity.MAX_FACES:,}, {connectivity.FREE_FACES:,} + {connectivity.MAX_FACES_A_BYTE} n_bytes) faces",
        f"beyond {positions.MAX_POSITION:,} in either direction",
    ):
        assert sentence in text


def test_the_printed_limits_are_the_code_s(text: str) -> None:
    from cndhf_codec.format import constants as c

    for sentence in (
        f"Version {c.VERSION}. A file of version {c.VERSION} is",
        f"1 to {c.MAX_DHFS} double height fields",
        f"at most {c.MAX_FILE_SIZE:,} bytes",
        f"A file has 1 to {c.MAX_SECTIONS} sections",
        f"| neurons in each sine layer | 1 to {c.MAX_WIDTH} |",
        f"| sine layers after the first | 1 to {c.MAX_HIDDEN_LAYERS} |",
        f"at most {c.MAX_PARAMETERS:,} weights and biases",
        f"sum of the four squares {c.QUATERNION_MIN_NORM**2:,} to {c.QUATERNION_MAX_NORM**2:,}",
        f"more than {rans.FREE_SYMBOLS:,} + {rans.MAX_SYMBOLS_A_BYTE} n_bytes symbols",
    ):
        assert sentence in text


def test_the_printed_errors_are_read(text: str, printed: bytes) -> None:
    m = loads(printed).container.metadata
    assert f"mean {m.mean_error:.6g}, p99 {m.p99_error:.6g}, maximum {m.max_error:.6g}" in re.sub("  +", " ", text)


def test_the_printed_ratios_are_the_code_s(text: str) -> None:
    rows = re.findall(r"^\| (\d+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|$", text, re.MULTILINE)
    printed = {int(r[k]): (int(r[k + 1]), int(r[k + 2])) for r in rows for k in (0, 3)}
    assert [printed[t] for t in range(28)] == list(rans.RATIOS)


def test_a_coder_written_from_the_text_decodes() -> None:
    tensors = [np.array(v, dtype=np.int32) for v in ([0, 3, -2, 500, -32767, 0], [40, -90, 1000], [7, 7, 900])]
    body = rans.encode(tensors)
    state, stream = int.from_bytes(body[3:7], "little"), list(body[7:])
    assert [byte >> 7 for byte in body[:3]] == [0, 0, 1]

    def decode(n: int, frequencies: list[int]) -> int:
        nonlocal state
        m, start, a = state % 2**n, 0, 0
        while start + frequencies[a] <= m:
            start += frequencies[a]
            a += 1
        state = frequencies[a] * (state >> n) + m - start
        while state < 2**23:
            state = 256 * state + stream.pop(0)
        return a

    def uniform(n: int) -> int:
        return decode(n, [1] * 2**n)

    for byte, tensor in zip(body[:3], tensors, strict=True):
        code, rising = byte & 127, byte >> 7
        b = max(0, code // 4 - 5)
        p, q = rans.RATIOS[code if code < 24 else 24 + code % 4]
        v = 2**24
        w = [v if code >= 24 else v // 2]
        for _ in range(62):
            v, p = v * p // 2**24, p * q // 2**24
            w.append(v)
        f = [1 + x * (2**14 - 64) // sum(w) for x in [*w, 0]]
        f[0] += 2**14 - sum(f)
        got = []
        for _ in tensor:
            bucket = decode(14, f)
            magnitude = uniform(8) * 256 + uniform(8) if bucket == 63 else bucket * 2**b + (uniform(b) if b else 0)
            if rising:
                got.append(magnitude + (got[-1] if got else 0))
            else:
                got.append(-magnitude if magnitude and uniform(1) else magnitude)
        assert got == tensor.tolist()
    assert state == 2**23
    assert not stream
