"""Surfaces and occupancy grids of solids whose volume and extent are known."""

from __future__ import annotations

import math

import analytic
import numpy as np
import pytest
import trimesh
from analytic import ABOUT_X_180, ABOUT_Y_90, ABOUT_Z_45, ridges, ring, slab, waves, wavy
from scipy.spatial import cKDTree
from skimage import measure

from cndhf_codec import load
from cndhf_codec.decoder.dhf import band, isosurface
from cndhf_codec.decoder.dhf.band import DhfBounds
from cndhf_codec.decoder.dhf.marching_cubes import crossed_edges, faces_between, neighbour_bricks
from cndhf_codec.errors import OptionError, SurfaceError

LO, HI = np.array([-0.5, -0.25, -0.125]), np.array([0.25, 0.5, 0.375])


def check_closed(mesh, bodies: int = 1) -> None:
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == bodies
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)


@pytest.mark.parametrize("resolution", [8, 20, 33, 64])
def test_box(resolution):
    mesh = analytic.model(slab(LO, HI)).to_mesh(resolution)
    check_closed(mesh)
    spacing = 0.75 / resolution
    # Faces are exact; only the edges and corners are cut, by less than a cell.
    np.testing.assert_allclose(mesh.bounds, [LO, HI], atol=0.02 * spacing)
    edges = 4 * (HI - LO).sum()
    assert 0 < np.prod(HI - LO) - mesh.volume < edges * spacing**2


@pytest.mark.parametrize("quaternion", [ABOUT_X_180, ABOUT_Y_90, ABOUT_Z_45, (9000, -14000, 20000, 20000)])
def test_turned_box(quaternion):
    m = analytic.model(slab(LO, HI, quaternion))
    mesh = m.to_mesh(64)
    check_closed(mesh)
    uvz = mesh.vertices @ m.container.dhfs[0].rotation.T
    np.testing.assert_allclose([uvz.min(axis=0), uvz.max(axis=0)], [LO, HI], atol=0.75 / 64)
    assert mesh.volume == pytest.approx(np.prod(HI - LO), rel=0.01)


def test_two_slabs_are_an_octagonal_prism():
    a = 0.25
    square, turned = slab((-a, -a, -0.5), (a, a, 0.5)), slab((-a, -a, -0.5), (a, a, 0.5), ABOUT_Z_45)
    mesh = analytic.model(square, turned).to_mesh(96)
    check_closed(mesh)
    assert mesh.volume == pytest.approx(8 * (math.sqrt(2) - 1) * a**2, rel=0.005)
    np.testing.assert_allclose(mesh.extents, [2 * a, 2 * a, 1], atol=0.01)


def test_one_dhf_cuts_a_piece_of_another():
    mesh = analytic.model(slab(LO, HI), slab((-0.125, -1, -1), (1, 0.25, 1))).to_mesh(48)
    check_closed(mesh)
    np.testing.assert_allclose(mesh.bounds, [[-0.125, -0.25, -0.125], [0.25, 0.25, 0.375]], atol=1e-3)


def test_input_coordinates():
    centre, scale = np.array([1e6, -2e6, 3e6]), 400.0
    mesh = analytic.model(slab(LO, HI), centre=tuple(centre), scale=scale).to_mesh(32)
    check_closed(mesh)
    np.testing.assert_allclose(mesh.bounds, np.array([LO, HI]) * scale + centre, atol=0.2)


def test_flat_and_long_solids():
    mesh = analytic.model(slab((-1, -0.0078125, -0.0078125), (1, 0.0078125, 0.0078125))).to_mesh(512)
    check_closed(mesh)
    np.testing.assert_allclose(mesh.extents, [2, 2**-6, 2**-6], atol=1e-4)


def test_a_through_hole_comes_out_of_crossing_heights():
    model = ring()
    mesh = model.to_mesh(64)
    check_closed(mesh)
    assert mesh.euler_number == 0  # a torus
    assert not model.contains([0, 0, 0])


def turned():
    """Three plates at odd angles, two of them mirrored; each reaches beyond the domain of the others."""
    return analytic.model(
        waves(1, fold=1), waves(2, (9000, -14000, 20000, 20000), fold=3), waves(3, ABOUT_Z_45), centre=(5, 6, 7)
    )


@pytest.mark.parametrize("make", [wavy, ring, turned, None], ids=["wavy", "ring", "turned", "encoded"])
def test_the_band_gives_the_mesh_of_the_whole_grid(monkeypatch, make, golden):
    model = load(golden / "encoded.cndhf") if make is None else make()
    mesh, occupied = model.to_mesh(60), model.occupancy(60)[0]
    looked_at = []
    original = band.dhf_bounds

    def unbounded(dhf, bounds, centres, half):
        looked_at.append(len(centres))
        terms, lower, upper = original(dhf, bounds, centres, half)
        return DhfBounds(np.full_like(terms, -np.inf), np.full_like(lower, -np.inf), np.full_like(upper, np.inf))

    monkeypatch.setattr(band, "dhf_bounds", unbounded)
    dense = model.to_mesh(60)
    assert np.array_equal(mesh.vertices, dense.vertices)
    assert np.array_equal(mesh.faces, dense.faces)
    assert np.array_equal(occupied, model.occupancy(60)[0])


