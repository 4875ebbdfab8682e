"""The reference decoder of `.cndhf` files: spec/cndhf.md in its order and in its words, slow, with no other purpose.

It needs numpy and zstandard. `python spec/reference.py FILE ...` says what files hold.
"""

from __future__ import annotations

import math
import struct
import sys
import zlib
from collections import Counter, defaultdict, deque
from pathlib import Path

import numpy as np
import zstandard


class RefusedError(Exception):
    """The file is not valid."""


def need(condition, why):
    if not condition:
        raise RefusedError(why)


def bf16(bits):
    return struct.unpack("<f", struct.pack("<I", bits << 16))[0]


def check_quaternion(quaternion):
    need(32000**2 <= sum(x * x for x in quaternion) <= 33000**2, "quaternion")


def decode(data):
    """What a file holds: centre, scale, encoder, source, errors; `dhfs`, or `mesh`."""
    try:
        return read(data)
    except (struct.error, IndexError, StopIteration, UnicodeDecodeError, zstandard.ZstdError) as exc:
        raise RefusedError("end of the bytes, or a frame or text that is not valid") from exc


def read(data):  # 1
    need(data[:4] == b"\x89DHF", "signature")
    need(data[4:5] == b"\x01", "version")
    need(26 <= len(data) <= 2**24, "size of the file")
    body, at, n_sections, bodies = data[:-4], 6, 0, {}
    need(zlib.crc32(body) == int.from_bytes(data[-4:], "little"), "checksum")
    need(data[5] <= 1, "flags")
    *centre, scale = struct.unpack_from("<3df" if data[5] else "<4f", body, at)
    need(all(-(2.0**100) <= x <= 2.0**100 for x in centre), "centre")
    need(2.0**-100 <= scale <= 2.0**100, "scale")
    at += 28 if data[5] else 16
    while at < len(body):
        kind, length, shift, byte = body[at], 0, 0, 128
        while byte >= 128:
            at += 1
            need(at < len(body) and shift < 28, "length of a section")
            byte = body[at]
            length += byte % 128 << shift
            shift += 7
        need(byte > 0 or shift == 7, "length in more bytes than it needs")
        at += 1 + length
        n_sections += 1
        need(at <= len(body) and n_sections <= 16, "section beyond the end, or the 17th")
        need(kind >= 0x80 or kind in (1, 2, 3), "kind of a section")
        if kind in (1, 2, 3, 0x81, 0x82, 0x83):
            need(kind not in bodies, "section twice")
            bodies[kind] = body[at - length : at]
    shapes = [kind for kind in bodies if kind < 4]
    need(len(shapes) == 1, "number of shapes")
    shape = surface(bodies[3]) if shapes == [3] else height_fields(bodies[shapes[0]], shapes[0])
    return {"centre": np.array(centre), "scale": scale, **metadata(bodies), "mesh" if shapes == [3] else "dhfs": shape}


def height_fields(body, kind):  # 2
    need(body and 1 <= body[0] <= 64, "n_dhfs")
    at, dhfs = 1, []
    for _ in range(body[0]):
        fold, *numbers, width, layers, first, hidden = struct.unpack_from("<B10h4B", body, at)
        quaternion, box = numbers[:4], np.reshape(numbers[4:], (3, 2))
        need(fold <= 3 and 1 <= width <= 128 and 1 <= layers <= 8 and first and hidden, "field of a record")
        check_quaternion(quaternion)
        need((box[:, 0] < box[:, 1]).all(), "box")
        shapes = [(width, 2), (width,), *[(width, width), (width,)] * layers, (2, width), (2,)]
        steps = struct.unpack_from(f"{len(shapes)}B", body, at + 25)
        at += 25 + len(shapes)
        omegas = [first] + [hidden] * layers
        dhfs.append({"fold": fold, "quaternion": quaternion, "box": box / 2**14, "omegas": omegas})
        dhfs[-1]["tensors"] = list(zip(shapes, steps, strict=True))
    shapes, steps = zip(*(tensor for d in dhfs for tensor in d["tensors"]), strict=True)
    sizes = [math.prod(shape) for shape in shapes]
    need(sum(sizes) <= 2**20, "number of weights and biases")
    symbols = np.array((zstd_symbols if kind == 1 else rans_symbols)(body[at:], sizes, steps))
    need((abs(symbols) <= 32767).all(), "symbol")
    weights = iter(np.split(symbols, np.cumsum(sizes)))
    for d in dhfs:
        tensors = [(next(weights) * 2.0 ** (-(step % 128) / 4)).reshape(shape) for shape, step in d["tensors"]]
        d["tensors"] = [tensor.astype(np.float32) for tensor in tensors]
    return dhfs


