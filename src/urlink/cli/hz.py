"""`urlink hz`: how regularly packets come."""

from __future__ import annotations

import argparse
import math
import time
from collections import deque
from typing import Any

from linkcore.errors import LinkTimeout
from linkcore.streaming.statistics import StreamStatistics
from linkcore.streaming.stream import Stream
from linkcore.wire.packet import State

from ..decoding import INTERFACES
from ..interfaces.primary.robot_state import RobotState
from ..interfaces.realtime.packets import RealtimeState
from ..robot import connect
from .glance import counted
from .options import ADDRESS, DURATION, Tap, argument, command, interface_of, positive_int

__all__ = ["line", "measure"]


@command(
    "hz",
    "measure how regularly states come",
    *ADDRESS,
    interface_of(INTERFACES),
    argument("--window", type=positive_int, default=1000, metavar="N", help="periods to look back on (1000)"),
    DURATION,
)
def run(args: argparse.Namespace) -> int:
    """Measure how regularly states come, by the times at which their bytes arrived here.

    One line a second: the rate, the shortest, mean and longest period and its standard deviation over the
    last --window periods, and what the stream has counted since the start; missed is what never came, by the
    controller's own clock. States that arrive in one segment have a period of zero between them. On e-Series
    the real-time interface sends 500 states a second, on CB2 and CB3 125, the primary and secondary interface
    10.

    examples:
      urlink hz 192.168.56.101
      urlink hz sim:// --duration 10 --window 5000
      urlink hz 192.168.56.101 --interface primary
    """
    kind = RealtimeState if args.interface == "realtime" else RobotState
    with connect(args.address, timeout=args.connect_timeout) as robot:
        measure(getattr(robot, args.interface), kind, args.window, args.duration)
    return 0


def measure(
    stream: Stream[Any], kind: type[State], window: int, duration: float | None, count: int | None = None
) -> None:
    """Print a line each second, for `duration` seconds, `count` lines, or until the stream ends.

    Raises:
        RemoteError: the stream could not be opened, gave up, or no state came.
    """
    periods: deque[float] = deque(maxlen=window)
    last: float | None = None
    fresh = lines = 0
    with Tap(stream, kind) as tap:
        until = math.inf if duration is None else time.monotonic() + duration
        due = min(time.monotonic() + 1.0, until)
        is_over = False
        while not is_over:
            packets = tap.take(max(due - time.monotonic(), 0.0))
            for packet in packets or ():
                arrived = packet.received.monotonic
                if last is not None:
                    periods.append(arrived - last)
                last = arrived
                fresh += 1
            now = time.monotonic()
            is_over = packets is None or now >= until
            if now >= due or is_over:
                print(line(periods, fresh, stream.stats), flush=True)
                due, fresh, lines = min(due + 1.0, until), 0, lines + 1
                is_over = is_over or lines == count
    if last is None:
        raise LinkTimeout(f"{stream.name}: no state came")


def line(periods: deque[float], fresh: int, stats: StreamStatistics) -> str:
    """One line about the last periods; `fresh` is how many states have come since the line before."""
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
