"""What a manifest says, as a page for people and a table for programs."""

from __future__ import annotations

import base64
import csv
import io
import statistics
import tempfile
from collections import Counter
from collections.abc import Iterable
from html import escape
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ..errors import CndhfError, MissingExtraError, require
from ..files import write_atomically
from . import remote
from .jobs import OUTCOMES
from .manifest import STARTED, Manifest, Row
from .run import Order

WORST = 20  # files with the largest errors, which are shown
NAMED = 1000  # failures on the page, at most; the table has all
VIEWER = "viewer.html"  # of web/, where it has been copied to OUT
HTML, TSV = "report.html", "report.tsv"

STYLE = """body { font: 15px/1.5 sans-serif; margin: 2em auto; max-width: 1400px; padding: 0 1em; color: #222 }
table { border-collapse: collapse; margin: 1em 0 } td, th { padding: .3em 1em; border-bottom: 1px solid #ddd }
td { text-align: right; white-space: nowrap } th, .text { text-align: left; white-space: normal }
th { font-weight: 600 } small { display: block; color: #666 } img { width: 200px; height: 200px }"""
COLUMNS = (
    "input",
    "output",
    "outcome",
    "reason",
    "representation",
    "source_bytes",
    "bytes",
    "ratio",
    "mean_percent",
    "p99_percent",
    "max_percent",
    "diagonal",
    "seconds",
    "warnings",
    "version",
)


def write_report(order: Order) -> list[Path]:
    """Write report.html and report.tsv to the output folder, or beside the manifest where that is a URL.

    Returns their paths. Raises InputError, OutputError, MissingExtraError (the `report` extra).
    """
    require("matplotlib", "report")
    path = order.manifest_path
    manifest = Manifest(path, create=False)
    try:
        rows, source = list(manifest.rows()), manifest.about("source")
    finally:
        manifest.close()
    folder = path.parent if remote.is_url(order.target) else Path(order.target)
    write_atomically(folder / TSV, table(rows).encode(), overwrite=True)
    write_atomically(folder / HTML, page(rows, source, order.target).encode(), overwrite=True)
    return [folder / HTML, folder / TSV]


def table(rows: Iterable[Row]) -> str:
    """A line per input, separated by tabs; errors in percent of the diagonal."""
    out = io.StringIO()
    lines = csv.writer(out, delimiter="\t", lineterminator="\n")
    lines.writerow(COLUMNS)
    for row in rows:
        done = row.outcome == "done"
        measured = [
            f"{_ratio(row):.3f}",
            *(f"{_percent(row, e):.5f}" for e in (row.mean_error, row.p99_error, row.max_error)),
            f"{row.diagonal:.6g}",
        ]
        lines.writerow(
            [
                row.input,
                row.output if done else "",
                row.outcome,
                row.reason,
                row.representation,
                row.source_bytes or "",
                row.bytes or "",
                *(measured if done else [""] * len(measured)),
                f"{row.seconds:.2f}",
                "; ".join(row.warnings),
                row.version,
            ]
        )
    return out.getvalue()


def page(rows: list[Row], source: str, target: str) -> str:
    """The whole HTML text, with pictures of the worst files in it. Takes about a second for each of them."""
    done = [row for row in rows if row.outcome == "done"]
    failed = [row for row in rows if row.outcome not in ("done", STARTED)]
    worst = sorted(done, key=lambda row: _percent(row, row.mean_error), reverse=True)[:WORST]
    viewer = not remote.is_url(target) and (Path(target) / VIEWER).is_file()
    return f"""<!DOCTYPE html>
<html lang="en"><meta charset="utf-8"><title>{escape(target)}</title><style>{STYLE}</style>
<h1>{escape(target)}</h1>
<p>From {escape(source)}. All files: <a href="{TSV}">{TSV}</a>.</p>
{_totals(rows, done)}
<h2>Largest mean errors</h2>
<table><tr><th>source</th><th>decoded</th><th>file</th><th>bytes</th><th>ratio</th><th>mean error</th><th>p99</th>
<th>maximum</th><th>representation</th></tr>
{"".join(_worst(row, source, target, viewer) for row in worst)}</table>
{_failures(failed)}
</html>
"""


