"""`urlink run` and `dashboard`: a program, or a command, and how it ends."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from linkcore.cli.options import argument, command, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.errors import BadValue, LinkError, LinkTimeout, LocalError
from linkcore.text import printable

from ..errors import ScriptError
from ..protocol.dashboard.commands import COMMANDS, COULD_NOT_UNDERSTAND
from ..robot import Robot
from .options import ADDRESS, connected, tell

#: Seconds to wait for a program that is being stopped.
_STOPPING = 5.0


@command(
    "run",
    "send a URScript program",
    *ADDRESS,
    argument("file", metavar="FILE", help="the program; - for stdin"),
    argument("--timeout", type=seconds, metavar="S", help="stop it after S seconds (never)"),
)
def _run(args: argparse.Namespace) -> int:
    """Send a URScript program, print the lines of its textmsg, and end when it does. THE ARM MOVES if the program
    says so.

    The program is a whole def, a sec, or bare statements, from a file or, with -, from stdin. Errors of the controller
    name the line and the column in that file. Ctrl-C stops the program.

    examples:
      urlink run 192.168.56.101 pick.script
      echo 'textmsg(get_actual_joint_positions())' | urlink run sim:// -
      urlink run sim:// pick.script --timeout 30
    """
    source = _read(args.file)
    with (
        Interruption() as interruption,
        connected(args) as robot,
        ProgressBar(f"running {args.file}", args.quiet),
    ):
        try:
            program = robot.script.run(source, on_text=_show)
        except BadValue as error:
            raise BadValue(f"{args.file}: {error}") from None
        waited = 0.0
        while not program.done:
            if interruption.wait(0.05):
                _stop(robot)
                break
            waited += 0.05
            if args.timeout is not None and waited >= args.timeout and not program.done:
                _stop(robot)
                raise LinkTimeout(f"the program was not over within {args.timeout:g} s, and was stopped")
        if interruption.number is None:
            try:
                program.wait(0.0)
            except ScriptError as error:
                tell(f"{args.file}:{error.line}:{error.column}: {error.text}")
                return 1
    return interruption.status


def _read(name: str) -> str:
    try:
        return sys.stdin.read() if name == "-" else Path(name).read_text(encoding="utf-8")
    except OSError as error:
        raise BadValue(f"cannot read {name}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise BadValue(f"{name} is no text: {error}") from error


def _show(text: str) -> None:
    print(printable(text), flush=True)


def _stop(robot: Robot) -> None:
    """Stop the program, and wait until the arm stands still."""
    try:
        robot.motion.stop().wait(_STOPPING)
    except LinkTimeout:
        tell("the controller has not confirmed that the program has stopped")
    except LinkError as error:
        tell(str(error))


@command(
    "dashboard",
    "send a dashboard command",
    *ADDRESS,
    argument(
        "command",
        nargs="+",
        metavar="COMMAND",
        help="the command, and its text where it takes one",
        words=lambda: ["start", *(word for name in COMMANDS for word in name.split())],
    ),
    argument("--timeout", type=seconds, metavar="S", help="wait S seconds for the reply (5; start: 30)"),
    listing=lambda: "\n".join(f"  {name}" for name in COMMANDS),
)
def _dashboard(args: argparse.Namespace) -> int:
    """Send a command to the dashboard server and print its reply; `start` powers the arm on, releases its brakes and
    waits until it runs. THE ARM MAY MOVE after `play`, `brake release` and `start`. The exit status is 1 if the reply
    does not confirm the command.

    Commands, on the firmware that has them:

    examples:
      urlink dashboard 192.168.56.101 robotmode
      urlink dashboard 192.168.56.101 start
      urlink dashboard sim:// popup mind the gap
    """
    command = " ".join(args.command)
    if not command.strip():
        raise LocalError("an empty command")
    with connected(args) as robot, ProgressBar(f"waiting for {command!r}", args.quiet):
        if command == "start":
            robot.dashboard.start(*([] if args.timeout is None else [args.timeout]))
            print("the arm runs")
        else:
            reply = robot.dashboard.send(command, args.timeout)
            print(printable(reply))
            return 0 if _is_carried_out(command, reply) else 1
    return 0


def _is_carried_out(command: str, reply: str) -> bool:
    """Whether a reply confirms a command; of one that is not in the table, any does but that it is unknown."""
    known = [each for each in COMMANDS.values() if f"{command} ".casefold().startswith(f"{each.name} ".casefold())]
    if not known:
        return not reply.casefold().startswith(COULD_NOT_UNDERSTAND)
    return max(known, key=lambda each: len(each.name)).match(reply) is not None
