"""The viewer's page: what is put into it, and who gets it."""

from __future__ import annotations

import base64
import html
import http.client
import re
import socket
import threading

import pytest

from cndhf_codec import load
from cndhf_codec.errors import InputError, OptionError
from cndhf_codec.viewer.page import PLACE, page
from cndhf_codec.viewer.server import PageServer


def test_the_page_has_one_place_for_a_file():
    assert page(b"", "a").replace(' data-name="a"', "").count(PLACE) == 1


def test_a_page_holds_the_file_and_its_name():
    name = 'a"><script>alert(1)</script>\udcff.cndhf'
    text = page(b"\x00\xff</script>", name)
    found = re.findall(r'<script id="cndhf-file" type="text/plain" data-name="([^"]*)">([^<]*)</script>', text)
    assert [(html.unescape(n), base64.b64decode(d)) for n, d in found] == [
        (name.replace("\udcff", "?"), b"\x00\xff</script>")
    ]
    text.encode()


def test_a_notebook_gets_a_frame_that_cannot_touch_it(golden):
    model = load(golden / "encoded.cndhf")
    shown = model.show(height=300)
    found = re.fullmatch(r'<iframe (.*) srcdoc="([^"]*)"></iframe>', shown._repr_html_(), re.DOTALL)
    assert html.unescape(found[2]) == page(model.dumps(), "model.cndhf")
    assert "height: 300px" in found[1]
    assert 'sandbox="allow-scripts allow-downloads"' in found[1]
    assert "cndhf-view" in repr(shown)


@pytest.mark.parametrize("height", [99, 10_001, "480", 1.5, None])
def test_heights_that_are_refused(golden, height):
    with pytest.raises(OptionError, match="height"):
        load(golden / "encoded.cndhf").show(height)


@pytest.fixture
def server():
    with PageServer(lambda: "<p>the page</p>", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def ask(server, path: str = "/", *hosts: str, method: str = "GET"):
    """The answer's status, headers and text; hosts: its Host headers."""
    connection = http.client.HTTPConnection(*server.server_address)
    connection.putrequest(method, path, skip_host=True)
    for host in hosts:
        connection.putheader("Host", host.replace("PORT", str(server.server_address[1])))
    connection.endheaders()
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, answer.headers, text


def test_the_page_is_served(server):
    for host in ("127.0.0.1:PORT", "localhost:PORT"):
        status, headers, text = ask(server, "/?reload", host)
        assert (status, text) == (200, "<p>the page</p>")
        assert headers["Content-Type"] == "text/html; charset=utf-8"
        assert headers["Cache-Control"] == "no-store"
        assert "default-src 'none'" in headers["Content-Security-Policy"]


@pytest.mark.parametrize("path", ["/a.cndhf", "/..", "/../../etc/passwd", "/%2e%2e/", "*"])
def test_nothing_else_is_served(server, path):
    status, _, text = ask(server, path, "127.0.0.1:PORT")
    assert (status, text) == (404, f"There is only {server.address}\n")


@pytest.mark.parametrize(
    "hosts", [[], ["evil.example"], ["evil.example:PORT"], ["127.0.0.1"], ["127.0.0.1:PORT", "evil.example"]]
)
def test_names_that_point_here_are_refused(server, hosts):
    status, _, text = ask(server, "/", *hosts)
    assert status == 403
    assert "the page" not in text


def test_other_methods_are_refused(server):
    assert ask(server, "/", "127.0.0.1:PORT", method="POST")[0] == 501


def test_other_machines_are_not_answered(server):
    assert server.server_address[0] == "127.0.0.1"


def test_a_file_that_is_gone_is_said(server):
    def gone():
        raise InputError("a.cndhf: cannot be read: No such file or directory")

    server.page = gone
    status, headers, text = ask(server, "/", "127.0.0.1:PORT")
    assert (status, text) == (500, "a.cndhf: cannot be read: No such file or directory\n")
    assert headers["Content-Type"].startswith("text/plain")


def test_a_port_that_is_in_use():
    with socket.create_server(("127.0.0.1", 0)) as other, pytest.raises(OptionError, match="name another"):
        PageServer(str, other.getsockname()[1])
