"""Page of viser for browsers on this computer, with checks of each request and of the address to listen on.

viser 1.1 serves its page and its WebSocket on one port. It checks neither the origin of a connection nor the host name
of the request. It also has a message with which any client can make the page reachable from the internet. Any other
page that is open in the same browser could use the WebSocket. Therefore each request is checked before viser receives
it, and that message has no effect.
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

#: Names of this computer on the computer itself.
LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
#: Pages that may embed this page: notebooks on this computer. Other pages could trick a person into pressing its
#: buttons.
_FRAMES = "frame-ancestors 'self' http://127.0.0.1:* http://localhost:*"
#: Only one page at a time is created, because a function that starts servers is replaced during the creation.
_making = threading.Lock()


def refusal(host: str | None, origin: str | None, is_upgrade: bool, names: frozenset[str] | None) -> str | None:
    """Return the reason why a request is refused; None if it is allowed.

    Args:
        host: Header Host of the request: the requested name of the page.
        origin: Header Origin of the request: the page that makes the browser send it.
        is_upgrade: Whether the request is for a WebSocket. A browser always sends an origin with it.
        names: Allowed names of the page. Another name may have been redirected to this computer (DNS rebinding). None
            allows every name.
    """
    name = urlsplit(f"//{host or ''}").hostname
    if names is not None and name not in names:
        return f"this page is at {' or '.join(sorted(names))}, but was requested as {host}"
    if is_upgrade and origin is None:
        return "a WebSocket without an Origin is not allowed"
    if origin is not None and urlsplit(origin).netloc != host:
        return f"the origin {origin} is another page"
    return None


class Page(Closing):
    """Server of viser. It is a context manager.

    Args:
        name: Name that is shown above the controls.
        host: Address to listen on. If it is not only for this computer, every name of the page is allowed.
        port: Port to listen on; 0 for a free port.

    Attributes:
        server: Server object of viser.
        host: Address that the server listens on.
        port: Port that the server listens on.

    Raises:
        ConnectFailed: If the server cannot listen on the address.
        LocalError: If viser is not installed, or the requests of this release of viser cannot be checked.
    """

    def __init__(self, name: str, host: str = "127.0.0.1", port: int = 8080) -> None:
        with needs("", "a view in a browser", "urlink-view"):
            import viser
            import websockets.asyncio.server as websocket_server
        # viser would try the next port, and never return if the host does not exist.
        try:
            bound_socket(host, port, purpose="the view").close()
        except BadAddress as error:
            raise ConnectFailed(str(error)) from error
        names = LOOPBACK if host in LOOPBACK else None

        class Unshared(viser.ViserServer):  # type: ignore[misc]
            def request_share_url(self, verbose: bool = True) -> None:
                """Do nothing: otherwise any client could make the page visible to the whole internet."""

        # Suppress the output of viser, which is meant for a person who runs viser.
        with _making, _checked(websocket_server, names) as checked, contextlib.redirect_stdout(io.StringIO()):
            self.server: Any = Unshared(host=host, port=port, label=name, verbose=False)
        self.host, self.port = host, int(self.server.get_port())
        if not checked:
            self.close()
            raise LocalError("this release of viser starts its server differently, so its clients cannot be checked")
        self.server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")

    @property
    def address(self) -> str:
        """Address for browsers."""
        host = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "[::1]", "::1": "[::1]"}.get(self.host, self.host)
        return f"http://{host}:{self.port}"

    def close(self) -> None:
        """Disconnect all browsers; idempotent."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


@contextlib.contextmanager
def _checked(websocket_server: Any, names: frozenset[str] | None) -> Iterator[list[None]]:
    """Check all requests to servers that viser starts in this block; yield a list with one entry per started server."""
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
