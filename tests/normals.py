"""Read vertex normals as a mesh file has them: trimesh computes its own when it loads one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh


def stored_normals(path: Path):
    if path.suffix == ".obj":
        return np.array([x.split()[1:] for x in path.read_text("utf-8").splitlines() if x.startswith("vn ")], float)
    if path.suffix == ".ply":
        vertices = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
        return np.column_stack([vertices[k] for k in ("nx", "ny", "nz")])
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    head = json.loads(data[20 : 20 + length])
    accessor = head["accessors"][head["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]]
    view = head["bufferViews"][accessor["bufferView"]]
    start = 28 + length + view.get("byteOffset", 0)
    return np.frombuffer(data[start : start + view["byteLength"]], "<f4").reshape(-1, 3)
