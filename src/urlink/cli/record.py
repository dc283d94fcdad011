"""`urlink record`: write what a robot sends to a file."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from linkcore.cli.interruption import Interruption
from linkcore.cli.progress_bar import ProgressBar
from linkcore.recording.file import Recording
from linkcore.streaming.events import ConnectionState

from ..decoding import INTERFACES
from ..robot import connect
from .options import Subparsers, add_address, add_command, positive_int, seconds
from .summary import summarise
from .tap import tell

__all__ = ["add_parser"]

_DESCRIPTION = """\
Record the raw bytes of one or more interfaces, with the times at which they came, into a new file.

Every byte is kept, whether this library can decode it or not. A lost connection is noted and made again.
Ctrl-C, SIGTERM, --duration and --count end the recording properly. After a crash the file can still be read
up to the crash. Play it with `urlink replay`, look into it with `urlink dissect`, or use it as an address:
replay:///path/to/file. A file that ends in .mcap gets messages of ROS 2 instead, for Foxglove and ros2 bag,
which cannot be replayed (pip install 'urlink[mcap]')."""

_EXAMPLES = (
    "urlink record 192.168.56.101 run.urlog",
    "urlink record sim:// run.urlog --interface realtime --duration 10",
    "urlink record 192.168.56.101 run.urlog --interface primary --interface secondary --count 100",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "record", "record what a robot sends", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    parser.add_argument("file", metavar="FILE", help="file to make; it must not exist yet")
    parser.add_argument(
        "--interface",
        action="append",
        choices=INTERFACES,
        help="interface to record; can be repeated (realtime and primary)",
    )
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds (never)")
    parser.add_argument(
        "--count", type=positive_int, metavar="N", help="end when N packets have come on each interface (never)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record until interrupted, and print what is in the file.

    Raises:
        BadRecording: the file exists, or cannot be made.
        RemoteError: the robot cannot be connected to, or a stream gave up.
    """
    interfaces = list(dict.fromkeys(args.interface or ("realtime", "primary")))
    with connect(args.address, timeout=args.connect_timeout) as robot, Interruption() as interruption:
        streams = [getattr(robot, name) for name in interfaces]
        with robot.record(args.file, interfaces), ProgressBar("recording", args.quiet) as progress:
            tell(f"recording {' and '.join(interfaces)} of {args.address} into {args.file}; Ctrl-C ends it")
            begin = time.monotonic()
            until = None if args.duration is None else begin + args.duration
            while until is None or time.monotonic() < until:
                left = 0.05 if until is None else min(0.05, max(until - time.monotonic(), 0.0))
                if interruption.wait(left):
                    break
                fewest = min(stream.stats.received for stream in streams)
                progress(
                    max(
                        0.0 if args.duration is None else (time.monotonic() - begin) / args.duration,
                        0.0 if args.count is None else fewest / args.count,
                    )
                )
                if args.count is not None and fewest >= args.count:
                    break
                for stream in streams:
                    if stream.failure is not None:
                        raise stream.failure
                if all(stream.connection is ConnectionState.CLOSED for stream in streams):
                    break  # the source is a recording, and it is over
    if Path(args.file).suffix.lower() == ".mcap":
        print(f"{args.file}: {Path(args.file).stat().st_size} bytes")
    else:
        with ProgressBar(f"reading {args.file}", args.quiet) as progress:
            summary = summarise(Recording(args.file, progress), progress)
        print(summary.as_text())
    interruption.raise_if_any()
    return 0
