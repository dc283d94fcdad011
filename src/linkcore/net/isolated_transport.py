"""A connection that another process reads, as a source of bytes."""

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
#: Seconds that a new interpreter may take to begin, on a machine that is busy.
_BEGINNING = 10.0
#: Bytes taken from the pipe at once.
_CHUNK = 1 << 16
#: Seconds that a process which was killed takes to be gone.
_END = 2.0


class IsolatedTransport:
    """Bytes that a process of its own reads. It is started for each connection, and killed with it.

    Nothing can be sent: it is for interfaces that only say something.

    Args:
        host, port, silence: as for `TcpTransport`.
        boundary: what packets look like: "module:class" of a `FrameBoundary`.
        decode: a packet from its bytes, which the other process has seen to be whole.

    Raises:
        LocalError: on Windows, where processes share no descriptors; in a program without an interpreter of its own.
    """

    def __init__(
        self, host: str, port: int, *, silence: float, boundary: str, decode: Callable[[bytes, Stamp], Any]
    ) -> None:
        if sys.platform == "win32":
            raise LocalError("isolate=True shares memory by descriptors, which Windows does not; leave it out")
        if not sys.executable:
            raise LocalError("isolate=True needs a Python interpreter to start, and this program does not say which")
        self.name = f"{host}:{port}"
        self.round_trip = math.inf
        self._arguments = {"host": host, "port": port, "silence": silence, "boundary": boundary}
        self._home = HomeProcess(self.name)
        self._silence = silence
        self._decode = decode
        self._lock = threading.RLock()  # re-entrant, for signal handlers
        self._process: subprocess.Popen[bytes] | None = None
        self._is_receiving = False
        self._slot: Slot | None = None
        self._records = Records()
        self._waiting: deque[HandedOver] = deque()
        self._seen: tuple[int, Any] = (0, None)

    # -- the newest packet -----------------------------------------------------------------------

    def newest(self) -> Any | None:
        """The newest packet that the other process has read, decoded here and now; None if there is none.

        It needs no thread of this process to have run before.

        Raises:
            PacketError: no layout holds it.
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
        """Start the process, and have it connect within `timeout` seconds.

        Raises:
            ConnectFailed, LinkTimeout: as `TcpTransport.open`.
            LocalError: no process could be started; or this one was forked from the one which made the transport.
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
            raise LocalError(f"{self.name}: no process could be started to read it: {error}") from error
        self._slot, self._records, self._seen = slot, Records(), (0, None)
        self._waiting.clear()
        try:
            self.round_trip = float(self._next(timeout + _BEGINNING, CONNECTED).payload)
        except BaseException:
            self.abort()
            raise

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes; with the moment at which the other process read them.

        Raises:
            LinkTimeout: nothing came in that time.
            ConnectionLost: the peer or this side ended it, or the process is gone.
        """
        record = self._next(self._silence if timeout is None else timeout, DATA)
        return record.payload, record.stamp

    def _next(self, timeout: float, kind: bytes) -> HandedOver:
        self._home.check()
        until = clock.now() + timeout
        while not self._waiting:
            data = self._read(clock.left(until))
            if data is None:
                raise LinkTimeout(f"{self.name}: nothing within {timeout:g} s")
            self._waiting.extend(self._records.feed(data))
        record = self._waiting.popleft()
        if record.kind == LOST:
            raise _error(record.payload.decode(errors="replace"))
        assert record.kind == kind, "a connection is made before anything comes"
        return record

    def _read(self, timeout: float) -> bytes | None:
        """What the process has to tell; None when time is up.

        Raises:
            ConnectionLost: it has ended, or was ended here.
        """
        with self._lock:
            process = self._process
            if process is None or process.stdout is None:
                raise ConnectionLost(f"{self.name} was closed here")
            self._is_receiving = True
        try:
            poll = select.poll()
            poll.register(process.stdout, select.POLLIN)
            if not poll.poll(timeout * 1e3):
                return None
            data = os.read(process.stdout.fileno(), _CHUNK)
            if data:
                return data
            by = "the process that read it has ended" if self._process is process else "closed here"
            raise ConnectionLost(f"{self.name}: {by}")
        finally:
            with self._lock:
                self._is_receiving = False
                if self._process is not process:
                    process.stdout.close()

    def send(self, data: bytes, timeout: float) -> None:
        """Refuse.

        Raises:
            LocalError: always.
        """
        self.send_some(data)

    def send_some(self, data: bytes | memoryview) -> int:
        """As `send`."""
        raise LocalError(f"{self.name} is read by another process, so nothing can be sent to it from here")

    def wait_for_room(self, timeout: float) -> bool:
        """There never is any."""
        return False

    def abort(self) -> None:
        """End the process, and with it the connection. Idempotent, from any thread."""
        if not self._home.is_here:  # the process that reads is the parent's
            return
        with self._lock:
            process, self._process = self._process, None
            slot, self._slot = self._slot, None
            is_receiving = self._is_receiving  # then `_read` closes what it reads: the number must not be given away
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
        """As `abort`: nothing was sent."""
        self.abort()


def _error(said: str) -> RemoteError:
    """The error that the other process has met."""
    name, _, text = said.partition(" ")
    kind = getattr(errors, name, ConnectionLost)
    return kind(text) if issubclass(kind, RemoteError) else ConnectionLost(text)
