"""The reference decoder of `.cndhf` files, section 4 of spec/cndhf.md: surfaces."""

from __future__ import annotations

import struct
from collections import Counter, deque


class RefusedError(Exception):
    """The file is not valid."""


def need(condition, why):
    if not condition:
        raise RefusedError(why)


def bf16(two):
    return struct.unpack("<f", b"\0\0" + two)[0]


def check_quaternion(quaternion):
    need(32000**2 <= sum(x * x for x in quaternion) <= 33000**2, "quaternion")


# 4. Surface


def surface(body):
    need(len(body) >= 3, "end inside the surface")
    flags, step, at, quaternion = body[0], bf16(body[1:3]), 3, (0, 0, 0, 32767)
    need(flags < 32 and flags % 16 <= 8, "flags of the surface")
    need(2.0**-30 <= step <= 1, "step")
    if flags & 16:
        need(len(body) >= 11, "end inside the quaternion")
        quaternion, at = struct.unpack_from("<4h", body, 3), 11
        check_quaternion(quaternion)
    coder = RangeDecoder(body[at:])
    faces = Connectivity(coder, len(body)).read()
    sharp = marks(coder, faces)
    grid = positions(coder, faces, flags % 16)
    coder.end()
    return {
        "quaternion": quaternion,
        "step": step,
        "positions": grid,
        "faces": faces,
        "sharp": sharp,
    }


class Context:
    def __init__(self, zero=32768, count=0):
        self.zero, self.count = zero, count


def closing(c):
    return Context(65536 - 1024 * c, 8)


