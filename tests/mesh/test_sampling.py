"""Samples of surfaces."""

from __future__ import annotations

import numpy as np
import trimesh
from control_meshes import arrays

from cndhf_codec.mesh.sampling import cover_evenly


def test_points_cover_a_surface_evenly():
    mesh = trimesh.creation.icosphere(2)
    faces, places = cover_evenly(*arrays(mesh), 20_000)
    shares = np.bincount(faces, minlength=len(mesh.faces)) / 20_000
    np.testing.assert_allclose(shares, mesh.area_faces / mesh.area, atol=1.01 / 20_000)
    np.testing.assert_allclose(places.mean(axis=0), 1 / 3, atol=2e-3)
    assert places.min() >= 0
