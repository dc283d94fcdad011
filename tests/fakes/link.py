"""Scripted transport and tiny protocol, to test streams without a network."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import linkcore.clock
from linkcore.clock import Stamp
from linkcore.errors import ConnectionLost, LinkTimeout, PacketError
from linkcore.net.transport import Transport
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.stream import Stream
from linkcore.wire.cycles import MissedCycles
from linkcore.wire.fields import Header, Int8ub, Int32ub
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State, packet, wire

HEADER = Header(size=Int8ub)


@packet(header=HEADER)
class Count(State):
    """Packet of five bytes: a size and a number."""

    number: int = wire(Int32ub)


class CountBoundary:
    largest = 5
    pace = 1
    size, head = 0, b""
    last: bytes | bytearray = b""

    def __str__(self) -> str:
        return "counts"

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        return []

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        return (5, 5) if buffer[at] == 5 else (0, 0)

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        at = buffer.find(b"\x05", start)
        return (len(buffer), 0, 1) if at < 0 else (at, 5, 5)

    def peer(self, buffer: bytes | bytearray) -> str | None:
        return None


AT_ONCE = Backoff(first=0, most=0)

#: Number that cannot be decoded.
BAD = 666


class CountProtocol:
    def __init__(self) -> None:
        self.framer = Framer(CountBoundary())
        self.unknown = self.tails = 0
        self.cycles: MissedCycles | None = None

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> Count:
        count: Count = Count.LAYOUTS.decode(frame, None, stamp)
        if count.number == BAD:
            raise PacketError("bad on purpose", packet="Count")
        return count


def counts(*numbers: int) -> bytes:
    return b"".join(bytes(Count(number=number)) for number in numbers)


def output_of(program: str) -> str:
    """Run a Python program, and return its output; its argument is a port that sends a `Count` every 10 ms."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(30)
        command = [sys.executable, "-c", program, str(server.getsockname()[1])]
        root = Path(__file__).resolve().parents[2]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root) as process:
            connection, _ = server.accept()
            stop = threading.Event()

            def send() -> None:
                with connection:
                    number = 0
                    while not stop.wait(0.01):
                        number += 1
                        try:
                            connection.sendall(counts(number))
                        except OSError:
                            return

            sender = threading.Thread(target=send, daemon=True)
            sender.start()
            out, _ = process.communicate(timeout=40)
            stop.set()
            sender.join(10)
    return out


class ScriptedTransport:
    """Transport with scripted input: it receives the bytes, and raises the exceptions, that the test puts.

    `openings` holds the result of each `open`: None for success, or an exception to raise.
    """

    name = "script"
    round_trip = 1e-4

    def __init__(self, *openings: Exception | None) -> None:
        self._openings = list(openings)
        self._items: deque[bytes | Exception] = deque()
        self._changed = threading.Condition()
        self.is_closed = True
        self.opened = 0
        self.sent: list[bytes] = []
        #: Exception that the next `send` raises.
        self.refusal: Exception | None = None
        #: Number of bytes that `send_some` accepts until the next `make_room`; None for no limit.
        self.room: int | None = None

    def put(self, *items: bytes | Exception) -> None:
        with self._changed:
            self._items.extend(items)
            self._changed.notify_all()

    def open(self, timeout: float) -> None:
        self.opened += 1
        outcome = self._openings.pop(0) if self._openings else None
        if outcome is not None:
            raise outcome
        with self._changed:
            self.is_closed = False

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        with self._changed:
            came = self._changed.wait_for(
                lambda: self._items or self.is_closed, timeout=30 if timeout is None else timeout
            )
            if self.is_closed:
                raise ConnectionLost("closed here")
            if not came:
                assert timeout is not None, "the test has put no data for 30 s"
                raise LinkTimeout("no data has arrived")
            item = self._items.popleft()
        if isinstance(item, Exception):
            raise item
        return item, Stamp(linkcore.clock.now(), time.time())

    def send(self, data: bytes, timeout: float) -> None:
        refusal, self.refusal = self.refusal, None
        if refusal is not None:
            raise refusal
        self.sent.append(data)

    def send_some(self, data: bytes | memoryview) -> int:
        refusal, self.refusal = self.refusal, None
        if refusal is not None:
            raise refusal
        if self.is_closed:
            raise ConnectionLost("script is not connected")
        with self._changed:
            count = len(data) if self.room is None else min(self.room, len(data))
            if self.room is not None:
                self.room -= count
        if count:
            self.sent.append(bytes(data[:count]))
        return count

    def wait_for_room(self, timeout: float) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: self.room != 0 or self.is_closed, timeout)
            if self.is_closed:
                raise ConnectionLost("script is not connected")
            return self.room != 0

    def make_room(self, room: int | None) -> None:
        with self._changed:
            self.room = room
            self._changed.notify_all()

    def abort(self) -> None:
        with self._changed:
            self.is_closed = True
            self._changed.notify_all()

    def close(self) -> None:
        self.abort()


def connection_over(
    transport: Transport, *, name: str = "script", backoff: Backoff = AT_ONCE, silence: float | None = None
) -> Connection:
    """Return a connection of `Count` over a transport."""
    return Connection(name, transport, CountProtocol, FanOut(Count), backoff=backoff, silence=silence)


def scripted(transport: Transport, *, lossless: bool = False, **options: Any) -> Stream[Count]:
    """Return a stream of `Count` over a transport; see `connection_over`."""
    return Stream(connection_over(transport, **options), Count, lossless=lossless)
