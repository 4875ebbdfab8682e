"""Check the links of all Markdown files of the repository: `python tools/docs/check_links.py`.

A relative link must name a file that exists, and its anchor a heading there. An absolute link to the project's own
repository must name a file that exists here. Other absolute links are not followed. Exit code 1 with a list of what is
broken. Standard library only.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parents[2]
OWN = re.compile(
    r"https://(?:github\.com/cndhf/cndhf-codec/(?:blob|tree|raw)|raw\.githubusercontent\.com/cndhf/cndhf-codec)/main(?:/|$)"
)
INLINE = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
REFERENCE = re.compile(r"^ {0,3}\[[^\]]+\]:\s*<?(\S+?)>?(?:\s|$)", re.MULTILINE)
HTML = re.compile(r"<(?:a|img)\b[^>]*?\b(?:href|src)=\"([^\"]+)\"")
FENCE = re.compile(r"^( {0,3})(```+|~~~+).*?(?:^\1\2[^\n]*$|\Z)", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"(`+)(?!`).+?(?<!`)\1(?!`)", re.DOTALL)
HEADING = re.compile(r"^ {0,3}(#{1,6})\s+(.*?)\s*#*\s*$", re.MULTILINE)


def markdown_files() -> list[Path]:
    """Those that git knows or would add."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", "*.md"]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    return sorted({ROOT / name for name in names.split("\0") if name and (ROOT / name).is_file()})


def links(text: str) -> Iterator[tuple[int, str]]:
    """(line, target) of every link outside code."""
    bare = CODE.sub(_blank, FENCE.sub(_blank, text))
    for pattern in (INLINE, REFERENCE, HTML):
        for match in pattern.finditer(bare):
            yield bare.count("\n", 0, match.start(1)) + 1, match[1]


def _blank(match: re.Match[str]) -> str:
    """As many lines, with nothing on them."""
    return re.sub(r"[^\n]", " ", match[0])


@cache
def anchors(path: Path) -> frozenset[str]:
    """The anchors of a file's headings, as GitHub and MkDocs make them."""
    text = FENCE.sub(_blank, path.read_text(encoding="utf-8"))
    found: dict[str, int] = {}
    out = set(re.findall(r"<a\s+(?:id|name)=\"([^\"]+)\"", text))
    for match in HEADING.finditer(text):
        plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", match[2])
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        number = found.get(slug, 0)
        found[slug] = number + 1
        out |= {f"{slug}-{number}", f"{slug}_{number}"} if number else {slug}
    return frozenset(out)


def broken(path: Path) -> Iterator[str]:
    """A line for each broken link of a file."""
    for line, target in links(path.read_text(encoding="utf-8")):
        problem = _problem(path, target)
        if problem:
            yield f"{path.relative_to(ROOT)}:{line}: {target}: {problem}"


def _problem(path: Path, target: str) -> str | None:
    own = OWN.match(target)
    if own:
        base, rest = ROOT, target[own.end() :]
    elif re.match(r"[a-zA-Z][a-zA-Z0-9+.-]*:|//", target):
        return None
    else:
        base, rest = path.parent, target
    name, _, anchor = unquote(rest).partition("#")
    file = (base / name).resolve() if name else (ROOT if own else path)
    if not file.exists():
        return "no such file"
    if not file.is_relative_to(ROOT):
        return "outside the repository"
    if anchor and file.suffix == ".md" and anchor not in anchors(file):
        return "no such heading"
    return None


def main() -> int:
    files = markdown_files()
    problems = [problem for path in files for problem in broken(path)]
    for problem in problems:
        print(problem)
    print(f"{len(files)} files, {len(problems)} broken links", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
