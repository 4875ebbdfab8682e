"""Valid files that ask for as much as they can: limits bound them, and they take no more memory than stated."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import manifolds
import numpy as np
import pytest
import rawfile
import surfaces

from cndhf_codec import Limits, Model, load, loads
from cndhf_codec.decoder.parallel import processors
from cndhf_codec.errors import OptionError, SurfaceError

MIB = 2**20

# A process of its own: the peak of the memory of this one has long been set by other tests. The small file first brings
# in the libraries; then the mark of the peak is put back to what is resident.
MEASURE = """
import json, sys
from pathlib import Path
import numpy as np
from cndhf_codec import load, loads

def status(name):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(name))

def to_mesh(model, resolution):
    return len(model.to_mesh(resolution).vertices)

def intersection(model, resolution):
    from cndhf_codec.decoder.dhf.intersection import DhfTriangulation

    closed, triangles = DhfTriangulation.solid, [0]

    def counted(*arguments):
        solid = closed(*arguments)
        triangles[0] += len(solid[1])
        return solid

    DhfTriangulation.solid = counted
    model.to_mesh(resolution, method="intersection")
    DhfTriangulation.solid = closed
    return triangles[0]

def occupancy(model, resolution):
    return model.occupancy(resolution)[0].size

def level(model, number):
    return len(model.surface(level=number).vertices) if model.representation == "surface" else 0

def shaded(model, number):
    levels = {"level": number} if model.representation == "surface" else {"resolution": 16}
    return len(model.to_mesh(normals=True, **levels).vertices)

def nearest(model, points):
    return len(model.nearest(np.random.default_rng(0).uniform(-1, 1, (points, 3))).distance)

def contains(model, points):
    return len(model.contains(np.random.default_rng(0).uniform(-2, 2, (points, 3))))

def parse(model, _):
    return len(loads(data).container.dhfs)

