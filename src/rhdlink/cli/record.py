"""`rhdlink record`: keep what a robot sends."""

from __future__ import annotations

import argparse
import time

from linkcore.cli.interruption import Interruption
from linkcore.cli.options import Subparsers, add_command, positive_int, seconds
from linkcore.recording.file import Recording

from ..client import connect
from .options import add_address, tell
from .summary import summarise

__all__ = ["add_parser"]

_DESCRIPTION = """\
Record the raw bytes that a robot sends to a reader, with the times at which they came, into a new file.

Every variable is in it from the first batch on, whether this library knows what it means or not. A lost
connection is noted and made again. Ctrl-C or SIGTERM ends the recording in order; so does --duration or
--count. After a crash the file is still readable up to the crash. Play it with `rhdlink replay`, look into it
with `rhdlink dissect`."""

_EXAMPLES = (
    "rhdlink record localhost drive.urlog",
    "rhdlink record smr12 drive.urlog --duration 10",
    "rhdlink record localhost drive.urlog --period 0.1 --count 100",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "record", "record what a robot sends", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    parser.add_argument("file", metavar="FILE", help="file to make; it must not exist yet")
    parser.add_argument("--period", type=seconds, metavar="S", help="seconds between syncs (every tick of the robot)")
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds (never)")
    parser.add_argument("--count", type=positive_int, metavar="N", help="end after N syncs (never)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record until told to stop, and say what is in the file.

    Raises:
        BadRecording: the file exists, or cannot be made, or the disk failed.
        RemoteError: nobody is there.
    """
    with Interruption() as interruption, connect(args.address, timeout=args.timeout, record=args.file) as robot:
        tell(f"recording {robot.address} into {args.file}; Ctrl-C ends it")
        until = None if args.duration is None else time.monotonic() + args.duration
        background = robot.background(args.period)
        while until is None or time.monotonic() < until:
            left = 0.02 if until is None else min(0.02, max(until - time.monotonic(), 0.0))
            if interruption.wait(left) or (args.count is not None and background.syncs >= args.count):
                break
            if background.failure is not None:
                raise background.failure
    print(summarise(Recording(args.file)).as_text())
    interruption.raise_if_any()
    return 0
