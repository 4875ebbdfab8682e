"""A mesh, and ways to write it, for tests of readers and of the encoder."""

from __future__ import annotations

import numpy as np
import trimesh


def lumps() -> trimesh.Trimesh:
    """Two balls with noise, coordinates that a float32 holds."""
    a, b = trimesh.creation.icosphere(2), trimesh.creation.icosphere(2, 0.5)
    b.apply_translation([2, 0.25, 0])
    mesh = trimesh.util.concatenate([a, b])
    noise = np.random.default_rng(0).normal(size=mesh.vertices.shape) * 0.01
    return trimesh.Trimesh((mesh.vertices + noise).astype(np.float32), mesh.faces, process=False)


def write_obj(mesh: trimesh.Trimesh, path) -> None:
    lines = ["v {!r} {!r} {!r}".format(*row) for row in mesh.vertices.tolist()]
    path.write_text("\n".join([*lines, *("f {} {} {}".format(*row) for row in (mesh.faces + 1).tolist())]))


def shuffled(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with faces and vertices in another order, corners rotated, and some vertices twice."""
    rng = np.random.default_rng(1)
    soup = mesh.triangles[rng.permutation(len(mesh.faces))]
    soup = np.stack([np.roll(t, k, axis=0) for t, k in zip(soup, rng.integers(3, size=len(soup)), strict=True)])
    return trimesh.Trimesh(soup.reshape(-1, 3), np.arange(3 * len(soup)).reshape(-1, 3), process=False)


def write_every_format(mesh: trimesh.Trimesh, folder) -> list:
    """Write the mesh in every format, some with vertices and faces in another order; return the paths."""
    for extension in ("ply", "glb", "stl", "off"):
        mesh.export(folder / f"a.{extension}")
    write_obj(mesh, folder / "a.obj")
    shuffled(mesh).export(folder / "b.ply")
    shuffled(mesh).export(folder / "b.glb")
    write_obj(shuffled(mesh), folder / "b.obj")
    return [folder / name for name in ("a.ply", "a.glb", "a.stl", "a.obj", "b.ply", "b.glb", "b.obj")]