def test_height_tables_are_made_once_for_surfaces_of_one_resolution(monkeypatch):
    made = []
    original = isosurface.make_grid
    monkeypatch.setattr(isosurface, "make_grid", lambda *a: made.append(a[1]) or original(*a))
    model = wavy()
    assert made == []
    for _ in range(2):
        model.to_mesh(20)
        model.occupancy(20)
    assert made == [20]
    model.to_mesh(24)
    model.to_mesh(20)
    assert made == [20, 24, 20]


def test_the_band_grows_with_the_surface():
    bricks = []
    for resolution in (64, 128, 256):
        grid, tables = isosurface.make_grid(wavy()._shape.solid.dhfs, resolution)
        bricks.append(len(band.narrow_band(grid, wavy()._shape.solid.dhfs, tables).values))
    assert bricks[1] < 5 * bricks[0]
    assert bricks[2] < 5 * bricks[1]
    assert bricks[2] * 64 < 0.15 * np.prod(grid.shape)


def test_marching_cubes_agrees_with_scikit_image():
    dhfs = wavy()._shape.solid.dhfs
    grid, tables = isosurface.make_grid(dhfs, 50)
    nodes = grid.origin + grid.spacing * np.stack(np.indices(grid.shape), axis=-1)
    points = nodes.reshape(-1, 3).astype(np.float32)
    f = np.minimum.reduce([d.implicit(points, t) for d, t in zip(dhfs, tables, strict=True)]).reshape(grid.shape)
    vertices, faces, *_ = measure.marching_cubes(f, level=0.0, gradient_direction="ascent")
    theirs = trimesh.Trimesh(vertices * grid.spacing + grid.origin, faces, process=False)
    ours = wavy().to_mesh(50)
    # A vertex for each edge of the grid that changes sign, however the cells are triangulated.
    inside = f >= 0
    assert len(ours.vertices) == sum(np.count_nonzero(np.diff(inside, axis=k)) for k in range(3))
    assert ours.euler_number == theirs.euler_number
    assert ours.volume == pytest.approx(theirs.volume, rel=2e-3)
    distance = cKDTree(theirs.vertices).query(ours.vertices)[0]
    assert np.percentile(distance, 95) < 0.2 * grid.spacing


def test_any_signs_give_a_closed_surface():
    # Noise: all cases of a cell come up, next to one another.
    n = 24
    rng = np.random.default_rng(0)
    shape = (n // band.BLOCK_SIDE + 1,) * 3
    blocks = np.full([k + 1 for k in shape], band.OUTSIDE_ROW, np.int32)
    blocks[:-1, :-1, :-1] = np.arange(2, 2 + np.prod(shape)).reshape(shape)
    bricks = np.concatenate([np.full((2, 64), [[0], [1]]), np.arange(2, 2 + 64 * np.prod(shape)).reshape(-1, 64)])
    corners = np.argwhere(np.ones(shape))[:, None] * band.BLOCK_SIDE + band.NODE_OFFSETS * band.BRICK_SIDE
    corners = corners.reshape(-1, 3)
    values = rng.choice([-1, 1], (2 + len(corners), 64)).astype(np.float32)
    nodes = corners[:, None] + band.NODE_OFFSETS
    border = np.any((nodes == 0) | (nodes >= n - 1), axis=-1)
    values[2:][border] = -1
    values[band.OUTSIDE_ROW] = -1
    corners = np.concatenate([np.zeros((2, 3)), corners]).astype(np.int32)
    nobody = np.full(values.shape, band.NO_DHF, dtype=np.uint8)
    noise = band.Band(band.Grid(np.zeros(3), 1.0, (n, n, n)), corners, values, nobody, blocks, bricks.astype(np.int32))
    edges = crossed_edges(noise, neighbour_bricks(noise))
    ends, axis, faces = edges.ends, edges.axis, faces_between(noise, edges)
    assert len(np.unique(ends[:, 0].astype(np.int64) * 3 + axis)) == len(ends)
    signs = values.ravel()[ends]
    assert np.all(signs[:, 0] * signs[:, 1] < 0)
    row, node = np.divmod(ends, 64)
    first, last = np.moveaxis(corners[row] + band.NODE_OFFSETS[node], 1, 0)
    assert np.array_equal(last - first, np.eye(3, dtype=int)[axis])
    vertices = first + 0.5 * np.eye(3)[axis]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    # Signs are as often one as the other, and so is the space.
    assert mesh.volume == pytest.approx((n - 2) ** 3 / 2, rel=0.2)
    assert noise.dense().sum() == (values[2:] > 0).sum()


def test_vertices_lie_on_the_surface():
    m = wavy()
    mesh = m.to_mesh(40)
    spacing = mesh.extents.max() / 40
    f = np.abs(m.implicit(mesh.vertices)) / spacing
    # Across a crease f has a kink, and a few steps of root finding do not end on it.
    assert np.percentile(f, 90) < 2e-3
    assert np.percentile(f, 99) < 0.05
    # Half a spacing along the normal is inside or outside.
    shift = 0.5 * spacing * mesh.vertex_normals
    assert m.contains(mesh.vertices - shift).mean() > 0.98
    assert m.contains(mesh.vertices + shift).mean() < 0.02


@pytest.mark.parametrize("quaternion", [analytic.NO_TURN, ABOUT_Z_45, (9000, -14000, 20000, 20000)])
def test_steep_walls_stand_where_they_are(monkeypatch, quaternion):
    def off_the_surface() -> float:
        """Share of vertices around which, at 1/16 of a spacing, all points are inside or all are outside."""
        m = ridges(quaternion)
        mesh = m.to_mesh(50)
        assert mesh.is_watertight
        around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3) / 50 / 16
        inside = m.contains(mesh.vertices[:, None] + around)
        return 1 - (inside.any(axis=1) & ~inside.all(axis=1)).mean()

    share = off_the_surface()
    monkeypatch.setattr(isosurface, "refine_steep_nodes", lambda band, dhfs, ends: False)
    assert share < 0.5 * off_the_surface()


