"""Declaration of commands (name, help, arguments and function), and arguments that many commands have."""

from __future__ import annotations

import argparse
import inspect
import math
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from ..recording.file import Progress
from .progress import ProgressBar

#: Function that adds arguments to a parser, or to a group of a parser.
Row = Callable[[Any], None]
#: Attribute of an argparse action that contains the words for completion.
_WORDS = "completed_words"


def argument(*names: str, words: Callable[[], Iterable[str]] | None = None, trailing: bool = False, **how: Any) -> Row:
    """Return the declaration of one argument.

    Args:
        names: See `argparse.ArgumentParser.add_argument`.
        words: Function that returns the words for the completion by a shell. It is only called by `completion`.
        trailing: Whether words after an option belong to this argument too. argparse does not support this for a
            variable number of words.
        how: See `argparse.ArgumentParser.add_argument`.
    """

    def declare(parser: Any) -> None:
        action = parser.add_argument(*names, **how)
        if words is not None:
            setattr(action, _WORDS, words)
        if trailing:
            parser.set_defaults(trailing=action.dest)

    return declare


def one_of(*rows: Row) -> Row:
    """Return the declaration of arguments that exclude each other."""

    def declare(parser: Any) -> None:
        group = parser.add_mutually_exclusive_group()
        for row in rows:
            row(group)

    return declare


def completed_words(action: argparse.Action) -> Iterable[str]:
    """Return the words for the completion of an argument by a shell."""
    words: Callable[[], Iterable[str]] = getattr(action, _WORDS, tuple)
    return [*words(), *map(str, action.choices or ())]


class Subcommand(NamedTuple):
    """Command of a program.

    Attributes:
        name: Name on the command line.
        summary: Line in the help of the program.
        rows: Arguments, in the order of the help.
        run: Function that gets the parsed arguments, and returns the exit status. Its docstring is the help of the
            command.
        listing: Function that returns lines to print after the description. It is called when the command is declared.
    """

    name: str
    summary: str
    rows: tuple[Row, ...]
    run: Callable[[argparse.Namespace], int]
    listing: Callable[[], str] | None = None

    def declare(self, subparsers: Any) -> None:
        """Add the parser of the command to the `subparsers` of the program, whose class is private to argparse."""
        text = inspect.getdoc(self.run) or "No more help is available: this Python runs without docstrings (-OO)."
        text = text.replace("{program}", subparsers._prog_prefix)
        description, heading, examples = text.partition("\n\nexamples:\n")
        if self.listing is not None:
            description += f"\n{self.listing()}"
        parser: argparse.ArgumentParser = subparsers.add_parser(
            self.name,
            help=self.summary,
            description=description,
            epilog=heading.strip() + "\n" + examples,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        common_options(parser)
        for row in self.rows:
            row(parser)
        parser.set_defaults(
            run=self.run,
            usage_error=parser.error,
            options=lambda: [option for each in parser._actions for option in each.option_strings],
        )


def common_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of every command, which are also accepted before the command."""
    parser.add_argument("-v", "--verbose", action="count", default=0, help="log events; give twice to log everything")
    parser.add_argument("-q", "--quiet", action="store_true", help="do not show the progress")


def command(
    name: str, summary: str, *rows: Row, listing: Callable[[], str] | None = None
) -> Callable[[Callable[[argparse.Namespace], int]], Subcommand]:
    """Return a decorator that converts a function to a command.

    The docstring of the function ends with lines of examples below ``examples:``. `program` finds the command in its
    module. See `Subcommand` for the arguments.
    """
    return lambda run: Subcommand(name, summary, rows, run, listing)


def seconds(text: str) -> float:
    """Convert text to a positive number of seconds."""
    return _positive(text, "a positive number of seconds")


def positive_number(text: str) -> float:
    """Convert text to a positive number."""
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
    """Convert text to a whole number that is 1 or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is invalid; expected a whole number, 1 or more")
    return int(text)


def replay_rate(text: str) -> float:
    """Convert text to a replay speed relative to the recording; ``max`` becomes 0, which means as fast as possible."""
    if text == "max":
        return 0.0
    try:
        return positive_number(text)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"{text!r} is invalid; expected a positive number or max") from None


#: Option for the duration of a command.
DURATION = argument("--duration", type=seconds, metavar="S", help="end after S seconds (default: never)")
#: Argument for the recording that a command reads.
RECORDING = argument("file", metavar="FILE", help="recording to read")


_C = TypeVar("_C")


def connected(connect: Callable[[str], _C], args: argparse.Namespace, address: str | None = None) -> _C:
    """Connect to a robot, and show the progress.

    Args:
        connect: Function that connects to an address.
        args: Arguments of a command that has an address.
        address: Address of the robot; None for the address in `args`.

    Raises:
        LinkError: See the `connect` of the package.
    """
    address = args.address if address is None else address
    with ProgressBar(f"connecting to {address}", args.quiet):
        return connect(address)


class Exportable(Protocol):
    """Recording that can be exported."""

    @property
    def missing(self) -> tuple[str, ...]:
        """Descriptions of the data that could not be read."""

    def export(
        self,
        path: str | os.PathLike[str],
        fields: Sequence[str] | None = None,
        rate: float | None = None,
        *,
        progress: Progress | None = None,
    ) -> Path:
        """Write the recording to a file. The suffix of the file determines the format."""


_T = TypeVar("_T", bound=Exportable)
_T_co = TypeVar("_T_co", bound=Exportable, covariant=True)


class Load(Protocol[_T_co]):
    """Function `load` of a package."""

    def __call__(self, path: str, /, *, progress: Progress | None = None) -> _T_co: ...


def _formats() -> str:
    from ..recording.table_files import format_list  # imported here, because most commands do not need it

    return format_list()


#: Decorator for the command `export` of a package, whose function calls `export`.
exporting = command(
    "export",
    "write a recording to a file for another program",
    RECORDING,
    argument("to", metavar="OUT", help="file to write; its suffix determines the format"),
    argument("fields", metavar="FIELD", nargs="*", trailing=True, help="write only these fields"),
    argument("--rate", type=positive_number, metavar="HZ", help="resample to HZ rows per second"),
    listing=_formats,
)


def export(args: argparse.Namespace, load: Load[_T], content: Callable[[_T], str], tell: Callable[[str], None]) -> int:
    """Export a recording, and print its missing data.

    Args:
        args: Arguments of the command.
        load: Function that reads a recording, and reports its progress.
        content: Function that describes the content of a recording, for the line at the end.
        tell: Function that prints a line on stderr.

    Raises:
        BadRecording: If there is no such recording, or the file cannot be written.
        BadValue: If the suffix or a field is unknown.
        LocalError: If the package that writes the format is not installed.
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
