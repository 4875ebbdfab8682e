"""The `.cndhf` container: bytes <-> Container. Needs numpy and zstandard only. See spec/cndhf.md."""

from .container import Container, ControlMesh, DhfRecord, Metadata
from .reader import loads, loads_prefix, read_header, section_sizes
from .writer import dumps

__all__ = [
    "Container",
    "ControlMesh",
    "DhfRecord",
    "Metadata",
    "dumps",
    "loads",
    "loads_prefix",
    "read_header",
    "section_sizes",
]
