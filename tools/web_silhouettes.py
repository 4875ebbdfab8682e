"""Make the silhouettes that shapes must have in a browser, and the triangles of their default meshes:
`python tools/web_silhouettes.py` writes web/test/silhouettes.json, by this package's decoder. `--check` only tells
whether it is current."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from cndhf_codec import Model, load

ROOT = Path(__file__).resolve().parents[1]
TARGET = ROOT / "web" / "test" / "silhouettes.json"
NAMES = (
    "surface-smooth", "surface-all-sharp", "surface-creases", "surface-darts", "surface-sheet", "surface-moebius",
    "surface-not-oriented", "surface-holes", "surface-genus", "surface-components", "surface-triangle",
    "surface-encoded", "dhf-rans", "dhf-zstd", "dhf-encoded",
)  # fmt: skip
OTHERS = ("tests/golden/by-hand.cndhf", "tests/golden/surface.cndhf", "examples/bracket.cndhf")
# `test/browser.test.mjs` has the same numbers.
PIXELS, HALF, VIEW = 96, 1.1, np.array([-0.5, -0.6, -0.7])


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


def differing(one: str, other: str) -> int:
    """In how many pixels two silhouettes differ."""
    return (int(one, 16) ^ int(other, 16)).bit_count()


def main(check: bool) -> int:
    values = {}
    for path in [*(f"spec/vectors/{name}.cndhf" for name in NAMES), *OTHERS]:
        model = load(ROOT / path)
        values[path] = {"representation": model.representation, "silhouette": silhouette(model)}
        if model.representation == "surface":
            values[path]["triangles"] = len(model.surface().faces)
    if check:
        there = json.loads(TARGET.read_text("utf-8"))
        same = there.keys() == values.keys() and all(
            differing(there[path]["silhouette"], value["silhouette"]) <= 3
            and there[path].get("triangles") == value.get("triangles")
            for path, value in values.items()
        )
        print("web/test/silhouettes.json is", "right" if same else "old: run python tools/web_silhouettes.py")
        return 0 if same else 1
    lines = ",\n".join(f"{json.dumps(path)}: {json.dumps(value)}" for path, value in values.items())
    TARGET.write_text("{\n" + lines + "\n}\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] == ["--check"]))
