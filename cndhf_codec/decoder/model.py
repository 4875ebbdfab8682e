"""The decoded model: queries and surfaces in the coordinates of the mesh that was encoded.

What is said of one representation alone stands in dhf/representation.py and surface/representation.py.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
import numpy.typing as npt

from .. import format as fmt
from ..arguments import chunks, path_like, rows, vectors, whole_in, whole_number
from ..arrays import F32, F64, Mask
from ..errors import OptionError, require
from ..files import write_atomically
from .dhf.meshes import DEFAULT_RESOLUTION
from .dhf.representation import DhfRepresentation
from .limits import Limits
from .parallel import over_rows
from .representation import Detail, Method, Representation
from .results import Nearest, OccupancyGrid, RayHits, TriangleMesh
from .surface.representation import SurfaceRepresentation

if TYPE_CHECKING:
    from ..viewer.page import Frame


class Model:
    """The shape of a `.cndhf` file, for queries of points and rays, and for meshes.

    A file holds an intersection of double height fields (`dhf`) or a subdivision surface (`surface`): `representation`
    says which. A surface may be a *sheet*, which encloses nothing; what needs an inside raises SheetError then.

    All coordinates and lengths are those of the mesh that was encoded, in its units ("input coordinates"). Only
    `heights` and `surface` use the normalised frame, (p - centre) / scale, with `centre` and `scale` from `info`.
    Points may be float32 or float64; at a great distance from the origin only float64 has the digits they need.

    Queries work in pieces. Besides their arguments and results they hold at most 60 MB, whatever the number of points,
    8 MB per processor after the second, and for a moment 1 MB per double height field. Those that are answered from a
    mesh, which are `distance` and `nearest` and all of a surface, hold 100 MB, 40 MB per processor after the second,
    and 800 bytes per triangle of the mesh, of which a surface has 524,288 at most. A model may be used from several
    threads at once.

    Models are made by `load`, `loads`, `loads_prefix` and `encode`.

    Parameters
    ----------
    container : format.Container
        The contents of a file.
    sections : dict of str to int, optional
        Sizes of the sections of the file that the container was read from, as `format.section_sizes` gives them.
    limits : Limits, optional
        How much work and memory surfaces and grids may take.
    body : bytes, optional
        Of the section of the container's surface, where it has been encoded already.

    Attributes
    ----------
    report : Report or None
        What `encode` did and had to assume; None for a model that was read from a file.

    Raises
    ------
    OptionError
        When an argument has another type.

    Examples
    --------
    >>> import cndhf_codec
    >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
    >>> model.contains([[10, 5, 5], [0, 0, 100]])
    array([ True, False])
    """

    def __init__(
        self,
        container: fmt.Container,
        sections: dict[str, int] | None = None,
        limits: Limits | None = None,
        body: bytes | None = None,
    ) -> None:
        if not isinstance(container, fmt.Container):
            raise OptionError(f"a format.Container is needed; got {type(container).__name__}: see load and loads")
        self._container = container
        self.limits = Limits() if limits is None else limits
        self._sections, self._body = sections, body
        self._shape: Representation = (
            DhfRepresentation(container) if container.surface is None else SurfaceRepresentation(container)
        )
        self._centre = np.array(container.centre, dtype=np.float64)
        # What `encode` did, a `cndhf_codec.Report`; None for a model that was read.
        self.report: Any = None

    @property
    def container(self) -> fmt.Container:
        """The contents of the file. To change them, make another model.

        Returns
        -------
        format.Container

        Examples
        --------
        >>> import cndhf_codec
        >>> cndhf_codec.load("tests/golden/encoded.cndhf").container.centre
        (0.0, 0.0, 13.0)
        """
        return self._container

    def __reduce__(self) -> tuple[Any, ...]:
        # Cells and tables can be made again, and their lock cannot be copied.
        return Model, (self.container, self._sections, self.limits), {"report": self.report}

    def __repr__(self) -> str:
        """Representation, size and mean error.

        >>> import cndhf_codec
        >>> cndhf_codec.load("tests/golden/encoded.cndhf")
        <Model of 2 double height fields, 747 bytes, mean error 0.05322>
        """
        info = self.info
        if info["representation"] == "dhf":
            count = len(info["dhfs"])
            what = f"{count} double height field{'s' * (count != 1)}"
        else:
            what = f"a surface of {info['vertices']} control vertices"
        error = "not measured" if info["mean_error"] is None else f"{info['mean_error']:.4g}"
        return f"<Model of {what}, {info['bytes']} bytes, mean error {error}>"

    @property
    def limits(self) -> Limits:
        """How much work and memory surfaces and grids may take; may be replaced at any time.

        Raises OptionError when it is set to anything but `Limits`.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> model.limits = cndhf_codec.Limits(resolution=512)
        >>> model.limits.resolution
        512
        """
        return self._limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        if not isinstance(limits, Limits):
            raise OptionError(f"limits is {limits!r}; a Limits is needed")
        self._limits = limits

    @property
    def representation(self) -> Literal["dhf", "surface"]:
        """What the file holds: "dhf", an intersection of double height fields, or "surface", a subdivision surface.

        Examples
        --------
        >>> import cndhf_codec
        >>> cndhf_codec.load("tests/golden/encoded.cndhf").representation
        'dhf'
        """
        return self._shape.kind

    @property
    def info(self) -> dict[str, Any]:
        """What the file holds, in plain Python values.

        Returns
        -------
        dict
            bytes, sections
                Size of the file, and of each of its sections.
            representation
                "dhf" or "surface".
            dhfs
                Of `dhf` only. For each double height field: axis (3 floats), mirrored ("u", "v"), width, hidden_layers,
                parameters and bounds (of u, v, z in its frame, normalised units).
            parameters, bits_per_parameter
                Of `dhf` only. Weights of all networks, and the file's size in bits divided by their number.
            vertices, faces, sharp_edges, components, bits_per_vertex
                Of `surface` only. Counts of the control mesh, without sharp boundary edges, and the file's size in bits
                divided by the number of vertices.
            closed
                Of `surface` only. Whether every edge has two faces; if not, it is a sheet.
            centre, scale
                Of the normalised frame: a point p of input coordinates is (p - centre) / scale there.
            encoder, source
                Names that the encoder stored, or None.
            mean_error, p99_error, max_error
                Distances from the encoded mesh in input units, or None: mean, 99th percentile and maximum.

        Examples
        --------
        >>> import cndhf_codec
        >>> info = cndhf_codec.load("tests/golden/encoded.cndhf").info
        >>> info["bytes"], info["parameters"], len(info["dhfs"])
        (747, 804, 2)
        """
        c = self.container
        # What `dumps` gives can have another size: without unknown sections, with another release of zstd.
        sections = fmt.section_sizes(self.dumps()) if self._sections is None else self._sections
        size = sum(sections.values())
        return {
            "bytes": size,
            "sections": dict(sections),
            "representation": self._shape.kind,
            **self._shape.describe(size),
            "centre": list(c.centre),
            "scale": c.scale,
            "encoder": c.metadata.encoder,
            "mean_error": c.metadata.mean_error,
            "p99_error": c.metadata.p99_error,
            "max_error": c.metadata.max_error,
            "source": c.metadata.source,
        }

    def heights(self, i: int, uv: npt.ArrayLike) -> F32:
        """Near and far height of a double height field over its plane: of `dhf` only.

        Parameters
        ----------
        i : int
            Number of the double height field, from 0.
        uv : array_like, shape (..., 2)
            Points of the plane, in the field's own frame: normalised and rotated, normalised units. Those outside the
            field's domain are clamped to it.

        Returns
        -------
        ndarray of float32, shape (..., 2)
            Near and far height in the same frame. The solid is where near <= z <= far; nowhere, where far < near.

        Raises
        ------
        OptionError
            When the file holds a surface, there is no field `i`, or uv is not an array of numbers of that shape.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> model.heights(0, [[0.5, 0.1], [0.0, 0.2]]).round(1)
        array([[ 0.1,  0.3],
               [-0.3,  0.3]], dtype=float32)
        """
        shape = self._height_fields("heights")
        dhfs = shape.solid.dhfs
        i = whole_number(i, "the number of a DHF")
        if not 0 <= i < len(dhfs):
            raise OptionError(f"there is no DHF {i}; this model has {len(dhfs)}")
        array = vectors(uv, 2)
        out = np.empty((array.size // 2, 2), dtype=np.float32)
        for first, last in chunks(len(out), shape.points_at_once):
            out[first:last] = dhfs[i].heights(rows(array, first, last).astype(np.float32))
        return out.reshape(array.shape)

    @overload
    def implicit(self, points: npt.ArrayLike, gradient: Literal[False] = False) -> F32: ...

    @overload
    def implicit(self, points: npt.ArrayLike, gradient: Literal[True]) -> tuple[F32, F32]: ...

    def implicit(self, points: npt.ArrayLike, gradient: bool = False) -> F32 | tuple[F32, F32]:
        """The implicit function f: positive inside the solid, zero on its surface, negative outside.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in input coordinates.
        gradient : bool
            Return the gradient of f, too.

        Returns
        -------
        f : ndarray of float32, shape (...)
            In input units. Of double height fields: close to the surface, f / |grad f| approximates the distance from
            it. Of a surface: the signed distance, as in `distance`.
        gradient : ndarray of float32, shape (..., 3), only if asked for
            By input coordinates, analytic. Where f has a crease, that of one side. -grad f / |grad f| is the outward
            normal of the surface. Zero where f is not finite.

        Raises
        ------
        OptionError
            When points is not an array of numbers of that shape.
        SheetError
            When the file holds a sheet.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> model.implicit([[10, 5, 5], [3, 3, 3]]).round()
        array([  5., -14.], dtype=float32)
        >>> f, gradient = model.implicit([10, 5, 5], gradient=True)
        >>> gradient.shape
        (3,)
        """
        array = vectors(points, 3)
        out = np.empty(array.size // 3, dtype=np.float32)
        slope = np.empty((len(out) if gradient else 0, 3), dtype=np.float32)
        for first, last in chunks(len(out), self._shape.points_at_once):
            p = self._normalised(rows(array, first, last))
            if gradient:
                f, slope[first:last] = self._shape.implicit_gradient(p)
            else:
                f = self._shape.implicit(p)
            out[first:last] = f * np.float32(self.container.scale)
        # The gradient has no scale: that of f and that of the coordinates cancel.
        shaped = out.reshape(array.shape[:-1])
        return (shaped, slope.reshape(array.shape)) if gradient else shaped

    def contains(self, points: npt.ArrayLike) -> Mask:
        """Whether points lie inside the solid or on its surface.

        The same as `implicit(points) >= 0`, up to the rounding of float32, and much faster for many points. Of double
        height fields: a table of 2 MB is made then, and networks are evaluated next to the surface only. Of a surface:
        inside is where the winding number of its default mesh is positive, so parts that overlap are united, and a
        part within another is a cavity when it faces the other way.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in input coordinates.

        Returns
        -------
        ndarray of bool, shape (...)

        Raises
        ------
        OptionError
            When points is not an array of numbers of that shape.
        SheetError
            When the file holds a sheet.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> model.contains([[10, 5, 5], [30, 3, 3], [3, 3, 3]])
        array([ True,  True, False])
        """
        array = vectors(points, 3)
        out = np.empty(array.size // 3, dtype=bool)
        self._shape.prepare(len(out))

        def work(first: int, last: int) -> None:
            out[first:last] = self._shape.contains(self._normalised(rows(array, first, last)))

        over_rows(work, len(out), self._shape.points_at_once)
        return out.reshape(array.shape[:-1])

    def distance(self, points: npt.ArrayLike) -> F64:
        """Signed distance from the surface: positive inside the solid, negative outside.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in input coordinates.

        Returns
        -------
        ndarray of float64, shape (...)
            In input units: the distance from the mesh that `to_mesh()` makes by default, exact up to rounding. So it is
            off by what that mesh is: of a surface, by less than half the file's mean error, but next to few of its
            edges. -inf for a point that is not finite; NaN for one with a NaN.

        Raises
        ------
        OptionError
            When points is not an array of numbers of that shape.
        SheetError
            When the file holds a sheet, which has no inside: see `nearest`.
        SurfaceError
            When there is no such mesh, as for `to_mesh`.

        Notes
        -----
        The first call makes the mesh and its tables, 800 bytes per triangle. They are kept.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> model.distance([[10, 5, 5], [20, 10, 10]]).round()
        array([ 3., -2.])
        """
        return self._in_pieces(points, self._shape.distance) * self.container.scale

    def nearest(self, points: npt.ArrayLike) -> Nearest:
        """The points of the surface that are nearest to points, for solids and sheets.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in input coordinates.

        Returns
        -------
        Nearest
            distance (...), without a sign, and point (..., 3), in input units and coordinates; float64. Of the same
            mesh as in `distance`. For a point that is not finite, inf or NaN, and NaN.

        Raises
        ------
        OptionError
            When points is not an array of numbers of that shape.
        SurfaceError
            As for `distance`.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> model.nearest([20, 10, 10]).point.round()
        array([20., 10.,  8.])
        """
        array = vectors(points, 3)
        distance, point = np.empty(array.size // 3), np.empty((array.size // 3, 3))
        for first, last in chunks(len(distance), self._shape.points_at_once):
            found = self._shape.nearest(self._normalised(rows(array, first, last)))
            distance[first:last] = found.distance * self.container.scale
            point[first:last] = found.point * self.container.scale + self._centre
        return Nearest(distance.reshape(array.shape[:-1]), point.reshape(array.shape))

    def normals(self, points: npt.ArrayLike) -> F32:
        """Outward normals of the surface.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points on the surface, or close to it, in input coordinates.

        Returns
        -------
        ndarray of float32, shape (..., 3)
            Of length one; on a crease, the normal of one side. Of a surface: those of the limit surface, between the
            corners of the triangle of the default mesh that is nearest. Zero for a point that is not finite.

        Raises
        ------
        OptionError
            When points is not an array of numbers of that shape.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> bool(model.normals([20, 10, 7.92])[2] > 0.9)
        True
        """
        array = vectors(points, 3)
        out = np.empty((array.size // 3, 3), dtype=np.float32)
        for first, last in chunks(len(out), self._shape.points_at_once):
            out[first:last] = self._shape.normals(self._normalised(rows(array, first, last)))
        return out.reshape(array.shape)

    def ray_intersect(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> RayHits:
        """Where rays first cross the surface.

        A ray that starts inside the solid hits where it leaves it, and the normal there points along the ray. A ray
        that starts on the surface may hit there.

        Parameters
        ----------
        origins, directions : array_like, shape (..., 3)
            In input coordinates, of shapes that broadcast to one. Directions may have any length but zero.

        Returns
        -------
        RayHits
            distance (...), point (..., 3) and normal (..., 3), in input coordinates and units; float32 when both
            arguments are, else float64. The distance is inf, and the rest NaN, where a ray misses, has a number that is
            not finite, or has no direction.

        Raises
        ------
        OptionError
            When an argument is not an array of numbers of that shape, or the shapes do not broadcast.

        Notes
        -----
        With s the longest side of the solid's box, points are within 2e-6 s of the surface; so are distances, unless
        the ray grazes it. float32 adds its own rounding, which grows with the distance from the origin. Where a ray
        enters and leaves the solid within s / 1000, both crossings may be missed.

        This holds for double height fields. Of a surface, hits and normals are those of the triangles of its default
        mesh, exact up to rounding; the normal is that of the side where the triangle faces.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> hits = model.ray_intersect([[20, 10, 100], [20, 80, 100]], [0, 0, -1])
        >>> hits.distance.round(1)
        array([92., inf])
        """
        from_, along = (vectors(a, 3) for a in (origins, directions))
        try:
            shape = np.broadcast_shapes(from_.shape, along.shape)
        except ValueError as exc:
            raise OptionError(f"origins {from_.shape} and directions {along.shape} do not broadcast") from exc
        from_, along = (np.broadcast_to(a, shape) for a in (from_, along))
        dtype = np.dtype(np.float32 if from_.dtype == along.dtype == np.float32 else np.float64)
        n = from_.size // 3
        distance = np.full(n, np.inf, dtype)
        point, normal = (np.full((n, 3), np.nan, dtype) for _ in range(2))
        for first, last in chunks(n, self._shape.points_at_once):
            o, d = (rows(a, first, last).astype(np.float64) for a in (from_, along))
            hits = self._shape.first_hits((o - self._centre) / self.container.scale, d)
            part = slice(first, last)
            distance[part], normal[part] = hits.distance * self.container.scale, hits.normal
            point[part] = hits.point * self.container.scale + self._centre
        return RayHits(distance.reshape(shape[:-1]), point.reshape(shape), normal.reshape(shape))

    def _height_fields(self, name: str) -> DhfRepresentation:
        """The representation, where it is one of double height fields. Raises OptionError."""
        if not isinstance(self._shape, DhfRepresentation):
            raise OptionError(f"{name} belongs to double height fields; this file holds a surface")
        return self._shape

    def _in_pieces(self, points: npt.ArrayLike, query: Callable[[F64], F64]) -> F64:
        array = vectors(points, 3)
        out = np.empty(array.size // 3)
        for first, last in chunks(len(out), self._shape.points_at_once):
            out[first:last] = query(self._normalised(rows(array, first, last)))
        return out.reshape(array.shape[:-1])

    def _normalised(self, points: npt.NDArray[Any]) -> F64:
        """Points (N, 3) of input coordinates in the normalised frame."""
        flat = points.reshape(-1)  # numpy is several times slower along rows of three
        with np.errstate(over="ignore", invalid="ignore"):
            p: F64 = flat - np.tile(self._centre, len(points))
            p /= self.container.scale
        return p.reshape(-1, 3)

    def to_mesh(
        self,
        resolution: int | None = None,
        method: Method | None = None,
        max_error: float | str | None = None,
        faces: int | None = None,
        normals: bool = False,
        level: int | None = None,
        specks: bool = False,
    ) -> Any:
        """The surface as a mesh: watertight, but that of a sheet; facing outward. Needs the `mesh` extra.

        By default there are as many triangles as the file's own measured error needs. Double height fields: marching
        cubes with cells of twelve mean errors (128 to 256 along the longest side), simplified by half the mean error,
        which adds 2 to 4 % to it; by intersection where walls are thinner than a cell; at 256, not simplified, where
        the file holds no error. A surface: subdivided, place by place, until its edges are within half the mean error
        of it, but for a tenth of those of the finest level at most; within 0.02 % of the diagonal where the file holds
        no error. That adds mostly less than 1 % to it. There are at most 524,288 triangles.

        Parameters
        ----------
        resolution : int, optional
            Of double height fields: cells along the longest side of the solid's box, 8 to 2048, for marching cubes. The
            mesh is then simplified only as far as max_error or faces say.
        method : {"marching-cubes", "intersection"}, optional
            Of double height fields. "intersection" triangulates each of them and intersects the solids, within 0.02 %
            of the diagonal, or at most a twentieth of the thickness of thin walls: creases are exact. Should that fail,
            the result is that of marching cubes, with a warning. "marching-cubes" alone is at 256, not simplified.
        max_error : float or str, optional
            About the greatest distance from the exact surface, as a number of input units or as "0.1%" of the diagonal
            of the shape's bounding box. Of marching cubes: 99.9 % of the vertices on a grid with cells of three such
            errors (384 at most along the longest side) are within it; between them, creases may be off by more.
        faces : int, optional
            The most triangles, 4 or more, in place of max_error: by simplification, but where a level of a surface has
            just so many. The rim of a sheet is that of the level that is simplified.
        normals : bool
            Set the mesh's vertex normals: from the analytic gradient, or of the limit surface. Vertices on the sharp
            edges of a surface then come once per side, so that its mesh has seams.
        level : int, optional
            Of a surface: how often the control mesh is subdivided, 0 to 6, in place of max_error.
        specks : bool
            Of double height fields: keep pieces that are thinner than 1.5 times the file's p99 error, and shorter than
            a tenth of the whole. They are artifacts of the fit, and left out otherwise; `contains` and the other
            queries of points still see them, those of distances do not.

        Returns
        -------
        trimesh.Trimesh
            In input coordinates.

        Raises
        ------
        OptionError
            When an option has a wrong type or value, options do not go together, one does not belong to what the file
            holds, or `faces` are too few for the shape's parts and handles.
        SurfaceError
            When the solid is empty or too thin for the resolution, a surface has no level as fine as that, or it asks
            for more than `limits` allow.
        MissingExtraError
            When trimesh or manifold3d is not installed; only intersections need the latter.

        Warns
        -----
        CndhfWarning
            When walls are thinner than a cell of the resolution asked for, or the intersection has failed.

        Notes
        -----
        Marching cubes takes at most 512 MiB of memory, 256 bytes per double height field and square of the resolution,
        and 250 bytes per vertex; simplification 1 KiB per vertex. An intersection takes 512 MiB and 1 KiB per triangle
        of the double height fields' solids: a few hundred MiB, but up to 4 GiB for a file of noise. A subdivision
        surface takes 64 MiB and 700 bytes per vertex, 1,200 with normals; it has half as many vertices as triangles.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> mesh = model.to_mesh()
        >>> mesh.is_watertight, len(mesh.faces) < len(model.to_mesh(128).faces) / 4
        (True, True)
        >>> len(model.to_mesh(faces=500).faces)
        500
        """
        detail = Detail(resolution, method, max_error, faces, level, specks)
        trimesh = require("trimesh", "mesh")
        if normals:
            vertices, triangles, vertex_normals = self._shape.shaded_mesh(detail, self.limits)
        else:
            vertices, triangles = self._shape.mesh(detail, self.limits)
        # process=False: merging vertices by position could weld parts of the surface that only touch.
        mesh = trimesh.Trimesh(vertices * self.container.scale + self._centre, triangles, process=False)
        if normals:
            mesh.vertex_normals = vertex_normals
        return mesh

    def surface(
        self, resolution: int | None = None, level: int | None = None, max_error: float | str | None = None
    ) -> TriangleMesh:
        """The surface as arrays in the normalised frame.

        Parameters
        ----------
        resolution : int, optional
            Of double height fields: cells along the longest side of the solid's box, for marching cubes, not
            simplified; by default as in `to_mesh`. When walls are thinner than a cell of 256, the surface is made by
            intersection, which needs the `mesh` extra.
        level : int, optional
            Of a surface: as for `to_mesh`.
        max_error : float or str, optional
            Of a surface: as for `to_mesh`.

        Returns
        -------
        TriangleMesh
            vertices (N, 3) float64 and faces (M, 3) int64, closed, but that of a sheet, and facing outward.

        Raises
        ------
        OptionError
            When an option is not a whole number, or does not belong to what the file holds.
        SurfaceError
            As for `to_mesh`.

        Examples
        --------
        >>> import cndhf_codec
        >>> vertices, faces = cndhf_codec.load("tests/golden/encoded.cndhf").surface(32)
        >>> vertices.shape[1], faces.shape[1]
        (3, 3)
        """
        if not isinstance(self._shape, DhfRepresentation):
            return self._shape.mesh(Detail(resolution, max_error=max_error, level=level), self.limits)
        if resolution is None or level is not None or max_error is not None:
            return self._shape.mesh(Detail(max_error=max_error, level=level), self.limits)
        return self._shape.whole(whole_number(resolution, "resolution"), self.limits)

    def occupancy(self, resolution: int = DEFAULT_RESOLUTION) -> OccupancyGrid:
        """In/out at the nodes of a regular grid around the solid.

        Parameters
        ----------
        resolution : int
            Cells along the longest side of the solid's box, 8 to 2048; for surfaces, too.

        Returns
        -------
        OccupancyGrid
            grid, bool (nx, ny, nz); origin, float64 (3,); and spacing, a float. grid[i, j, k] tells whether the point
            origin + spacing * (i, j, k), in input coordinates, is inside.

        Raises
        ------
        OptionError
            When the resolution is not a whole number, or out of range.
        SurfaceError
            When the solid is empty, or asks for more than `limits` allow.
        SheetError
            When the file holds a sheet.

        Warns
        -----
        CndhfWarning
            When parts of the solid are thinner than a cell.

        Notes
        -----
        Takes as much memory as `to_mesh` by marching cubes, with 2 bytes per node in place of 250 per vertex.

        Examples
        --------
        >>> import cndhf_codec
        >>> grid, origin, spacing = cndhf_codec.load("tests/golden/encoded.cndhf").occupancy(16)
        >>> grid.shape, round(spacing, 1)
        ((21, 15, 11), 5.2)
        """
        grid, origin, spacing = self._shape.occupancy(resolution, self.limits)
        scale = self.container.scale
        return OccupancyGrid(grid, origin * scale + self._centre, spacing * scale)

    def prefix(self, n_dhfs: int) -> Model:
        """The solid of the first double height fields alone, which contains the whole solid.

        The same as `loads_prefix` makes of the first bytes of the file, with this model's limits.

        Parameters
        ----------
        n_dhfs : int
            How many double height fields, at least 1.

        Returns
        -------
        Model

        Raises
        ------
        OptionError
            When there are not so many, or the file holds a surface.

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> len(model.prefix(1).info["dhfs"])
        1
        """
        self._height_fields("prefix")
        n_dhfs = whole_number(n_dhfs, "n_dhfs")
        if not 1 <= n_dhfs <= len(self.container.dhfs):
            raise OptionError(f"there are no {n_dhfs} DHFs; this model has {len(self.container.dhfs)}")
        first = replace(self.container, dhfs=self.container.dhfs[:n_dhfs], metadata=fmt.Metadata())
        return Model(first, limits=self.limits)

    def show(self, height: int = 480) -> Frame:
        """The viewer with this shape in it, in a notebook (Jupyter, VS Code and the like).

        Parameters
        ----------
        height : int
            Of the frame, in CSS pixels, 100 to 10,000; it is as wide as the cell.

        Returns
        -------
        Frame
            As the last value of a cell, the notebook draws it. Elsewhere it is a line of text: save the model, and run
            `cndhf-view`. It needs no library, nor a connection: the notebook's file keeps the whole viewer, 0.8 MB for
            each frame.

        Raises
        ------
        OptionError
            When the height is not a whole number, or out of range.

        Examples
        --------
        >>> import cndhf_codec
        >>> cndhf_codec.load("tests/golden/encoded.cndhf").show()
        <Viewer of model.cndhf: drawn in notebooks; elsewhere save the model, and run cndhf-view>
        """
        from ..viewer.page import Frame

        height = whole_in(height, "height", 100, 10_000)
        return Frame(self.dumps(), "model.cndhf", height)

    def dumps(self) -> bytes:
        """The bytes of the `.cndhf` file.

        Returns
        -------
        bytes

        Examples
        --------
        >>> import cndhf_codec
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> len(model.dumps())
        747
        """
        return self._bytes

    @cached_property
    def _bytes(self) -> bytes:
        return fmt.dumps(self.container, self._body)

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the `.cndhf` file. When that fails, nothing is left, and an older file stays as it was.

        Parameters
        ----------
        path : str or path-like
            Where to.
        overwrite : bool
            Replace a file that exists.

        Raises
        ------
        OptionError
            When it is not a path.
        OutputError
            When the file cannot be written, or exists and may not be overwritten.

        Examples
        --------
        >>> import cndhf_codec, pathlib, tempfile
        >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     model.save(pathlib.Path(folder) / "bracket.cndhf")
        ...     cndhf_codec.load(pathlib.Path(folder) / "bracket.cndhf").info["bytes"]
        747
        """
        write_atomically(path_like(path), self.dumps(), overwrite)
