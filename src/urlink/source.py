"""Where a robot's bytes come from: a controller on the network, or a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from linkcore.errors import BadRecording, BadValue, ConnectFailed
from linkcore.net.transport import TcpTransport, Transport
from linkcore.recording.file import Recording
from linkcore.recording.player import ReplayClock, ReplayTransport
from linkcore.streaming.backoff import Backoff

from .address import RecordingAddress, RobotAddress
from .decode import INTERFACES
from .firmware import Firmware
from .identity import Identity, identify

__all__ = ["Origin", "networked", "recorded"]


class Origin(NamedTuple):
    """What a robot is made of.

    Attributes:
        ask: asks the controller who it is.
        transport: makes the transport of an interface.
        options: of its streams.
    """

    ask: Callable[[], Identity]
    transport: Callable[[str], Transport]
    options: Mapping[str, Any]


def networked(
    place: RobotAddress, *, timeout: float, read_only: bool, backoff: Backoff | None, silence: float
) -> Origin:
    """A controller on the network, or a simulated one."""
    suffix = "_readonly" if read_only else ""

    def ask() -> Identity:
        try:
            return identify(place.host, place.ports["primary" + suffix], timeout)
        except ConnectFailed:
            # The version message is on the secondary interface too.
            return identify(place.host, place.ports["secondary" + suffix], timeout)

    def transport(interface: str) -> Transport:
        if interface not in INTERFACES:
            raise BadValue(f"no interface {interface!r}; expected one of {', '.join(INTERFACES)}")
        return TcpTransport(place.host, place.ports[interface + suffix], silence=silence)

    return Origin(ask, transport, {"backoff": backoff, "timeout": timeout, "silence": silence})


def recorded(place: RecordingAddress) -> Origin:
    """A recording, which is played as it is read.

    Raises:
        BadRecording: it does not exist, or is none.
    """
    recording = Recording(place.path)
    clock = ReplayClock(recording, place.rate)

    def ask() -> Identity:
        for info in recording.channels.values():
            if "firmware" in info:
                firmware = Firmware.parse(info["firmware"])
                return Identity(firmware, said_so=True, model=info.get("model"))
        raise BadRecording(f"{recording.path} does not say what firmware it was recorded from")

    return Origin(
        ask,
        lambda interface: ReplayTransport(recording, interface, clock),
        {"backoff": Backoff(first=0, most=0), "silence": None, "lossless": place.rate == 0},
    )
