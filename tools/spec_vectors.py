"""Make spec/vectors, which every decoder of the format is tested with: `python tools/spec_vectors.py`.

It writes files that are missing, and never one that is there: they are frozen, so that a later version shows that it
still reads them. Expected values are those of the reference decoder (spec/reference.py), which knows the specification
alone; they and the indices are written anew. `--check` writes nothing, and tells whether all is there and right.

NAME.cndhf, expected.json          valid files, and what is in them
accepted/NAME.cndhf, index.tsv     odd files: why each is valid; all have the weights of valid.cndhf
refused/NAME.cndhf, index.tsv      files that a decoder must refuse: by which section of the specification; class and
                                   words of the error in this project's decoders, which say why
"""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "spec"), str(ROOT / "tools")]

import manifolds  # noqa: E402
import rawfile  # noqa: E402
import reference  # noqa: E402
import refused_vectors  # noqa: E402

import cndhf_codec  # noqa: E402
from cndhf_codec.format import Container, ControlMesh, DhfRecord, Metadata, dumps, read_header  # noqa: E402
from cndhf_codec.format.container import tensor_shapes  # noqa: E402
from cndhf_codec.format.surface.manifold import edges_of  # noqa: E402
from cndhf_codec.format.surface.positions import MAX_POSITION  # noqa: E402

FOLDER = ROOT / "spec" / "vectors"
CLEAR = 5e-3  # normalised units: in/out is asked only of points farther from the surface
LEVELS = (0, 1, 2)  # of the meshes whose limit points and normals are given
CORNERS = 10  # per level
TURNED = (9000, -14000, 20000, 20000)
STILL = (0, 0, 0, 32767)
PLACE = {"centre": (10.0, -20.0, 3.5), "scale": 4.0}
RING = manifolds.grid(9, 5, wrap=True, wrap_other=True)


def torus(n: int, m: int) -> np.ndarray:
    """(n m, 3) vertices of `manifolds.grid` wrapped in both directions."""
    a, b = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    r = 0.6 + 0.3 * np.cos(b)
    return np.stack([r * np.cos(a), r * np.sin(a), 0.3 * np.sin(b)], axis=-1).reshape(-1, 3)


def surface(
    faces: np.ndarray,
    vertices: np.ndarray | None = None,
    share: float = 0.1,
    turned: bool = False,
    step: float = 2.0**-10,
    **place: Any,
) -> bytes:
    """A control mesh with a share of its inner edges sharp; random vertices where none are given."""
    rng = np.random.default_rng(len(faces))
    faces = np.asarray(faces, dtype=np.int32)
    if vertices is None:
        vertices = rng.uniform(-0.7, 0.7, (int(faces.max()) + 1, 3))
    edges = edges_of(faces)
    interior = edges.vertices[edges.n_faces == 2]
    sharp = interior[rng.random(len(interior)) < share]
    positions = np.round(vertices / step).astype(np.int32)
    mesh = ControlMesh(TURNED if turned else STILL, step, positions, faces, sharp)
    return dumps(Container(**{**PLACE, **place}, metadata=Metadata("spec"), surface=mesh))


def record(
    shape: tuple[int, int],
    draw: Callable[[tuple[int, ...]], np.ndarray],
    first: int = 40,
    turn: tuple[int, int, int, int] = STILL,
    fold: int = 0,
    rising: bool = False,
    octaves: float = 0.0,
) -> DhfRecord:
    """A field whose symbols are drawn, with heights around -0.47 and 0.47 that are some waves. shape: width, hidden
    layers. first: deviation of W_1's symbols. octaves: by how many all steps but the last are finer."""
    width, hidden = shape
    symbols, codes = [], []
    for k, tensor in enumerate(tensor_shapes(width, hidden)):
        deviation = first if k == 2 else 40
        s = np.round(draw(tensor) * deviation).astype(np.int32)
        if rising and len(tensor) == 1:
            s = np.sort(np.abs(s))
        symbols.append(s)
        # W_0 about 0.6; W_j so that a layer's slope is about 1, or deep networks would be chaotic; the last so that
        # heights stay apart.
        size = 0.6 if k < 2 else 0.3 if k % 2 else 0.3 / np.sqrt(width)
        codes.append(round(4 * (np.log2(deviation / size) + octaves)))
    codes[-2:] = [round(4 * np.log2(40 * np.sqrt(width) / 0.1)), 28]
    symbols[-1] = np.array([-60, 60], dtype=np.int32)  # near and far: 2^-7 each
    box = (-9000, 9000, -8000, 8500, -12000, 12000)
    return DhfRecord(turn, box, width, hidden, 6, 5, tuple(codes), tuple(symbols), fold=fold)


