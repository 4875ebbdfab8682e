"""Hand-made models whose solids are known in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cndhf_codec.decoder import Model
from cndhf_codec.format import Container, DhfRecord
from cndhf_codec.format.container import tensor_shapes

NO_TURN = (0, 0, 0, 32767)
ABOUT_X_180 = (32767, 0, 0, 0)  # the axis is -z
ABOUT_Z_45 = (0, 0, 12539, 30273)
ABOUT_Y_90 = (0, 23170, 0, 23170)


def slab(lo: Sequence[float], hi: Sequence[float], quaternion: tuple[int, int, int, int] = NO_TURN) -> DhfRecord:
    """A box in the DHF's frame: u and v from the domain box, z from a network whose heights are constant.

    The corners are multiples of 2^-13, so that nothing is rounded. The domain is wider in z than the heights.
    """
    z = np.array([lo[2], hi[2]])
    zeros = [np.zeros(s, np.int32) for s in tensor_shapes(1, 1)]
    box = [lo[0], hi[0], lo[1], hi[1], lo[2] - 0.25, hi[2] + 0.25]
    return DhfRecord(
        quaternion=quaternion,
        box=tuple(round(b * 2**14) for b in box),
        width=1,
        hidden_layers=1,
        omega_first=30,
        omega_hidden=30,
        step_codes=(52,) * 6,  # steps of 2^-13
        symbols=(*zeros[:5], np.round(z * 2**13).astype(np.int32)),
    )


def waves(seed: int, quaternion: tuple[int, int, int, int] = NO_TURN, fold: int = 0) -> DhfRecord:
    """A smooth wavy plate with random folds, some 0.6 thick; `fold` as in the record."""
    rng = np.random.default_rng(seed)
    width = 6
    symbols = [np.rint(rng.uniform(-0.6, 0.6, s) * 2**9).astype(np.int32) for s in tensor_shapes(width, 1)]
    symbols[4] = np.rint(rng.uniform(-0.08, 0.08, (2, width)) * 2**9).astype(np.int32)
    symbols[5] = np.array([-0.3 * 2**9, 0.3 * 2**9], np.int32)
    return DhfRecord(
        quaternion=quaternion,
        box=tuple(round(b * 2**14) for b in (-0.7, 0.8, -0.6, 0.7, -0.9, 0.9)),
        width=width,
        hidden_layers=1,
        omega_first=5,
        omega_hidden=2,
        step_codes=(36,) * 6,  # steps of 2^-9
        symbols=tuple(symbols),
        fold=fold,
    )


def model(*dhfs: DhfRecord, centre: tuple[float, float, float] = (0.0, 0.0, 0.0), scale: float = 1.0) -> Model:
    return Model(Container(centre, scale, dhfs))


def ring() -> Model:
    """far = -near = 0.75 - 0.5 (cos 2u + cos 2v): a plate with a hole where that is negative."""
    one = 2**9
    # With omega 2, layer 0 is sin(2u + pi/2), sin(2v + pi/2); layer 1 is about 0.1 times their sum, which is
    # small enough for sine to be the identity.
    w0 = np.array([[one, 0], [0, one]], np.int32)
    b0 = np.full(2, round(math.pi / 4 * one), np.int32)
    w1 = np.array([[round(0.05 * one), round(0.05 * one)], [0, 0]], np.int32)
    w2 = np.array([[5 * one, 0], [-5 * one, 0]], np.int32)
    b2 = np.array([-round(0.75 * one), round(0.75 * one)], np.int32)
    record = DhfRecord(
        quaternion=(0, 0, 0, 32767),
        box=(-16384, 16384, -16384, 16384, -16384, 16384),
        width=2,
        hidden_layers=1,
        omega_first=2,
        omega_hidden=2,
        step_codes=(36,) * 6,
        symbols=(w0, b0, w1, np.zeros(2, np.int32), w2, b2),
    )
    return model(record)


def ridges(quaternion: tuple[int, int, int, int] = NO_TURN) -> Model:
    """A plate with walls: far is about the sum of sin(30 k u) / k for k = 1, 3, 5, 7, times 0.6."""
    one, odd = 2**11, np.array([1, 3, 5, 7])
    w0 = np.stack([odd * one, 0 * odd], axis=1)
    # Layer 1 is small enough for sine to be the identity.
    w1 = np.zeros((4, 4))
    w1[0] = 0.05 * one / odd
    w2 = np.zeros((2, 4))
    w2[1, 0] = 6 * one
    none = np.zeros(4)
    record = DhfRecord(
        quaternion=quaternion,
        box=tuple(round(b * 2**14) for b in (-0.5, 0.5, -0.4, 0.4, -0.9, 0.9)),
        width=4,
        hidden_layers=1,
        omega_first=30,
        omega_hidden=2,
        step_codes=(44,) * 6,  # steps of 2^-11
        symbols=tuple(np.rint(s).astype(np.int32) for s in (w0, none, w1, none, w2, [-0.45 * one, 0])),
    )
    return model(record)


def wavy() -> Model:
    return model(waves(7), waves(8, ABOUT_Y_90))
