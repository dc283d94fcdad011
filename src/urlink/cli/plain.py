"""The monitor as a line of text, where stdout is no terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from linkcore.streaming.statistics import StreamStatistics
from linkcore.text import printable

from .glance import Glance, Status, rate_text

__all__ = ["age_text", "counted", "line"]


def line(glance: Glance, clock: str) -> str:
    """One line with the most important values; old values are marked as old."""
    parts = [f"{clock} {glance.status.value}", printable(glance.robot)]
    reading, stats = glance.reading, glance.stats
    if glance.is_fresh:
        parts.append(rate_text(glance))
    elif glance.trouble is not None and glance.status is not Status.ENDED:
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
