"""`urlink run`: sends a URScript program, and ends when the program ends."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from linkcore.cli.options import argument, command, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.errors import BadValue, LinkError, LinkTimeout
from linkcore.text import printable

from ..errors import ScriptError
from ..robot import Robot
from .options import ADDRESS, LIMITS, connected, tell

#: Timeout, in seconds, for stopping a program.
_STOPPING = 5.0


@command(
    "run",
    "send a URScript program",
    *ADDRESS,
    LIMITS,
    argument("file", metavar="FILE", help="file with the program; - for stdin"),
    argument("--timeout", type=seconds, metavar="S", help="stop the program after S seconds (default: never)"),
)
def run(args: argparse.Namespace) -> int:
    """Send a URScript program, print the lines of its textmsg, and end when the program ends. THE ARM MOVES if the
    program moves it.

    FILE contains a complete def, a complete sec, or only statements. With -, the program is read from stdin. Errors of
    the controller contain the line and the column in this program. Ctrl-C stops the program.

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
                raise LinkTimeout(f"the program did not end within {args.timeout:g} s, and was stopped")
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
        raise BadValue(f"{name} is not a text file: {error}") from error


def _show(text: str) -> None:
    print(printable(text), flush=True)


def _stop(robot: Robot) -> None:
    """Stop the program, and wait until the arm is at rest."""
    try:
        robot.motion.stop().wait(_STOPPING)
    except LinkTimeout:
        tell("the controller did not confirm that the program has stopped")
    except LinkError as error:
        tell(str(error))
