"""Hypothesis strategies over containers: valid ones, and damaged files whose checksum fits."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from hypothesis import strategies as st

from cndhf_codec.format import Container, DhfRecord, Metadata, dumps, read_header
from cndhf_codec.format.bfloat16 import above
from cndhf_codec.format.constants import CODEC_RANS, CODEC_ZSTD, FRAME_AT
from cndhf_codec.format.container import tensor_shapes
from cndhf_codec.format.writer import section

texts = st.none() | st.text(st.characters(codec="utf-8"), max_size=60)
errors = st.floats(0, 2.0**100).map(above)
metadata = st.builds(
    lambda e, s, three: Metadata(e, *(three or (None, None, None)), s),
    texts,
    texts,
    st.none() | st.tuples(errors, errors, errors),
)
bounds = st.tuples(st.integers(-32768, 32767), st.integers(-32768, 32767)).filter(lambda b: b[0] != b[1]).map(sorted)


@st.composite
def records(draw) -> DhfRecord:
    width, hidden = draw(st.integers(1, 12)), draw(st.integers(1, 3))
    shapes = tensor_shapes(width, hidden)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    q = rng.normal(size=4)
    # Each tensor has its own range, from all zero to the widest that the format can say.
    limits = [draw(st.sampled_from([0, 1, 127, 128, 129, 32767])) for _ in shapes]
    symbols = []
    for shape, limit in zip(shapes, limits, strict=True):
        s = rng.integers(-limit, limit, shape, endpoint=True).astype(np.int32)
        s.flat[0], s.flat[-1] = -limit, limit
        symbols.append(s)
    return DhfRecord(
        quaternion=tuple(int(x) for x in np.round(q / np.linalg.norm(q) * 32767)),
        box=tuple(x for _ in range(3) for x in draw(bounds)),
        width=width,
        hidden_layers=hidden,
        omega_first=draw(st.integers(1, 255)),
        omega_hidden=draw(st.integers(1, 255)),
        step_codes=tuple(draw(st.integers(0, 127)) for _ in shapes),
        symbols=tuple(symbols),
        fold=draw(st.integers(0, 3)),
    )


coordinates = st.floats(-(2.0**100), 2.0**100)
singles = st.floats(-(2.0**100), 2.0**100, width=32)
# Valid containers: whatever the format can say, in small networks.
containers = st.builds(
    Container,
    st.tuples(coordinates, coordinates, coordinates) | st.tuples(singles, singles, singles),
    st.floats(2.0**-100, 2.0**100, width=32),
    st.lists(records(), min_size=1, max_size=4).map(tuple),
    metadata,
    st.sampled_from([CODEC_ZSTD, CODEC_RANS]),
)


def seal(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


@st.composite
def damaged(draw) -> bytes:
    """A file with a checksum that fits, and bytes changed, removed or added in one place or a few."""
    body = bytearray(dumps(draw(containers))[:-4])
    for _ in range(draw(st.integers(1, 4))):
        # Half of the damage to the header and the records, which are a small part of the bytes.
        end = draw(st.sampled_from([80, len(body)]))
        at = draw(st.integers(FRAME_AT - 1, max(FRAME_AT, min(end, len(body)) - 1)))
        body[at : at + draw(st.integers(0, 4))] = draw(st.binary(max_size=4))
    return seal(bytes(body))


@st.composite
def rearranged(draw) -> bytes:
    """A file whose sections are dropped, repeated, exchanged with another file's, or of another kind."""
    sections = []
    for _ in range(2):
        data = dumps(draw(containers))
        found = read_header(data).sections
        sections += [(s.kind, data[s.offset : s.offset + s.length]) for s in found]
    head = data[: 34 if data[FRAME_AT - 1] else 22]
    chosen = draw(st.lists(st.sampled_from(sections), max_size=5))
    if chosen and draw(st.booleans()):
        k = draw(st.integers(0, len(chosen) - 1))
        chosen[k] = (draw(st.integers(0, 255)), chosen[k][1])
    return seal(head + b"".join(section(kind, body) for kind, body in chosen))
