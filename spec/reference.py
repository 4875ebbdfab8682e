"""The reference decoder of `.cndhf` files: spec/cndhf.md in its order and in its words, slow, with no other purpose.

It needs numpy and zstandard. `python spec/reference.py FILE ...` says what files hold.
"""

from __future__ import annotations

import math
import struct
import sys
import zlib
from collections import Counter, deque

import numpy as np
import zstandard


class RefusedError(Exception):
    """The file is not valid."""


def need(condition, why):
    if not condition:
        raise RefusedError(why)


def bf16(two):
    return struct.unpack("<f", b"\0\0" + two)[0]


def check_quaternion(quaternion):
    need(32000**2 <= sum(x * x for x in quaternion) <= 33000**2, "quaternion")


# 1. Layout


def decode(data):
    """What a file holds: centre, scale, encoder, source, errors; `dhfs`, or `mesh`."""
    need(data[:4] == b"\x89DHF", "signature")
    need(data[4:5] == b"\x01", "version")
    need(26 <= len(data) <= 2**24, "size of the file")
    end = len(data) - 4
    need(zlib.crc32(data[:end]) == int.from_bytes(data[end:], "little"), "checksum")
    need(data[5] <= 1, "flags")
    layout, at = ("<3df", 34) if data[5] else ("<4f", 22)
    need(at <= end, "end inside the header")
    *centre, scale = struct.unpack(layout, data[6:at])
    need(all(-(2.0**100) <= x <= 2.0**100 for x in centre), "centre")
    need(2.0**-100 <= scale <= 2.0**100, "scale")
    count, bodies = 0, {}
    while at < end:
        kind, length, shift, byte = data[at], 0, 0, 128
        while byte >= 128:
            at += 1
            need(at < end and shift < 28, "length of a section")
            byte = data[at]
            length += byte % 128 << shift
            shift += 7
        need(byte > 0 or shift == 7, "length in more bytes than it needs")
        at += 1 + length
        count += 1
        need(at <= end and count <= 16, "section beyond the end, or the 17th")
        if kind in (1, 2, 3, 0x81, 0x82, 0x83):
            need(kind not in bodies, "section twice")
            bodies[kind] = data[at - length : at]
        else:
            need(kind & 0x80, "kind of a section")
    shapes = [kind for kind in bodies if kind < 4]
    need(len(shapes) == 1, "number of shapes")
    kind, body = shapes[0], bodies[shapes[0]]
    shape = {"mesh": surface(body)} if kind == 3 else {"dhfs": height_fields(body, kind)}
    return {"centre": np.array(centre), "scale": scale, **metadata(bodies), **shape}


# 2. Double height fields: records


def height_fields(body, kind):
    need(body and 1 <= body[0] <= 64, "n_dhfs")
    at, dhfs = 1, []
    for _ in range(body[0]):
        need(len(body) >= at + 25, "end inside a record")
        fold, *numbers, width, layers, first, hidden = struct.unpack_from("<B10h4B", body, at)
        quaternion, box = numbers[:4], numbers[4:]
        need(fold <= 3 and 1 <= width <= 128 and 1 <= layers <= 8 and first and hidden, "field of a record")
        check_quaternion(quaternion)
        need(all(box[k] < box[k + 1] for k in (0, 2, 4)), "box")
        shapes = [(width, 2), (width,), *[(width, width), (width,)] * layers, (2, width), (2,)]
        at += 25 + len(shapes)
        need(len(body) >= at, "end inside a record")
        dhfs.append(
            {
                "fold": fold,
                "quaternion": quaternion,
                "box": np.array(box).reshape(3, 2) / 2**14,
                "omegas": [first] + [hidden] * layers,
                "steps": body[at - len(shapes) : at],
                "shapes": shapes,
            }
        )
    sizes = [math.prod(shape) for d in dhfs for shape in d["shapes"]]
    steps = [step for d in dhfs for step in d["steps"]]
    need(sum(sizes) <= 2**20, "number of weights and biases")
    symbols = iter((zstd_symbols if kind == 1 else rans_symbols)(body[at:], sizes, steps))
    for d in dhfs:
        d["tensors"] = [
            (np.array(next(symbols)) * 2.0 ** (-(step % 128) / 4)).astype(np.float32).reshape(shape)
            for step, shape in zip(d["steps"], d["shapes"], strict=True)
        ]
    return dhfs


# 3. Double height fields: weights


