"""The page of a view: which requests are served, and which are refused."""

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
        # the same computer, but another page on it
        ("127.0.0.1:8080", "http://127.0.0.1:8888", True, "is another page"),
        ("127.0.0.1:8080", "http://localhost:8080", True, "is another page"),
        ("127.0.0.1:8080", "null", True, "is another page"),
        ("127.0.0.1:8080", "http://evil.example", False, "is another page"),
        # a foreign host name that was pointed at this computer
        ("evil.example:8080", "http://evil.example:8080", True, "requested as evil.example"),
        ("127.0.0.1.evil.example", None, False, "requested as"),
        ("evil@127.0.0.1:8080", "http://evil.example", True, "is another page"),
        (None, None, False, "requested as None"),
    ],
)
def test_request_is_refused_for_wrong_host_or_origin(
    host: str | None, origin: str | None, is_upgrade: bool, says: str | None
) -> None:
    why = refusal(host, origin, is_upgrade, LOOPBACK)
    assert (why is None) if says is None else (why is not None and says in why)


def test_public_page_accepts_any_host_but_no_other_origin() -> None:
    assert refusal("cell-4:8080", "http://cell-4:8080", True, None) is None
    assert refusal("cell-4:8080", "http://evil.example", True, None) is not None


def ask(page: Page, **headers: str) -> http.client.HTTPResponse:
    """Return the answer to a browser's WebSocket request; the default `Host` is the page's."""
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
def test_socket_serves_only_its_own_page(page: Page) -> None:
    own = {"Origin": f"http://127.0.0.1:{page.port}"}
    assert ask(page, **UPGRADE, **own).status == 101
    assert ask(page, **UPGRADE).status == 403
    assert ask(page, **UPGRADE, Origin="http://evil.example").status == 403
    assert ask(page, **UPGRADE, Host="evil.example", Origin="http://evil.example").status == 403
    # viser does not recognise this spelling, and a browser never sends it
    assert ask(page, **{**UPGRADE, "Upgrade": "WebSocket"}).status == 403
    served = ask(page)
    assert served.status == 200
    assert served.getheader("Content-Security-Policy", "").startswith("frame-ancestors 'self'")
    assert ask(page, Host="evil.example").status == 403


@pytest.mark.real_time
def test_client_cannot_request_share_url(page: Page) -> None:
    assert page.server.request_share_url() is None
    assert page.server._share_tunnel is None


@pytest.mark.real_time
def test_port_in_use_raises_connect_failed(page: Page) -> None:
    with pytest.raises(urlink.ConnectFailed, match="for the view"):
        Page("another", port=page.port)


@pytest.mark.real_time
def test_import_does_not_patch_websockets_server(page: Page) -> None:
    import websockets.asyncio.server as server

    assert server.serve.__module__ == "websockets.asyncio.server"


def test_view_command_names_missing_package(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert urlink.cli.main(["view", "sim://"]) == 1
    assert "pip install urlink-view" in capsys.readouterr().err