def fields(codec: int, *records: DhfRecord, metadata: Metadata | None = None, **place: Any) -> bytes:
    return dumps(Container(**{**PLACE, **place}, dhfs=records, metadata=metadata or Metadata("spec"), codec=codec))


def normal(seed: int) -> Callable[[tuple[int, ...]], np.ndarray]:
    return np.random.default_rng(seed).standard_normal


def sparse(seed: int) -> Callable[[tuple[int, ...]], np.ndarray]:
    """Mostly zero."""
    rng = np.random.default_rng(seed)
    return lambda shape: rng.standard_normal(shape) * (rng.random(shape) < 0.01)


def long_tailed(seed: int) -> Callable[[tuple[int, ...]], np.ndarray]:
    """So that some symbols lie far beyond what a Gaussian has: codec 2 escapes."""
    rng = np.random.default_rng(seed)
    return lambda shape: rng.standard_normal(shape) * np.where(rng.random(shape) < 0.04, 30, 0.3)


def encoded(representation: str) -> bytes:
    """What the encoder makes of the bracket, at the size of the other vectors."""
    if representation == "dhf":
        return (ROOT / "tests" / "golden" / "encoded.cndhf").read_bytes()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = cndhf_codec.encode(
            ROOT / "examples" / "bracket.ply", preset="fast", representation="surface", target_size=700, threads=1
        )
    return model.dumps()


def with_sections(data: bytes) -> bytes:
    """The shape last, unknown optional sections around it, all metadata."""
    header = read_header(data)
    body = data[header.shape.offset :][: header.shape.length]
    parts = [
        (0xFE, bytes(range(200))),
        (rawfile.SOURCE, "Gerät.obj".encode()),
        (rawfile.ERRORS, bytes.fromhex("003f 803f 0040")),
        (0x90, b""),
        (header.shape.kind, body),
        (0x90, b"again"),
        (rawfile.ENCODER, b"other 1.2"),
    ]
    return rawfile.build(parts, **PLACE)


def cubes() -> np.ndarray:
    """Five by three cubes in a plane with two holes."""
    solid = np.ones((5, 3, 1), dtype=bool)
    solid[1::2, 1] = False
    return solid


def touching() -> tuple[np.ndarray, np.ndarray]:
    """Two cubes that share an edge, which is cut: each has vertices of its own there, at the same places."""
    cube = manifolds.voxels(np.ones((1, 1, 1), dtype=bool))
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) / 2
    return manifolds.together(cube, cube), np.concatenate([corners, corners - (0.5, 0.5, 0)])


