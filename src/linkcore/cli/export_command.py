"""The command `export` of both command lines: a recording as a file of another program."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

from ..progress import Progress
from .options import Subparsers, add_command, positive_number
from .progress_bar import ProgressBar

__all__ = ["Exportable", "add_export"]


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


def add_export(
    subparsers: Subparsers,
    description: str,
    examples: Sequence[str],
    load: Callable[[str, Progress], _T],
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
            recording = load(args.file, reading)
            with ProgressBar(f"writing {args.to}", args.quiet) as writing:
                recording.export(args.to, args.fields or None, args.rate, progress=writing)
            missing = recording.missing
        for each in missing:
            tell(f"missing: {each}")
        print(f"{args.to}: {content(recording)}")
        return 0

    parser.set_defaults(run=run, trailing="fields")
