"""`urlink explain`: explains the stops in a recording, or in the table of a log of another program."""

from __future__ import annotations

import argparse
from pathlib import Path

from linkcore.cli.options import argument, command
from linkcore.cli.progress import ProgressBar
from linkcore.errors import BadValue
from linkcore.text import printable, strict_json

from ..errors.stop_explanation import StopExplanation
from .options import tell


@command(
    "explain",
    "explain why a robot stopped, from a recording",
    argument("file", metavar="FILE", help="a .urlog recording, or a table (.csv, .tsv, .txt, .gz)"),
    argument("--output", "-o", metavar="OUT", help=".svg file to write: a picture of the last second"),
    argument("--stop", type=int, default=0, metavar="N", help="show only stop N, counted from 1 (default: all)"),
    argument("--model", metavar="NAME", help="model of the arm, such as UR5e, if the file does not name it"),
    argument("--json", action="store_true", help="print one JSON object per stop"),
)
def run(args: argparse.Namespace) -> int:
    """Explain each stop in a recording: the cause, the code, the limit, and what was commanded.

    A table has one line of names, as RTDE or the real-time interface name them: actual_q_0, target_q_0, safety_mode.
    Columns may be missing. With --output and several stops, the picture shows the stop of --stop, or the last one.

    The exit status is 0 if the file contains a stop, and 1 if it contains none.

    examples:
      urlink explain run.urlog
      urlink explain run.urlog --stop 2 --output stop.svg
      urlink explain log.csv --model UR5e --json
    """
    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        stops = _stops(args, progress)
    if not stops:
        tell("no stop was found")
        return 1
    if args.stop:
        if not 1 <= args.stop <= len(stops):
            raise BadValue(f"--stop {args.stop}; expected 1 to {len(stops)}")
        stops = [stops[args.stop - 1]]
    for number, stop in enumerate(stops):
        if args.json:
            print(strict_json(stop.to_dict()), flush=True)
        else:
            print("\n" * (number > 0) + "\n".join(map(printable, stop.text().split("\n"))))
    if args.output is not None:
        tell(f"picture: {stops[-1].save(args.output)}")
    return 0


def _stops(args: argparse.Namespace, progress: ProgressBar) -> list[StopExplanation]:
    from ..arm.models import model
    from ..diagnosis.stop_causes import explain
    from ..diagnosis.stop_table import SUFFIXES, read_table
    from ..recording.recording import load

    arm = None if args.model is None else model(args.model)
    if Path(args.file).suffix.lower() in SUFFIXES:
        return explain(read_table(args.file, arm))
    return load(args.file, progress=progress).explain()
