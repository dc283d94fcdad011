"""`urlink echo`: packets as lines."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Iterable
from typing import Any, TypeGuard

from linkcore.text import strict_json
from linkcore.wire.packet import State

from .. import packets
from ..decoding import INTERFACES
from ..interfaces.primary.robot_state import RobotState
from ..interfaces.realtime.packets import RealtimeState
from ..robot import Robot, connect
from .options import ADDRESS, Tap, argument, command, positive_int, seconds
from .values import NoSuchField, as_json, as_line, as_text, getter, plain

__all__ = ["PRINTED", "echo", "kind_of", "shower"]


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
def run(args: argparse.Namespace) -> int:
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
    with connect(args.address, timeout=args.connect_timeout) as robot:
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
    if args.json and getters:
        return lambda packet: strict_json(_picked(packet, getters))
    if args.json:
        return lambda packet: strict_json(as_json(packet))
    if getters:
        return lambda packet: " ".join(f"{path}={as_text(get(packet))}" for path, get in getters.items())
    return as_line


def _picked(packet: State, getters: dict[str, Callable[[Any], Any]]) -> dict[str, Any]:
    received = packet.received
    head = {"type": type(packet).__name__, "received": None if received is None else received.wall}
    return head | {path: plain(get(packet)) for path, get in getters.items()}


def echo(
    robot: Robot, interface: str, kind: type[State], show: Callable[[State], str], args: argparse.Namespace
) -> None:
    """Print the packets of one class on one interface.

    Raises:
        RemoteError: the stream could not be opened, gave up, or was silent for longer than `--timeout`.
    """
    with Tap(getattr(robot, interface), kind) as tap:
        packets: Iterable[State] = tap.packets(args.timeout)
        for packet in itertools.islice(packets, args.count):
            print(show(packet))
            # Flushed line by line: the reader of a pipe gets each line at once.
            sys.stdout.flush()
