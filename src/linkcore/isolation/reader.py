"""The process that reads a connection for another one, which may hold its interpreter's lock for long.

It reads at once, stamps the bytes, keeps the newest packet where the other can look at it, and hands all bytes over by
a pipe. Of what the other does not take, it keeps 16 MiB; then it reads no more, so that nothing is lost.

It ends when the other does: its standard input is a pipe that is never written, and ends with the other process. Where
a third process has inherited that pipe, it sees that it has another parent.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import select
import signal
import time
from collections.abc import Callable
from typing import Any

from ..clock import Stamp
from ..errors import RemoteError
from ..net.transport import TcpTransport
from ..wire.framing import FrameBoundary, Framer
from .hand_over import CONNECTED, DATA, LOST, HandedOver, Slot

__all__ = ["read_for"]

#: Bytes that wait for the other process: 25 s of real-time packets at 500 Hz.
_MOST_WAITING = 1 << 24
#: Bytes handed to the pipe at once: what it holds on Linux.
_PIPE = 1 << 16
#: Seconds between two looks whether the parent is still the same.
_LOOK = 0.5


class _Pipe:
    """The way to the other process, which is never waited for."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        os.set_blocking(descriptor, False)
        self._waiting = bytearray()

    @property
    def waiting(self) -> int:
        return len(self._waiting)

    def put(self, record: HandedOver) -> None:
        self._waiting += bytes(record)
        self.flush()

    def flush(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._waiting:
                del self._waiting[: os.write(self.descriptor, memoryview(self._waiting)[:_PIPE].tobytes())]


def read_for(parent: int, host: str, port: int, silence: float, timeout: float, slot: int, boundary: str) -> None:
    """Read a connection until it is lost or the other process ends.

    Args:
        parent: number of the other process.
        host, port, silence: of the connection, as for `TcpTransport`.
        timeout: seconds for it to be made.
        slot: descriptor of the shared memory.
        boundary: what packets look like: "module:class" of a `FrameBoundary`.
    """
    # Ctrl-C is for the other process, which ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    module, _, name = boundary.partition(":")
    make: Callable[[], FrameBoundary] = getattr(importlib.import_module(module), name)
    pipe = _Pipe(1)
    newest = Slot(slot)
    transport = TcpTransport(host, port, silence=silence)
    try:
        transport.open(timeout)
        pipe.put(HandedOver(CONNECTED, repr(transport.round_trip).encode(), Stamp.now()))
        _relay(transport, pipe, newest, Framer(make()), parent)
    except RemoteError as error:
        newest.clear()
        pipe.put(HandedOver(LOST, f"{type(error).__name__} {error}".encode(), Stamp.now()))
        # The other process may be busy; what it has not taken yet comes before this.
        while pipe.waiting and _is_wanted(parent, [], [pipe.descriptor])[0]:
            pipe.flush()
    except BrokenPipeError:
        pass  # it is gone
    finally:
        transport.abort()


def _relay(transport: TcpTransport, pipe: _Pipe, newest: Slot, framer: Framer, parent: int) -> None:
    """Read and hand over until the other process is gone.

    Raises:
        RemoteError: the connection was lost.
        BrokenPipeError: the other process is gone.
    """
    connection = transport.fileno()
    while True:
        reads = [connection] if pipe.waiting < _MOST_WAITING else []
        is_wanted, ready = _is_wanted(parent, reads, [pipe.descriptor] if pipe.waiting else [])
        if not is_wanted:
            return
        if connection in ready:
            received = transport.receive_waiting()
            if received is not None:
                data, stamp = received
                frames = framer.feed(data)
                if frames:
                    newest.put(bytes(frames[-1]), stamp)
                pipe.put(HandedOver(DATA, data, stamp))
        pipe.flush()


_looked = time.monotonic()


def _is_wanted(parent: int, reads: list[int], writes: list[int]) -> tuple[bool, list[Any]]:
    """Wait for something to do; whether the other process is still there, and what can be read."""
    global _looked
    ready, _, _ = select.select([*reads, 0], writes, [], _LOOK)
    if 0 in ready and not os.read(0, 1):
        return False, []
    now = time.monotonic()
    if now - _looked > _LOOK:
        _looked = now
        if os.getppid() != parent:
            return False, []
    return True, ready
