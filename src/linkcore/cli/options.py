"""What commands have in common: options with checked numbers, a progress bar on stderr, and the command `export`."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, TypeVar

from ..recording.file import Progress
from ..text import printable

__all__ = [
    "Exportable",
    "ProgressBar",
    "Subparsers",
    "add_command",
    "add_export",
    "positive_int",
    "positive_number",
    "seconds",
]

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


#: Characters of a bar.
_WIDTH = 30
#: Seconds between two drawings, and before the first: shorter work needs no bar.
_PERIOD = 0.2


class ProgressBar:
    """A progress bar, as a context manager; call it with the fraction that is done, 0 to 1.

    Args:
        text: what is being done.
        quiet: do not draw on a terminal either.

    Attributes:
        is_shown: whether it is drawn.
    """

    def __init__(self, text: str, quiet: bool = False) -> None:
        self._text = text
        self.is_shown = sys.stderr.isatty() and not quiet
        self._next = time.monotonic() + _PERIOD
        self._is_drawn = False

    def __call__(self, part: float) -> None:
        """Draw it, if the last drawing is old enough."""
        now = time.monotonic()
        if not self.is_shown or now < self._next or part <= 0.0:  # 0: there is no progress to show
            return
        self._next = now + _PERIOD
        done = round(min(max(part, 0.0), 1.0) * _WIDTH)
        # The rest of the line is erased: the bar before may have been longer.
        bar = f"\r{printable(self._text)} [{'=' * done}{' ' * (_WIDTH - done)}] {part:4.0%}\x1b[K"
        print(bar, end="", file=sys.stderr, flush=True)
        self._is_drawn = True

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_drawn:  # erased, so that what is printed next stands alone
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


class Exportable(Protocol):
    """A recording that can be exported."""

    @property
    def missing(self) -> tuple[str, ...]:
        """What could not be read, one text each."""

    def export(
        self,
        path: str | os.PathLike[str],
        fields: Sequence[str] | None = None,
        rate: float | None = None,
        *,
        progress: Progress | None = None,
    ) -> Path:
        """Write it to a file; the suffix says the format."""


_T = TypeVar("_T", bound=Exportable)
_T_co = TypeVar("_T_co", bound=Exportable, covariant=True)


class Load(Protocol[_T_co]):
    """The `load` of a package."""

    def __call__(self, path: str, /, *, progress: Progress | None = None) -> _T_co: ...


def add_export(
    subparsers: Subparsers,
    description: str,
    examples: Sequence[str],
    load: Load[_T],
    content: Callable[[_T], str],
    tell: Callable[[str], None],
) -> None:
    """Declare the command.

    Args:
        load: reads a recording, and reports the progress.
        content: describes what is in it, for the line at the end.
        tell: prints a line on stderr.
    """
    parser = add_command(subparsers, "export", "write a recording to a file of another program", description, examples)
    parser.add_argument("file", metavar="FILE", help="a recording")
    parser.add_argument("to", metavar="OUT", help="file to write; its suffix says the format")
    parser.add_argument("fields", metavar="FIELD", nargs="*", help="write only these fields")
    parser.add_argument("--rate", type=positive_number, metavar="HZ", help="resample to so many rows a second")

    def run(args: argparse.Namespace) -> int:
        """Export, and print what was missing.

        Raises:
            BadRecording: no such recording, or the file cannot be written.
            BadValue: unknown suffix or field.
            LocalError: the package that writes the format is not installed.
        """
        with ProgressBar(f"reading {args.file}", args.quiet) as reading:
            recording = load(args.file, progress=reading)
            with ProgressBar(f"writing {args.to}", args.quiet) as writing:
                recording.export(args.to, args.fields or None, args.rate, progress=writing)
            missing = recording.missing
        for each in missing:
            tell(f"missing: {each}")
        print(f"{args.to}: {content(recording)}")
        return 0

    parser.set_defaults(run=run, trailing="fields")
