"""Read glTF 2.0's JSON, with errors that name the place, and its buffers, buffer views and accessors, as arrays."""

from __future__ import annotations

import base64
import binascii
import json
import re
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from ...arrays import F64, I64
from ...errors import require
from .common import UnreadableError, told

KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # componentType
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# Most numbers of an accessor without data, which are 0: a few bytes can ask for billions. Morph targets have such
# accessors, as large as their meshes, so more are allowed per byte of buffers that was read before.
MOST_ZEROS, ZEROS_A_BYTE = 2**20, 64
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")

Object = dict[str, Any]
Numbers = npt.NDArray[np.generic]
# Returns the bytes at a buffer's relative address. Raises UnreadableError.
Fetch = Callable[[str], bytes]


def parse(data: bytes) -> Object:
    """Parse the JSON of a glTF file."""
    try:
        root = json.loads(data.removeprefix(b"\xef\xbb\xbf"))
    except (ValueError, RecursionError) as exc:
        raise UnreadableError(f"the JSON is damaged: {str(exc)[:80]}") from exc
    if not isinstance(root, dict) or not isinstance(root.get("asset"), dict):
        raise UnreadableError("is JSON without an asset: no glTF file")
    version = root["asset"].get("version")
    if not isinstance(version, str) or not version.startswith("2."):
        raise UnreadableError(f"is glTF of version {told(version)}; only 2.0 is read: export it anew")
    return root


def section(owner: Object, key: str, kind: type, where: str) -> Any:
    """Return owner[key], or an empty object or list where it is missing. Raises UnreadableError for another type."""
    found = owner.get(key, kind())
    if not isinstance(found, kind):
        raise UnreadableError(f"{where}: {key} is no {'object' if kind is dict else 'list'}")
    return found


def objects(owner: Object, key: str, where: str) -> list[Object]:
    found = section(owner, key, list, where)
    if not all(isinstance(item, dict) for item in found):
        raise UnreadableError(f"{where}: {key} holds what is no object")
    return cast("list[Object]", found)


def count_of(owner: Object, key: str, where: str, default: int | None = None) -> int:
    """Return owner[key], a whole number from 0 on. Raises UnreadableError for anything else."""
    found = owner.get(key, default)
    if isinstance(found, float) and found.is_integer():
        found = int(found)
    if not isinstance(found, int) or isinstance(found, bool) or not 0 <= found < 2**53:
        raise UnreadableError(f"{where}: {key} is {told(found)}, no whole number from 0 on")
    return found


def vector_of(owner: Object, key: str, length: int | None, where: str) -> F64 | None:
    """Return owner[key] as numbers (length,), or None where it is missing."""
    if key not in owner:
        return None
    found = owner[key]
    if not isinstance(found, list) or not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in found):
        raise UnreadableError(f"{where}: {key} is no list of numbers")
    if length is not None and len(found) != length:
        raise UnreadableError(f"{where}: {key} has {len(found)} numbers, not {length}")
    try:
        return np.array(found, dtype=np.float64)
    except OverflowError as exc:
        raise UnreadableError(f"{where}: {key} holds a number that is too large") from exc


def item(root: Object, kind: str, index: Any, where: str) -> tuple[Object, str]:
    """Return the object of this number in the list root[kind], and its name for messages."""
    items = section(root, kind, list, "the file")
    if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(items):
        raise UnreadableError(f"{where}: names {kind} {told(index)}, but there are {len(items)}")
    if not isinstance(items[index], dict):
        raise UnreadableError(f"{kind} {index}: is no object")
    return items[index], f"{kind} {index}"


