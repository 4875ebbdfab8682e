"""Fuzz the surface section in process: `python tools/fuzz/surfaces.py FOLDER [--runs 1000000]`; see README.md.

Needs nothing but the package. Execution k is made from k alone, so a run that was stopped goes on where FOLDER says,
and `--only K` does one again. Inputs are sections of the spec's vectors with symbols changed, taken out, put in or
drawn at random, all coded with the chances that the decoder has at that place, so that what follows is still read as
it was; sections with other bytes, cut or made longer; and any bytes after a valid head. Every other one is read as a
whole file with a right checksum, the others by the section's decoder alone.

A finding is any exception but a FormatError, any warning, a message of several lines, more time or memory than
`measure.py` allows a surface, or a surface that is another when written and read again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import resource
import struct
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import measure
import mutate
from watch import FindingError, digest

from cndhf_codec import format as fmt
from cndhf_codec.errors import FormatError
from cndhf_codec.format.container import Container
from cndhf_codec.format.surface import section
from cndhf_codec.format.surface.range_coder import Context, RangeDecoder, RangeEncoder

VECTORS = Path(__file__).parent.parent.parent / "spec" / "vectors"
MOST_SYMBOLS = 4000  # of a vector that is changed: more take long, and hold nothing new
MOST_DRAWN = 400  # symbols that are drawn after a script has ended
SAVE_EVERY = 1000


class EndedError(Exception):
    """A script has ended."""


class Recorder(RangeDecoder):
    """Reads a section, and keeps its symbols."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.symbols: list[int] = []

    def bit(self, context: Context, bit: int = 0) -> int:
        self.symbols.append(super().bit(context))
        return self.symbols[-1]

    def raw(self, n_bits: int, value: int = 0) -> int:
        self.symbols.append(super().raw(n_bits))
        return self.symbols[-1]


class Writer:
    """Stands in for a decoder: gives the symbols of a script, then drawn ones, and codes them as they are asked for."""

    def __init__(self, script: list[int], rng: random.Random) -> None:
        self.encoder = RangeEncoder()
        self._script, self._rng, self._at = script, rng, 0
        self._ones, self._drawn = rng.choice((0.1, 0.3, 0.5, 0.7)), rng.randrange(MOST_DRAWN)

    def bit(self, context: Context, bit: int = 0) -> int:
        return self.encoder.bit(context, self._next(1))

    def raw(self, n_bits: int, value: int = 0) -> int:
        return self.encoder.raw(n_bits, self._next(n_bits))

    def finish(self) -> None:
        pass

    def _next(self, n_bits: int) -> int:
        self._at += 1
        if self._at <= len(self._script):
            return self._script[self._at - 1] & (1 << n_bits) - 1
        if self._at > len(self._script) + self._drawn:
            raise EndedError
        return self._rng.getrandbits(n_bits) if n_bits > 1 else int(self._rng.random() < self._ones)


def read_with(decoder: Callable[[bytes], object], body: bytes) -> None:
    with mock.patch.object(section, "RangeDecoder", decoder):
        section.decode_surface(body)


class Source:
    """A valid section: head, and the symbols after it."""

    def __init__(self, body: bytes) -> None:
        self.body = body
        self.head = 11 if body[0] & section.ROTATED else section.HEAD_SIZE
        made: list[Recorder] = []

        def recorder(data: bytes) -> Recorder:
            made.append(Recorder(data))
            return made[0]

        read_with(recorder, body)
        self.symbols = made[0].symbols


def sources() -> list[Source]:
    bodies = []
    for path in sorted([*VECTORS.glob("*.cndhf"), *VECTORS.glob("accepted/*.cndhf")]):
        found = mutate.Parts(path.read_bytes()).section(mutate.SURFACE)
        if found:
            bodies.append(bytes(found[1]))
    return [s for s in map(Source, bodies) if len(s.symbols) <= MOST_SYMBOLS]


def script_changed(source: Source, others: list[Source], rng: random.Random) -> bytes:
    symbols = list(source.symbols)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at, what = rng.randrange(len(symbols) + 1), rng.randrange(6)
        if what <= 1 and at < len(symbols):
            symbols[at] ^= 1 if what else rng.choice((1, 2, 4, 1 << 20))
        elif what == 2:
            del symbols[at : at + rng.choice((1, 1, 3, 20))]
        elif what == 3:
            symbols[at:at] = [rng.getrandbits(1) for _ in range(rng.choice((1, 1, 3, 20)))]
        elif what == 4:
            theirs = rng.choice(others).symbols
            begin = rng.randrange(len(theirs))
            symbols[at : at + rng.choice((0, 5, 50))] = theirs[begin : begin + rng.choice((5, 50))]
        else:
            del symbols[at:]
    writer = Writer(symbols, rng)
    with contextlib.suppress(FormatError, EndedError):
        read_with(lambda _: writer, source.body)
    return source.body[: source.head] + writer.encoder.finish()


def bytes_changed(source: Source, others: list[Source], rng: random.Random) -> bytes:
    body = bytearray(source.body)
    for _ in range(rng.choice((1, 1, 2, 5))):
        body[rng.randrange(len(body))] = rng.choice((rng.randrange(256), *mutate.BYTES))
    return bytes(body)


