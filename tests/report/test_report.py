"""Comparisons of shapes whose distance is known, and the page made of one."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
import trimesh

from cndhf_codec.report import page as page_module
from cndhf_codec.report.compare import compare, read_shape
from cndhf_codec.report.render import view_frame, visible


@pytest.fixture
def pair(tmp_path):
    for name, radius in (("a", 1.0), ("b", 1.05)):
        trimesh.creation.icosphere(4, radius).export(tmp_path / f"{name}.ply")
    return tmp_path / "a.ply", tmp_path / "b.ply"


def test_two_spheres(pair):
    values = compare(*(read_shape(p, 32) for p in pair)).as_dict()
    assert values["diagonal"] == pytest.approx(2 * 3**0.5, rel=1e-3)
    for key in ("mean_error", "p99_error", "max_error"):
        assert values[key] == pytest.approx(0.05, rel=0.03)
        assert values["percent"][key] == pytest.approx(100 * values[key] / values["diagonal"])
    assert values["a"] == {"name": "a.ply", "bytes": pair[0].stat().st_size, "vertices": 2562, "faces": 5120}


def test_a_cndhf_file_is_its_surface(golden):
    shape = read_shape(golden / "encoded.cndhf", 24)
    assert shape.bytes == (golden / "encoded.cndhf").stat().st_size
    assert compare(shape, shape).distances.maximum < 1e-6


def test_what_a_pixel_sees():
    from cndhf_codec.mesh.solid import Solid

    ball = trimesh.creation.icosphere(4, 0.8)
    frame = view_frame(30, 20)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    face, at = visible(Solid(np.asarray(ball.vertices), np.asarray(ball.faces)), frame, 64)
    hit = face >= 0
    assert hit.mean() == pytest.approx(np.pi * 0.4**2, rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(at[hit], axis=1), 0.8, rtol=0.01)
    assert (at[hit] @ frame[2] > -0.01).all()


@pytest.mark.encode
def test_the_page_stands_alone(pair, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(page_module, "SIZE", 96)
    shapes = [read_shape(p, 32) for p in pair]
    shapes[0] = type(shapes[0])(shapes[0].vertices, shapes[0].faces, "<script>a.ply", shapes[0].bytes)
    html = page_module.page(compare(*shapes))
    assert "<script" not in html
    assert "http" not in html
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    assert len(pictures) == len(page_module.VIEWS)
    from PIL import Image

    for data in pictures:
        image = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))
        assert image.shape[1] > 1000
        assert (image != 255).any(axis=2).mean() > 0.1
