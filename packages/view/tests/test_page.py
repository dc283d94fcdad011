"""The page of a view: who is served, and who is not."""

from __future__ import annotations

import http.client
import sys
from collections.abc import Iterator

import pytest

import urlink
import urlink.cli
from urlink_view.page import LOOPBACK, Page, refusal

WHY = "needs viser: uv pip install viser"


@pytest.fixture
def page() -> Iterator[Page]:
    pytest.importorskip("viser", reason=WHY)
    with Page("a page", port=0) as page:
        yield page


@pytest.mark.parametrize(
    ("host", "origin", "is_upgrade", "says"),
    [
        ("127.0.0.1:8080", None, False, None),
        ("localhost:8080", "http://localhost:8080", True, None),
        ("[::1]:8080", "http://[::1]:8080", True, None),
        ("127.0.0.1:8080", None, True, "without an Origin"),
        ("127.0.0.1:8080", "http://evil.example", True, "is another page"),
        # The same computer, and yet another page of it.
        ("127.0.0.1:8080", "http://127.0.0.1:8888", True, "is another page"),
        ("127.0.0.1:8080", "http://localhost:8080", True, "is another page"),
        ("127.0.0.1:8080", "null", True, "is another page"),
        ("127.0.0.1:8080", "http://evil.example", False, "is another page"),
        # A name of somebody else's that has been made to mean this computer.
        ("evil.example:8080", "http://evil.example:8080", True, "requested as evil.example"),
        ("127.0.0.1.evil.example", None, False, "requested as"),
        ("evil@127.0.0.1:8080", "http://evil.example", True, "is another page"),
        (None, None, False, "requested as None"),
    ],
)
def test_what_is_refused(host: str | None, origin: str | None, is_upgrade: bool, says: str | None) -> None:
    why = refusal(host, origin, is_upgrade, LOOPBACK)
    assert (why is None) if says is None else (why is not None and says in why)


def test_a_page_for_others_is_taken_by_every_name_and_from_no_other_page() -> None:
    assert refusal("cell-4:8080", "http://cell-4:8080", True, None) is None
    assert refusal("cell-4:8080", "http://evil.example", True, None) is not None


def ask(page: Page, **headers: str) -> http.client.HTTPResponse:
    """The answer to a request for a WebSocket, as a browser makes it; without a Host, for the page."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=60.0)
    connection.putrequest("GET", "/", skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    response = connection.getresponse()
    if response.status != 101:
        response.read()
    connection.close()
    return response


UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec_WebSocket_Version": "13",
    "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
    "Sec_WebSocket_Protocol": "viser-v1.1.1",
}


@pytest.mark.real_time
def test_the_socket_is_for_its_own_page(page: Page) -> None:
    own = {"Origin": f"http://127.0.0.1:{page.port}"}
    assert ask(page, **UPGRADE, **own).status == 101
    assert ask(page, **UPGRADE).status == 403
    assert ask(page, **UPGRADE, Origin="http://evil.example").status == 403
    assert ask(page, **UPGRADE, Host="evil.example", Origin="http://evil.example").status == 403
    # As viser does not read it, and a browser never writes it.
    assert ask(page, **{**UPGRADE, "Upgrade": "WebSocket"}).status == 403
    served = ask(page)
    assert served.status == 200
    assert served.getheader("Content-Security-Policy", "").startswith("frame-ancestors 'self'")
    assert ask(page, Host="evil.example").status == 403


@pytest.mark.real_time
def test_a_client_cannot_make_it_public(page: Page) -> None:
    assert page.server.request_share_url() is None
    assert page.server._share_tunnel is None


@pytest.mark.real_time
def test_a_port_that_is_taken_is_not_another_one(page: Page) -> None:
    with pytest.raises(urlink.ConnectFailed, match="for the view"):
        Page("another", port=page.port)


@pytest.mark.real_time
def test_servers_of_others_are_not_touched(page: Page) -> None:
    import websockets.asyncio.server as server

    assert server.serve.__module__ == "websockets.asyncio.server"


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert urlink.cli.main(["view", "sim://"]) == 1
    assert "pip install urlink-view" in capsys.readouterr().err
