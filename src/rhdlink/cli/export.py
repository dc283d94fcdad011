"""`rhdlink export`: writes a recording to a file of another program."""

from __future__ import annotations

import argparse

from linkcore.cli.options import (
    export,
    exporting,
)

from ..loading import load
from .options import tell


@exporting
def run(args: argparse.Namespace) -> int:
    """Write a recording to a file of another program.

    A column for each variable, as 32-bit words, and a row or message for each batch that the robot sent. A file of
    that name is replaced once the new one is complete. Every format except .csv needs the extra of its name: pip
    install 'urlink-robot[parquet]', or 'urlink-robot[data]' for all. The suffix of the file names the format:

    examples:
      rhdlink export drive.urlog drive.csv encl encr
      rhdlink export drive.urlog drive.parquet --rate 50
      rhdlink export drive.urlog drive.mcap
    """
    return export(args, load, lambda recording: f"{len(recording)} batches", tell)
