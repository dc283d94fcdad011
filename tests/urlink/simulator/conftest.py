"""Raw TCP client for the simulated controller, independent of the client code of the library."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from urlink.simulator import Controller

TIMEOUT = 120.0


class Link:
    """Connection to one port of a controller."""

    def __init__(self, controller: Controller, port: str) -> None:
        self.socket = socket.create_connection((controller.host, controller.ports[port]), timeout=TIMEOUT)

    def exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self.socket.recv(count - len(data))
            assert more, f"closed after {len(data)} of {count} bytes"
            data += more
        return data

    def packet(self) -> bytes:
        head = self.exactly(4)
        return head + self.exactly(int.from_bytes(head, "big") - 4)

    def segment(self) -> bytes:
        data = self.socket.recv(65536)
        assert data, "closed"
        return data

    def until(self, wanted: Callable[[bytes], bool]) -> bytes:
        """Return the first packet that `wanted` accepts."""
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            packet = self.packet()
            if wanted(packet):
                return packet
        raise AssertionError("no such packet arrived")

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def is_ended(self) -> bool:
        """Whether the connection ends before the timeout; data that arrives until then is discarded."""
        deadline = time.monotonic() + TIMEOUT
        try:
            while time.monotonic() < deadline:
                if not self.socket.recv(65536):
                    return True
        except ConnectionError:
            return True
        except TimeoutError:
            return False
        return False

    def close(self) -> None:
        self.socket.close()


@pytest.fixture
def connect() -> Iterator[Callable[[Controller, str], Link]]:
    """Function that opens a connection; all connections are closed after the test."""
    with contextlib.ExitStack() as links:

        def connect(controller: Controller, port: str) -> Link:
            link = Link(controller, port)
            links.callback(link.close)
            return link

        yield connect


@pytest.fixture
def eventually() -> Callable[[Callable[[], object]], None]:
    """Function that waits until a condition is true, and fails after `TIMEOUT` seconds."""

    def eventually(condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < deadline, "the condition did not become true in time"
            time.sleep(0.002)

    return eventually