def cut_or_longer(source: Source, others: list[Source], rng: random.Random) -> bytes:
    body = source.body[: rng.randrange(len(source.body) + 1)]
    return body if rng.random() < 0.5 else body + rng.randbytes(rng.choice((1, 2, 5, 40)))


def any_bytes(source: Source, others: list[Source], rng: random.Random) -> bytes:
    body = rng.randbytes(rng.choice((0, 1, 4, 20, 100, 400)))
    if rng.random() < 0.3:  # few different bytes: long runs of likely symbols
        body = bytes(rng.choice((0, 255, 1, 128)) for _ in body)
    return source.body[: source.head] + body


def head_changed(source: Source, others: list[Source], rng: random.Random) -> bytes:
    body = bytearray(source.body)
    body[0] = rng.randrange(256)
    if rng.random() < 0.5:
        struct.pack_into("<H", body, 1, rng.choice((0x3080, 0x307F, 0x3F80, 0x3F81, 0x7FC0, rng.getrandbits(16))))
    if rng.random() < 0.5 and len(body) >= 11:
        struct.pack_into("<4h", body, 3, *(rng.choice(mutate.SHORTS) for _ in range(4)))
    return bytes(body)


WAYS = (script_changed,) * 12 + (bytes_changed,) * 3 + (cut_or_longer,) * 2 + (any_bytes,) * 2 + (head_changed,)


def input_of(k: int, known: list[Source]) -> tuple[bytes, str]:
    """Section k, and how it was made."""
    rng = random.Random(k)
    way = rng.choice(WAYS)
    source = rng.choices(known, [1 / len(s.symbols) for s in known])[0]  # as much time for each
    return way(source, known, rng), way.__name__


def file_of(body: bytes) -> bytes:
    """A whole file of a section, with a right checksum."""
    parts = mutate.Parts(FILE)
    found = parts.section(mutate.SURFACE)
    assert found
    found[1] = body
    return parts.dumps()


FILE = (VECTORS / "surface-triangle.cndhf").read_bytes()


def execute(body: bytes, whole: bool) -> bool:
    """Read a section; return whether it was accepted. Raises FindingError, or what the decoder must not raise."""
    data = file_of(body) if whole else body
    try:
        mesh = fmt.loads(data).surface if whole else section.decode_surface(body)
    except FormatError as exc:
        if "\n" in str(exc):
            raise FindingError("a message of several lines") from exc
        return False
    assert mesh is not None
    if len(mesh.faces) < 1000 and digest(body)[0] == "0":  # one in sixteen: writing takes twice as long as reading
        again = fmt.dumps(Container((0.0, 0.0, 0.0), 1.0, surface=mesh))
        if fmt.dumps(fmt.loads(again)) != again:
            raise FindingError("written and read again it is another surface")
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--only", type=int, help="execute this one alone, with a traceback")
    arguments = parser.parse_args()
    warnings.simplefilter("error")
    known = sources()
    if arguments.only is not None:
        body, way = input_of(arguments.only, known)
        print(way, body.hex())
        print("accepted" if execute(body, arguments.only % 2 == 0) else "refused")
        return
    arguments.folder.mkdir(parents=True, exist_ok=True)
    path = arguments.folder / "state.json"
    state = {"done": 0, "seconds": 0.0, "accepted": 0, "slowest": 0.0, "slowest_k": 0, "most_memory": 0, "ways": {},
             "findings": []}  # fmt: skip
    if path.exists():
        state = json.loads(path.read_text())
    ways, limits = Counter(state["ways"]), measure.SUBJECTS["surfaces"]
    execute(known[0].body, True)
    before = _high_water()
    began = time.thread_time()
    while state["done"] < arguments.runs:
        k = state["done"]
        finding, body = None, b""
        try:
            body, way = input_of(k, known)
            ways[way] += 1
            at = time.thread_time()
            state["accepted"] += execute(body, k % 2 == 0)
            took, grown = time.thread_time() - at, _high_water() - before
            if took > state["slowest"]:
                state["slowest"], state["slowest_k"] = took, k
            state["most_memory"] = max(state["most_memory"], grown)
            if took > limits.most_seconds:
                finding = f"{took:.1f} s"
            if grown > limits.most_bytes:
                finding, before = f"{grown} bytes of memory", _high_water()
        except Exception:
            finding = traceback.format_exc(limit=-3)
            (arguments.folder / f"finding-{k}-{digest(body)}.section").write_bytes(body)
        if finding:
            state["findings"].append([k, finding])
            print(f"finding {k}: {finding}", flush=True)
        state["done"] = k + 1
        if state["done"] % SAVE_EVERY == 0 or state["done"] == arguments.runs:
            now = time.thread_time()
            state["seconds"] += now - began
            began = now
            path.with_suffix(".new").write_text(json.dumps({**state, "ways": ways}, indent=1))
            path.with_suffix(".new").replace(path)
        if state["done"] % (10 * SAVE_EVERY) == 0:
            print(
                f"{state['done']} executions, {state['done'] / state['seconds']:.0f} per second of processor, "
                f"{state['accepted']} accepted, slowest {1000 * state['slowest']:.0f} ms, most memory "
                f"{state['most_memory'] / 2**20:.1f} MiB, {len(state['findings'])} findings",
                flush=True,
            )
    if state["findings"]:
        raise SystemExit(1)


def _high_water() -> int:
    """Most memory that the process has had so far, in bytes (Linux). It never falls, so one look per execution sees an
    execution that took more than all before."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main()
