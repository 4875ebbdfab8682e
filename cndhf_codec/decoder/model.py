"""The decoded model: queries and surfaces in input coordinates."""

from __future__ import annotations

import math
import os
import threading
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, overload

import numpy as np
import numpy.typing as npt

from .. import format as fmt
from ..arrays import F32
from ..errors import CndhfWarning, FormatError, InputError, LimitError, OptionError, SurfaceError, require
from ..files import read_bytes, write_atomically
from ..format.constants import MAX_FILE_SIZE
from .dhf.field import Dhf, implicit, implicit_gradient
from .limits import Limits
from .parallel import over_rows

if TYPE_CHECKING:
    from .dhf.cells import CellGrid
    from .dhf.isosurface import Tabled
    from .dhf.rays import RayHits
    from .dhf.thickness import Thickness

# What only surfaces, many points or rays need is imported where it is used: to load a file should cost little.

CHUNK = 2**16  # points evaluated at once
# Normalised units; a DHF's box ends at 2. However far a point is, it is outside: float32 must not overflow on the way
# to saying so.
FAR = np.float32(2**20)
CELLS_FROM = 2**18  # points asked for, over all calls, from which on cells are worth the time to make them
RESOLUTION = 256  # of a surface, unless another is asked for
ROUGH = 128  # resolution of the surface that an intersection is checked against
KEPT = 512  # resolution up to which the height tables of the last surface are kept: some megabytes
DEFAULT_ERROR = "0.02%"  # of an intersection: less than what the smallest files lose, by far


