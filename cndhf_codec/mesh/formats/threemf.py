"""Read 3MF: the build items, with components and transforms (3MF core specification 1.3, and production)."""

from __future__ import annotations

import io
import posixpath
import re
import zipfile
import zlib
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np

from ...arrays import F64, I64
from .common import Triangles, UnreadableError, check_count, check_indices, joined, number, shown, whole

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
# Namespaces of extensions that a file may require: they say what surfaces look like, and how they are sliced.
KNOWN = {
    CORE,
    PRODUCTION,
    "http://schemas.microsoft.com/3dmanufacturing/material/2015/02",
    "http://schemas.microsoft.com/3dmanufacturing/slice/2015/07",
    "http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07",
}
MOST_BYTES = 2**31  # of a model, unpacked
DEEPEST = 32  # most levels of components within components
ROOT, RELATIONS = "3d/3dmodel.model", "_rels/.rels"


@dataclass
class Object3MF:
    """A mesh, or components: other objects, by part and number, with transforms (4, 3)."""

    kind: str
    vertices: list[float] = field(default_factory=list)
    triangles: list[int] = field(default_factory=list)
    components: list[tuple[tuple[str, str], F64 | None]] = field(default_factory=list)
    triangles_at: Triangles | None = None


def is_3mf(data: bytes) -> bool:
    return data.startswith(b"PK") and re.search(rb"3d/[^\0]*\.model", data, re.IGNORECASE) is not None


def read_3mf(data: bytes) -> Triangles:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = {_key(name): name for name in archive.namelist()}
            package = _Package(archive, names, min(MOST_BYTES, 1000 * len(data) + 2**16))
            return package.built(package.root())
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError, ValueError) as exc:
        raise UnreadableError(f"the ZIP archive is damaged, or of a kind that is not read: {str(exc)[:80]}") from exc


class _Package:
    def __init__(self, archive: zipfile.ZipFile, names: dict[str, str], most_bytes: int) -> None:
        self._archive, self._names, self._room = archive, names, most_bytes
        self._objects: dict[tuple[str, str], Object3MF] = {}
        self._parts: dict[str, _Part] = {}
        self._triangles = self._vertices = self._copies = self._others = 0

    def root(self) -> str:
        """Find the part that the package's relationships name as the model, or the usual one."""
        if RELATIONS in self._names:
            for relation in re.findall(rb"<Relationship\b[^>]*>", self._bytes(RELATIONS)):
                target = re.search(rb"\bTarget\s*=\s*[\"']([^\"']+)", relation)
                if target and re.search(rb"/3dmodel[\"']", relation):
                    return _key(target[1].decode("utf-8", "replace"))
        root = ROOT if ROOT in self._names else next((n for n in self._names if n.endswith(".model")), None)
        if root is None:
            raise UnreadableError("is a ZIP archive without a 3D model: no 3MF file; unpack it")
        return root

    def built(self, root: str) -> Triangles:
        part = self._part(root)
        out = []
        for key, transform in part.items:
            out += self._placed(key, transform, 0)
        notes = []
        if self._others:
            notes.append(f"{self._others} objects that are supports or no parts of the model were left out")
        if not any(len(p.faces) for p in out):
            raise UnreadableError("holds no triangles: nothing is to be built")
        both = joined(out)
        return Triangles(both.vertices, both.faces, notes + both.notes)

    def _part(self, name: str) -> _Part:
        if name not in self._parts:
            self._parts[name] = part = _Part(name, self._bytes(name))
            self._objects.update(part.objects)
        return self._parts[name]

    def _bytes(self, name: str) -> bytes:
        if name not in self._names:
            raise UnreadableError(f"the archive has no part {shown(name)}")
        info = self._archive.getinfo(self._names[name])
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise UnreadableError(f"the part {shown(name)} is not compressed by Deflate, as 3MF demands; zip it anew")
        self._room -= info.file_size
        if self._room < 0:
            raise UnreadableError(f"the part {shown(name)} claims {info.file_size} bytes unpacked, too many to be true")
        with self._archive.open(info) as file:
            return file.read(info.file_size + 1)

    def _object(self, key: tuple[str, str]) -> Object3MF:
        self._part(key[0])
        if key not in self._objects:
            raise UnreadableError(f"names the object {shown(key[1])} of {shown(key[0])}, which is not there")
        return self._objects[key]

    def _placed(self, key: tuple[str, str], transform: F64 | None, depth: int) -> list[Triangles]:
        if depth > DEEPEST:
            raise UnreadableError(f"objects are nested more than {DEEPEST} deep, or within themselves")
        found = self._object(key)
        if found.kind in ("support", "solidsupport", "other"):
            self._others += 1
            return []
        out = []
        if found.triangles:
            self._triangles += len(found.triangles) // 3
            self._vertices += len(found.vertices) // 3
            check_count(self._triangles, self._vertices)
            out.append(_moved(_mesh(found, key[1]), transform))
        for inner, own in found.components:
            out += self._placed(inner, _product(own, transform), depth + 1)
            self._copies += 1
            check_count(0, 0, self._copies)
        return out


