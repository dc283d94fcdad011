"""`urlink plot`: fields of a recording as a picture."""

from __future__ import annotations

import argparse

from linkcore.cli.progress_bar import ProgressBar

from ..data.recording import load
from .options import Subparsers, add_command
from .tap import tell

__all__ = ["add_parser"]

_DESCRIPTION = """\
Draw fields of a recording over time, a panel for each: in a window, or into a .png, .svg or .pdf.

Fields are named as `urlink export` names them: q_actual, joint_data.T_motor, rtde.actual_q. It needs the extra
plot: pip install 'urlink[plot]'."""

_EXAMPLES = (
    "urlink plot run.urlog q_actual tcp_force",
    "urlink plot run.urlog q_actual --output q.svg",
    "urlink plot run.urlog tcp_force --start 2 --end 4.5 --output contact.png",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "plot", "draw fields of a recording", _DESCRIPTION, _EXAMPLES)
    parser.add_argument("file", metavar="FILE", help="a recording")
    parser.add_argument("fields", metavar="FIELD", nargs="+", help="field to draw; the first one is at the top")
    parser.add_argument("--output", "-o", metavar="OUT", help="picture to write (a window)")
    parser.add_argument("--start", type=float, default=0.0, metavar="S", help="second at which it begins (0)")
    parser.add_argument(
        "--end", type=float, default=float("inf"), metavar="S", help="second at which it ends (the last)"
    )
    parser.set_defaults(run=run, trailing="fields")


def run(args: argparse.Namespace) -> int:
    """Draw the fields.

    Raises:
        BadRecording: no such recording, or the picture cannot be written.
        BadValue: no such field, or unknown suffix of the picture.
        LocalError: matplotlib is not installed.
    """
    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        recording = load(args.file, progress=progress)
        plot = recording.plot(*args.fields, start=args.start, end=args.end)
        missing = recording.missing
    for each in missing:
        tell(f"missing: {each}")
    if args.output is None:
        plot.show()
    else:
        print(plot.save(args.output))
    return 0
