"""`rhdlink mission`: run a script in SMR-CL on a robot or a turtle, check it, or serve clients of MRC."""

from __future__ import annotations

import argparse
import contextlib
import math
from pathlib import Path

from linkcore import clock
from linkcore.cli.options import argument, command, one_of, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.errors import LinkError
from linkcore.text import printable

from ..address import Address
from ..host.plugins.turtle import SmrTurtle, Turtle
from ..host.world import World
from ..smrcl.mission import Mission, MissionRun
from ..smrcl.profile import PROFILES
from ..smrcl.recipients import Said
from ..smrcl.robot_conf import RobotConf, read_robot_conf
from ..smrcl.robot_link import ClientLink, PluginLink, RobotLink
from ..smrcl.server import PORT, MissionServer
from .options import connected, port, tell
from .turtle_world import WORLD, drawn, world

#: Interval between updates of the progress, in s.
_VIEW = 0.2


@command(
    "mission",
    "run a script in SMR-CL",
    argument("file", metavar="FILE", nargs="?", help="the script"),
    one_of(
        argument("--robot", metavar="ADDRESS", help="a host, host:port (default port: 24902), or mqtt://host"),
        argument(
            "--turtle",
            nargs="?",
            const="velocity",
            choices=("velocity", "smr"),
            help="a simulated robot in a walled square of 11 x 11 m in this process, "
            "driven by velocity (default) or by two wheels",
        ),
    ),
    argument("--profile", choices=sorted(PROFILES), default="sound", help="mrc (like MRC) or sound (default: sound)"),
    argument("--conf", metavar="PATH", help="a robot.conf, or its folder calib/"),
    argument(
        "--calibration",
        metavar="NAME",
        help="name of the calibrations in --conf (default: the robot's name, or this computer's)",
    ),
    argument("--trace", action="store_true", help="show each line when it is executed"),
    argument("--svg", metavar="FILE", help="draw the turtle's path into FILE at the end: .svg or .png"),
    *WORLD,
    argument("--realtime", action="store_true", help="run the turtle in real time, not as fast as possible"),
    argument("--lockstep", action="store_true", help="the robot waits for each request: $time counts ticks"),
    argument("--log-folder", metavar="DIR", help="folder for the script's logs (default: logs are not saved)"),
    argument("--timeout", type=seconds, default=5.0, metavar="S", help="fail after S seconds of silence (default: 5)"),
    one_of(
        argument("--check", action="store_true", help="only check the script"),
        argument("--serve", action="store_true", help="serve clients of MRC until Ctrl-C, SIGTERM or --duration"),
    ),
    argument(
        "--port", type=port, default=PORT, metavar="P", help=f"port of --serve, 0 for a free port (default: {PORT})"
    ),
    argument("--listen", default="127.0.0.1", metavar="H", help="address of --serve (default: 127.0.0.1)"),
    argument("--duration", type=seconds, metavar="S", help="end --serve after S seconds (default: never)"),
)
def _run(args: argparse.Namespace) -> int:
    """Run a mission: a script in SMR-CL, the language of DTU's mobile robot controller MRC, on a robot, or on a turtle
    in this process. The script is checked before it starts. An error shows its line, and the robot stops.

    Text of `print` and values of `eval` go to stdout, and all other output goes to stderr. With --trace, each line is
    shown when it is executed. With --profile mrc, the robot does what MRC would do, tick by tick, and MRC's output is
    printed.

    With --check, the script is only checked. With --serve, clients of MRC can connect and send commands.

    examples:
      rhdlink mission square.smr --turtle
      rhdlink mission square.smr --robot smr12 --trace
      rhdlink mission line.smr --robot mqtt://192.168.0.55
      rhdlink mission spiral.smr --turtle --profile mrc --svg spiral.svg
      rhdlink mission dock.smr --turtle smr --floor floor.svg --start 1.5,2,0 --svg way.svg
      rhdlink mission --check square.smr
      rhdlink mission --serve --robot smr12
    """
    if args.serve:
        return _serve(args)
    if args.duration is not None:
        args.usage_error("--duration needs --serve; a script ends on its own")
    if args.file is None:
        args.usage_error("no script was given; it can only be omitted with --serve")
    if args.check:
        return _check(args)
    return _execute(args)


def _check(args: argparse.Namespace) -> int:
    mission = Mission(Path(args.file))
    mistakes = mission.check()
    for mistake in mistakes:
        print(f"{printable(mission.name)}: {printable(str(mistake))}")
    if not mistakes:
        tell(f"{mission.name}: no mistakes found")
    return 1 if mistakes else 0


