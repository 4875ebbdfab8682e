"""Faces of two-manifold triangle meshes of every kind, for tests of the surface section."""

from __future__ import annotations

import numpy as np


def grid(n: int, m: int, *, wrap: bool = False, wrap_other: bool = False, twist: bool = False) -> np.ndarray:
    """A sheet of n by m squares. Wrapped in one direction a ring, or with a twist a Moebius strip; in both directions a
    torus, or with a twist a Klein bottle. Wrapped directions need 4 squares or more."""
    faces = []
    for i in range(n):
        for j in range(m):
            a, b, c, d = (
                _number(i + x, j + y, n, m, wrap, wrap_other, twist) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))
            )
            faces += [(a, b, c), (a, c, d)]
    return renumbered(np.array(faces))


def _number(i: int, j: int, n: int, m: int, wrap: bool, wrap_other: bool, twist: bool) -> int:
    rows = m if wrap_other else m + 1
    if wrap_other:
        j %= m
    if wrap and i == n:
        i, j = 0, (rows - 1 - j if twist else j)
    return i * (m + 1) + j


def renumbered(faces: np.ndarray) -> np.ndarray:
    """The faces with vertex numbers from 0 on, without gaps."""
    return np.unique(faces, return_inverse=True)[1].reshape(-1, 3).astype(np.int32)


def fan(n: int) -> np.ndarray:
    """n faces around one vertex, closed."""
    k = np.arange(n)
    return np.stack([np.zeros(n, dtype=int), 1 + k, 1 + (k + 1) % n], axis=1).astype(np.int32)


def voxels(solid: np.ndarray) -> np.ndarray:
    """The surface of the cubes that are set; its edges must have two faces."""
    padded = np.pad(solid, 1)
    corners: list[tuple[int, ...]] = []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
        step = np.diff(padded.astype(int), axis=axis)
        for sign in (1, -1):
            for at in np.argwhere(step == sign):
                base = at + np.eye(3, dtype=int)[axis]
                a, b, c, d = (tuple(int(x) for x in base + o) for o in (0 * u, u, u + v, v))
                corners += (a, b, c, a, c, d) if sign == -1 else (a, c, b, a, d, c)
    return np.unique(corners, axis=0, return_inverse=True)[1].reshape(-1, 3).astype(np.int32)


def together(*parts: np.ndarray) -> np.ndarray:
    """Several meshes as the components of one."""
    offsets = np.cumsum([0, *(int(p.max()) + 1 for p in parts)])
    return np.concatenate([p + o for p, o in zip(parts, offsets[:-1], strict=True)]).astype(np.int32)


def connected_sum(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Two closed meshes joined where their last faces were."""
    names = np.arange(other.max() + 1) + one.max() + 1
    names[other[-1]] = one[-1, ::-1]
    return renumbered(np.concatenate([one[:-1], names[other[:-1]]]))


def with_flips(faces: np.ndarray, rng: np.random.Generator, n_flips: int) -> np.ndarray:
    """The mesh after up to so many edge flips at random edges, of faces that agree in orientation."""
    faces = faces.copy()
    for _ in range(n_flips):
        f = int(rng.integers(len(faces)))
        a, b, c = np.roll(faces[f], rng.integers(3))
        others = [g for g in np.flatnonzero((faces == a).any(1) & (faces == b).any(1)) if g != f]
        if len(others) != 1:
            continue
        g = others[0]
        d = int(faces[g].sum() - a - b)
        agree = (b, a, d) in [tuple(np.roll(faces[g], k)) for k in range(3)]
        if agree and d != c and not ((faces == c).any(1) & (faces == d).any(1)).any():
            faces[f], faces[g] = (a, d, c), (d, b, c)
    return renumbered(faces)


def without(faces: np.ndarray, rng: np.random.Generator, share: float) -> np.ndarray:
    """The mesh without a share of its faces; vertices whose faces are several fans then become several vertices."""
    kept = faces[rng.random(len(faces)) >= share]
    if not len(kept):
        kept = faces[:1]
    parent = list(range(kept.size))

    def root(x: int) -> int:
        while parent[x] != x:
            x = parent[x]
        return x

    corners: dict[tuple[int, int], list[dict[int, int]]] = {}
    for f, face in enumerate(kept.tolist()):
        for k in range(3):
            a, b = face[k], face[(k + 1) % 3]
            corners.setdefault((min(a, b), max(a, b)), []).append({a: 3 * f + k, b: 3 * f + (k + 1) % 3})
    for edge, found in corners.items():
        if len(found) == 2:
            for v in edge:
                parent[root(found[0][v])] = root(found[1][v])
    return renumbered(np.array([root(x) for x in range(kept.size)]).reshape(-1, 3))


def turned(faces: np.ndarray, rng: np.random.Generator, share: float) -> np.ndarray:
    """The mesh with a share of its faces turned round."""
    out = faces.copy()
    chosen = rng.random(len(faces)) < share
    out[chosen] = out[chosen, ::-1]
    return out


def shuffled(faces: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The mesh with vertices, faces and corners in another order."""
    names = rng.permutation(faces.max() + 1)
    rolled = np.stack([np.roll(f, k) for f, k in zip(faces, rng.integers(3, size=len(faces)), strict=True)])
    return names[rolled[rng.permutation(len(faces))]].astype(np.int32)


def sphere(n: int) -> np.ndarray:
    """Two fans of n faces around two poles."""
    pole = fan(n)[:, ::-1].copy()
    pole[pole == 0] = n + 1
    return np.concatenate([fan(n), pole])


TORUS = grid(7, 6, wrap=True, wrap_other=True)
TETRAHEDRON = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)], dtype=np.int32)
SEVEN = np.arange(7)
ODD = np.indices((5, 5, 5)) % 2
KINDS: dict[str, np.ndarray] = {
    "triangle": np.array([(0, 1, 2)], dtype=np.int32),
    "tetrahedron": TETRAHEDRON,
    "sheet": grid(9, 5),
    "ring": grid(8, 3, wrap=True),
    "moebius strip": grid(8, 3, wrap=True, twist=True),
    "torus": TORUS,
    "klein bottle": grid(7, 6, wrap=True, wrap_other=True, twist=True),
    "genus 2": connected_sum(TORUS, TORUS),
    "genus 5": connected_sum(connected_sum(TORUS, TORUS), connected_sum(TORUS, connected_sum(TORUS, TORUS))),
    # Moebius' torus: every two of its seven vertices are joined. Likewise the projective plane of six.
    "complete graph of 7": np.concatenate(
        [np.stack([SEVEN, SEVEN + 1, SEVEN + 3], 1), np.stack([SEVEN, SEVEN + 3, SEVEN + 2], 1)]
    ).astype(np.int32)
    % 7,
    "projective plane": np.array(
        [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5), (0, 5, 1), (1, 2, 4), (2, 3, 5), (3, 4, 1), (4, 5, 2), (5, 1, 3)],
        dtype=np.int32,
    ),
    "sponge": voxels(ODD.sum(axis=0) < 2),
    "fan of 60": fan(60),
    "poles of 60": sphere(60),
    "triangles": together(*[np.array([(0, 1, 2)])] * 100),
    "parts": together(TORUS, TETRAHEDRON, grid(4, 4), fan(9)),
}
