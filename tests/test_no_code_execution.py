"""The package runs no code from files, and opens no connections: no pickle, no eval, no network, no shell."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import cndhf_codec

PACKAGE = Path(cndhf_codec.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))

MODULES = {
    # what turns bytes into code or objects
    "pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "yaml", "code", "codeop", "runpy",
    # network
    "socket", "ssl", "urllib", "http", "ftplib", "smtplib", "poplib", "imaplib", "telnetlib", "xmlrpc", "requests",
    "httpx", "aiohttp", "asyncio", "socketserver", "webbrowser",
    # other programs, and memory behind Python's back
    "subprocess", "pty", "ctypes", "cffi",
}  # fmt: skip
CALLS = {
    "eval", "exec", "compile", "__import__", "os.system", "os.popen", "os.execv", "os.execve", "os.execvp", "os.spawnv",
    "os.posix_spawn", "os.fork", "torch.load", "torch.save", "torch.hub.load", "np.fromfile", "numpy.fromfile",
}  # fmt: skip
# What its user asks for: a file shown to this machine's own browser; whether a Ray cluster answers.
EXCEPTIONS = {
    "viewer/server.py": {"http", "http.server", "socketserver"},
    "cli/view.py": {"webbrowser"},
    "batch/on_ray.py": {"socket"},
}
TEXT_ONLY = {"urllib.parse"}  # cuts and joins text
KEYWORDS = {"allow_pickle", "shell", "allow_remote"}


def violations(source: str) -> list[str]:
    """List the forbidden things that a module's source does."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [a.name for a in node.names if a.name.split(".")[0] in MODULES]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            module = str(node.module)
            found += [module] if module.split(".")[0] in MODULES and module not in TEXT_ONLY else []
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            found += [name] if name in CALLS else []
            given = {k.arg: k.value for k in node.keywords if k.arg in KEYWORDS}
            found += [k for k, v in given.items() if not (isinstance(v, ast.Constant) and v.value is False)]
            if name in {"np.load", "numpy.load"} and "allow_pickle" not in given:
                found.append("np.load without allow_pickle=False")
            if name in {"importlib.import_module", "require"} and isinstance(node.args[0], ast.Constant):
                found += [node.args[0].value] if node.args[0].value.split(".")[0] in MODULES else []
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_runs_nothing_and_asks_nobody(path):
    allowed = EXCEPTIONS.get(path.relative_to(PACKAGE).as_posix(), set())
    assert set(violations(path.read_text("utf-8"))) == allowed


def test_there_are_modules_to_look_at():
    assert len(FILES) > 30


@pytest.mark.parametrize(
    "bad",
    [
        "import pickle",
        "from urllib.request import urlopen",
        "def f():\n    import subprocess",
        "eval('1')",
        "x = np.load(p, allow_pickle=True)",
        "x = np.load(p)",
        "torch.load(p)",
        "importlib.import_module('socket')",
        "trimesh.load(p, allow_remote=True)",
    ],
)
def test_the_test_sees(bad):
    assert violations(bad)


def test_loading_and_asking_trigger_no_such_event(golden):
    # The interpreter's own audit hooks, which also see what libraries do.
    code = """
import sys, cndhf_codec
seen = set()
def use():
    model = cndhf_codec.load(sys.argv[1])
    model.contains([[0, 0, 0]]), model.info, model.dumps(), model.occupancy(16)
use()  # with all imports, which compile and execute
sys.addaudithook(lambda name, _: seen.add(name))
use()
bad = ("socket", "subprocess", "pickle", "marshal", "exec", "compile", "import", "urllib", "ctypes", "os.system",
       "os.exec", "os.posix_spawn", "os.fork")
print(sorted(n for n in seen if n.startswith(bad)), "open" in seen)
"""
    command = [sys.executable, "-c", code, str(golden / "encoded.cndhf")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "[] True"), done.stderr
