"""What `meshes.py` fuzzes: a byte that chooses the kind, and a mesh file, to a Mesh.

Two limits of the readers are lower here: what copies (instances, components) may come to, and what may come out of a
compressed file. By design a small file may ask for much there, up to those limits; everything else is to be measured.
Draco and meshoptimizer are libraries in C that this package does not vouch for: here they are never installed.
"""

from __future__ import annotations

import struct
from typing import NoReturn

from cndhf_codec.errors import InputError, MeshError, MissingExtraError
from cndhf_codec.mesh import read as reader
from cndhf_codec.mesh.formats import accessors, common, gltf

ALLOWED = (MeshError, InputError, MissingExtraError)
KINDS = (None, *reader.READERS)  # by the first byte of an input; None is a stream
# The files beside a .gltf: corners and faces of a tetrahedron.
BESIDE = {"a.bin": struct.pack("<12f12H", *(0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1), *(0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3))}


def _absent(module: str, extra: str) -> NoReturn:
    raise MissingExtraError(f"this needs {module}, which is not fuzzed; extra {extra}")


gltf.require = accessors.require = _absent  # type: ignore[assignment]
common.MOST_TRIANGLES, common.MOST_COPIES = 2**16, 2**10
reader.MOST_TIMES, reader.PIECE = 8, 2**16


def _beside(uri: str) -> bytes:
    if uri not in BESIDE:
        raise common.UnreadableError(f"names the file {uri!r} beside it, which is not there")
    return BESIDE[uri]


def read(data: bytes) -> reader.Mesh:
    """Raises one of ALLOWED; all else is a finding."""
    return reader._of_bytes(data[1:], "input", KINDS[data[0] % len(KINDS)] if data else None, _beside)
