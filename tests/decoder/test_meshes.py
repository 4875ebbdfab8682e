"""Which mesh a file of double height fields gives: by default, for an error, for a number of triangles."""

from __future__ import annotations

from dataclasses import replace

import analytic
import numpy as np
import pytest
import trimesh
from analytic import ABOUT_X_180, slab, wavy

from cndhf_codec import Model, OptionError
from cndhf_codec.decoder.pieces import piece_labels, pieces_of, without_specks
from cndhf_codec.decoder.results import TriangleMesh


def measured(model: Model, mean: float, p99: float | None = None) -> Model:
    """The same file with a measured error, in input units."""
    errors = replace(model.container.metadata, mean_error=mean, p99_error=p99 or 5 * mean, max_error=20 * mean)
    return Model(replace(model.container, metadata=errors))


def distances(model: Model, mesh: trimesh.Trimesh) -> np.ndarray:
    return model.nearest(trimesh.sample.sample_surface(mesh, 5000, seed=0)[0]).distance


def test_triangles_follow_from_the_error_of_the_file():
    exact = wavy()
    counts = []
    for error in (0.01, 0.002, 0.0004):
        mesh = measured(wavy(), error).to_mesh()
        assert mesh.is_watertight
        assert distances(exact, mesh).mean() < error / 2
        counts.append(len(mesh.faces))
    assert 2 * counts[0] < counts[1] < counts[2] / 2
    assert counts[2] < len(exact.to_mesh().faces) / 10


def test_a_file_without_an_error_is_not_simplified():
    for model in (wavy(), measured(wavy(), 0.0)):
        assert len(model.to_mesh().faces) == len(wavy().to_mesh(256).faces)


def test_an_error_that_no_file_has_does_no_harm():
    mesh = measured(wavy(), 1e30).to_mesh()
    assert mesh.volume == pytest.approx(wavy().to_mesh(64).volume, rel=0.1)


@pytest.mark.parametrize("options", [{}, {"resolution": 64}, {"method": "marching-cubes"}, {"method": "intersection"}])
@pytest.mark.parametrize("model", [wavy(), measured(wavy(), 0.002)], ids=["plain", "measured"])
def test_a_number_of_faces_for_every_method(options, model):
    mesh = model.to_mesh(faces=800, **options)
    assert len(mesh.faces) == 800
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(wavy().to_mesh(100).volume, rel=0.01)


@pytest.mark.parametrize("options", [{}, {"method": "marching-cubes"}, {"method": "intersection"}])
def test_an_error_asked_for_is_kept(options):
    exact, counts = wavy(), []
    for error in (8e-3, 2e-3):
        mesh = measured(wavy(), 0.001).to_mesh(max_error=error, **options)
        assert np.quantile(distances(exact, mesh), 0.99) < error
        assert mesh.is_watertight
        counts.append(len(mesh.faces))
    assert 1.5 * counts[0] < counts[1]


def test_files_of_noise_are_not_simplified(monkeypatch):
    from cndhf_codec.decoder.dhf import meshes

    model = measured(wavy(), 0.01)
    monkeypatch.setattr(meshes, "MOST_FACES", 1000)
    assert len(model.to_mesh().faces) == len(wavy().to_mesh(128).faces)


def test_a_resolution_alone_is_not_simplified():
    mesh = measured(wavy(), 0.002).to_mesh(48)
    assert np.array_equal(mesh.faces, wavy().to_mesh(48).faces)


def test_too_few_faces_say_how_many_are_enough():
    with pytest.raises(OptionError, match=r"faces is 4: too few for this shape; \d+ are enough"):
        analytic.ring().to_mesh(64, faces=4)


def boxes(*sizes: tuple[float, float, float]) -> TriangleMesh:
    parts = []
    for k, size in enumerate(sizes):
        part = trimesh.creation.box(size)
        part.vertices += [3 * k, 0, 0]
        parts.append(part)
    whole = trimesh.util.concatenate(parts)
    return TriangleMesh(np.asarray(whole.vertices), np.asarray(whole.faces, dtype=np.int64))


def test_pieces_and_their_thickness():
    mesh = boxes((1, 1, 1), (2, 2, 0.01))
    found = pieces_of(mesh)
    assert list(np.bincount(found.label)) == [12, 12]
    np.testing.assert_allclose(found.length, [np.sqrt(3), np.sqrt(8.0001)])
    np.testing.assert_allclose(found.thickness, [1 / 3, 0.01], rtol=0.02)
    assert len(piece_labels(np.zeros((0, 3), dtype=np.int64), 0)) == 0


def test_specks_are_thin_and_short():
    kept = boxes((1, 1, 1), (0.1, 0.1, 0.1), (1, 1, 0.001))  # thick, and long
    assert without_specks(kept, 0.01) is kept
    out = without_specks(boxes((1, 1, 1), (0.1, 0.1, 0.001), (0.5, 0.5, 0.5)), 0.01)
    assert (len(out.vertices), len(out.faces)) == (16, 24)


def speckled() -> Model:
    """A slab, and a flake beside it that two fields leave."""
    a = slab((-0.6, -0.5, -0.2), (0.6, 0.5, 0.2))
    return analytic.model(a, slab((-0.6, -0.5, -0.2), (0.6, 0.5, 0.2), ABOUT_X_180))


def test_specks_are_left_out_unless_they_are_asked_for(monkeypatch):
    from cndhf_codec.decoder.dhf import isosurface

    original = isosurface.isosurface

    def with_a_speck(*arguments):
        whole = original(*arguments)
        box = trimesh.creation.box((0.01, 0.01, 0.002))
        return TriangleMesh(
            np.concatenate([whole.vertices, box.vertices + np.array([0, 0, 0.9])]),
            np.concatenate([whole.faces, box.faces + len(whole.vertices)]),
        )

    monkeypatch.setattr(isosurface, "isosurface", with_a_speck)
    model = measured(speckled(), 0.001)
    for options in ({}, {"resolution": 64}, {"faces": 200}):
        assert model.to_mesh(**options).body_count == 1
        assert model.to_mesh(specks=True, **options).body_count == 2
    assert pieces_of(model.surface(64)).label.max() == 0
    assert model.nearest([0, 0, 0.9]).distance == pytest.approx(0.7, abs=0.01)
    assert speckled().to_mesh(64).body_count == 2  # without a measured error nothing is left out


def test_surfaces_have_no_specks():
    import surfaces

    with pytest.raises(OptionError, match="specks"):
        surfaces.cube().to_mesh(specks=True)
