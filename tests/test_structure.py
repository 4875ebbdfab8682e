"""Rules of the code: who may import whom, how many arguments a function takes, which decisions are cited."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest
from places import ROOT

PACKAGE = ROOT / "cndhf_codec"
MODULES = {
    ".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in PACKAGE.rglob("*.py")
}
# Public functions whose options are keyword-only, and commands, whose options are their users'.
MANY_ARGUMENTS = {
    "cndhf_codec.encoder.pipeline.encode",
    "cndhf_codec.cli.encode.command",
    "cndhf_codec.cli.decode.command",
    "cndhf_codec.cli.batch.command",
}


def imports_of(name: str) -> set[str]:
    """Modules that a module imports anywhere, except for type checkers only. Of other packages: the top-level name."""
    path, found = MODULES[name], set()
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    tree = ast.parse(path.read_text("utf-8"))
    tree.body = [n for n in tree.body if not (isinstance(n, ast.If) and getattr(n.test, "id", "") == "TYPE_CHECKING")]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").split(".")[0])
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] + (node.module or "").split(".") * bool(node.module)
            for alias in node.names:
                whole = ".".join([*base, alias.name])
                found.add(whole if whole in MODULES else ".".join(base))
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "require":
            first = node.args[0]
            if isinstance(first, ast.Constant):
                found.add(str(first.value).split(".")[0])
    return found


GRAPH = {name: imports_of(name) for name in MODULES}


def test_no_module_imports_itself_by_way_of_others():
    state: dict[str, int] = defaultdict(int)

    def visit(name: str, path: list[str]) -> None:
        assert state[name] != 1, " -> ".join([*path, name])
        if state[name] == 2:
            return
        state[name] = 1
        for other in sorted(GRAPH[name] & MODULES.keys()):
            visit(other, [*path, name])
        state[name] = 2

    for name in MODULES:
        visit(name, [])


def below(*folders: str) -> list[str]:
    return [m for m in MODULES if any(m == f"cndhf_codec.{f}" or m.startswith(f"cndhf_codec.{f}.") for f in folders)]


@pytest.mark.parametrize(
    ("folder", "others"),
    [
        ("viewer", ("format", "mesh", "decoder", "encoder", "report", "integrations", "batch", "cli")),
        ("format", ("mesh", "decoder", "encoder", "report", "integrations", "batch", "cli")),
        ("mesh", ("decoder", "encoder", "report", "integrations", "batch", "cli")),
        ("decoder", ("mesh", "encoder", "report", "integrations", "batch", "cli")),
        ("encoder", ("report", "integrations", "batch", "cli")),
        ("report", ("encoder", "integrations", "batch", "cli")),
        ("integrations", ("encoder", "report", "batch", "cli")),
        ("batch", ("integrations", "cli")),
        ("encoder.dhf", ("encoder.paper", "encoder.pipeline", "encoder.settings")),
        ("encoder.dhf.network", ("encoder.dhf.axes", "encoder.dhf.fit", "encoder.dhf.rounding")),
        ("encoder.dhf.fit", ("encoder.dhf.axes", "encoder.dhf.rounding")),
        ("encoder.dhf.rounding", ("encoder.dhf.axes",)),
    ],
)
def test_arrows_point_one_way(folder, others):
    forbidden = set(below(*others))
    for name in below(folder):
        assert not GRAPH[name] & forbidden, name


@pytest.mark.parametrize(
    ("library", "homes"),
    [
        ("torch", ("encoder", "integrations.torch")),
        ("numba", ("encoder.compiling", "encoder.dhf.network", "encoder.pipeline", "encoder.surface")),
        ("llvmlite", ("encoder.dhf.network",)),
        ("click", ("cli",)),
        ("matplotlib", ("report", "batch.report", "cli.compare")),
        ("ray", ("batch.on_ray",)),
        ("fsspec", ("batch.remote",)),
        ("psutil", ("batch.pool",)),
        (
            "trimesh",
            (
                "mesh.read",
                "decoder.model",
                "encoder.pipeline",
                "encoder.check",
                "integrations.trimesh",
            ),
        ),
    ],
)
def test_heavy_libraries_stay_at_home(library, homes):
    users = {name for name in MODULES if library in GRAPH[name]}
    assert users
    assert users <= set(below(*homes))


def test_no_function_takes_more_than_eight_arguments():
    many = set()
    for name, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef):
                a = node.args
                names = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs) if x.arg not in ("self", "cls")]
                if len(names) > 8:
                    many.add(f"{name}.{node.name}")
    assert many == MANY_ARGUMENTS


def test_cited_decisions_exist_and_name_what_they_govern():
    records = {p.name[:3] for p in (ROOT / "docs" / "adr").glob("[0-9]*.md")}
    assert len(records) > 20
    for path in PACKAGE.rglob("*.py"):
        for line in re.findall(
            r"Evidence for these constants: (.*?)\.\n", path.read_text("utf-8").replace("\n# ", " ")
        ):
            assert set(re.findall(r"\b\d{3}\b", line)) <= records, path
    governed = re.findall(
        r"((?:`\w+`[^`()|]*)+)\(`([\w/]+\.py)`", (ROOT / "docs" / "adr" / "README.md").read_text("utf-8")
    )
    assert len(governed) > 30
    for names, file in governed:
        text = (PACKAGE / Path(file)).read_text("utf-8")
        for name in re.findall(r"`(\w+)`", names):
            assert re.search(rf"\b{name}\b", text), f"{file}: {name}"
