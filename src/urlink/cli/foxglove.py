"""`urlink foxglove`: a robot live in Foxglove."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Sequence
from typing import Any

from linkcore.cli.program import Interruption
from linkcore.errors import LocalError, WrongPeer
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.stream import Stream

from ..data.foxglove_server import FoxgloveServer, RobotView
from ..kinematics import Arm
from ..robot import Robot, connect
from .options import Subparsers, add_address, add_command, positive_number, seconds, tell

__all__ = ["add_parser", "keep_showing"]

_DESCRIPTION = """\
Serve a robot to Foxglove: connect it to the WebSocket that is printed, and add a 3D panel for the arm, plots
of /realtime and a log panel.

The topics are those of `urlink export run.mcap`; the arm is drawn from cylinders, and moves as the real one.
The robot is only read. It needs the extra foxglove: pip install 'urlink[foxglove]'."""

_EXAMPLES = (
    "urlink foxglove 192.168.56.101",
    "urlink foxglove sim:// --rate 100",
    "urlink foxglove replay:///tmp/run.urlog --host 0.0.0.0 --port 8766",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "foxglove", "serve a robot to Foxglove", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    parser.add_argument("--host", default="127.0.0.1", metavar="HOST", help="address to listen on (127.0.0.1)")
    parser.add_argument("--port", type=int, default=8765, metavar="PORT", help="port to listen on, 0 for any (8765)")
    parser.add_argument(
        "--rate", type=positive_number, default=50.0, metavar="HZ", help="states a second to show at most (50)"
    )
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds (never)")
    parser.set_defaults(run=run)


def arm_of(robot: Robot) -> Arm | None:
    """The kinematics of the arm; None if its model is unknown."""
    with contextlib.suppress(LocalError, WrongPeer):
        return robot.kinematics
    return None


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted, or until a recording is over.

    Raises:
        RemoteError: the robot cannot be connected to, a stream gave up, or the port cannot be listened on.
        LocalError: the extra is not installed.
    """
    with (
        FoxgloveServer(args.address, args.host, args.port) as server,
        connect(args.address, timeout=args.connect_timeout) as robot,
        contextlib.closing(RobotView(robot.realtime, robot.primary, arm_of(robot), server)) as view,
    ):
        tell(f"{args.address} is at {server.address}; Ctrl-C ends it")
        keep_showing(view.show, (robot.realtime, robot.primary), args.rate, args.duration)
    return 0


def keep_showing(
    show: Callable[[], object], streams: Sequence[Stream[Any]], rate: float, duration: float | None
) -> None:
    """Call `show` `rate` times a second, until interrupted, until all `streams` are closed, or for `duration` seconds.

    Raises:
        RemoteError: a stream gave up.
        Interrupted: by a signal.
    """
    until = float("inf") if duration is None else time.monotonic() + duration
    with Interruption() as interruption:
        due = time.monotonic()
        while time.monotonic() < until and not (
            streams and all(each.connection is ConnectionState.CLOSED for each in streams)
        ):
            show()
            for stream in streams:
                if stream.failure is not None:
                    raise stream.failure
            # At absolute times: the rate does not depend on how long a round takes.
            due = max(due + 1 / rate, time.monotonic())
            if interruption.wait(due - time.monotonic()):
                break
    interruption.raise_if_any()
