"""Files as people have them are read as what they hold, or refused with a reason.

tests/trials has our own (see make.py there); CNDHF_TRIALS names a folder of more, with what is right in EXPECTED.tsv.
"""

from __future__ import annotations

import csv
import os
import re
from pathlib import Path

import numpy as np
import pytest

from cndhf_codec.errors import MeshError
from cndhf_codec.mesh.read import Mesh, read_mesh

TESTS = Path(__file__).parent.parent
OURS = TESTS / "trials"
OTHERS = Path(os.environ.get("CNDHF_TRIALS", TESTS.parent.parent / "shared" / "trials"))


def table(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


def volume(mesh: Mesh) -> float:
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return float((np.cross(a, b) * c).sum() / 6)


def area(mesh: Mesh) -> float:
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def is_closed(mesh: Mesh) -> bool:
    """Whether faces run along every edge as often one way as the other. A fan over a concave polygon passes, a polygon
    that lost a corner does not."""
    ends = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    there = {tuple(e) for e in ends.tolist()}
    return all((b, a) in there for a, b in there)


INDEX = table(OURS / "index.tsv")


def test_no_file_is_without_a_row():
    files = {p.name for p in OURS.iterdir()} - {"make.py", "index.tsv", "l.bin", "__pycache__"}
    assert files == {row["file"] for row in INDEX}


@pytest.mark.parametrize("row", INDEX, ids=[row["file"] for row in INDEX])
def test_ours(row):
    path = OURS / row["file"]
    if row["error"]:
        with pytest.raises(MeshError) as caught:
            read_mesh(path)
        assert row["error"] in str(caught.value)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)
        return
    mesh = read_mesh(path)
    # The quantised ones are off by half a step.
    assert volume(mesh) == pytest.approx(float(row["volume"]), rel=2e-3)
    assert area(mesh) == pytest.approx(float(row["area"]), rel=2e-3)
    box = np.array(row["box"].split(), dtype=float)
    np.testing.assert_allclose([*mesh.vertices.min(axis=0), *mesh.vertices.max(axis=0)], box, atol=2e-3)
    assert is_closed(mesh)
    assert row["note"] in "; ".join(mesh.notes)
    assert bool(mesh.notes) == bool(row["note"])


# Where EXPECTED.tsv says in words what is right: the error's text, or volume and faces.
ERRORS = {
    "p-obj-zero.obj": "line 13: index 0 is not allowed",
    "p-obj-1e200.obj": "outside 1e-30 to 1e+30",
    "obj-comma.obj": "line 1: '0,000' is no number",
    "stl-last-cut.stl": "the file is cut short",
    "stl-bin-count0.stl": "the header says 0 triangles, the file has room for 20",
}
VOLUMES = {
    **dict.fromkeys(["p-obj-ftab-some.obj", "p-obj-vtab.obj", "p-obj-indent-some.obj", "p-obj-comment-eol.obj"], 14),
    **dict.fromkeys(["p-obj-bom.obj", "p-off-wrapped.off", "p-ply-mixed-bin.ply", "p-ply-trailing-nl.ply"], 14),
    "p-stl-path.stl": 14,
    # Its section is a square that stands on a corner, of area 2, its height 2: 4, and not the 8 of its box.
    "off-comment-mid.off": 4,
    "geo-thin.ply": 0.016,
    "geo-sheet.ply": None,  # a sheet holds nothing
    "geo-36spheres.ply": 3.93373,
    "geo-hollow.stl": 3.28275,
}
NOTES = {"stl-bin-tail.stl": "2 bytes behind them", "stl-no-endsolid.stl": "no line 'endsolid'"}
OTHER_ROWS = table(OTHERS / "EXPECTED.tsv") if OTHERS.is_dir() else []


@pytest.mark.skipif(not OTHER_ROWS, reason="no folder of trials; name one in CNDHF_TRIALS")
@pytest.mark.parametrize("row", OTHER_ROWS, ids=[row["file"] for row in OTHER_ROWS])
def test_others(row):
    name = row["file"]
    if name in ERRORS:
        with pytest.raises(MeshError, match=re.escape(ERRORS[name])):
            read_mesh(OTHERS / name)
        return
    mesh = read_mesh(OTHERS / name)
    right = float(row["volume"]) if row["volume"] else VOLUMES[name]
    if right is not None:
        # One file's strip winds inward: its volume is negative.
        assert abs(volume(mesh)) == pytest.approx(right, rel=1e-3)
    if row["box"]:
        lo, hi = (np.array(end.split(), dtype=float) for end in row["box"].split(" to "))
        np.testing.assert_allclose(mesh.vertices.min(axis=0), lo, atol=1e-3 * np.ptp([lo, hi]))
        np.testing.assert_allclose(mesh.vertices.max(axis=0), hi, atol=1e-3 * np.ptp([lo, hi]))
    assert is_closed(mesh) or name in ("geo-sheet.ply", "geo-stray-triangle.ply", "glb-fan-mixed.glb")
    assert NOTES.get(name, "") in "; ".join(mesh.notes)
    assert bool(mesh.notes) == (name in NOTES)
