"""Connectivity of a control mesh: the faces of a two-manifold triangle mesh, without loss, up to a renumbering.

A region grows face by face (as in Gumhold and Strasser, 1998, and Touma and Gotsman, 1998). Its border is made of
loops of *nodes*; a node is a gap in the fan of faces around its vertex, so that a vertex may have several. A *pivot*
is chosen, a node whose vertex has many faces already, and faces are put into its gap until that is closed. The next
face lies on the *gate*, the border edge from the pivot P to its neighbour Q on the side whose vertex has more faces:

        R --- P --- Q --- S      a part of the border; the face goes above the gate P - Q

    close pivot   the third corner is R; P leaves the border
    close other   the third corner is S; Q leaves the border
    new           the third corner is a new vertex
    join          the third corner is another node of the border, which becomes two

Faces are so coded by when fans close: the chance of that depends on how many faces a vertex has, and the cost is
that of the valences of vertices, about 2.3 bits per vertex for simplified meshes.

Boundaries are closed first: each boundary loop gets a *cap*, a vertex that is joined to all its edges. When all faces
are coded, the faces of caps are left out. A vertex that has a cap as a neighbour is called capped.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from ...errors import LimitError, MeshError, PayloadError
from .manifold import Edges, Ints, edges_of, fault
from .models import UnsignedModel
from .range_coder import ONE, Coder, Context, RangeDecoder, RangeEncoder

MAX_VERTICES, MAX_FACES = 2**17, 2**18
# Most faces of a section: so many, and so many more per byte of it. Otherwise a small file could ask for much work.
# Simplified meshes have about 6 faces per byte. Plane regular grids, which cost least of all, have 280 at 7,200 faces
# and 1,200 at 80,000 (without positions): only such grids of more than 2^16 faces can be refused.
FREE_FACES, MAX_FACES_A_BYTE = 2**16, 256

CLOSE_PIVOT, CLOSE_OTHER, NEW, JOIN = range(4)
LEVELS = 6  # pivots of LEVELS - 1 faces or more come first, in the order in which they got them
MAX_STEPS = 64  # a join counts nodes along the border up to here
DEGREES = 10  # contexts distinguish so many degrees

# The chance, in 64ths, that the gap of a vertex with 0, 1, 2, ... faces is closed by the next one, as in simplified
# meshes; contexts start from it as if they had seen PRIOR bits, which saves 0.2 bits per vertex at 100 vertices.
PIVOT_CLOSES = (1, 1, 25, 8, 22, 36, 42, 40, 33, 15)
OTHER_CLOSES = (1, 1, 2, 6, 18, 30, 35, 37, 37, 32)
PRIOR = 8


class Limits(NamedTuple):
    """How large a mesh may be, caps and their faces counted."""

    vertices: int
    faces: int


class Numbering(NamedTuple):
    """How an encoder renumbers a mesh."""

    vertices: Ints  # (V,): the new number of each vertex
    faces: Ints  # (F,): the new number of each face


def limits_for(n_bytes: int) -> Limits:
    """The largest mesh that a section of so many bytes may hold."""
    return Limits(MAX_VERTICES, min(MAX_FACES, FREE_FACES + MAX_FACES_A_BYTE * n_bytes))


def encode_connectivity(encoder: RangeEncoder, faces: Ints) -> Numbering:
    """Code the faces of a mesh, and say how vertices and faces are numbered in what will be decoded.

    Parameters
    ----------
    encoder : RangeEncoder
    faces : (F, 3) int array
        vertex numbers. A two-manifold with or without boundary; any number of components; neighbours may disagree in
        orientation, which costs up to a bit per face

    Returns
    -------
    Numbering
        new numbers of vertices, in order of their first appearance among the new faces, and of faces. The corners of
        a face may be rotated, but its orientation stays.

    Raises
    ------
    MeshError
        if the mesh is not a two-manifold: see `manifold.fault`
    LimitError
        if it has more than `MAX_VERTICES` vertices or `MAX_FACES` faces, caps and their faces counted
    """
    faces = np.asarray(faces, dtype=np.int32).reshape(-1, 3)
    edges = edges_of(faces)
    found = fault(faces, edges)
    if found:
        raise MeshError(f"the control mesh is not a two-manifold: {found}; cut it there")
    mesh = _Source(faces, edges)
    encoder.bit(Context(), int(mesh.oriented))
    walk = _Walk(encoder, Limits(MAX_VERTICES, MAX_FACES), mesh.oriented, mesh)
    walk.run()
    walked = walk.faces()
    order = [f for f in mesh.order if f < len(faces)]
    numbers = np.empty(len(faces), dtype=np.int32)
    numbers[order] = np.arange(len(order))
    if not mesh.oriented:
        walked = _code_orientation(encoder, walked, np.array(mesh.numbers, dtype=np.int32)[faces[order]])
    return Numbering(_ranks(walked)[mesh.numbers[: mesh.n_vertices]], numbers)


def decode_connectivity(decoder: RangeDecoder, limits: Limits) -> Ints:
    """Read the faces of a mesh: (F, 3) vertex numbers.

    Raises
    ------
    TruncatedError
        if the section ends inside
    LimitError
        if there are more vertices or faces than `limits` says
    PayloadError
        if what is read is not a two-manifold
    """
    oriented = bool(decoder.bit(Context()))
    walk = _Walk(decoder, limits, oriented, None)
    walk.run()
    faces = walk.faces()
    if not oriented:
        faces = _code_orientation(decoder, faces, faces)
    faces = _ranks(faces)[faces]
    found = fault(faces, edges_of(faces))
    if found:
        raise PayloadError(f"the control mesh is not a two-manifold: {found}")
    return faces


def _ranks(faces: Ints) -> Ints:
    """Numbers of vertices in order of their first appearance, for the vertex numbers of faces."""
    used, first = np.unique(faces, return_index=True)
    ranks = np.zeros(int(faces.max(initial=-1)) + 1, dtype=np.int32)
    ranks[used[np.argsort(first)]] = np.arange(len(used))
    return ranks


def _code_orientation(coder: Coder, walked: Ints, faces: Ints) -> Ints:
    """Code which of the walked faces are turned round in `faces`, and return them so."""
    same = (walked[:, :, None] == faces[:, None, :]).argmax(axis=2)  # the corner of `faces` that each walked one is
    turned = ((same[:, 1] - same[:, 0]) % 3 == 2).tolist()
    contexts, last, out = (Context(), Context()), 0, walked.copy()
    for k, flag in enumerate(turned):
        last = coder.bit(contexts[last], int(flag))
        if last:
            out[k, 1:] = walked[k, :0:-1]
    return out


class _Source:
    """The mesh of an encoder, closed by caps: answers what the next face is, in terms of the walk's nodes."""

    def __init__(self, faces: Ints, edges: Edges) -> None:
        self.n_vertices = int(faces.max()) + 1 if faces.size else 0
        direction = np.where(faces < np.roll(faces, -1, axis=1), 1, -1)
        sums = np.bincount(edges.of_faces.ravel(), direction.ravel(), len(edges.vertices))
        self.oriented = not (sums[edges.n_faces == 2]).any()
        self._faces: list[list[int]] = faces.tolist()
        self.n_seeds = len(self._faces)  # caps are not in a component's first face
        self._n_caps = self._close(edges)
        self.has_caps = self._n_caps > 0
        self._at: dict[tuple[int, int], list[int]] = {}
        for f, (a, b, c) in enumerate(self._faces):
            for key in ((a, b), (b, c), (c, a)):
                self._at.setdefault(key if key[0] < key[1] else key[::-1], []).append(f)
        self._done = [False] * len(self._faces)
        self.names: list[int] = []  # the walk's vertex -> ours
        self.numbers = [-1] * (self.n_vertices + self._n_caps)  # and back, -1 before it is met
        self.order: list[int] = []  # faces in the walk's order
        self._seed = 0

    def _close(self, edges: Edges) -> int:
        """Add the faces of caps; return how many caps there are."""
        around: dict[int, list[int]] = {}
        for a, b in edges.vertices[edges.n_faces == 1].tolist():
            around.setdefault(a, []).append(b)
            around.setdefault(b, []).append(a)
        cap = self.n_vertices
        while around:
            first, (before, last) = next(iter(around.items()))
            current, before = first, last
            while current in around:
                a, b = around.pop(current)
                following = b if a == before else a
                self._faces.append([current, following, cap])
                before, current = current, following
            cap += 1
        return cap - self.n_vertices

    def seed(self) -> list[int] | None:
        """The first face that has not been coded, as the walk's vertices; None if there is none."""
        while self._seed < self.n_seeds and self._done[self._seed]:
            self._seed += 1
        if self._seed == self.n_seeds:
            return None
        self._take(self._seed)
        for v in self._faces[self._seed]:
            self._name(v)
        return [self.numbers[v] for v in self._faces[self._seed]]

    def third(self, p: int, q: int) -> tuple[int, bool]:
        """The third corner of the face beyond a gate: the walk's vertex, or -1 if it is new, and whether it is a cap.

        The face counts as coded from now on.
        """
        p, q = self.names[p], self.names[q]
        faces = self._at[(p, q) if p < q else (q, p)]
        f = faces[self._done[faces[0]]]
        self._take(f)
        y = sum(self._faces[f]) - p - q
        number = self.numbers[y]
        if number < 0:
            self._name(y)
        return number, y >= self.n_vertices

    def beyond(self, q: int, y: int) -> int:
        """Turn round y from the edge to q, away from the face coded last, to the border; its other end."""
        f, other, y = self.order[-1], self.names[q], self.names[y]
        while True:
            faces = self._at[(y, other) if y < other else (other, y)]
            f = faces[0] + faces[1] - f
            if self._done[f]:
                return self.numbers[other]
            other = sum(self._faces[f]) - y - other

    def _take(self, f: int) -> None:
        self._done[f] = True
        self.order.append(f)

    def _name(self, v: int) -> None:
        self.numbers[v] = len(self.names)
        self.names.append(v)


