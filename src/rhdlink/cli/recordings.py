"""`rhdlink record`, `replay` and `export`: a recording made, summarised or played, and written for other programs."""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from linkcore import clock
from linkcore.cli.options import DURATION, RECORDING, argument, command, export, exporting, positive_int, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.errors import BadRecording
from linkcore.recording.file import RecordingFile
from linkcore.recording.player import ReplayTimeline
from linkcore.text import printable, strict_json

from ..loading import load
from ..recording import play
from ..variables.snapshot import Update
from .options import ADDRESS, connected, tell
from .view import in_units, update_as_json, with_meaning, words_of


@dataclass
class _Summary:
    """The contents of a recording.

    Attributes:
        file: its name.
        size: bytes.
        is_complete: whether it was closed in good order.
        left_out: bytes at its end that are unfinished or damaged.
        seconds: from the first batch to the last.
        batches: how many, those of handshakes among them.
        connections: how many.
        width: words of a time stamp.
        variables: name -> how many batches set it.
    """

    file: str
    size: int
    is_complete: bool
    left_out: int
    seconds: float = 0.0
    batches: int = 0
    connections: int = 0
    width: int = 0
    variables: dict[str, int] = field(default_factory=dict)


def _rate(text: str) -> float:
    """The rate of a `ReplayTimeline`: 0 is as fast as possible."""
    try:
        value = 0.0 if text == "max" else float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf") or (value == 0 and text != "max"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a positive number nor max")
    return value


@command(
    "record",
    "record what a robot sends",
    *ADDRESS,
    argument("file", metavar="FILE", help="file to make; it must not exist yet"),
    argument("--period", type=seconds, metavar="S", help="seconds between syncs (every tick of the robot)"),
    DURATION,
    argument("--count", type=positive_int, metavar="N", help="end after N syncs (never)"),
)
def _record(args: argparse.Namespace) -> int:
    """Record the raw bytes that a robot sends to a reader, with the times at which they came, into a new file.

    Every variable is in it from the first batch on, whether this library knows its meaning or not. A lost
    connection is noted and made again. Ctrl-C, SIGTERM, --duration and --count end the recording properly.
    After a crash the file can still be read up to the crash. Play it with `rhdlink replay`, look into it with
    `rhdlink dissect`.

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
    print(_summary_text(_summary(args)))
    return interruption.status


@command(
    "replay",
    "print what is in a recording, or play it",
    RECORDING,
    argument("names", metavar="NAME", nargs="*", help="print only these variables", trailing=True),
    argument("--rate", type=_rate, metavar="R", help="play at R times the recorded speed, or max"),
    argument("--count", type=positive_int, metavar="N", help="end after N lines (never)"),
    argument("--json", action="store_true", help="one JSON object a line"),
)
def _replay(args: argparse.Namespace) -> int:
    """Print what is in a recording: how long it is, how many batches, how often each variable was set.

    With --rate print what was set instead, a line for each batch that set a variable: at R times the speed
    at which it was recorded, or at once with --rate max. Recordings are made by `rhdlink record`, or by the
    logger plugin in a file that ends in .urlog.

    examples:
      rhdlink replay drive.urlog
      rhdlink replay drive.urlog transpos rotpos --rate 1
      rhdlink replay drive.urlog --rate max --json > drive.jsonl
    """
    if args.rate is None:
        if args.names or args.count is not None:
            args.usage_error("what to print can be chosen only when the recording is played, with --rate")
        summary = _summary(args)
        print(strict_json(vars(summary)) if args.json else _summary_text(summary))
        return 0
    # On a terminal this is shown only while nothing is printed.
    with ProgressBar(f"reading {args.file}", args.quiet) as progress, Interruption() as interruption:
        recording = RecordingFile(args.file, progress)
        progress.next(f"playing {args.file}")
        for update in itertools.islice(_updates(recording, args, interruption, progress), args.count):
            print(strict_json(update_as_json(update)) if args.json else _line(update), flush=True)
    return interruption.status


def _summary(args: argparse.Namespace) -> _Summary:
    """Read a recording through.

    Raises:
        BadRecording: it holds no robot that runs RHD.
        PacketError: it holds bytes that are not a batch.
    """
    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        recording = RecordingFile(args.file, progress)
        size = recording.path.stat().st_size
        summary = _Summary(str(recording.path), size, recording.is_complete, recording.left_out)
        first: float | None = None
        for moment in play(recording, progress):
            first = moment.received.monotonic if first is None else first
            summary.seconds = moment.received.monotonic - first
            summary.batches += 1
            summary.connections, summary.width = moment.connection, moment.width
            if moment.is_handshake:
                for row in (*moment.database.read, *moment.database.write):
                    summary.variables.setdefault(row.name, 0)
            else:
                for name in moment.update().changes:
                    summary.variables[name] += 1
    return summary


def _updates(
    recording: RecordingFile, args: argparse.Namespace, interruption: Interruption, progress: ProgressBar
) -> Iterator[Update]:
    timeline = ReplayTimeline(recording, args.rate)
    timeline.start()
    names = frozenset(args.names) or None
    for moment in play(recording, progress):
        if moment.is_handshake and names is not None:
            there = {row.name for row in (*moment.database.read, *moment.database.write)}
            missing = [name for name in args.names if name not in there]
            if missing:
                raise BadRecording(f"{recording.path} holds no variable {', '.join(map(repr, missing))}")
        if interruption.number is not None or interruption.wait(max(timeline.delay(moment.received), 0.0)):
            return
        update = moment.update(names)
        if update.changes:
            yield update


def _line(update: Update) -> str:
    clock = time.strftime("%H:%M:%S", time.localtime(update.received.wall))
    parts = [f"{clock}.{int(update.received.wall * 1000) % 1000:03d}"]
    for name, change in update.changes.items():
        # An update does not have the direction; a name has the same meaning in both.
        words = words_of(change.value)
        direction = "r" if in_units("r", name, words) else "w"
        parts.append(f"{printable(name)} {with_meaning(direction, name, words)}")
    return " | ".join(parts)


def _summary_text(summary: _Summary) -> str:
    state = "complete" if summary.is_complete else "not closed in order"
    left_out = f", {summary.left_out} bytes at its end unreadable" if summary.left_out else ""
    rate = f", {summary.batches / summary.seconds:.1f}/s" if summary.seconds else ""
    connections = f"{summary.connections} connection{'' if summary.connections == 1 else 's'}"
    lines = [
        f"{printable(summary.file)}: {summary.seconds:.1f} s, {summary.size} bytes, {state}{left_out}",
        f"{summary.batches} batches{rate}, {connections}, time stamps of {summary.width} words",
    ]
    width = max(map(len, map(printable, summary.variables)), default=0)
    lines += [f"  {printable(name):{width}}  set {count} times" for name, count in summary.variables.items()]
    return "\n".join(lines)


@exporting
def _export(args: argparse.Namespace) -> int:
    """Write a recording to a file of another program: .csv, .parquet, .mat (MATLAB), .h5 (HDF5) or .mcap (Foxglove,
    ros2 bag), by its suffix.

    A column for each variable, as 32-bit words, and a row or message for each batch that the robot sent. A file of
    that name is replaced once the new one is complete. .parquet, .mat, .h5 and .mcap need the extra of the same name:
    pip install 'urlink-robot[parquet]', or 'urlink-robot[data]' for all.

    examples:
      rhdlink export drive.urlog drive.csv encl encr
      rhdlink export drive.urlog drive.parquet --rate 50
      rhdlink export drive.urlog drive.mcap
    """
    return export(args, load, lambda recording: f"{len(recording)} batches", tell)
