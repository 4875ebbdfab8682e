"""Remove tiny parts far away from the rest, which would cost the rest its detail."""

from __future__ import annotations

import numpy as np

from .connectivity import component_boxes, face_components
from .read import Mesh, checked
from .sampling import face_areas
from .wording import counted, percent

# Evidence for these constants: ADR 003.
#
# Tiny parts have at most this share of the surface, all together: less than any error of a file.
TINY_SHARE = 0.001
LARGEST_FRAME = 2.0  # times the size of the rest; a frame twice as large leaves half of the detail


def without_outliers(mesh: Mesh) -> tuple[Mesh, list[str]]:
    """Remove tiny parts far away; return the mesh and a line that names them.

    The frame reaches to the farthest vertex, and the detail of a file is relative to it. Tiny parts that make the frame
    LARGEST_FRAME times as large make everything else that much coarser.
    """
    component = face_components(mesh.faces, len(mesh.vertices))
    count = int(component.max()) + 1
    if count == 1:
        return mesh, []
    lo, hi = component_boxes(mesh.vertices, mesh.faces, component)
    areas = np.bincount(component, weights=face_areas(mesh.vertices, mesh.faces), minlength=count)
    by_area = np.argsort(areas, kind="stable")
    tiny = np.zeros(count, dtype=bool)
    tiny[by_area[np.cumsum(areas[by_area]) <= TINY_SHARE * areas.sum()]] = True
    # Keep what is not tiny, and tiny parts around it that widen its box to no more than LARGEST_FRAME times its size.
    low, high = lo[~tiny].min(axis=0), hi[~tiny].max(axis=0)
    middle, reach = low / 2 + high / 2, LARGEST_FRAME * float(np.linalg.norm(high - low)) / 2
    away = tiny & (np.linalg.norm(np.maximum(hi - middle, middle - lo), axis=1) > reach)
    if not away.any():
        return mesh, []
    faces = away[component]
    at = (lo[away] / 2 + hi[away] / 2)[0]
    where = f"at about ({at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g})" + (" and elsewhere" if away.sum() > 1 else "")
    kept = checked(mesh.vertices, mesh.faces[~faces], mesh.name)
    return kept, [
        f"{counted(int(away.sum()), 'tiny part')} far away ({counted(int(faces.sum()), 'face')}, "
        f"{percent(areas[away].sum() / areas.sum())} of the surface, {where}) left out, of the errors too: to reach so "
        "far would cost everything else its detail"
    ]
