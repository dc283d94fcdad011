"""A recording as the source of a robot's bytes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from linkcore.errors import BadRecording
from linkcore.net.transport import Transport
from linkcore.recording.file import RecordingFile
from linkcore.recording.player import ReplayClock, ReplayTransport
from linkcore.streaming.connection_life import Backoff

from .address import RecordingAddress
from .identity import Identity, described_identity
from .source import Source

__all__ = ["recorded"]


def recorded(place: RecordingAddress) -> Source:
    """A recording, which is played as it is read.

    Raises:
        BadRecording: it does not exist, or is none.
    """
    recording = RecordingFile(place.path)
    clock = ReplayClock(recording, place.rate)

    def ask() -> Identity:
        for info in recording.channels.values():
            if "firmware" in info:
                return described_identity(info)
        raise BadRecording(f"{recording.path} does not say what firmware it was recorded from")

    def transport(interface: str) -> Transport:
        return ReplayTransport(recording, interface, clock)

    def channel(interface: str) -> Mapping[str, Any]:
        return recording.channels[recording.channel(interface)]

    at_once = Backoff(first=0, most=0)
    return Source(ask, transport, at_once, timeout=5.0, silence=None, is_lossless=place.rate == 0, channel=channel)
