"""The frame of the grid. In one in which the planes of a mechanical part lie along the axes coordinates repeat, and
those that repeat take hardly a bit."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import F64, I64
from ...format.constants import QUATERNION_MAX_NORM, QUATERNION_MIN_NORM

Quaternion = tuple[int, int, int, int]

# Evidence for these constants: ADR 036.
LEAST_GAIN = 0.1  # share of the area that must come to lie along the axes
ALONG = 2e-3  # radians off an axis, or of each other; noise of flat scans is larger, and that of written digits less
CANDIDATES = 12  # directions with most area


def turned_frame(vertices: F64, faces: I64) -> Quaternion | None:
    """The quaternion of the frame in which most of the area lies along the axes; None where that gains little.

    vertices: (N, 3) normalised. faces: (M, 3). The quaternion takes the normalised frame to that of the grid.
    """
    cross = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    lengths = np.linalg.norm(cross, axis=1)
    some = lengths > 0
    normals, areas = cross[some] / lengths[some, None], lengths[some]
    areas = areas / areas.sum()
    best, most = np.eye(3), _share(np.eye(3), normals, areas) + LEAST_GAIN
    directions = _directions(normals, areas)
    for i, first in enumerate(directions):
        any_across = np.cross(first, np.eye(3)[np.abs(first).argmin()])
        for second in (*directions[i + 1 :], any_across / np.linalg.norm(any_across)):
            if abs(first @ second) < ALONG:
                axes = _fitted(first, second, normals, areas)
                share = _share(axes, normals, areas)
                if share > most:
                    best, most = axes, share
    return None if np.array_equal(best, np.eye(3)) else _integers(best)


def _directions(normals: F64, areas: F64) -> list[F64]:
    """Some of the directions, up to sign, that most of the area has; none where that is little."""
    largest = np.abs(normals).argmax(axis=1)
    signs = np.sign(np.take_along_axis(normals, largest[:, None], axis=1))
    # Cells of a grid: what is near the wall of one may count half, which is enough to be found.
    _, where = np.unique(np.rint(normals * signs / ALONG), axis=0, return_inverse=True)
    sums = np.bincount(where.ravel(), areas)
    found: list[F64] = []
    cells = np.argsort(-sums, kind="stable")[: 4 * CANDIDATES]
    if sums[cells].sum() < LEAST_GAIN:
        return found
    for cell in cells:
        face = int(np.flatnonzero(where.ravel() == cell)[0])
        direction = normals[face] * signs[face]
        if all(abs(direction @ other) < np.cos(2 * ALONG) for other in found):
            found.append(direction)
    return found[:CANDIDATES]


def _share(axes: F64, normals: F64, areas: F64) -> float:
    """The share of the area whose normals are along the axes, (3, 3) rows."""
    return float(areas[np.abs(normals @ axes.T).max(axis=1) > np.cos(ALONG)].sum())


def _fitted(first: F64, second: F64, normals: F64, areas: F64) -> F64:
    """(3, 3) rows: the axes nearest to two directions and their normal, by the area along each of them."""
    axes = np.array([first, second, np.cross(first, second)])
    along = normals @ axes.T
    nearest = np.abs(along).argmax(axis=1)
    of = np.take_along_axis(along, nearest[:, None], axis=1)[:, 0]
    near = np.abs(of) > np.cos(ALONG)
    sums = np.zeros((3, 3))
    np.add.at(sums, nearest[near], (areas * np.sign(of))[near, None] * normals[near])
    if np.linalg.matrix_rank(sums, tol=1e-6) < 3:
        sums += 1e-6 * axes
    u, _, v = np.linalg.svd(sums)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v)


def _integers(axes: F64) -> Quaternion:
    """The quaternion nearest to a rotation. Of the lengths that are allowed one is much nearer than the others."""
    quaternion = Rotation.from_matrix(axes).as_quat()
    lengths = np.arange(QUATERNION_MIN_NORM + 2, QUATERNION_MAX_NORM - 1)
    rounded = np.rint(lengths[:, None] * quaternion)
    off = np.linalg.norm(rounded / np.linalg.norm(rounded, axis=1, keepdims=True) - quaternion, axis=1)
    x, y, z, w = (int(c) for c in rounded[int(off.argmin())])
    return x, y, z, w