def zstd_symbols(body, sizes, steps):  # 3.1
    need(body[:1] in (b"\x20", b"\x60", b"\xa0"), "frame descriptor")
    digits = {0x20: 1, 0x60: 2, 0xA0: 4}[body[0]]
    content = int.from_bytes(body[1 : 1 + digits], "little") + (256 if digits == 2 else 0)
    wide = np.repeat(np.array(steps) >= 128, sizes)
    need(content == len(wide) + wide.sum(), "content size")
    raw = zstandard.ZstdDecompressor().decompress(b"\x28\xb5\x2f\xfd" + body, allow_extra_data=False)
    need(len(raw) == content, "content of the frame")
    unsigned = np.array([*raw[: len(wide)]])
    unsigned[wide] += 256 * np.array([*raw[len(wide) :]], dtype=int)
    return np.where(unsigned % 2, -(unsigned + 1) // 2, unsigned // 2)


def rans_symbols(body, sizes, steps):  # 3.2
    n = len(sizes)
    need(max(steps) < 128, "wide step")
    need(sum(sizes) <= 32768 + 4 * len(body), "number of symbols")
    *scales, state = struct.unpack_from(f"<{n}BI", body)
    need(all(scale % 128 < 60 for scale in scales), "scale code")
    need(2**23 <= state < 2**31, "state")
    stream = iter(body[n + 4 :])

    def decode_one(bits, freq):
        nonlocal state
        part, start, a = state % 2**bits, 0, 0
        while start + freq[a] <= part:
            start += freq[a]
            a += 1
        state = freq[a] * (state // 2**bits) + part - start
        while state < 2**23:
            state = 256 * state + next(stream)
        return a

    def uniform(bits):
        return decode_one(bits, [1] * 2**bits) if bits else 0

    symbols = []
    for size, scale in zip(sizes, scales, strict=True):
        symbol, freq, low = 0, table(scale % 128), max(0, scale % 128 // 4 - 5)
        for _ in range(size):
            bucket = decode_one(14, freq)
            magnitude = 256 * uniform(8) + uniform(8) if bucket == 63 else bucket * 2**low + uniform(low)
            if scale >= 128:
                symbol += magnitude
            else:
                symbol = -magnitude if magnitude and uniform(1) else magnitude
            symbols.append(symbol)
    need(state == 2**23 and next(stream, None) is None, "end of the weights")
    return symbols


RATIOS = """
5628 58611 307285 991630 2270549 4078822 6171993 8272320 10175896 11780768 13066109 14058751 14805841 15357953 15760736
16051906 16261035 16410554 16517109 16592872 16646655 16684790 16711808 16730939"""


def table(c):
    """The change of a row below 24 is the ratio of two rows before; rows from 24 on repeat the ratios of 18 to 21."""
    rows = [2, 205, *map(int, RATIOS.split())]
    ratio, change = (rows[c + 2], rows[c]) if c < 24 else [rows[20 + c % 4]] * 2
    value, weight = 2**24, [2**23 if c < 24 else 2**24]
    for _ in range(62):
        value = value * ratio // 2**24
        ratio = ratio * change // 2**24
        weight.append(value)
    freq = [1 + w * (2**14 - 64) // sum(weight) for w in [*weight, 0]]
    freq[0] += 2**14 - sum(freq)
    return freq


def surface(body):  # 4
    flags, step = struct.unpack_from("<BH", body)
    need(flags < 64 and flags % 16 <= 8, "flags of the surface")
    need(2.0**-30 <= bf16(step) <= 1, "step")
    quaternion = struct.unpack_from("<4h", body, 3) if flags & 16 else (0, 0, 0, 32767)
    check_quaternion(quaternion)
    coder = RangeDecoder(body[11 if flags & 16 else 3 :])
    faces = Connectivity(coder, len(body)).read()
    sharp = marks(coder, faces)
    grid = positions(coder, faces, flags % 16, flags & 32)
    coder.end()
    return {"quaternion": quaternion, "step": bf16(step), "positions": grid, "faces": faces, "sharp": sharp}


class RangeDecoder:
    """A context is [zero, count], found by its name in the specification."""

    def __init__(self, stream):  # 4.1
        self.stream, self.length, self.taken = stream + bytes(4), len(stream), 4
        self.range, self.code = 2**32 - 1, int.from_bytes(self.stream[:4], "big")
        self.contexts = defaultdict(lambda: [32768, 0])

    def closing(self, c, *name):
        self.contexts[name] = [65536 - 1024 * c, 8]

    def split(self, bound):
        result = int(self.code >= bound)
        self.code -= result * bound
        self.range = self.range - bound if result else bound
        while self.range < 2**24:
            self.range *= 256
            self.code = 256 * self.code + self.stream[self.taken]
            self.taken += 1
        return result

    def bit(self, *name):
        zero, count = self.contexts[name]
        result = self.split(self.range // 2**16 * zero)
        zero += -(zero // (count + 2)) if result else (65536 - zero) // (count + 2)
        self.contexts[name] = [zero, min(count + 1, 62)]
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

    def unsigned(self, model):  # 4.2
        digits = value = 1
        while digits < 21 and self.bit(model, "more", digits):
            digits += 1
        learnt = min(digits - 1, 2)
        for _ in range(learnt):
            value = 2 * value + self.bit(model, "below", digits - 1, value)
        rest = digits - 1 - learnt
        return 2**rest * value + self.raw(rest) - 1

    def signed(self, model):
        if not self.bit(model, "nonzero"):
            return 0
        sign, magnitude = self.bit(model, "negative"), 1 + self.unsigned(model)
        return -magnitude if sign else magnitude


class Node:
    """`ends`: next, prev."""

    def __init__(self, vertex, following=None, before=None):
        self.vertex, self.ends, self.on_border = vertex, [following, before], True

    def other(self, node):
        return self.ends[1 if self.ends[0] is node else 0]

    def link(self, old, new):
        self.ends[0 if self.ends[0] is old else 1] = new


class Connectivity:  # 4.3
    def __init__(self, coder, n_bytes):
        self.coder, self.bit, self.most_faces = coder, coder.bit, min(262144, 65536 + 256 * n_bytes)
        self.nodes, self.degree, self.caps, self.capped, self.faces = [], [], set(), set(), []
        self.queues = [deque() for _ in range(6)]
        for degree in range(10):
            coder.closing((1, 1, 2, 6, 18, 30, 35, 37, 37, 32)[degree], "closes_other", degree)
            for kind in range(3):
                coder.closing((1, 1, 25, 8, 22, 36, 42, 40, 33, 15)[degree], "closes_pivot", kind, degree)
        coder.closing(2, "joins")
        coder.closing(5, "far")

    def read(self):
        self.oriented, self.has_caps = self.bit("oriented"), self.bit("has_caps")
        while self.bit("goes_on"):
            a, b, c = (self.make_vertex() for _ in range(3))
            self.face(a, b, c)
            A, C, B = (self.make_node(v) for v in (a, c, b))
            A.ends, C.ends, B.ends = [C, B], [B, A], [A, C]
            self.push(A, C, B)
            while P := self.pivot():
                while P.on_border:
                    self.grow(P)
        faces, t, numbers = [f for f in self.faces if not self.caps & {*f}], 0, {}
        for k, (a, b, c) in enumerate(faces):
            t = 0 if self.oriented else self.bit("turns", t)
            names = [numbers.setdefault(v, len(numbers)) for v in ((a, c, b) if t else (a, b, c))]
            k_least = names.index(min(names))
            faces[k] = (*names[k_least:], *names[:k_least])
        check_manifold(faces)
        return faces

    def make_vertex(self):
        need(len(self.degree) < 131072, "number of vertices")
        self.degree.append(0)
        return len(self.degree) - 1

    def make_node(self, vertex, following=None, before=None, ahead=True):
        self.nodes.append(Node(vertex, following, before) if ahead else Node(vertex, before, following))
        return self.nodes[-1]

    def face(self, *corners):
        need(len(self.faces) < self.most_faces, "number of faces")
        self.faces.append(corners)
        for v in corners:
            self.degree[v] += 1
        if self.caps & {*corners}:
            self.capped.update(corners)

    def deg(self, N, most):
        return min(self.degree[N.vertex], most)

    def push(self, *nodes):
        for N in nodes:
            self.queues[self.deg(N, 5)].append(N)

    def pivot(self):
        while any(self.queues):
            for k in (5, 4, 3, 2, 1, 0):
                while self.queues[k]:
                    N = self.queues[k].popleft()
                    if N.on_border and self.deg(N, 5) == k:
                        return N
                    if N.on_border:
                        self.push(N)
        return None

    def zip(self, *nodes):
        for N in nodes:
            B, A = N.ends
            if N.on_border and A.vertex != B.vertex:
                self.push(N)
            elif N.on_border:
                N.on_border = B.on_border = False
                if A is not B:
                    C = B.other(N)
                    A.link(N, C)
                    C.link(B, A)
                    self.push(C, A)

    def close(self, N, A, B):
        """Drop N between A and B."""
        N.on_border = False
        A.link(N, B)
        B.link(N, A)
        self.zip(A, B)

    def grow(self, P):
        ahead = self.degree[P.ends[0].vertex] >= self.degree[P.ends[1].vertex]
        Q, R = P.ends if ahead else reversed(P.ends)
        S, p, q = Q.other(P), P.vertex, Q.vertex
        first = (p, q) if ahead else (q, p)
        kind = 2 if p in self.caps else int(p in self.capped)
        if self.bit("closes_pivot", kind, self.deg(P, 9)):
            self.face(*first, R.vertex)
            self.close(P, R, Q)
        elif S is not R and self.bit("closes_other", self.deg(Q, 9)):
            self.face(*first, S.vertex)
            self.close(Q, S, P)
        elif self.bit("joins"):
            self.join(P, Q, R, S, ahead)
        else:
            a = self.make_vertex()
            if self.has_caps and not ({p, q} & self.caps or {p, q} & self.capped) and self.bit("caps"):
                self.caps.add(a)
            self.face(*first, a)
            Y = self.make_node(a, Q, P, ahead)
            P.link(Q, Y)
            Q.link(P, Y)
            self.push(Y, Q)

    def join(self, P, Q, R, S, ahead):
        if self.bit("far"):
            number = self.coder.raw((len(self.nodes) - 1).bit_length())
            need(number < len(self.nodes) and self.nodes[number].on_border, "far join")
            Y = self.nodes[number]
            X = Y.ends[1 if ahead else 0]
        else:
            s, n = self.bit("side"), self.coder.unsigned("steps")
            need(n <= 64, "steps of a join")
            before, Y = (P, R) if s else (Q, S)
            for _ in range(n + 1):
                before, Y = Y, Y.other(before)
            X = Y.other(before) if s else before
        need(Y not in (P, Q, R, S) and Y.vertex not in (P.vertex, Q.vertex), "join")
        if not self.oriented and self.bit("twisted"):
            X = Y.other(X)
        self.face(*((P.vertex, Q.vertex) if ahead else (Q.vertex, P.vertex)), Y.vertex)
        Z = self.make_node(Y.vertex, Q, X, ahead)
        X.link(Y, Z)
        Y.link(X, P)
        P.link(Q, Y)
        Q.link(P, Z)
        self.zip(Y, Z, P, Q)


def sides(face):
    return [(face[k - 1], face[k]) for k in (1, 2, 0)]


def edge(a, b):
    return (min(a, b), max(a, b))


def by_edge(faces):
    """For each edge, its faces with the vertex across, in the order of faces."""
    found = defaultdict(list)
    for f, face in enumerate(faces):
        for a, b in sides(face):
            found[edge(a, b)].append((f, sum(face) - a - b))
    return found


def check_manifold(faces):
    need(faces, "no faces")
    need(all(len({*face}) == 3 for face in faces), "vertex twice in a face")
    need(len({frozenset(face) for face in faces}) == len(faces), "two faces of the same vertices")
    need(all(len(around) <= 2 for around in by_edge(faces).values()), "edge of three faces")
    links = defaultdict(list)  # of a vertex, the sides across from it: they are one chain
    for face in faces:
        for a, b in sides(face):
            links[sum(face) - a - b].append({a, b})
    for around in links.values():
        chain = around.pop()
        while joined := [side for side in around if side & chain]:
            chain |= set().union(*joined)
            around = [side for side in around if side not in joined]
        need(not around, "two fans at a vertex")


def marks(coder, faces):  # 4.4
    """The sharp edges that are not on the boundary."""
    edges = by_edge(faces)
    todo, marked = ({e for e, around in edges.items() if len(around) == n} for n in (2, 1))
    inner = sorted(todo)
    if not inner or not coder.bit("any"):
        return []
    if coder.bit("all"):
        return inner
    sharp, left = (Counter(v for e in part for v in e) for part in (marked, todo))
    lines = deque(sorted(v for v in sharp if sharp[v] == 1))

    def mark(e, *context):
        todo.remove(e)
        result = coder.bit(*context)
        for v in e:
            left[v] -= 1
            sharp[v] += result
            if result and sharp[v] == 1:
                lines.append(v)
        if result:
            marked.add(e)

    def follow(d):
        rings, seen = [[e for e in marked if d in e]], set()
        while rings[-1]:
            seen.update(rings[-1])
            rings.append(sorted({edge(d, w) for e in rings[-1] for _, w in edges[e]} - seen))
        for e in [e for ring in reversed(rings) for e in ring if e in todo]:
            if sharp[d] == 1:
                mark(e, "line", min(left[d], 4), min(sharp[sum(e) - d], 2))

    for e in edges:
        while lines:
            d = lines.popleft()
            if sharp[d] == 1:
                follow(d)
        if e in todo:
            mark(e, "alone", *sorted(min(sharp[v], 2) for v in e))
    return [e for e in inner if e in marked]


def positions(coder, faces, eighths, repeats):  # 4.5
    edges, n_vertices, missing, last = by_edge(faces), 1 + max(map(max, faces)), [3] * len(faces), (0, 0, 0)
    at, near, foretelling, queue = {}, {}, defaultdict(list), [deque(), deque(), deque()]

    def following():
        waiting = (vertices.popleft() for vertices in reversed(queue) for _ in range(len(vertices)))
        return next((d for d in waiting if d not in at), None)

    def place(d):
        nonlocal last
        by, m = foretelling[d], len(foretelling[d])
        here = list(at[near[d]] if d in near else last)
        for k in range(3):
            total = 8 * m + sum((8 + eighths) * (at[a][k] + at[b][k]) - 2 * eighths * at[c][k] for a, b, c in by)
            guess = total // (16 * m) if m else here[k]
            found = sorted({at[v][k] for v in sum(by, ()) if repeats}, key=lambda x: (abs(x - guess), x))
            tried = (x for i, x in enumerate(found) if coder.bit("same", k, min(len(found), 3), min(i, 3)))
            repeated = next(tried, None)
            here[k] = guess + coder.signed("told" if m else "untold") if repeated is None else repeated
            need(abs(here[k]) <= 262144, "position")
        at[d] = last = tuple(here)
        for f in (f for f, face in enumerate(faces) if d in face):
            missing[f] -= 1
            for a, b in sides(faces[f]):
                if missing[f] and a not in at and a not in near:
                    near[a] = d
                    queue[0].append(a)
                for h in [h for g, h in edges[edge(a, b)] if g != f and h not in at and not missing[f]]:
                    foretelling[h].append((a, b, sum(faces[f]) - a - b))
                    if len(foretelling[h]) <= 2:
                        queue[len(foretelling[h])].append(h)

    for v in range(n_vertices):
        d = None if v in at else v
        while d is not None:
            place(d)
            d = following()
    return [at[v] for v in range(n_vertices)]


def metadata(bodies):  # 5
    errors = bodies.get(0x82, bytes(6))
    need(len(errors) == 6 and max(struct.unpack("<3H", errors)) < 0x7F80, "errors")
    found = {"errors": [bf16(bits) for bits in struct.unpack("<3H", errors)] if 0x82 in bodies else None}
    for name, kind in (("encoder", 0x81), ("source", 0x83)):
        need(len(bodies.get(kind, b"")) <= 255, name)
        found[name] = bodies[kind].decode("utf-8") if kind in bodies else None
    return found


def rotation(quaternion):  # 6.1
    *q, w = (float(x) for x in quaternion)
    x, y, z = q
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    square = w * w - x * x - y * y - z * z
    return (square * np.eye(3) + 2 * np.outer(q, q) + 2 * w * cross) / (x * x + y * y + z * z + w * w)


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


def control_vertices(mesh):  # 6.2
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
        middles = [(a, b, c, *(number[edge(*side)] for side in sides((a, b, c)))) for a, b, c in self.faces]
        cuts = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))
        faces = [tuple(face[k] for k in cut) for cut in cuts for face in middles]
        return Level(new, faces, [(v, number[e]) for e in self.sharp for v in e])

    def limit(self):
        w = [1 / (len(around) + 3 / (8 * beta(len(around)))) for around in self.around]
        return np.array([self.dart(v) if len(e) == 1 else self.moved(v, w[v], 1 / 6) for v, e in enumerate(self.along)])

    def dart(self, v):
        n, ring, r = len(self.around[v]), list(self.along[v]), (5 - math.sqrt(21)) / 2
        while len(ring) < n:
            ring.append(next(w for _, w in self.edges[edge(v, ring[-1])] if w not in ring))
        w = np.array([8 / 3 * beta(n) * (1 - (r**i + r ** (n - i)) / (1 + r**n)) for i in range(n)])
        w[0] = 2 * beta(n) + (w[1] + w[n - 1]) / 4
        return (self.vertices[v] + w @ self.vertices[ring]) / (1 + w.sum())

    def normals(self):
        """(F, 3, 3): the normal of each corner of each face."""
        corners = [(f, k) for f in range(len(self.faces)) for k in range(3)]
        starts = [side for face in self.faces for side in sides(face)]
        ends = self.sharp | {edge(*side) for side, n in Counter(starts).items() if n > 1}
        corner_of, after, found, limit = dict(zip(starts, corners, strict=True)), {}, {}, self.limit()
        for f, k in corners:
            v, w = self.faces[f][k], self.faces[f][k - 1]
            if edge(v, w) not in ends:
                after[f, k] = corner_of[v, w]
        for corner in [*(c for c in corners if c not in {*after.values()}), *corners]:
            if corner not in found:
                sector = [corner]
                while (following := after.get(sector[-1], corner)) != corner:
                    sector.append(following)
                found.update(dict.fromkeys(sector, self.normal(sector, limit)))
        return np.array([found[corner] for corner in corners]).reshape(-1, 3, 3)

    def normal(self, sector, limit):
        n, (f, k), (last_f, last_k) = len(sector), sector[0], sector[-1]
        v, others = self.faces[f][k], [self.faces[f][k - 2] for f, k in sector] + [self.faces[last_f][last_k - 1]]
        arm, i, s, t = self.vertices[others] - self.vertices[v], np.arange(n), np.zeros(3), np.zeros(3)
        if len(self.along[v]) < 2 and n == len(self.around[v]):
            s, t = np.cos(2 * np.pi * i / n) @ arm[:n], np.sin(2 * np.pi * i / n) @ arm[:n]
        elif len(self.along[v]) == 2 and {others[0], others[-1]} == {*self.along[v]}:
            x = np.pi / n
            end = 1 if n == 1 else -math.cos(x) / math.tan(x / 2) / (1 + 2 * math.cos(x))
            s, t = arm[0] - arm[n], end * (arm[0] + arm[n]) + np.sin(x * i) @ arm[:n]
        normal = np.cross(s, t)
        if not normal.any():
            for a, b in zip(limit[others[:-1]] - limit[v], limit[others[1:]] - limit[v], strict=True):
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
        try:
            print(path, decode(Path(path).read_bytes()))
        except RefusedError as refused:
            print(path, "refused:", refused)
