"""A web server of one page, for this machine's own browser."""

from __future__ import annotations

import os
import socketserver
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler

from ..errors import CndhfError, OptionError

HOST = "127.0.0.1"
# Whatever a file holds, the page loads nothing and sends nothing.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "frame-ancestors 'none'"
)


class PageServer(socketserver.ThreadingTCPServer):
    """Serves a page at `/`, and nothing else, on the loopback address alone.

    Not http.server's own server, which looks up the machine's name at the start.

    Parameters
    ----------
    page : callable
        Makes the HTML for each request; a CndhfError becomes the answer.
    port : int
        0 for a free one.

    Raises
    ------
    OptionError
        When the port cannot be had.
    """

    daemon_threads = True
    allow_reuse_address = os.name != "nt"  # a port at once after its last use; on Windows, one that is in use

    def __init__(self, page: Callable[[], str], port: int) -> None:
        self.page = page
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as exc:
            raise OptionError(f"--port {port} cannot be used: {exc.strerror}; name another, or none") from exc
        at = self.server_address[1]
        self.address = f"http://{HOST}:{at}/"  # what to open in a browser
        # What a browser may call this server; it leaves out the port of http.
        self.names = [
            f"{name}{end}" for name in (HOST, "localhost") for end in ([f":{at}", ""] if at == 80 else [f":{at}"])
        ]

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing: browsers drop connections."""


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    server_version, sys_version = "cndhf-view", ""
    timeout = 30  # seconds, for a connection that says nothing

    def do_GET(self) -> None:
        # A foreign page whose name was made to point here says that name: it must not read the file.
        if self.headers.get_all("Host") not in [[name] for name in self.server.names]:
            self._answer(HTTPStatus.FORBIDDEN, "text/plain", f"Open {self.server.address}\n")
        elif self.path.partition("?")[0] != "/":
            self._answer(HTTPStatus.NOT_FOUND, "text/plain", f"There is only {self.server.address}\n")
        else:
            try:
                self._answer(HTTPStatus.OK, "text/html", self.server.page())
            except CndhfError as exc:  # the file is gone
                self._answer(HTTPStatus.INTERNAL_SERVER_ERROR, "text/plain", f"{exc}\n")

    def _answer(self, status: HTTPStatus, kind: str, text: str) -> None:
        data = text.encode("utf-8", "replace")
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_: object) -> None:
        """Say nothing: the terminal has the address."""
