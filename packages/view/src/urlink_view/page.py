"""A page of viser for browsers of this computer: what others may not ask of it, and where it listens.

viser 1.1 serves its page and its WebSocket on one port, checks neither the origin of a connection nor the name by which
it was reached, and has a message by which any client makes it reachable from the internet. Any page that a person has
open in the same browser could use the WebSocket. So each request is checked before viser sees it, and that message does
nothing.
"""

from __future__ import annotations

import contextlib
import http
import io
import threading
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from urlink import BadAddress, ConnectFailed, LocalError
from urlink.tools import Closing, bound_socket, needs

#: The names of this computer for itself.
LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
#: Pages that may show this one within theirs: notebooks of this computer. Others could have a person press its buttons.
_FRAMES = "frame-ancestors 'self' http://127.0.0.1:* http://localhost:*"
#: One page at a time is made: meanwhile what starts servers is another function.
_making = threading.Lock()


def refusal(host: str | None, origin: str | None, is_upgrade: bool, names: frozenset[str] | None) -> str | None:
    """Why a request is refused; None if it is not.

    Args:
        host: its header Host, which is the name by which the page was reached.
        origin: its header Origin, the page that a browser sends it for.
        is_upgrade: it asks for a WebSocket. A browser always says for which page it does.
        names: names by which the page may be reached: another one may have been made to mean this computer (DNS
            rebinding). None takes every name.
    """
    name = urlsplit(f"//{host or ''}").hostname
    if names is not None and name not in names:
        return f"this page is at {' or '.join(sorted(names))}, and was asked for at {host}"
    if is_upgrade and origin is None:
        return "a WebSocket without an Origin"
    if origin is not None and urlsplit(origin).netloc != host:
        return f"the origin {origin} is another page"
    return None


class Page(Closing):
    """A server of viser. A context manager.

    Args:
        name: shown above its controls.
        host: address to listen on. Where that is not of this computer alone, the page is taken by every name.
        port: to listen on; 0 for a free one.

    Attributes:
        server: viser's.
        host, port: where it listens.

    Raises:
        ConnectFailed: it cannot listen there.
        LocalError: viser is not installed, or this release of viser cannot be checked.
    """

    def __init__(self, name: str, host: str = "127.0.0.1", port: int = 8080) -> None:
        with needs("", "a view in a browser", "urlink-view"):
            import viser
            import websockets.asyncio.server as websocket_server
        # viser would go on to the next port, and never return where there is no such host.
        try:
            bound_socket(host, port, purpose="the view").close()
        except BadAddress as error:
            raise ConnectFailed(str(error)) from error
        names = LOOPBACK if host in LOOPBACK else None

        class Unshared(viser.ViserServer):  # type: ignore[misc]
            def request_share_url(self, verbose: bool = True) -> None:
                """Does nothing: a client asks for it, and the whole internet would see the page."""

        # What viser prints is for a person who runs viser.
        with _making, _checked(websocket_server, names) as checked, contextlib.redirect_stdout(io.StringIO()):
            self.server: Any = Unshared(host=host, port=port, label=name, verbose=False)
        self.host, self.port = host, int(self.server.get_port())
        if not checked:
            self.close()
            raise LocalError("this release of viser starts its server in another way, so its clients are not checked")
        self.server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")

    @property
    def address(self) -> str:
        """The address for browsers."""
        host = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "[::1]", "::1": "[::1]"}.get(self.host, self.host)
        return f"http://{host}:{self.port}"

    def close(self) -> None:
        """Disconnect every browser; idempotent."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


@contextlib.contextmanager
def _checked(websocket_server: Any, names: frozenset[str] | None) -> Iterator[list[None]]:
    """Meanwhile what viser serves is checked; yields a list that has an entry once it serves."""
    serve, done = websocket_server.serve, list[None]()

    def serve_checked(handler: Any, *places: Any, process_request: Any = None, **options: Any) -> Any:
        if not str(getattr(handler, "__module__", "")).startswith("viser."):
            return serve(handler, *places, process_request=process_request, **options)

        def process(connection: Any, request: Any) -> Any:
            headers = request.headers
            why = refusal(headers.get("Host"), headers.get("Origin"), "Upgrade" in headers, names)
            if why is not None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{why}\n")
            response = process_request(connection, request)
            if response is not None:
                response.headers["Content-Security-Policy"] = _FRAMES
            return response

        done.append(None)
        return serve(handler, *places, process_request=process, **options)

    websocket_server.serve = serve_checked
    try:
        yield done
    finally:
        websocket_server.serve = serve