class Model:
    """A solid as the intersection of double height fields.

    Points go in, and surfaces and distances come out, in the coordinates and units of the mesh that was encoded.
    Points may be float32 or float64; far from the origin only float64 can say them. All queries work in pieces:
    besides what goes in and comes out they hold 60 MB at most, whatever the number of points, 8 MB more for each
    processor after the second, and for a moment a megabyte for each double height field. A model may be used from
    several threads at once.

    limits: how much the file may ask for when a surface or a grid is made; set it to others at will.
    """

    def __init__(
        self, container: fmt.Container, sections: dict[str, int] | None = None, limits: Limits | None = None
    ) -> None:
        """sections: of the file that the container was read from, where it was; as `fmt.section_sizes` gives them."""
        self.container = container
        self.limits = limits or Limits()
        self._sections = sections
        self._dhfs = [Dhf(record) for record in container.dhfs]
        self._centre = np.array(container.centre, dtype=np.float64)
        self._cells: CellGrid | None = None
        self._tables: tuple[int, Tabled] | None = None
        self._thickness: tuple[Thickness | None] | None = None  # None: not looked for yet
        self._asked = 0
        self._lock = threading.Lock()
        self.report: Any = None  # what `encode` did, a `cndhf_codec.Report`; None for a model that was read

    def __reduce__(self) -> tuple[Any, ...]:
        # A lock cannot be copied, and cells can be made again.
        return Model, (self.container, self._sections, self.limits)

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
                    "mirrored": [name for name, m in zip("uv", d.mirrors, strict=True) if m is not None],
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
        out = np.empty((array.size // 2, 2), dtype=np.float32)
        for first, last in _chunks(len(out)):
            out[first:last] = self._dhfs[i].heights(_rows(array, first, last).astype(np.float32))
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
        out = np.empty(array.size // 3, dtype=np.float32)
        slope = np.empty((len(out) if gradient else 0, 3), dtype=np.float32)
        for first, last in _chunks(len(out)):
            p = np.clip(self._normalised(_rows(array, first, last)), -FAR, FAR)
            if gradient:
                f, slope[first:last] = implicit_gradient(self._dhfs, p)
            else:
                f = implicit(self._dhfs, p)
            out[first:last] = f * np.float32(self.container.scale)
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
        out = np.empty(array.size // 3, dtype=bool)
        self._asked += len(out)  # two threads at once may lose a count, which does no harm
        if self._cells is None and self._asked < CELLS_FROM:
            return np.asarray(self.implicit(array) >= 0)
        cells = self._cell_grid()

        def work(first: int, last: int) -> None:
            out[first:last] = cells.contains(self._normalised(_rows(array, first, last)))

        over_rows(work, len(out), CHUNK)
        return out.reshape(array.shape[:-1])

    def ray_intersect(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> RayHits:
        """Where rays first cross the surface: (distance, point, normal), in input coordinates and units.

        origins, directions: (..., 3), of shapes that broadcast to one; directions of any finite length but zero.
        distance: (...,), at least 0, in input units and not in lengths of the direction; inf where a ray misses, and
        where it is not finite or its direction is zero. point, normal: (..., 3), NaN there. All are float32 when
        both arguments are, else float64. Normals face outward and are of length one.
        A ray that starts inside hits where it leaves the solid; its normal then points along it. One that starts on
        the surface may hit there.
        With s the longest side of the solid's box: points are within 2e-6 s of the surface, and so are distances but
        where a ray grazes it; float32 adds its own rounding, far from the origin more than that. Where a ray goes in
        and out again within s / 1000, both crossings may be missed.
        Raises OptionError when a last dimension is not 3 or the shapes do not broadcast.
        """
        from .dhf.rays import RayHits, first_crossings

        from_, along = (_last_dimension(a, 3) for a in (origins, directions))
        try:
            shape = np.broadcast_shapes(from_.shape, along.shape)
        except ValueError as exc:
            raise OptionError(f"origins {from_.shape} and directions {along.shape} do not broadcast") from exc
        start, way = (np.broadcast_to(a, shape) for a in (from_, along))
        dtype = np.dtype(np.float32 if start.dtype == way.dtype == np.float32 else np.float64)
        n = start.size // 3
        distance = np.full(n, np.inf, dtype)
        point, normal = (np.full((n, 3), np.nan, dtype) for _ in range(2))
        cells = self._cell_grid()
        for at, last in _chunks(n):
            o, d = (_rows(a, at, last).astype(np.float64) for a in (start, way))
            with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
                d /= np.abs(d).max(axis=1, keepdims=True)  # its square may be too large or too small a number
                d /= np.linalg.norm(d, axis=1, keepdims=True)
            p = (o - self._centre) / self.container.scale
            t = first_crossings(cells, p, d)
            hit = np.flatnonzero(np.isfinite(t))
            _, g = implicit_gradient(self._dhfs, (p[hit] + t[hit, None] * d[hit]).astype(np.float32))
            t *= self.container.scale
            distance[at + hit], normal[at + hit] = t[hit], _outward(g)
            point[at + hit] = o[hit] + t[hit, None] * d[hit]
        return RayHits(distance.reshape(shape[:-1]), point.reshape(shape), normal.reshape(shape))

    def _cell_grid(self) -> CellGrid:
        from .dhf.cells import CellGrid

        with self._lock:  # the first thread makes it, others wait
            if self._cells is None:
                self._cells = CellGrid(self._dhfs)
            return self._cells

    def _grid(self, resolution: int) -> Tabled:
        """The grid of a resolution and the height tables that go with it, which the next surface may want again."""
        from .dhf.isosurface import make_grid

        with self._lock:
            if self._tables is None or self._tables[0] != resolution:
                made = resolution, make_grid(self._dhfs, resolution)
                if resolution > KEPT:
                    return made[1]
                self._tables = made
            return self._tables[1]

    def _normalised(self, points: npt.NDArray[np.floating]) -> F32:
        """(N, 3) points of input coordinates -> normalised frame; subtracted in float64."""
        flat = points.reshape(-1)  # numpy is several times slower over rows of three
        with np.errstate(over="ignore"):
            p = flat - np.tile(self._centre, len(points))
            p /= self.container.scale
            return p.astype(np.float32).reshape(-1, 3)

    def to_mesh(
        self,
        resolution: int | None = None,
        method: Literal["marching-cubes", "intersection"] | None = None,
        max_error: float | str | None = None,
        faces: int | None = None,
        normals: bool = False,
    ) -> Any:
        """The surface as a `trimesh.Trimesh` in input coordinates: watertight, facing outward.

        resolution: marching-cubes cells along the longest side of the solid's box, 8 to 2048. Where neither this nor a
        method is given, 256, but an intersection for a solid with walls thinner than a cell of that.
        method: "marching-cubes", or "intersection", which triangulates each double height field and intersects the
        solids: creases stay sharp, and far fewer triangles do. Should manifold3d fail, there is a CndhfWarning and the
        result of marching cubes. So there is when walls are thinner than a cell of that and of the default resolution.
        max_error: of an intersection, about the distance from the exact surface: a number in input units, or a string
        "0.1%" of the solid's bounding box's diagonal; "0.02%", or a twentieth of thin walls, when neither this nor
        `faces` is given.
        faces: of an intersection, the most triangles, in place of max_error.
        normals: set the mesh's vertex normals from the networks' analytic gradient.
        Takes at most 512 MiB of memory, 256 bytes for each double height field and square of the resolution, and 250
        bytes a vertex: see `limits`. An intersection takes 512 MiB and 1 KiB for each triangle of the double height
        fields' solids: some hundred MiB, but up to 4 GiB for a field of noise.
        Raises OptionError, SurfaceError, or MissingExtraError (the `mesh` extra).
        """
        from .dhf import isosurface as surface  # here: a program that only asks for points should not wait for it

        chosen = method is not None or resolution is not None
        cells = RESOLUTION if resolution is None else resolution
        self.limits.check(self.container, cells)
        trimesh = require("trimesh", "mesh")
        if method not in (None, "marching-cubes", "intersection"):
            raise OptionError(f"method is {method!r}; there are 'marching-cubes' and 'intersection'")
        if method != "intersection" and (max_error is not None or faces is not None):
            raise OptionError("max_error and faces belong to method 'intersection'")
        if method == "intersection":
            vertices, triangles = self._intersection(max_error, faces, cells)
        elif not chosen:
            vertices, triangles = self.surface(cells)
        else:
            self._warn_of_thin(cells)
            vertices, triangles = surface.marching_cubes(self._dhfs, self._grid(cells), self.limits)
        # process=False: merging vertices by position could weld parts of the surface that only touch.
        mesh = trimesh.Trimesh(vertices * self.container.scale + self._centre, triangles, process=False)
        if normals:
            mesh.vertex_normals = self.normals(mesh.vertices)
        return mesh

    def normals(self, points: npt.ArrayLike) -> F32:
        """Outward unit normals (..., 3) at surface points (..., 3) in input coordinates; on a crease, that of one side.

        Raises OptionError when the last dimension is not 3.
        """
        return _outward(self.implicit(points, gradient=True)[1])

    def _intersection(
        self, max_error: float | str | None, faces: int | None, resolution: int
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
        """In the normalised frame."""
        from .dhf import intersection as solids
        from .dhf import isosurface as surface

        if max_error is not None and faces is not None:
            raise OptionError("give max_error or faces, not both")
        if faces is not None and not faces >= 4:
            raise OptionError(f"faces is {faces}; a solid has at least 4")
        rough = None
        try:
            rough = surface.marching_cubes(self._dhfs, self._grid(ROUGH), self.limits)
            sides = np.ptp(rough[0], axis=0)
        except SurfaceError:  # nothing as thick as a cell
            grid = self._grid(ROUGH)[0]
            sides = grid.spacing * (np.array(grid.shape) - 3)
        diagonal = float(np.linalg.norm(sides))
        error = None
        if faces is None:
            error = _length(DEFAULT_ERROR if max_error is None else max_error, diagonal, self.container.scale)
            thin = self._thin(RESOLUTION)
            if thin is not None and max_error is None:
                error = min(error, thin.typical / 20)
        try:
            found = solids.intersection(self._dhfs, error, None if faces is None else int(faces), self.limits)
            if rough is not None:
                # The two surfaces are apart by half a cell of the rough one at most, on average, and by the error; of
                # few triangles no error is known.
                volume = solids.volume(*rough)
                allowed = volume / 2 if error is None else solids.area(*rough) * (diagonal / ROUGH / 2 + error)
                if abs(solids.volume(*found) - volume) > allowed:
                    raise SurfaceError("its volume is not that of the solid")
        except SurfaceError as exc:
            warnings.warn(f"no intersection ({exc}); the surface is that of marching cubes", CndhfWarning, stacklevel=3)
            self._warn_of_thin(resolution)
            return surface.marching_cubes(self._dhfs, self._grid(resolution), self.limits)
        return found

    def surface(self, resolution: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
        """Vertices and triangles in the normalised frame: an intersection where walls are thinner than a cell of the
        default resolution, else marching cubes at the one given."""
        from .dhf import isosurface as surface

        if self._thin(RESOLUTION):
            return self._intersection(None, None, RESOLUTION)
        return surface.marching_cubes(self._dhfs, self._grid(resolution), self.limits)

    def _thin(self, resolution: int) -> Thickness | None:
        """How thick the solid is, where a cell of this resolution is thicker."""
        from .dhf.thickness import thickness

        with self._lock:
            if self._thickness is None:
                self._thickness = (thickness(self._dhfs),)
            found = self._thickness[0]
        return found if found is not None and found.resolution > resolution else None

    def _warn_of_thin(self, resolution: int) -> None:
        # What any solid loses on a coarse grid goes without saying.
        thin = self._thin(max(resolution, RESOLUTION))
        if thin is not None:
            warnings.warn(
                f"parts of the solid, {thin.least * self.container.scale:.3g} thick, are thinner than a cell of "
                f"resolution {resolution} and may come out torn or not at all: leave resolution and method to the "
                f"default, take the method intersection, or a resolution of {math.ceil(thin.resolution)} and more",
                CndhfWarning,
                stacklevel=3,
            )

    def occupancy(self, resolution: int = 256) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.float64], float]:
        """In/out at the nodes of a regular grid around the solid.

        Returns (grid, origin, spacing): grid[i, j, k] tells whether origin + spacing * (i, j, k), in input
        coordinates, is inside. A CndhfWarning says when parts of the solid are thinner than a cell. Takes the memory
        of `to_mesh`, with 2 bytes a node in place of those of vertices.
        Raises OptionError or SurfaceError.
        """
        from .dhf import isosurface as surface

        self.limits.check(self.container, resolution)
        self._warn_of_thin(resolution)
        grid, origin, spacing = surface.occupancy(self._dhfs, self._grid(resolution), self.limits)
        scale = self.container.scale
        return grid, origin * scale + self._centre, spacing * scale

    def prefix(self, n_dhfs: int) -> Model:
        """The solid of the first `n_dhfs` double height fields: it holds the whole solid, and what later ones carve.

        The same as `loads_prefix` gives of the file's first bytes, with this model's limits. Raises OptionError.
        """
        if not 1 <= n_dhfs <= len(self._dhfs):
            raise OptionError(f"there are no {n_dhfs} DHFs; this model has {len(self._dhfs)}")
        first = replace(self.container, dhfs=self.container.dhfs[:n_dhfs], metadata=fmt.Metadata())
        return Model(first, limits=self.limits)

    def dumps(self) -> bytes:
        """The bytes of the `.cndhf` file."""
        return fmt.dumps(self.container)

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the `.cndhf` file, whole or not at all. Raises OutputError."""
        write_atomically(path, self.dumps(), overwrite)


def loads(data: bytes, limits: Limits | None = None) -> Model:
    """Model from the bytes of a `.cndhf` file, with `Model.limits`. Raises FormatError.

    Takes at most 64 MiB of memory beyond the file's bytes.
    """
    data = bytes(data)
    return Model(fmt.loads(data), fmt.section_sizes(data), limits)


def loads_prefix(data: bytes, n_dhfs: int | None = None, limits: Limits | None = None) -> Model:
    """Model of the first `n_dhfs` double height fields, or as many as are complete, from a file's first bytes.

    For streams: call it again as bytes arrive. The checksum comes last, so that damage may go unseen here; `loads` the
    whole file in the end. limits: as for `loads`. Raises FormatError (TruncatedError where more bytes are needed)
    or OptionError.
    """
    return Model(fmt.loads_prefix(bytes(data), n_dhfs), limits=limits)


def load(path: str | os.PathLike[str], limits: Limits | None = None) -> Model:
    """As `loads`, from a file. Raises FormatError or InputError, naming the file."""
    return _loads(read_bytes(path, MAX_FILE_SIZE + 1), str(Path(path)), limits)


def load_stream(stream: BinaryIO, name: str, limits: Limits | None = None) -> Model:
    """As `loads`, from an open binary stream, read to its end. Raises FormatError or InputError, with `name`."""
    try:
        data = stream.read(MAX_FILE_SIZE + 1)
    except OSError as exc:
        raise InputError(f"{name}: cannot be read: {exc.strerror}") from exc
    return _loads(data, name, limits)


def _loads(data: bytes, name: str, limits: Limits | None) -> Model:
    try:
        if len(data) > MAX_FILE_SIZE:
            raise LimitError(f"the file has more than {MAX_FILE_SIZE} bytes, the most that the format allows")
        return loads(data, limits)
    except FormatError as exc:
        raise type(exc)(f"{name}: {exc}") from exc


def _outward(gradient: F32) -> F32:
    """The outward unit normals of a surface where f has these gradients (..., 3)."""
    length = np.linalg.norm(gradient, axis=-1, keepdims=True)
    # Flat heights have slope 1 towards their own axis: only points that are not finite have no direction.
    return np.divide(-gradient, length, out=np.zeros_like(gradient), where=length > 0)


def _length(text: float | str, diagonal: float, scale: float) -> float:
    """A positive length in normalised units: `text` is a number of input units, or "N%" of the normalised diagonal."""
    try:
        relative = str(text).strip().endswith("%")
        value = float(str(text).strip().removesuffix("%"))
    except ValueError:
        relative, value = False, 0.0
    if not 0 < value < np.inf:
        raise OptionError(
            f"max_error is {text!r}; give a positive number of input units, or one with % of the diagonal"
        )
    return value / 100 * diagonal if relative else value / scale


def _last_dimension(values: npt.ArrayLike, n: int) -> npt.NDArray[Any]:
    """An array (..., n) of real numbers."""
    try:
        array = np.asarray(values)
    except ValueError:  # lists of different lengths
        array = np.empty((), dtype=object)
    if array.dtype.kind not in "fiub":
        raise OptionError(f"an array of numbers of shape (..., {n}) is needed")
    if array.ndim == 0 or array.shape[-1] != n:
        raise OptionError(f"an array of shape (..., {n}) is needed; got {array.shape}")
    return array


def _chunks(n: int) -> Iterator[tuple[int, int]]:
    return ((at, min(at + CHUNK, n)) for at in range(0, n, CHUNK))


def _rows(array: npt.NDArray[Any], first: int, last: int) -> npt.NDArray[Any]:
    """Rows first to last of array.reshape(-1, n), which would copy an array that is not in one piece."""
    if array.ndim <= 2 or array.flags.c_contiguous:
        return array.reshape(-1, array.shape[-1])[first:last]
    return array[np.unravel_index(np.arange(first, last), array.shape[:-1])]
