"""What `cndhf-encode` says of an encode that is done."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..files import STREAM
from ..mesh.wording import counted

if TYPE_CHECKING:
    from ..decoder.model import Model
    from ..encoder.report import Other
    from ..mesh.bodies import Bodies
    from ..mesh.unite import United


def summary(source: Path, target: Path, model: Model, verbose: bool) -> str:
    """Lines on the file, and the last one on its size and errors. verbose: what it is made of, too."""
    report = model.report
    d, decoded = report.distances, report.decoded
    mesh = model.container.surface
    size = len(model.dumps())
    if mesh is None:
        what = counted(len(model.container.dhfs), "double height field")
    else:
        what = f"a surface of {len(mesh.positions)} control vertices"
    lines = [f"{target}: {size} bytes, {what}"]
    if verbose:
        lines.append(
            f"error in input units: mean {d.mean:.4g}, p99 {d.p99:.4g}, maximum {d.maximum:.4g}; "
            f"the diagonal is {report.diagonal:.4g}"
        )
        if mesh is None:
            lines.append(
                f"surface seen by the chosen axes: {100 * report.covered:.1f} % (by any axis: "
                f"{100 * report.visible:.1f} %)"
            )
    if report.united is not None:
        lines.append(united_line(report.united))
    lines.append(f"input: {_bodies(report.bodies)}; result: {_bodies(decoded)}")
    if report.other is not None:
        lines.append(_other(report.other, report.diagonal))
    if report.lost:
        lines.append(f"not kept: {', '.join(report.lost)}")

    def share(value: float) -> str:
        return f"{100 * value / report.diagonal:.2g} %"

    pieces = counted(decoded.parts + decoded.minor, "piece") if decoded.closed else "open"
    lines.append(
        f"{change(_size(source), size)}, mean error {share(d.mean)} of the diagonal, p99 {share(d.p99)}, maximum "
        f"{share(d.maximum)}, {pieces}, {sum(report.seconds.values()):.0f} s"
    )
    return "\n".join(lines)


def united_line(united: United) -> str:
    """Say what uniting parts did."""
    return f"united: {counted(united.before)} became {counted(united.after)}, volume {united.volume:.4g}"


def _size(source: Path) -> int:
    """Bytes of the input; 0 where that cannot be told."""
    try:
        return 0 if source == STREAM else source.stat().st_size
    except OSError:  # removed meanwhile
        return 0


def change(before: int, after: int) -> str:
    """From how many bytes to how many; before: 0 where that is not known."""
    if not before:
        return _bytes(after)
    ratio = before / after
    return f"{_bytes(before)} -> {_bytes(after)} ({ratio:.{0 if ratio >= 10 else 1}f}:1)"


def _bytes(size: int) -> str:
    if size < 1e3:
        return f"{size} bytes"
    return f"{size / 1e6:.2f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB"


def _bodies(found: Bodies) -> str:
    if not found.closed:
        return "open"
    tiny = f" and {found.minor} tiny" if found.minor else ""
    return f"{counted(found.parts)}{tiny}, volume {found.volume:.4g}"


def _other(other: Other, diagonal: float) -> str:
    name = {"dhf": "double height fields", "surface": "a surface"}[other.representation]
    if other.how == "impossible":
        return f"as {name}: not possible, for it bounds no solid"
    if other.how == "untried":
        return f"as {name}: not tried, which takes minutes at this size; --preset best does"
    of = {"at least": "at least", "trial": "by a short trial about", "encoded": f"in {other.bytes} bytes"}[other.how]
    return f"as {name}: mean error {of} {100 * other.mean_error / diagonal:.2g} % of the diagonal"
