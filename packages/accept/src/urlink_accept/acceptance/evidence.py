"""Content of a logbook, prepared for checks: connections, notes, and the packets of each interface as columns."""

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

from .logbook import DELAYED, NOTES, SENT

#: Delay of this computer in s, longest or in total, above which nothing that takes time is judged. Many short delays
#: count only if they add up to this fraction of the time: then the processor is shared with other programs. On an idle
#: computer, the fraction is below 0.01.
_DELAYED, _SHARED = 0.1, 0.1


class Note(NamedTuple):
    """Note in a logbook.

    Attributes:
        at: Monotonic time of the computer, in s.
        step: Step that the note belongs to.
        said: Content of the note.
    """

    at: float
    step: str
    said: Mapping[str, Any]


@dataclass
class Wire:
    """Data of one connection in one direction.

    Attributes:
        interface: Name of the interface: "realtime", "primary", ... or "reverse".
        is_beside: Whether another connection to the interface was already open.
        is_sent: Whether these are the sent bytes rather than the received bytes.
        chunks: Bytes, with the time when they were received or sent.
    """

    interface: str
    is_beside: bool
    is_sent: bool
    chunks: list[tuple[Stamp, bytes]] = field(default_factory=list)

    @property
    def data(self) -> bytes:
        """All bytes of the connection."""
        return b"".join(data for _, data in self.chunks)


