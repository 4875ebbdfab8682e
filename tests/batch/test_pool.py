"""Worker processes: what ends one costs one file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from poisoned import poison, write

from cndhf_codec import __version__
from cndhf_codec.batch.jobs import Job, Limits, Result
from cndhf_codec.batch.pool import THREADS, Pool
from cndhf_codec.errors import EncodeError, OptionError

pytestmark = [
    pytest.mark.encode,
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs signals"),
]


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    poison(tmp_path / "custom", monkeypatch)
    return tmp_path / "in"


def results(folder: Path, jobs: int = 1, limits: Limits | None = None, **lines: str) -> dict[str, Result]:
    """What becomes of files with these lines, in this order."""
    write(folder, **lines)
    todo = [Job(name, str(folder / f"{name}.obj"), None, {}, __version__) for name in lines]
    pool = Pool(jobs, limits or Limits())
    try:
        return {r.input: r for r in pool.results(iter(todo)) if r is not None}
    finally:
        pool.close()


def test_faults_of_all_kinds_are_named_and_the_others_are_done(folder):
    found = results(
        folder,
        jobs=2,
        limits=Limits(memory=900_000_000),
        first="fine",
        crash="crash",
        eat="eat",
        bug="bug",
        bad="bad",
        last="fine",
    )
    assert {name: r.outcome for name, r in found.items()} == {
        "first": "done",
        "crash": "crashed",
        "eat": "memory",
        "bug": "failed",
        "bad": "failed",
        "last": "done",
    }
    assert "SIGSEGV" in found["crash"].reason
    assert "over the 0.90 of --memory" in found["eat"].reason
    assert found["bug"].reason == "unexpected KeyError: 'a fault of the program'"
    assert found["bad"].reason == "is bad"  # without the path, which the line begins with
    assert found["last"].data == b"# fine\n" * 2
    assert (found["last"].mean_error, found["last"].warnings) == (0.1, ("rough",))
    assert all(len(r.hash) == 64 for r in found.values())


def test_a_file_that_does_not_end_costs_its_time_only(folder):
    found = results(folder, limits=Limits(timeout=2), a="fine", b="hang", c="fine")
    assert [r.outcome for r in found.values()] == ["done", "timeout", "done"]
    assert found["b"].reason == "took longer than the 2 s of --timeout"
    assert 2 <= found["b"].seconds < 60


def test_what_an_old_worker_does_not_stand_a_new_one_may(folder):
    found = results(folder, a="fine", b="crash-when-old", c="fine")
    assert [r.outcome for r in found.values()] == ["done"] * 3


def test_a_worker_that_is_killed_from_outside_loses_nothing(folder):
    write(folder, a="fine", b="fine 3", c="fine")
    pool = Pool(1, Limits())
    todo = [Job(name, str(folder / f"{name}.obj"), None, {}, __version__) for name in "abc"]
    found = []
    try:
        for result in pool.results(iter(todo)):
            if result is None and len(found) == 1 and pool._workers[0].done == 1:
                os.kill(pool._workers[0].process.pid, signal.SIGKILL)
            elif result is not None:
                found.append(result)
    finally:
        pool.close()
    assert [(r.input, r.outcome) for r in found] == [("a", "done"), ("b", "done"), ("c", "done")]


def test_a_worker_that_cannot_start_is_no_fault_of_the_mesh(folder, tmp_path, monkeypatch):
    (tmp_path / "custom" / "sitecustomize.py").write_text("import sys; sys.modules['threadpoolctl'] = None")
    with pytest.raises(EncodeError, match=r"a worker cannot start: .*threadpoolctl"):
        results(folder, a="fine")


def test_too_little_memory_for_any_work(folder):
    with pytest.raises(OptionError, match="before it has any work"):
        results(folder, limits=Limits(memory=10**7), a="fine")


def test_a_node_with_another_version_says_so(folder):
    write(folder, a="fine")
    pool = Pool(1, Limits())
    try:
        (found,) = [r for r in pool.results(iter([Job("a", str(folder / "a.obj"), None, {}, "9.9")])) if r]
    finally:
        pool.close()
    assert "not 9.9" in found.reason


def test_workers_end_with_their_parent(folder):
    write(folder, a="hang", b="hang")
    code = f"""
import multiprocessing, sys
from cndhf_codec.batch.jobs import Job, Limits
from cndhf_codec.batch.pool import Pool
if __name__ == "__main__":
    pool = Pool(2, Limits())
    jobs = [Job(n, sys.argv[1] + "/" + n + ".obj", None, {{}}, {__version__!r}) for n in "ab"]
    for result in pool.results(iter(jobs)):
        if all(w is not None and w._ready for w in pool._workers):
            print(*(w.process.pid for w in pool._workers), flush=True)
"""
    (folder / "program.py").write_text(code)
    with subprocess.Popen([sys.executable, folder / "program.py", folder], stdout=subprocess.PIPE, text=True) as parent:
        workers = [int(pid) for pid in parent.stdout.readline().split()]
        assert len(workers) == 2
        parent.kill()
    end = time.monotonic() + 20
    while any(alive(pid) for pid in workers) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(alive(pid) for pid in workers)


def alive(pid: int) -> bool:
    import psutil

    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.parametrize("threads", [1, 2])
def test_a_worker_has_the_threads_that_it_may_have(folder, threads):
    from cndhf_codec.decoder.parallel import processors

    found = results(folder, limits=Limits(threads=threads), a="threads")
    assert found["a"].reason == f"{threads} {threads} {min(threads, processors())} {threads}"


def test_the_environment_of_the_parent_is_as_before(folder, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    before = dict(os.environ)
    results(folder, a="fine")
    assert dict(os.environ) == before
    assert "NUMBA_NUM_THREADS" in THREADS
