"""`urlink export`: a recording as a file of another program."""

from __future__ import annotations

import argparse

from linkcore.cli.progress import ProgressBar

from ..data.recording import load
from .options import Subparsers, add_command, positive_number
from .tap import tell

__all__ = ["add_parser"]

_DESCRIPTION = """\
Write a recording to a file of another program: .csv, .parquet, .mat (MATLAB), .h5 (HDF5) or .mcap (Foxglove,
ros2 bag), by its suffix.

Without fields everything is written; into .csv and .parquet, which hold one table, everything of the first
stream that was recorded. Fields are named as `urlink echo` names them: q_actual, joint_data.T_motor,
rtde.actual_q. A file of that name is replaced once the new one is whole. .parquet, .mat, .h5 and .mcap need the
extra of the same name: pip install 'urlink[mcap]', or 'urlink[data]' for all."""

_EXAMPLES = (
    "urlink export run.urlog run.csv q_actual tcp_force",
    "urlink export run.urlog run.parquet --rate 100",
    "urlink export run.urlog run.mcap",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(
        subparsers, "export", "write a recording to a file of another program", _DESCRIPTION, _EXAMPLES
    )
    parser.add_argument("file", metavar="FILE", help="a recording")
    parser.add_argument("to", metavar="OUT", help="file to write; its suffix says the format")
    parser.add_argument("fields", metavar="FIELD", nargs="*", help="write only these fields")
    parser.add_argument("--rate", type=positive_number, metavar="HZ", help="resample to so many rows a second")
    parser.set_defaults(run=run, trailing="fields")


def run(args: argparse.Namespace) -> int:
    """Export, and say what was missing.

    Raises:
        BadRecording: no such recording, or the file cannot be written.
        BadValue: no such format or field.
        LocalError: what writes the format is not installed.
    """
    recording = load(args.file)
    with ProgressBar(f"writing {args.to}") as progress:
        recording.export(args.to, args.fields or None, args.rate, progress=progress)
    for each in recording.missing:
        tell(f"missing: {each}")
    print(f"{args.to}: {recording.duration:.1f} s of {', '.join(recording.tables)}")
    return 0
