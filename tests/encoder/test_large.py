"""Ten million faces: memory stays bounded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cndhf_codec.decoder.meshfile import write_mesh

pytestmark = pytest.mark.encode

MOST_MEMORY = (
    10e9  # bytes; reading, preparing and measuring were seen to take 7.3 GB, most of it igl's tree of all faces
)

ENCODE = """
import resource, sys
from dataclasses import replace
from cndhf_codec.encoder import settings
from quietly import encode_quietly

settings.PRESETS["fast"] = replace(
    settings.PRESETS["fast"], max_axes=1, width=12, target_size=None, steps=150, joint_steps=200, samples=50_000,
    rounds=2, round_steps=50, verify_resolution=96,
)
model, report = encode_quietly(sys.argv[1], preset="fast", representation="dhf")
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
print(report.faces, report.distances.mean / report.diagonal, memory)
"""


def bumpy_sphere(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """A sphere with waves on it, of about 4 rows^2 faces."""
    columns = 2 * rows
    theta = np.pi * np.arange(1, rows)[:, None] / rows
    phi = 2 * np.pi * np.arange(columns) / columns
    r = 1 + 0.05 * np.sin(7 * phi) * np.sin(5 * theta)
    points = np.stack([r * np.sin(theta) * np.cos(phi), r * np.sin(theta) * np.sin(phi), r * np.cos(theta)], axis=-1)
    i = np.arange((rows - 2) * columns).reshape(rows - 2, columns)
    j, n = np.roll(i, -1, axis=1), (rows - 1) * columns
    rings = [np.stack([i, i + columns, j], axis=-1), np.stack([j, i + columns, j + columns], axis=-1)]
    top, bottom = i[0], i[-1] + columns
    caps = [
        np.stack([np.full(columns, n), top, np.roll(top, -1)], axis=-1),
        np.stack([np.full(columns, n + 1), np.roll(bottom, -1), bottom], axis=-1),
    ]
    faces = np.concatenate([part.reshape(-1, 3) for part in (*rings, *caps)])
    return np.concatenate([points.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]]), faces


@pytest.mark.slow
def test_ten_million_faces(tmp_path: Path):
    import trimesh

    vertices, faces = bumpy_sphere(1600)
    assert len(faces) > 10_000_000
    write_mesh(trimesh.Trimesh(vertices, faces, process=False), tmp_path / "large.ply")
    del vertices, faces
    command = [sys.executable, "-c", ENCODE, str(tmp_path / "large.ply")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    n, error, memory = map(float, done.stdout.split())
    assert n > 10_000_000
    assert error < 0.01
    assert memory < MOST_MEMORY
