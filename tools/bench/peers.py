"""What users do today: simplify a mesh to F faces, then code it. Every function gives (bytes, decoded mesh) pairs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import DracoPy
import fast_simplification
import meshoptimizer
import numpy as np
import pymeshlab
import zstandard

FACES = [int(80 * 1.5**k) for k in range(2, 14)]  # 180 to 15,500; a mesh with no more than the last is also coded whole
QUANTISATION_BITS = (9, 10, 11, 12, 13, 14)
AGGRESSIVENESS = (1, 2, 3, 5, 7)  # of fast-simplification: 7 is its default; the least stop before the count
LARGEST = 24_576  # bytes; larger files say nothing about 16 KiB

Mesh = tuple[np.ndarray, np.ndarray]
Point = tuple[str, int, Mesh, float, float]  # peer and its options, bytes, decoded mesh, encode and decode seconds


def draco(vertices: np.ndarray, faces: np.ndarray) -> Iterator[Point]:
    """Quadric decimation by two libraries, then Draco at level 10."""
    for count in _counts(faces):
        for name, decimate in WHOLE if count == len(faces) else DECIMATIONS:
            start = time.perf_counter()
            v, f = decimate(vertices, faces, count)
            simplified = time.perf_counter() - start
            # What stops far above the count asked for is like what another count gives.
            if not 4 <= len(f) <= 1.5 * count:
                continue
            for bits in QUANTISATION_BITS:
                start = time.perf_counter()
                data = DracoPy.encode(v, f.astype(np.uint32), quantization_bits=bits, compression_level=10)
                if len(data) > LARGEST:
                    break
                coded = time.perf_counter()
                mesh = DracoPy.decode(data)
                took = time.perf_counter() - coded
                out = np.asarray(mesh.points, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
                yield f"draco {name} {count} {bits}", len(data), out, simplified + coded - start, took


def meshopt(vertices: np.ndarray, faces: np.ndarray) -> Iterator[Point]:
    """meshoptimizer's simplifier and codecs, positions of 16 bits at `bits` of precision, then zstd."""
    v32 = np.ascontiguousarray(vertices, dtype=np.float32)
    indices = np.ascontiguousarray(faces.ravel(), dtype=np.uint32)
    lo, extent = v32.min(axis=0), float(np.ptp(v32, axis=0).max())
    for count in _counts(faces):
        start = time.perf_counter()
        kept = np.empty_like(indices)
        n = meshoptimizer.simplify(kept, indices, v32, target_index_count=3 * count, target_error=1.0)
        ordered = np.empty(n, dtype=np.uint32)
        meshoptimizer.optimize_vertex_cache(ordered, kept[:n].copy(), vertex_count=len(v32))
        used, inverse = np.unique(ordered, return_inverse=True)
        # First use decides a vertex's number: what the codecs expect.
        first = np.full(len(used), n, dtype=np.int64)
        np.minimum.at(first, inverse, np.arange(n))
        order = np.argsort(first, kind="stable")
        number = np.empty(len(used), dtype=np.uint32)
        number[order] = np.arange(len(used), dtype=np.uint32)
        triangles, positions = number[inverse].astype(np.uint32), v32[used[order]]
        simplified = time.perf_counter() - start
        for bits in QUANTISATION_BITS:
            start = time.perf_counter()
            grid = np.zeros((len(positions), 4), dtype=np.uint16)
            grid[:, :3] = np.rint((positions - lo) / extent * (2**bits - 1))
            raw = meshoptimizer.encode_vertex_buffer(grid, len(grid), 8)
            raw += meshoptimizer.encode_index_buffer(triangles, len(triangles), len(grid))
            data = zstandard.ZstdCompressor(19).compress(raw)
            decoded = grid[:, :3].astype(np.float64) / (2**bits - 1) * extent + lo
            took = time.perf_counter() - start
            if len(data) > LARGEST:
                break
            yield (
                f"meshopt {count} {bits}",
                len(data) + 24,
                (decoded, triangles.reshape(-1, 3).astype(np.int64)),
                (simplified + took),
                0.0,
            )


def _counts(faces: np.ndarray) -> list[int]:
    """How many faces to simplify to; the last is all of them where they are few."""
    counts = [count for count in FACES if count < len(faces)]
    return [*counts, len(faces)] if len(faces) <= FACES[-1] else counts


def _fast_simplification(aggressiveness: int) -> Callable[[np.ndarray, np.ndarray, int], Mesh]:
    def decimate(vertices: np.ndarray, faces: np.ndarray, count: int) -> Mesh:
        v, f = fast_simplification.simplify(
            vertices.astype(np.float32), faces.astype(np.int32), target_count=count, agg=aggressiveness
        )
        return np.asarray(v, dtype=np.float32), np.asarray(f)

    return decimate


def _pymeshlab(vertices: np.ndarray, faces: np.ndarray, count: int) -> Mesh:
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=count, optimalplacement=True, preservenormal=True, preservetopology=False
    )
    mesh = meshes.current_mesh()
    return mesh.vertex_matrix().astype(np.float32), mesh.face_matrix()


def _whole(vertices: np.ndarray, faces: np.ndarray, count: int) -> Mesh:
    return vertices.astype(np.float32), faces


WHOLE = (("whole", _whole),)
DECIMATIONS = (
    *((f"fast-simplification-{k}", _fast_simplification(k)) for k in AGGRESSIVENESS),
    ("pymeshlab", _pymeshlab),
)
