"""`rhdlink export`: a recording as a file of another program."""

from __future__ import annotations

import argparse

from linkcore.cli.options import Subparsers, add_command, positive_number
from linkcore.cli.progress import ProgressBar
from linkcore.recording.exporting import chosen, export
from linkcore.recording.table_files import TABLE_WRITERS

from ..recording.loading import load
from .options import tell

__all__ = ["add_parser"]

_DESCRIPTION = """\
Write a recording to a file of another program: .csv, .parquet, .mat (MATLAB) or .h5 (HDF5), by its suffix.

A column for each variable, as 32-bit words, and a row for each batch that the robot sent. A file of that name
is replaced once the new one is whole. .parquet, .mat and .h5 need the extra of the same name:
pip install 'urlink[parquet]', or 'urlink[data]' for all."""

_EXAMPLES = (
    "rhdlink export drive.urlog drive.csv encl encr",
    "rhdlink export drive.urlog drive.parquet --rate 50",
    "rhdlink export drive.urlog drive.mat",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(
        subparsers, "export", "write a recording to a file of another program", _DESCRIPTION, _EXAMPLES
    )
    parser.add_argument("file", metavar="FILE", help="a recording")
    parser.add_argument("to", metavar="OUT", help="file to write; its suffix says the format")
    parser.add_argument("names", metavar="NAME", nargs="*", help="write only these variables")
    parser.add_argument("--rate", type=positive_number, metavar="HZ", help="resample to so many rows a second")
    parser.set_defaults(run=run, trailing="names")


def run(args: argparse.Namespace) -> int:
    """Export, and say what was missing.

    Raises:
        BadRecording: no such recording, or the file cannot be written.
        BadValue: no such format or variable.
        LocalError: what writes the format is not installed.
    """
    table = load(args.file)
    with ProgressBar(f"writing {args.to}") as progress:
        export(args.to, chosen({"rhd": table}, args.names or None, args.rate), TABLE_WRITERS, progress)
    for each in table.missing:
        tell(f"missing: {each}")
    print(f"{args.to}: {len(table)} batches")
    return 0
