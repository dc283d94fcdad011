"""`robot.tool_serial`: the RS485 line in the tool connector of an e-Series, over the network.

A URCap of the vendor ("RS485 daemon", on PolyScope X "Tool Comm Forwarder") copies bytes between the line and port
54321 of the controller. There is no protocol of its own around them.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from linkcore import clock
from linkcore.arguments import check_seconds
from linkcore.errors import BadValue, Cancelled, Closed, ConnectionLost, LinkTimeout
from linkcore.names import StrictAttributes
from linkcore.net.transport import TcpTransport
from linkcore.net.undo import MAY_STILL
from linkcore.pending_call import interruptible
from linkcore.threads import Closing, alone

#: The message where the port is refused.
_NEEDED = (
    "the tool's serial line is served by a URCap: the vendor's RS485 daemon, on PolyScope X the Tool Comm Forwarder; "
    "no other URCap, such as that of a gripper, may use the line"
)


class ToolSerial(StrictAttributes, Closing):
    """The bytes of the RS485 line in the tool connector. Connects when it is first used; threads take turns.

    The line is set by `robot.io.set_tool_communication`. Nothing of it is interlocked: what is mounted there does what
    it is commanded, also in a stop. Whoever is connected to the port shares the line with this computer: whose bytes
    come then is not known.

    All methods that use the line raise

    - `BadValue` for an unusable argument; nothing has been sent then;
    - `ConnectFailed` where no URCap serves it, `ConnectionLost` where it went away, `LinkTimeout` where nothing came;
    - `Closed` after the robot was closed.

    Args:
        host: of the controller.
        port: 54321 on a real one.
        timeout: seconds to connect.
    """

    def __init__(self, host: str, port: int, *, timeout: float = 5.0) -> None:
        self._timeout = check_seconds(timeout, "timeout", positive=True, finite=True)
        self._transport = TcpTransport(host, port, silence=timeout, refused=lambda: _NEEDED)
        self._lock = threading.RLock()
        self._is_open = False
        self._is_closed = False
        self._rest = b""

    def ask(self, request: bytes, size: int, *, timeout: float = 1.0) -> bytes:
        """Discard what has come unasked, write a request, and read its answer.

        Args:
            request: at least one byte.
            size: bytes of the answer.
            timeout: seconds for all of it.

        Raises:
            LinkTimeout: not all of the answer came; the device may still carry the request out. The connection is
                closed, so that what comes later is not taken for the answer to the next request.
        """
        until = self._check(timeout, request=request, size=size)
        with self._turn(timeout):
            self._discard(until)
            self._send(request, until)
            try:
                return self._take(size, until, timeout)
            except (LinkTimeout, ConnectionLost) as error:
                self._disconnect()
                error.args = (f"{error}; {MAY_STILL}",)
                raise

    def write(self, data: bytes, *, timeout: float = 1.0) -> None:
        """Write bytes. They are on their way when it returns."""
        until = self._check(timeout, request=data)
        with self._turn(timeout):
            self._send(data, until)

    def read(self, size: int, *, timeout: float = 1.0) -> bytes:
        """So many bytes.

        Raises:
            LinkTimeout: not all of them came; those that did are kept for the next `read`.
        """
        until = self._check(timeout, size=size)
        with self._turn(timeout):
            self._connect(until)
            return self._take(size, until, timeout)

    def discard(self) -> bytes:
        """The bytes that have come so far, and were not read."""
        with self._turn(self._timeout):
            return self._discard(clock.now() + self._timeout)

    def close(self) -> None:
        """Disconnect for good. Idempotent; `robot.close()` does it too."""
        self._is_closed = True
        self._transport.close()

    # -- inside, by the thread that has its turn -----------------------------------------------------------

    @contextlib.contextmanager
    def _turn(self, timeout: float) -> Iterator[None]:
        otherwise = f"for {timeout:g} s another thread used the tool's serial line; nothing was sent"
        with alone(self._lock, timeout, otherwise):
            try:
                with interruptible(self._transport.abort):
                    yield
            except Cancelled:
                self._disconnect()
                raise

    def _check(self, timeout: float, *, request: bytes = b"\0", size: int = 1) -> float:
        if not isinstance(request, (bytes, bytearray)) or not request:
            raise BadValue(f"{request!r} was to be written; expected at least one byte, as bytes")
        if not isinstance(size, int) or isinstance(size, bool) or size < 1:
            raise BadValue(f"size={size!r}; expected a whole number of bytes from 1 on")
        return clock.now() + check_seconds(timeout, "timeout", positive=True, finite=True)

    def _connect(self, until: float) -> None:
        if self._is_closed:
            raise Closed("the tool's serial line was closed")
        if not self._is_open:
            self._transport.open(max(min(until - clock.now(), self._timeout), 0.0))
            self._is_open, self._rest = True, b""

    def _disconnect(self) -> None:
        self._transport.abort()
        self._is_open, self._rest = False, b""

    def _send(self, data: bytes, until: float) -> None:
        self._connect(until)
        try:
            self._transport.send(bytes(data), clock.left(until))
        except (LinkTimeout, ConnectionLost) as error:
            self._disconnect()
            error.args = (f"{error}; {MAY_STILL}",)
            raise

    def _take(self, size: int, until: float, timeout: float) -> bytes:
        while len(self._rest) < size:
            try:
                data, _ = self._transport.receive(clock.left(until))
            except LinkTimeout:
                came = f"{len(self._rest)} of {size} bytes came within {timeout:g} s"
                raise LinkTimeout(f"the tool's serial line at {self._transport.name}: {came}") from None
            except ConnectionLost:
                self._disconnect()
                raise
            self._rest += data
        taken, self._rest = self._rest[:size], self._rest[size:]
        return taken

    def _discard(self, until: float) -> bytes:
        """What has come; a connection that has ended meanwhile is made anew."""
        if not self._is_open:
            return b""
        found, self._rest = self._rest, b""
        try:
            while (more := self._transport.receive_waiting()) is not None:
                found += more[0]
        except ConnectionLost:
            self._disconnect()
            self._connect(until)
        return found