class _Walk:
    """Growing the region, which goes the same way in encoder and decoder; only an encoder has a source."""

    def __init__(self, coder: Coder, limits: Limits, oriented: bool, source: _Source | None) -> None:
        self._coder = coder
        self._limits = limits
        self._oriented = oriented
        self._source = source
        # Nodes: neighbours on the border, vertex, whether still there. Where faces agree, they are the previous and
        # the next node; after a twisted join they are just the two neighbours.
        self._previous: list[int] = []
        self._next: list[int] = []
        self._vertex: list[int] = []
        self._alive: list[bool] = []
        # Vertices: number of faces, whether a cap or capped.
        self._degree: list[int] = []
        self._is_cap: list[bool] = []
        self._capped: list[bool] = []
        self._nodes_of: list[list[int]] = []  # of an encoder
        self._out: list[tuple[int, int, int]] = []
        self._queues: tuple[deque[int], ...] = tuple(deque() for _ in range(LEVELS))
        # Contexts. Pivots: by degree; apart for caps and capped vertices.
        self._more = Context()
        self._pivot_closes = [[_closing(x) for x in PIVOT_CLOSES] for _ in range(3)]
        self._other_closes = [_closing(x) for x in OTHER_CLOSES]
        self._joins = _closing(2)
        self._caps = Context()
        self._far = _closing(5)
        self._side = Context()
        self._steps = UnsignedModel()
        self._twisted = Context()

    def faces(self) -> Ints:
        """The faces so far, (F, 3), without those of caps."""
        is_cap = np.array(self._is_cap, dtype=bool)
        out = np.array(self._out, dtype=np.int32).reshape(-1, 3)
        return out[~is_cap[out].any(axis=1)]

    def run(self) -> None:
        """Code all components."""
        source = self._source
        self._has_caps = bool(self._coder.bit(Context(), int(source is not None and source.has_caps)))
        while True:
            seed = source.seed() if source else None
            if not self._coder.bit(self._more, int(seed is not None)):
                return
            self._start()
            while True:
                pivot = self._pop()
                if pivot < 0:
                    break
                while self._alive[pivot]:
                    self._grow(pivot)

    def _start(self) -> None:
        """Begin a component with a face of three new vertices."""
        a, b, c = (self._add_vertex(False) for _ in range(3))
        self._add_face(a, b, c)
        # The border runs the other way round than the face, as the next faces do.
        nodes = [self._add_node(v) for v in (a, c, b)]
        for k in range(3):
            self._next[nodes[k]], self._previous[nodes[k]] = nodes[k - 2], nodes[k - 1]
        for node in nodes:
            self._push(node)

    def _grow(self, P: int) -> None:
        """Code the face at a gate of the pivot."""
        vertex, degree, bit = self._vertex, self._degree, self._coder.bit
        Q, R = self._next[P], self._previous[P]
        ahead = degree[vertex[Q]] >= degree[vertex[R]]
        if not ahead:
            Q, R = R, Q
        S = self._other(Q, P)
        p, q, r, s = vertex[P], vertex[Q], vertex[R], vertex[S]
        answer, y, cap = -1, -1, False
        if self._source:
            y, cap = self._source.third(p, q)
            answer = NEW if y < 0 else CLOSE_PIVOT if y == r else CLOSE_OTHER if y == s else JOIN
        kind = 2 if self._is_cap[p] else self._capped[p]
        if bit(self._pivot_closes[kind][min(degree[p], DEGREES - 1)], int(answer == CLOSE_PIVOT)):
            self._face(p, q, r, ahead)
            self._drop(P)
            self._link(R, P, Q)
            self._link(Q, P, R)
            self._zip(R)
            self._zip(Q)
        elif S != R and bit(self._other_closes[min(degree[q], DEGREES - 1)], int(answer == CLOSE_OTHER)):
            self._face(p, q, s, ahead)
            self._drop(Q)
            self._link(P, Q, S)
            self._link(S, Q, P)
            self._zip(S)
            self._zip(P)
        elif bit(self._joins, int(answer == JOIN)):
            self._join(P, Q, y, ahead)
        else:
            if self._has_caps and not (self._capped[p] or self._capped[q] or self._is_cap[p] or self._is_cap[q]):
                cap = bool(bit(self._caps, int(cap)))
            else:
                cap = False
            y = self._add_vertex(cap)
            self._face(p, q, y, ahead)
            Y = self._add_node(y)
            self._next[Y], self._previous[Y] = (Q, P) if ahead else (P, Q)
            self._link(P, Q, Y)
            self._link(Q, P, Y)
            self._push(Y)
            self._push(Q)

    def _join(self, P: int, Q: int, y: int, ahead: bool) -> None:
        """Code the node Y that the face at a gate reaches, and part it in two: one beside P, one beside Q."""
        bit, vertex = self._coder.bit, self._vertex
        S, R = self._other(Q, P), self._other(P, Q)
        Y = X = steps = side = 0
        far = False
        if self._source:
            x = self._source.beyond(vertex[Q], y)
            Y = next(n for n in self._nodes_of[y] if self._alive[n] and x in self._neighbours(n))
            X = next(n for n in (self._previous[Y], self._next[Y]) if vertex[n] == x)
            far, side, steps = self._distance(P, Q, Y)
        if bit(self._far, int(far)):
            n_bits = (len(vertex) - 1).bit_length()
            Y = self._coder.raw(n_bits, Y)
            if len(vertex) <= Y or not self._alive[Y]:
                raise PayloadError("a join of the control mesh names a node that is not on the border")
            usual = self._previous[Y] if ahead else self._next[Y]
        else:
            side = bit(self._side, side)
            steps = self._steps.code(self._coder, 0, steps)
            if steps > MAX_STEPS:
                raise PayloadError(f"a join of the control mesh is {steps} nodes away; at most {MAX_STEPS} are allowed")
            before, Y = (Q, S) if side == 0 else (P, R)
            for _ in range(steps + 1):
                before, Y = Y, self._other(Y, before)
            usual = before if side == 0 else self._other(Y, before)
        if Y in (P, Q, R, S) or vertex[Y] in (vertex[P], vertex[Q]):
            raise PayloadError("a join of the control mesh names a node of the gate")
        twisted = not self._oriented and bit(self._twisted, int(self._source is not None and usual != X))
        X = self._other(Y, usual) if twisted else usual
        self._face(vertex[P], vertex[Q], vertex[Y], ahead)
        other = self._add_node(vertex[Y])
        # Y keeps its neighbour that is not X, and gets P; the other one gets X and Q.
        self._next[other], self._previous[other] = (Q, X) if ahead else (X, Q)
        self._link(X, Y, other)
        self._link(Y, X, P)
        self._link(P, Q, Y)
        self._link(Q, P, other)
        for node in (Y, other, P, Q):
            self._zip(node)

    def _distance(self, P: int, Q: int, Y: int) -> tuple[bool, int, int]:
        """Of an encoder: whether Y is far away, else on which side it is nearer, and how many nodes lie between."""
        ends = [(P, Q), (Q, P)]
        for steps in range(-1, MAX_STEPS + 1):
            for side, (before, node) in enumerate(ends):
                ends[side] = node, self._other(node, before)
                if ends[side][1] == Y and steps >= 0:
                    return False, side, steps
        return True, 0, 0

    def _neighbours(self, node: int) -> tuple[int, int]:
        """The vertices on both sides of a node."""
        return self._vertex[self._previous[node]], self._vertex[self._next[node]]

    def _zip(self, node: int) -> None:
        """Where the edges on both sides of a node are one edge, close the gap: the nodes beside it become one."""
        if not self._alive[node]:
            return
        A, B = self._previous[node], self._next[node]
        if self._vertex[A] != self._vertex[B]:
            self._push(node)
            return
        self._drop(node)
        self._drop(B)
        if A != B:
            beyond = self._other(B, node)
            self._link(A, node, beyond)
            self._link(beyond, B, A)
            self._push(beyond)
            self._push(A)

    def _other(self, node: int, neighbour: int) -> int:
        """The neighbour of a node that is not this one. Loops of a two-manifold have three nodes or more."""
        following = self._next[node]
        return self._previous[node] if following == neighbour else following

    def _link(self, node: int, old: int, new: int) -> None:
        """Replace a neighbour of a node."""
        if self._next[node] == old:
            self._next[node] = new
        else:
            self._previous[node] = new

    def _add_vertex(self, is_cap: bool) -> int:
        self._degree.append(0)
        self._is_cap.append(is_cap)
        self._capped.append(False)
        self._nodes_of.append([])
        if len(self._degree) > self._limits.vertices:
            raise LimitError(f"the control mesh has more than {self._limits.vertices} vertices, caps counted")
        return len(self._degree) - 1

    def _add_node(self, vertex: int) -> int:
        node = len(self._vertex)
        self._vertex.append(vertex)
        self._alive.append(True)
        self._previous.append(-1)
        self._next.append(-1)
        if self._source:
            self._nodes_of[vertex].append(node)
        return node

    def _drop(self, node: int) -> None:
        self._alive[node] = False

    def _face(self, p: int, q: int, y: int, ahead: bool) -> None:
        """Add the face beyond a gate, turned so that it agrees with the face on this side."""
        if ahead:
            self._add_face(p, q, y)
        else:
            self._add_face(q, p, y)

    def _add_face(self, a: int, b: int, c: int) -> None:
        self._out.append((a, b, c))
        if len(self._out) > self._limits.faces:
            raise LimitError(f"the control mesh has more than {self._limits.faces} faces, those of caps counted")
        for v in (a, b, c):
            self._degree[v] += 1
        if self._has_caps and (self._is_cap[a] or self._is_cap[b] or self._is_cap[c]):
            for v in (a, b, c):
                self._capped[v] = True

    def _push(self, node: int) -> None:
        self._queues[min(self._degree[self._vertex[node]], LEVELS - 1)].append(node)

    def _pop(self) -> int:
        """The next pivot, or -1.

        A node whose vertex has got faces since it was queued goes to a higher queue; hence the second look at these.
        """
        while any(self._queues):
            for level in range(LEVELS - 1, -1, -1):
                queue = self._queues[level]
                while queue:
                    node = queue.popleft()
                    if self._alive[node]:
                        if min(self._degree[self._vertex[node]], LEVELS - 1) == level:
                            return node
                        self._push(node)
        return -1


def _closing(chance: int) -> Context:
    """A context that starts from a chance of a one, in 64ths."""
    return Context(ONE - chance * (ONE // 64), PRIOR)
