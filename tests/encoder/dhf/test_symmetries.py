"""Folded and sorted networks are the same function."""

from __future__ import annotations

import math

import numpy as np
import torch

from cndhf_codec.encoder.dhf.network.siren import Networks, heights, initialise, stacked
from cndhf_codec.encoder.dhf.rounding.symmetries import fold_biases, sort_neurons
from cndhf_codec.format import rans


def networks(seed: int = 0) -> Networks:
    generator = torch.Generator().manual_seed(seed)
    out = stacked([initialise(9, 3, 30, generator) for _ in range(2)])
    for k in range(2):  # biases of several periods, as a fit leaves them
        for bias in out.tensors(k)[1:-2:2]:
            bias *= 5
    return out


def test_folding_keeps_the_heights():
    before = networks()
    after = fold_biases(before)
    uv = torch.rand(500, 2, generator=torch.Generator().manual_seed(1)) * 2 - 1
    for k in range(2):
        assert torch.allclose(heights(before, k, uv), heights(after, k, uv), atol=1e-4)
        for bias in after.tensors(k)[1:-2:2]:
            assert float(bias.min()) >= 0
            assert float(bias.max()) <= math.pi / 60 + 1e-6
    assert any(float(b.min()) < -math.pi / 30 for b in before.tensors(0)[1:-2:2])


def test_folding_leaves_its_argument_alone():
    before = networks()
    theta = before.theta.clone()
    fold_biases(before)
    assert torch.equal(before.theta, theta)


def test_sorted_neurons_are_the_same_network():
    before = networks()
    whole = [[np.rint(t.numpy() * 1000).astype(np.int32) for t in before.tensors(k)] for k in range(2)]
    after = [sort_neurons(tensors) for tensors in whole]
    uv = torch.rand(500, 2, generator=torch.Generator().manual_seed(1)) * 2 - 1
    for k in range(2):
        for bias in after[k][1:-2:2]:
            assert (np.diff(bias, prepend=0) >= 0).all()
        rebuilt = [
            Networks(torch.cat([torch.from_numpy(t / 1000).float().ravel() for t in tensors])[None], (9,), 3, (30,))
            for tensors in (whole[k], after[k])
        ]
        assert torch.allclose(heights(rebuilt[0], 0, uv), heights(rebuilt[1], 0, uv), atol=1e-4)
    assert len(rans.encode(after[0])) < len(rans.encode(whole[0]))
