"""What a stream publishes beside packets: changes of its connection, and the bytes as they were received."""

from __future__ import annotations

import enum
from typing import NamedTuple

from ..stamp import Stamp

__all__ = ["Chunk", "ConnectionEvent", "ConnectionState", "Traffic"]


class ConnectionState(enum.Enum):
    """What a stream's connection is doing."""

    IDLE = "idle"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    LOST = "lost"
    CLOSED = "closed"


class ConnectionEvent(NamedTuple):
    """A change of a stream's connection; subscribe to it as to a packet.

    Attributes:
        state: the new state.
        stream: name of the stream.
        error: what ended the connection, or None.
        received: when it was noticed.
    """

    state: ConnectionState
    stream: str
    error: Exception | None
    received: Stamp


class Traffic:
    """Base class of `Chunk` and `ConnectionEvent`: a subscription to it gets both, in order."""

    IS_EVENT = True


class Chunk(NamedTuple):
    """Bytes as they came, and when."""

    data: bytes
    received: Stamp
