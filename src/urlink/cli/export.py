"""`urlink export`: writes a recording to a file of another program."""

from __future__ import annotations

import argparse

from linkcore.cli.options import (
    export,
    exporting,
)

from .options import tell


@exporting
def run(args: argparse.Namespace) -> int:
    """Write a recording to a file of another program.

    Without fields everything is written; into a format for one table, everything of the first stream that was
    recorded. Fields are named as `urlink echo` names them: q_actual, joint_data.T_motor, rtde.actual_q. A file of
    that name is replaced once the new one is complete. Every format except .csv needs the extra of its name: pip
    install 'urlink-robot[mcap]', or 'urlink-robot[data]' for all. The suffix of the file names the format:

    examples:
      urlink export run.urlog run.csv q_actual tcp_force
      urlink export run.urlog run.parquet --rate 100
      urlink export run.urlog run.mcap
    """
    from ..recording.recording import load  # which `record` and `replay` do without

    return export(args, load, lambda recording: f"{recording.duration:.1f} s of {', '.join(recording.tables)}", tell)
