"""Output is written whole or not at all, and every failure names the file."""

from __future__ import annotations

import os
import pathlib
import re
import signal
import stat
import subprocess
import sys

import pytest

from cndhf_codec import files
from cndhf_codec.errors import InputError, OutputError
from cndhf_codec.files import check_output, read_bytes, write_atomically


def names(folder) -> list[str]:
    return sorted(os.listdir(folder))


def test_write_and_read(tmp_path):
    write_atomically(tmp_path / "a", b"hello", overwrite=False)
    assert read_bytes(tmp_path / "a", 100) == b"hello"
    assert read_bytes(str(tmp_path / "a"), 3) == b"hel"
    assert names(tmp_path) == ["a"]


def test_a_relative_name_goes_to_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_atomically("a", b"hello", overwrite=False)
    assert names(tmp_path) == ["a"]


def test_output_has_the_permissions_of_any_other_new_file(tmp_path):
    write_atomically(tmp_path / "a", b"", overwrite=False)
    (tmp_path / "b").touch()
    modes = [stat.S_IMODE((tmp_path / n).stat().st_mode) for n in "ab"]
    assert modes[0] == modes[1]


def test_an_existing_file_is_kept_unless_told(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"old")
    with pytest.raises(OutputError, match=r"exists already.*overwrite"):
        write_atomically(path, b"new", overwrite=False)
    assert path.read_bytes() == b"old"
    write_atomically(path, b"new", overwrite=True)
    assert path.read_bytes() == b"new"
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_targets_that_cannot_be_written(tmp_path, overwrite):
    with pytest.raises(OutputError, match="folder does not exist"):
        check_output(tmp_path / "no" / "a", overwrite)
    with pytest.raises(OutputError, match="is a folder"):
        check_output(tmp_path, overwrite)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="folder does not exist"):
        check_output(tmp_path / "file" / "a", overwrite)


@pytest.mark.parametrize("call", ["replace", "fsync"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), PermissionError(13, "Permission denied")])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, call, error):
    path = tmp_path / "a"
    path.write_bytes(b"old")

    def fail(*_):
        raise error

    monkeypatch.setattr(files.os, call, fail)
    with pytest.raises(OutputError, match=f"a: cannot be written: {error.strerror}"):
        write_atomically(path, b"new", overwrite=True)
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a"]


def test_an_interrupted_write_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a", b"new", overwrite=False)
    assert names(tmp_path) == []


def test_the_longest_name_can_be_written(tmp_path):
    write_atomically(tmp_path / ("n" * 255), b"hello", overwrite=False)
    assert names(tmp_path) == ["n" * 255]


def test_a_name_too_long_for_the_file_system(tmp_path):
    with pytest.raises(OutputError, match="nnn: "):
        write_atomically(tmp_path / ("n" * 256), b"hello", overwrite=False)
    with pytest.raises(InputError, match="nnn: "):
        read_bytes(tmp_path / ("n" * 256), 100)


def test_a_folder_that_may_not_be_looked_into(tmp_path, monkeypatch):
    def refuse(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(pathlib.Path, "is_dir", refuse)
    with pytest.raises(OutputError, match="Permission denied"):
        check_output(tmp_path / "a", overwrite=False)


def test_a_folder_that_may_not_be_written_to_is_told_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(files.os, "access", lambda path, mode: not (path == tmp_path and mode == os.W_OK))
    for call in (lambda: check_output(tmp_path / "a", True), lambda: write_atomically(tmp_path / "a", b"", True)):
        with pytest.raises(OutputError, match="a: the folder may not be written to"):
            call()
    assert names(tmp_path) == []


@pytest.fixture
def killed(tmp_path):
    """A folder with an old file `a`, and what a process leaves there when it is killed while writing a new one."""
    (tmp_path / "a").write_bytes(b"old")
    code = "import os, sys; from cndhf_codec import files; files.os.fsync = lambda _: os.kill(os.getpid(), 9)"
    code += "; files.write_atomically(sys.argv[1], b'new', True)"
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a")], check=False)
    assert done.returncode == -signal.SIGKILL
    (leftover,) = (tmp_path / n for n in names(tmp_path) if n != "a")
    return tmp_path, leftover


@pytest.mark.skipif(files.fcntl is None, reason="leftovers are removed where files can be locked")
def test_the_next_write_removes_what_a_killed_one_left(killed):
    folder, leftover = killed
    assert re.fullmatch(r"\.[0-9a-f]{16}\.cndhf\.tmp", leftover.name)
    assert (folder / "a").read_bytes() == b"old"
    write_atomically(folder / "b", b"other", overwrite=False)
    assert names(folder) == ["a", "b"]


@pytest.mark.skipif(files.fcntl is None, reason="leftovers are removed where files can be locked")
def test_what_another_process_is_writing_is_left_alone(killed):
    folder, leftover = killed
    (folder / ".0123456789abcdef.cndhf.tmp").touch()  # another process has just made this one
    (folder / ".mine.cndhf.tmp").write_bytes(b"of another name")
    kept = [n for n in names(folder) if n != "a"]
    with open(leftover, "rb") as file:
        files._lock(file.fileno())
        write_atomically(folder / "b", b"other", overwrite=False)
        assert names(folder) == sorted([*kept, "a", "b"])
    write_atomically(folder / "b", b"other", overwrite=True)
    assert leftover.name not in names(folder)


def test_a_file_system_without_locks_is_written_to_all_the_same(tmp_path, monkeypatch):
    def refuse(_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(files, "_lock", refuse)
    (tmp_path / ".0123456789abcdef.cndhf.tmp").write_bytes(b"who knows whose")
    write_atomically(tmp_path / "a", b"new", overwrite=False)
    assert names(tmp_path) == [".0123456789abcdef.cndhf.tmp", "a"]


def test_input_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"gone: cannot be read: No such file"):
        read_bytes(tmp_path / "gone", 100)
    with pytest.raises(InputError, match=r"cannot be read: Is a directory"):
        read_bytes(tmp_path, 100)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_what_is_no_regular_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for call in (lambda: check_output(tmp_path / "pipe", True), lambda: write_atomically(tmp_path / "pipe", b"", True)):
        with pytest.raises(OutputError, match="is no regular file; name another, or - for the standard output"):
            call()
    assert not (tmp_path / "pipe").is_file()
