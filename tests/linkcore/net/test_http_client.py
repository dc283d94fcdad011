"""HTTP client with a server that sends the bytes of the test: redirects, deadlines, and ends."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from linkcore.errors import Closed, ConnectFailed, ConnectionLost, LinkTimeout, WrongPeer
from linkcore.net.http_client import HttpClient
from linkcore.wire.http import HttpParser, HttpRequest, HttpResponse
from tests.fakes.server import OneAfterAnother
from tests.waiting import until

pytestmark = pytest.mark.real_time

TIMEOUT = 10.0
Respond = Callable[[HttpRequest], Iterator[bytes]]


class WebServer(OneAfterAnother):
    """Server that answers each request with the pieces that `respond` yields, and closes the connection.

    Attributes:
        asked: Received requests.
    """

    def __init__(self, respond: Respond) -> None:
        self._respond = respond
        self.asked: list[HttpRequest] = []
        super().__init__(TIMEOUT)

    def _talk(self, connection: socket.socket) -> None:
        parser, request = HttpParser("request"), None
        while request is None:
            request = parser.feed(connection.recv(65536))
        assert isinstance(request, HttpRequest)
        self.asked.append(request)
        for piece in self._respond(request):
            connection.sendall(piece)


@pytest.fixture
def serve() -> Iterator[Callable[[Respond], WebServer]]:
    made: list[WebServer] = []

    def serve(respond: Respond) -> WebServer:
        made.append(WebServer(respond))
        return made[-1]

    yield serve
    for server in made:
        server.close()


Serve = Callable[[Respond], WebServer]


def once(response: HttpResponse) -> Respond:
    return lambda request: iter([response.encode()])


def test_redirect_keeps_method_and_body(serve: Serve) -> None:
    there = serve(once(HttpResponse(200, "OK", {}, b"there")))

    def respond(request: HttpRequest) -> Iterator[bytes]:
        where = {"/a": "/b?c=d", "/b?c=d": f"http://127.0.0.1:{there.port}/end", "/see": "/other"}[request.target]
        yield HttpResponse(303 if request.target == "/see" else 307, "", {"Location": where}).encode()

    here = serve(respond)
    client = HttpClient("127.0.0.1", here.port)
    assert client.ask(HttpRequest("PUT", "/a", {}, b"body"), TIMEOUT).body == b"there"
    asked = [(each.method, each.target, each.body) for each in [*here.asked, *there.asked]]
    assert asked == [("PUT", "/a", b"body"), ("PUT", "/b?c=d", b"body"), ("PUT", "/end", b"body")]
    assert here.asked[0].headers["host"] == f"127.0.0.1:{here.port}"


@pytest.mark.parametrize(
    ("location", "error"),
    [
        ("/again", "redirects more than 5 times"),
        ("https://127.0.0.1/", "only http is supported"),
        ("http://[", "is not a valid address"),
    ],
)
def test_invalid_redirect_raises_wrong_peer(serve: Serve, location: str, error: str) -> None:
    server = serve(once(HttpResponse(302, "Found", {"Location": location})))
    with pytest.raises(WrongPeer, match=error):
        HttpClient("127.0.0.1", server.port).ask(HttpRequest("GET", "/"), TIMEOUT)


def test_timeout_covers_the_whole_response(serve: Serve) -> None:
    def drip(request: HttpRequest) -> Iterator[bytes]:
        yield b"HTTP/1.1 200 OK\r\n"
        while True:
            time.sleep(0.02)
            yield b"X-A: b\r\n"

    server = serve(drip)
    began = time.monotonic()
    with pytest.raises(LinkTimeout):
        HttpClient("127.0.0.1", server.port).ask(HttpRequest("GET", "/"), 0.2)
    assert time.monotonic() - began < TIMEOUT / 2


def test_response_that_is_not_http_or_incomplete_raises(serve: Serve) -> None:
    other = serve(lambda request: iter([b"Connected: Universal Robots Dashboard Server\r\n"]))
    with pytest.raises(WrongPeer, match="does not respond like a web server"):
        HttpClient("127.0.0.1", other.port).ask(HttpRequest("GET", "/"), TIMEOUT)
    half = serve(lambda request: iter([b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\nhalf"]))
    with pytest.raises(ConnectionLost):
        HttpClient("127.0.0.1", half.port).ask(HttpRequest("GET", "/"), TIMEOUT)
    open_end = serve(lambda request: iter([b"HTTP/1.1 200 OK\r\n\r\n", b"all of it"]))
    assert HttpClient("127.0.0.1", open_end.port).ask(HttpRequest("GET", "/"), TIMEOUT).body == b"all of it"


def test_refused_connection_error_names_the_possible_cause() -> None:
    with socket.create_server(("127.0.0.1", 0)) as gone:
        port = gone.getsockname()[1]
    with pytest.raises(ConnectFailed, match=r"refused.*; it may be switched off"):
        HttpClient("127.0.0.1", port, refused=lambda: "it may be switched off").ask(HttpRequest("GET", "/"), 5)


def test_close_ends_a_waiting_request(serve: Serve) -> None:
    is_over = threading.Event()

    def wait(request: HttpRequest) -> Iterator[bytes]:
        is_over.wait(TIMEOUT)
        yield b""

    server = serve(wait)
    client = HttpClient("127.0.0.1", server.port)

    def close() -> None:
        until(lambda: server.asked)
        client.close()

    threading.Thread(target=close).start()
    try:
        with pytest.raises(Closed, match="was closed while GET / was waiting"):
            client.ask(HttpRequest("GET", "/"), TIMEOUT)
    finally:
        is_over.set()