@dataclass
class Came:
    """Packets of one interface, from all connections to it.

    Attributes:
        states: Packets of the class that contains the values, in the order of their arrival.
        arrivals: Monotonic arrival time of each state, in s.
        others: All other packets.
        sizes: Number of packets of each size. The keys are the sizes in bytes.
        failures: Reasons why packets could not be decoded.
        skipped: Number of bytes that belong to no packet.
        unknown: Number of packets, or parts of packets, of an unknown type.
        tails: Number of packets, or parts of packets, that end with bytes that no layout describes.
        begins: Indices of the first state of each connection.
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
    _values: dict[str, NDArray[np.float64] | None] = field(default_factory=dict, init=False, repr=False, compare=False)

    def column(self, read: Callable[[Any], Any]) -> NDArray[np.float64] | None:
        """Return the values that `read` returns for the states, one row for each state; None if a state lacks them."""
        values = [read(state) for state in self.states]
        if not values or any(value is None for value in values):
            return None
        return np.array(values, np.float64)

    def values(self, name: str) -> NDArray[np.float64] | None:
        """Return the values of a field of the states, one row for each state; None if a state lacks it.

        Several requirements read the same fields, so the array is kept. It is read-only.
        """
        if name not in self._values:
            column = self.column(lambda state: getattr(state, name, None))
            if column is not None:
                column.flags.writeable = False
            self._values[name] = column
        return self._values[name]

    def between(self, moment: float, later: float) -> Came:
        """Return the states that arrived from one monotonic time until before another, in s."""
        first, end = (int(each) for each in np.searchsorted(self.arrived, (moment, later)))
        begins = [0, *(at - first for at in self.begins if first < at < end)] if first < end else []
        return Came(self.states[first:end], self.arrivals[first:end], begins=begins)

    @cached_property
    def arrived(self) -> NDArray[np.float64]:
        """`arrivals` as an array."""
        return np.array(self.arrivals)


class Evidence:
    """Evidence of a run.

    Args:
        path: Path of the logbook.

    Attributes:
        identity: Identity that the controller reported; None if it was never requested.
        notes: Notes in their order.
        wires: All connections, in both directions.

    Raises:
        BadRecording: If the file is not a logbook, or is damaged.
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
        """Firmware of the controller; None if the controller never reported it."""
        return None if self.identity is None else self.identity.firmware

    def said(self, step: str) -> list[Note]:
        """Return the notes of a step."""
        return [note for note in self.notes if note.step == step]

    def last(self, step: str) -> Mapping[str, Any] | None:
        """Return the content of the last note of a step; None if there is none."""
        found = self.said(step)
        return found[-1].said if found else None

    def busy(self, begin: float, end: float) -> str:
        """Return how this computer was delayed between two monotonic times in s; "" if results can be judged.

        A computer whose processor is shared can have many short delays instead of a long one. A simulated controller on
        this computer is then too slow, and leaves out packets. The time for which the step "frozen" suspends this
        program on purpose does not count.
        """
        during = [(at, by) for at, by in self._delays if at - by <= end and at >= begin]
        longest = max((by for _, by in during), default=0.0)
        if longest > _DELAYED:
            return f"it was delayed by {longest * 1e3:.0f} ms"
        total = sum(min(at, end) - max(at - by, begin) for at, by in during)
        if total > max(_DELAYED, _SHARED * (end - begin)):
            return f"its delays took {total / (end - begin):.0%} of the time"
        return ""

    @cached_property
    def _delays(self) -> list[tuple[float, float]]:
        """End and length of each delay of this computer that was not on purpose, in s."""
        frozen = [note for note in self.said("frozen") if "seconds" in note.said]
        found = []
        for at, _, said in self.said(DELAYED):
            by = said["by"]
            meant = sum(n.said["seconds"] for n in frozen if at - by <= n.at and n.at - n.said["seconds"] <= at)
            found.append((at, max(by - meant, 0.0)))
        return found

    def stage(self, number: int) -> tuple[float, float]:
        """Return the monotonic start times of a stage and of the next one, in s.

        The time is inf for a stage that did not start or does not exist.
        """
        began = {note.said["number"]: note.at for note in self.said("stage")}
        return began.get(number, math.inf), min((at for n, at in began.items() if n > number), default=math.inf)

    def received(self, interface: str) -> list[Wire]:
        """Return the received bytes of each connection to an interface."""
        return [wire for wire in self.wires if wire.interface == interface and not wire.is_sent]

    def _alone(self, interface: str) -> list[Wire]:
        """Return the connections that were opened while no other connection to the interface was open."""
        return [wire for wire in self.received(interface) if not wire.is_beside]

    @cached_property
    def realtime(self) -> Came:
        """Packets of the real-time interface."""
        return _read(((wire, RealtimeProtocol()) for wire in self._alone("realtime")), RealtimeState)

    @cached_property
    def primary(self) -> Came:
        """Packets of the primary interface."""
        return _read(((wire, PrimaryProtocol()) for wire in self._alone("primary")), RobotState)

    @cached_property
    def secondary(self) -> Came:
        """Packets of the secondary interface."""
        return _read(((wire, PrimaryProtocol()) for wire in self._alone("secondary")), RobotState)

    @cached_property
    def rtde(self) -> Came:
        """Packets of the RTDE connection with the most variables."""
        sent = [wire for wire in self.wires if wire.interface == "rtde" and wire.is_sent]
        pairs = zip(self.received("rtde"), map(_names, sent), strict=True)
        asked = [(len(names), wire, names) for wire, names in pairs]
        if not asked:
            return Came()
        _, wire, names = max(asked, key=lambda each: each[0])
        if not names:
            return Came()
        return _read([(wire, RtdeProtocol(Requests(names, optional=frozenset(names))))], Outputs)


def decoded(evidence: Evidence, wire: Wire, protocol: Any, kind: type) -> Came:
    """Return the packets of one connection. For RTDE, pass None as the protocol; the requested names determine it."""
    if protocol is not None:
        return _read([(wire, protocol())], kind)
    received = evidence.received("rtde")
    sent = [each for each in evidence.wires if each.interface == "rtde" and each.is_sent]
    names = _names(sent[next(at for at, each in enumerate(received) if each is wire)])
    return _read([(wire, RtdeProtocol(Requests(names, optional=frozenset(names))))], kind) if names else Came()


def _names(sent: Wire) -> tuple[str, ...]:
    """Return the names of the first outputs that were requested and started on a connection to RTDE."""
    data, at, is_started = sent.data, 0, False
    names: tuple[str, ...] = ()
    while at + 3 <= len(data):
        size = int.from_bytes(data[at : at + 2], "big")
        frame = data[at : at + max(size, 3)]
        is_started = is_started or frame[2:3] == b"S"
        if frame[2:3] == b"O" and not names:
            # In protocol 2, a frequency precedes the names. The first byte of the frequency is not a letter.
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
            except LinkError as error:  # the controller refused a request
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
        except LinkError:  # the peer is another interface
            return
