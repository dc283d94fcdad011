"""`urlink foxglove`: a robot live in Foxglove."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Sequence
from typing import Any

from linkcore.cli.terminal import Interruption
from linkcore.errors import LocalError, WrongPeer
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.stream import Stream

from ..data.foxglove_server import FoxgloveServer, RobotView
from ..kinematics import Arm
from ..robot import Robot, connect
from .options import ADDRESS, DURATION, argument, command, positive_number, tell

__all__ = ["keep_showing"]


def arm_of(robot: Robot) -> Arm | None:
    """The kinematics of the arm; None if its model is unknown."""
    with contextlib.suppress(LocalError, WrongPeer):
        return robot.kinematics
    return None


@command(
    "foxglove",
    "serve a robot to Foxglove",
    *ADDRESS,
    argument("--host", default="127.0.0.1", metavar="HOST", help="address to listen on (127.0.0.1)"),
    argument("--port", type=int, default=8765, metavar="PORT", help="port to listen on, 0 for any (8765)"),
    argument("--rate", type=positive_number, default=50.0, metavar="HZ", help="states a second to show at most (50)"),
    DURATION,
)
def run(args: argparse.Namespace) -> int:
    """Serve a robot to Foxglove: connect it to the WebSocket that is printed, and add a 3D panel for the arm, plots
    of /realtime and a log panel.

    The topics are those of `urlink export run.mcap`; the arm is drawn from cylinders, and moves as the real one.
    The robot is only read. It needs the extra foxglove: pip install 'urlink[foxglove]'.

    examples:
      urlink foxglove 192.168.56.101
      urlink foxglove sim:// --rate 100
      urlink foxglove replay:///tmp/run.urlog --host 0.0.0.0 --port 8766
    """
    with (
        FoxgloveServer(args.address, args.host, args.port) as server,
        connect(args.address, timeout=args.connect_timeout) as robot,
        contextlib.closing(RobotView(robot.realtime, robot.primary, arm_of(robot), server)) as view,
    ):
        tell(f"{args.address} is at {server.address}; Ctrl-C ends it")
        return keep_showing(view.show, (robot.realtime, robot.primary), args.rate, args.duration)


def keep_showing(
    show: Callable[[], object], streams: Sequence[Stream[Any]], rate: float, duration: float | None
) -> int:
    """Call `show` `rate` times a second, until interrupted, until all `streams` are closed, or for `duration` seconds.

    Returns the exit status.

    Raises:
        RemoteError: a stream gave up.
    """
    with Interruption(duration) as interruption:
        due = time.monotonic()
        while not interruption.is_over and not (
            streams and all(each.connection is ConnectionState.CLOSED for each in streams)
        ):
            show()
            for stream in streams:
                if stream.failure is not None:
                    raise stream.failure
            # At absolute times: the rate does not depend on how long a round takes.
            due = max(due + 1 / rate, time.monotonic())
            interruption.wait(due - time.monotonic())
    return interruption.status
