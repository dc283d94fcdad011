"""Client that sends exactly the bytes that a test gives it, to test a host."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Mapping, Sequence
from types import TracebackType

from rhdlink.variables.database import Database
from rhdlink.wire.decoder import ServerDecoder
from rhdlink.wire.messages import Batch, Handshake

#: Seconds of silence after which the test fails.
TIMEOUT = 10.0


class RawClient:
    """Connection to a host on this machine.

    Args:
        port: Port of the host.
        access: Bytes that are sent immediately; b"" sends none.
        width: Words of a time stamp, 2 or 4.
    """

    def __init__(self, port: int, access: bytes = b"ar", *, width: int = 2) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.stream = ServerDecoder(width=width)
        self.width = width
        self.send(access)

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def greeting(self) -> Handshake:
        while (handshake := self.stream.take_handshake()) is None:
            self._receive()
        self.tables = Database(handshake.read, handshake.write)
        for data in handshake.data:
            self.tables.table(data.direction).receive(data)
        return handshake

    def raw(self) -> bytes:
        """Return the bytes of the next batch, which must not have arrived yet."""
        parts: list[bytes] = []
        feed = self.stream.feed

        def noted(data: bytes) -> None:
            parts.append(data)
            feed(data)

        self.stream.feed = noted  # type: ignore[method-assign]
        self.batch()
        self.stream.feed = feed  # type: ignore[method-assign]
        return b"".join(parts)

    def batch(self) -> Batch:
        while (batch := self.stream.take_batch()) is None:
            self._receive()
        for data in batch.data:
            self.tables.table(data.direction).receive(data)
        return batch

    def _receive(self) -> None:
        data = self.socket.recv(1 << 16)
        if not data:
            raise ConnectionError("closed by the host")
        self.stream.feed(data)

    def sync(self, values: Mapping[str, int | Sequence[int]] | None = None) -> Batch:
        """Send a request as a reader, or with values as a writer, and return the reply."""
        self.send(b"rree" if values is None else self.request(values))
        return self.batch()

    def request(self, values: Mapping[str, int | Sequence[int]]) -> bytes:
        table = self.tables.write
        parts = [b"rwdw" + struct.pack(">i", len(values))]
        for name, value in values.items():
            identity = table.find(name)
            assert identity is not None
            words = [value] if isinstance(value, int) else list(value)
            parts.append(struct.pack(f">i{self.width + len(words)}i", identity, *[0] * self.width, *words))
        return b"".join(parts) + b"ee"

    def words(self, name: str) -> list[int]:
        """Return the words of a variable that the host sent last."""
        for table in (self.tables.read, self.tables.write):
            if (identity := table.find(name)) is not None:
                return list(map(int, table.value(identity)))
        raise KeyError(name)

    def value(self, name: str) -> int:
        """Return the first word of a variable."""
        return self.words(name)[0]

    def is_closed(self) -> bool:
        """Whether the host closes the connection in time; data that arrives before is discarded."""
        try:
            while self.socket.recv(1 << 16):
                pass
        except ConnectionError:
            return True
        except TimeoutError:
            return False
        return True

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.socket.close()

    def __enter__(self) -> RawClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
