"""`urlink record`: records the data that a robot sends."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from linkcore import clock
from linkcore.cli.options import (
    DURATION,
    argument,
    command,
    positive_int,
)
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.recording.table_files import format_of
from linkcore.streaming.connection_life import ConnectionState

from ..protocol.ports import INTERFACES
from .options import ADDRESS, connected, tell
from .recording_summary import read_summary


@command(
    "record",
    "record the data that a robot sends",
    *ADDRESS,
    argument("file", metavar="FILE", help="file to create; it must not exist yet"),
    argument(
        "--interface",
        action="append",
        choices=INTERFACES,
        help="interface to record; can be repeated (default: realtime and primary)",
    ),
    DURATION,
    argument("--count", type=positive_int, metavar="N", help="end after N packets on each interface (default: never)"),
)
def run(args: argparse.Namespace) -> int:
    """Record the raw bytes of one or more interfaces, with their times of arrival, into a new file.

    Every byte is kept, whether or not this library can decode it. If the connection is lost, this is recorded, and the
    command reconnects. Ctrl-C, SIGTERM, --duration and --count end the recording properly. After a crash, the file can
    be read up to the crash. Play the file with `urlink replay`, inspect it with `urlink dissect`, or use it as an
    address: replay:///path/to/file. If the file name ends in .mcap, the file contains ROS 2 messages for Foxglove and
    ros2 bag, and cannot be replayed (pip install 'urlink-robot[mcap]').

    examples:
      urlink record 192.168.56.101 run.urlog
      urlink record sim:// run.urlog --interface realtime --duration 10
      urlink record 192.168.56.101 run.urlog --interface primary --interface secondary --count 100
    """
    interfaces = list(dict.fromkeys(args.interface or ("realtime", "primary")))
    longest, most = args.duration or math.inf, args.count or math.inf
    with connected(args) as robot, Interruption() as interruption:
        streams = [getattr(robot, name) for name in interfaces]
        with robot.record(args.file, interfaces), ProgressBar("recording", args.quiet) as progress:
            tell(f"recording {' and '.join(interfaces)} of {args.address} into {args.file}; Ctrl-C ends it")
            begin = clock.now()
            interruption.end_after(args.duration)
            while not interruption.wait(0.05):
                fewest = min(stream.stats.received for stream in streams)
                progress(max((clock.now() - begin) / longest, fewest / most), f"recording, {fewest} packets")
                if fewest >= most:
                    break
                for stream in streams:
                    if stream.failure is not None:
                        raise stream.failure
                if all(stream.connection is ConnectionState.CLOSED for stream in streams):
                    break  # the source is a recording that has ended
    if format_of(args.file) is not None:
        print(f"{args.file}: {Path(args.file).stat().st_size} bytes")
    else:
        print(read_summary(args.file, args.quiet).as_text())
    return interruption.status
