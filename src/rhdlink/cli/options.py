"""Options that several commands share (address, port), a connection with progress, and output on stderr."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from linkcore.cli import options, terminal
from linkcore.cli.options import argument, seconds

from ..client import Variables, connect

#: Options for the address of a robot, and for the time to wait for it.
ADDRESS = (
    argument("address", metavar="ADDRESS", help="a host, host:port (default port: 24902), or mqtt://host"),
    argument(
        "--timeout",
        type=seconds,
        default=5.0,
        metavar="S",
        help="give up if the robot is silent for S seconds (default: 5)",
    ),
)


def port(text: str) -> int:
    """Parse a TCP port; 0 for a free port."""
    if not (text.isascii() and text.isdecimal()) or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port; expected 0 to 65535")
    return int(text)


def connected(args: argparse.Namespace, address: str | None = None, **how: Any) -> Variables:
    """Connect to the address of a command, or to `address`, as `linkcore.cli.options.connected` does."""
    robot: Variables = options.connected(partial(connect, timeout=args.timeout, **how), args, address)
    return robot


#: Print one line on stderr.
tell = partial(terminal.tell, "rhdlink")
