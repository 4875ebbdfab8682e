"""Coverage-guided fuzzing of the reader with atheris: see README.md beside this file.

A finding is any exception but a FormatError, any warning, more than 64 MB of memory, more than 100 ms for a file under
64 KB (256 MB and 5 s for one with a surface), or a file that is accepted and does not survive being written
and read again.
"""

from __future__ import annotations

from pathlib import Path

import atheris

with atheris.instrument_imports(include=["cndhf_codec.format", "cndhf_codec.decoder.model"]):
    from cndhf_codec import format as fmt
    from cndhf_codec.decoder.model import Model
    from cndhf_codec.errors import FormatError

import measure
import mutate
import numpy as np
from watch import FindingError, Watch, digest, run

VECTORS = Path(__file__).parent.parent.parent / "spec" / "vectors"
VALID = [p.read_bytes() for pattern in ("*.cndhf", "accepted/*.cndhf") for p in sorted(VECTORS.glob(pattern))]
SEEDS = [*VALID, *(p.read_bytes() for p in sorted(VECTORS.glob("refused/*.cndhf")))]


FIELDS, SURFACES = Watch(measure.SUBJECTS["cndhf"], slowest=0.02), Watch(measure.SUBJECTS["surfaces"], slowest=1.0)


def one_input(data: bytes) -> None:
    parts = mutate.Parts(data)
    watch = SURFACES if parts.section(mutate.SURFACE) else FIELDS
    watch.begin()
    try:
        model = Model(fmt.loads(data))
    except FormatError as exc:
        watch.end(False, data)
        if "\n" in str(exc):
            raise FindingError("a message of several lines") from exc
        return
    watch.end(True, data)
    use(model, data)


def use(model: Model, data: bytes) -> None:
    """A file that is accepted answers queries, and what is written of it is the same file."""
    if model.container.surface is not None:
        if len(model.container.surface.faces) < 1000:
            data = fmt.dumps(model.container)
            if fmt.dumps(fmt.loads(data)) != data:
                raise FindingError("written and read again it is another surface")
        return
    if model.info["parameters"] > 20_000:
        return
    if not np.isfinite(model.heights(0, [[0, 0], [1e30, -1e30]])).all():
        raise FindingError("a height that is not finite")
    if not np.isfinite(model.implicit([model.container.centre])).all():
        raise FindingError("an implicit function that is not finite")
    if digest(data)[0] == "0":  # one in sixteen: written with the slowest zstd level
        again = fmt.loads(fmt.dumps(model.container))
        same = [np.array_equal(a, b) for p, q in zip(model.container.dhfs, again.dhfs, strict=True)
                for a, b in zip(p.symbols, q.symbols, strict=True)]  # fmt: skip
        if not all(same) or repr(again.metadata) != repr(model.container.metadata):
            raise FindingError("written and read again it is another file")


def custom_mutator(data: bytes, most: int, seed: int) -> bytes:
    return mutate.mutate(data, most, seed, lambda part, n: atheris.Mutate(part, min(n, most)), VALID)


if __name__ == "__main__":
    run(SEEDS, one_input, custom_mutator)
