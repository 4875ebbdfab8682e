"""The frame of the grid. In one in which the planes of a mechanical part lie along the axes coordinates repeat, and
those that repeat take hardly a bit."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import F64, I64
from ...format.constants import QUATERNION_MAX_NORM, QUATERNION_MIN_NORM, QUATERNION_ONE
from ...mesh.sampling import area_normals

Quaternion = tuple[int, int, int, int]

# Evidence for these constants: ADR 036.
ALONG = 2e-3  # radians off an axis, or of each other; noise of flat scans is larger, that of decimal digits less
CANDIDATES = 12  # directions with most area
LEAST_AREA = 0.1  # share of it that directions have which many faces share, where a frame is sought
EQUAL = 1e-4  # normalised units: ends of an edge that share a coordinate; about a step of the grid in a large file
# Coordinates along edges that must become equal: a share of them, and so many, which save what the quaternion takes.
LEAST_REPEATED, LEAST_COORDINATES = 0.05, 12


def turned_frame(vertices: F64, faces: I64) -> Quaternion | None:
    """The quaternion of the frame in which most of the area lies along the axes; None where few coordinates more than
    before are equal there.

    vertices: (N, 3) normalised. faces: (M, 3). The quaternion takes the normalised frame to that of the grid.
    """
    directions, areas = _directions(vertices, faces)
    found = directions[:CANDIDATES]
    if areas[:CANDIDATES].sum() < LEAST_AREA:
        return None
    best, most = np.eye(3), _share(np.eye(3), directions, areas)
    for i, first in enumerate(found):
        any_across = np.cross(first, np.eye(3)[np.abs(first).argmin()])
        for second in (*found[i + 1 :], any_across / np.linalg.norm(any_across)):
            if abs(first @ second) < ALONG:
                axes = _fitted(first, second, directions, areas)
                share = _share(axes, directions, areas)
                if share > most:
                    best, most = axes, share
    gained = _repeated(best, vertices, faces) - _repeated(np.eye(3), vertices, faces)
    least = max(LEAST_REPEATED, LEAST_COORDINATES / (3 / 2 * faces.size))
    return _integers(best) if gained > least else None


def _directions(vertices: F64, faces: I64) -> tuple[F64, F64]:
    """(K, 3) directions of faces, up to sign, and the share of the area that each has, the largest first."""
    cross = area_normals(vertices, faces)
    areas = np.linalg.norm(cross, axis=1)
    normals, areas = cross[areas > 0] / areas[areas > 0, None], areas[areas > 0]
    largest = np.abs(normals).argmax(axis=1)
    normals *= np.sign(np.take_along_axis(normals, largest[:, None], axis=1))
    # Cells of a grid. Directions near the wall of one are parted, and found all the same.
    cells = np.rint(normals / ALONG).astype(np.int64) + round(1 / ALONG)
    numbers = cells @ (3 * round(1 / ALONG)) ** np.arange(3)
    _, where = np.unique(numbers, return_inverse=True)
    sums = np.column_stack([np.bincount(where, areas * normals[:, k]) for k in range(3)])
    shares = np.bincount(where, areas) / areas.sum()
    order = np.argsort(-shares, kind="stable")
    return (sums / np.linalg.norm(sums, axis=1, keepdims=True))[order], shares[order]


def _share(axes: F64, directions: F64, areas: F64) -> float:
    """The share of the area that is along the axes, (3, 3) rows."""
    return float(areas[np.abs(directions @ axes.T).max(axis=1) > np.cos(ALONG)].sum())


def _fitted(first: F64, second: F64, directions: F64, areas: F64) -> F64:
    """(3, 3) rows: the axes nearest to two directions and their normal, by the area along each of them."""
    axes = np.array([first, second, np.cross(first, second)])
    along = directions @ axes.T
    nearest = np.abs(along).argmax(axis=1)
    of = np.take_along_axis(along, nearest[:, None], axis=1)[:, 0]
    near = np.abs(of) > np.cos(ALONG)
    sums = 1e-6 * axes  # for an axis that nothing is along
    np.add.at(sums, nearest[near], (areas * np.sign(of))[near, None] * directions[near])
    u, _, v = np.linalg.svd(sums)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v)


def _repeated(axes: F64, vertices: F64, faces: I64) -> float:
    """The share of the coordinates along the axes, (3, 3) rows, that both ends of an edge have."""
    places = vertices @ axes.T
    equal = [np.abs(places[faces[:, k]] - places[faces[:, k - 1]]) < EQUAL for k in range(3)]
    return float(np.mean(equal))


def _integers(axes: F64) -> Quaternion:
    """The quaternion nearest to a rotation, of all lengths that the format allows."""
    quaternion = Rotation.from_matrix(axes).as_quat()
    lengths = np.arange(QUATERNION_MIN_NORM + 2, QUATERNION_MAX_NORM - 1)
    rounded = np.rint(lengths[:, None] * quaternion)
    rounded = rounded[np.abs(rounded).max(axis=1) <= QUATERNION_ONE]
    off = np.linalg.norm(rounded / np.linalg.norm(rounded, axis=1, keepdims=True) - quaternion, axis=1)
    x, y, z, w = (int(c) for c in rounded[int(off.argmin())])
    return x, y, z, w
