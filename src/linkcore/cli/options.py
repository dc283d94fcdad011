"""What all commands have in common: options with checked numbers, and help with its own line breaks."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any

__all__ = ["Subparsers", "add_command", "positive_int", "positive_number", "seconds"]

Subparsers = Any  # argparse's own class for it is private


def add_command(
    subparsers: Subparsers, name: str, summary: str, description: str, examples: Sequence[str]
) -> argparse.ArgumentParser:
    """A subcommand whose help ends with examples."""
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
    parser.add_argument("-q", "--quiet", action="store_true", help="draw no progress bar")
    parser.set_defaults(
        usage_error=parser.error, options=lambda: [option for each in parser._actions for option in each.option_strings]
    )
    return parser


def seconds(text: str) -> float:
    """A positive number of seconds."""
    return _positive(text, "a positive number of seconds")


def positive_number(text: str) -> float:
    """A positive number."""
    return _positive(text, "a positive number")


def _positive(text: str, expected: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not {expected}")
    return value


def positive_int(text: str) -> int:
    """A whole number from 1 on."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)
