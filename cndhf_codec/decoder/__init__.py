"""Contents of a file -> queries, grids and surfaces. Needs numpy and zstandard; meshes need the `mesh` extra.

What every representation shares stands here, with `Model` in front of it; what is about height fields, in dhf/.
"""

from .model import Model
from .reading import load, loads, loads_prefix

__all__ = ["Model", "load", "loads", "loads_prefix"]
