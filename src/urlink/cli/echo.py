"""`urlink echo` and `hz`: packets as lines, and how regularly they come."""

from __future__ import annotations

import argparse
import itertools
import math
from collections import deque
from collections.abc import Callable
from typing import Any, TypeGuard

from linkcore import clock
from linkcore.cli.options import DURATION, argument, command, positive_int, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.errors import LinkTimeout
from linkcore.streaming.statistics import StreamStatistics
from linkcore.streaming.stream import Stream
from linkcore.text import strict_json
from linkcore.wire.packet import State

from .. import packets
from ..protocol.ports import INTERFACES
from ..protocol.primary.robot_state import RobotState
from ..protocol.realtime.packets import RealtimeState
from ..robot import Robot
from .glance import counted
from .options import ADDRESS, Tap, connected, interface_of
from .values import NoSuchField, as_json, as_line, as_text, getter


def _packet_class(name: str) -> type[State]:
    kind = getattr(packets, name, None)
    if _is_packet_class(kind):
        return kind
    there = ", ".join(each for each in dir(packets) if _is_packet_class(getattr(packets, each)))
    raise argparse.ArgumentTypeError(f"{name!r} is no class of packets; there are {there}")


def _is_packet_class(value: object) -> TypeGuard[type[State]]:
    return isinstance(value, type) and issubclass(value, State)


#: What to print, and how.
PRINTED = (
    argument(
        "fields",
        metavar="FIELD",
        nargs="*",
        words=lambda: RealtimeState.FIELDS,
        trailing=True,
        help="print only these fields",
    ),
    argument("--interface", choices=INTERFACES, help="interface to read (realtime; primary where --type needs it)"),
    argument(
        "--type",
        metavar="CLASS",
        type=_packet_class,
        help="class of packet: RobotModeData, TextMessage, State for all, ...",
    ),
    argument("--json", action="store_true", help="one JSON object a line; NaN and infinities are null"),
    argument("--count", type=positive_int, metavar="N", help="end after N lines (never)"),
    argument("--timeout", type=seconds, metavar="S", help="fail when nothing comes for S seconds (never)"),
)


@command("echo", "print packets, one line each", *ADDRESS, *PRINTED)
def _echo(args: argparse.Namespace) -> int:
    """Print packets, one line each: every packet, in order.

    Without a FIELD a line has all of them. A field of the real-time interface is named as it is, q_actual; one of
    robot states (--interface primary) comes after its sub-package, joint_data.q_actual. --type selects
    sub-packages, messages or other packages by their class. A field that the controller does not send is "-",
    in JSON null. If the output is too slow, packets are dropped, and counted on stderr at the end.

    examples:
      urlink echo 192.168.56.101 q_actual tcp_force
      urlink echo sim:// --json --count 1
      urlink echo 192.168.56.101 --interface primary joint_data.T_motor robot_mode_data.robot_mode
      urlink echo 192.168.56.101 --type RobotMessage
    """
    interface, kind = kind_of(args)
    show = shower(args, kind)
    with connected(args) as robot:
        echo(robot, interface, kind, show, args)
    return 0


def kind_of(args: argparse.Namespace) -> tuple[str, type[State]]:
    """The interface to read and the class of packet to print."""
    interface = args.interface
    if args.type is None:
        interface = interface or "realtime"
        return interface, RealtimeState if interface == "realtime" else RobotState
    kind: type[State] = args.type
    if interface is None:
        interface = "realtime" if kind is RealtimeState else "primary"
    if (interface == "realtime") != (kind is RealtimeState) and kind is not State:
        args.usage_error(f"{kind.__name__} does not come on the {interface} interface")
    return interface, kind


def shower(args: argparse.Namespace, kind: type[State]) -> Callable[[State], str]:
    """The function that makes a line of a packet."""
    try:
        getters = {path: getter(kind, path) for path in args.fields}
    except NoSuchField as error:
        args.usage_error(str(error))
    if args.json:
        return lambda packet: strict_json(as_json(packet, getters))
    if getters:
        return lambda packet: " ".join(f"{path}={as_text(get(packet))}" for path, get in getters.items())
    return as_line


def echo(
    robot: Robot, interface: str, kind: type[State], show: Callable[[State], str], args: argparse.Namespace
) -> None:
    """Print the packets of one class on one interface.

    Raises:
        RemoteError: the stream could not be opened, gave up, or was silent for longer than `--timeout`.
    """
    # On a terminal this is shown only while no packet is printed.
    with (
        ProgressBar(f"waiting for {kind.__name__}", args.quiet) as progress,
        Tap(getattr(robot, interface), kind) as tap,
    ):
        for number, packet in enumerate(itertools.islice(tap.packets(args.timeout), args.count), 1):
            print(show(packet), flush=True)  # line by line: the reader of a pipe gets each line at once
            progress(number / (args.count or math.inf), f"{number} packets printed")


@command(
    "hz",
    "measure how regularly states come",
    *ADDRESS,
    interface_of(INTERFACES),
    argument("--window", type=positive_int, default=1000, metavar="N", help="periods to look back on (1000)"),
    DURATION,
)
def _hz(args: argparse.Namespace) -> int:
    """Measure how regularly states come, by the times at which their bytes arrived here.

    One line a second: the rate, the shortest, mean and longest period and its standard deviation over the
    last --window periods, and what the stream has counted since the start; missed is what never came, and
    duplicates what came twice, by the controller's own clock. States that arrive in one segment have a period
    of zero between them. On e-Series the real-time interface sends 500 states a second, on CB2 and CB3 125,
    the primary and secondary interface 10.

    examples:
      urlink hz 192.168.56.101
      urlink hz sim:// --duration 10 --window 5000
      urlink hz 192.168.56.101 --interface primary
    """
    kind = RealtimeState if args.interface == "realtime" else RobotState
    with connected(args) as robot:
        measure(getattr(robot, args.interface), kind, args.window, args.duration, quiet=args.quiet)
    return 0


def measure(
    stream: Stream[Any],
    kind: type[State],
    window: int,
    duration: float | None,
    count: int | None = None,
    *,
    quiet: bool = False,
) -> None:
    """Print a line each second, for `duration` seconds, `count` lines, or until the stream ends.

    Raises:
        RemoteError: the stream could not be opened, gave up, or no state came.
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
