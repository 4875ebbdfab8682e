"""The compiled count of a section's bytes is that of the section."""

from __future__ import annotations

from dataclasses import replace

import manifolds
import numpy as np
import pytest

from cndhf_codec.encoder.surface.coded_size import SectionSizes
from cndhf_codec.format import ControlMesh
from cndhf_codec.format.surface import positions
from cndhf_codec.format.surface.manifold import edges_of
from cndhf_codec.format.surface.section import REPEATS, UNTURNED, PositionEncoder

# None at all, small and large residuals, coordinates that repeat, and the greatest.
SPREADS = (1, 3, 40, 5000, positions.MAX_POSITION)


@pytest.mark.parametrize("kind", sorted(manifolds.KINDS))
@pytest.mark.parametrize("spread", SPREADS)
def test_the_count_is_exact(kind, spread):
    faces = np.asarray(manifolds.KINDS[kind], dtype=np.int32)
    rng = np.random.default_rng(spread)
    edges = edges_of(faces)
    sharp = edges.vertices[edges.n_faces == 2][::3].astype(np.int32)
    shape = (int(faces.max()) + 1, 3)
    mesh = ControlMesh(UNTURNED, 2.0**-12, np.zeros(shape, dtype=np.int32), faces, sharp)
    sizes, encoder = SectionSizes(mesh), PositionEncoder(mesh)
    for _ in range(6):
        # Few values along one axis, as in parts.
        points = rng.integers(1 - spread, spread, shape)
        if spread == positions.MAX_POSITION:
            points = rng.choice([-spread, spread], shape)
        points[:, 1] = rng.choice([0, spread - 1], len(points))
        each = replace(mesh, positions=points.astype(np.int32))
        body, coding = encoder.body(each), sizes.of(each)
        assert (len(body), bool(body[0] & REPEATS)) == (coding.n_bytes, coding.repeats)


@pytest.mark.parametrize("repeats", [False, True])
def test_both_ways_are_counted(repeats):
    faces = np.asarray(manifolds.voxels(np.ones((6, 5, 4), dtype=bool)), dtype=np.int32)
    rng = np.random.default_rng(0)
    shape = (int(faces.max()) + 1, 3)
    points = rng.choice(1000 * np.arange(3), shape) if repeats else rng.integers(-999, 999, shape)
    mesh = ControlMesh(UNTURNED, 2.0**-12, points.astype(np.int32), faces, np.zeros((0, 2), dtype=np.int32))
    coding = SectionSizes(mesh).of(mesh)
    assert (coding.n_bytes, coding.repeats) == (len(PositionEncoder(mesh).body(mesh)), repeats)


def test_a_turned_frame_is_counted():
    faces = np.asarray(manifolds.KINDS["parts"], dtype=np.int32)
    points = np.random.default_rng(0).integers(-50, 50, (int(faces.max()) + 1, 3)).astype(np.int32)
    mesh = ControlMesh((0, 32767, 0, 0), 2.0**-12, points, faces, np.zeros((0, 2), dtype=np.int32))
    assert SectionSizes(mesh).of(mesh).n_bytes == len(PositionEncoder(mesh).body(mesh))
