"""`urlink sim`: runs a simulated controller in the foreground."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from linkcore.cli.options import DURATION, argument, command
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption

from ..session.address import Motion
from .options import tell

#: Joint positions of URSim after its start, in rad, from the vendor's integration tests.
_URSIM_POSTURE = (-1.6, -1.72, -2.2, -0.8, 1.6, 0.03)
_URSIM_PROGRAM = "Default program"
#: Programs on URSim, as the vendor's tests start it. On PolyScope X, the name of the second program has no suffix.
_URSIM_FILES = {
    _URSIM_PROGRAM: "def Default_program():\nend\n",
    **dict.fromkeys(
        ("wait_program.urp", "wait_program"), "def wait_program():\n  while True:\n    sleep(1)\n  end\nend\n"
    ),
}


def _faults() -> str:
    from ..simulator.faults import FAULTS

    lines = []
    for name, takes in FAULTS.items():
        if takes is None:
            lines.append(f"  {name}")
        else:
            lines.append(f"  {name}{'[=...]' if takes.is_optional else '=...'}".ljust(28) + takes.meaning)
    return "\n".join(lines)


def _program(text: str) -> tuple[str, str]:
    name, equals, file = text.partition("=")
    if not name or not equals:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=FILE")
    try:
        return name, Path(file).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise argparse.ArgumentTypeError(f"cannot read {file!r}: {error}") from error


@command(
    "sim",
    "run a simulated controller",
    argument("--model", metavar="NAME", help="arm: UR3, UR5, UR10, UR5e, UR16e, UR20, ... (default: UR5e)"),
    argument("--firmware", metavar="X.Y", help="controller software (default: the newest for the arm)"),
    argument(
        "--frequency",
        type=int,
        metavar="HZ",
        help="cycles per second, for tests that need fewer than a real controller executes (default: 125 or 500)",
    ),
    argument(
        "--host", default="127.0.0.1", metavar="H", help="address to listen on, 0.0.0.0 for all (default: 127.0.0.1)"
    ),
    argument(
        "--ports", choices=("standard", "free"), default="free", help="30001 and so on, or free ports (default: free)"
    ),
    argument("--fault", action="append", default=[], metavar="FAULT", help="inject a fault; can be repeated"),
    argument(
        "--program",
        action="append",
        default=[],
        type=_program,
        metavar="NAME=FILE",
        help="URScript file that the dashboard can load as NAME; can be repeated",
    ),
    argument(
        "--motion",
        choices=get_args(Motion),
        default="still",
        help="stand still until a program is sent, or move around a home posture (default: still)",
    ),
    argument("--noise", choices=("on", "off"), default="on", help="sensor noise (default: on)"),
    argument(
        "--scene",
        metavar="FILE",
        help="bodies around the arm, such as table.xml for MuJoCo (needs pip install urlink-mujoco)",
    ),
    argument("--like", choices=("ursim",), help="start in the same state as URSim"),
    argument(
        "--local-control",
        action="store_true",
        help="act as an e-Series in local control: accept commands only from the pendant",
    ),
    DURATION,
    listing=_faults,
)
def run(args: argparse.Namespace) -> int:
    """Run a simulated controller until Ctrl-C, SIGTERM or --duration, and print the address to connect to.

    The controller serves the primary, secondary and real-time interfaces, their read-only variants, RTDE and the
    dashboard, each to at most a hundred clients. Packets have the wire format of the firmware. The arm stands still
    until a program is sent; with --motion demo, it moves slowly around a home posture until then. With --ports
    standard, the controller uses the ports of a real controller, which other programs expect. With --like ursim, the
    controller starts in the same state as URSim, the vendor's simulator: in URSim's posture, with "Default program"
    loaded and wait_program.urp in /ursim/programs. The controller is then not in remote control, but still accepts
    commands, unless --local-control is given.

    The format of a fault is NAME[=ARGUMENT]@SECONDS. The fault happens SECONDS after the start. The faults are:

    examples:
      urlink sim
      urlink sim --model UR10 --firmware 3.4 --ports standard
      urlink sim --fault protective_stop@5 --fault clear@8 --fault reboot=5.12@15
      urlink sim --duration 60 --fault garbage=100@2 --fault stall=3@10
      urlink sim --program pick.urp=pick.script
      urlink sim --like ursim --ports standard --noise off
    """
    from ..simulator import HOME, Controller, Demonstration, Still, parse_fault

    faults = [parse_fault(text) for text in args.fault]
    posture, files = HOME, dict(args.program)
    if args.like == "ursim":
        posture, files = _URSIM_POSTURE, {**_URSIM_FILES, **files}
    with ProgressBar("starting the simulator", args.quiet):
        controller = Controller(
            args.model,
            args.firmware,
            host=args.host,
            ports=args.ports,
            files=files,
            motion=Demonstration(posture) if args.motion == "demo" else Still(posture),
            noise=args.noise == "on",
            scene=args.scene,
            frequency=args.frequency,
        )
    if args.like == "ursim":
        controller.pendant.load(_URSIM_PROGRAM)
        controller.pendant.directory = "/ursim/programs"
        controller.has_local_control = args.local_control
    controller.remote_control = not args.local_control and args.like is None
    controller.schedule(*faults)
    with Interruption() as interruption, controller:
        tell(f"{controller.model.name}, firmware {controller.firmware}; Ctrl-C ends it; connect to")
        print(controller.address, flush=True)
        interruption.end_after(args.duration)
        while not interruption.wait(1.0):
            pass
    return interruption.status