small, large, what, amount = sys.argv[1:]
data = Path(large).read_bytes()
use = globals()[what]
use(load(small), 16)
model = load(large) if what != "parse" else None
Path("/proc/self/clear_refs").write_text("5")
before = status("VmRSS")
count = use(model, int(amount))
print(json.dumps([count, status("VmHWM") - before]))
"""


@pytest.fixture
def measure(golden, tmp_path):
    """(what, amount, data) -> (its result, bytes of memory taken at most)"""
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("memory is measured on Linux only")

    def run(what: str, amount: int, data: bytes) -> tuple[int, int]:
        (tmp_path / "large.cndhf").write_bytes(data)
        files = [str(golden / "encoded.cndhf"), str(tmp_path / "large.cndhf")]
        command = [sys.executable, "-c", MEASURE, *files, what, str(amount)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        count, memory = json.loads(done.stdout)
        return count, memory

    return run


LARGEST = 8 * 128 * 129 + 5 * 128 + 2  # parameters of the largest network


def seven_of_the_largest() -> bytes:
    wide = rawfile.record(width=128, hidden=8, codes=bytes([0x80 | 20] * 20))
    return rawfile.build([rawfile.fields(wide * 7, rawfile.frame(bytes(2 * 7 * LARGEST)), n_dhfs=7)])


@pytest.mark.parametrize(
    "data", [seven_of_the_largest(), rawfile.noise(64, 8, 2), rawfile.noise(64, 43, 8)], ids=["wide", "many", "both"]
)
def test_memory_of_loading(measure, data):
    assert len(data) < 2**20
    assert measure("parse", 0, data)[1] < 64 * MIB


@pytest.mark.encode
@pytest.mark.parametrize("data", [rawfile.noise(16, 4, 1), rawfile.noise(1, 128, 2)], ids=["many", "wide"])
def test_memory_of_queries(measure, data):
    count, memory = measure("contains", 70_000, data)
    assert memory < 32 * MIB + 40 * count
    count, memory = measure("contains", 300_000, data)  # so many that cells are made
    assert memory < 60e6 + 16e6 + 40 * count


@pytest.mark.encode
@pytest.mark.parametrize(
    ("n_dhfs", "width", "resolution"), [(1, 4, 112), (64, 2, 32), (1, 96, 32)], ids=["surface", "tables", "network"]
)
@pytest.mark.parametrize("what", ["to_mesh", "occupancy"])
def test_memory_of_surfaces_and_grids(measure, what, n_dhfs, width, resolution):
    count, memory = measure(what, resolution, rawfile.noise(n_dhfs, width, 2))
    each = {"to_mesh": 250, "occupancy": 2}[what]
    assert memory < 512 * MIB + 256 * n_dhfs * resolution**2 + each * count


@pytest.mark.encode
@pytest.mark.parametrize(("what", "each"), [("level", 700), ("shaded", 1200)])
def test_memory_of_subdivision_surfaces(measure, what, each):
    faces = manifolds.grid(32, 32)
    vertices = np.random.default_rng(0).uniform(-0.5, 0.5, (33**2, 3))
    data = Model(surfaces.container(faces, vertices)).dumps()
    count, memory = measure(what, 4, data)
    assert count > 250_000
    assert memory < 64 * MIB + each * count


@pytest.mark.encode
def test_memory_of_queries_of_subdivision_surfaces(measure):
    count, memory = measure("nearest", 300_000, surfaces.ball().dumps())
    assert memory < 100e6 + 40e6 * processors() + 80 * count  # arguments, results, and what is made of them


@pytest.mark.encode
def test_memory_of_an_intersection(measure):
    triangles, memory = measure("intersection", 32, rawfile.noise(2, 8, 2))
    assert triangles > 1e6
    assert memory < 512 * MIB + 1024 * triangles


def test_the_defaults_refuse_nothing_at_the_default_resolution():
    # The most that the format allows: 64 double height fields, 2^20 parameters.
    for data in (rawfile.noise(64, 43, 8), seven_of_the_largest()):
        Limits().check(loads(data).container, 256)


@pytest.mark.parametrize("method", ["to_mesh", "occupancy"])
def test_resolution_has_a_limit_that_can_be_raised_and_lowered(golden, method):
    model = load(golden / "encoded.cndhf", limits=Limits(resolution=20))
    assert model.prefix(1).limits == model.limits
    with pytest.raises(OptionError, match="8 to 20 are allowed"):
        getattr(model, method)(21)
    with pytest.raises(OptionError, match="8 to 20 are allowed"):
        getattr(model, method)(7)
    model.limits = Limits(resolution=21)
    getattr(model, method)(21)
    with pytest.raises(OptionError, match="8 to 2048 are allowed"):
        getattr(load(golden / "encoded.cndhf"), method)(2049)
    with pytest.raises(OptionError, match="8 to 4096 are allowed"):
        getattr(load(golden / "encoded.cndhf", limits=Limits(resolution=4096)), method)(4097)


@pytest.mark.parametrize("method", ["to_mesh", "occupancy"])
@pytest.mark.parametrize(
    ("data", "name"), [(rawfile.noise(64, 8, 2), "tables"), (seven_of_the_largest(), "work")], ids=["tables", "work"]
)
def test_a_file_that_asks_for_too_much_is_refused_before_any_work(method, data, name):
    with pytest.raises(
        SurfaceError, match=rf"too much at this resolution \({name}: .*lower the resolution.*Limits\({name}="
    ):
        getattr(loads(data), method)(1024)


def test_a_surface_has_a_limit_of_vertices():
    model = loads(rawfile.noise())
    n = len(model.to_mesh(32).vertices)
    assert n > 5000  # a smooth solid has about 6 * 32^2
    model.limits = Limits(vertices=n)
    assert len(model.to_mesh(32).vertices) == n
    model.limits = Limits(vertices=n - 1)
    with pytest.raises(SurfaceError, match="vertices"):
        model.to_mesh(32)


def test_a_grid_has_a_limit_of_nodes(golden):
    model = load(golden / "encoded.cndhf")
    n = model.occupancy(32)[0].size
    model.limits = Limits(nodes=n)
    assert np.count_nonzero(model.occupancy(32)[0])
    model.limits = Limits(nodes=n - 1)
    with pytest.raises(SurfaceError, match="nodes"):
        model.occupancy(32)
