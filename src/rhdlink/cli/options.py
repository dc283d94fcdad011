"""Options that several commands share (address, port), connecting with progress, and lines on stderr."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from linkcore.cli import options, terminal
from linkcore.cli.options import argument, seconds

from ..client import Variables, connect

#: The address of a robot, and how long to wait for it.
ADDRESS = (
    argument("address", metavar="ADDRESS", help="a host, or host:port; the port is 24902 unless named"),
    argument(
        "--timeout", type=seconds, default=5.0, metavar="S", help="give up when the robot is silent for S seconds (5)"
    ),
)


def port(text: str) -> int:
    """A TCP port, or 0 for a free one."""
    if not (text.isascii() and text.isdecimal()) or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def connected(args: argparse.Namespace, address: str | None = None, **how: Any) -> Variables:
    """Connect to the address of a command, or to another one, as `linkcore.cli.options.connected` does."""
    robot: Variables = options.connected(partial(connect, timeout=args.timeout, **how), args, address)
    return robot


#: Prints one line on stderr.
tell = partial(terminal.tell, "rhdlink")
