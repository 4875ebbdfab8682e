"""The public API, and what it costs to import."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
import sys

import pytest

import cndhf_codec

HEAVY = [
    "torch",
    "trimesh",
    "skimage",
    "scipy",
    "click",
    "embreex",
    "igl",
    "numba",
    "tqdm",
    "manifold3d",
]


def loaded_by(code: str, *arguments: str) -> set[str]:
    """Top-level modules that a fresh interpreter has after running `code`."""
    script = f"import sys\n{code}\nimport json\nprint(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))"
    command = [sys.executable, "-W", "error", "-c", script, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout))


def test_import_costs_nothing():
    modules = loaded_by("import cndhf_codec")
    assert not modules & {*HEAVY, "zstandard"}


def test_decoding_needs_numpy_and_zstandard_only(golden):
    modules = loaded_by(
        "import cndhf_codec\n"
        "model = cndhf_codec.load(sys.argv[1])\n"
        "model.contains([[0, 0, 0]]), model.implicit([[0, 0, 0]]), model.heights(0, [0, 0]), model.info\n"
        "model.occupancy(16), model.dumps()",
        str(golden / "encoded.cndhf"),
    )
    assert not modules & set(HEAVY)
    assert {"numpy", "zstandard"} <= modules


def test_surfaces_need_no_encoder(golden):
    modules = loaded_by(
        "import warnings, cndhf_codec\n"
        "warnings.simplefilter('default')\n"  # trimesh's own imports
        "cndhf_codec.load(sys.argv[1]).to_mesh(16)",
        str(golden / "encoded.cndhf"),
    )
    assert not modules & {"torch", "igl", "numba"}  # trimesh takes embreex where it is installed


def test_every_public_name_resolves():
    for name in cndhf_codec.__all__:
        assert getattr(cndhf_codec, name) is not None
        assert name in dir(cndhf_codec)
    assert {"encode", "load", "loads", "Model", "CndhfError"} <= set(cndhf_codec.__all__)


def test_a_name_that_is_not_there():
    with pytest.raises(AttributeError, match="frobnicate"):
        cndhf_codec.frobnicate  # noqa: B018


def test_version():
    assert cndhf_codec.__version__ == importlib.metadata.version("cndhf-codec")


def test_every_error_is_a_cndhf_error():
    from cndhf_codec import errors

    found = [
        e
        for e in vars(errors).values()
        if isinstance(e, type) and issubclass(e, Exception) and e is not errors.CndhfWarning
    ]
    assert len(found) > 15
    assert all(issubclass(e, cndhf_codec.CndhfError) for e in found)


@pytest.mark.parametrize(
    ("gone", "use", "extra"),
    [
        ("trimesh", lambda model: model.to_mesh(16), "mesh"),
        ("manifold3d", lambda model: model.to_mesh(method="intersection"), "mesh"),
        ("torch", lambda model: cndhf_codec.encode("a.ply"), "encode"),
    ],
)
def test_a_missing_extra_is_named(monkeypatch, golden, gone, use, extra):
    model = cndhf_codec.load(golden / "encoded.cndhf")
    monkeypatch.setitem(sys.modules, gone, None)
    with pytest.raises(ImportError, match=rf"needs {gone.split('.')[0]}.*pip install '.\[{extra}\]'") as e:
        use(model)
    assert isinstance(e.value, cndhf_codec.CndhfError)
