"""The pieces of a mesh: parts of it that share no vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import F64, I64
from .results import TriangleMesh

# Evidence for these constants: ADR 040.
# A piece is a speck where it is thinner than so many times the error that 99 % of the surface keep, and shorter than
# this share of the whole. Specks of seven files were 0.0 to 1.3 times as thick; the thinnest real part was 44 times.
SPECK_THICKNESS, SPECK_LENGTH = 1.5, 0.1


class Pieces(NamedTuple):
    """label: (M,) the piece of each face. length: (P,) diagonals of their boxes. thickness: (P,) 2 volume / area, which
    is the thickness of a plate and a third of the diameter of a ball."""

    label: I64
    length: F64
    thickness: F64


def piece_labels(faces: I64, n_vertices: int) -> I64:
    """(M,) the piece of each face, from 0 without gaps."""
    label = np.arange(n_vertices)
    while True:
        # Each vertex takes the least number around it, and what that one has.
        least = label.copy()
        around = label[faces].min(axis=1)
        for k in range(3):
            np.minimum.at(least, faces[:, k], around)
        least = least[least]
        if np.array_equal(least, label):
            return np.unique(label[faces[:, 0]], return_inverse=True)[1].astype(np.int64).reshape(-1)
        label = least


def pieces_of(mesh: TriangleMesh) -> Pieces:
    """Find the pieces of a closed mesh, which is not empty."""
    label = piece_labels(mesh.faces, len(mesh.vertices))
    order = np.argsort(label, kind="stable")
    starts = np.flatnonzero(np.diff(label[order], prepend=-1))
    corners = mesh.vertices[mesh.faces]
    lo = np.minimum.reduceat(corners[order].min(axis=1), starts)
    hi = np.maximum.reduceat(corners[order].max(axis=1), starts)
    a, b, c = corners.transpose(1, 0, 2)
    volume = np.bincount(label, (a * np.cross(b, c)).sum(axis=1) / 6)
    area = np.bincount(label, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
    thickness = np.divide(2 * np.abs(volume), area, out=np.zeros_like(volume), where=area > 0)
    return Pieces(label, np.linalg.norm(hi - lo, axis=1), thickness)


def without_specks(mesh: TriangleMesh, p99_error: float) -> TriangleMesh:
    """Leave out the pieces of a closed mesh that are thinner and shorter than the error of its file can tell.

    p99_error: that 99 % of the surface keep, in the mesh's units. The longest piece stays.
    """
    pieces = pieces_of(mesh)
    longest = pieces.length.max()
    speck = (pieces.thickness < SPECK_THICKNESS * p99_error) & (pieces.length < SPECK_LENGTH * longest)
    if not speck.any():
        return mesh
    used, numbers = np.unique(mesh.faces[~speck[pieces.label]], return_inverse=True)
    return TriangleMesh(mesh.vertices[used], numbers.reshape(-1, 3).astype(np.int64))
