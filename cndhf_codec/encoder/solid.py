"""The solid that a mesh bounds: ray casting, which way its faces look, and inside tests."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..errors import require

RAYS_AT_ONCE = 2**18


class Solid:
    """A mesh in the normalised frame, ready for rays. Faces are in Morton order, so that rays cast from
    neighbouring faces walk the same part of the tree, and face outward as seen from outside.

    vertices: (N, 3) float64. faces: (M, 3) int64. normals: (M, 3) unit float64. areas: (M,) float64.
    flipped: share of the area whose orientation was reversed.
    """

    def __init__(self, vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> None:
        scene = require("embreex.rtcore_scene", "encode")
        construction = require("embreex.mesh_construction", "encode")
        self.vertices = vertices
        self.faces = faces[np.argsort(_morton(vertices[faces].mean(axis=1)), kind="stable")]
        self._scene = scene.EmbreeScene(robust=True)
        self._geometry = construction.TriangleMesh(
            self._scene, vertices.astype(np.float32), self.faces.astype(np.int32)
        )
        a, b, c = (vertices[self.faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        length = np.linalg.norm(cross, axis=1)
        self.normals = cross / length[:, None]
        self.areas = length / 2
        inward = self._inward_faces()
        self.flipped = float(self.areas[inward].sum() / self.areas.sum())
        self.faces[inward] = self.faces[inward][:, ::-1]
        self.normals[inward] *= -1

    def first_hits(
        self, origins: npt.NDArray[np.floating], directions: npt.NDArray[np.floating]
    ) -> npt.NDArray[np.int32]:
        """The face that each ray hits first, or -1. origins (N, 3); directions (N, 3) or (3,)."""
        o = np.ascontiguousarray(origins, dtype=np.float32)
        d = np.broadcast_to(np.asarray(directions, dtype=np.float32), o.shape)
        out = np.empty(len(o), dtype=np.int32)
        for at in range(0, len(o), RAYS_AT_ONCE):
            part = slice(at, at + RAYS_AT_ONCE)
            out[part] = self._scene.run(o[part], np.ascontiguousarray(d[part]), query="INTERSECT")
        return out

    def contains(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
        """Inside test: the winding number is above 1/2. That closes holes of the surface, and takes overlapping parts
        as one. Barill et al., "Fast Winding Numbers for Soups and Clouds" (2018)."""
        igl = require("igl", "encode")
        wide = np.ascontiguousarray(points, dtype=np.float64)
        return np.asarray(igl.fast_winding_number(self.vertices, np.ascontiguousarray(self.faces), wide) > 0.5)

    def _inward_faces(self) -> npt.NDArray[np.bool_]:
        """Faces whose connected component is seen mostly from behind by rays from outside."""
        labels = _components(self.vertices, self.faces)
        score = np.zeros(labels.max() + 1)
        for direction in _directions(14):
            origins = _disc(direction, 100)
            hit = self.first_hits(origins, -direction)
            hit = hit[hit >= 0]
            facing = self.normals[hit] @ direction
            np.add.at(score, labels[hit], np.sign(facing))
        return score[labels] < 0


def _components(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """(M,) number of the connected component (by shared vertices) that each face belongs to."""
    sparse = require("scipy.sparse", "encode")
    graph = require("scipy.sparse.csgraph", "encode")
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    n = len(vertices)
    matrix = sparse.coo_matrix((np.ones(len(edges), dtype=bool), edges.T), shape=(n, n))
    return graph.connected_components(matrix, directed=False)[1][faces[:, 0]]


def _directions(n: int) -> npt.NDArray[np.float64]:
    """(n, 3) unit vectors spread over the sphere, none along a coordinate axis."""
    from .axes import fibonacci_sphere

    return fibonacci_sphere(n)


def _disc(direction: npt.NDArray[np.float64], n: int) -> npt.NDArray[np.float64]:
    """(~n^2, 3) grid of ray origins on the disc of radius 1 at distance 2 along `direction`."""
    side = np.linspace(-1, 1, n)
    x, y = (g.ravel() for g in np.meshgrid(side, side))
    keep = x * x + y * y <= 1
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    e1 = np.cross(direction, helper)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(direction, e1)
    return 2 * direction + x[keep, None] * e1 + y[keep, None] * e2


def _morton(points: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Z-order curve index of points in the cube [-1, 1]^3, 10 bits an axis."""
    cell = np.clip((points + 1) * 512, 0, 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