def _execute(args: argparse.Namespace) -> int:
    conf = _conf(args)
    link, driven = _link(args, is_realtime=args.realtime)
    try:
        mission = Mission(Path(args.file), link, compat=args.profile, conf=conf, log_folder=args.log_folder)
        _listen(mission, args)
        with Interruption() as interruption:
            run = mission.start()
            _watch(run, interruption, args)
        error = run.error
        if driven is not None:
            pose = driven.pose
            tell(f"ended at x {pose.x:.3f} m, y {pose.y:.3f} m, heading {math.degrees(pose.theta):.1f} deg")
            if args.svg is not None:
                drawn(driven, args, args.svg, mission.name)
        if error is not None and interruption.number is None:
            raise error
        return interruption.status
    finally:
        link.close()


def _watch(run: MissionRun, interruption: Interruption, args: argparse.Namespace) -> None:
    """Wait for the end, and show the progress."""
    due = clock.now() + _VIEW
    with ProgressBar(args.file, args.quiet or args.trace) as progress:
        while not run.done:
            if interruption.wait(0.02):
                run.cancel()
                break
            if clock.now() >= due:
                due = clock.now() + _VIEW
                progress(text=_view(run))
        # After a signal, the robot is stopped and gets time to answer.
        with contextlib.suppress(LinkError):
            run.wait(args.timeout + 1.0)


def _view(run: MissionRun) -> str:
    x, y, theta = run.pose
    parts = [
        f"line {run.line}: {printable(run.text)[:40]}",
        f"x {x:.3f} m  y {y:.3f} m  heading {math.degrees(theta):.1f} deg",
        f"$drivendist {run.system('drivendist'):.3f}  $cmdtime {run.system('cmdtime'):.2f}",
    ]
    if run.conditions:
        parts.append(f"conditions {' '.join('true' if each else 'false' for each in run.conditions)}")
    return "  |  ".join(parts)


def _listen(mission: Mission, args: argparse.Namespace) -> None:
    if args.profile == "mrc":
        mission.on_said(_print_as_mrc)
        return
    mission.on("values", _print).on("text", _print)
    mission.on("event", tell).on("message", lambda text: tell(text.strip()))
    if args.trace:
        mission.on_said(_trace)


def _print(text: str) -> None:
    print(printable(text), flush=True)


def _print_as_mrc(said: Said) -> None:
    # Do not escape the lines, because they come from the user's own script.
    print(said.printed, end="", flush=True)


def _print_what_clients_said(said: Said) -> None:
    # Escape lines from the network for the terminal, line by line.
    print("\n".join(map(printable, said.printed.split("\n"))), end="", flush=True)


def _trace(said: Said) -> None:
    if said.line:
        tell(f"line {said.line}: {said.text.strip()}")


def _serve(args: argparse.Namespace) -> int:
    if args.file is not None:
        args.usage_error("a script cannot be combined with --serve, which takes commands from clients")
    conf = _conf(args)
    link, driven = _link(args, is_realtime=True)
    server = MissionServer(
        link, port=args.port, address=args.listen, compat=args.profile, conf=conf, log_folder=args.log_folder
    )
    if args.profile == "mrc":
        server.on_said(_print_what_clients_said)
    try:
        with Interruption() as interruption:
            with server:
                tell("clients of MRC can connect; Ctrl-C ends it; connect to")
                print(Address(args.listen, server.port), flush=True)
                interruption.end_after(args.duration)
                while not server.wait(0.0) and not interruption.wait(0.1):
                    pass
            if driven is not None and args.svg is not None:
                drawn(driven, args, args.svg, "served")
            return interruption.status
    finally:
        link.close()


def _conf(args: argparse.Namespace) -> RobotConf | str | None:
    """Return the configuration of the robot, or its path, from the options.

    Raises:
        BadConfiguration: If the requested calibration does not exist.
    """
    if args.calibration is None:
        path: str | None = args.conf
        return path
    if args.conf is None:
        args.usage_error("--calibration needs --conf, which names the folder of the calibration files")
    return read_robot_conf(args.conf, calibration=args.calibration)


def _link(args: argparse.Namespace, *, is_realtime: bool) -> tuple[RobotLink, World | None]:
    """Open the link to the robot; return it, and the world if the robot is a turtle.

    Raises:
        BadValue: If the world cannot be created, or the picture cannot be written.
    """
    if args.turtle is None:
        if not (args.svg is None and args.floor is None and args.start is None):
            args.usage_error("--svg, --floor and --start need --turtle")
        robot = connected(args, args.robot or "localhost", access="w")
        return ClientLink(robot, is_lockstep=args.lockstep, owns=True), None
    turtle = Turtle(world(args)) if args.turtle == "velocity" else SmrTurtle(world(args))
    if args.svg is not None:
        drawn(turtle.world, args, args.svg)  # raises an error immediately if it cannot be written
    return PluginLink([turtle], is_realtime=is_realtime), turtle.world
