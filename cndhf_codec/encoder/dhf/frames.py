"""The frame of a double height field: its axis, its rotation and its domain box, as the file stores them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import F64
from ...format.constants import BOX_STEP, QUATERNION_ONE
from ...format.container import fold, mirrors, rotation_matrix


@dataclass(frozen=True, eq=False)
class Frame:
    """The frame of a double height field: rotation as an integer quaternion x, y, z, w; domain box in `BOX_STEP`s; and
    in which of u and v its heights are mirrored (as `DhfRecord.fold`)."""

    quaternion: tuple[int, int, int, int]
    box: tuple[int, int, int, int, int, int]
    fold: int = 0

    @property
    def rotation(self) -> F64:
        return rotation_matrix(self.quaternion)

    @property
    def bounds(self) -> F64:
        return np.array(self.box).reshape(3, 2) * BOX_STEP

    @property
    def mirrors(self) -> tuple[float | None, float | None]:
        return mirrors(self.box, self.fold)

    def folded(self, uv: F64) -> F64:
        """(..., 2) -> (..., 2): the network's input for (u, v), on the side of the mirrors that it describes."""
        uv = uv.copy()
        fold(uv, self.mirrors)
        return uv


def frame_for_axis(axis: F64, vertices: F64) -> Frame:
    """Make a frame whose rotation takes `axis` to +z the shortest way, with the box of the rotated vertices."""
    x, y, z = axis / np.linalg.norm(axis)
    # This is half way between the identity and twice the rotation. From -z every half turn is as short: take x.
    q = np.array([y, -x, 0.0, 1 + z] if z > -1 + 1e-12 else [1.0, 0.0, 0.0, 0.0])
    return frame_for_quaternion(q, vertices)


def frame_for_quaternion(q: F64, vertices: F64) -> Frame:
    """Make a frame of a quaternion x, y, z, w of any length, with the box of the rotated vertices."""
    a, b, c, d = (int(k) for k in np.round(q / np.linalg.norm(q) * QUATERNION_ONE))
    uvz = vertices @ rotation_matrix((a, b, c, d)).T
    lo = np.floor(uvz.min(axis=0) / BOX_STEP).astype(int)
    hi = np.maximum(np.ceil(uvz.max(axis=0) / BOX_STEP).astype(int), lo + 1)
    box = (int(lo[0]), int(hi[0]), int(lo[1]), int(hi[1]), int(lo[2]), int(hi[2]))
    return Frame((a, b, c, d), box)
