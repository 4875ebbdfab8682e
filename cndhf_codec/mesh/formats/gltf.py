"""Read glTF 2.0, .glb and .gltf: the scene as a viewer shows it at rest, with instances, skins and morph targets.

The specification's sections are named as in glTF 2.0.1 (Khronos).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import F64, I64
from ...errors import require
from .accessors import Accessors, Fetch, Object, count_of, item, objects, parse, section, vector_of
from .common import Triangles, UnreadableError, check_count, check_indices, joined, told
from .ply import strip_triangles

DRACO, INSTANCES, VISIBILITY = "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing", "KHR_node_visibility"
READ = {DRACO, INSTANCES, VISIBILITY, "KHR_mesh_quantization", "EXT_meshopt_compression", "KHR_meshopt_compression"}
# Prefixes of extensions that say how a surface looks, sounds, moves or is called, not where it is.
SHAPELESS = (
    *(
        "KHR_materials_",
        "KHR_texture_",
        "KHR_lights_",
        "KHR_xmp",
        "KHR_animation_pointer",
        "KHR_audio",
        "KHR_techniques_",
    ),
    *("EXT_texture_", "EXT_lights_", "EXT_structural_metadata", "EXT_mesh_features", "EXT_instance_features"),
    *(
        "MSFT_texture_",
        "MSFT_packing_",
        "VRM",
        "EXT_materials_",
        "ADOBE_materials_",
        "CESIUM_primitive_outline",
        "FB_ngon_encoding",
        "GOOGLE_texture_",
    ),
)
STRIP, FAN, LIST = 5, 6, 4  # primitive modes; those below are points and lines


@dataclass(frozen=True)
class Primitive:
    """Triangles of a mesh with one material. positions: (N, 3) at rest. faces: (M, 3). joints, weights: (N, K), or
    None."""

    positions: F64
    faces: I64
    joints: I64 | None
    weights: F64 | None


def read_glb(data: bytes, fetch: Fetch) -> Triangles:
    """Read a GLB file. fetch: reads a buffer beside the file."""
    if len(data) < 20 or not data.startswith(b"glTF"):
        raise UnreadableError("is no GLB file: it does not begin with 'glTF' and a header")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise UnreadableError(f"is GLB of version {version}; only 2 is read: export it anew")
    if length > len(data):
        raise UnreadableError(f"is cut short: the header declares {length} bytes, the file has {len(data)}")
    at, chunks = 12, dict[bytes, bytes]()
    while at + 8 <= length:
        size = int.from_bytes(data[at : at + 4], "little")
        if at + 8 + size > length:
            raise UnreadableError(f"a chunk of {size} bytes at byte {at} reaches beyond the file's {length}")
        chunks.setdefault(data[at + 4 : at + 8], data[at + 8 : at + 8 + size])
        at += 8 + size
    if b"JSON" not in chunks:
        raise UnreadableError("has no JSON chunk")
    out = _read(parse(chunks[b"JSON"]), chunks.get(b"BIN\0"), fetch)
    if len(data) > length:
        out.notes.append(f"{len(data) - length} bytes behind the end that the header declares were not read")
    return out


def read_gltf(data: bytes, fetch: Fetch) -> Triangles:
    return _read(parse(data), None, fetch)


def _read(root: Object, binary: bytes | None, fetch: Fetch) -> Triangles:
    for name in section(root, "extensionsRequired", list, "the file"):
        if not isinstance(name, str) or (name not in READ and not name.startswith(SHAPELESS)):
            raise UnreadableError(
                f"requires the glTF extension {told(name)}, which is not read; export the file without it"
            )
    accessors = Accessors(root, binary, fetch)
    return _Scene(root, accessors).triangles()


class _Scene:
    def __init__(self, root: Object, accessors: Accessors) -> None:
        self.root, self.accessors, self.notes = root, accessors, accessors.notes
        self.nodes = objects(root, "nodes", "the file")
        self.parents = self._tree()
        self._worlds: dict[int, F64] = {}
        self._meshes: dict[int, list[Primitive]] = {}
        self._other = 0  # primitives that are points or lines

    def triangles(self) -> Triangles:
        out: list[Triangles] = []
        total = vertices = 0
        for node in self._shown():
            if "mesh" not in self.nodes[node]:
                continue
            where = f"nodes {node}"
            targets = self._weights(node, where)
            for primitive in self._mesh(self.nodes[node]["mesh"], where, targets):
                for part in self._placed(primitive, node, where):
                    total, vertices = total + len(part.faces), vertices + len(part.vertices)
                    check_count(total, vertices, len(out))
                    out.append(part)
        if self._other:
            self.notes.append(f"{self._other} primitives of points or lines, which bound no surface, were left out")
        if not total:
            what = "nothing but points and lines" if self._other else "no mesh in its scene"
            raise UnreadableError(f"holds no triangles: {what}")
        both = joined(out)
        return Triangles(both.vertices, both.faces, list(dict.fromkeys(self.notes)), self._lost())

    def _lost(self) -> list[str]:
        """What the file holds beside the shape, by name."""
        primitives = [p for mesh in objects(self.root, "meshes", "the file") for p in mesh.get("primitives", [])]
        attributes = {name for p in primitives for name in p.get("attributes", {})}
        found = {
            "colours": any(name.startswith("COLOR_") for name in attributes),
            "texture coordinates": any(name.startswith("TEXCOORD_") for name in attributes),
            "textures": bool(self.root.get("textures")),
            "materials": bool(self.root.get("materials")),
            "skins": bool(self.root.get("skins")),
            "animations": bool(self.root.get("animations")),
        }
        return [name for name, there in found.items() if there]

    # Nodes (3.5).

    def _tree(self) -> dict[int, int]:
        """Find the parent of every node that has one. Raises UnreadableError where nodes are no trees."""
        parents: dict[int, int] = {}
        for k, node in enumerate(self.nodes):
            for child in section(node, "children", list, f"nodes {k}"):
                item(self.root, "nodes", child, f"nodes {k}")
                if child in parents:
                    raise UnreadableError(f"nodes {child}: is the child of two nodes, or twice of one")
                parents[child] = k
        settled: set[int] = set()
        for k in range(len(self.nodes)):
            path: set[int] = set()
            while k in parents and k not in settled:
                path.add(k)
                settled.add(k)
                k = parents[k]
                if k in path:  # the walk may have begun outside the circle
                    raise UnreadableError(f"nodes {k}: is its own ancestor")
        return parents

    def _shown(self) -> list[int]:
        """List the visible nodes of the scene, depth first."""
        scenes = objects(self.root, "scenes", "the file")
        if scenes:
            index = self.root.get("scene", 0)
            scene, name = item(self.root, "scenes", index, "the file")
            if len(scenes) > 1:
                self.notes.append(f"scene {index} of {len(scenes)} was read")
            roots = section(scene, "nodes", list, name)
        else:
            roots = [k for k in range(len(self.nodes)) if k not in self.parents]
        out, hidden, waiting = [], 0, list(reversed(roots))
        seen: set[int] = set()
        while waiting:
            k = waiting.pop()
            node, name = item(self.root, "nodes", k, "the scene")
            if k in seen:
                raise UnreadableError(f"{name}: is twice in the scene")
            seen.add(k)
            visibility = section(section(node, "extensions", dict, name), VISIBILITY, dict, name)
            if visibility.get("visible") is False:
                hidden += 1
                continue
            out.append(k)
            waiting += reversed(section(node, "children", list, name))
        if hidden:
            self.notes.append(f"{hidden} hidden nodes, and what is below them, were left out")
        absent = sum("mesh" in node for k, node in enumerate(self.nodes) if k not in seen)
        if absent and not hidden:
            self.notes.append(f"{absent} nodes with meshes are not part of the scene and were left out")
        return out

    def _local(self, k: int) -> F64 | None:
        """A node's own transform (4, 4), or None for the identity."""
        node, where = self.nodes[k], f"nodes {k}"
        matrix = vector_of(node, "matrix", 16, where)
        if matrix is not None:
            return None if np.array_equal(matrix, np.eye(4).ravel()) else matrix.reshape(4, 4).T
        parts = [vector_of(node, key, n, where) for key, n in (("translation", 3), ("rotation", 4), ("scale", 3))]
        if all(part is None for part in parts):
            return None
        t, r, s = (np.array(d, dtype=float) if p is None else p for p, d in zip(parts, REST, strict=True))
        return _transforms(t[None], r[None], s[None])[0]

    def _world(self, k: int) -> F64 | None:
        """A node's transform (4, 4) into the scene's frame, or None for the identity."""
        path = [k]
        while path[-1] in self.parents and path[-1] not in self._worlds:
            path.append(self.parents[path[-1]])
        world: F64 | None = None
        for node in reversed(path):
            if node in self._worlds:
                world = self._worlds[node]
                continue
            local = self._local(node)
            world = local if world is None else world if local is None else world @ local
            if world is not None:
                self._worlds[node] = world
        return world

    # Meshes (3.7).

    def _weights(self, node: int, where: str) -> F64 | None:
        """Weights of morph targets: the node's, else the mesh's, else none."""
        mesh, name = item(self.root, "meshes", self.nodes[node]["mesh"], where)
        own = vector_of(self.nodes[node], "weights", None, where)
        return vector_of(mesh, "weights", None, name) if own is None else own

    def _mesh(self, index: Any, where: str, weights: F64 | None) -> list[Primitive]:
        mesh, name = item(self.root, "meshes", index, where)
        morphed = weights is not None and weights.any()
        if morphed or index not in self._meshes:
            made = []
            for k, primitive in enumerate(objects(mesh, "primitives", name)):
                mode = count_of(primitive, "mode", f"{name}, primitive {k}", LIST)
                if mode < LIST:
                    self._other += 1
                    continue
                if "POSITION" not in section(primitive, "attributes", dict, name):
                    self.notes.append(f"{name}, primitive {k}: has no POSITION and was left out")
                    continue
                made.append(self._primitive(primitive, mode, f"{name}, primitive {k}", weights))
            if morphed:
                return made
            self._meshes[index] = made
        return self._meshes[index]

    def _primitive(self, primitive: Object, mode: int, where: str, weights: F64 | None) -> Primitive:
        attributes = section(primitive, "attributes", dict, where)
        packed = section(primitive, "extensions", dict, where).get(DRACO)
        joints = weights_of = None
        if isinstance(packed, dict) and not self._has_fallback(primitive, attributes, where):
            positions, corners, joints, weights_of = self._draco(primitive, packed, where)
            mode = LIST  # whatever it was, it is decoded to triangles
            if joints is None:  # they may stand beside the compressed attributes
                joints, weights_of = self._influences(attributes, where)
        else:
            positions = self.accessors.floats(attributes["POSITION"], 3, where)
            if "indices" in primitive:
                corners = self.accessors.integers(primitive["indices"], 1, where)[:, 0]
            else:
                corners = np.arange(len(positions))
            joints, weights_of = self._influences(attributes, where)
        check_indices(corners, len(positions), lambda k: f"{where}: index {k}")
        for target, weight in zip(
            objects(primitive, "targets", where), [] if weights is None else weights, strict=False
        ):
            if weight and "POSITION" in target:
                moved = self.accessors.floats(target["POSITION"], 3, where)
                if len(moved) != len(positions):
                    raise UnreadableError(f"{where}: a morph target has {len(moved)} positions, not {len(positions)}")
                positions = positions + weight * moved
        return Primitive(positions, self._faces(corners, mode, where), joints, weights_of)

    def _faces(self, corners: I64, mode: int, where: str) -> I64:
        if mode == LIST:
            if len(corners) % 3:
                self.notes.append(f"{where}: has {len(corners)} indices, which are no whole triangles")
            return corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if mode == STRIP:
            return strip_triangles(corners)
        if mode != FAN:
            raise UnreadableError(f"{where}: its mode {mode} is not known")
        if len(corners) < 3:
            return np.empty((0, 3), dtype=np.int64)
        return np.stack([np.broadcast_to(corners[:1], len(corners) - 2), corners[1:-1], corners[2:]], axis=1)

    def _influences(self, attributes: Object, where: str) -> tuple[I64 | None, F64 | None]:
        """Joints and weights of all sets side by side, (N, 4 sets)."""
        joints: list[I64] = []
        weights: list[F64] = []
        while f"JOINTS_{len(joints)}" in attributes and f"WEIGHTS_{len(joints)}" in attributes:
            k = len(joints)
            joints.append(self.accessors.integers(attributes[f"JOINTS_{k}"], 4, where))
            weights.append(self.accessors.floats(attributes[f"WEIGHTS_{k}"], 4, where))
        if not joints:
            return None, None
        try:
            return np.hstack(joints), np.hstack(weights)
        except ValueError as exc:
            raise UnreadableError(f"{where}: its joints and weights differ in number") from exc

    def _has_fallback(self, primitive: Object, attributes: Object, where: str) -> bool:
        """Whether positions and indices are there uncompressed, too."""
        used = [attributes["POSITION"], *([primitive["indices"]] if "indices" in primitive else [])]
        return all(self.accessors.has_data(index, where) for index in used)

    def _draco(self, primitive: Object, packed: Object, where: str) -> tuple[F64, I64, I64 | None, F64 | None]:
        library = require("DracoPy", "gltf")
        data = self.accessors.view(packed.get("bufferView"), where)
        try:
            mesh = library.decode(data)
            arrays = {a["unique_id"]: np.asarray(a["data"]) for a in mesh.attributes}
            faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
        except Exception as exc:  # whatever the library raises of damaged bytes
            raise UnreadableError(f"{where}: its Draco data is damaged: {str(exc)[:80]}") from exc
        ids = section(packed, "attributes", dict, where)

        def array(name: str) -> np.ndarray:
            key = ids.get(name)
            found = arrays.get(key) if isinstance(key, int) else None
            if found is None:
                raise UnreadableError(f"{where}: its Draco data has no attribute {name}")
            return found

        positions = array("POSITION").astype(np.float64)
        declared = self.accessors.shape(section(primitive, "attributes", dict, where)["POSITION"], where)
        if positions.shape != declared:
            raise UnreadableError(f"{where}: declares {declared[0]} positions, its Draco data has {len(positions)}")
        if "indices" in primitive:
            indices = self.accessors.shape(primitive["indices"], where)[0]
            if indices != 3 * len(faces):
                raise UnreadableError(f"{where}: declares {indices} indices, its Draco data has {3 * len(faces)}")
        if "JOINTS_0" not in ids or "WEIGHTS_0" not in ids:
            return positions, faces.ravel(), None, None
        return positions, faces.ravel(), array("JOINTS_0").astype(np.int64), array("WEIGHTS_0").astype(np.float64)

    # Places (3.7.3, 3.5.3).

    def _placed(self, primitive: Primitive, k: int, where: str) -> Iterator[Triangles]:
        """Place the primitive as the node says: by its skin, by its instances, or by its transform."""
        node = self.nodes[k]
        if "skin" in node and primitive.joints is not None and primitive.weights is not None:
            posed = Primitive(self._posed(primitive, node["skin"], where), primitive.faces, None, None)
            yield _turned(posed, self._world(k))
            return
        world = self._world(k)
        instances = section(node, "extensions", dict, where).get(INSTANCES)
        if instances is None:
            yield _moved(primitive, world)
            return
        if not isinstance(instances, dict):
            raise UnreadableError(f"{where}: its instances are no object")
        transforms = self._instances(section(instances, "attributes", dict, where), where)
        check_count(len(transforms) * len(primitive.faces), len(transforms) * len(primitive.positions), len(transforms))
        for transform in transforms:
            yield _moved(primitive, transform if world is None else world @ transform)

    def _instances(self, attributes: Object, where: str) -> F64:
        """Transforms (K, 4, 4) of EXT_mesh_gpu_instancing."""
        names = [("TRANSLATION", 3), ("ROTATION", 4), ("SCALE", 3)]
        found = [self.accessors.floats(attributes[n], width, where) if n in attributes else None for n, width in names]
        counts = {len(array) for array in found if array is not None}
        if len(counts) != 1:
            raise UnreadableError(f"{where}: its instances' translations, rotations and scales differ in number")
        k = counts.pop()
        t, r, s = (
            np.broadcast_to(np.array(rest, dtype=float), (k, len(rest))) if array is None else array
            for array, rest in zip(found, REST, strict=True)
        )
        return _transforms(t, r, s)

    def _posed(self, primitive: Primitive, index: Any, where: str) -> F64:
        """Pose by linear blend skinning: a vertex goes to the weighted mean of where its joints take it. The node's own
        transform is ignored."""
        skin, name = item(self.root, "skins", index, where)
        joints = section(skin, "joints", list, name)
        used, weights = primitive.joints, primitive.weights
        assert used is not None
        assert weights is not None
        if len(used) != len(primitive.positions) or weights.shape != used.shape:
            raise UnreadableError(f"{where}: its joints, weights and positions differ in number")
        used = np.where(weights != 0, used, 0)
        check_indices(used.ravel(), len(joints), lambda k: f"{where}: joint of vertex {k // used.shape[1]}")
        matrices = np.empty((len(joints), 4, 4))
        for k, joint in enumerate(joints):
            item(self.root, "nodes", joint, name)
            world = self._world(joint)
            matrices[k] = np.eye(4) if world is None else world
        if "inverseBindMatrices" in skin:
            inverse = self.accessors.floats(skin["inverseBindMatrices"], 16, name)
            if len(inverse) < len(joints):
                raise UnreadableError(f"{name}: has {len(joints)} joints and {len(inverse)} inverse bind matrices")
            matrices = matrices @ inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
        total = weights.sum(axis=1, keepdims=True)
        out = np.zeros_like(primitive.positions)
        for column in range(used.shape[1]):
            m = matrices[used[:, column]]
            there = np.einsum("nij,nj->ni", m[:, :3, :3], primitive.positions) + m[:, :3, 3]
            out += (weights[:, column : column + 1] / np.where(total > 0, total, 1)) * there
        return np.where(total > 0, out, primitive.positions)