def _key(name: str) -> str:
    """Normalise a part's name: in OPC, case and a leading slash make no difference."""
    return posixpath.normpath(name).lstrip("/").lower()


def _mesh(found: Object3MF, name: str) -> Triangles:
    if found.triangles_at is None:
        vertices = np.array(found.vertices, dtype=np.float64).reshape(-1, 3)
        faces: I64 = np.array(found.triangles, dtype=np.int64).reshape(-1, 3)
        check_indices(faces.ravel(), len(vertices), lambda k: f"object {shown(name)}, triangle {k // 3}")
        found.triangles_at = Triangles(vertices, faces)
    return found.triangles_at


def _product(inner: F64 | None, outer: F64 | None) -> F64 | None:
    """Apply the inner transform, then the outer one. Vectors are rows, as in the file."""
    if inner is None or outer is None:
        return inner if outer is None else outer
    out = inner @ outer[:3]
    out[3] += outer[3]
    return out


def _moved(mesh: Triangles, transform: F64 | None) -> Triangles:
    if transform is None:
        return mesh
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a determinant of NaN can divide by zero
        vertices = mesh.vertices @ transform[:3] + transform[3]
        mirrored = np.linalg.det(transform[:3]) < 0
    return Triangles(vertices, mesh.faces[:, ::-1] if mirrored else mesh.faces)


class _Part:
    """One model part: its objects and its build items."""

    def __init__(self, name: str, text: bytes) -> None:
        self.name = name
        self._shown = shown(name, 80)[1:-1]  # without its quotes
        self.objects: dict[tuple[str, str], Object3MF] = {}
        self.items: list[tuple[tuple[str, str], F64 | None]] = []
        self._object: Object3MF | None = None
        self._namespaces: dict[str, str] = {}
        self._parser = parser = expat.ParserCreate(namespace_separator=" ")
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartNamespaceDeclHandler = self._declared
        parser.StartDoctypeDeclHandler = self._doctype
        try:
            parser.Parse(text, True)
        except expat.ExpatError as exc:
            raise UnreadableError(f"{self._shown}, line {exc.lineno}: the XML is damaged: {str(exc)[:60]}") from exc
        except (LookupError, ValueError) as exc:
            raise UnreadableError(
                f"{self._shown}: the XML is of an encoding that is not read; save it as UTF-8"
            ) from exc

    def _where(self) -> str:
        return f"{self._shown}, line {self._parser.CurrentLineNumber}"

    def _doctype(self, *_: object) -> None:
        raise UnreadableError(f"{self._shown}: has a document type, which 3MF does not allow")

    def _declared(self, prefix: str | None, uri: str) -> None:
        self._namespaces[prefix or ""] = uri

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        space, _, name = tag.rpartition(" ")
        if space not in (CORE, ""):
            if name in ("beamlattice", "booleanshape", "displacementmesh", "levelset", "volumetric"):
                raise UnreadableError(f"{self._where()}: '{name}' is a shape that is not read; export triangles")
            return
        if name == "vertex" and self._object:
            self._object.vertices += [number(attributes.get(axis, ""), self._where()) for axis in "xyz"]
        elif name == "triangle" and self._object:
            self._object.triangles += [whole(attributes.get(v, ""), self._where()) for v in ("v1", "v2", "v3")]
        elif name == "object":
            self._object = Object3MF(attributes.get("type", "model"))
            self.objects[self.name, attributes.get("id", "")] = self._object
        elif name == "component" and self._object:
            self._object.components.append(self._reference(attributes))
        elif name == "item":
            self.items.append(self._reference(attributes))
        elif name == "model":
            for prefix in attributes.get("requiredextensions", "").split():
                uri = self._namespaces.get(prefix, prefix)
                if uri not in KNOWN:
                    raise UnreadableError(f"requires the 3MF extension {shown(uri, 80)}, which is not read")

    def _end(self, tag: str) -> None:
        if tag.rpartition(" ")[2] == "object":
            self._object = None

    def _reference(self, attributes: dict[str, str]) -> tuple[tuple[str, str], F64 | None]:
        path = attributes.get(f"{PRODUCTION} path")
        part = self.name if path is None else _key(path)
        text = attributes.get("transform")
        transform = None
        if text is not None:
            words = text.split()
            if len(words) != 12:
                raise UnreadableError(f"{self._where()}: a transform of {len(words)} numbers, not 12")
            transform = np.array([number(word, self._where()) for word in words]).reshape(4, 3)
        return (part, attributes.get("objectid", "")), transform
