"""`urlink export`: writes a recording to a file for another program."""

from __future__ import annotations

import argparse

from linkcore.cli.options import (
    export,
    exporting,
)

from .options import tell


@exporting
def run(args: argparse.Namespace) -> int:
    """Write a recording to a file for another program.

    Without FIELD, all fields are written; a format for a single table gets all fields of the first recorded stream.
    Fields are named as in `urlink echo`: q_actual, joint_data.T_motor, rtde.actual_q. An existing file of that name is
    replaced when the new one is complete. Every format except .csv needs the extra with its name: pip install
    'urlink-robot[mcap]', or 'urlink-robot[data]' for all. The suffix of the file selects the format:

    examples:
      urlink export run.urlog run.csv q_actual tcp_force
      urlink export run.urlog run.parquet --rate 100
      urlink export run.urlog run.mcap
    """
    from ..recording.recording import load  # imported here, because `record` and `replay` do not need it

    return export(args, load, lambda recording: f"{recording.duration:.1f} s of {', '.join(recording.tables)}", tell)
