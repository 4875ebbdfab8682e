"""Show a comparison as one HTML file: a table, and pictures with the error in colours."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import Any

import numpy as np

from ..arrays import I32
from ..errors import require
from ..mesh.distances import point_distances
from ..mesh.solid import Solid
from .compare import Comparison
from .render import shade, view_frame, visible

VIEWS = ((35.0, 25.0), (215.0, 25.0), (35.0, -50.0))  # azimuth and elevation, degrees
SIZE = 640  # pixels along the side of a picture

STYLE = """body { font: 15px/1.5 sans-serif; margin: 2em auto; max-width: 1400px; padding: 0 1em; color: #222 }
table { border-collapse: collapse; margin: 1em 0 } td, th { padding: .3em 1em; border-bottom: 1px solid #ddd }
td { text-align: right } th { text-align: left; font-weight: 600 } img { width: 100%; margin: .5em 0 }"""


def page(comparison: Comparison, up: str = "y") -> str:
    """Make the whole HTML text, with pictures in it as PNG. Takes half a minute for a large mesh.

    up: the axis that points up in the pictures, y or z. Raises MissingExtraError (the `report` extra).
    """
    c = comparison
    values = c.as_dict()
    a, b = (f"{escape(s.name)} ({s.bytes:,} bytes, {len(s.faces):,} triangles)" for s in (c.a, c.b))
    names = (("mean_error", "mean error (CD)"), ("p99_error", "99th percentile"), ("max_error", "maximum"))
    rows = "".join(
        f"<tr><th>{name}</th><td>{values[key]:.4g}</td><td>{values['percent'][key]:.4f} %</td></tr>"
        for key, name in names
    )
    images = "".join(
        f'<img alt="view {i + 1}" src="data:image/png;base64,{p}">' for i, p in enumerate(_pictures(c, up))
    )
    return f"""<!DOCTYPE html>
<html lang="en"><meta charset="utf-8"><title>{escape(c.a.name)} and {escape(c.b.name)}</title><style>{STYLE}</style>
<h1>{escape(c.a.name)} and {escape(c.b.name)}</h1>
<p>A: {a}<br>B: {b}</p>
<table><tr><th>Distance between the surfaces</th><th>input units</th><th>of A's diagonal ({c.diagonal:.4g})</th></tr>
{rows}</table>
<p>From left to right: A, B, distance of A's surface to B, distance of B's surface to A. Colours end at the 99th
percentile.</p>
{images}
</html>
"""


def _pictures(c: Comparison, up: str) -> list[str]:
    """Draw one PNG per view, in base64."""
    require("matplotlib", "report")
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    centre = (c.a.vertices.min(axis=0) + c.a.vertices.max(axis=0)) / 2
    radius = 1.02 * max(np.linalg.norm(s.vertices - centre, axis=1).max() for s in (c.a, c.b))
    solids = [Solid((s.vertices - centre) / radius, s.faces.copy()) for s in (c.a, c.b)]
    colours = ScalarMappable(Normalize(0, max(c.distances.p99, 1e-12 * c.diagonal), clip=True), "inferno_r")
    out = []
    for azimuth, elevation in VIEWS:
        frame = view_frame(azimuth, elevation, up)
        seen = [visible(solid, frame, SIZE) for solid in solids]
        shaded = [shade(solid, frame, face) for solid, (face, _) in zip(solids, seen, strict=True)]
        errors = []
        for (face, at), picture, other in zip(seen, shaded, (c.b, c.a), strict=True):
            hit = face >= 0
            heat = np.ones_like(picture)
            heat[hit] = colours.to_rgba(point_distances(at[hit] * radius + centre, other.vertices, other.faces))[:, :3]
            # Shape stays visible under the colour.
            errors.append(np.where(hit[:, None], heat * (0.55 + 0.45 * picture.mean(axis=1, keepdims=True)), 1.0))
        figure = Figure(figsize=(15, 4), layout="constrained")
        axes: Any = figure.subplots(1, 4)
        crop = _filled(seen[0][0], seen[1][0])
        for axis, image, title in zip(axes, [*shaded, *errors], ("A", "B", "A to B", "B to A"), strict=True):
            axis.imshow(image.reshape(SIZE, SIZE, 3)[crop])
            axis.set_title(title)
            axis.axis("off")
        figure.colorbar(colours, ax=list(axes), label="distance, input units", shrink=0.8)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=110)
        out.append(base64.b64encode(buffer.getvalue()).decode("ascii"))
    return out


def _filled(*faces: I32) -> tuple[slice, slice]:
    """Find the rows and columns of the pictures that show something, and a few more."""
    hit = np.any([face.reshape(SIZE, SIZE) >= 0 for face in faces], axis=0)
    spans = [np.flatnonzero(hit.any(axis=axis)) for axis in (1, 0)]
    rows, columns = (slice(max(int(s[0]) - 8, 0), int(s[-1]) + 9) if len(s) else slice(None) for s in spans)
    return rows, columns
