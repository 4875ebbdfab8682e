"""A build step for game assets: meshes -> .cndhf to keep or ship -> GLB levels of detail for the engine.

    python examples/game_assets.py MESHES KEPT BUILT [--preset fast] [--lods 3]

MESHES holds .obj, .ply, .stl, .off or .glb; KEPT gets a .cndhf each, made again only when its mesh is newer; BUILT gets
NAME.lod0.glb, NAME.lod1.glb, ... with the surface's normals, each with a quarter of the triangles of the one before.
The first has as many as the file's own error needs, but no more than FINEST.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cndhf_codec
from cndhf_codec.decoder.meshfile import write_mesh

EXTENSIONS = (".obj", ".ply", ".stl", ".off", ".glb")
FINEST = 20_000  # triangles of the first level, at most
LEAST = 50  # of any level


def levels_of_detail(model: cndhf_codec.Model, count: int) -> list[Any]:
    """The meshes of all levels, the finest first, for files of either representation."""
    finest = model.to_mesh(normals=True)
    own = 0 if model.representation == "dhf" else model.info["faces"]  # a surface has no fewer
    out = []
    for k in range(count):
        wanted = max(min(len(finest.faces), FINEST) // 4**k, LEAST, own)
        out.append(finest if wanted >= len(finest.faces) else model.to_mesh(faces=wanted, normals=True))
    return out


def build(meshes: Path, kept: Path, built: Path, preset: str = "default", lods: int = 3) -> list[str]:
    """One line for each mesh that could not be stored: an asset that fails must not stop the others."""
    kept.mkdir(exist_ok=True)
    built.mkdir(exist_ok=True)
    failures = []
    names: dict[str, str] = {}
    for source in sorted(p for p in meshes.iterdir() if p.suffix.lower() in EXTENSIONS):
        if names.setdefault(source.stem, source.name) != source.name:
            failures.append(f"{source.name}: has the name of {names[source.stem]}; rename one of them")
            continue
        stored = kept / f"{source.stem}.cndhf"
        try:
            if not stored.exists() or stored.stat().st_mtime < source.stat().st_mtime:
                cndhf_codec.encode(source, preset=preset).save(stored, overwrite=True)
            model = cndhf_codec.load(stored)
            for level, mesh in enumerate(levels_of_detail(model, lods)):
                write_mesh(mesh, built / f"{source.stem}.lod{level}.glb", overwrite=True, with_normals=True)
        except cndhf_codec.CndhfError as exc:
            failures.append(f"{source.name}: {exc}")
    return failures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("meshes", "kept", "built"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--preset", default="default")
    parser.add_argument("--lods", type=int, default=3)
    failures = build(**vars(parser.parse_args()))
    for line in failures:
        print(line)
    raise SystemExit(1 if failures else 0)


if __name__ == "__main__":
    main()
