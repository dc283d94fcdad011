"""What a logbook holds, ready to be judged: connections, notes, and the packets of each interface as columns."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from linkcore.clock import Stamp
from urlink import Firmware, LinkError, PacketError, RealtimeState
from urlink.packets import RobotState
from urlink.rtde import Outputs
from urlink.tools import (
    Identity,
    Kind,
    OutputsRequest,
    PrimaryProtocol,
    RealtimeProtocol,
    RecordingFile,
    Requests,
    RtdeProtocol,
    decode_request,
    described,
    described_identity,
    split_names,
)

from .logbook import NOTES, SENT


class Note(NamedTuple):
    """A note.

    Attributes:
        at: s, monotonic clock of the computer.
        step: what it is about.
        said: the rest of it.
    """

    at: float
    step: str
    said: Mapping[str, Any]


@dataclass
class Wire:
    """One connection, in one direction.

    Attributes:
        interface: "realtime", "primary", ... or "reverse".
        is_beside: another connection to it was open already.
        is_sent: what this side has sent, and not what came.
        chunks: the bytes, and when they came or went.
    """

    interface: str
    is_beside: bool
    is_sent: bool
    chunks: list[tuple[Stamp, bytes]] = field(default_factory=list)

    @property
    def data(self) -> bytes:
        """All of its bytes."""
        return b"".join(data for _, data in self.chunks)


@dataclass
class Came:
    """The packets of one interface, of all connections to it.

    Attributes:
        states: those of the class that has the values, in the order of their arrival.
        arrivals: s, monotonic, of each.
        others: every other packet.
        sizes: bytes of a packet -> how many had so many.
        failures: what could not be decoded, with the reason.
        skipped: bytes that belonged to no packet.
        unknown, tails: packets, or parts of them, that no layout explains, or that end in bytes which none explains.
        begins: numbers of the states with which a connection begins.
    """

    states: list[Any] = field(default_factory=list)
    arrivals: list[float] = field(default_factory=list)
    others: list[tuple[float, Any]] = field(default_factory=list)
    sizes: Counter[int] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    skipped: int = 0
    unknown: int = 0
    tails: int = 0
    begins: list[int] = field(default_factory=list)

    def column(self, read: Callable[[Any], Any]) -> NDArray[np.float64] | None:
        """What `read` gives of each state, as an array of a row each; None where it is sent by none."""
        values = [read(state) for state in self.states]
        if not values or any(value is None for value in values):
            return None
        return np.array(values, np.float64)

    def between(self, moment: float, later: float) -> Came:
        """The states that came from one moment on and before another, s, monotonic."""
        first, end = (int(each) for each in np.searchsorted(self.arrived, (moment, later)))
        begins = [0, *(at - first for at in self.begins if first < at < end)] if first < end else []
        return Came(self.states[first:end], self.arrivals[first:end], begins=begins)

    @cached_property
    def arrived(self) -> NDArray[np.float64]:
        """`arrivals` as an array."""
        return np.array(self.arrivals)


class Evidence:
    """What is known of a run.

    Args:
        path: of the logbook.

    Attributes:
        identity: what the controller reported of itself; None where it was never asked.
        notes: in the order in which they were made.
        wires: every connection, in both directions.

    Raises:
        BadRecording: not a logbook, or a damaged one.
    """

    def __init__(self, path: Path) -> None:
        recording = RecordingFile(path)
        self.identity: Identity | None = None
        self.notes: list[Note] = []
        self.wires: list[Wire] = []
        present: dict[int, Wire] = {}
        names = {number: info["name"] for number, info in recording.channels.items()}
        for record in recording:
            name = names.get(record.channel, "")
            if record.kind is Kind.BYTES and name == NOTES:
                said = described(path, record.channel, record.payload, "step")
                self.notes.append(Note(record.stamp.monotonic, said.pop("step"), said))
            elif record.kind is Kind.BYTES:
                present[record.channel].chunks.append((record.stamp, record.payload))
            elif (
                record.kind is Kind.EVENT
                and described(path, record.channel, record.payload, "state")["state"] == "connected"
            ):
                bare, _, number = name.removesuffix(SENT).partition(" ")
                present[record.channel] = Wire(bare, bool(number), name.endswith(SENT))
                self.wires.append(present[record.channel])
        known = next((note.said for note in self.notes if note.step == "identity"), None)
        if known is not None:
            self.identity = described_identity({"name": NOTES, **known})

    @property
    def firmware(self) -> Firmware | None:
        """The controller's firmware; None where it never reported it."""
        return None if self.identity is None else self.identity.firmware

    def said(self, step: str) -> list[Note]:
        """The notes about a step."""
        return [note for note in self.notes if note.step == step]

    def last(self, step: str) -> Mapping[str, Any] | None:
        """The last note about a step; None where there is none."""
        found = self.said(step)
        return found[-1].said if found else None

    def stage(self, number: int) -> tuple[float, float]:
        """When a stage began and when the next one did, s, monotonic: inf where it has not begun, or was the last."""
        began = {note.said["number"]: note.at for note in self.said("stage")}
        return began.get(number, math.inf), min((at for n, at in began.items() if n > number), default=math.inf)

    def received(self, interface: str) -> list[Wire]:
        """What came on each connection to an interface."""
        return [wire for wire in self.wires if wire.interface == interface and not wire.is_sent]

    def _alone(self, interface: str) -> list[Wire]:
        """The connections one after the other, without those that were open beside one."""
        return [wire for wire in self.received(interface) if not wire.is_beside]

    @cached_property
    def realtime(self) -> Came:
        """What came on the real-time interface."""
        return _read(((wire, RealtimeProtocol()) for wire in self._alone("realtime")), RealtimeState)

    @cached_property
    def primary(self) -> Came:
        """What came on the primary interface."""
        return _read(((wire, PrimaryProtocol()) for wire in self._alone("primary")), RobotState)

    @cached_property
    def secondary(self) -> Came:
        """What came on the secondary interface."""
        return _read(((wire, PrimaryProtocol()) for wire in self._alone("secondary")), RobotState)

    @cached_property
    def rtde(self) -> Came:
        """Data packages of RTDE, of the connection with the most variables, and what else came on it."""
        sent = [wire for wire in self.wires if wire.interface == "rtde" and wire.is_sent]
        pairs = zip(self.received("rtde"), map(_names, sent), strict=True)
        asked = [(len(names), wire, names) for wire, names in pairs]
        if not asked:
            return Came()
        _, wire, names = max(asked, key=lambda each: each[0])
        if not names:
            return Came()
        return _read([(wire, RtdeProtocol(Requests(names, optional=frozenset(names))))], Outputs)


