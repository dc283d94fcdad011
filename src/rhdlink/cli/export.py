"""`rhdlink export`: a recording as a file of another program."""

from __future__ import annotations

from linkcore.cli.export_command import add_export
from linkcore.cli.options import Subparsers

from ..recording.loading import load
from .options import tell

__all__ = ["add_parser"]

_DESCRIPTION = """\
Write a recording to a file of another program: .csv, .parquet, .mat (MATLAB), .h5 (HDF5) or .mcap (Foxglove,
ros2 bag), by its suffix.

A column for each variable, as 32-bit words, and a row or message for each batch that the robot sent. A file of
that name is replaced once the new one is complete. .parquet, .mat, .h5 and .mcap need the extra of the same name:
pip install 'urlink[parquet]', or 'urlink[data]' for all."""

_EXAMPLES = (
    "rhdlink export drive.urlog drive.csv encl encr",
    "rhdlink export drive.urlog drive.parquet --rate 50",
    "rhdlink export drive.urlog drive.mcap",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    add_export(
        subparsers,
        _DESCRIPTION,
        _EXAMPLES,
        lambda path, progress: load(path, progress=progress),
        lambda recording: f"{len(recording)} batches",
        tell,
    )
