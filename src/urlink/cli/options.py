"""What the commands' options have in common: numbers that are checked, and help that keeps its lines."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any

__all__ = ["Subparsers", "add_address", "add_command", "add_interface", "positive_int", "seconds"]

Subparsers = Any  # argparse's own class for it is private

_ADDRESS = "a host (192.168.56.101, ur://host?primary=40001), sim://, sim://ur10?firmware=3.4, or replay:///file"


def add_command(
    subparsers: Subparsers, name: str, summary: str, description: str, examples: Sequence[str]
) -> argparse.ArgumentParser:
    """A subcommand whose help ends in examples."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        name,
        help=summary,
        description=description,
        epilog="examples:\n" + "\n".join(f"  {example}" for example in examples),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-v", "--verbose", action="count", default=0, help="log to stderr what happens; twice for everything"
    )
    parser.set_defaults(usage_error=parser.error)
    return parser


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


def seconds(text: str) -> float:
    """A positive number of seconds."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number of seconds")
    return value


def positive_int(text: str) -> int:
    """A whole number from 1 on."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)
