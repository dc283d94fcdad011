"""Commands `urlink foxglove` and `urlink view`: show an arm in Foxglove, or in 3D in a browser."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from linkcore import clock
from urlink import ConnectionState, LocalError, Robot, Stream, WrongPeer
from urlink.arm.kinematics import Arm
from urlink.tools import (
    ADDRESS,
    DURATION,
    LIMITS,
    Interruption,
    ProgressBar,
    RecordingAddress,
    argument,
    command,
    connected,
    parse_address,
    positive_number,
    tell,
    with_motion,
)

from ..arm_view import ArmView
from ..live import FoxgloveServer, RobotView
from ..page import LOOPBACK, Page
from ..windows import LiveWindow, RecordedWindow, Window


def arm_of(robot: Robot) -> Arm | None:
    """Return the kinematics of the arm; None if its model is unknown."""
    with contextlib.suppress(LocalError, WrongPeer):
        return robot.kinematics
    return None


@command(
    "foxglove",
    "serve a robot to Foxglove",
    *ADDRESS,
    argument("--host", default="127.0.0.1", metavar="HOST", help="address to listen on (default: 127.0.0.1)"),
    argument("--port", type=int, default=8765, metavar="PORT", help="port to listen on, 0 for any (default: 8765)"),
    argument(
        "--rate", type=positive_number, default=50.0, metavar="HZ", help="maximum states per second (default: 50)"
    ),
    DURATION,
)
def _foxglove(args: argparse.Namespace) -> int:
    """Serve a robot to Foxglove: connect Foxglove to the printed WebSocket address, and add a 3D panel for the arm,
    plots of /realtime and a log panel.

    The topics are those of `urlink export run.mcap`. The arm is drawn as cylinders, and moves like the real arm.
    The robot is only read. The command needs the extra foxglove: pip install 'urlink-view[foxglove]'.

    examples:
      urlink foxglove 192.168.56.101
      urlink foxglove sim:// --rate 100
      urlink foxglove replay:///tmp/run.urlog --host 0.0.0.0 --port 8766
    """
    with (
        contextlib.closing(FoxgloveServer(args.address, args.host, args.port)) as server,
        connected(args) as robot,
        contextlib.closing(RobotView(robot.realtime, robot.primary, arm_of(robot), server)) as view,
    ):
        tell(f"{args.address} is at {server.address}; Ctrl-C ends it")
        return keep_showing(view.show, (robot.realtime, robot.primary), args.rate, args.duration)


def keep_showing(
    show: Callable[[], object], streams: Sequence[Stream[Any]], rate: float, duration: float | None
) -> int:
    """Call `show` `rate` times a second, until interrupted, until all `streams` are closed, or for `duration` seconds.

    Returns:
        Exit status.

    Raises:
        RemoteError: If a stream has failed permanently.
    """
    with Interruption(duration) as interruption:
        due = clock.now()
        while not interruption.is_over and not (
            streams and all(each.connection is ConnectionState.CLOSED for each in streams)
        ):
            show()
            for stream in streams:
                if stream.failure is not None:
                    raise stream.failure
            # Use absolute times, so that the rate does not depend on the duration of a cycle.
            due = max(due + 1 / rate, clock.now())
            interruption.wait(due - clock.now())
    return interruption.status


@command(
    "view",
    "show an arm in 3D in a browser",
    *ADDRESS,
    LIMITS,
    argument("--host", default="127.0.0.1", metavar="HOST", help="address to listen on (default: 127.0.0.1)"),
    argument("--port", type=int, default=8080, metavar="PORT", help="port to listen on, 0 for any (default: 8080)"),
    argument("--plot", action="append", metavar="FIELD", help="plot this field; repeatable"),
    argument("--urdf", type=Path, metavar="FILE", help="draw the bodies of this URDF, with its meshes"),
    argument("--jog", action="store_true", help="show buttons that move the arm while they are held"),
    argument(
        "--rate", type=positive_number, default=30.0, metavar="HZ", help="maximum frames per second (default: 30)"
    ),
    DURATION,
)
def _view(args: argparse.Namespace) -> int:
    """Show an arm in 3D in a browser: open the printed address.

    The page shows the arm, a translucent arm at the target if it differs, the trail of the TCP over ten seconds, the
    force on it as an arrow, the modes, and plots of the fields given with --plot. A recording has a slider. The page
    is only for this computer, unless --host is given, and needs nothing from the internet.

    The robot is only read. With --jog THE ARM MOVES while a button of the page is held. A box has to be ticked before,
    which ends the running program.

    examples:
      urlink view 192.168.56.101
      urlink view sim://ur10e --plot qd_actual --plot I_actual
      urlink view run.urlog
      urlink view 192.168.56.101 --jog
    """
    place = parse_address(args.address)
    if args.jog and args.host not in LOOPBACK:
        raise LocalError(
            "--jog is only for browsers on this computer; from another one, use ssh -L 8080:localhost:8080"
        )
    with contextlib.ExitStack() as stack:
        with ProgressBar("starting the view", args.quiet) as progress:
            page = stack.enter_context(Page(f"urlink view {args.address}", args.host, args.port))
            streams: list[Stream[Any]] = []
            window: Window
            if isinstance(place, RecordingAddress):
                if args.jog:
                    raise LocalError(f"{args.address} is a recording; --jog needs a robot")
                from urlink import load

                recording = load(place.path, progress=progress)
                table = recording.realtime if "realtime" in recording.channels else recording.rtde
                arm, window, jog = recording.kinematics, RecordedWindow(table), None
            else:
                address = args.address if args.jog else with_motion(args.address)
                robot = stack.enter_context(connected(args, address))
                arm, window, jog = robot.kinematics, LiveWindow(robot.realtime), robot.motion.jog if args.jog else None
                streams.append(robot.realtime)
            progress.next("starting the view")
            fields = {} if args.plot is None else {"plots": args.plot}
            view = stack.enter_context(ArmView(page, arm, window, urdf=args.urdf, jog=jog, **fields))
        tell(f"{args.address} is at {view.address}; Ctrl-C ends it")
        return keep_showing(view.show, streams, args.rate, args.duration)
