"""The range coder and its models: what goes in comes out, near the ideal number of bytes, and ends where it should."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cndhf_codec.errors import FormatError, OptionError, PayloadError, TruncatedError
from cndhf_codec.format.surface.models import MAX_VALUE, SignedModel, UnsignedModel
from cndhf_codec.format.surface.range_coder import (
    LIMIT,
    LOOKAHEAD,
    ONE,
    Context,
    RangeDecoder,
    RangeEncoder,
)

FROZEN = "61 5f 73 78 bd 6f ff fa 91 0b"
# A step is (context, bit), or (-digits, value) for raw bits.
steps = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 1)) | st.tuples(st.integers(-9, -1), st.integers(0, 511)), max_size=300
)


def coded(plan: list[tuple[int, int]], coder) -> list[int]:
    contexts = [Context() for _ in range(3)] + [Context(60000, 20)]
    return [coder.bit(contexts[k], v) if k >= 0 else coder.raw(-k, v & (1 << -k) - 1) for k, v in plan]


def written(plan: list[tuple[int, int]]) -> bytes:
    encoder = RangeEncoder()
    coded(plan, encoder)
    return encoder.finish()


@given(steps)
@settings(max_examples=200, deadline=None)
def test_round_trip(plan):
    decoder = RangeDecoder(written(plan))
    assert coded([(k, 0) for k, _ in plan], decoder) == [v if k >= 0 else v & (1 << -k) - 1 for k, v in plan]
    decoder.finish()


@pytest.mark.parametrize("bit", [0, 1])
def test_long_runs_and_their_end(bit):
    for length in (1, 2, 3, 10, 1000, 50_000):
        body = written([(0, bit)] * length + [(1, 1 - bit)])
        decoder = RangeDecoder(body)
        assert coded([(0, 0)] * length + [(1, 0)], decoder) == [bit] * length + [1 - bit]
        decoder.finish()
        assert len(body) <= 3 + length // 700


def test_a_carry_runs_through_many_bytes():
    # 0111... is the interval just below a half; a one in its last place, then all that is above, carries up to it.
    encoder = RangeEncoder()
    plan = [(-1, 0), *[(-8, 255)] * 40, (0, 1), *[(1, 1)] * 40]
    coded(plan, encoder)
    decoder = RangeDecoder(encoder.finish())
    assert coded([(k, 0) for k, _ in plan], decoder) == [v for _, v in plan]


def test_size_is_near_the_entropy():
    rng = np.random.default_rng(0)
    for p in (0.5, 0.2, 0.02, 0.002):
        bits = (rng.random(40_000) < p).astype(int).tolist()
        ones = sum(bits) / len(bits)
        entropy = -(ones * np.log2(ones) + (1 - ones) * np.log2(1 - ones)) * len(bits) / 8
        # A context that forgets is never sure: about 0.36 / LIMIT bits each.
        assert len(written([(0, b) for b in bits])) < entropy + 0.4 / LIMIT * len(bits) / 8 + 8


def test_few_bits_are_learnt_fast():
    # Krichevsky and Trofimov's bound: half of log2(n), and one more, above the entropy, which is 0 here.
    encoder, context, bits = RangeEncoder(), Context(), 0.0
    for _ in range(60):
        bits -= np.log2(context.zero / ONE)
        encoder.bit(context, 0)
    assert bits < 0.5 * np.log2(60) + 1


def test_a_copy_goes_on_by_itself():
    encoder = RangeEncoder()
    encoder.raw(20, 0xFFFFF)  # with a carry still to come
    copy = encoder.copy()
    encoder.raw(12, 0xABC)
    copy.raw(16, 0x1234)
    for coder, n_bits, value in ((encoder, 12, 0xABC), (copy, 16, 0x1234)):
        decoder = RangeDecoder(coder.finish())
        assert (decoder.raw(20), decoder.raw(n_bits)) == (0xFFFFF, value)
        decoder.finish()


@pytest.mark.parametrize("zero", [1, 2, ONE // 2, ONE - 2, ONE - 1])
def test_a_chance_is_never_0_or_1(zero):
    for bit in (0, 1):
        encoder, context = RangeEncoder(), Context(zero)
        for _ in range(3000):
            encoder.bit(context, bit)
            assert 0 < context.zero < ONE


def test_both_coders_teach_a_context_alike():
    bits = (np.random.default_rng(3).random(300) < 0.3).astype(int).tolist()
    encoder, mine, theirs = RangeEncoder(), Context(), Context()
    taught = [(encoder.bit(mine, bit), mine.zero, mine.count) for bit in bits]
    decoder = RangeDecoder(encoder.finish())
    assert [(decoder.bit(theirs), theirs.zero, theirs.count) for _ in bits] == taught
    assert mine.count == LIMIT


def test_no_bits_are_no_bytes():
    assert written([]) == b""
    RangeDecoder(b"").finish()
    with pytest.raises(PayloadError, match="goes on"):
        RangeDecoder(b"\x01").finish()


def test_frozen_bytes():
    encoder, unsigned, signed = RangeEncoder(), UnsignedModel(2), SignedModel()
    for value in (0, 3, 1, 1000):
        unsigned.code(encoder, value & 1, value)
    for value in (0, -1, 5, -70000):
        signed.code(encoder, 0, value)
    assert encoder.finish().hex(" ") == FROZEN


@pytest.mark.parametrize("seed", range(20))
def test_truncations_and_other_ends_do_not_pass(seed):
    rng = np.random.default_rng(seed)
    plan = [(int(k), int(k == 1 or rng.random() < 0.3)) for k in rng.integers(0, 3, 300)]
    body = written(plan)
    ends = [body[:-1] + bytes([x]) for x in range(256) if x != body[-1]]
    for changed in [body[:end] for end in range(len(body))] + ends:
        decoder = RangeDecoder(changed)
        try:
            values = coded(plan, decoder)
            decoder.finish()
        except FormatError:
            continue
        # Few bytes may be missing without being missed. Then other bits were read, and they are what these bytes say.
        assert values != [v for _, v in plan]
        assert written([(k, v) for (k, _), v in zip(plan, values, strict=True)]) == changed
    for tail in (b"\0", b"\1", b"\0\0\0\0\0", body):
        decoder = RangeDecoder(body + tail)
        coded(plan, decoder)
        with pytest.raises(PayloadError, match="goes on"):
            decoder.finish()


def test_reading_stops_soon_after_the_end():
    decoder = RangeDecoder(b"")
    with pytest.raises(TruncatedError):
        decoder.raw(8 * LOOKAHEAD + 1)


@pytest.mark.parametrize("values", [range(-40, 40), [2**k for k in range(20)], [2**20, -(2**20), MAX_VALUE + 1], [0]])
def test_integers(values):
    encoder, model = RangeEncoder(), SignedModel(2)
    unsigned = UnsignedModel()
    for value in values:
        assert model.code(encoder, value & 1, value) == value
        unsigned.code(encoder, 0, min(abs(value), MAX_VALUE))
    decoder, model, again = RangeDecoder(encoder.finish()), SignedModel(2), UnsignedModel()
    for value in values:
        assert model.code(decoder, value & 1) == value
        assert again.code(decoder, 0) == min(abs(value), MAX_VALUE)
    decoder.finish()


def test_integers_beyond_the_limit_are_refused():
    for model, value in ((UnsignedModel(), -1), (UnsignedModel(), MAX_VALUE + 1), (SignedModel(), MAX_VALUE + 2)):
        with pytest.raises(OptionError, match="can be coded"):
            model.code(RangeEncoder(), 0, value)


@pytest.mark.parametrize(("deviation", "excess"), [(0.5, 0.06), (3, 0.06), (40, 0.12)])
def test_a_gaussian_costs_little_more_than_its_entropy(deviation, excess):
    values = np.rint(np.random.default_rng(0).normal(0, deviation, 5000)).astype(int)
    encoder, model = RangeEncoder(), SignedModel()
    for value in values.tolist():
        model.code(encoder, 0, value)
    _, counts = np.unique(values, return_counts=True)
    p = counts / counts.sum()
    entropy = -(p * np.log2(p)).sum()
    assert len(encoder.finish()) * 8 / len(values) < entropy + excess
