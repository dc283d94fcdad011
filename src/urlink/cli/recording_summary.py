"""Summary of a recording, channel by channel."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field
from typing import Any

from linkcore.cli.progress import ProgressBar
from linkcore.errors import PacketError, WrongPeer
from linkcore.recording.file import Kind, Progress, Record, RecordingFile
from linkcore.text import printable
from linkcore.wire.cycles import Missing
from linkcore.wire.framing import PacketProtocol

from ..protocol.primary.protocol import PrimaryProtocol
from ..protocol.realtime.protocol import RealtimeProtocol
from ..protocol.rtde.protocol import RtdeProtocol
from ..protocol.rtde.recipes import Outputs
from ..rtde.outputs import recorded_plan
from ..session.identity import described_frequency

#: A gap is a silence that is longer than this number of usual periods, and also longer than this time in seconds.
_GAP_PERIODS, _GAP_SECONDS = 5, 0.05


@dataclass
class ChannelSummary:
    """Summary of one interface in a recording.

    Attributes:
        name: Name of the interface. The attributes `address`, `firmware` and `model` describe the robot, as the
            recorder wrote them.
        bytes: Number of received bytes.
        packets: Number of decoded packets, by class; `failed` is the number of packets that could not be decoded.
        skipped: Number of bytes outside packets; `unfinished` is the number of bytes in packets that were cut off.
        connections: Number of connections during the recording; `lost` lists the errors that ended them.
        started: Wall time of the first bytes, in seconds since 1970; None if there are none.
        duration: Time from the first bytes to the last, in seconds.
        gaps: Duration of each gap between times of arrival that was much longer than usual, in seconds.
        missing: Missing cycles according to the controller's clock, number of gaps, and the longest gap in s; None if
            the packets contain no clock.
    """

    name: str
    address: str | None
    firmware: str | None
    model: str | None
    bytes: int = 0
    packets: dict[str, int] = field(default_factory=dict)
    failed: int = 0
    skipped: int = 0
    unfinished: int = 0
    connections: int = 0
    lost: list[str] = field(default_factory=list)
    started: float | None = None
    duration: float = 0.0
    gaps: list[float] = field(default_factory=list)
    missing: Missing | None = None


@dataclass
class RecordingSummary:
    """Summary of a recording.

    Attributes:
        path: Path of the file; `size` is its size in bytes.
        is_complete: Whether the recorder closed the file properly.
        left_out: Number of bytes at the end of the file that cannot be read.
        duration: Time from the first bytes to the last, over all channels, in seconds.
        channels: Summaries of the channels, in the order of recording.
    """

    path: str
    size: int
    is_complete: bool
    left_out: int
    duration: float
    channels: list[ChannelSummary]

    def as_json(self) -> dict[str, Any]:
        """Return the summary as values for JSON."""
        return {**asdict(self), "channels": [_as_json(channel) for channel in self.channels]}

    def as_text(self) -> str:
        """Return the summary as text."""
        state = "complete" if self.is_complete else "not closed properly, for example after a crash"
        if self.left_out:
            state += f"; {self.left_out} bytes at the end are damaged or unfinished, and were ignored"
        lines = [f"{printable(self.path)}: {self.duration:.1f} s, {self.size} bytes, {state}"]
        for channel in self.channels:
            lines += _channel_lines(channel)
        return "\n".join(lines)


def _as_json(channel: ChannelSummary) -> dict[str, Any]:
    missing = None if channel.missing is None else channel.missing._asdict()
    return {**asdict(channel), "missing": missing}


def _channel_lines(channel: ChannelSummary) -> list[str]:
    robot = f"{channel.model or 'unknown arm'}, firmware {channel.firmware or 'unknown'}, {channel.address or '-'}"
    lines = [f"{printable(channel.name)}: {printable(robot)}"]
    if channel.started is None:
        return [*lines, "  no bytes"]
    clock = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(channel.started))
    lines.append(f"  from {clock} for {channel.duration:.3f} s, {channel.bytes} bytes")
    packets = ", ".join(f"{count} {name}" for name, count in channel.packets.items()) or "no packets"
    count = sum(channel.packets.values())
    rate = f", {(count - 1) / channel.duration:.1f} packets/s" if channel.duration > 0 and count > 1 else ""
    lines.append(f"  {packets}{rate}")
    if channel.gaps:
        lines.append(f"  {_counted(len(channel.gaps), 'silence')}, the longest {max(channel.gaps):.3f} s")
    else:
        lines.append("  no silence")
    if channel.missing is not None:
        states = max(channel.packets.values(), default=0)  # there are more states than messages
        lines.append(f"  {channel.missing.text(states) if channel.missing.cycles else 'no cycle is missing'}")
    if channel.failed or channel.skipped or channel.unfinished:
        lines.append(
            f"  {channel.failed} packets not decoded, {channel.skipped} bytes outside packets, "
            f"{channel.unfinished} bytes of unfinished packets"
        )
    if channel.connections > 1 or channel.lost:
        reasons = "".join(f"\n    {printable(reason)}" for reason in channel.lost)
        lines.append(
            f"  {_counted(channel.connections, 'connection')}, lost {_counted(len(channel.lost), 'time')}{reasons}"
        )
    return lines


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def read_summary(path: str, quiet: bool) -> RecordingSummary:
    """Read a recording, show the progress, and return a summary."""
    with ProgressBar(f"reading {path}", quiet) as progress:
        return summarise(RecordingFile(path, progress), progress)


def summarise(recording: RecordingFile, progress: Progress) -> RecordingSummary:
    """Read a recording from beginning to end and return a summary.

    Args:
        progress: Function called with the fraction that has been read, 0 to 1.
    """
    readers = {number: _Reader(info) for number, info in recording.channels.items()}
    for record in recording.records(progress):
        reader = readers.get(record.channel)
        if reader is not None:
            reader.take(record)
    for reader in readers.values():
        reader.finish()
    starts = [reader.first for reader in readers.values() if reader.first is not None]
    ends = [reader.last for reader in readers.values() if reader.first is not None]
    return RecordingSummary(
        path=str(recording.path),
        size=recording.path.stat().st_size,
        is_complete=recording.is_complete,
        left_out=recording.left_out,
        duration=max(ends) - min(starts) if starts else 0.0,
        channels=[reader.channel for reader in readers.values()],
    )


class _Reader:
    """Counters of one channel, while the recording is read."""

    def __init__(self, info: dict[str, Any]) -> None:
        said = {key: None if info.get(key) is None else str(info[key]) for key in ("address", "firmware", "model")}
        self.channel = ChannelSummary(info["name"], said["address"], said["firmware"], said["model"])
        self.first: float | None = None
        self.last = 0.0
        self._info = info
        self._periods: list[float] = []
        self._session = self._new_session()

    def _new_session(self) -> PacketProtocol:
        if self.channel.name == "rtde":
            return RtdeProtocol(recorded_plan(self._info, Outputs))
        is_realtime = self.channel.name == "realtime"
        return RealtimeProtocol(described_frequency(self._info)) if is_realtime else PrimaryProtocol()

    def take(self, record: Record) -> None:
        if record.kind is Kind.EVENT:
            event = json.loads(record.payload)
            if event.get("state") == "connected":
                self.channel.connections += 1
            elif event.get("state") == "lost":
                self.channel.lost.append(str(event.get("error")))
                self._end_session()
        elif record.kind is Kind.BYTES:
            channel = self.channel
            if self.first is None:
                self.first, channel.started = record.stamp.monotonic, record.stamp.wall
            else:
                self._periods.append(record.stamp.monotonic - self.last)
            self.last = record.stamp.monotonic
            channel.bytes += len(record.payload)
            self._decode(record.payload)

    def _decode(self, data: bytes) -> None:
        channel = self.channel
        try:
            frames = self._session.framer.feed(data)
        except WrongPeer:
            channel.skipped += len(data)
            return
        if frames and self._session.cycles is not None:
            self._session.cycles.take(frames)
        for frame in frames:
            try:
                name = type(self._session.decode(frame)).__name__
            except PacketError:
                channel.failed += 1
            else:
                channel.packets[name] = channel.packets.get(name, 0) + 1

    def _end_session(self) -> None:
        framer = self._session.framer
        self.channel.skipped += framer.skipped
        self.channel.unfinished += len(framer.rest)
        if self._session.cycles is not None:
            self.channel.missing = self._session.cycles.missing.plus(self.channel.missing or Missing())
        self._session = self._new_session()

    def finish(self) -> None:
        self._end_session()
        if self.first is not None:
            self.channel.duration = self.last - self.first
        if self._periods:
            usual = sorted(self._periods)[len(self._periods) // 2]
            longest = max(usual * _GAP_PERIODS, _GAP_SECONDS)
            self.channel.gaps = [period for period in self._periods if period > longest]
