"""Declaration of a command: its name, help, arguments and function; and the arguments that many commands share."""

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

#: What declares arguments at a parser, or at a group of one.
Row = Callable[[Any], None]
#: The attribute of argparse's own argument with the words that it takes.
_WORDS = "completed_words"


def argument(*names: str, words: Callable[[], Iterable[str]] | None = None, trailing: bool = False, **how: Any) -> Row:
    """One argument.

    Args:
        names, how: those of `argparse.ArgumentParser.add_argument`.
        words: what a shell completes it from, computed for the script of `completion` only.
        trailing: takes words that come after an option too, which argparse does not do for a variable number of them.
    """

    def declare(parser: Any) -> None:
        action = parser.add_argument(*names, **how)
        if words is not None:
            setattr(action, _WORDS, words)
        if trailing:
            parser.set_defaults(trailing=action.dest)

    return declare


def one_of(*rows: Row) -> Row:
    """Arguments of which one can be given."""

    def declare(parser: Any) -> None:
        group = parser.add_mutually_exclusive_group()
        for row in rows:
            row(group)

    return declare


def completed_words(action: argparse.Action) -> Iterable[str]:
    """The words that a shell completes an argument from."""
    words: Callable[[], Iterable[str]] = getattr(action, _WORDS, tuple)
    return [*words(), *map(str, action.choices or ())]


class Subcommand(NamedTuple):
    """A command of a program.

    Attributes:
        name: on the command line.
        summary: its line in the help of the program.
        rows: its arguments, in the order of its help.
        run: gets the parsed arguments, and returns the exit status. Its docstring is the help of the command.
        listing: makes lines that follow the description; called when the command is declared.
    """

    name: str
    summary: str
    rows: tuple[Row, ...]
    run: Callable[[argparse.Namespace], int]
    listing: Callable[[], str] | None = None

    def declare(self, subparsers: Any) -> None:
        """Add its parser to those of the program; `subparsers` is of a class that is argparse's own."""
        text = inspect.getdoc(self.run) or "No more help: this Python runs without docstrings (option -OO)."
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
    parser.add_argument("-v", "--verbose", action="count", default=0, help="log events; twice logs everything")
    parser.add_argument("-q", "--quiet", action="store_true", help="show no progress")


def command(
    name: str, summary: str, *rows: Row, listing: Callable[[], str] | None = None
) -> Callable[[Callable[[argparse.Namespace], int]], Subcommand]:
    """Make a command of a function, whose docstring ends with lines of examples below ``examples:``.

    `program` finds it in its module. The arguments are those of `Subcommand`.
    """
    return lambda run: Subcommand(name, summary, rows, run, listing)


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


def replay_rate(text: str) -> float:
    """How many times as fast as it was recorded; 0 for ``max``, as fast as possible."""
    if text == "max":
        return 0.0
    try:
        return positive_number(text)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a positive number nor max") from None


#: For how long a command runs.
DURATION = argument("--duration", type=seconds, metavar="S", help="end after S seconds (never)")
#: The file that a command reads.
RECORDING = argument("file", metavar="FILE", help="a recording")


_C = TypeVar("_C")


def connected(connect: Callable[[str], _C], args: argparse.Namespace, address: str | None = None) -> _C:
    """Connect to a robot, and show the progress.

    Args:
        connect: Connects to an address.
        args: The arguments of a command that takes an address.
        address: Address of the robot; None for the one in `args`.

    Raises:
        LinkError: See the `connect` of the package.
    """
    address = args.address if address is None else address
    with ProgressBar(f"connecting to {address}", args.quiet):
        return connect(address)


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


def _formats() -> str:
    from ..recording.table_files import format_list  # which most commands do without

    return format_list()


#: The command `export` of a package, made of a function that calls `export`.
exporting = command(
    "export",
    "write a recording to a file of another program",
    RECORDING,
    argument("to", metavar="OUT", help="file to write; its suffix says the format"),
    argument("fields", metavar="FIELD", nargs="*", trailing=True, help="write only these fields"),
    argument("--rate", type=positive_number, metavar="HZ", help="resample to so many rows a second"),
    listing=_formats,
)


def export(args: argparse.Namespace, load: Load[_T], content: Callable[[_T], str], tell: Callable[[str], None]) -> int:
    """Export, and print what was missing.

    Args:
        load: reads a recording, and reports the progress.
        content: describes what is in it, for the line at the end.
        tell: prints a line on stderr.

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
