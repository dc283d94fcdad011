"""What the monitor knows at one moment, as a picture, or as a line of text where stdout is not a terminal."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.statistics import StreamStatistics
from linkcore.text import printable

from .reading import Reading

#: Data older than this, in seconds, counts as old although the connection stands: five states of the 10 Hz
#: interfaces, 60 and more of the real-time one.
FRESH = 0.5
#: Part of the usual rate below which states are missing, however fresh the newest is.
ENOUGH = 0.95


class StreamStatus(enum.Enum):
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
) -> StreamStatus:
    """The status of a stream.

    Args:
        connection: of the stream.
        has_latest: whether the stream has a newest state; `latest` of a stream is None after a lost connection.
        reading: the last one, possibly old; None before the first state.
        rate: states per second; None where it is not known.
        usual: states per second that the controller sends; None where that is not known.
    """
    if connection is ConnectionState.CLOSED:
        return StreamStatus.ENDED
    if connection is ConnectionState.CONNECTED:
        if reading is None:
            return StreamStatus.WAITING
        if not has_latest or reading.age > FRESH:
            return StreamStatus.SILENT
        is_slow = rate is not None and usual is not None and rate < ENOUGH * usual
        return StreamStatus.SLOW if is_slow else StreamStatus.CONNECTED
    # A lost connection that is being tried again is still lost.
    return StreamStatus.CONNECTING if reading is None else StreamStatus.LOST


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
    status: StreamStatus
    reading: Reading | None
    stats: StreamStatistics
    rate: float | None = None
    usual: float | None = None
    trouble: str | None = None
    message: str | None = None

    @property
    def is_fresh(self) -> bool:
        """Whether the reading is current."""
        return self.status in (StreamStatus.CONNECTED, StreamStatus.SLOW)


def rate_text(glance: Glance) -> str:
    """The rate, and what it should be where it is too low: "111.0 of 500 Hz"."""
    if glance.rate is None:
        return "- Hz"
    of = f" of {glance.usual:g}" if glance.status is StreamStatus.SLOW else ""
    return f"{glance.rate:.1f}{of} Hz"


def line(glance: Glance, clock: str) -> str:
    """One line with the most important values; old values are marked as old."""
    parts = [f"{clock} {glance.status.value}", printable(glance.robot)]
    reading, stats = glance.reading, glance.stats
    if glance.is_fresh:
        parts.append(rate_text(glance))
    elif glance.trouble is not None and glance.status is not StreamStatus.ENDED:
        parts.append(printable(glance.trouble))
    if reading is None:
        parts.append("no state yet")
    else:
        parts.append(f"age {age_text(reading.age)}" if glance.is_fresh else f"OLD DATA, {age_text(reading.age)}")
        if reading.q is not None:
            parts.append(f"q {_vector([math.degrees(value) for value in reading.q], 1)} deg")
        if reading.pose is not None:
            parts.append(f"tool {_vector(reading.pose[:3], 3)} m")
        modes = (("robot", reading.robot_mode), ("safety", reading.safety_mode), ("program", reading.program))
        parts += [f"{name} {printable(mode)}" for name, mode in modes if mode is not None]
    return " | ".join([*parts, counted(stats)])


def counted(stats: StreamStatistics) -> str:
    """What a stream has counted, short; "-" where packets have no clock by which one can be missed."""
    missed = "-" if stats.missed is None else stats.missed
    return f"received {stats.received} missed {missed} failed {stats.failed} reconnects {stats.reconnects}"


def age_text(seconds: float) -> str:
    """An age, short: ``2 ms``, ``3.4 s``, ``12 min``."""
    if seconds < 1.0:
        return f"{seconds * 1000:.0f} ms"
    return f"{seconds:.1f} s" if seconds < 600.0 else f"{seconds / 60:.0f} min"


def _vector(values: Sequence[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)
