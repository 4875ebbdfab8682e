"""cndhf-codec: 3D meshes in one to twenty kilobytes.

model = cndhf_codec.encode("in.obj")      # needs the `encode` extra
model.save("out.cndhf")
model = cndhf_codec.load("out.cndhf")     # numpy and zstandard only
model.contains(points), model.to_mesh()   # to_mesh needs the `mesh` extra
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .decoder.limits import Limits
    from .decoder.model import Model
    from .decoder.reading import load, loads, loads_prefix
    from .encoder.check import Check, check
    from .encoder.pipeline import encode
    from .encoder.report import Report
    from .errors import (
        CndhfError,
        CndhfWarning,
        EncodeError,
        FormatError,
        InputError,
        MeshError,
        MissingExtraError,
        OptionError,
        OutputError,
        SheetError,
        SurfaceError,
    )

__version__ = "0.1.0"
__all__ = [
    "Check",
    "CndhfError",
    "CndhfWarning",
    "EncodeError",
    "FormatError",
    "InputError",
    "Limits",
    "MeshError",
    "MissingExtraError",
    "Model",
    "OptionError",
    "OutputError",
    "Report",
    "SheetError",
    "SurfaceError",
    "check",
    "encode",
    "load",
    "loads",
    "loads_prefix",
]

_HOMES = {
    "Check": "encoder.check",
    "CndhfError": "errors",
    "CndhfWarning": "errors",
    "EncodeError": "errors",
    "FormatError": "errors",
    "InputError": "errors",
    "Limits": "decoder.limits",
    "MeshError": "errors",
    "MissingExtraError": "errors",
    "Model": "decoder.model",
    "OptionError": "errors",
    "OutputError": "errors",
    "Report": "encoder.report",
    "SheetError": "errors",
    "SurfaceError": "errors",
    "check": "encoder.check",
    "encode": "encoder.pipeline",
    "load": "decoder.reading",
    "loads": "decoder.reading",
    "loads_prefix": "decoder.reading",
}


def __getattr__(name: str) -> Any:
    # Imported on first use, so that a program that only decodes never loads the encoder's libraries.
    if name in _HOMES:
        return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