REST = ([0, 0, 0], [0, 0, 0, 1], [1, 1, 1])  # translation, rotation (x, y, z, w), scale


def _transforms(t: F64, r: F64, s: F64) -> F64:
    """Transforms (K, 4, 4) from translations (K, 3), quaternions (K, 4) and scales (K, 3)."""
    length = np.linalg.norm(r, axis=1, keepdims=True)
    x, y, z, w = (r / np.where(length > 0, length, 1)).T
    out = np.zeros((len(t), 4, 4))
    out[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1)
    out[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1)
    out[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1)
    out[:, :3, :3] *= s[:, None, :]
    out[:, :3, 3] = t
    out[:, 3, 3] = 1
    return out


def _moved(primitive: Primitive, transform: F64 | None) -> Triangles:
    if transform is None:
        return Triangles(primitive.positions, primitive.faces)
    # Too large numbers are reported later, with the mesh's size. A determinant of NaN can divide by zero.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        vertices = primitive.positions @ transform[:3, :3].T + transform[:3, 3]
    return _turned(Primitive(vertices, primitive.faces, None, None), transform)


def _turned(primitive: Primitive, transform: F64 | None) -> Triangles:
    """Keep the positions; reverse the triangles where the node's transform mirrors (3.7.4)."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        mirrored = transform is not None and np.linalg.det(transform[:3, :3]) < 0
    return Triangles(primitive.positions, primitive.faces[:, ::-1] if mirrored else primitive.faces)