class RangeDecoder:  # 4.1
    def __init__(self, stream):
        self.stream, self.length, self.taken = stream + bytes(4), len(stream), 4
        self.range, self.code = 2**32 - 1, int.from_bytes(self.stream[:4], "big")

    def split(self, bound):
        result = int(self.code >= bound)
        if result:
            self.range -= bound
            self.code -= bound
        else:
            self.range = bound
        while self.range < 2**24:
            need(self.taken < self.length + 4, "end of the stream")
            self.range *= 256
            self.code = 256 * self.code + self.stream[self.taken]
            self.taken += 1
        return result

    def bit(self, c):
        result = self.split(self.range // 2**16 * c.zero)
        if result:
            c.zero -= c.zero // (c.count + 2)
        else:
            c.zero += (65536 - c.zero) // (c.count + 2)
        c.count = min(c.count + 1, 62)
        return result

    def raw(self, digits):
        value = 0
        for _ in range(digits):
            value = 2 * value + self.split(self.range // 2)
        return value

    def end(self):
        last = int.from_bytes(self.stream[self.taken - 4 : self.taken], "big")
        low = (last - self.code) % 2**32
        shortest = 0 if low == 0 or low + self.range > 2**32 else -(-low // 2**24) * 2**24
        need(last == shortest and self.length == self.taken - 4 + (shortest > 0), "end of the surface")


class Integers:  # 4.2
    def __init__(self, coder):
        self.coder, self.more, self.nonzero, self.negative = coder, [Context() for _ in range(21)], Context(), Context()
        self.below = [[Context() for _ in range(4)] for _ in range(21)]

    def unsigned(self):
        digits = value = 1
        while digits < 21 and self.coder.bit(self.more[digits]):
            digits += 1
        learnt = min(digits - 1, 2)
        for _ in range(learnt):
            value = 2 * value + self.coder.bit(self.below[digits - 1][value])
        rest = digits - 1 - learnt
        return 2**rest * value + self.coder.raw(rest) - 1

    def signed(self):
        if not self.coder.bit(self.nonzero):
            return 0
        sign, magnitude = self.coder.bit(self.negative), 1 + self.unsigned()
        return -magnitude if sign else magnitude


class Connectivity:  # 4.3
    def __init__(self, coder, n_bytes):
        self.bit, self.coder, self.most_faces = coder.bit, coder, min(262144, 65536 + 256 * n_bytes)
        self.next, self.prev, self.vertex, self.on_border = [], [], [], []  # of nodes
        self.degree, self.is_cap, self.capped = [], [], []  # of vertices
        self.faces, self.queues = [], [deque() for _ in range(6)]
        self.closes_pivot = [[closing(c) for c in (1, 1, 25, 8, 22, 36, 42, 40, 33, 15)] for _ in range(3)]
        self.closes_other = [closing(c) for c in (1, 1, 2, 6, 18, 30, 35, 37, 37, 32)]
        self.joins, self.far, self.steps = closing(2), closing(5), Integers(coder)
        self.goes_on, self.caps, self.side, self.twisted = Context(), Context(), Context(), Context()

    def read(self):
        self.oriented, self.has_caps = self.bit(Context()), self.bit(Context())
        while self.bit(self.goes_on):
            a, b, c = (self.make_vertex(False) for _ in range(3))
            self.face(a, b, c)
            n = len(self.vertex)
            for v, following, before in ((a, n + 1, n + 2), (c, n + 2, n), (b, n, n + 1)):
                self.push(self.make_node(v, following, before))
            while (P := self.pivot()) is not None:
                while self.on_border[P]:
                    self.grow(P)
        faces, t, turns = [f for f in self.faces if not any(self.is_cap[v] for v in f)], 0, (Context(), Context())
        if not self.oriented:
            for k, (a, b, c) in enumerate(faces):
                t = self.bit(turns[t])
                if t:
                    faces[k] = (a, c, b)
        numbers = {}
        faces = [tuple(numbers.setdefault(v, len(numbers)) for v in f) for f in faces]
        check_manifold(faces)
        return [f[k:] + f[:k] for f in faces for k in [f.index(min(f))]]

    def make_vertex(self, is_cap):
        need(len(self.degree) < 131072, "number of vertices")
        self.degree.append(0)
        self.is_cap.append(is_cap)
        self.capped.append(False)
        return len(self.degree) - 1

    def make_node(self, vertex, following, before):
        self.vertex.append(vertex)
        self.next.append(following)
        self.prev.append(before)
        self.on_border.append(True)
        return len(self.vertex) - 1

    def face(self, *corners):
        need(len(self.faces) < self.most_faces, "number of faces")
        self.faces.append(corners)
        for v in corners:
            self.degree[v] += 1
            self.capped[v] |= any(self.is_cap[a] for a in corners)

    def deg(self, N):
        return self.degree[self.vertex[N]]

    def push(self, N):
        self.queues[min(self.deg(N), 5)].append(N)

    def other(self, N, M):
        return self.prev[N] if self.next[N] == M else self.next[N]

    def link(self, *links):
        for N, M, L in links:
            (self.next if self.next[N] == M else self.prev)[N] = L

    def pivot(self):
        while any(self.queues):
            for k in (5, 4, 3, 2, 1, 0):
                while self.queues[k]:
                    N = self.queues[k].popleft()
                    if self.on_border[N] and min(self.deg(N), 5) == k:
                        return N
                    if self.on_border[N]:
                        self.push(N)
        return None

    def zip(self, *nodes):
        for N in nodes:
            A, B = self.prev[N], self.next[N]
            if self.on_border[N] and self.vertex[A] != self.vertex[B]:
                self.push(N)
            elif self.on_border[N]:
                self.on_border[N] = self.on_border[B] = False
                if A != B:
                    C = self.other(B, N)
                    self.link((A, N, C), (C, B, A))
                    self.push(C)
                    self.push(A)

    def grow(self, P):
        Q, R = self.next[P], self.prev[P]
        ahead = self.deg(Q) >= self.deg(R)
        if not ahead:
            Q, R = R, Q
        S, p, q = self.other(Q, P), self.vertex[P], self.vertex[Q]
        kind = 2 if self.is_cap[p] else int(self.capped[p])

        def add(a):
            self.face(*((p, q, a) if ahead else (q, p, a)))

        if self.bit(self.closes_pivot[kind][min(self.deg(P), 9)]):
            add(self.vertex[R])
            self.on_border[P] = False
            self.link((R, P, Q), (Q, P, R))
            self.zip(R, Q)
        elif S != R and self.bit(self.closes_other[min(self.deg(Q), 9)]):
            add(self.vertex[S])
            self.on_border[Q] = False
            self.link((P, Q, S), (S, Q, P))
            self.zip(S, P)
        elif self.bit(self.joins):
            self.join(P, Q, ahead, add)
        else:
            free = self.has_caps and not any(self.is_cap[v] or self.capped[v] for v in (p, q))
            a = self.make_vertex(bool(free and self.bit(self.caps)))
            add(a)
            Y = self.make_node(a, *((Q, P) if ahead else (P, Q)))
            self.link((P, Q, Y), (Q, P, Y))
            self.push(Y)
            self.push(Q)

    def join(self, P, Q, ahead, add):
        S, R = self.other(Q, P), self.other(P, Q)
        if self.bit(self.far):
            Y = self.coder.raw((len(self.vertex) - 1).bit_length())
            need(0 <= Y < len(self.vertex) and self.on_border[Y], "far join")
            X = self.prev[Y] if ahead else self.next[Y]
        else:
            s, n = self.bit(self.side), self.steps.unsigned()
            need(n <= 64, "steps of a join")
            before, Y = (P, R) if s else (Q, S)
            for _ in range(n + 1):
                before, Y = Y, self.other(Y, before)
            X = self.other(Y, before) if s else before
        y = self.vertex[Y]
        need(Y not in (P, Q, R, S) and y not in (self.vertex[P], self.vertex[Q]), "join")
        if not self.oriented and self.bit(self.twisted):
            X = self.other(Y, X)
        add(y)
        Z = self.make_node(y, *((Q, X) if ahead else (X, Q)))
        self.link((X, Y, Z), (Y, X, P), (P, Q, Y), (Q, P, Z))
        self.zip(Y, Z, P, Q)


def sides(face):
    return [(face[k - 1], face[k]) for k in (1, 2, 0)]


def edge(a, b):
    return (min(a, b), max(a, b))


def by_edge(faces):
    """For each edge, its faces with the vertex across, in the order of faces."""
    found = {}
    for f, face in enumerate(faces):
        for a, b in sides(face):
            found.setdefault(edge(a, b), []).append((f, sum(face) - a - b))
    return found


def check_manifold(faces):
    need(faces, "no faces")
    need(all(len(set(f)) == 3 for f in faces), "vertex twice in a face")
    need(len({tuple(sorted(f)) for f in faces}) == len(faces), "two faces of the same vertices")
    edges, of_vertex = by_edge(faces), {}
    need(all(len(around) <= 2 for around in edges.values()), "edge of three faces")
    for f, face in enumerate(faces):
        for v in face:
            of_vertex.setdefault(v, []).append(f)
    for v, around in of_vertex.items():
        fan, todo = set(), {around[0]}
        while todo:
            fan |= todo
            todo = {g for f in todo for w in faces[f] if w != v for g, _ in edges[edge(v, w)]} - fan
        need(len(fan) == len(around), "two fans at a vertex")


def marks(coder, faces):  # 4.4
    """The sharp edges that are not on the boundary."""
    edges = by_edge(faces)
    todo, marked = ({e for e, around in edges.items() if len(around) == n} for n in (2, 1))
    inner = sorted(todo)
    if not inner or not coder.bit(Context()):
        return []
    if coder.bit(Context()):
        return inner
    line, alone = ([[Context() for _ in range(3)] for _ in range(n)] for n in (5, 3))
    sharp, left = (Counter(v for e in part for v in e) for part in (marked, todo))
    lines = deque(sorted(v for v in sharp if sharp[v] == 1))

    def mark(e, context):
        todo.remove(e)
        if result := coder.bit(context):
            marked.add(e)
        for v in e:
            left[v] -= 1
            sharp[v] += result
            if result and sharp[v] == 1:
                lines.append(v)

    def follow(d):
        rings, seen = [[e for e in marked if d in e]], set()
        while rings[-1]:
            seen.update(rings[-1])
            rings.append(sorted({edge(d, w) for e in rings[-1] for _, w in edges[e]} - seen))
        for e in (e for ring in reversed(rings) for e in ring):
            if e in todo and sharp[d] == 1:
                mark(e, line[min(left[d], 4)][min(sharp[sum(e) - d], 2)])

    for e in dict.fromkeys(edge(*side) for face in faces for side in sides(face)):
        while lines:
            d = lines.popleft()
            if sharp[d] == 1:
                follow(d)
        if e in todo:
            i, j = sorted(min(sharp[v], 2) for v in e)
            mark(e, alone[i][j])
    return [e for e in inner if e in marked]


def positions(coder, faces, eighths):  # 4.5
    edges, n_vertices = by_edge(faces), 1 + max(map(max, faces))
    told, untold, missing, last = Integers(coder), Integers(coder), [3] * len(faces), (0, 0, 0)
    at, near, foretelling, queue = {}, {}, [[] for _ in range(n_vertices)], [deque(), deque(), deque()]

    def following():
        for k in (2, 1, 0):
            while queue[k]:
                d = queue[k].popleft()
                if d not in at and min(len(foretelling[d]), 2) == k:
                    return d
        return None

    def place(d):
        nonlocal last
        here, by = [], foretelling[d]
        for k in range(3):
            total = sum((8 + eighths) * (at[a][k] + at[b][k]) - 2 * eighths * at[c][k] for a, b, c in by)
            if by:
                here.append((8 * len(by) + total) // (16 * len(by)) + told.signed())
            else:
                here.append((at[near[d]] if d in near else last)[k] + untold.signed())
            need(abs(here[k]) <= 262144, "position")
        at[d] = last = tuple(here)
        for f, face in enumerate(faces):
            if d not in face:
                continue
            missing[f] -= 1
            if missing[f]:
                for h in face:
                    if h not in at and h not in near:
                        near[h] = d
                        queue[0].append(h)
                continue
            for a, b in sides(face):
                for other, h in edges[edge(a, b)]:
                    if other == f or h in at:
                        continue
                    foretelling[h].append((a, b, sum(face) - a - b))
                    if len(foretelling[h]) <= 2:
                        queue[len(foretelling[h])].append(h)

    for v in range(n_vertices):
        d = None if v in at else v
        while d is not None:
            place(d)
            d = following()
    return [at[v] for v in range(n_vertices)]