def ring_of(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A ring of n squares: two boundaries, caps of n faces."""
    faces = manifolds.grid(n, 1, wrap=True)
    a = 2 * np.pi * np.arange(n).repeat(2) / n
    return faces, np.column_stack([0.8 * np.cos(a), 0.8 * np.sin(a), np.tile([0, 0.25], n)])


def extreme() -> np.ndarray:
    """Corners of the largest grid, of a tetrahedron."""
    return np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) * MAX_POSITION * 2.0**-19


VALID: dict[str, Callable[[], bytes]] = {
    "surface-smooth": lambda: surface(RING, torus(9, 5), 0.0),
    "surface-all-sharp": lambda: surface(RING, torus(9, 5), 1.0),
    "surface-creases": lambda: surface(RING, torus(9, 5), 0.2, turned=True),
    "surface-darts": lambda: surface(manifolds.with_flips(RING, np.random.default_rng(7), 40), None, 0.06),
    "surface-corners": lambda: surface(manifolds.voxels(np.ones((2, 1, 1), dtype=bool)), None, 0.6),
    "surface-sheet": lambda: surface(manifolds.grid(5, 4), None, 0.1),
    "surface-moebius": lambda: surface(manifolds.grid(6, 1, wrap=True, twist=True), None, 0.1),
    "surface-klein": lambda: surface(manifolds.KINDS["klein bottle"], None, 0.05),
    "surface-not-oriented": lambda: surface(manifolds.turned(RING, np.random.default_rng(8), 0.4), torus(9, 5), 0.1),
    "surface-holes": lambda: surface(manifolds.without(RING, np.random.default_rng(9), 0.2), None, 0.1),
    "surface-genus": lambda: surface(manifolds.voxels(cubes()), None, 0.1),
    "surface-components": lambda: surface(
        manifolds.together(manifolds.sphere(3), manifolds.fan(7), manifolds.sphere(40), manifolds.grid(1, 1))
    ),
    "surface-touching": lambda: surface(*touching(), 0.3),
    "surface-triangle": lambda: surface(np.array([[0, 1, 2]]), None, 0.0),
    "surface-ring": lambda: surface(*ring_of(60), 0.0, step=2.0**-7),
    "surface-grid": lambda: surface(manifolds.TETRAHEDRON, extreme(), 0.0, step=2.0**-19),
    "surface-far-centre": lambda: surface(RING, torus(9, 5), 0.05, centre=(4.5e6 + 1 / 3, -5e6 - 0.1, 1e-3)),
    "surface-sections": lambda: with_sections(surface(manifolds.grid(2, 2), None, 0.1)),
    "surface-encoded": lambda: encoded("surface"),  # made before coordinates could repeat
    "surface-repeats": lambda: surface(RING, torus(9, 5), 0.2, step=2.0**-5),
    "surface-repeats-encoded": lambda: encoded("surface"),
    "dhf-zstd": lambda: fields(1, record((20, 2), normal(1)), record((20, 2), normal(2), turn=TURNED, fold=1)),
    "dhf-zstd-wide": lambda: fields(1, record((5, 1), normal(3), first=900, octaves=2)),
    "dhf-zstd-widest": lambda: fields(1, record((128, 1), sparse(4))),
    "dhf-rans": lambda: fields(
        2, record((12, 3), normal(5), first=900), record((12, 3), normal(6), first=900, turn=TURNED, fold=1)
    ),
    "dhf-rans-rising": lambda: fields(
        2, record((5, 1), normal(7), rising=True), record((5, 1), normal(8), turn=TURNED, fold=3, rising=True)
    ),
    "dhf-rans-escapes": lambda: fields(2, record((10, 1), long_tailed(9))),
    "dhf-rans-finest": lambda: fields(2, record((6, 1), normal(10), first=9000, octaves=4)),
    "dhf-rans-deepest": lambda: fields(2, record((3, 8), normal(11), fold=2)),
    "dhf-64": lambda: fields(
        2, *(record((1, 1), normal(20 + k), turn=(round(500 * np.sin(k)), 500 * (k % 7), 0, 32700)) for k in range(64))
    ),
    "dhf-far-centre": lambda: fields(1, record((6, 1), normal(12)), centre=(4.5e6 + 1 / 3, -5e6 - 0.1, 1e-3)),
    "dhf-sections": lambda: with_sections(fields(2, record((4, 1), normal(13)))),
    "dhf-encoded": lambda: encoded("dhf"),
}


def expected(data: bytes) -> dict:
    """What the reference decoder finds in a file."""
    shape = reference.decode(data)
    out = {"sha256": hashlib.sha256(data).hexdigest(), "centre": shape["centre"].tolist()}
    out |= {key: shape[key] for key in ("scale", "encoder", "source", "errors")}
    return out | (of_fields(shape) if "dhfs" in shape else of_surface(shape))


def around(shape: dict) -> np.ndarray:
    points = np.random.default_rng(5).uniform(-0.8, 0.8, (600, 3))
    return np.round(shape["centre"] + shape["scale"] * points, 4)


def chosen(points: np.ndarray, is_in: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """Some of the points inside and some of those outside, none near the surface."""
    return np.concatenate([np.flatnonzero(clear & is_in)[:8], np.flatnonzero(clear & ~is_in)[:8]])


def of_fields(shape: dict) -> dict:
    points = around(shape)
    f = reference.implicit(shape, points)
    some = chosen(points, f > 0, np.abs(f) > CLEAR * shape["scale"])
    uv = np.round(np.random.default_rng(4).uniform(-0.7, 0.7, (2 if len(shape["dhfs"]) > 9 else 6, 2)), 3)
    return {
        "points": points[some].tolist(),
        "contains": (f[some] > 0).astype(int).tolist(),
        "f": np.round(f[some], 9).tolist(),
        "uv": uv.tolist(),
        "heights": [np.round(reference.heights(dhf, uv), 9).tolist() for dhf in shape["dhfs"]],
    }


def of_surface(shape: dict) -> dict:
    mesh = shape["mesh"]
    level = reference.Level(reference.control_vertices(mesh), mesh["faces"], mesh["sharp"])
    out = {key: mesh[key] for key in ("quaternion", "step", "positions", "faces", "sharp")}
    out |= {"solid": reference.is_solid(mesh), "levels": []}
    for number in LEVELS:
        out["levels"].append({"level": number, "faces": len(level.faces), "corners": corners(shape, level, number)})
        level = level.next()
    if out["solid"]:
        vertices, points = level.limit(), around(shape)
        normalised = (points - shape["centre"]) / shape["scale"]
        wound = np.array([reference.winding(vertices, level.faces, p) for p in normalised])
        distance = cndhf_codec.Model(decoded(shape)).distance(points) / shape["scale"]
        some = chosen(points, wound > 0.5, np.abs(distance) > CLEAR)
        out |= {"points": points[some].tolist(), "contains": (wound[some] > 0.5).astype(int).tolist()}
    return out


def decoded(shape: dict) -> Container:
    """The shape for the package, which measures distances."""
    mesh = shape["mesh"]
    arrays = [np.array(mesh[key], dtype=np.int32).reshape(-1, n) for key, n in (("positions", 3), ("faces", 3))]
    sharp = np.array(mesh["sharp"], dtype=np.int32).reshape(-1, 2)
    control = ControlMesh(tuple(mesh["quaternion"]), mesh["step"], *arrays, sharp)
    return Container(tuple(shape["centre"].tolist()), shape["scale"], surface=control)


def corners(shape: dict, level: Any, number: int) -> list:
    """Limit points, in input units, and normals at some corners of a level's faces: face, corner, point, normal.

    Face 4 f + k of a level is the k-th that face f of the level before makes: three at its corners, then the middle.
    """
    limit, normals = shape["centre"] + shape["scale"] * level.limit(), level.normals()
    n_faces, n_control = len(level.faces), len(level.faces) // 4**number
    rng = np.random.default_rng(number)
    rows = []
    for f in rng.choice(n_faces, min(n_faces, CORNERS), replace=False).tolist():
        k = int(rng.integers(3))
        # The reference decoder has the first of four faces of all, then the second: see `Level.next`.
        ours, size, way = f, n_faces, []
        while size > n_control:
            size //= 4
            way.append(ours // size)
            ours %= size
        for part in reversed(way):
            ours = 4 * ours + part
        point, normal = limit[level.faces[f][k]], normals[f, k]
        rows.append([ours, k, *np.round(point, 9).tolist(), *np.round(normal, 9).tolist()])
    return rows


def index(rows: dict[str, tuple]) -> str:
    return "".join(sorted("\t".join([f"{name}.cndhf", *rest]) + "\n" for name, (_, *rest) in rows.items()))


def close(a: object, b: object) -> bool:
    """Whether two JSON values are equal, numbers to within 1e-9 of their size."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(close(a[k], b[k]) for k in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(close, a, b))
    if isinstance(a, float) and isinstance(b, (int, float)):
        return abs(a - b) <= 1e-9 * max(1, abs(a))
    return a == b


def main(check: bool) -> int:
    folders = {"refused": refused_vectors.refused(), "accepted": refused_vectors.accepted()}
    files = {FOLDER / f"{name}.cndhf": make for name, make in VALID.items()}
    for folder, rows in folders.items():
        files |= {FOLDER / folder / f"{name}.cndhf": lambda row=row: row[0] for name, row in rows.items()}
    wrong = [f"{path.name} is no vector" for path in FOLDER.rglob("*.cndhf") if path not in files]
    for path, make in files.items():
        if not path.exists() and not check:
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(make())
        wrong += [f"{path.name} is missing"] if not path.exists() else []
    for path in FOLDER.glob("refused/*.cndhf"):
        try:
            reference.decode(path.read_bytes())
            wrong.append(f"{path.name} is not refused")
        except reference.RefusedError:
            pass
    for path in FOLDER.glob("accepted/*.cndhf"):
        reference.decode(path.read_bytes())
    texts = {FOLDER / folder / "index.tsv": index(rows) for folder, rows in folders.items()}
    values = {p.stem: expected(p.read_bytes()) for p in sorted(FOLDER.glob("*.cndhf"))}
    values = json.loads(json.dumps(values))
    target = FOLDER / "expected.json"
    if check:
        wrong += [f"{path.name} is old" for path, text in texts.items() if path.read_text("utf-8") != text]
        wrong += [] if close(json.loads(target.read_text("utf-8")), values) else ["expected.json is old"]
    else:
        for path, text in texts.items():
            path.write_text(text, encoding="utf-8")
        lines = ",\n".join(f"{json.dumps(k)}: {json.dumps(v, separators=(',', ':'))}" for k, v in values.items())
        target.write_text("{\n" + lines + "\n}\n", encoding="utf-8")
    print("\n".join(wrong) or f"{len(files)} files are there, and expected values are right")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] == ["--check"]))
