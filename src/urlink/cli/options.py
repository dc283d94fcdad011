"""Options that several commands share (address, interface), connecting with progress, and lines on stderr."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any, Literal

from linkcore.cli import options, terminal
from linkcore.cli.options import Row, argument, seconds

from ..robot import Robot, connect

_ADDRESS = "a host (192.168.56.101, ur://host?primary=40001), sim://, sim://ur10?firmware=3.4, or replay:///file"

CONNECT_TIMEOUT = argument(
    "--connect-timeout", type=seconds, default=5.0, metavar="S", help="give up connecting after S seconds (5)"
)


def address(nargs: Literal["?"] | None = None) -> tuple[Row, Row]:
    """The address of a robot, which may be left out where `nargs` is "?", and how long to wait for it."""
    return argument("address", metavar="ADDRESS", nargs=nargs, help=_ADDRESS), CONNECT_TIMEOUT


ADDRESS = address()


def interface_of(choices: Sequence[str]) -> Row:
    """Which interface of the controller to read."""
    return argument(
        "--interface", choices=choices, default="realtime", help="interface of the controller to read (realtime)"
    )


def connected(args: argparse.Namespace, address: str | None = None, **how: Any) -> Robot:
    """Connect to the address of a command, or to another one, as `linkcore.cli.options.connected` does."""
    return options.connected(partial(connect, timeout=args.connect_timeout, **how), args, address)


#: Prints one line on stderr.
tell = partial(terminal.tell, "urlink")


def agrees(question: str) -> bool:
    """Whether the person at the terminal says yes."""
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
