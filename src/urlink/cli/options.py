"""Options of several commands: address, time to connect, interface."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from linkcore.cli.options import Subparsers, add_command, positive_int, positive_number, seconds

__all__ = ["Subparsers", "add_address", "add_command", "add_interface", "positive_int", "positive_number", "seconds"]

_ADDRESS = "a host (192.168.56.101, ur://host?primary=40001), sim://, sim://ur10?firmware=3.4, or replay:///file"


def add_address(parser: argparse.ArgumentParser) -> None:
    """The address of a robot, and how long to wait for it."""
    parser.add_argument("address", metavar="ADDRESS", help=_ADDRESS)
    parser.add_argument(
        "--connect-timeout", type=seconds, default=5.0, metavar="S", help="give up connecting after S seconds (5)"
    )


def add_interface(parser: argparse.ArgumentParser, choices: Sequence[str], default: str = "realtime") -> None:
    """Which interface of the controller to read."""
    parser.add_argument(
        "--interface", choices=choices, default=default, help=f"interface of the controller to read ({default})"
    )
