"""`urlink plot`: draws fields of a recording over time."""

from __future__ import annotations

import argparse

from linkcore.cli.options import (
    RECORDING,
    argument,
    command,
)
from linkcore.cli.progress import ProgressBar

from .options import tell


@command(
    "plot",
    "draw fields of a recording",
    RECORDING,
    argument("fields", metavar="FIELD", nargs="+", help="field to draw; the first one is at the top", trailing=True),
    argument("--output", "-o", metavar="OUT", help="file to write (default: show a window)"),
    argument("--start", type=float, default=0.0, metavar="S", help="begin at second S (default: 0)"),
    argument("--end", type=float, default=float("inf"), metavar="S", help="end at second S (default: the last)"),
)
def run(args: argparse.Namespace) -> int:
    """Draw fields of a recording over time, one panel per field: in a window, or into a .png, .svg or .pdf file.

    Fields are named as in `urlink export`: q_actual, joint_data.T_motor, rtde.actual_q. This command needs the extra
    plot: pip install 'urlink-robot[plot]'.

    examples:
      urlink plot run.urlog q_actual tcp_force
      urlink plot run.urlog q_actual --output q.svg
      urlink plot run.urlog tcp_force --start 2 --end 4.5 --output contact.png
    """
    from ..recording.recording import load

    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        recording = load(args.file, progress=progress)
        plot = recording.plot(*args.fields, start=args.start, end=args.end)
        missing = recording.missing
        if args.output is not None:
            progress.next(f"drawing {args.output}")
            plot.save(args.output)
    for each in missing:
        tell(f"missing: {each}")
    if args.output is None:
        plot.show()
    else:
        print(args.output)
    return 0