def _names(sent: Wire) -> tuple[str, ...]:
    """The outputs that were asked for first, and started, on a connection to RTDE."""
    data, at, is_started = sent.data, 0, False
    names: tuple[str, ...] = ()
    while at + 3 <= len(data):
        size = int.from_bytes(data[at : at + 2], "big")
        frame = data[at : at + max(size, 3)]
        is_started = is_started or frame[2:3] == b"S"
        if frame[2:3] == b"O" and not names:
            # Under protocol 2 a frequency comes first, whose first byte is not a letter.
            request = decode_request(frame, 1 if frame[3:4].isalpha() else 2)
            assert isinstance(request, OutputsRequest)
            names = split_names(request.names)
        at += max(size, 3)
    return names if is_started else ()


def _read(wires: Any, kind: type) -> Came:
    found = Came()
    for wire, protocol in wires:
        is_first = True
        for stamp, frame in _frames(wire, protocol):
            found.sizes[len(frame)] += 1
            try:
                packet = protocol.decode(frame, stamp)
            except PacketError as error:
                found.failures.append(str(error))
                continue
            except LinkError as error:  # a refusal
                found.others.append((stamp.monotonic, error))
                continue
            if isinstance(packet, kind):
                if is_first:
                    found.begins.append(len(found.states))
                    is_first = False
                found.states.append(packet)
                found.arrivals.append(stamp.monotonic)
            else:
                found.others.append((stamp.monotonic, packet))
        found.skipped += protocol.framer.skipped
        found.unknown += protocol.unknown
        found.tails += protocol.tails
    return found


def _frames(wire: Wire, protocol: Any) -> Iterator[tuple[Stamp, bytes]]:
    for stamp, data in wire.chunks:
        try:
            for frame in protocol.framer.feed(data):
                yield stamp, frame
        except LinkError:  # another interface talks here
            return
