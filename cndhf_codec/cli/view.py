"""`cndhf-view`: show a .cndhf file in the browser, or write it as a page."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path

import click

from ..errors import OptionError
from ..files import STREAM, check_output, write_atomically
from .streams import read_input


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("source", metavar="INPUT.cndhf", type=click.Path(path_type=Path))
@click.option("--port", type=click.IntRange(1, 65535), help="Serve at this port of 127.0.0.1.  [default: a free one]")
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@click.option(
    "--html",
    metavar="PAGE.html",
    type=click.Path(path_type=Path),
    help="Write one page with the viewer and the file in it, about 0.7 MB, and end: to send to somebody.",
)
@click.option("--overwrite", is_flag=True, help="Replace PAGE.html if it exists.")
@click.version_option(package_name="cndhf-codec")
def command(source: Path, port: int | None, no_browser: bool, html: Path | None, overwrite: bool) -> None:
    """Show INPUT.cndhf in the browser, served to this machine alone until Ctrl-C.

    INPUT may be `-`, the standard input. A file is read anew whenever the page is reloaded. The page says what is
    wrong with a damaged one.
    """
    from ..decoder.reading import load_bytes
    from ..viewer.page import page

    if html is not None:
        if port is not None or no_browser:
            raise OptionError("--html serves nothing: leave out --port and --no-browser")
        check_output(html, overwrite, [source])
        data, name = read_input(source)
        load_bytes(data, name)  # nobody is sent a page that shows an error
        write_atomically(html, page(data, _title(source)).encode(), overwrite)
        click.echo(f"{html}: {html.stat().st_size} bytes")
        return
    from ..viewer.server import PageServer

    data, name = read_input(source)

    def latest() -> str:
        return page(read_input(source)[0] if source.is_file() else data, _title(source))  # a pipe is read once

    with PageServer(latest, port or 0) as server, suppress(KeyboardInterrupt):
        click.echo(f"{name}: {server.address} (Ctrl-C ends)")
        if not no_browser:
            _open(server.address)
        server.serve_forever()


def _title(source: Path) -> str:
    return "shape.cndhf" if source == STREAM else source.name


def _open(address: str) -> None:
    """Open the browser while the server serves: one in the terminal lasts until it is left."""
    import webbrowser

    threading.Thread(target=webbrowser.open, args=[address], daemon=True).start()
