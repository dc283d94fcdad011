"""What several commands have: the address of a robot, and a line for people."""

from __future__ import annotations

import argparse
import sys

from linkcore.cli.options import seconds
from linkcore.text import printable

__all__ = ["add_address", "port", "tell"]


def add_address(parser: argparse.ArgumentParser) -> None:
    """The address of a robot, and how long to wait for it."""
    parser.add_argument("address", metavar="ADDRESS", help="a host, or host:port; the port is 24902 unless named")
    parser.add_argument(
        "--timeout", type=seconds, default=5.0, metavar="S", help="give up when the robot is silent for S seconds (5)"
    )


def port(text: str) -> int:
    """A TCP port, or 0 for a free one."""
    if not (text.isascii() and text.isdecimal()) or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def tell(text: str) -> None:
    """One line on stderr."""
    print(f"rhdlink: {printable(text)}", file=sys.stderr)
