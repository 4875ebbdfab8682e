"""Make the golden files: `python tests/golden/make.py`. Only for a new format version: it never overwrites.

The tests of every later version decode these files. To make one again would hide the changes that the test looks for.

encoded.cndhf    a short encode of examples/bracket.ply with two axes and width 8
by-hand.cndhf    codec 1, wide symbols, an unknown optional section, all metadata, a centre of float64
expected.json    SHA-256 and decoded values of both
surface.cndhf    a ring and a closed part: two components, one open, a turned frame, sharp edges
surface.json     SHA-256 of it, and the control mesh that it holds
"""

from __future__ import annotations

import hashlib
import json
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

import manifolds  # noqa: E402
import rawfile  # noqa: E402

from cndhf_codec import encode, loads  # noqa: E402
from cndhf_codec.encoder import settings  # noqa: E402
from cndhf_codec.format import Container, ControlMesh, Metadata, dumps  # noqa: E402
from cndhf_codec.format.surface.manifold import edges_of  # noqa: E402


def encoded() -> bytes:
    settings.PRESETS["fast"] = replace(
        settings.PRESETS["fast"], steps=300, batch=1024, target_resolution=128, verify_resolution=64
    )
    return encode(HERE.parent.parent / "examples" / "bracket.ply", preset="fast", axes=2, width=8, threads=1).dumps()


def by_hand() -> bytes:
    rng = np.random.default_rng(2024)
    width, hidden = 3, 2
    sizes = [6, 3, 9, 3, 9, 3, 6, 2]
    codes, low, high = [], b"", b""
    for dhf in range(2):
        for k, n in enumerate(sizes):
            wide = k in (0, 5, 7)
            u = rng.integers(0, 700 if wide else 256, n)
            if k == len(sizes) - 1:
                u = np.array([1201, 1400])  # near and far bias: -601 and 700 steps of 2^-10, so that it is a solid
            codes.append((40 if k == 7 else 41 + dhf) | (0x80 if wide else 0))
            low += (u & 0xFF).astype(np.uint8).tobytes()
            if wide:
                high += (u >> 8).astype(np.uint8).tobytes()
    boxes = [(-9000, 9000, -8000, 8500, -12000, 12000), (-10000, 10000, -11000, 9000, -9500, 9600)]
    turns = [(0, 0, 0, 32767), (9000, -14000, 20000, 20000)]
    records = b"".join(
        rawfile.record(0, turns[i], boxes[i], width, hidden, (30, 20), bytes(codes[8 * i : 8 * i + 8]))
        for i in range(2)
    )
    parts = [
        (0xC0, b"of a later version"),
        rawfile.fields(records, rawfile.frame(low + high), n_dhfs=2),
        (rawfile.ENCODER, b"by hand"),
        (rawfile.ERRORS, struct.pack("<3H", 0x3E00, 0x3F00, 0x4000)),  # 0.125, 0.5, 2
        (rawfile.SOURCE, "Gerät.obj".encode()),
    ]
    return rawfile.build(parts, flags=1, centre=(1e5 + 0.1, -2e5, 3.5), scale=40.0)


def values(data: bytes) -> dict:
    model = loads(data)
    rng = np.random.default_rng(1)
    uv = np.round(rng.uniform(-0.6, 0.6, (8, 2)), 3)
    points = np.round(model.container.centre + model.container.scale * rng.uniform(-0.7, 0.7, (2000, 3)), 3)
    inside = model.contains(points)
    points = np.concatenate([points[inside][:8], points[~inside][:8]])
    symbols = [s.astype("<i4").tobytes() for d in model.container.dhfs for s in d.symbols]
    meta = model.container.metadata
    return {
        "sha256": hashlib.sha256(data).hexdigest(),
        "centre": list(model.container.centre),
        "scale": model.container.scale,
        "metadata": [meta.encoder, meta.mean_error, meta.p99_error, meta.max_error, meta.source],
        "symbols_sha256": hashlib.sha256(b"".join(symbols)).hexdigest(),
        "step_codes": [list(d.step_codes) for d in model.container.dhfs],
        "uv": uv.tolist(),
        "heights": [model.heights(i, uv).tolist() for i in range(len(model.container.dhfs))],
        "points": points.tolist(),
        "implicit": model.implicit(points).tolist(),
    }


def surface() -> bytes:
    faces = manifolds.together(manifolds.grid(4, 2, wrap=True), manifolds.sphere(6))
    edges = edges_of(faces)
    interior = edges.vertices[edges.n_faces == 2]
    rng = np.random.default_rng(2024)
    positions = rng.integers(-900, 900, (int(faces.max()) + 1, 3)).astype(np.int32)
    mesh = ControlMesh((9000, -14000, 20000, 20000), 2.0**-10, positions, faces, interior[::3])
    metadata = Metadata("by hand", 0.125, 0.5, 2.0, "Gerät.obj")
    return dumps(Container((1e5, -2e5, 3.5), 40.0, metadata=metadata, surface=mesh))


def control_mesh(data: bytes) -> dict:
    c = loads(data).container
    return {
        "sha256": hashlib.sha256(data).hexdigest(),
        "centre": list(c.centre),
        "scale": c.scale,
        "quaternion": list(c.surface.quaternion),
        "step": c.surface.step,
        "positions": c.surface.positions.tolist(),
        "faces": c.surface.faces.tolist(),
        "sharp": c.surface.sharp.tolist(),
    }


def make_surface() -> None:
    data = surface()
    (HERE / "surface.cndhf").write_bytes(data)
    (HERE / "surface.json").write_text(json.dumps(control_mesh(data)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if not (HERE / "surface.cndhf").exists():
        make_surface()
    if (HERE / "encoded.cndhf").exists() or (HERE / "expected.json").exists():
        sys.exit("the golden files exist; they are frozen")
    expected = {}
    for name, data in (("encoded.cndhf", encoded()), ("by-hand.cndhf", by_hand())):
        (HERE / name).write_bytes(data)
        expected[name] = values(data)
    (HERE / "expected.json").write_text(json.dumps(expected, indent=1) + "\n", encoding="utf-8")
