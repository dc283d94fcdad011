"""`rhdlink export`: write a recording to a file in another format."""

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
    """Write a recording to a file in another format.

    The file has a column for each variable, as 32-bit words, and a row or message for each batch that the robot sent.
    An existing file is replaced when the new file is complete. The suffix of the file selects the format. Every format
    except .csv needs the extra with its name: pip install 'urlink-robot[parquet]', or 'urlink-robot[data]' for all.

    examples:
      rhdlink export drive.urlog drive.csv encl encr
      rhdlink export drive.urlog drive.parquet --rate 50
      rhdlink export drive.urlog drive.mcap
    """
    return export(args, load, lambda recording: f"{len(recording)} batches", tell)
