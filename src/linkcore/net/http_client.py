"""HTTP client with a single deadline for a whole exchange: connecting, redirects, and all bytes of the answer.

The clients of the standard library limit each wait separately. So a server that sends a byte from time to time could
block such a client forever.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from urllib.parse import urljoin, urlsplit

from .. import clock
from ..errors import Cancelled, Closed, ConnectionLost, LinkTimeout, PacketError, WrongPeer
from ..pending_call import interruptible
from ..wire.http import HttpParser, HttpRequest, HttpResponse
from .transport import TcpTransport
from .undo import MAY_STILL

#: Maximum number of redirects that are followed.
_MOST_REDIRECTS = 5
_MOVED = (301, 302, 303, 307, 308)


class HttpClient:
    """Client of one server that makes a connection for each request. Threads may share it.

    Args:
        host: Host name or address.
        port: TCP port.
        refused: Function that returns a hint for the error if the connection is refused. See `TcpTransport`.
    """

    def __init__(self, host: str, port: int, *, refused: Callable[[], str] = str) -> None:
        self.host = host
        self.port = port
        self._refused = refused
        self._open: set[TcpTransport] = set()
        self._is_closed = False

    def ask(self, request: HttpRequest, timeout: float, given_up: Callable[[], object] | None = None) -> HttpResponse:
        """Send a request, follow redirects, and return the answer.

        Args:
            request: Request.
            timeout: Maximum time for the whole exchange, in s.
            given_up: Function that is called if the request was sent, but no answer was received. The error then states
                that the request might still be executed. None for a request that changes nothing.

        Raises:
            ConnectFailed, ConnectionLost: If the server cannot be reached, or disconnects.
            WrongPeer: If the peer is not an HTTP server, or redirects to an invalid address or too often.
            LinkTimeout: If the answer is not complete within `timeout` seconds.
            Closed: If `close` was called.
            Cancelled: If the task that awaits this call was cancelled.
        """
        until = clock.now() + timeout
        host, port = self.host, self.port
        for _ in range(_MOST_REDIRECTS + 1):
            response = self._ask(host, port, request, until, timeout, given_up)
            location = response.headers.get("location")
            if response.status not in _MOVED or location is None:
                return response
            here = f"http://{_authority(host, port)}{request.target}"
            try:
                there = urlsplit(urljoin(here, location))
                host, port = there.hostname or "", there.port or 80
            except ValueError:
                raise WrongPeer(f"{here} redirects to {location[:200]!r}, which is not a valid address") from None
            if there.scheme != "http" or not host:
                raise WrongPeer(f"{here} redirects to {location[:200]}; only http is supported")
            request = replace(request, target=f"{there.path or '/'}{'?' if there.query else ''}{there.query}")
            if response.status == 303:
                request = replace(request, method="GET", body=b"")
        raise WrongPeer(f"{_authority(self.host, self.port)} redirects more than {_MOST_REDIRECTS} times")

    def close(self) -> None:
        """Abort running requests, and send no more. Idempotent, in any thread."""
        self._is_closed = True
        for transport in list(self._open):
            transport.abort()

    def _ask(
        self,
        host: str,
        port: int,
        request: HttpRequest,
        until: float,
        timeout: float,
        given_up: Callable[[], object] | None,
    ) -> HttpResponse:
        transport = TcpTransport(host, port, silence=timeout, refused=self._refused)
        data = request.encode(_authority(host, port))
        parser = HttpParser("response")
        self._open.add(transport)
        is_sent, answer = False, None
        try:
            with interruptible(transport.abort):
                transport.open(_left(until, transport.name, timeout))
                if self._is_closed:
                    raise ConnectionLost(f"{transport.name} was closed by this program")
                is_sent = True
                transport.send(data, _left(until, transport.name, timeout))
                while answer is None:
                    answer = _received(transport, parser, _left(until, transport.name, timeout))
            return answer
        except BaseException as error:
            hint = ""
            if given_up is not None and is_sent and (answer is None or isinstance(error, Cancelled)):
                given_up()
                hint = f"; {MAY_STILL}"
            if isinstance(error, (ConnectionLost, LinkTimeout, WrongPeer)):
                if self._is_closed:
                    what = f"{request.method} {request.target}"
                    raise Closed(f"{transport.name} was closed while {what} was waiting for a reply{hint}") from error
                error.args = (f"{error}{hint}",)
            raise
        finally:
            self._open.discard(transport)
            transport.abort()


def _received(transport: TcpTransport, parser: HttpParser, left: float) -> HttpResponse | None:
    """Receive bytes; return the answer if it is complete now, or else None."""
    answer: HttpRequest | HttpResponse | None
    try:
        data = transport.receive(left)[0]
    except ConnectionLost as lost:
        try:
            answer = parser.end()
        except PacketError:
            raise lost from None
    else:
        try:
            answer = parser.feed(data)
        except PacketError as error:
            raise WrongPeer(f"{transport.name} does not respond like a web server: {error}") from None
    assert not isinstance(answer, HttpRequest)
    return answer


def _left(until: float, name: str, timeout: float) -> float:
    left = until - clock.now()
    if left <= 0.0:
        raise LinkTimeout(f"{name} has not answered within {timeout:g} s")
    return left


def _authority(host: str, port: int) -> str:
    name = f"[{host}]" if ":" in host else host
    return name if port == 80 else f"{name}:{port}"
