"""`urlink replay`: print what is in a recording, or play it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from linkcore.cli.progress_bar import ProgressBar
from linkcore.recording.file import Kind, Recording
from linkcore.streaming.stream import Stream
from linkcore.text import strict_json
from linkcore.wire.packet import State

from ..robot import connect
from .echo import add_options, echo, kind_of, shower
from .options import Subparsers, add_command
from .summary import summarise

__all__ = ["add_parser"]

_DESCRIPTION = """\
Print what is in a recording; with --rate, play it.

Without --rate: interfaces, robot, duration, bytes, packets, gaps, lost connections, and whether the file was
closed properly. With --rate the packets are printed as `urlink echo` prints them, with the same options, and
at the times at which they came, divided by the rate; `--rate max` prints them at once.

A recording is an address as well: `urlink monitor replay:///tmp/run.urlog?rate=2` watches it, and so does
every other command that takes one."""

_EXAMPLES = (
    "urlink replay run.urlog",
    "urlink replay run.urlog --rate 1 q_actual tcp_force",
    "urlink replay run.urlog --rate max --interface primary --json > states.jsonl",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "replay", "print what is in a recording, or play it", _DESCRIPTION, _EXAMPLES)
    parser.add_argument("file", metavar="FILE", help="a recording")
    add_options(parser)
    parser.add_argument("--rate", type=_rate, metavar="R", help="play at R times the recorded speed, or max")
    parser.set_defaults(run=run)


def _rate(text: str) -> str:
    if text == "max":
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a positive number nor max")
    return text


def run(args: argparse.Namespace) -> int:
    """Print a summary, or play.

    Raises:
        BadRecording: no such file, or no recording, or it does not have this interface.
    """
    if args.rate is None:
        for name in ("fields", "interface", "type", "count", "timeout"):
            if getattr(args, name):
                args.usage_error("what to print can be chosen only when the recording is played, with --rate")
        with ProgressBar(f"reading {args.file}", args.quiet) as progress:
            summary = summarise(Recording(args.file, progress), progress)
        print(strict_json(summary.as_json()) if args.json else summary.as_text())
        return 0
    interface, kind = kind_of(args)
    show = shower(args, kind)
    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        recording = Recording(args.file, progress)
    number = recording.channel(interface)  # raises at once, and names the interfaces that there are
    address = f"replay://{quote(str(Path(args.file).absolute()))}?rate={args.rate}"
    # On a terminal the printed packets show the progress.
    with connect(address) as robot, ProgressBar("playing", args.quiet or sys.stdout.isatty()) as progress:
        if progress.is_shown:
            show = _drawing(show, progress, getattr(robot, interface), _size(recording, number))
        echo(robot, interface, kind, show, args)
    return 0


def _size(recording: Recording, channel: int) -> int:
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