def test_finer_grids_converge_to_one_volume():
    volumes = [ring().to_mesh(r).volume for r in (24, 48, 96)]
    assert abs(volumes[2] - volumes[1]) < abs(volumes[1] - volumes[0]) / 2


def test_occupancy_agrees_with_contains():
    m = analytic.model(analytic.waves(7), analytic.waves(8, ABOUT_Y_90), centre=(10, 20, 30), scale=5)
    grid, origin, spacing = m.occupancy(40)
    assert grid.dtype == bool
    nodes = origin + spacing * np.stack(np.indices(grid.shape), axis=-1)
    f = m.implicit(nodes)
    clear = np.abs(f) > 1e-4 * spacing  # nearer than that float32 may differ
    assert np.array_equal(grid[clear], f[clear] >= 0)
    # The grid holds the whole solid, with `resolution` cells along its longest side.
    assert not any(grid.take(k, axis).any() for axis in range(3) for k in (0, -1))
    assert m.to_mesh(40).extents.max() == pytest.approx(40 * spacing, rel=0.1)


def test_occupancy_of_a_box_has_its_place_and_volume():
    grid, origin, spacing = analytic.model(slab(LO, HI), centre=(7, 8, 9), scale=2).occupancy(60)
    inside = origin + spacing * np.argwhere(grid)
    # A node represents the cell around it.
    np.testing.assert_allclose(inside.min(axis=0), LO * 2 + [7, 8, 9], atol=spacing)
    np.testing.assert_allclose(inside.max(axis=0), HI * 2 + [7, 8, 9], atol=spacing)
    assert spacing == pytest.approx(1.5 / 60, rel=0.05)
    assert grid.sum() * spacing**3 == pytest.approx(np.prod(2 * (HI - LO)), rel=0.1)


@pytest.mark.parametrize("resolution", [-1, 0, 7, 2049])
def test_resolution_limits(resolution):
    m = analytic.model(slab(LO, HI))
    with pytest.raises(OptionError, match=f"resolution is {resolution}"):
        m.to_mesh(resolution)
    with pytest.raises(OptionError, match=f"resolution is {resolution}"):
        m.occupancy(resolution)


@pytest.mark.parametrize(
    "dhfs",
    [
        [slab((-0.5, -0.5, 0.25), (0.5, 0.5, -0.25))],  # far below near everywhere
        [slab((-1, -1, -1), (-0.5, 1, 1)), slab((0.5, -1, -1), (1, 1, 1))],
    ],
    ids=["crossed", "apart"],
)
def test_empty_solids(dhfs):
    m = analytic.model(*dhfs)
    assert not m.contains(np.random.default_rng(0).uniform(-1, 1, (1000, 3))).any()
    with pytest.raises(SurfaceError, match="empty"):
        m.to_mesh(32)


def test_a_speck_in_a_large_domain_does_not_ask_for_a_huge_table():
    # The boxes overlap in a cube of 1/512 at one corner each. Tables as fine as the grid would have 10^8 nodes.
    tiny = 2**-9
    a, b = slab((-1, -1, -1), (0, 0, 0)), slab((-tiny, -tiny, -tiny), (1, 1, 1))
    m = analytic.model(a, b)
    nodes = []
    original = isosurface.HeightTable.__init__

    def counted(self, dhf, spacing):
        size = (dhf.bounds[:2, 1] - dhf.bounds[:2, 0]) / spacing
        assert np.prod(size) < 10**7, "a height table of that size would not fit into memory"
        nodes.append(np.prod(size))
        original(self, dhf, spacing)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(isosurface.HeightTable, "__init__", counted)
        m.to_mesh(64)
    assert nodes
