"""Encode many files, from Python."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import PurePosixPath
from typing import Any

from .. import __version__
from ..arguments import whole_in
from ..errors import MeshError, OptionError
from . import remote
from .discovery import output_names
from .jobs import Job, Limits, Result, Runner


def encode_many(
    paths: Iterable[str | os.PathLike[str]],
    folder: str | os.PathLike[str] | None = None,
    *,
    jobs: int | None = None,
    limits: Limits | None = None,
    ray: str | None = None,
    **options: Any,
) -> Iterator[Result]:
    """Encode many mesh files, each in a worker process, and tell what became of each as it ends.

    A mesh that fails, crashes its process or exceeds a limit is a result with the reason, and stops nothing. A program
    that calls this has to keep its own work under ``if __name__ == "__main__":``, since the workers import it.

    Parameters
    ----------
    paths : iterable of str or path
        Mesh files, or URLs that fsspec opens.
    folder : str or path, optional
        Where NAME.cndhf is written for each NAME.ply, replacing what is there; inputs of one name keep their extension,
        as NAME.ply.cndhf. A path or URL. By default nothing is written, and the results have the bytes.
    jobs : int, optional
        Files at a time, by default as many as processors. With `ray`, by default twice as many as the cluster has.
    limits : Limits, optional
        Threads (by default 1), bytes of memory and seconds of each file.
    ray : str, optional
        "local", or the address of a Ray cluster.
    **options
        Those of `cndhf_codec.encode`, but for `threads`, `time_limit` and `progress`.

    Returns
    -------
    iterator of Result
        In the order in which they end.

    Raises
    ------
    OptionError
        An option is of a wrong type or out of range.
    EncodeError
        A worker cannot start.
    MissingExtraError
        The `encode` extra is not installed, or with `ray` or URLs the `cluster` extra.

    Examples
    --------
    >>> from cndhf_codec.batch import encode_many
    >>> for result in encode_many(["examples/bracket.ply"], jobs=1, preset="fast", target_size="1KiB"):
    ...     print(result.input, result.outcome, len(result.data) <= 1024)
    examples/bracket.ply done True
    """
    check_options(options)
    sources = [os.fspath(path) for path in paths]
    targets = _targets(sources, os.fspath(folder)) if folder is not None else {}
    work = [Job(source, source, targets.get(source), options, __version__) for source in sources]
    return _results(work, runner_for(jobs, limits or Limits(), ray))


def _results(work: list[Job], runner: Runner) -> Iterator[Result]:
    try:
        for result in runner.results(iter(work)):
            if result is not None:
                yield result
    finally:
        runner.close()


def _targets(sources: list[str], folder: str) -> dict[str, str]:
    """The output of each input. Raises OptionError where two inputs would have the same."""
    names = {source: PurePosixPath(source.partition("::")[0].replace(os.sep, "/")).name for source in sources}
    if len(set(names.values())) < len(sources):
        raise OptionError("two of the paths have the same name, and would have the same output; give each a folder")
    outputs = output_names(list(names.values()))
    return {source: remote.join(folder, outputs[name]) for source, name in names.items()}


def check_options(options: dict[str, Any]) -> None:
    """Raise OptionError or MissingExtraError for what every file would be refused for."""
    from ..encoder.pipeline import encode

    for name in ("threads", "time_limit", "progress"):
        if name in options:
            raise OptionError(f"{name} is not an option of a batch; see Limits")
    with suppress(MeshError):
        encode(None, **options)  # which looks at its options, and for its libraries, before it looks at the mesh


def runner_for(jobs: int | None, limits: Limits, ray: str | None) -> Runner:
    """Workers on this machine, or on a Ray cluster. Raises OptionError, MissingExtraError."""
    if jobs is not None:
        jobs = whole_in(jobs, "jobs", 1)
    whole_in(limits.threads, "threads", 1)
    if ray is not None:
        from .on_ray import OnRay

        return OnRay(ray, jobs, limits)
    from ..decoder.parallel import processors
    from .pool import Pool

    return Pool(max(processors() // limits.threads, 1) if jobs is None else jobs, limits)
