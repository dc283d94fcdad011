"""Functions that several commands use: options, connecting with a progress display, and printing to stderr."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any, Literal

from linkcore.cli import options, terminal
from linkcore.cli.options import Row, argument, seconds
from linkcore.errors import LocalError

from ..robot import Robot, connect
from ..session.session_limits import SessionLimits

_ADDRESS = "host (192.168.56.101, ur://host?primary=40001), sim://, sim://ur10?firmware=3.4, or replay:///file"

CONNECT_TIMEOUT = argument(
    "--connect-timeout", type=seconds, default=5.0, metavar="S", help="stop connecting after S seconds (default: 5)"
)


def address(nargs: Literal["?"] | None = None) -> tuple[Row, Row]:
    """Return the arguments for the address of a robot and for the connect timeout.

    The address is optional if `nargs` is "?".
    """
    return argument("address", metavar="ADDRESS", nargs=nargs, help=_ADDRESS), CONNECT_TIMEOUT


ADDRESS = address()


def interface_of(choices: Sequence[str]) -> Row:
    """Return the argument for the interface of the controller."""
    return argument(
        "--interface", choices=choices, default="realtime", help="interface of the controller (default: realtime)"
    )


def _limits(text: str) -> SessionLimits:
    try:
        return SessionLimits.named(text)
    except LocalError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


LIMITS = argument(
    "--limits",
    type=_limits,
    metavar="FILE",
    help="refuse commands beyond the limits in a JSON file, or in the ready profile 'teaching' (not a safety function)",
)


def connected(args: argparse.Namespace, address: str | None = None, **how: Any) -> Robot:
    """Connect to `address`, or by default to the address in `args`; see `linkcore.cli.options.connected`."""
    how.setdefault("limits", getattr(args, "limits", None))
    return options.connected(partial(connect, timeout=args.connect_timeout, **how), args, address)


#: Prints one line on stderr.
tell = partial(terminal.tell, "urlink")


def agrees(question: str) -> bool:
    """Ask a question on the terminal, and return whether the answer is yes."""
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
