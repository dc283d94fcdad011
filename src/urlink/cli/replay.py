"""`urlink replay`: prints what is in a recording, or its packets at the times at which they arrived."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from linkcore.cli.options import (
    RECORDING,
    argument,
    command,
    replay_rate,
)
from linkcore.cli.progress import ProgressBar
from linkcore.recording.file import Kind, RecordingFile
from linkcore.streaming.stream import Stream
from linkcore.text import strict_json
from linkcore.wire.packet import State

from ..robot import connect
from .packet_printing import PRINTED, kind_of, print_packets, shower
from .recording_summary import read_summary


@command(
    "replay",
    "print what is in a recording, or play it",
    RECORDING,
    *PRINTED,
    argument("--rate", type=replay_rate, metavar="R", help="play at R times the recorded speed, or max"),
)
def run(args: argparse.Namespace) -> int:
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
        summary = read_summary(args.file, args.quiet)
        print(strict_json(summary.as_json()) if args.json else summary.as_text())
        return 0
    interface, kind = kind_of(args)
    show = shower(args, kind)
    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        recording = RecordingFile(args.file, progress)
    number = recording.channel(interface)  # raises at once, and names the interfaces that there are
    address = f"replay://{quote(str(Path(args.file).absolute()))}?rate={args.rate or 'max'}"
    with connect(address) as robot, ProgressBar(f"playing {args.file}", args.quiet) as progress:
        if not args.quiet:
            show = _drawing(show, progress, getattr(robot, interface), _size(recording, number))
        print_packets(robot, interface, kind, show, args)
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
