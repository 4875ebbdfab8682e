"""The examples in the docstrings run. They name files from the repository's root."""

from __future__ import annotations

import doctest
import importlib

import pytest
from places import ROOT

MODULES = [
    pytest.param("cndhf_codec.batch.many", marks=pytest.mark.encode),
    "cndhf_codec.decoder.gridfile",
    "cndhf_codec.decoder.limits",
    "cndhf_codec.decoder.meshfile",
    "cndhf_codec.decoder.model",
    "cndhf_codec.decoder.reading",
    "cndhf_codec.decoder.results",
    "cndhf_codec.encoder.check",
    pytest.param("cndhf_codec.encoder.pipeline", marks=pytest.mark.encode),
    "cndhf_codec.errors",
    "cndhf_codec.integrations.meshio",
    "cndhf_codec.integrations.torch",
    "cndhf_codec.integrations.trimesh",
    "cndhf_codec.viewer.page",
]
# What their examples need besides numpy and zstandard. Where it is missing, the test is skipped.
NEEDS = {
    "cndhf_codec.batch.many": ["numba"],
    "cndhf_codec.decoder.meshfile": ["trimesh"],
    "cndhf_codec.encoder.check": ["igl", "embreex"],
    "cndhf_codec.encoder.pipeline": ["torch", "numba"],
    "cndhf_codec.decoder.model": ["trimesh", "manifold3d"],
    "cndhf_codec.integrations.meshio": ["meshio", "trimesh"],
    "cndhf_codec.integrations.torch": ["torch"],
    "cndhf_codec.integrations.trimesh": ["trimesh"],
}


@pytest.mark.parametrize("name", MODULES)
def test_examples(name, monkeypatch):
    for module in NEEDS.get(name, []):
        pytest.importorskip(module)
    monkeypatch.chdir(ROOT)
    failed, attempted = doctest.testmod(importlib.import_module(name))
    assert attempted > 0
    assert failed == 0


def test_every_public_function_of_the_decoder_has_an_example():
    from cndhf_codec import Limits, Model, decoder
    from cndhf_codec.decoder.reading import load_stream

    functions = [decoder.load, decoder.loads, decoder.loads_prefix, load_stream, Limits, Model]
    functions += [x for name, x in vars(Model).items() if not name.startswith("_")]
    assert len(functions) > 18
    assert [f for f in functions if ">>>" not in f.__doc__] == []
