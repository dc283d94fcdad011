"""`urlink view`: an arm in 3D in a browser."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from typing import Any

from linkcore.errors import LocalError
from linkcore.streaming.stream import Stream

from ..address import RecordingAddress, parse_address
from ..robot import connect
from ..view.arm_view import ArmView
from ..view.page import LOOPBACK, Page
from ..view.windows import LiveWindow, RecordedWindow, Window
from .foxglove import keep_showing
from .monitor import with_motion
from .options import ADDRESS, DURATION, argument, command, positive_number, tell


@command(
    "view",
    "show an arm in 3D in a browser",
    *ADDRESS,
    argument("--host", default="127.0.0.1", metavar="HOST", help="address to listen on (127.0.0.1)"),
    argument("--port", type=int, default=8080, metavar="PORT", help="port to listen on, 0 for any (8080)"),
    argument("--plot", action="append", metavar="FIELD", help="draw this field; may be given again"),
    argument("--urdf", type=Path, metavar="FILE", help="draw the bodies of this URDF, with its meshes"),
    argument("--jog", action="store_true", help="buttons that move the arm while they are held"),
    argument("--rate", type=positive_number, default=30.0, metavar="HZ", help="pictures a second at most (30)"),
    DURATION,
)
def run(args: argparse.Namespace) -> int:
    """Show an arm in 3D in a browser: open the address that is printed.

    Drawn are the arm, translucent where its controller wants it if that is elsewhere, the trail of the TCP over
    ten seconds, the force on it as an arrow, the modes, and curves of the fields given with --plot. A recording
    has a slider. The page is for this computer alone, unless --host says otherwise, and asks nothing of the
    internet.

    The robot is only read. With --jog THE ARM MOVES while a button of the page is held: a box has to be ticked
    before, which ends the program that runs. It needs the extra view: pip install 'urlink[view]'.

    examples:
      urlink view 192.168.56.101
      urlink view sim://ur10e --plot qd_actual --plot I_actual
      urlink view run.urlog
      urlink view 192.168.56.101 --jog
    """
    place = parse_address(args.address)
    if args.jog and args.host not in LOOPBACK:
        raise LocalError("--jog is for a browser of this computer; from another one, forward the port: ssh -L 8080:...")
    with contextlib.ExitStack() as stack:
        page = stack.enter_context(Page(f"urlink view {args.address}", args.host, args.port))
        streams: list[Stream[Any]] = []
        window: Window
        if isinstance(place, RecordingAddress):
            if args.jog:
                raise LocalError(f"{args.address} is a recording, so it cannot be moved")
            from ..data.recording import load

            recording = load(place.path)
            table = recording.realtime if "realtime" in recording.channels else recording.rtde
            arm, window, jog = recording.kinematics, RecordedWindow(table), None
        else:
            address = args.address if args.jog else with_motion(args.address)
            robot = stack.enter_context(connect(address, timeout=args.connect_timeout))
            arm, window, jog = robot.kinematics, LiveWindow(robot.realtime), robot.motion.jog if args.jog else None
            streams.append(robot.realtime)
        fields = {} if args.plot is None else {"plots": args.plot}
        view = stack.enter_context(ArmView(page, arm, window, urdf=args.urdf, jog=jog, **fields))
        tell(f"{args.address} is at {view.address}; Ctrl-C ends it")
        return keep_showing(view.show, streams, args.rate, args.duration)