class Accessors:
    """A document's accessors as arrays. binary: the GLB's own chunk, if there is one."""

    def __init__(self, root: Object, binary: bytes | None, fetch: Fetch) -> None:
        self.root, self.notes = root, list[str]()
        self._binary, self._fetch = binary, fetch
        self._buffers: dict[int, bytes] = {}
        self._views: dict[int, bytes] = {}

    def has_data(self, index: Any, where: str) -> bool:
        accessor, _ = item(self.root, "accessors", index, where)
        return "bufferView" in accessor or "sparse" in accessor

    def shape(self, index: Any, where: str) -> tuple[int, int]:
        """Count and components of an accessor, as declared."""
        accessor, name = item(self.root, "accessors", index, where)
        kind = accessor.get("type")
        if not isinstance(kind, str) or kind not in COMPONENTS:
            raise UnreadableError(f"{name}: its type {told(kind)} is not read")
        return count_of(accessor, "count", name), COMPONENTS[kind]

    def floats(self, index: Any, components: int, where: str) -> F64:
        """(count, components) float64, integers normalised where the accessor says so (glTF 2.0, 3.6.2.2)."""
        accessor = item(self.root, "accessors", index, where)[0]
        raw = self._raw(index, components, where)
        if accessor.get("normalized") is True and raw.dtype.kind in "iu":
            largest = 2 ** (8 * raw.itemsize - (raw.dtype.kind == "i")) - 1
            return np.maximum(raw.astype(np.float64) / largest, -1)
        return raw.astype(np.float64)

    def integers(self, index: Any, components: int, where: str) -> I64:
        """(count, components) int64."""
        raw = self._raw(index, components, where)
        if raw.dtype.kind == "f":
            raise UnreadableError(f"{where}: its integers are stored as floats")
        return raw.astype(np.int64)

    def _raw(self, index: Any, components: int, where: str) -> Numbers:
        """(count, components) as stored, checked against the declared minimum and maximum."""
        accessor, name = item(self.root, "accessors", index, where)
        count, width = self.shape(index, where)
        if width != components:
            raise UnreadableError(f"{where}: {name} has {width} components; {components} are needed")
        kind = self._kind(accessor, name)
        if "bufferView" in accessor:
            at = count_of(accessor, "byteOffset", name, 0)
            out = self._strided(accessor["bufferView"], at, kind, count, width, name)
        else:
            if count * width > max(MOST_ZEROS, ZEROS_A_BYTE * sum(map(len, self._buffers.values()))):
                raise UnreadableError(f"{name}: has {count} elements and no data for them, too many to be true")
            out = np.zeros((count, width), dtype=kind)
        if "sparse" in accessor:
            out = self._sparse(section(accessor, "sparse", dict, name), out, name)
        self._check_range(accessor, out, name)
        return out

    def _kind(self, owner: Object, where: str) -> np.dtype[Any]:
        kind = owner.get("componentType")
        if not isinstance(kind, int) or kind not in KINDS:
            raise UnreadableError(f"{where}: its componentType {told(kind)} is not known")
        return np.dtype(KINDS[kind])

    def _strided(self, view: Any, at: int, kind: np.dtype[Any], count: int, width: int, where: str) -> Numbers:
        data, stride = self.view(view, where), item(self.root, "bufferViews", view, where)[0].get("byteStride")
        size = kind.itemsize * width
        if stride is None:
            stride = size
        if not isinstance(stride, int) or not (stride == size or 4 <= stride <= 252) or stride < size:
            raise UnreadableError(f"{where}: its buffer view has the byteStride {told(stride)} for {size} bytes")
        if count and at + stride * (count - 1) + size > len(data):
            raise UnreadableError(
                f"{where}: {count} of {size} bytes from byte {at} on "
                f"reach beyond the {len(data)} bytes of bufferViews {view}"
            )
        return np.ndarray((count, width), kind, data, at if count else 0, (stride, kind.itemsize)).copy()

    def _sparse(self, sparse: Object, base: Numbers, where: str) -> Numbers:
        count = count_of(sparse, "count", where)
        places, values = section(sparse, "indices", dict, where), section(sparse, "values", dict, where)
        offsets = [count_of(part, "byteOffset", where, 0) for part in (places, values)]
        kind = self._kind(places, where)
        if kind.kind != "u":
            raise UnreadableError(f"{where}: its sparse indices are no unsigned integers")
        at = self._strided(places.get("bufferView"), offsets[0], kind, count, 1, where)[:, 0].astype(np.int64)
        if count and (at.max() >= len(base) or (np.diff(at) <= 0).any()):
            raise UnreadableError(f"{where}: its sparse indices do not rise, or reach beyond its {len(base)} elements")
        base[at] = self._strided(values.get("bufferView"), offsets[1], base.dtype, count, base.shape[1], where)
        return base

    def _check_range(self, accessor: Object, found: Numbers, where: str) -> None:
        """Add a note where values are not in the range that the file declares: they or their offsets are wrong."""
        if not found.size or (found.dtype.kind == "f" and not np.isfinite(found).all()):
            return
        size = float(np.ptp(found.astype(np.float64), axis=0).max())
        for key, true in (("min", found.min(axis=0)), ("max", found.max(axis=0))):
            declared = vector_of(accessor, key, None, where)
            if declared is not None and len(declared) == len(true):
                away = np.abs(declared - true.astype(np.float64)).max()
                if not away <= 1e-4 * size + 1e-6 * np.abs(declared).max():
                    self.notes.append(
                        f"{where}: {key} is declared as {_listed(declared)}, its data has {_listed(true)}: "
                        "the file was changed by something that did not understand it"
                    )

    # Bytes.

    def view(self, index: Any, where: str) -> bytes:
        """The bytes of a buffer view, decompressed."""
        view, name = item(self.root, "bufferViews", index, where)
        if index not in self._views:
            extensions = section(view, "extensions", dict, name)
            packed = next((extensions[key] for key in MESHOPT if key in extensions), None)
            if packed is None:
                self._views[index] = self._slice(view, name)
            elif isinstance(packed, dict):
                self._views[index] = _unpacked(packed, self._slice(packed, name), name)
            else:
                raise UnreadableError(f"{name}: its compression is no object")
        return self._views[index]

    def _slice(self, owner: Object, where: str) -> bytes:
        data = self._buffer(owner.get("buffer"), where)
        at, size = count_of(owner, "byteOffset", where, 0), count_of(owner, "byteLength", where)
        if at + size > len(data):
            raise UnreadableError(f"{where}: bytes {at} to {at + size} of a buffer of {len(data)}")
        return data[at : at + size]

    def _buffer(self, index: Any, where: str) -> bytes:
        buffer, name = item(self.root, "buffers", index, where)
        if index in self._buffers:
            return self._buffers[index]
        size, uri = count_of(buffer, "byteLength", name), buffer.get("uri")
        if uri is None:
            if index or self._binary is None:
                raise UnreadableError(f"{name}: has no uri, and the file no binary chunk for it")
            data = self._binary
        elif not isinstance(uri, str):
            raise UnreadableError(f"{name}: its uri is no text")
        elif uri.startswith("data:"):
            head, _, body = uri.partition(",")
            try:
                data = _base64(body) if head.endswith(";base64") else _unquoted(body)
            except (binascii.Error, ValueError) as exc:
                raise UnreadableError(f"{name}: its data uri is damaged") from exc
        else:
            try:
                data = self._fetch(_unquoted(uri).decode("utf-8", "replace"))
            except UnreadableError:
                if "%" not in uri:
                    raise
                data = self._fetch(uri)  # some programs write names without %XX
        if len(data) < size:
            raise UnreadableError(f"{name}: declares {size} bytes, but {len(data)} are there: it is cut short")
        self._buffers[index] = data[:size]
        return self._buffers[index]


