"""tools/bench/rivals on a sphere, whose distances are known."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from rivals import networks, nglod, vqad
from rivals.samples import Samples, samples_of

from cndhf_codec.mesh.solid import Solid

pytestmark = pytest.mark.encode

RADIUS = 0.7


@pytest.fixture(scope="module")
def sphere(tmp_path_factory: pytest.TempPathFactory) -> Samples:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    solid = Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))
    return samples_of(solid, tmp_path_factory.mktemp("cache"), share=0.05)


def fitted(method: str, sphere: Samples, steps: int = 800) -> networks.Network:
    torch.manual_seed(0)
    network = import_module(f"rivals.{method}").build(sphere, 4851, 1)
    network.batch = 512
    networks.train(network, sphere, steps, seed=0)
    return network


def off(mesh: networks.Mesh) -> float:
    return float(np.abs(np.linalg.norm(mesh[0], axis=1) - RADIUS).mean())


def test_distances_are_exact_and_negative_inside(sphere: Samples) -> None:
    exact = np.linalg.norm(sphere.points.numpy(), axis=1) - RADIUS
    assert np.abs(sphere.distances.numpy() - exact).max() < 3e-3  # how far the icosphere is within the sphere
    assert (sphere.distances < 0).sum() > 1000
    assert len(sphere.surface) == 12_500


def test_samples_are_read_from_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = trimesh.creation.box((1, 1, 1))
    solid = Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))
    first = samples_of(solid, tmp_path, share=1e-4)
    monkeypatch.setattr("rivals.samples._drawn", None)
    assert torch.equal(samples_of(solid, tmp_path, share=1e-4).points, first.points)
    with pytest.raises(TypeError):
        samples_of(solid, tmp_path, share=2e-4)


@pytest.mark.parametrize("method", ["siren_sdf", "nglod", "vqad", "idf"])
def test_each_rival_learns_a_sphere_and_keeps_it_in_eight_bits(method: str, sphere: Samples) -> None:
    network = fitted(method, sphere)
    back, size = networks.rounded(network, sphere, 800, seed=0)
    assert off(networks.mesh_of(network, sphere, 32)) < 0.01
    assert off(networks.mesh_of(back, sphere, 32)) < 0.02
    assert size < network.size + 200
    for weights in back.weights():
        levels = weights.detach() / (weights.detach().abs().max() / 127)
        assert torch.allclose(levels, levels.round(), atol=1e-3)


def test_equal_seeds_give_equal_rivals(sphere: Samples) -> None:
    one, two = (fitted("nglod", sphere, steps=5) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(one.parameters(), two.parameters(), strict=True))


@pytest.mark.parametrize(("method", "parameters"), [("siren_sdf", 4801), ("idf", 4808)])
def test_sirens_are_as_wide_as_the_parameters_allow(method: str, parameters: int, sphere: Samples) -> None:
    assert import_module(f"rivals.{method}").build(sphere, 4851, 1).size == parameters


def test_the_displacement_of_idf_moves_its_surface(sphere: Samples) -> None:
    network = fitted("idf", sphere)
    whole = off(networks.mesh_of(network, sphere, 32))
    with torch.no_grad():
        network.detail.linear[-1].bias += 1.0  # tanh(1) of the most, 0.05, away from the base
    assert 0.015 < abs(off(networks.mesh_of(network, sphere, 32)) - whole) < 0.05


def test_features_are_trilinear_in_each_level(sphere: Samples) -> None:
    octree = nglod.Octree(sphere.surface, 3)
    points = sphere.points[octree.covers(sphere.points)][:500]
    tables = []
    for k, level in enumerate(octree.levels):
        cells = 2**level
        corners = np.argwhere(octree.corners[k].numpy().reshape(3 * (cells + 1,)) > 0)
        place = torch.tensor(2 * corners / cells - 1, dtype=torch.float32)
        tables.append(torch.cat([torch.zeros(1, 3), place]))
    # Where the features of corners are their places, those of a point are its own, once per level.
    for level, (within, features) in enumerate(octree.sums(points, tables)):
        assert within.all()
        assert torch.allclose(features, (level + 1) * points, atol=1e-5)


def test_the_octree_can_be_read_back(sphere: Samples) -> None:
    octree = nglod.Octree(sphere.surface, 3)
    data = np.frombuffer(octree.packed(), dtype=np.uint8)
    coarse = np.unpackbits(data[:8]).astype(bool)
    assert (coarse == octree.occupied[0].numpy().ravel()).all()
    assert np.unpackbits(data[8:]).sum() == octree.occupied[1].sum()


def test_vqad_has_a_feature_of_its_codebook_at_every_corner(sphere: Samples) -> None:
    network = import_module("rivals.vqad").build(sphere, 4851, 2)
    soft = network.tables()
    network.settle()
    for table, before, codebook in zip(network.tables(), soft, network.codebooks, strict=True):
        off = torch.cdist(before[1:], codebook).min(dim=1).values
        assert torch.allclose((table - before)[1:].norm(dim=1), off, atol=2e-4)  # each corner has the nearest entry
        assert off.mean() < before[1:].norm(dim=1).mean()
    corners = sum(len(logits) for logits in network.logits)
    assert len(network.whole()) == len(network.octree.packed()) + -(-corners * vqad.BITS // 8)


@pytest.mark.parametrize(("value", "message"), [(1, "Surface level"), (-1, "No surface found")])
def test_nothing_of_a_network_is_meshed_outside_its_voxels(value: int, message: str, sphere: Samples) -> None:
    # The voxels of level 4 form a shell: at its walls there is no surface, whatever the sign within.
    network = import_module("rivals.nglod").build(sphere, 4851, 3)
    assert not network.covers(torch.zeros(1, 3)).any()
    with torch.no_grad():
        for weights in network.parameters():
            weights.zero_()
        network.decoder[2].bias += value
    with pytest.raises(ValueError, match=message):
        networks.mesh_of(network, sphere, 32)
