"""Workers of cndhf-batch that do what a mesh file's first line says, such as to crash.

No mesh is known that ends the encoder's process, so the workers, fresh interpreters, are given an encoder that
does. Other files are encoded as ever.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from places import ROOT

CUSTOM = """
import sys

if any("spawn_main" in word for word in sys.orig_argv):  # a worker
    import os, signal, time
    from pathlib import Path
    from types import SimpleNamespace
    from cndhf_codec import CndhfError
    from cndhf_codec.encoder import pipeline
    from cndhf_codec.mesh.distances import Distances

    real, calls = pipeline.encode, []

    def encode(source, **options):
        calls.append(source)
        words = Path(source).read_bytes()[:80].decode("utf-8", "replace").split("\\n")[0].split()
        if words[:1] != ["#"]:
            return real(source, **options)
        verb, *rest = words[1:]
        if verb == "crash" or (verb == "crash-when-old" and len(calls) > 1):
            os.kill(os.getpid(), signal.SIGSEGV)
        if verb == "eat":
            kept = [bytearray(b"x") * 10**8 for _ in range(30) if not time.sleep(0.02)]
        if verb == "hang":
            time.sleep(600)
        if verb == "bug":
            raise KeyError("a fault of the program")
        if verb == "threads":
            from cndhf_codec.decoder.parallel import processors
            import numba
            found = [os.environ["OMP_NUM_THREADS"], numba.get_num_threads(), processors(), options["threads"]]
            raise CndhfError(" ".join(map(str, found)))
        if verb == "bad":
            raise CndhfError(f"{source}: is bad")
        time.sleep(float(rest[0]) if rest else 0)
        report = SimpleNamespace(
            distances=Distances(0.1, 0.2, 0.3), diagonal=10.0, representation="surface", warnings=["rough"]
        )
        return SimpleNamespace(report=report, dumps=lambda: Path(source).read_bytes() * 2)

    pipeline.encode = encode
"""


def poison(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on workers read the first lines of their files."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(CUSTOM)
    paths = [str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(p for p in paths if p))


def write(folder: Path, **lines: str) -> None:
    """Write NAME.obj for each NAME, with the line that says what a worker does with it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, line in lines.items():
        (folder / f"{name}.obj").write_text(f"# {line}\n")
        os.utime(folder / f"{name}.obj", (1e9, 1e9))  # old: its time can be trusted
