"""Pins of the lowest versions that pyproject.toml allows: `python tools/ci/lowest.py encode report > pins.txt`.

Then `pip install --constraint pins.txt '.[encode,report]'`. Prints `name==lowest` for the package's dependencies and
those of the extras named, and of the extras that these name. Exits with 1 when a dependency has no lower bound.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"
REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)(\[(?P<extras>[^]]*)\])?(?P<bounds>[^;]*)")


def lowest(extras: list[str], project: Path = PROJECT) -> dict[str, str]:
    """Name and lowest version of each dependency. Raises KeyError for an extra that is not there, ValueError for a
    dependency without a lower bound."""
    data = tomllib.loads(project.read_text("utf-8"))["project"]
    found: dict[str, str] = {}
    waiting, seen = list(data["dependencies"]), set()
    for extra in extras:
        waiting.append(f"{data['name']}[{extra}]")
    while waiting:
        match = REQUIREMENT.match(waiting.pop(0))
        assert match
        name = match["name"]
        if name == data["name"]:
            for extra in match["extras"].split(","):
                if extra not in seen:
                    seen.add(extra)
                    waiting += data["optional-dependencies"][extra]
            continue
        bound = re.search(r"(>=|==)\s*([^,\s]+)", match["bounds"])
        if not bound:
            raise ValueError(f"{name} has no lower bound")
        found[name] = bound[2]
    return found


if __name__ == "__main__":
    try:
        pins = lowest(sys.argv[1:])
    except KeyError as e:
        sys.exit(f"no extra {e}")
    except ValueError as e:
        sys.exit(str(e))
    for name, version in sorted(pins.items(), key=lambda pin: pin[0].lower()):
        print(f"{name}=={version}")
