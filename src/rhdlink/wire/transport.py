"""What carries the bytes between a client and a server."""

from __future__ import annotations

from typing import Protocol

from linkcore.clock import Stamp


class Transport(Protocol):
    """The transport of a connection: `linkcore.net.transport.TcpTransport`, or `rhdlink.mqtt.mqtt_transport`."""

    name: str

    def open(self, timeout: float) -> None:
        """Connect."""

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes."""

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """Return bytes that have already arrived, or None. Does not wait."""

    def send(self, data: bytes, timeout: float) -> None:
        """Send all bytes."""

    def abort(self) -> None:
        """Disconnect immediately and wake waiting threads.

        Bytes that the peer has not acknowledged are discarded.
        """

    def close(self) -> None:
        """Disconnect, after a short wait for the peer to acknowledge the sent bytes.

        Wake waiting threads.
        """
