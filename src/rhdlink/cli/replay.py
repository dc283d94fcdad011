"""`rhdlink replay`: print a summary of a recording, or play its changes at the recorded times."""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator

from linkcore.cli.options import (
    RECORDING,
    argument,
    command,
    positive_int,
    replay_rate,
)
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.errors import BadRecording
from linkcore.recording.file import RecordingFile
from linkcore.recording.player import ReplayTimeline
from linkcore.text import printable, strict_json

from ..recording import play
from ..variables.snapshot import Update
from .recording_summary import read_summary
from .variable_text import in_units, update_as_json, with_meaning, words_of


@command(
    "replay",
    "print a summary of a recording, or play it",
    RECORDING,
    argument("names", metavar="NAME", nargs="*", help="print only these variables", trailing=True),
    argument("--rate", type=replay_rate, metavar="R", help="play at R times the recorded speed, or max"),
    argument("--count", type=positive_int, metavar="N", help="end after N lines (default: never)"),
    argument("--json", action="store_true", help="print one JSON object per line"),
)
def run(args: argparse.Namespace) -> int:
    """Print a summary of a recording: its duration, its number of batches, and how often each variable was set.

    With --rate, print the changes instead, one line for each batch that set a variable: at R times the recorded speed,
    or without pauses with --rate max. Recordings are made by `rhdlink record`, or by the logger plugin with a file
    name that ends in .urlog.

    examples:
      rhdlink replay drive.urlog
      rhdlink replay drive.urlog transpos rotpos --rate 1
      rhdlink replay drive.urlog --rate max --json > drive.jsonl
    """
    if args.rate is None:
        if args.names or args.count is not None:
            args.usage_error("NAME and --count need --rate")
        summary = read_summary(args.file, args.quiet)
        print(strict_json(vars(summary)) if args.json else summary.as_text())
        return 0
    # On a terminal, the bar is shown only while nothing is printed.
    with ProgressBar(f"reading {args.file}", args.quiet) as progress, Interruption() as interruption:
        recording = RecordingFile(args.file, progress)
        progress.next(f"playing {args.file}")
        for update in itertools.islice(_updates(recording, args, interruption, progress), args.count):
            print(strict_json(update_as_json(update)) if args.json else _line(update), flush=True)
    return interruption.status


def _updates(
    recording: RecordingFile, args: argparse.Namespace, interruption: Interruption, progress: ProgressBar
) -> Iterator[Update]:
    clock = ReplayTimeline(recording, args.rate)
    clock.start()
    names = frozenset(args.names) or None
    for moment in play(recording, progress):
        if moment.is_handshake and names is not None:
            there = {row.name for row in (*moment.database.read, *moment.database.write)}
            missing = [name for name in args.names if name not in there]
            if missing:
                raise BadRecording(f"{recording.path} contains no variable {', '.join(map(repr, missing))}")
        if interruption.number is not None or interruption.wait(max(clock.delay(moment.received), 0.0)):
            return
        update = moment.update(names)
        if update.changes:
            yield update


def _line(update: Update) -> str:
    clock = time.strftime("%H:%M:%S", time.localtime(update.received.wall))
    parts = [f"{clock}.{int(update.received.wall * 1000) % 1000:03d}"]
    for name, change in update.changes.items():
        # An update does not contain the direction, but a name has the same meaning in both directions.
        words = words_of(change.value)
        direction = "r" if in_units("r", name, words) else "w"
        parts.append(f"{printable(name)} {with_meaning(direction, name, words)}")
    return " | ".join(parts)
