"""The decoded model: queries and surfaces in input coordinates."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any, BinaryIO, Literal, overload

import numpy as np
import numpy.typing as npt

from .. import format as fmt
from ..errors import FormatError, InputError, LimitError, OptionError, require
from ..files import read_bytes, write_atomically
from ..format.constants import MAX_FILE_SIZE
from . import surface
from .cells import CellGrid
from .dhf import Dhf
from .network import F32
from .parallel import over_rows
from .rays import RayHits, first_crossings

CHUNK = 2**16  # points evaluated at once
# Normalised units; a DHF's box ends at 2. However far a point is, it is outside: float32 must not overflow on the way
# to saying so.
FAR = np.float32(2**20)
CELLS_FROM = 2**18  # points asked for, over all calls, from which on cells are worth the time to make them


class Model:
    """A solid as the intersection of double height fields.

    Points go in, and surfaces and distances come out, in the coordinates and units of the mesh that was encoded.
    Points may be float32 or float64; far from the origin only float64 can say them. All queries work in pieces:
    besides what goes in and comes out they hold 60 MB at most, whatever the number of points, 8 MB more for each
    processor after the second, and for a moment a megabyte for each double height field. A model may be used from
    several threads at once.
    """

    def __init__(self, container: fmt.Container, sections: dict[str, int] | None = None) -> None:
        """sections: of the file that the container was read from, where it was; as `fmt.section_sizes` gives them."""
        self.container = container
        self._sections = sections
        self._dhfs = [Dhf(record) for record in container.dhfs]
        self._centre = np.array(container.centre, dtype=np.float64)
        self._cells: CellGrid | None = None
        self._asked = 0
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        return Model, (self.container, self._sections)  # a lock cannot be copied, and cells can be made again

    @property
    def info(self) -> dict[str, Any]:
        """What the file holds: version-independent names, plain Python values, errors in input units."""
        c = self.container
        parameters = sum(d.parameters for d in c.dhfs)
        # A copy can have another size: sections that this version does not know, another zstd release.
        sections = fmt.section_sizes(self.dumps()) if self._sections is None else self._sections
        size = sum(sections.values())
        return {
            "bytes": size,
            "sections": dict(sections),
            "dhfs": [
                {
                    "axis": [round(float(x), 6) for x in d.rotation[2]],
                    "width": d.width,
                    "hidden_layers": d.hidden_layers,
                    "parameters": d.parameters,
                    "bounds": [[float(x) for x in row] for row in d.bounds],
                }
                for d in c.dhfs
            ],
            "parameters": parameters,
            "bits_per_parameter": 8 * size / parameters,
            "centre": list(c.centre),
            "scale": c.scale,
            "encoder": c.metadata.encoder,
            "mean_error": c.metadata.mean_error,
            "p99_error": c.metadata.p99_error,
            "max_error": c.metadata.max_error,
            "source": c.metadata.source,
        }

    def heights(self, i: int, uv: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Near and far height of DHF `i`.

        uv: (..., 2), in the rotated normalised frame of that DHF; values outside its domain are clamped to it.
        Returns (..., 2) float32, near then far, in the same frame. Empty where far < near.
        Raises OptionError when there is no DHF `i` or the last dimension is not 2.
        """
        if not 0 <= i < len(self._dhfs):
            raise OptionError(f"there is no DHF {i}; this model has {len(self._dhfs)}")
        array = _last_dimension(uv, 2)
        flat = array.reshape(-1, 2)
        out = np.empty(flat.shape, dtype=np.float32)
        for at in range(0, len(flat), CHUNK):
            part = slice(at, at + CHUNK)
            out[part] = self._dhfs[i].heights(flat[part].astype(np.float32))
        return out.reshape(array.shape)

    @overload
    def implicit(self, points: npt.ArrayLike, gradient: Literal[False] = False) -> F32: ...

    @overload
    def implicit(self, points: npt.ArrayLike, gradient: Literal[True]) -> tuple[F32, F32]: ...

    def implicit(self, points: npt.ArrayLike, gradient: bool = False) -> F32 | tuple[F32, F32]:
        """The implicit function f at points (..., 3) in input coordinates -> (...,) float32 in input units.

        Positive inside, zero on the surface, negative outside. f / |grad f| approximates the distance.
        gradient: return (f, grad f) with grad f (..., 3) float32, by input coordinates: analytic, and that of one
        side where f has a crease. -grad f / |grad f| is the surface's outward normal.
        Raises OptionError when the last dimension is not 3.
        """
        array = _last_dimension(points, 3)
        flat = array.reshape(-1, 3)
        out = np.empty(len(flat), dtype=np.float32)
        slope = np.empty((len(flat) if gradient else 0, 3), dtype=np.float32)
        for at in range(0, len(flat), CHUNK):
            part = slice(at, at + CHUNK)
            p = np.clip(self._normalised(flat[part]), -FAR, FAR)
            if gradient:
                f, slope[part] = surface.implicit_gradient(self._dhfs, p)
            else:
                f = surface.implicit(self._dhfs, p)
            out[part] = f * np.float32(self.container.scale)
        # By input coordinates, in input units: the scale of one cancels that of the other.
        shaped = out.reshape(array.shape[:-1])
        return (shaped, slope.reshape(array.shape)) if gradient else shaped

    def contains(self, points: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Whether points (..., 3) in input coordinates lie in the solid or on its surface -> (...,) bool.

        As `implicit(points) >= 0`, to the rounding of float32, but networks are evaluated near the surface only: many
        points cost a tenth of the time each. What is near is tabulated (2 MB) once many points were asked for.
        Raises OptionError when the last dimension is not 3.
        """
        array = _last_dimension(points, 3)
        flat = array.reshape(-1, 3)
        out = np.empty(len(flat), dtype=bool)
        self._asked += len(flat)  # two threads at once may lose a count, which does no harm
        if self._cells is None and self._asked < CELLS_FROM:
            return self.implicit(array) >= 0
        cells = self._cell_grid()

        def work(first: int, last: int) -> None:
            out[first:last] = cells.contains(self._normalised(flat[first:last]))

        over_rows(work, len(flat), CHUNK)
        return out.reshape(array.shape[:-1])

    def ray_intersect(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> RayHits:
        """Where rays first cross the surface: (distance, point, normal), in input coordinates and units.

        origins, directions: (..., 3), of shapes that broadcast to one; directions of any length but zero.
        distance: (...,), at least 0, in input units and not in lengths of the direction; inf where a ray misses, and
        where it is not finite or its direction is zero. point, normal: (..., 3), NaN there. All are float32 when
        both arguments are, else float64. Normals face outward and are of length one.
        A ray that starts inside hits where it leaves the solid; its normal then points along it. One that starts on
        the surface may hit there.
        With s the longest side of the solid's box: points are within 2e-6 s of the surface, and so are distances but
        where a ray grazes it. Where a ray goes in and out again within s / 1000, both crossings may be missed.
        Raises OptionError when a last dimension is not 3 or the shapes do not broadcast.
        """
        from_, along = (_last_dimension(a, 3) for a in (origins, directions))
        try:
            shape = np.broadcast_shapes(from_.shape, along.shape)
        except ValueError as exc:
            raise OptionError(f"origins {from_.shape} and directions {along.shape} do not broadcast") from exc
        start, way = (np.broadcast_to(a, shape).reshape(-1, 3) for a in (from_, along))
        dtype = np.result_type(start, way)
        distance = np.full(len(start), np.inf, dtype)
        point, normal = np.full((2, len(start), 3), np.nan, dtype)
        cells = self._cell_grid()
        for at in range(0, len(start), CHUNK):
            o, d = (a[at : at + CHUNK].astype(np.float64) for a in (start, way))
            with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
                d /= np.linalg.norm(d, axis=1, keepdims=True)
            p = (o - self._centre) / self.container.scale
            t = first_crossings(cells, p, d)
            hit = np.flatnonzero(np.isfinite(t))
            _, g = surface.implicit_gradient(self._dhfs, (p[hit] + t[hit, None] * d[hit]).astype(np.float32))
            g /= -np.maximum(np.linalg.norm(g, axis=1, keepdims=True), np.finfo(np.float32).tiny)
            t *= self.container.scale
            distance[at + hit], normal[at + hit] = t[hit], g
            point[at + hit] = o[hit] + t[hit, None] * d[hit]
        return RayHits(distance.reshape(shape[:-1]), point.reshape(shape), normal.reshape(shape))

    def _cell_grid(self) -> CellGrid:
        with self._lock:  # the first thread makes it, others wait
            if self._cells is None:
                self._cells = CellGrid(self._dhfs)
            return self._cells

    def _normalised(self, points: npt.NDArray[np.floating]) -> F32:
        """(N, 3) points of input coordinates -> normalised frame; subtracted in float64."""
        flat = points.reshape(-1)  # numpy is several times slower over rows of three
        with np.errstate(over="ignore"):
            p = flat - np.tile(self._centre, len(points))
            p /= self.container.scale
            return p.astype(np.float32).reshape(-1, 3)

    def to_mesh(self, resolution: int = 256) -> Any:
        """The surface as a `trimesh.Trimesh` in input coordinates: watertight, facing outward.

        resolution: marching-cubes cells along the longest side of the solid's box, 8 to 2048.
        Raises OptionError, SurfaceError, or MissingExtraError (the `mesh` extra).
        """
        trimesh = require("trimesh", "mesh")
        vertices, faces = surface.marching_cubes(self._dhfs, resolution)
        # process=False: merging vertices by position could weld parts of the surface that only touch.
        return trimesh.Trimesh(vertices * self.container.scale + self._centre, faces, process=False)

    def occupancy(self, resolution: int = 256) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.float64], float]:
        """In/out at the nodes of a regular grid around the solid.

        Returns (grid, origin, spacing): grid[i, j, k] tells whether origin + spacing * (i, j, k), in input
        coordinates, is inside. Raises OptionError or SurfaceError.
        """
        grid, origin, spacing = surface.occupancy(self._dhfs, resolution)
        scale = self.container.scale
        return grid, origin * scale + self._centre, spacing * scale

    def dumps(self) -> bytes:
        """The bytes of the `.cndhf` file."""
        return fmt.dumps(self.container)

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the `.cndhf` file, whole or not at all. Raises OutputError."""
        write_atomically(path, self.dumps(), overwrite)


def loads(data: bytes) -> Model:
    """Model from the bytes of a `.cndhf` file. Raises FormatError."""
    data = bytes(data)
    return Model(fmt.loads(data), fmt.section_sizes(data))


def load(path: str | os.PathLike[str]) -> Model:
    """Model from a `.cndhf` file. Raises FormatError or InputError, naming the file."""
    return _loads(read_bytes(path, MAX_FILE_SIZE + 1), str(Path(path)))


def load_stream(stream: BinaryIO, name: str) -> Model:
    """Model from an open binary stream, which is read to its end. Raises FormatError or InputError, with `name`."""
    try:
        data = stream.read(MAX_FILE_SIZE + 1)
    except OSError as exc:
        raise InputError(f"{name}: cannot be read: {exc.strerror}") from exc
    return _loads(data, name)


def _loads(data: bytes, name: str) -> Model:
    try:
        if len(data) > MAX_FILE_SIZE:
            raise LimitError(f"the file has more than {MAX_FILE_SIZE} bytes, the most that the format allows")
        return loads(data)
    except FormatError as exc:
        raise type(exc)(f"{name}: {exc}") from exc


def _last_dimension(values: npt.ArrayLike, n: int) -> npt.NDArray[np.float32] | npt.NDArray[np.float64]:
    array = np.asarray(values)
    if array.dtype != np.float32:
        array = array.astype(np.float64, copy=False)
    if array.ndim == 0 or array.shape[-1] != n:
        raise OptionError(f"an array of shape (..., {n}) is needed; got {array.shape}")
    return array
