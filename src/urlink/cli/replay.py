"""`urlink replay`: prints a summary of a recording, or its packets at the times of their arrival."""

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
    "print a summary of a recording, or play it",
    RECORDING,
    *PRINTED,
    argument("--rate", type=replay_rate, metavar="R", help="play at R times the recorded speed, or at max"),
)
def run(args: argparse.Namespace) -> int:
    """Print a summary of a recording; with --rate, play it.

    Without --rate, this prints the interfaces, robot, duration, bytes, packets, gaps, lost connections, and whether
    the file was closed properly. With --rate, packets are printed as in `urlink echo`, with the same options, at their
    recorded times divided by the rate. `--rate max` prints them immediately.

    A recording can also be used as an address, with every command that takes one. For example,
    `urlink monitor replay:///tmp/run.urlog?rate=2` shows the recording at twice the recorded speed.

    examples:
      urlink replay run.urlog
      urlink replay run.urlog --rate 1 q_actual tcp_force
      urlink replay run.urlog --rate max --interface primary --json > states.jsonl
    """
    if args.rate is None:
        for name in ("fields", "interface", "type", "count", "timeout"):
            if getattr(args, name):
                args.usage_error("the options for printed packets need --rate, which plays the recording")
        summary = read_summary(args.file, args.quiet)
        print(strict_json(summary.as_json()) if args.json else summary.as_text())
        return 0
    interface, kind = kind_of(args)
    show = shower(args, kind)
    with ProgressBar(f"reading {args.file}", args.quiet) as progress:
        recording = RecordingFile(args.file, progress)
    number = recording.channel(interface)  # raises an error with the recorded names if `interface` is none of them
    address = f"replay://{quote(str(Path(args.file).absolute()))}?rate={args.rate or 'max'}"
    with connect(address) as robot, ProgressBar(f"playing {args.file}", args.quiet) as progress:
        if not args.quiet:
            show = _drawing(show, progress, getattr(robot, interface), _size(recording, number))
        print_packets(robot, interface, kind, show, args)
    return 0


def _size(recording: RecordingFile, channel: int) -> int:
    """Return the number of bytes received over one interface."""
    return sum(len(record.payload) for record in recording if (record.channel, record.kind) == (channel, Kind.BYTES))


def _drawing(
    show: Callable[[State], str], progress: ProgressBar, stream: Stream[Any], size: int
) -> Callable[[State], str]:
    """Return a function that calls `show`, and also draws the fraction of `size` bytes that has been played."""

    def show_and_draw(packet: State) -> str:
        progress(stream.stats.bytes / max(size, 1))
        return show(packet)

    return show_and_draw
