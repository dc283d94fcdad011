"""RHD server that runs the scripts of the test, one script for each connection."""

from __future__ import annotations

import select
import socket
import struct
import threading
from collections.abc import Callable, Iterator

import numpy as np

from rhdlink.variables.database import Database, TimeStamp
from rhdlink.wire.data import DataPackage, Words
from rhdlink.wire.messages import SymbolRow

#: Time limit in seconds; a client that sends nothing for this time fails the test.
TIMEOUT = 10.0


class Peer:
    """Server side of one connection.

    Attributes:
        heard: All data from the client that a script has read.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self.heard = b""

    def expect(self, expected: bytes) -> None:
        """Read as many bytes as expected, and check that they equal the expected bytes."""
        there = self.read(len(expected))
        assert there == expected, f"the client sent {there!r}; expected {expected!r}"

    def read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            more = self._socket.recv(size - len(data))
            assert more, f"the client left after {data!r}"
            data += more
        self.heard += data
        return data

    def send(self, *data: bytes) -> None:
        for each in data:
            self._socket.sendall(each)

    def is_left(self) -> bool:
        """Wait for the client to leave; return False if it sends more data instead."""
        try:
            return self._socket.recv(1) == b""
        except ConnectionError:
            return True

    def hears_nothing(self) -> bool:
        """Whether no data has arrived so far."""
        return not select.select([self._socket], [], [], 0)[0]

    def reset(self) -> None:
        """Make the close of the connection a reset, as for a crashed program."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


Script = Callable[[Peer], object]


class ScriptedServer:
    """Server that runs its scripts in a thread, one for each connection, one after another.

    Leaving the context waits for the end of the scripts, and raises the error of a failed script.
    """

    def __init__(self, *scripts: Script) -> None:
        self._scripts = scripts
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(TIMEOUT)
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> ScriptedServer:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        if kind is not None:
            self._listener.close()  # the test has failed, so no more clients will connect
        self._thread.join(2 * TIMEOUT)
        self._listener.close()
        if kind is None and self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        try:
            for script in self._scripts:
                connection, _ = self._listener.accept()
                with connection:
                    connection.settimeout(TIMEOUT)
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    script(Peer(connection))
        except BaseException as failure:
            self._failure = failure


class Robot:
    """Robot side for scripts, with one read variable, two write variables, and a tick."""

    def __init__(self, read: tuple[str, ...] = ("tick", "encl"), write: tuple[str, ...] = ("speedl", "speedr")) -> None:
        self.database = Database([SymbolRow(name, 1) for name in read], [SymbolRow(name, 1) for name in write])

    def greet(self, peer: Peer, access: str = "r") -> None:
        peer.expect(b"a" + access.encode())
        peer.send(self.database.encode_handshake(access))

    def batch(self, tick: int, **values: int) -> bytes:
        """Return a batch of the tick `tick`, with a time stamp of `tick` centiseconds."""
        read = self.database.read
        for name, value in {"tick": tick, **values}.items():
            read.set(read.find(name) or 0, value, TimeStamp(1000, 10_000 * tick))
        return b"dw\0\0\0\0" + read.encode(read.dirty.take()) + b"ee"

    def write(self, **values: int) -> bytes:
        """Return the message of a writer that sets these values, except for its time stamps."""
        write = Database(write=self.database.write.rows).write
        for name, value in values.items():
            write.set(write.find(name) or 0, value, TimeStamp(0, 0))
        return b"rw" + write.encode(write.dirty.take()) + b"ee"


def nothing_more_after_greeting(peer: Peer) -> None:
    Robot().greet(peer)
    assert peer.is_left()


def serving(side: Robot, access: str = "r", syncs: int = 0) -> Script:
    def script(peer: Peer) -> None:
        side.greet(peer, access)
        for tick in range(1, syncs + 1):
            peer.read(2)
            while not peer.heard.endswith(b"ee"):
                peer.read(1)
            peer.send(side.batch(tick))
        assert peer.is_left()

    return script


def endless(side: Robot, access: str = "r") -> Script:
    def script(peer: Peer) -> None:
        side.greet(peer, access)
        tick = 0
        try:
            while True:
                peer.expect(b"rree")
                tick += 1
                peer.send(side.batch(tick, encl=tick // 2))
        except (AssertionError, ConnectionError):
            assert tick  # the client left, after at least one tick

    return script


def entries(package: DataPackage) -> Iterator[tuple[int, tuple[int, int], Words]]:
    """Yield each entry of a data package: id, (seconds, microseconds), values."""
    values, starts = package.values, package.selection.starts
    sizes = np.diff(starts, append=len(values))
    for identity, start, size, (seconds, micros) in zip(
        package.ids.tolist(), starts.tolist(), sizes.tolist(), package.stamps.tolist(), strict=True
    ):
        yield identity, (seconds, micros), values[start : start + size]