def _totals(rows: list[Row], done: list[Row]) -> str:
    counts = Counter(row.outcome for row in rows)
    names = OUTCOMES | {STARTED: "not finished"}
    facts = [(names.get(outcome, outcome), f"{count:,}") for outcome, count in counts.most_common()]
    if done:
        source_bytes, size = sum(r.source_bytes for r in done), sum(r.bytes for r in done)
        errors = [_percent(r, r.mean_error) for r in done]
        ratios = [_ratio(r) for r in done]
        facts += [
            ("bytes of the sources", f"{source_bytes:,}"),
            ("bytes of the files", f"{size:,}"),
            ("ratio, of all", f"{source_bytes / size:.1f}"),
            ("ratio, median", f"{statistics.median(ratios):.1f}"),
            ("mean error, median, of the diagonal", f"{statistics.median(errors):.4f} %"),
            ("mean error, largest", f"{max(errors):.4f} %"),
            ("seconds of work", f"{sum(r.seconds for r in done):,.0f}"),
        ]
        facts += [(f"as {kind}", f"{n:,}") for kind, n in Counter(r.representation for r in done).most_common()]
    return f"<table>{''.join(f'<tr><th>{escape(k)}</th><td>{v}</td></tr>' for k, v in facts)}</table>"


def _worst(row: Row, source: str, target: str, viewer: bool) -> str:
    shown = escape(row.input)
    if viewer:
        shown = f'<a href="{VIEWER}?url={quote(row.output, safe="")}">{shown}</a>'
    elif not remote.is_url(target):
        shown = f'<a href="{quote(row.output)}">{shown}</a>'
    cells = [
        *_pictures(row, source, target),
        f'<td class="text">{shown}{"".join(f"<small>{escape(line)}</small>" for line in row.warnings)}</td>',
        f"<td>{row.bytes:,}</td><td>{_ratio(row):.1f}</td>",
        *(f"<td>{_percent(row, e):.4f} %</td>" for e in (row.mean_error, row.p99_error, row.max_error)),
        f"<td>{row.representation}</td>",
    ]
    return f"<tr>{''.join(cells)}</tr>\n"


def _pictures(row: Row, source: str, target: str) -> list[str]:
    """Cells with the source and the decoded file, in one frame; the reason where there is no picture."""
    from ..decoder.reading import load
    from ..mesh.read import read_mesh
    from ..report.thumbnail import thumbnail

    box, cells = None, []
    with tempfile.TemporaryDirectory() as scratch:
        for path in (remote.join(source, row.input), remote.join(target, row.output)):
            try:
                local = remote.fetch(path, Path(scratch)) if remote.is_url(path) else path
                mesh = load(local).to_mesh() if Path(local).suffix == ".cndhf" else read_mesh(local)
                vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)
                if box is None:
                    box = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
                png = base64.b64encode(thumbnail(vertices, faces, box)).decode("ascii")
                cells.append(f'<td><img alt="" src="data:image/png;base64,{png}"></td>')
            except MissingExtraError:
                raise
            except CndhfError as exc:  # removed since
                cells.append(f'<td class="text">{escape(str(exc))}</td>')
    return cells


def _failures(failed: list[Row]) -> str:
    if not failed:
        return ""
    lines = "".join(
        f'<tr><td class="text">{escape(r.input)}</td><td class="text">{OUTCOMES[r.outcome]}</td>'
        f'<td class="text">{escape(r.reason)}</td></tr>\n'
        for r in failed[:NAMED]
    )
    more = f"<p>And {len(failed) - NAMED:,} more, in {TSV}.</p>" if len(failed) > NAMED else ""
    return f"<h2>Not encoded</h2>\n<table>{lines}</table>{more}"


def _ratio(row: Row) -> float:
    return row.source_bytes / max(row.bytes, 1)


def _percent(row: Row, error: float) -> float:
    return 100 * error / row.diagonal if row.diagonal else 0.0
