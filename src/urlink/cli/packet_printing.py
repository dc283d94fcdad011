"""Printing of packets of an interface: the options and output lines of `echo` and `replay`."""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable
from typing import TypeGuard

from linkcore.cli.options import argument, positive_int, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.text import strict_json
from linkcore.wire.packet import State

from .. import packets
from ..protocol.ports import INTERFACES
from ..protocol.primary.robot_state import RobotState
from ..protocol.realtime.packets import RealtimeState
from ..robot import Robot
from .packet_fields import NoSuchField, as_json, as_line, as_text, getter
from .packet_stream import Tap


def _packet_class(name: str) -> type[State]:
    kind = getattr(packets, name, None)
    if _is_packet_class(kind):
        return kind
    there = ", ".join(each for each in dir(packets) if _is_packet_class(getattr(packets, each)))
    raise argparse.ArgumentTypeError(f"{name!r} is not a class of packets; expected one of {there}")


def _is_packet_class(value: object) -> TypeGuard[type[State]]:
    return isinstance(value, type) and issubclass(value, State)


#: Options for what to print, and in which format.
PRINTED = (
    argument(
        "fields",
        metavar="FIELD",
        nargs="*",
        words=lambda: RealtimeState.FIELDS,
        trailing=True,
        help="print only these fields",
    ),
    argument("--interface", choices=INTERFACES, help="interface to read (default: realtime, or as --type requires)"),
    argument(
        "--type",
        metavar="CLASS",
        type=_packet_class,
        help="class of packet: RobotModeData, TextMessage, State for all, ...",
    ),
    argument("--json", action="store_true", help="print one JSON object per line; NaN and infinities are null"),
    argument("--count", type=positive_int, metavar="N", help="end after N lines (default: never)"),
    argument("--timeout", type=seconds, metavar="S", help="fail if nothing arrives for S seconds (default: never)"),
)


def kind_of(args: argparse.Namespace) -> tuple[str, type[State]]:
    """Return the interface to read and the class of packets to print."""
    interface = args.interface
    if args.type is None:
        interface = interface or "realtime"
        return interface, RealtimeState if interface == "realtime" else RobotState
    kind: type[State] = args.type
    if interface is None:
        interface = "realtime" if kind is RealtimeState else "primary"
    if (interface == "realtime") != (kind is RealtimeState) and kind is not State:
        args.usage_error(f"the {interface} interface does not send {kind.__name__}")
    return interface, kind


def shower(args: argparse.Namespace, kind: type[State]) -> Callable[[State], str]:
    """Return the function that formats a packet as a line."""
    try:
        getters = {path: getter(kind, path) for path in args.fields}
    except NoSuchField as error:
        args.usage_error(str(error))
    if args.json:
        return lambda packet: strict_json(as_json(packet, getters))
    if getters:
        return lambda packet: " ".join(f"{path}={as_text(get(packet))}" for path, get in getters.items())
    return as_line


def print_packets(
    robot: Robot, interface: str, kind: type[State], show: Callable[[State], str], args: argparse.Namespace
) -> None:
    """Print the packets of one class on one interface.

    Raises:
        RemoteError: If the stream could not be opened, gave up reconnecting, or was silent for longer than `--timeout`.
    """
    # On a terminal, the progress bar is shown only until the first packet is printed.
    with (
        ProgressBar(f"waiting for {kind.__name__}", args.quiet) as progress,
        Tap(getattr(robot, interface), kind) as tap,
    ):
        for number, packet in enumerate(itertools.islice(tap.packets(args.timeout), args.count), 1):
            print(show(packet), flush=True)  # flushed, so that the reader of a pipe gets each line immediately
            progress(number / (args.count or math.inf), f"{number} packets printed")
