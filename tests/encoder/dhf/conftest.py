"""A T, two frames, samples and the joint loss of them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cndhf_codec.encoder.dhf.fit.clear_space import ClearSpace
from cndhf_codec.encoder.dhf.fit.loss import JointLoss
from cndhf_codec.encoder.dhf.fit.samples import draw_samples
from cndhf_codec.encoder.dhf.frames import frame_for_axis
from cndhf_codec.encoder.thread_pool import ThreadPool
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.solid import Solid


@pytest.fixture(scope="session")
def solid() -> Solid:
    """A T: along z its arms hide the floor under them, along y nothing is hidden."""
    top = trimesh.creation.box((1.6, 0.4, 0.4), trimesh.transformations.translation_matrix((0, 0, 0.6)))
    stem = trimesh.creation.box((0.4, 0.4, 1.0))
    mesh = read_mesh(trimesh.boolean.union([top, stem], engine="manifold").subdivide())
    return Solid(normalisation(mesh).apply(mesh.vertices), mesh.faces)


@pytest.fixture(scope="session")
def frames(solid):
    return [frame_for_axis(np.array(a, dtype=float), solid.vertices) for a in ((0, 0, 1), (1, 0, 0))]


@pytest.fixture(scope="session")
def samples(solid, frames):
    return draw_samples(solid, frames, 20_000, 0)


@pytest.fixture(scope="session")
def clear(solid, frames, samples):
    return ClearSpace(solid, frames, samples.sides)


@pytest.fixture(scope="module")
def joint_loss(samples, clear, frames):
    return JointLoss(samples, clear, frames, ThreadPool(1))
