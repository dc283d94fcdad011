"""`rhdlink record`: record the data that a robot sends."""

from __future__ import annotations

import argparse

from linkcore import clock
from linkcore.cli.options import (
    DURATION,
    argument,
    command,
    positive_int,
    seconds,
)
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption

from .options import ADDRESS, connected, tell
from .recording_summary import read_summary


@command(
    "record",
    "record the data of a robot",
    *ADDRESS,
    argument("file", metavar="FILE", help="new file; it must not exist yet"),
    argument("--period", type=seconds, metavar="S", help="seconds between syncs (default: every tick of the robot)"),
    DURATION,
    argument("--count", type=positive_int, metavar="N", help="end after N syncs (default: never)"),
)
def run(args: argparse.Namespace) -> int:
    """Record the raw bytes that a robot sends to a reader, with their arrival times, into a new file.

    The file contains every variable, beginning with the first batch, whether this library knows its meaning or not. If
    the connection is lost, this is recorded, and the command reconnects. Ctrl-C, SIGTERM, --duration and --count end
    the recording properly. After a crash, the file can be read up to the crash. Play the file with `rhdlink replay`,
    or examine it with `rhdlink dissect`.

    examples:
      rhdlink record localhost drive.urlog
      rhdlink record smr12 drive.urlog --duration 10
      rhdlink record localhost drive.urlog --period 0.1 --count 100
    """
    with (
        Interruption() as interruption,
        connected(args, record=args.file) as robot,
        ProgressBar("recording", args.quiet) as progress,
    ):
        tell(f"recording {robot.address} into {args.file}; Ctrl-C ends it")
        begin = clock.now()
        interruption.end_after(args.duration)
        sync_thread = robot.background(args.period)
        while not interruption.wait(0.02) and (args.count is None or sync_thread.syncs < args.count):
            by_time = 0.0 if args.duration is None else (clock.now() - begin) / args.duration
            by_count = 0.0 if args.count is None else sync_thread.syncs / args.count
            progress(max(by_time, by_count), f"recording, {sync_thread.syncs} syncs")
            if sync_thread.failure is not None:
                raise sync_thread.failure
    print(read_summary(args.file, args.quiet).as_text())
    return interruption.status
