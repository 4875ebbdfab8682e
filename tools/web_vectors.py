"""Make the files and the expected values that the tests of web/ decode: `python tools/web_vectors.py`.

Writes web/test/vectors/NAME.cndhf for shapes that are made here, and web/test/vectors/expected.json for these, the
golden files and the example. `--check` only compares with what is there, to tolerances. Values are those of this
package's decoder; points of in/out queries keep clear of the surface, where a decoder may answer either way.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import manifolds  # noqa: E402

from cndhf_codec import Model, loads  # noqa: E402
from cndhf_codec.decoder.surface.levels import Level, next_level  # noqa: E402
from cndhf_codec.decoder.surface.normals import limit_normals, sectors_of  # noqa: E402
from cndhf_codec.decoder.surface.subdivision import topology_of  # noqa: E402
from cndhf_codec.format import Container, ControlMesh, DhfRecord, Metadata, dumps  # noqa: E402
from cndhf_codec.format.container import tensor_shapes  # noqa: E402
from cndhf_codec.format.surface.manifold import edges_of  # noqa: E402

FOLDER = ROOT / "web" / "test" / "vectors"
CLEAR = 1e-3  # normalised units: in/out is asked only of points farther from the surface
LEVELS = (0, 1, 3)  # of the meshes that are compared
CORNERS = 24  # per level
# Of silhouettes. `test/browser.test.mjs` has the same numbers.
PIXELS, HALF, VIEW = 96, 1.1, np.array([-0.5, -0.6, -0.7])
TURNED = (9000, -14000, 20000, 20000)


def torus(n: int, m: int) -> np.ndarray:
    """(n m, 3) vertices of `manifolds.grid` wrapped in both directions."""
    a, b = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    r = 0.6 + 0.3 * np.cos(b)
    return np.stack([r * np.cos(a), r * np.sin(a), 0.3 * np.sin(b)], axis=-1).reshape(-1, 3)


def surface(faces: np.ndarray, vertices: np.ndarray | None, share: float, turned: bool = False) -> Container:
    """A control mesh with a share of its inner edges sharp; random vertices where none are given."""
    rng = np.random.default_rng(len(faces))
    faces = np.asarray(faces, dtype=np.int32)
    if vertices is None:
        vertices = rng.uniform(-0.7, 0.7, (int(faces.max()) + 1, 3))
    edges = edges_of(faces)
    interior = edges.vertices[edges.n_faces == 2]
    sharp = interior[rng.random(len(interior)) < share]
    positions = np.round(vertices * 2**10).astype(np.int32)
    mesh = ControlMesh(TURNED if turned else (0, 0, 0, 32767), 2.0**-10, positions, faces, sharp)
    return Container((10.0, -20.0, 3.5), 4.0, metadata=Metadata("web"), surface=mesh)


def fields(codec: int, width: int, hidden: int, rising: bool = False) -> Container:
    """Two random double height fields, one turned, one folded, that are a solid."""
    rng = np.random.default_rng(width)
    records = []
    for k, turn in enumerate(((0, 0, 0, 32767), TURNED)):
        symbols = []
        for shape in tensor_shapes(width, hidden):
            deviation = 900 if codec == 2 and len(symbols) == 2 else 40
            s = np.round(rng.standard_normal(shape) * deviation).astype(np.int32)
            if rising and len(shape) == 1:
                s = np.sort(np.abs(s))
            symbols.append(s)
        symbols[-1] = np.array([-60, 60], dtype=np.int32)  # near and far
        codes = [24, 24, *[36, 26] * hidden, 38, 28]
        if codec == 2:
            codes[2] = 52
        box = (-9000, 9000, -8000, 8500, -12000, 12000)
        records.append(
            DhfRecord(turn, box, width, hidden, 6, 5, tuple(codes), tuple(symbols), fold=3 * k if rising else k)
        )
    return Container((10.0, -20.0, 3.5), 4.0, tuple(records), Metadata("web", 0.5, 1.0, 2.0, "ä"), codec)


def containers() -> dict[str, Container]:
    rng = np.random.default_rng(7)
    ring = manifolds.grid(9, 5, wrap=True, wrap_other=True)
    cubes = np.ones((5, 3, 1), dtype=bool)
    cubes[1::2, 1] = False
    return {
        "smooth": surface(ring, torus(9, 5), 0.0),
        "all-sharp": surface(ring, torus(9, 5), 1.0),
        "creases": surface(ring, torus(9, 5), 0.2, turned=True),
        "darts": surface(manifolds.with_flips(ring, rng, 40), None, 0.06),
        "sheet": surface(manifolds.grid(5, 4), None, 0.1),
        "strip": surface(manifolds.grid(6, 1, wrap=True, twist=True), None, 0.1),
        "not-oriented": surface(manifolds.turned(ring, rng, 0.4), torus(9, 5), 0.1),
        "holes": surface(manifolds.without(ring, rng, 0.2), None, 0.1),
        "genus": surface(manifolds.voxels(cubes), None, 0.1),
        "components": surface(
            manifolds.together(manifolds.sphere(3), manifolds.fan(7), manifolds.sphere(40), manifolds.grid(1, 1)),
            None,
            0.1,
        ),
        "triangle": surface(np.array([[0, 1, 2]]), None, 0.0),
        "fields-rans": fields(2, 12, 3),
        "fields-rising": fields(2, 5, 1, rising=True),
        "fields-zstd": fields(1, 20, 2),
    }


def silhouette(model: Model) -> str:
    """Which pixels of an image the shape covers, seen along `VIEW`: a hexadecimal digit per four pixels, by rows from
    the bottom. The image's half side is `HALF` scales; its middle is the centre."""
    ahead = VIEW / np.linalg.norm(VIEW)
    right = np.cross(ahead, [0, 1, 0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    at = HALF * (2 * (np.arange(PIXELS) + 0.5) / PIXELS - 1)
    y, x = np.meshgrid(at, at, indexing="ij")
    rays = x[..., None] * right + y[..., None] * up - 3 * ahead
    c = model.container
    origins = (np.array(c.centre) + c.scale * rays).reshape(-1, 3)
    hits = model.ray_intersect(origins, np.broadcast_to(ahead, origins.shape))
    return np.packbits(np.isfinite(hits.distance)).tobytes().hex()


def expected(data: bytes) -> dict:
    model = loads(data)
    info = model.info
    out = {key: info[key] for key in ("bytes", "sections", "representation", "centre", "scale", "encoder", "source")}
    out["errors"] = [info["mean_error"], info["p99_error"], info["max_error"]]
    out["silhouette"] = silhouette(model)
    return out | (of_fields(model) if model.representation == "dhf" else of_surface(model))


def inside(model: Model, points: np.ndarray, distance: np.ndarray) -> dict:
    """Half of the points inside where there are so many, none near the surface."""
    far = distance > CLEAR
    is_in = model.contains(points)
    chosen = np.concatenate([np.flatnonzero(far & is_in)[:16], np.flatnonzero(far & ~is_in)[:16]])
    return {"points": points[chosen].tolist(), "contains": is_in[chosen].astype(int).tolist()}


def around(model: Model) -> np.ndarray:
    points = np.random.default_rng(5).uniform(-0.8, 0.8, (4000, 3))
    return np.round(np.array(model.container.centre) + model.container.scale * points, 4)


def of_fields(model: Model) -> dict:
    uv = np.round(np.random.default_rng(4).uniform(-0.7, 0.7, (12, 2)), 3)
    points = around(model)
    f = model.implicit(points)
    out = inside(model, points, np.abs(f) / model.container.scale)
    n = len(model.container.dhfs)
    return out | {
        "implicit": model.implicit(out["points"]).tolist(),
        "uv": uv.tolist(),
        "heights": [model.heights(i, uv).tolist() for i in range(n)],
    }


def of_surface(model: Model) -> dict:
    control = model.container.surface
    out: dict = {
        "quaternion": list(control.quaternion),
        "step": control.step,
        "positions": control.positions.ravel().tolist(),
        "faces": control.faces.ravel().tolist(),
        "sharp": control.sharp.ravel().tolist(),
        "closed": model.info["closed"],
        "meshes": [corners(model, level) for level in LEVELS],
    }
    if model.info["closed"] and model._shape.oriented:
        points = around(model)
        out |= inside(model, points, np.abs(model.distance(points)) / model.container.scale)
    return out


def corners(model: Model, number: int) -> dict:
    """Limit points and normals at some corners of a level's faces: the way to a face through the levels, its corner,
    then position and normal. Face 4 f + k of the next level is the k-th that face f makes: three at its corners, then
    the middle one."""
    control = model.container.surface
    mesh = topology_of(control.faces, len(control.positions), control.sharp)
    level = Level(0, mesh, control.vertices)
    sizes = []
    for _ in range(number):
        sizes.append(len(level.topology.faces))
        level = next_level(level)
    topology = level.topology
    sectors = sectors_of(topology)
    normals = limit_normals(topology, level.vertices, level.limit, sectors)
    rng = np.random.default_rng(number)
    n = len(topology.faces)
    rows = []
    for f in rng.choice(n, min(n, CORNERS), replace=False).tolist():
        way = f
        path = []
        for size in reversed(sizes):
            path.append(way // size)
            way %= size
        ours = way
        for k in reversed(path):
            ours = 4 * ours + k
        c = int(rng.integers(3))
        p = np.array(model.container.centre) + model.container.scale * level.limit[topology.faces[f, c]]
        rows.append([ours, c, *np.round(p, 9).tolist(), *np.round(normals[sectors.corners[f, c]], 9).tolist()])
    return {"level": number, "faces": n, "sectors": len(sectors.vertices), "corners": rows}


def close(a: object, b: object) -> bool:
    """Whether two JSON values are equal, numbers to within 1e-6."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(close(a[k], b[k]) for k in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(close, a, b))
    if isinstance(a, float) and isinstance(b, (int, float)):
        return abs(a - b) <= 1e-6 * max(1, abs(a))
    return a == b


def main(check: bool) -> int:
    made = {name: dumps(container) for name, container in containers().items()}
    paths = [f"web/test/vectors/{name}.cndhf" for name in made]
    paths += [f"tests/golden/{p.name}" for p in sorted((ROOT / "tests/golden").glob("*.cndhf"))]
    paths += ["examples/bracket.cndhf"]
    if not check:
        FOLDER.mkdir(parents=True, exist_ok=True)
        for name, data in made.items():
            (FOLDER / f"{name}.cndhf").write_bytes(data)
    values = json.loads(json.dumps({path: expected((ROOT / path).read_bytes()) for path in paths}))
    target = FOLDER / "expected.json"
    if check:
        same = close(json.loads(target.read_text("utf-8")), values)
        print("web/test/vectors/expected.json is", "right" if same else "old: run python tools/web_vectors.py")
        return 0 if same else 1
    lines = ",\n".join(f"{json.dumps(k)}: {json.dumps(v, separators=(',', ':'))}" for k, v in values.items())
    target.write_text("{\n" + lines + "\n}\n", encoding="utf-8")
    print(f"{len(paths)} files, {target.stat().st_size} bytes of expected values")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] == ["--check"]))
