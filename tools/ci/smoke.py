"""Does an installed package work? `python -W error tools/ci/smoke.py base|mesh|encode`.

base: golden files are read and answer queries. mesh: also, one gives a surface, and the commands print their version.
encode: also, examples/bracket.ply is encoded and decoded. Warnings are errors where the package alone is imported.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import warnings
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def run(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [Path(sys.executable).with_name(f"cndhf-{name}"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def base() -> None:
    import cndhf_codec

    if Path(cndhf_codec.__file__).is_relative_to(ROOT):
        sys.exit("this is the checkout, not what was installed")
    files = sorted([*ROOT.glob("tests/golden/*.cndhf"), *ROOT.glob("examples/*.cndhf")])
    assert files
    for file in files:
        model = cndhf_codec.load(file)
        points = [[0.0, 0.0, 0.0], [1e6, 0.0, 0.0]]
        if model.info.get("closed", True):
            inside = model.contains(points)
            assert inside.shape == (2,)
            assert not inside[1]
        else:  # a sheet
            assert model.nearest(points).distance[1] > 0
        assert model.info
        assert "<iframe" in model.show()._repr_html_()  # the viewer's page is there
    if not find_spec("click"):
        done = run("info", str(files[0]))
        assert done.returncode == 1
        assert ".[cli]" in done.stderr, done.stderr
    print(f"cndhf-codec {cndhf_codec.__version__}: read {len(files)} files")


def mesh() -> None:
    import cndhf_codec

    warnings.simplefilter("default")  # other libraries' own imports
    surface = cndhf_codec.load(ROOT / "tests/golden/encoded.cndhf").to_mesh(64)
    assert surface.is_watertight
    assert surface.volume > 0
    for name in ("encode", "decode", "info", "compare", "view", "batch"):
        done = run(name, "--version")
        assert version("cndhf-codec") in done.stdout, done
    print(f"a surface of {len(surface.faces)} faces; six commands")


def encode() -> None:
    import cndhf_codec

    source = ROOT / "examples/bracket.ply"
    model = cndhf_codec.encode(source, preset="fast", axes=2, width=8)
    with tempfile.TemporaryDirectory() as folder:
        model.save(Path(folder) / "a.cndhf")
        size = (Path(folder) / "a.cndhf").stat().st_size
        surface = cndhf_codec.load(Path(folder) / "a.cndhf").to_mesh(64)
    assert surface.is_watertight
    assert model.info["mean_error"] < 0.02 * model.info["scale"], model.info["mean_error"]
    print(f"encoded to {size} bytes, mean error {model.info['mean_error']:.3f}")


PARTS = {"base": [base], "mesh": [base, mesh], "encode": [base, mesh, encode]}

if __name__ == "__main__":
    for part in PARTS[sys.argv[1]]:
        part()