def _base64(text: str) -> bytes:
    """Decode base64 text that may have line breaks and lack its padding."""
    packed = "".join(text.split())
    return base64.b64decode(packed + "=" * (-len(packed) % 4), validate=True)


def _unquoted(text: str) -> bytes:
    """Decode text in which some bytes are written %XX (RFC 3986)."""
    return re.sub(
        rb"%([0-9A-Fa-f]{2})", lambda found: bytes([int(found[1], 16)]), text.encode("utf-8", "surrogatepass")
    )


def _listed(values: Numbers | F64) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in values.tolist()) + ")"


def _unpacked(packed: Object, data: bytes, where: str) -> bytes:
    """Decompress a buffer view compressed by meshoptimizer (EXT_meshopt_compression)."""
    library = require("meshoptimizer", "gltf")
    count, stride = count_of(packed, "count", where), count_of(packed, "byteStride", where)
    mode, filter_ = packed.get("mode"), packed.get("filter", "NONE")
    if count * stride > 1000 * len(data) + 2**16:
        raise UnreadableError(f"{where}: {len(data)} compressed bytes cannot hold {count} of {stride}")
    try:
        if mode == "ATTRIBUTES" and stride % 4 == 0 and 4 <= stride <= 256:
            out = library.decode_vertex_buffer(count, stride, data)
        elif mode in ("TRIANGLES", "INDICES") and stride in (2, 4):
            decode = library.decode_index_buffer if mode == "TRIANGLES" else library.decode_index_sequence
            out = decode(count, 4, data).astype(f"<u{stride}")  # asked for 2 bytes, it would pack two numbers into one
        else:
            raise UnreadableError(f"{where}: its compression mode {told(mode)} of {stride} bytes is not known")
    except (ValueError, RuntimeError, TypeError) as exc:
        raise UnreadableError(f"{where}: its compressed bytes are damaged: {str(exc)[:80]}") from exc
    raw = np.ascontiguousarray(out).tobytes()
    if len(raw) != count * stride:
        raise UnreadableError(f"{where}: decompressed it has {len(raw)} bytes, not {count} of {stride}")
    if filter_ == "EXPONENTIAL":  # 24 bits of mantissa, 8 of exponent
        packed_floats = np.frombuffer(raw, "<i4")
        with np.errstate(over="ignore"):
            return np.ldexp((packed_floats << 8 >> 8).astype(np.float64), packed_floats >> 24).astype("<f4").tobytes()
    if filter_ == "QUATERNION" and stride == 8:
        return cast("bytes", library.decode_filter_quat(np.frombuffer(raw, np.uint8), count, stride).tobytes())
    if filter_ != "NONE":  # a filter of normals and colours: positions and indices have none
        raise UnreadableError(f"{where}: its compression filter {told(filter_)} is not read")
    return raw
