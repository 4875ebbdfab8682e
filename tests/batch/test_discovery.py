"""Which files below a folder are taken, and how their outputs are named."""

from __future__ import annotations

import os
import time

import pytest

from cndhf_codec.batch.discovery import find, output_names
from cndhf_codec.errors import InputError


def put(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")


def names(listing):
    return [found.name for found in listing.files]


def test_meshes_are_found_in_all_folders_in_order(tmp_path):
    put(
        tmp_path,
        "b.obj",
        "a.PLY",
        "sub/deep/c.stl.gz",
        "sub/d.gltf",
        "notes.txt",
        "e.cndhf",
        "f.gz",
        ".g.obj",
        ".h/i.obj",
    )
    os.symlink(tmp_path, tmp_path / "sub" / "loop")
    os.symlink(tmp_path / "b.obj", tmp_path / "sub" / "link.obj")
    listing = find(str(tmp_path))
    assert names(listing) == ["a.PLY", "b.obj", "sub/d.gltf", "sub/deep/c.stl.gz", "sub/link.obj"]
    assert [f.output for f in listing.files][-2:] == ["sub/deep/c.cndhf", "sub/link.cndhf"]
    assert listing.refused == []


def test_patterns_match_names_or_paths(tmp_path):
    put(tmp_path, "a.obj", "cars/a.obj", "cars/b.ply", "cars/c.txt")
    assert names(find(str(tmp_path), ["*.obj"])) == ["a.obj", "cars/a.obj"]
    assert names(find(str(tmp_path), ["cars/*"])) == ["cars/a.obj", "cars/b.ply"]
    assert names(find(str(tmp_path), ["b*", "a.obj"])) == ["a.obj", "cars/a.obj", "cars/b.ply"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_what_is_no_file_is_named(tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    os.mkfifo(tmp_path / "other")
    os.symlink("/dev/zero", tmp_path / "zero.stl")
    os.symlink("gone", tmp_path / "link.obj")
    assert find(str(tmp_path)).refused == [
        ("link.obj", "cannot be read: No such file or directory"),
        ("pipe.ply", "is a pipe, which is not read"),
        ("zero.stl", "is a device, which is not read"),
    ]


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_a_name_that_is_no_text_is_named(tmp_path):
    with open(os.fsencode(tmp_path) + b"/a\xff.obj", "wb"):
        pass
    assert find(str(tmp_path)).refused == [("a\\udcff.obj", "its name is not UTF-8; rename it")]


@pytest.mark.parametrize(("path", "match"), [("gone", "no such folder"), ("a.obj", "cndhf-encode")])
def test_what_is_no_folder(tmp_path, path, match):
    put(tmp_path, "a.obj")
    with pytest.raises(InputError, match=match):
        find(str(tmp_path / path))


def test_a_stamp_is_of_size_and_time_and_none_for_what_is_new_or_names_others(tmp_path):
    put(tmp_path, "a.obj", "b.obj", "c.gltf")
    for name in ("a.obj", "c.gltf"):
        os.utime(tmp_path / name, (1e9, 1e9))
    os.utime(tmp_path / "b.obj", (time.time(), time.time()))
    old, new, naming = find(str(tmp_path)).files
    assert (old.stamp, new.stamp, naming.stamp) == ("1 1000000000000000000", "", "")


def test_inputs_of_one_output_keep_their_extensions():
    assert output_names(["x/a.obj", "x/a.ply", "x/A.stl.gz", "y/a.obj"]) == {
        "x/a.obj": "x/a.obj.cndhf",
        "x/a.ply": "x/a.ply.cndhf",
        "x/A.stl.gz": "x/A.stl.gz.cndhf",
        "y/a.obj": "y/a.cndhf",
    }
    # a.obj.ply has the output that a.obj gets for its neighbour's sake.
    assert output_names(["a.obj", "a.ply", "a.obj.ply"]) == {
        "a.obj": "a.obj.cndhf",
        "a.ply": "a.ply.cndhf",
        "a.obj.ply": "a.obj.ply.cndhf",
    }