def zstd_symbols(body, sizes, steps):  # 3.1
    need(body[:1] in (b"\x20", b"\x60", b"\xa0"), "frame descriptor")
    digits = {0x20: 1, 0x60: 2, 0xA0: 4}[body[0]]
    content = int.from_bytes(body[1 : 1 + digits], "little") + (256 if digits == 2 else 0)
    n_low = sum(sizes)
    need(content == n_low + sum(n for n, step in zip(sizes, steps, strict=True) if step >= 128), "content size")
    try:
        raw = zstandard.ZstdDecompressor().decompress(b"\x28\xb5\x2f\xfd" + body, allow_extra_data=False)
    except zstandard.ZstdError as exc:
        raise RefusedError("frame") from exc
    need(len(raw) == content, "content of the frame")
    low, high, tensors = iter(raw[:n_low]), iter(raw[n_low:]), []
    for size, step in zip(sizes, steps, strict=True):
        unsigned = [next(low) + (256 * next(high) if step >= 128 else 0) for _ in range(size)]
        tensors.append([-(u + 1) // 2 if u % 2 else u // 2 for u in unsigned])
        need(min(tensors[-1]) >= -32767, "symbol")
    return tensors


def rans_symbols(body, sizes, steps):  # 3.2
    need(all(step < 128 for step in steps), "wide step")
    need(sum(sizes) <= 32768 + 4 * len(body), "number of symbols")
    need(len(body) >= len(sizes) + 4, "end inside the scale codes or the state")
    need(all(byte % 128 < 60 for byte in body[: len(sizes)]), "scale code")
    state, stream = int.from_bytes(body[len(sizes) : len(sizes) + 4], "little"), iter(body[len(sizes) + 4 :])
    need(2**23 <= state < 2**31, "state")

    def decode_one(bits, freq):
        nonlocal state
        part, start, a = state % 2**bits, 0, 0
        while start + freq[a] <= part:
            start += freq[a]
            a += 1
        state = freq[a] * (state // 2**bits) + part - start
        while state < 2**23:
            byte = next(stream, None)
            need(byte is not None, "end of the stream")
            state = 256 * state + byte
        return a

    def uniform(bits):
        return decode_one(bits, [1] * 2**bits) if bits else 0

    tensors = []
    for size, byte in zip(sizes, body, strict=False):
        c, rising, symbol, freq, tensor = byte % 128, byte >= 128, 0, table(byte % 128), []
        low = max(0, c // 4 - 5)
        for _ in range(size):
            bucket = decode_one(14, freq)
            magnitude = 256 * uniform(8) + uniform(8) if bucket == 63 else bucket * 2**low + uniform(low)
            if rising:
                symbol += magnitude
            else:
                symbol = -magnitude if magnitude and uniform(1) else magnitude
            need(abs(symbol) <= 32767, "symbol")
            tensor.append(symbol)
        tensors.append(tensor)
    need(state == 2**23 and next(stream, None) is None, "end of the weights")
    return tensors


# fmt: off
RATIOS = [
    5628, 58611, 307285, 991630, 2270549, 4078822, 6171993, 8272320, 10175896, 11780768, 13066109, 14058751, 14805841,
    15357953, 15760736, 16051906, 16261035, 16410554, 16517109, 16592872, 16646655, 16684790, 16711808, 16730939,
    16517109, 16592872, 16646655, 16684790,
]
# fmt: on
CHANGES = [2, 205, *RATIOS[:22], *RATIOS[24:]]


def table(c):
    row = c if c < 24 else 24 + c % 4
    ratio, value, weight = RATIOS[row], 2**24, [2**23 if c < 24 else 2**24]
    for _ in range(62):
        value = value * ratio // 2**24
        ratio = ratio * CHANGES[row] // 2**24
        weight.append(value)
    freq = [1 + w * (2**14 - 64) // sum(weight) for w in [*weight, 0]]
    freq[0] += 2**14 - sum(freq)
    return freq


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
    return {"quaternion": quaternion, "step": step, "positions": grid, "faces": faces, "sharp": sharp}


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


# 5. Metadata


def metadata(bodies):
    errors = bodies.get(0x82, bytes(6))
    need(len(errors) == 6 and all(bits < 0x7F80 for bits in struct.unpack("<3H", errors)), "errors")
    found = {"errors": [bf16(errors[k : k + 2]) for k in (0, 2, 4)] if 0x82 in bodies else None}
    for name, kind in (("encoder", 0x81), ("source", 0x83)):
        need(len(bodies.get(kind, b"")) <= 255, name)
        try:
            found[name] = bodies[kind].decode("utf-8") if kind in bodies else None
        except UnicodeDecodeError as exc:
            raise RefusedError(name) from exc
    return found


# 6. The shape: 6.1 double height fields


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


if __name__ == "__main__":
    for path in sys.argv[1:]:
        with open(path, "rb") as file:
            content = file.read()
        try:
            print(path, decode(content))
        except RefusedError as refused:
            print(path, "refused:", refused)
