"""`urlink dashboard`: one command to the dashboard server, and its reply."""

from __future__ import annotations

import argparse

from linkcore.errors import LocalError
from linkcore.text import printable

from ..interfaces.dashboard.commands import COMMANDS
from ..robot import connect
from .options import Subparsers, add_address, add_command, seconds

__all__ = ["add_parser"]

_DESCRIPTION = """\
Send a command to the dashboard server and print its reply; `start` powers the arm on, releases its brakes and
waits until it runs. THE ARM MAY MOVE after `play`, `brake release` and `start`.

Commands, on the firmware that has them:
"""

_EXAMPLES = (
    "urlink dashboard 192.168.56.101 robotmode",
    "urlink dashboard 192.168.56.101 start",
    "urlink dashboard sim:// popup mind the gap",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    commands = "\n".join(f"  {name}" for name in COMMANDS)
    parser = add_command(subparsers, "dashboard", "send a dashboard command", _DESCRIPTION + commands, _EXAMPLES)
    add_address(parser)
    parser.add_argument("command", nargs="+", metavar="COMMAND", help="the command, and its text where it takes one")
    parser.add_argument("--timeout", type=seconds, metavar="S", help="wait S seconds for the reply (5; start: 30)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Send it, and print the reply.

    Raises:
        LocalError: the robot has no dashboard, or the line cannot be sent.
        RemoteError: there was no reply.
    """
    command = " ".join(args.command)
    if not command.strip():
        raise LocalError("an empty command")
    with connect(args.address, timeout=args.connect_timeout) as robot:
        if command == "start":
            robot.dashboard.start(*([] if args.timeout is None else [args.timeout]))
            print("the arm runs")
        else:
            print(printable(robot.dashboard.send(command, args.timeout)))
    return 0
