"""Container -> heights, occupancy, surfaces. numpy and zstandard; the `mesh` extra only for surfaces."""

from .model import Model, load, loads, loads_prefix

__all__ = ["Model", "load", "loads", "loads_prefix"]
