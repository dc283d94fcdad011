"""Client behind `robot.tool_serial`: the RS485 line in the tool connector of an e-Series, over the network.

A URCap of the vendor ("RS485 daemon", on PolyScope X "Tool Comm Forwarder") copies bytes between the line and port
54321 of the controller. The bytes have no additional framing.
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

#: Hint in the error if the port is closed.
_NEEDED = (
    "the tool's serial line is served by a URCap: the vendor's RS485 daemon, on PolyScope X the Tool Comm Forwarder; "
    "no other URCap, such as that of a gripper, may use the line"
)


class ToolSerial(StrictAttributes, Closing):
    """RS485 line in the tool connector. It connects when it is first used; threads take turns.

    `robot.io.set_tool_communication` configures the line. The interlock does not affect the line: the device at the
    tool executes commands even during a stop. All clients that are connected to the port share the line, so received
    bytes can be the reply to another client.

    All methods that use the line raise

    - `BadValue` if an argument is invalid; in this case, nothing is sent;
    - `ConnectFailed` if no URCap serves the line, `ConnectionLost` if the connection is lost, and `LinkTimeout` if
      nothing arrives in time;
    - `Closed` after the robot was closed.

    Args:
        host: Host name or address of the controller.
        port: Port number, 54321 on a real controller.
        timeout: Maximum time to connect, in seconds.
    """

    def __init__(self, host: str, port: int, *, timeout: float = 5.0) -> None:
        self._timeout = check_seconds(timeout, "timeout", positive=True, finite=True)
        self._transport = TcpTransport(host, port, silence=timeout, refused=lambda: _NEEDED)
        self._lock = threading.RLock()
        self._is_open = False
        self._is_closed = False
        self._rest = b""

    def ask(self, request: bytes, size: int, *, timeout: float = 1.0) -> bytes:
        """Discard unread bytes, write a request, and read its reply.

        Args:
            request: Bytes to write, at least one.
            size: Length of the reply, in bytes.
            timeout: Maximum time for the whole call, in seconds.

        Raises:
            LinkTimeout: If the reply is not complete in time. The device might still execute the request. The
                connection is closed, so that late bytes are not taken as the reply to the next request.
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
        """Write bytes, and return after they are handed to the network."""
        until = self._check(timeout, request=data)
        with self._turn(timeout):
            self._send(data, until)

    def read(self, size: int, *, timeout: float = 1.0) -> bytes:
        """Read `size` bytes from the line.

        Raises:
            LinkTimeout: If fewer bytes arrive in time. The received bytes are kept for the next `read`.
        """
        until = self._check(timeout, size=size)
        with self._turn(timeout):
            self._connect(until)
            return self._take(size, until, timeout)

    def discard(self) -> bytes:
        """Return the bytes that have arrived but were not read, and remove them."""
        with self._turn(self._timeout):
            return self._discard(clock.now() + self._timeout)

    def close(self) -> None:
        """Disconnect permanently. Idempotent; `robot.close()` calls it too."""
        self._is_closed = True
        self._transport.close()

    # -- internal, called only by the thread that has its turn ---------------------------------------------

    @contextlib.contextmanager
    def _turn(self, timeout: float) -> Iterator[None]:
        otherwise = f"another thread used the tool's serial line for {timeout:g} s; nothing was sent"
        with alone(self._lock, timeout, otherwise):
            try:
                with interruptible(self._transport.abort):
                    yield
            except Cancelled:
                self._disconnect()
                raise

    def _check(self, timeout: float, *, request: bytes = b"\0", size: int = 1) -> float:
        if not isinstance(request, (bytes, bytearray)) or not request:
            raise BadValue(f"cannot write {request!r}; expected a bytes object with at least one byte")
        if not isinstance(size, int) or isinstance(size, bool) or size < 1:
            raise BadValue(f"size={size!r}; expected a whole number of bytes, at least 1")
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
                came = f"only {len(self._rest)} of {size} bytes arrived within {timeout:g} s"
                raise LinkTimeout(f"the tool's serial line at {self._transport.name}: {came}") from None
            except ConnectionLost:
                self._disconnect()
                raise
            self._rest += data
        taken, self._rest = self._rest[:size], self._rest[size:]
        return taken

    def _discard(self, until: float) -> bytes:
        """Return the unread bytes. If the connection has ended in the meantime, connect again."""
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
