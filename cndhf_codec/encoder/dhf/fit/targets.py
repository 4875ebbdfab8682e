"""Height targets of single fits: the exact heights of a field on a grid of rays along its axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....arrays import F32, F64, I32, Mask
from ....mesh.solid import Solid
from ..frames import Frame

RAY_START = 2.0  # the shape lies within 1 of the origin


@dataclass(frozen=True, eq=False)
class HeightTargets:
    """Heights at the pixel centres of a grid that fills the domain box; arrays are (nu, nv), heights float32.

    hit: whether the ray meets the shape. near, far: z of the first hit along +z and along -z (normalised units).
    near_known, far_known: whether the hit is on the front of a face. On the back, the ray came in through a hole in the
    surface, and the height is not one of the solid's.
    """

    frame: Frame
    uv: F32  # (nu, nv, 2), on the side of the frame's mirrors that the network describes
    hit: Mask
    near: F32
    far: F32
    near_known: Mask
    far_known: Mask

    @property
    def unknown(self) -> float:
        """Share of the hits that are on the back of a face."""
        rays = 2 * int(self.hit.sum())
        return 1 - float(self.near_known.sum() + self.far_known.sum()) / rays if rays else 0.0


def height_targets(solid: Solid, frame: Frame, resolution: int) -> HeightTargets:
    """Cast one ray down and one up through each pixel. resolution: pixels along the box's longer side."""
    (u0, u1), (v0, v1), _ = frame.bounds
    pixel = max(u1 - u0, v1 - v0) / resolution
    nu, nv = (max(8, round((b - a) / pixel)) for a, b in ((u0, u1), (v0, v1)))
    u = u0 + (np.arange(nu) + 0.5) * (u1 - u0) / nu
    v = v0 + (np.arange(nv) + 0.5) * (v1 - v0) / nv
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
    flat = uv.reshape(-1, 2)

    R = frame.rotation
    start = np.column_stack([flat, np.full(len(flat), RAY_START)])
    top = solid.first_hits(start @ R, -R[2])
    bottom = solid.first_hits((start * [1, 1, -1]) @ R, R[2])
    hit = (top >= 0) & (bottom >= 0)
    far, up = _heights_on(solid, R, top, flat)
    near, down = _heights_on(solid, R, bottom, flat)
    far_known, near_known = hit & (up > 0), hit & (down < 0)

    shape = (nu, nv)
    return HeightTargets(
        frame=frame,
        uv=frame.folded(uv).astype(np.float32),
        hit=hit.reshape(shape),
        near=near.reshape(shape).astype(np.float32),
        far=far.reshape(shape).astype(np.float32),
        near_known=near_known.reshape(shape),
        far_known=far_known.reshape(shape),
    )


def _heights_on(solid: Solid, R: F64, face: I32, uv: F64) -> tuple[F64, F64]:
    """Return z of each hit face's plane at (u, v), in float64, clipped to the face's range, 0 where `face` is -1; and z
    of the face's normal, in the field's frame."""
    corners, n = solid.vertices[solid.faces[face]] @ R.T, solid.normals[face] @ R.T
    a = corners[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = a[:, 2] - ((uv - a[:, :2]) * n[:, :2]).sum(axis=1) / n[:, 2]
    zs = corners[:, :, 2]
    z = np.clip(np.nan_to_num(z, nan=np.inf), zs.min(axis=1), zs.max(axis=1))
    return np.where(face >= 0, z, 0), n[:, 2]
