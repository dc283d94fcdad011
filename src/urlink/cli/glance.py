"""All that the monitor knows at one moment, ready to be shown as a picture or as a line."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from linkcore.streaming.events import ConnectionState
from linkcore.streaming.statistics import StreamStatistics

from .reading import Reading

__all__ = ["Glance", "Status", "status_of"]

#: Data older than this, in seconds, is called old while the connection still stands: five states of the slow
#: interfaces, 60 and more of the real-time one.
FRESH = 0.5


class Status(enum.Enum):
    """In one word, whether what is shown is what is."""

    CONNECTING = "CONNECTING"
    WAITING = "WAITING"
    CONNECTED = "CONNECTED"
    SILENT = "SILENT"
    LOST = "LOST"
    ENDED = "ENDED"


def status_of(connection: ConnectionState, has_latest: bool, reading: Reading | None) -> Status:
    """The status of a stream.

    Args:
        connection: of the stream.
        has_latest: whether the stream still vouches for its newest state.
        reading: the last that was read, maybe long ago.
    """
    if connection is ConnectionState.CLOSED:
        return Status.ENDED
    if connection is ConnectionState.CONNECTED:
        if reading is None:
            return Status.WAITING
        return Status.CONNECTED if has_latest and reading.age <= FRESH else Status.SILENT
    # A lost connection is tried again and again; that is still lost.
    return Status.CONNECTING if reading is None else Status.LOST


@dataclass(frozen=True)
class Glance:
    """One moment of the monitor.

    Attributes:
        robot: model and firmware.
        address: what was connected to, and which interface of it.
        status: whether the reading can be trusted.
        reading: the newest, or the last before the connection was lost; None before the first.
        stats: of the stream.
        rate: states a second; None where that cannot be told yet.
        trouble: what ended the connection last, or None.
        message: the last robot message, or None.
    """

    robot: str
    address: str
    status: Status
    reading: Reading | None
    stats: StreamStatistics
    rate: float | None = None
    trouble: str | None = None
    message: str | None = None

    @property
    def is_fresh(self) -> bool:
        """Whether the reading shows what is, and not what was."""
        return self.status is Status.CONNECTED
