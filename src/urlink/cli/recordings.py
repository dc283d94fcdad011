"""`urlink record`, `replay`, `export` and `plot`: a recording made, summed up or played, written for others, drawn."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from linkcore import clock
from linkcore.cli.options import (
    DURATION,
    RECORDING,
    argument,
    command,
    export,
    exporting,
    positive_int,
    positive_number,
)
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.recording.file import Kind, RecordingFile
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.stream import Stream
from linkcore.text import strict_json
from linkcore.wire.packet import State

from ..protocol.ports import INTERFACES
from ..robot import connect
from .echo import PRINTED, echo, kind_of, shower
from .options import ADDRESS, connected, tell
from .summary import RecordingSummary, summarise


@command(
    "record",
    "record what a robot sends",
    *ADDRESS,
    argument("file", metavar="FILE", help="file to make; it must not exist yet"),
    argument(
        "--interface",
        action="append",
        choices=INTERFACES,
        help="interface to record; can be repeated (realtime and primary)",
    ),
    DURATION,
    argument("--count", type=positive_int, metavar="N", help="end when N packets have come on each interface (never)"),
)
def _record(args: argparse.Namespace) -> int:
    """Record the raw bytes of one or more interfaces, with the times at which they came, into a new file.

    Every byte is kept, whether this library can decode it or not. A lost connection is noted and made again.
    Ctrl-C, SIGTERM, --duration and --count end the recording properly. After a crash the file can still be read
    up to the crash. Play it with `urlink replay`, look into it with `urlink dissect`, or use it as an address:
    replay:///path/to/file. A file that ends in .mcap gets messages of ROS 2 instead, for Foxglove and ros2 bag,
    which cannot be replayed (pip install urlink-view).

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
                    break  # the source is a recording, and it is over
    if Path(args.file).suffix.lower() == ".mcap":
        print(f"{args.file}: {Path(args.file).stat().st_size} bytes")
    else:
        print(_summary(args).as_text())
    return interruption.status


def _summary(args: argparse.Namespace) -> RecordingSummary:
    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        return summarise(RecordingFile(args.file, progress), progress)


def _rate(text: str) -> str:
    if text != "max":
        try:
            positive_number(text)
        except argparse.ArgumentTypeError:
            raise argparse.ArgumentTypeError(f"{text!r} is neither a positive number nor max") from None
    return text


@command(
    "replay",
    "print what is in a recording, or play it",
    RECORDING,
    *PRINTED,
    argument("--rate", type=_rate, metavar="R", help="play at R times the recorded speed, or max"),
)
def _replay(args: argparse.Namespace) -> int:
    """Print what is in a recording; with --rate, play it.

    Without --rate: interfaces, robot, duration, bytes, packets, gaps, lost connections, and whether the file was
    closed properly. With --rate the packets are printed as `urlink echo` prints them, with the same options, and
    at the times at which they came, divided by the rate; `--rate max` prints them at once.

    A recording is an address as well: `urlink monitor replay:///tmp/run.urlog?rate=2` watches it, and so does
    every other command that takes one.

    examples:
      urlink replay run.urlog
      urlink replay run.urlog --rate 1 q_actual tcp_force
      urlink replay run.urlog --rate max --interface primary --json > states.jsonl
    """
    if args.rate is None:
        for name in ("fields", "interface", "type", "count", "timeout"):
            if getattr(args, name):
                args.usage_error("what to print can be chosen only when the recording is played, with --rate")
        summary = _summary(args)
        print(strict_json(summary.as_json()) if args.json else summary.as_text())
        return 0
    interface, kind = kind_of(args)
    show = shower(args, kind)
    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        recording = RecordingFile(args.file, progress)
    number = recording.channel(interface)  # raises at once, and names the interfaces that there are
    address = f"replay://{quote(str(Path(args.file).absolute()))}?rate={args.rate}"
    with connect(address) as robot, ProgressBar(f"playing {args.file}", args.quiet) as progress:
        if not args.quiet:
            show = _drawing(show, progress, getattr(robot, interface), _size(recording, number))
        echo(robot, interface, kind, show, args)
    return 0


def _size(recording: RecordingFile, channel: int) -> int:
    """Number of bytes that came over one interface."""
    return sum(len(record.payload) for record in recording if (record.channel, record.kind) == (channel, Kind.BYTES))


def _drawing(
    show: Callable[[State], str], progress: ProgressBar, stream: Stream[Any], size: int
) -> Callable[[State], str]:
    """`show`, which also draws how much of `size` bytes has been played."""

    def show_and_draw(packet: State) -> str:
        progress(stream.stats.bytes / max(size, 1))
        return show(packet)

    return show_and_draw


@exporting
def _export(args: argparse.Namespace) -> int:
    """Write a recording to a file of another program: .csv, .parquet, .mat (MATLAB), .h5 (HDF5) or .mcap (Foxglove,
    ros2 bag), by its suffix.

    Without fields everything is written; into .csv and .parquet, which hold one table, everything of the first
    stream that was recorded. Fields are named as `urlink echo` names them: q_actual, joint_data.T_motor,
    rtde.actual_q. A file of that name is replaced once the new one is complete. .parquet, .mat, .h5 and .mcap need the
    extra of the same name: pip install 'urlink[mcap]', or 'urlink[data]' for all.

    examples:
      urlink export run.urlog run.csv q_actual tcp_force
      urlink export run.urlog run.parquet --rate 100
      urlink export run.urlog run.mcap
    """
    from ..recording.recording import load  # which `record` and `replay` do without

    return export(args, load, lambda recording: f"{recording.duration:.1f} s of {', '.join(recording.tables)}", tell)


@command(
    "plot",
    "draw fields of a recording",
    RECORDING,
    argument("fields", metavar="FIELD", nargs="+", help="field to draw; the first one is at the top", trailing=True),
    argument("--output", "-o", metavar="OUT", help="picture to write (a window)"),
    argument("--start", type=float, default=0.0, metavar="S", help="second at which it begins (0)"),
    argument("--end", type=float, default=float("inf"), metavar="S", help="second at which it ends (the last)"),
)
def _plot(args: argparse.Namespace) -> int:
    """Draw fields of a recording over time, a panel for each: in a window, or into a .png, .svg or .pdf.

    Fields are named as `urlink export` names them: q_actual, joint_data.T_motor, rtde.actual_q. It needs the extra
    plot: pip install 'urlink[plot]'.

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
