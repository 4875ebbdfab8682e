"""The solid that a mesh bounds: ray casting, orientation of its faces, and inside tests."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..arrays import F64, I32, I64, Mask
from ..errors import require
from .connectivity import edges_of
from .distances import point_distances
from .repair import repair
from .sampling import area_normals, draw_faces, face_areas, fibonacci_sphere, points_in

RAYS_AT_ONCE = 2**18
RAY_OFFSET = 1e-4  # rays from the surface start this far from it (normalised units)
# Evidence for these constants: ADR 002.
#
# A patch is a sheet, without an inside, where more than this share of the rays from outside meet it from behind.
# Measured: a bunny with holes in its base 0.02, a sphere without a cap of a tenth of its area 0.09; an open box 0.17, a
# draped cloth 0.28, a range scan 0.44.
SHEET_SHARE = 0.125
LEAST_RAYS = 20  # fewer say nothing about a patch


class Solid:
    """The solid that a mesh in the normalised frame bounds, ready for rays.

    Copies of faces count once, neighbours look the same way, and every patch looks outward as seen from outside. Inside
    is where the winding number is above 1/2: so holes are closed, overlapping parts are one, and parts within others do
    not matter. Faces are in Morton order, so that rays from neighbouring faces walk the same part of the tree.

    vertices: (N, 3) float64. given: (M, 3) int64, the faces as they came. faces: (M', 3) int64, those of the solid.
    normals: (M', 3) unit float64. areas: (M',) float64. flipped: share of the area whose orientation was reversed.
    behind: share of the rays from outside that meet a face from behind, through a hole. open: share of those rays that
    meet sheets, patches without an inside. sheet: (M',) whether the face is of a sheet, or of a scrap that hardly any
    ray meets.
    """

    def __init__(self, vertices: F64, faces: I64) -> None:
        scene = require("embreex.rtcore_scene", "compare")
        construction = require("embreex.mesh_construction", "compare")
        self.vertices = vertices
        self.given = faces[np.argsort(_morton(vertices[faces].mean(axis=1)), kind="stable")]
        given_areas = face_areas(vertices, self.given)
        self.repaired = repaired = repair(self.given, given_areas, len(vertices))
        self.faces = repaired.faces
        self._scene = scene.EmbreeScene(robust=True)
        self._geometry = construction.TriangleMesh(
            self._scene, vertices.astype(np.float32), self.faces.astype(np.int32)
        )
        cross = area_normals(vertices, self.faces)
        length = np.linalg.norm(cross, axis=1)
        # Normalising can round a sliver to nothing: it then has no normal, and no weight.
        self.normals = cross / np.where(length > 0, length, 1)[:, None]
        self.areas = length / 2
        inward = self._look_from_outside()
        self.faces[inward] = self.faces[inward][:, ::-1]
        self.normals[inward] *= -1
        # A face given in both orientations has none that could be reversed, and a sheet has no inside.
        flipped = (repaired.turned ^ inward) & ~repaired.doubled & ~self.sheet
        self.flipped = float(self.areas[flipped].sum() / self.areas.sum())

    def first_hits(self, origins: npt.NDArray[np.floating], directions: npt.NDArray[np.floating]) -> I32:
        """Find the face that each ray hits first, (N,), or -1. origins (N, 3); directions (N, 3) or (3,)."""
        o = np.ascontiguousarray(origins, dtype=np.float32)
        d = np.broadcast_to(np.asarray(directions, dtype=np.float32), o.shape)
        out = np.empty(len(o), dtype=np.int32)
        for at in range(0, len(o), RAYS_AT_ONCE):
            part = slice(at, at + RAYS_AT_ONCE)
            out[part] = self._scene.run(o[part], np.ascontiguousarray(d[part]), query="INTERSECT")
        return out

    def sample(self, count: int, rng: np.random.Generator) -> tuple[F64, F64]:
        """Draw points of the surface, uniform by area, in the order of the faces; and their outward normals.

        Both are (count, 3).
        """
        face = draw_faces(self.areas, count, rng)
        return points_in(self.vertices[self.faces[face]], rng), self.normals[face]

    def visible_along(self, axis: F64, points: F64, normals: F64) -> Mask:
        """(N,) whether nothing lies in front of surface points (N, 3), on the side of the axis that they face."""
        toward = np.where((normals @ axis > 0)[:, None], axis, -axis)
        return self.first_hits(points + RAY_OFFSET * normals, toward) < 0

    def contains(self, points: npt.NDArray[np.floating]) -> Mask:
        """(N,) whether points (N, 3) are inside: their winding number is above 1/2. This closes holes of the surface,
        and takes overlapping parts as one. Barill et al., "Fast Winding Numbers for Soups and Clouds" (2018)."""
        return self.winding_numbers(points) > 0.5

    def distances(self, points: npt.NDArray[np.floating]) -> F64:
        """(N,) distance of points (N, 3) from the solid's boundary: exact from its faces, approximate from what closes
        its holes.

        At a height h over the middle of a round hole, and a distance d from its rim, the winding number w is
        1/2 +- h / 2d, so that d |2 w - 1| is h.
        """
        wide = np.ascontiguousarray(points, dtype=np.float64)
        distance = point_distances(wide, self.vertices, self.faces)
        if self.repaired.open_patch.any():
            distance *= np.minimum(np.abs(2 * self.winding_numbers(wide) - 1), 1)
        return distance

    @cached_property
    def closed(self) -> bool:
        """Whether faces run along every edge as often one way as the other: then winding numbers are whole."""
        return not edges_of(self.faces, len(self.vertices)).net.any()

    @property
    def signed_volume(self) -> float:
        """Volume that a closed surface encloses; where faces go round it several times, it counts as often."""
        return float(signed_volumes(self.vertices, self.faces).sum())

    def winding_numbers(self, points: npt.NDArray[np.floating]) -> F64:
        """(N,) how often the surface goes round points (N, 3)."""
        igl = require("igl", "compare")
        wide = np.ascontiguousarray(points, dtype=np.float64)
        return np.asarray(igl.fast_winding_number(self.vertices, np.ascontiguousarray(self.faces), wide))

    def _look_from_outside(self) -> Mask:
        """Cast rays from outside and set `behind`, `open` and `sheet`. Returns (M',) whether a face looks inward: rays
        see its patch mostly from behind."""
        patch = self.repaired.patch
        seen = np.zeros((2, patch.max() + 1), dtype=np.int64)  # from the front, from behind
        for direction in fibonacci_sphere(14):
            hit = self.first_hits(_disc(direction, 100), -direction)
            hit = hit[hit >= 0]
            for side, at in enumerate((hit[self.normals[hit] @ direction > 0], hit[self.normals[hit] @ direction < 0])):
                seen[side] += np.bincount(patch[at], minlength=seen.shape[1])
        unseen = seen.sum(axis=0) == 0
        if unseen.all():  # all passes between rays: a closed patch looks outward when its volume is positive
            volumes = np.bincount(patch, weights=signed_volumes(self.vertices, self.faces))
            seen[1] = (volumes < 0) & ~self.repaired.open_patch
        rays, behind = np.maximum(seen.sum(axis=0), 1), seen.min(axis=0)
        sheet = behind > SHEET_SHARE * rays
        self.behind = float(behind.sum() / rays.sum())
        self.open = float(rays[sheet].sum() / rays.sum())
        self.sheet = (sheet | (self.repaired.open_patch & (rays < LEAST_RAYS)))[patch]
        inward = seen[1] > seen[0]
        if not unseen.all() and inward[~unseen].all():
            inward |= unseen  # the mesh was inside out, and so were patches that no ray meets: cavities stay so
        return inward[patch]


def signed_volumes(vertices: F64, faces: I64) -> F64:
    """(M,) volumes between faces and the mean of all vertices. Those of a closed surface add up to its volume."""
    a, b, c = (vertices[faces[:, k]] - vertices.mean(axis=0) for k in range(3))
    return np.asarray((np.cross(a, b) * c).sum(axis=1)) / 6


def _disc(direction: F64, n: int) -> F64:
    """(~n^2, 3) grid of ray origins on the disc of radius 1 at distance 2 along `direction`."""
    side = np.linspace(-1, 1, n)
    x, y = (g.ravel() for g in np.meshgrid(side, side))
    keep = x * x + y * y <= 1
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    e1 = np.cross(direction, helper)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(direction, e1)
    return 2 * direction + x[keep, None] * e1 + y[keep, None] * e2


def _morton(points: F64) -> I64:
    """Z-order curve index of points in the cube [-1, 1]^3, 10 bits per axis."""
    cell = np.clip((points + 1) * 512, 0, 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
