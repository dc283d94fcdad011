"""What the monitor knows at one moment, to be shown as a picture or as a line."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from linkcore.streaming.events import ConnectionState
from linkcore.streaming.statistics import StreamStatistics

from .reading import Reading

__all__ = ["Glance", "Status", "rate_text", "status_of"]

#: Data older than this, in seconds, counts as old although the connection stands: five states of the 10 Hz
#: interfaces, 60 and more of the real-time one.
FRESH = 0.5
#: Part of the usual rate below which states are missing, however fresh the newest is.
ENOUGH = 0.95


class Status(enum.Enum):
    """State of a stream in one word: whether the values that are shown are current."""

    CONNECTING = "CONNECTING"
    WAITING = "WAITING"
    CONNECTED = "CONNECTED"
    SLOW = "SLOW"
    SILENT = "SILENT"
    LOST = "LOST"
    ENDED = "ENDED"


def status_of(
    connection: ConnectionState,
    has_latest: bool,
    reading: Reading | None,
    rate: float | None = None,
    usual: float | None = None,
) -> Status:
    """The status of a stream.

    Args:
        connection: of the stream.
        has_latest: whether the stream has a newest state; `latest` of a stream is None after a lost connection.
        reading: the last one, possibly old; None before the first state.
        rate: states per second; None where it is not known.
        usual: states per second that the controller sends; None where that is not known.
    """
    if connection is ConnectionState.CLOSED:
        return Status.ENDED
    if connection is ConnectionState.CONNECTED:
        if reading is None:
            return Status.WAITING
        if not has_latest or reading.age > FRESH:
            return Status.SILENT
        is_slow = rate is not None and usual is not None and rate < ENOUGH * usual
        return Status.SLOW if is_slow else Status.CONNECTED
    # A lost connection that is being tried again is still lost.
    return Status.CONNECTING if reading is None else Status.LOST


@dataclass(frozen=True)
class Glance:
    """One moment of the monitor.

    Attributes:
        robot: model and firmware.
        address: what was connected to, and which interface of it.
        status: whether the reading is current.
        reading: the newest, or the last before the connection was lost; None before the first.
        stats: of the stream.
        rate: states per second; None in the first second.
        usual: states per second that the controller sends; None where that is not known.
        trouble: the last error of the connection, or None.
        message: the last robot message, or None.
    """

    robot: str
    address: str
    status: Status
    reading: Reading | None
    stats: StreamStatistics
    rate: float | None = None
    usual: float | None = None
    trouble: str | None = None
    message: str | None = None

    @property
    def is_fresh(self) -> bool:
        """Whether the reading is current."""
        return self.status in (Status.CONNECTED, Status.SLOW)


def rate_text(glance: Glance) -> str:
    """The rate, and what it should be where it is too low: "111.0 of 500 Hz"."""
    if glance.rate is None:
        return "- Hz"
    of = f" of {glance.usual:g}" if glance.status is Status.SLOW else ""
    return f"{glance.rate:.1f}{of} Hz"
