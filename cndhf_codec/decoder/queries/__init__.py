"""Queries of a triangle mesh with numpy: what every representation answers from its surface.

cells.py answers in or out, with crossings.py; tree.py finds nearest points and first hits, with single.py.
"""

from .triangles import TriangleQueries

__all__ = ["TriangleQueries"]
