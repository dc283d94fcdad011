"""Measurement of the rate and jitter of a stream, printed once per second, for `hz` and `rtde --hz`."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from linkcore import clock
from linkcore.cli.progress import ProgressBar
from linkcore.errors import LinkTimeout
from linkcore.streaming.statistics import StreamStatistics
from linkcore.streaming.stream import Stream
from linkcore.wire.packet import State

from .packet_stream import Tap, counted


def measure(
    stream: Stream[Any],
    kind: type[State],
    window: int,
    duration: float | None,
    count: int | None = None,
    *,
    quiet: bool = False,
) -> None:
    """Print a line each second until the stream ends, or until `duration` seconds or `count` lines are reached.

    Raises:
        RemoteError: If the stream could not be opened or gave up reconnecting, or if no state arrived.
    """
    periods: deque[float] = deque(maxlen=window)
    last: float | None = None
    fresh = lines = 0
    with ProgressBar(f"measuring {stream.name}", quiet) as progress, Tap(stream, kind) as tap:
        begun = clock.now()
        until = math.inf if duration is None else clock.now() + duration
        due = min(clock.now() + 1.0, until)
        is_over = False
        while not is_over:
            packets = tap.take(clock.left(due))
            for packet in packets or ():
                arrived = packet.received.monotonic
                if last is not None:
                    periods.append(arrived - last)
                last = arrived
                fresh += 1
            now = clock.now()
            is_over = packets is None or now >= until
            if now >= due or is_over:
                print(line(periods, fresh, stream.stats), flush=True)
                due, fresh, lines = min(due + 1.0, until), 0, lines + 1
                is_over = is_over or lines == count
                progress(max((now - begun) / (duration or math.inf), lines / (count or math.inf)))
    if last is None:
        raise LinkTimeout(f"{stream.name}: no state arrived")


def line(periods: deque[float], fresh: int, stats: StreamStatistics) -> str:
    """Format a line about the last periods; `fresh` is the number of states since the previous line."""
    counters = counted(stats)
    if not fresh:
        return f"no new states | {counters}"
    if not periods:
        return f"one state so far | {counters}"
    mean = sum(periods) / len(periods)
    spread = math.sqrt(sum((period - mean) ** 2 for period in periods) / len(periods))
    rate = f"{1.0 / mean:.2f} Hz" if mean > 0.0 else "- Hz"
    return (
        f"{rate} | period min {min(periods) * 1e3:.3f} mean {mean * 1e3:.3f} max {max(periods) * 1e3:.3f} "
        f"std {spread * 1e3:.3f} ms | window {len(periods)} | {counters}"
    )
