"""The reference decoder of `.cndhf` files, section 6 of spec/cndhf.md: heights, f, subdivision, limit points, normals.

Of what `reference.decode` gives.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from reference_surface import by_edge, edge, sides

# 6.1 Double height fields


def rotation(quaternion):
    x, y, z, w = (float(q) for q in quaternion)
    return np.array(
        [
            [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), -x * x - y * y + z * z + w * w],
        ]
    ) / (x * x + y * y + z * z + w * w)


def heights(dhf, uv):
    """Near and far (N, 2) over points (N, 2) of a DHF's plane."""
    h = np.clip(np.asarray(uv, dtype=float), *dhf["box"][:2].T)
    for k in range(2):
        middle = dhf["box"][k].mean()
        if dhf["fold"] >> k & 1:
            h[:, k] = middle + abs(h[:, k] - middle)
    tensors = [t.astype(float) for t in dhf["tensors"]]
    for k, omega in enumerate(dhf["omegas"]):
        h = np.sin(omega * (h @ tensors[2 * k].T + tensors[2 * k + 1]))
    return h @ tensors[-2].T + tensors[-1]


def implicit(shape, points):
    """f (N,) of double height fields at points (N, 3), both in input units."""
    normalised, terms = (np.asarray(points, dtype=float) - shape["centre"]) / shape["scale"], []
    for dhf in shape["dhfs"]:
        at = normalised @ rotation(dhf["quaternion"]).T
        near, far = heights(dhf, at[:, :2]).T
        terms += [far - at[:, 2], at[:, 2] - near, *(at - dhf["box"][:, 0]).T, *(dhf["box"][:, 1] - at).T]
    return np.min(terms, axis=0) * shape["scale"]


# 6.2 Surface


def control_vertices(mesh):
    """(V, 3) normalised."""
    return mesh["step"] * np.array(mesh["positions"]) @ rotation(mesh["quaternion"])


def beta(n):
    return (5 / 8 - (3 / 8 + math.cos(2 * math.pi / n) / 4) ** 2) / n


def unit(vector):
    return vector / (np.linalg.norm(vector) or 1)


class Level:
    """A mesh that has been subdivided. vertices: (V, 3), normalised. sharp: edges."""

    def __init__(self, vertices, faces, sharp):
        self.vertices, self.faces, self.edges = np.asarray(vertices, dtype=float), faces, by_edge(faces)
        self.sharp = {*sharp, *(e for e, around in self.edges.items() if len(around) == 1)}
        self.around = [[] for _ in self.vertices]
        for a, b in self.edges:
            self.around[a].append(b)
            self.around[b].append(a)
        self.along = [[w for w in around if edge(v, w) in self.sharp] for v, around in enumerate(self.around)]

    def moved(self, v, smooth, crease):
        """Vertex v with weights of its neighbours: `smooth` of all, or `crease` of those along a crease."""
        along, p = self.along[v], self.vertices
        if len(along) > 2:
            return p[v]
        around, w = (along, crease) if len(along) == 2 else (self.around[v], smooth)
        return (1 - len(around) * w) * p[v] + w * p[around].sum(axis=0)

    def next(self):
        new = [self.moved(v, beta(len(around)), 1 / 8) for v, around in enumerate(self.around)]
        number = {e: len(new) + k for k, e in enumerate(self.edges)}
        for (a, b), around in self.edges.items():
            ends, across = self.vertices[a] + self.vertices[b], sum(self.vertices[w] for _, w in around)
            new.append(ends / 2 if (a, b) in self.sharp else 3 / 8 * ends + across / 8)
        parts = [[], [], [], []]
        for a, b, c in self.faces:
            ab, bc, ca = number[edge(a, b)], number[edge(b, c)], number[edge(c, a)]
            for part, face in zip(parts, ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)), strict=True):
                part.append(face)
        return Level(new, [face for part in parts for face in part], [(v, number[e]) for e in self.sharp for v in e])

    def limit(self):
        w = [1 / (len(around) + 3 / (8 * beta(len(around)))) for around in self.around]
        return np.array(
            [self.dart(v) if len(along) == 1 else self.moved(v, w[v], 1 / 6) for v, along in enumerate(self.along)]
        )

    def dart(self, v):
        n, ring, r = len(self.around[v]), list(self.along[v]), (5 - math.sqrt(21)) / 2
        while len(ring) < n:
            ring.append(next(w for _, w in self.edges[edge(v, ring[-1])] if w not in ring))
        w = np.array([8 / 3 * beta(n) * (1 - (r**i + r ** (n - i)) / (1 + r**n)) for i in range(n)])
        w[0] = 2 * beta(n) + (w[1] + w[n - 1]) / 4
        return (self.vertices[v] + w @ self.vertices[ring]) / (1 + w.sum())

    def normals(self):
        """(F, 3, 3): the normal of each corner of each face."""
        starting = {side: (f, k) for f, face in enumerate(self.faces) for k, side in enumerate(sides(face))}
        twice = [
            e
            for e, around in self.edges.items()
            if len({side for f, _ in around for side in sides(self.faces[f]) if edge(*side) == e}) < len(around)
        ]
        ends = {*self.sharp, *twice}

        def following(f, k):
            v, w = self.faces[f][k], self.faces[f][k - 1]
            return None if edge(v, w) in ends else starting[v, w]

        corners = [(f, k) for f in range(len(self.faces)) for k in range(3)]
        first = set(corners) - {following(*corner) for corner in corners}
        limit, found = self.limit(), {}
        for corner in [*first, *corners]:
            if corner in found:
                continue
            sector = [corner]
            while (after := following(*sector[-1])) not in (None, corner):
                sector.append(after)
            found.update(dict.fromkeys(sector, self.normal(sector, limit)))
        return np.array([found[corner] for corner in corners]).reshape(-1, 3, 3)

    def normal(self, sector, limit):
        n, v = len(sector), self.faces[sector[0][0]][sector[0][1]]
        others = [self.faces[f][(k + 1) % 3] for f, k in sector] + [self.faces[sector[-1][0]][sector[-1][1] - 1]]
        arm, i, s, t = self.vertices[others] - self.vertices[v], np.arange(n), np.zeros(3), np.zeros(3)
        if len(self.along[v]) < 2 and n == len(self.around[v]):
            s, t = np.cos(2 * np.pi * i / n) @ arm[:n], np.sin(2 * np.pi * i / n) @ arm[:n]
        elif len(self.along[v]) == 2 and {others[0], others[-1]} == set(self.along[v]):
            x = np.pi / n
            end = 1 if n == 1 else -math.cos(x) / math.tan(x / 2) / (1 + 2 * math.cos(x))
            s, t = arm[0] - arm[n], end * (arm[0] + arm[n]) + np.sin(x * i) @ arm[:n]
        normal = np.cross(s, t)
        if not normal.any():
            for f, k in sector:
                a, b = (limit[self.faces[f][k - j]] - limit[v] for j in (2, 1))
                normal = normal + unit(np.cross(a, b)) * math.acos(np.clip(unit(a) @ unit(b), -1, 1))
        return unit(normal)


def is_solid(mesh):
    starts = Counter(side for face in mesh["faces"] for side in sides(face))
    return all(starts[a, b] == starts[b, a] == 1 for a, b in by_edge(mesh["faces"]))


def winding(vertices, faces, point):
    """How often a closed mesh winds round a point: the sum of the solid angles of its triangles."""
    a, b, c = (vertices[[f[k] for f in faces]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return np.arctan2((a * np.cross(b, c)).sum(axis=1), below).sum() / (2 * np.pi)
