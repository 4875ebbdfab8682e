"""Encode many meshes: in worker processes of this machine, or on a Ray cluster.

`cndhf-batch` (`run.py`) keeps a folder of `.cndhf` files beside a folder of meshes, with a manifest of what is done.
"""

from __future__ import annotations

from .jobs import Limits, Result
from .many import encode_many

__all__ = ["Limits", "Result", "encode_many"]
