"""Transport for a connection that a separate process reads."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from .. import clock, errors
from ..clock import Stamp
from ..errors import ConnectionLost, LinkTimeout, LocalError, RemoteError
from ..process import HomeProcess
from .isolated_reader import CONNECTED, DATA, LOST, HandedOver, Records, Slot

_PROGRAM = (
    "import json, sys; path, arguments = json.loads(sys.argv[1]); sys.path[:] = path; "
    "from linkcore.net.isolated_reader import read_for; read_for(**arguments)"
)
#: Maximum time in s in which a new interpreter starts on a busy computer.
_BEGINNING = 10.0
#: Maximum number of bytes read from the pipe at once.
_CHUNK = 1 << 16
#: Maximum time in s in which a killed process ends.
_END = 2.0


class IsolatedTransport:
    """Transport for a connection that a separate process reads.

    The process is started with each connection, and killed at the end of the connection.

    The transport cannot send, so use it only for interfaces that need no input.

    Args:
        host: See `TcpTransport`.
        port: See `TcpTransport`.
        silence: See `TcpTransport`.
        boundary: Boundary of the packets, as "module:class" of a `FrameBoundary`.
        decode: Function that returns a packet from its bytes. The other process has checked that they are complete.

    Raises:
        LocalError: If this is Windows, where processes cannot share descriptors, or if `sys.executable` is not set.
    """

    def __init__(
        self, host: str, port: int, *, silence: float, boundary: str, decode: Callable[[bytes, Stamp], Any]
    ) -> None:
        _check_system()
        self.name = f"{host}:{port}"
        self.round_trip = math.inf
        self._arguments = {"host": host, "port": port, "silence": silence, "boundary": boundary}
        self._home = HomeProcess(self.name)
        self._silence = silence
        self._decode = decode
        self._lock = threading.RLock()  # re-entrant for signal handlers
        self._process: subprocess.Popen[bytes] | None = None
        self._is_receiving = False
        self._slot: Slot | None = None
        self._records = Records()
        self._waiting: deque[HandedOver] = deque()
        self._seen: tuple[int, Any] = (0, None)

    # -- the newest packet -----------------------------------------------------------------------

    def newest(self) -> Any | None:
        """Return the newest packet that the other process has read; None if there is none.

        The packet is decoded in this call, so the result does not depend on another thread of this process.

        Raises:
            PacketError: If no layout can hold the packet.
        """
        slot = self._slot
        if slot is None:
            return None
        try:
            found = slot.get()
        except ValueError:  # closed meanwhile
            return None
        if found is None:
            return None
        number, data, stamp = found
        seen = self._seen
        if seen[0] != number:
            self._seen = seen = (number, self._decode(data, stamp))
        return seen[1]

    # -- the connection --------------------------------------------------------------------------

    def open(self, timeout: float) -> None:
        """Start the process, and wait until it has connected, for at most `timeout` seconds.

        Raises:
            ConnectFailed, LinkTimeout: See `TcpTransport.open`.
            LocalError: If no process can be started, or this process was forked from the process that made the
                transport.
        """
        self._home.check()
        self.abort()
        slot = Slot()
        arguments = {**self._arguments, "parent": os.getpid(), "timeout": timeout, "slot": slot.descriptor}
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, json.dumps([sys.path, arguments])],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=[slot.descriptor],
                bufsize=0,
            )
        except OSError as error:
            slot.close()
            raise LocalError(f"{self.name}: cannot start the process that reads it: {error}") from error
        self._slot, self._records, self._seen = slot, Records(), (0, None)
        self._waiting.clear()
        try:
            self.round_trip = float(self._next(timeout + _BEGINNING, CONNECTED).payload)
        except BaseException:
            self.abort()
            raise

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes; return them with the time when the other process read them.

        Raises:
            LinkTimeout: If nothing arrives in time.
            ConnectionLost: If the peer or this program ends the connection, or the process has ended.
        """
        record = self._next(self._silence if timeout is None else timeout, DATA)
        return record.payload, record.stamp

    def _next(self, timeout: float, kind: bytes) -> HandedOver:
        self._home.check()
        until = clock.now() + timeout
        while not self._waiting:
            data = self._read(clock.left(until))
            if data is None:
                raise LinkTimeout(f"{self.name}: nothing received within {timeout:g} s")
            self._waiting.extend(self._records.feed(data))
        record = self._waiting.popleft()
        if record.kind == LOST:
            raise _error(record.payload.decode(errors="replace"))
        assert record.kind == kind, "a connection is made before any data arrives"
        return record

    def _read(self, timeout: float) -> bytes | None:
        """Read from the pipe of the process; return None after `timeout` seconds.

        Raises:
            ConnectionLost: If the process has ended, or this program has ended it.
        """
        with self._lock:
            process = self._process
            if process is None or process.stdout is None:
                raise ConnectionLost(f"{self.name} was closed by this program")
            self._is_receiving = True
        try:
            if not _is_readable(process.stdout.fileno(), timeout):
                return None
            data = os.read(process.stdout.fileno(), _CHUNK)
            if data:
                return data
            by = "the process that read it has ended" if self._process is process else "closed by this program"
            raise ConnectionLost(f"{self.name}: {by}")
        finally:
            with self._lock:
                self._is_receiving = False
                if self._process is not process:
                    process.stdout.close()

    def send(self, data: bytes, timeout: float) -> None:
        """Raise an error, because this transport cannot send.

        Raises:
            LocalError: If called.
        """
        self.send_some(data)

    def send_some(self, data: bytes | memoryview) -> int:
        """Raise an error; see `send`."""
        raise LocalError(f"{self.name} is read by another process, so this program cannot send to it")

    def wait_for_room(self, timeout: float) -> bool:
        """Return False, because this transport cannot send."""
        return False

    def abort(self) -> None:
        """End the process, and with it the connection. Idempotent, in any thread."""
        if not self._home.is_here:  # the reading process belongs to the parent of this process
            return
        with self._lock:
            process, self._process = self._process, None
            slot, self._slot = self._slot, None
            # While `_read` runs, `_read` closes the pipe itself, so that the descriptor is not reused too early.
            is_receiving = self._is_receiving
        if process is not None:
            process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_END)
            for pipe in (process.stdin, None if is_receiving else process.stdout):
                if pipe is not None:
                    pipe.close()
        if slot is not None:
            slot.close()

    def close(self) -> None:
        """Do the same as `abort`, because no sent data has to be acknowledged."""
        self.abort()


def _check_system() -> None:
    """Check that a process can be started that shares memory with this process.

    Raises:
        LocalError: See `IsolatedTransport`.
    """
    if sys.platform == "win32":
        raise LocalError("isolate=True needs to share a file descriptor, which Windows does not support; omit isolate")
    elif not sys.executable:
        raise LocalError(
            "isolate=True starts a Python interpreter, but sys.executable is not set; set it, or omit isolate"
        )


def _is_readable(descriptor: int, seconds: float) -> bool:
    """Wait until a pipe can be read, or its other end is closed; return False after `seconds`."""
    if sys.platform == "win32":
        raise NotImplementedError("no transport of this kind exists on Windows")
    else:
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        return bool(poll.poll(seconds * 1e3))


def _error(said: str) -> RemoteError:
    """Return the error that the other process has reported."""
    name, _, text = said.partition(" ")
    kind = getattr(errors, name, ConnectionLost)
    return kind(text) if issubclass(kind, RemoteError) else ConnectionLost(text)
