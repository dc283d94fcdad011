"""`urlink dashboard`: sends a command to the dashboard server, and shows whether the reply confirms the command."""

from __future__ import annotations

import argparse

from linkcore.cli.options import argument, command, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.errors import LocalError
from linkcore.text import printable

from ..protocol.dashboard.commands import COMMANDS, COULD_NOT_UNDERSTAND
from .options import ADDRESS, LIMITS, connected


@command(
    "dashboard",
    "send a dashboard command",
    *ADDRESS,
    LIMITS,
    argument(
        "command",
        nargs="+",
        metavar="COMMAND",
        help="command, followed by its text if it takes one",
        words=lambda: ["start", *(word for name in COMMANDS for word in name.split())],
    ),
    argument("--timeout", type=seconds, metavar="S", help="wait S seconds for the reply (default: 5; start: 30)"),
    listing=lambda: "\n".join(f"  {name}" for name in COMMANDS),
)
def run(args: argparse.Namespace) -> int:
    """Send a command to the dashboard server and print its reply. `start` switches the arm on, releases its brakes and
    waits until it runs. THE ARM MAY MOVE after `play`, `brake release` and `start`. The exit status is 1 if the reply
    does not confirm the command.

    Commands, and the firmware that has them:

    examples:
      urlink dashboard 192.168.56.101 robotmode
      urlink dashboard 192.168.56.101 start
      urlink dashboard sim:// popup mind the gap
    """
    command = " ".join(args.command)
    if not command.strip():
        raise LocalError("the command is empty")
    with connected(args) as robot, ProgressBar(f"waiting for {command!r}", args.quiet):
        if command == "start":
            robot.dashboard.start(*([] if args.timeout is None else [args.timeout]))
            print("the arm is running")
        else:
            reply = robot.dashboard.send(command, args.timeout)
            print(printable(reply))
            return 0 if _is_carried_out(command, reply) else 1
    return 0


def _is_carried_out(command: str, reply: str) -> bool:
    """Return whether a reply confirms a command.

    If urlink does not know the command, every reply confirms it, except the reply that the command is unknown.
    """
    known = [each for each in COMMANDS.values() if f"{command} ".casefold().startswith(f"{each.name} ".casefold())]
    if not known:
        return not reply.casefold().startswith(COULD_NOT_UNDERSTAND)
    return max(known, key=lambda each: len(each.name)).match(reply) is not None
