"""`rhdlink replay`: what is in a recording, or all of it again."""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator

from linkcore.cli.interruption import Interruption
from linkcore.cli.options import Subparsers, add_command, positive_int
from linkcore.cli.terminal import safe, strict_json
from linkcore.errors import BadRecording
from linkcore.recording.file import Recording
from linkcore.recording.player import ReplayClock

from ..playback import play
from ..update import Update
from .meaning import in_units, words_text
from .summary import summarise
from .watch import update_as_json

__all__ = ["add_parser"]

_DESCRIPTION = """\
Tell what is in a recording: how long it is, how many batches, how often each variable was set.

With --rate print what was set instead, a line for each batch that brought something new: at R times the speed
at which it was recorded, or at once with --rate max. A recording is what `rhdlink record` makes, or the
logger plugin in a file that ends in .urlog."""

_EXAMPLES = (
    "rhdlink replay drive.urlog",
    "rhdlink replay drive.urlog transpos rotpos --rate 1",
    "rhdlink replay drive.urlog --rate max --json > drive.jsonl",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "replay", "tell what is in a recording, or play it", _DESCRIPTION, _EXAMPLES)
    parser.add_argument("file", metavar="FILE", help="a recording")
    parser.add_argument("names", metavar="NAME", nargs="*", help="print only these variables")
    parser.add_argument("--rate", type=_rate, metavar="R", help="play at R times the recorded speed, or max")
    parser.add_argument("--count", type=positive_int, metavar="N", help="end after N lines (never)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    parser.set_defaults(run=run, trailing="names")


def _rate(text: str) -> float:
    """Of a `ReplayClock`: 0 is as fast as possible."""
    try:
        value = 0.0 if text == "max" else float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf") or (value == 0 and text != "max"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a positive number nor max")
    return value


def run(args: argparse.Namespace) -> int:
    """Summarise, or play.

    Raises:
        BadRecording: no such file, or it is none, or it holds no such variable.
        PacketError: it holds bytes that are no batch.
    """
    recording = Recording(args.file)
    if args.rate is None:
        if args.names or args.count is not None:
            args.usage_error("what to print can be chosen only when the recording is played, with --rate")
        summary = summarise(recording)
        print(strict_json(summary.as_json()) if args.json else summary.as_text())
        return 0
    with Interruption() as interruption:
        for update in itertools.islice(_updates(recording, args, interruption), args.count):
            print(strict_json(update_as_json(update)) if args.json else _line(update), flush=True)
    interruption.raise_if_any()
    return 0


def _updates(recording: Recording, args: argparse.Namespace, interruption: Interruption) -> Iterator[Update]:
    clock = ReplayClock(recording, args.rate)
    clock.start()
    names = frozenset(args.names) or None
    for moment in play(recording):
        if moment.is_handshake and names is not None:
            there = {row.name for table in (moment.database.read, moment.database.write) for row in table}
            missing = [name for name in args.names if name not in there]
            if missing:
                raise BadRecording(f"{recording.path} holds no variable {', '.join(map(repr, missing))}")
        if interruption.number is not None or interruption.wait(max(clock.delay(moment.received), 0.0)):
            return
        update = moment.update(names)
        if update.changes:
            yield update


def _line(update: Update) -> str:
    clock = time.strftime("%H:%M:%S", time.localtime(update.received.wall))
    parts = [f"{clock}.{int(update.received.wall * 1000) % 1000:03d}"]
    for name, change in update.changes.items():
        # The direction is not told with an update; a name has the same meaning in both.
        meaning = in_units("r", name, change.value) or in_units("w", name, change.value)
        parts.append(f"{safe(name)} {words_text(change.value)}" + (f" = {meaning}" if meaning else ""))
    return " | ".join(parts)
