"""`cndhf-batch`: encode whole folders of meshes, and go on where a run was stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..errors import OptionError
from ..mesh.lengths import parse_size
from .terminal import say


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("places", metavar="IN OUT", nargs=-1)
@click.option(
    "--report", is_flag=True, help="Encode nothing: write OUT/report.html and OUT/report.tsv; takes OUT alone."
)
@click.option("--jobs", type=click.IntRange(min=1), help="Files at a time.  [default: one per processor]")
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    default=1,
    help="Threads of each file; more than one pays where there are fewer files than processors.",
)
@click.option("--include", metavar="GLOB", multiple=True, help="Only inputs that match, such as '*.ply' or 'cars/*'.")
@click.option(
    "--preset", type=click.Choice(["fast", "default", "best", "paper"]), default="default", help="As cndhf-encode."
)
@click.option(
    "--representation", type=click.Choice(["auto", "dhf", "surface"]), default="auto", help="As cndhf-encode."
)
@click.option("--target-size", metavar="SIZE", help="Most bytes of each output.  [default: the preset's]")
@click.option("--target-error", metavar="ERROR", help="Most mean error, as cndhf-encode.")
@click.option("--target-max", metavar="ERROR", help="Most maximum error, as cndhf-encode.")
@click.option("--unit", type=click.Choice(["mm", "cm", "m", "in"]), help="The unit of all inputs.")
@click.option("--thicken", metavar="THICKNESS", help="Give open sheets a wall, as cndhf-encode.")
@click.option("--solid", is_flag=True, help="Unite overlapping parts first, as cndhf-encode.")
@click.option("--seed", type=int, default=0, help="As cndhf-encode.")
@click.option("--memory", metavar="SIZE", help="Most memory of a worker, such as 4GB; a file that takes more fails.")
@click.option(
    "--timeout",
    metavar="SECONDS",
    type=click.FloatRange(min=0, min_open=True),
    help="Most time of a file, which else fails.",
)
@click.option(
    "--ray",
    metavar="local|ADDRESS",
    help="Work as tasks of a Ray cluster: one started here, or the one at ADDRESS (auto: of this machine).",
)
@click.option(
    "--manifest",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="What is done.  [default: OUT/cndhf-batch.sqlite]",
)
@click.option("--force", is_flag=True, help="Encode what is done, too.")
@click.option("--retry-failed", is_flag=True, help="Try again what has failed; without, only when it has changed.")
@click.option("--overwrite", is_flag=True, help="Replace outputs that no earlier run has made, too.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object per line.")
@click.option("--quiet", is_flag=True, help="No progress; failures and the summary stay.")
@click.version_option(package_name="cndhf-codec")
def command(
    places: tuple[str, ...],
    report: bool,
    jobs: int | None,
    threads: int,
    include: tuple[str, ...],
    memory: str | None,
    timeout: float | None,
    ray: str | None,
    manifest: Path | None,
    force: bool,
    retry_failed: bool,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> int:
    """Encode the meshes below the folder IN to .cndhf files in the same folders below OUT.

    A second run does what is missing or has changed. A mesh that fails, crashes, or exceeds --memory or --timeout is
    named, and costs that mesh only. IN and OUT may be URLs that fsspec opens (s3://, gs://, ...), then with --manifest.
    Where a.obj and a.ply stand side by side, they become a.obj.cndhf and a.ply.cndhf.
    """
    from ..batch.run import Order, run

    if report:
        if len(places) != 1:
            raise OptionError("--report takes OUT alone")
        from ..batch.report import write_report

        for path in write_report(Order("", places[0], manifest=manifest)):
            click.echo(str(path))
        return 0
    if len(places) != 2:
        raise OptionError("IN and OUT are needed, and no more" if places else "IN and OUT are missing")
    from ..batch.jobs import Limits
    from ..batch.many import check_options, runner_for
    from .batch_display import display

    options = {name: value for name, value in options.items() if value is not None}
    order = Order(*places, options, include, manifest, force, retry_failed, overwrite)
    limits = Limits(threads, None if memory is None else parse_size(memory, "memory"), timeout)
    check_options(options)
    shown = display(quiet, as_json)
    runner = runner_for(jobs, limits, ray)
    try:
        run(order, runner, shown)
    except KeyboardInterrupt:
        shown.close()
        click.echo(
            f"cndhf-batch: interrupted; {shown.counts['done']} files are done, run again for the others", err=True
        )
        return 130
    finally:
        shown.close()
        runner.close()
    say(shown.summary())
    return 1 if shown.failed else 0
