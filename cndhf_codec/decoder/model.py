"""The decoded model: queries and surfaces in input coordinates."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from .. import format as fmt
from ..errors import FormatError, LimitError, OptionError, SurfaceError, require
from ..files import read_bytes, write_atomically
from ..format.constants import MAX_FILE_SIZE
from .dhf import Dhf, implicit, implicit_gradient
from .limits import Limits
from .network import F32

CHUNK = 2**16  # points evaluated at once
FAR = 2.0**20  # normalised units; a DHF's box ends at 2
ROUGH = 64  # resolution of the surface that an intersection is checked against
DEFAULT_ERROR = "0.03%"  # of an intersection: less than what the smallest files lose, by far


class Model:
    """A solid as the intersection of double height fields.

    Points go in, and surfaces and distances come out, in the coordinates and units of the mesh that was encoded.

    limits: how much the file may ask for when a surface or a grid is made; set it to others at will.
    """

    def __init__(self, container: fmt.Container, size: int | None = None, limits: Limits | None = None) -> None:
        """size: bytes of the file that the container was read from, where it was."""
        self.container = container
        self.limits = limits or Limits()
        self._size = size
        self._dhfs = [Dhf(record) for record in container.dhfs]
        self._centre = np.array(container.centre, dtype=np.float64)

    @property
    def info(self) -> dict[str, Any]:
        """What the file holds: version-independent names, plain Python values, errors in input units."""
        c = self.container
        parameters = sum(d.parameters for d in c.dhfs)
        # A copy can have another size: sections that this version does not know, another zstd release.
        size = len(self.dumps()) if self._size is None else self._size
        return {
            "bytes": size,
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
        array = _last_dimension(uv, 2).astype(np.float32)
        return self._dhfs[i].heights(array.reshape(-1, 2)).reshape(array.shape)

    @overload
    def implicit(self, points: npt.ArrayLike, gradient: Literal[False] = False) -> F32: ...

    @overload
    def implicit(self, points: npt.ArrayLike, gradient: Literal[True]) -> tuple[F32, F32]: ...

    def implicit(self, points: npt.ArrayLike, gradient: bool = False) -> F32 | tuple[F32, F32]:
        """The implicit function f at points (..., 3) in input coordinates -> (...,) float32 in input units.

        Positive inside, zero on the surface, negative outside. f / |grad f| approximates the distance.
        gradient: return (f, grad f) with grad f (..., 3) float32, by input coordinates: analytic, and that of one
        side where f has a crease. -grad f / |grad f| is the surface's outward normal.
        Takes at most 32 MiB of memory, and 40 bytes a point. Raises OptionError when the last dimension is not 3.
        """
        array = _last_dimension(points, 3)
        flat = array.reshape(-1, 3)
        out = np.empty(len(flat), dtype=np.float32)
        slope = np.empty((len(flat) if gradient else 0, 3), dtype=np.float32)
        for at in range(0, len(flat), CHUNK):
            with np.errstate(over="ignore"):
                normalised = (flat[at : at + CHUNK] - self._centre) / self.container.scale
            # However far a point is, it is outside: float32 must not overflow on the way to saying so.
            p = np.clip(normalised, -FAR, FAR).astype(np.float32)
            if gradient:
                f, slope[at : at + CHUNK] = implicit_gradient(self._dhfs, p)
            else:
                f = implicit(self._dhfs, p)
            out[at : at + CHUNK] = f * np.float32(self.container.scale)
        # By input coordinates, in input units: the scale of one cancels that of the other.
        shaped = out.reshape(array.shape[:-1])
        return (shaped, slope.reshape(array.shape)) if gradient else shaped

    def contains(self, points: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Whether points (..., 3) in input coordinates lie in the solid or on its surface -> (...,) bool."""
        return self.implicit(points) >= 0

    def to_mesh(
        self,
        resolution: int = 256,
        method: Literal["marching-cubes", "intersection"] = "marching-cubes",
        max_error: float | str | None = None,
        faces: int | None = None,
        normals: bool = False,
    ) -> Any:
        """The surface as a `trimesh.Trimesh` in input coordinates: watertight, facing outward.

        resolution: marching-cubes cells along the longest side of the solid's box, 8 to 2048.
        method: "intersection" triangulates each double height field and intersects the solids: creases stay sharp,
        and far fewer triangles do. Should manifold3d fail, there is a UserWarning and the result of marching cubes.
        max_error: of an intersection, about the distance from the exact surface: a number in input units, or a string
        "0.1%" of the solid's bounding box's diagonal; "0.03%" when neither this nor `faces` is given.
        faces: of an intersection, the most triangles, in place of max_error.
        normals: set the mesh's vertex normals from the networks' analytic gradient.
        Takes at most 512 MiB of memory, 256 bytes for each double height field and square of the resolution, and 250
        bytes a vertex: see `limits`. Raises OptionError, SurfaceError, or MissingExtraError (the `mesh` extra).
        """
        from . import surface  # here: a program that only asks for points should not wait for it

        self.limits.check(self.container, resolution)
        trimesh = require("trimesh", "mesh")
        if method not in ("marching-cubes", "intersection"):
            raise OptionError(f"method is {method!r}; there are 'marching-cubes' and 'intersection'")
        if method == "intersection":
            vertices, triangles = self._intersection(max_error, faces, resolution)
        elif max_error is not None or faces is not None:
            raise OptionError("max_error and faces belong to method 'intersection'")
        else:
            vertices, triangles = surface.marching_cubes(self._dhfs, resolution, self.limits)
        # process=False: merging vertices by position could weld parts of the surface that only touch.
        mesh = trimesh.Trimesh(vertices * self.container.scale + self._centre, triangles, process=False)
        if normals:
            mesh.vertex_normals = self.normals(mesh.vertices)
        return mesh

    def normals(self, points: npt.ArrayLike) -> F32:
        """Outward unit normals (..., 3) at surface points (..., 3) in input coordinates; on a crease, that of one side.

        Raises OptionError when the last dimension is not 3.
        """
        _, gradient = self.implicit(points, gradient=True)
        length = np.linalg.norm(gradient, axis=-1, keepdims=True)
        # Flat heights have slope 1 towards their own axis: only points that are not finite have no direction.
        return np.divide(-gradient, length, out=np.zeros_like(gradient), where=length > 0)

    def _intersection(
        self, max_error: float | str | None, faces: int | None, resolution: int
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
        """In the normalised frame."""
        from . import solids, surface

        if max_error is not None and faces is not None:
            raise OptionError("give max_error or faces, not both")
        if faces is not None and faces < 4:
            raise OptionError(f"faces is {faces}; a solid has at least 4")
        rough = surface.marching_cubes(self._dhfs, ROUGH, self.limits)
        diagonal = float(np.linalg.norm(np.ptp(rough[0], axis=0)))
        error = None
        if faces is None:
            error = _length(DEFAULT_ERROR if max_error is None else max_error, diagonal, self.container.scale)
        try:
            found = solids.intersection(self._dhfs, error, faces)
            # The two surfaces are apart by half a cell of the rough one at most, on average, and by the error; of few
            # triangles no error is known.
            volume = solids.volume(*rough)
            allowed = volume / 2 if error is None else solids.area(*rough) * (diagonal / ROUGH / 2 + error)
            if abs(solids.volume(*found) - volume) > allowed:
                raise SurfaceError("its volume is not that of the solid")
        except SurfaceError as exc:
            warnings.warn(f"no intersection ({exc}); the surface is that of marching cubes", stacklevel=3)
            return surface.marching_cubes(self._dhfs, resolution, self.limits)
        return found

    def occupancy(self, resolution: int = 256) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.float64], float]:
        """In/out at the nodes of a regular grid around the solid.

        Returns (grid, origin, spacing): grid[i, j, k] tells whether origin + spacing * (i, j, k), in input
        coordinates, is inside. Takes the memory of `to_mesh`, with 2 bytes a node in place of those of vertices.
        Raises OptionError or SurfaceError.
        """
        from . import surface

        self.limits.check(self.container, resolution)
        grid, origin, spacing = surface.occupancy(self._dhfs, resolution, self.limits)
        scale = self.container.scale
        return grid, origin * scale + self._centre, spacing * scale

    def prefix(self, n_dhfs: int) -> Model:
        """The solid of the first `n_dhfs` double height fields: it holds the whole solid, and what later ones carve.

        The same as `loads_prefix` gives of the file's first bytes. Raises OptionError.
        """
        if not 1 <= n_dhfs <= len(self._dhfs):
            raise OptionError(f"there are no {n_dhfs} DHFs; this model has {len(self._dhfs)}")
        return Model(replace(self.container, dhfs=self.container.dhfs[:n_dhfs], metadata=fmt.Metadata()))

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
    return Model(fmt.loads(bytes(data)), len(data), limits)


def loads_prefix(data: bytes, n_dhfs: int | None = None) -> Model:
    """Model of the first `n_dhfs` double height fields, or as many as are complete, from a file's first bytes.

    For streams: call it again as bytes arrive. The checksum comes last, so that damage may go unseen here; `loads` the
    whole file in the end. Raises FormatError (TruncatedError where more bytes are needed) or OptionError.
    """
    return Model(fmt.loads_prefix(bytes(data), n_dhfs))


def load(path: str | os.PathLike[str], limits: Limits | None = None) -> Model:
    """As `loads`, from a file. Raises FormatError or InputError, naming the file."""
    data = read_bytes(path, MAX_FILE_SIZE + 1)
    try:
        if len(data) > MAX_FILE_SIZE:
            raise LimitError(f"the file has more than {MAX_FILE_SIZE} bytes, the most that the format allows")
        return loads(data, limits)
    except FormatError as exc:
        raise type(exc)(f"{Path(path)}: {exc}") from exc


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


def _last_dimension(values: npt.ArrayLike, n: int) -> npt.NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != n:
        raise OptionError(f"an array of shape (..., {n}) is needed; got {array.shape}")
    return array
