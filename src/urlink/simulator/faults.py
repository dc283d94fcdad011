"""What can go wrong, on demand: from Python as methods, from a command line as text.

Faults of the arm change its modes, as on a real controller. Faults of the link change the bytes or the connections; the
controller itself runs on. All methods may be called from any thread, and have happened when they return.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from linkcore.errors import BadValue, LocalError
from urlink.firmware import Firmware

from ..ports import PORTS, interface
from . import tampering
from .packets import package

if TYPE_CHECKING:
    from .controller import Controller

__all__ = ["FAULTS", "Faults", "ScheduledFault", "parse_fault"]


class Faults:
    """The faults of one controller.

    Wherever a method takes `port`, that is the name of the one port it is for (`"realtime"`,
    `"primary_readonly"`, ...), or None for all of them.
    """

    def __init__(self, controller: Controller, seed: int) -> None:
        self._controller = controller
        self._random = random.Random(seed)
        self._stalled_until = dict.fromkeys(PORTS, 0)
        self._cuts: set[str] = set()
        self._segments: dict[str, tuple[tuple[int, ...], int]] = {}
        self._generation = 0
        self._tails: dict[str, bytes] = {}
        self._sub_packages: dict[str, tuple[int, bytes]] = {}
        self._before: dict[str, list[bytes]] = {name: [] for name in PORTS}
        self._inside: dict[str, list[bytes]] = {name: [] for name in PORTS}

    # -- the arm -----------------------------------------------------------------------------------

    def protective_stop(self) -> None:
        """The arm brakes and stands with its motors on; its program pauses. Ends with `clear`."""
        self._do(self._controller.modes.protective_stop)

    def emergency_stop(self) -> None:
        """The arm brakes, stands and loses its power; its program stops. Ends with `clear`, then `power_on`."""
        self._do(self._controller.modes.emergency_stop)

    def clear(self) -> None:
        """Unlock a protective stop, after which the motion goes on from rest; or release the emergency stop button,
        after which the power is still off."""
        self._do(self._controller.modes.clear)

    def power_off(self) -> None:
        """The arm brakes, stands and loses its power."""
        self._do(self._controller.modes.power_off)

    def power_on(self) -> None:
        """Power the arm up and release its brakes; the motion begins anew. Without effect in an emergency stop."""
        self._do(self._controller.modes.power_on)

    # -- connections ---------------------------------------------------------------------------------

    def reboot(self, firmware: Firmware | str | None = None, downtime: float = 1.0) -> None:
        """Reset all connections, refuse new ones for `downtime` seconds, then come back with the time at 0.

        The controller comes back running, which a real one does not: it waits to be powered on.

        Args:
            firmware: to come back with; None for the present one.
            downtime: seconds.

        Raises:
            BadValue: the firmware does not go with the model, or the time is negative or not finite.
        """
        chosen = None if firmware is None else self._controller.suited(firmware)
        seconds = _seconds(downtime)
        self._do(lambda: self._controller.go_down(chosen, seconds))

    def cut(self, port: str | None = None) -> None:
        """Reset the connections; new ones are accepted at once."""
        names = _names(port)
        self._do(lambda: self._cuts.update(names))

    def stall(self, seconds: float, port: str | None = None) -> None:
        """Stay connected and silent for so long. What would have been sent is lost; who connects waits.

        Raises:
            BadValue: the time is negative or not finite.
        """
        names, cycles = _names(port), math.ceil(_seconds(seconds) * self._controller.firmware.rate)

        def stall() -> None:
            self._stalled_until.update(dict.fromkeys(names, self._controller.cycle + cycles))

        self._do(stall)

    # -- segments ------------------------------------------------------------------------------------

    def split(self, sizes: Sequence[int] | int, port: str | None = None) -> None:
        """Cut the stream of each connection into segments of these sizes, in turn, until `heal`.

        What does not fill a segment waits for the next packet, so packets arrive in parts. `split(1460)` is what a
        real capture shows. The receiving side may join segments again if it does not read in time.

        Raises:
            BadValue: a size is not a whole number of at least 1.
        """
        checked = tampering.checked_sizes([sizes] if isinstance(sizes, int) else list(sizes))
        self._segment(port, checked, 1)

    def merge(self, count: int, port: str | None = None) -> None:
        """Send `count` packets at a time as one segment, until `heal`.

        Raises:
            BadValue: `count` is not a whole number of at least 1.
        """
        self._segment(port, (), tampering.checked_sizes([count])[0])

    def _segment(self, port: str | None, sizes: tuple[int, ...], count: int) -> None:
        names = _names(port)

        def segment() -> None:
            self._segments.update(dict.fromkeys(names, (sizes, count)))
            self._generation += 1

        self._do(segment)

    # -- bytes ---------------------------------------------------------------------------------------

    def garbage(self, data: bytes | int, port: str | None = None, *, inside: bool = False) -> None:
        """Bytes that belong to no packet, once: before the next packet of a port, or in the middle of it.

        Args:
            data: the bytes, or how many random ones; random as the controller's seed has it.
            inside: in the middle of the next packet, which does not say so in its size.

        Raises:
            BadValue: a number of bytes that is not at least 1.
        """
        if isinstance(data, int):
            data = self._random.randbytes(tampering.checked_sizes([data])[0])
        garbage, names = data, _names(port)

        def inject() -> None:
            queues = self._inside if inside else self._before
            for name in names:
                queues[name].append(garbage)

        self._do(inject)

    def append(self, tail: bytes | int, port: str | None = None) -> None:
        """Let packets end in bytes that no known layout explains, as those of a newer release; until `heal`.

        Real-time packets grow by the tail, robot states by one tail per sub-package, and their size fields say so.
        Messages stay as they are.

        Args:
            tail: the bytes, or how many random ones. A newer release appends whole cells of 8 bytes to a real-time
                packet.

        Raises:
            BadValue: a number of bytes that is not at least 1.
        """
        if isinstance(tail, int):
            tail = self._random.randbytes(tampering.checked_sizes([tail])[0])
        appended, names = tail, _names(port)
        self._do(lambda: self._tails.update(dict.fromkeys(names, appended)))

    def unknown_package(self, kind: int = 99, payload: bytes = b"unknown", port: str | None = None) -> None:
        """Send a package of this type once, on the primary and secondary ports.

        Raises:
            BadValue: the type is not 0 to 255, or the port is neither.
        """
        made = package(_byte(kind), payload)
        names = _package_ports(port)

        def inject() -> None:
            for name in names:
                self._before[name].append(made)

        self._do(inject)

    def unknown_sub_package(self, kind: int = 77, payload: bytes = b"unknown", port: str | None = None) -> None:
        """Let robot states end in a sub-package of this type, until `heal`.

        Raises:
            BadValue: the type is not 0 to 255, or the port is neither.
        """
        added, names = (_byte(kind), payload), _package_ports(port)
        self._do(lambda: self._sub_packages.update(dict.fromkeys(names, added)))

    def heal(self) -> None:
        """End all that has been done to the link: stalls, segments, garbage, tails, unknown sub-packages."""

        def heal() -> None:
            self._stalled_until = dict.fromkeys(PORTS, 0)
            self._cuts.clear()
            self._segments.clear()
            self._generation += 1
            self._tails.clear()
            self._sub_packages.clear()
            for queues in (self._before, self._inside):
                for queue in queues.values():
                    queue.clear()

        self._do(heal)

    def _do(self, change: Callable[[], object]) -> None:
        self._controller.call(change)

    # -- for the server ------------------------------------------------------------------------------

    def is_stalled(self, port: str) -> bool:
        """This port is silent at present."""
        return self._controller.cycle < self._stalled_until[port]

    def take_cuts(self) -> set[str]:
        """The ports whose connections are to be reset now."""
        cuts, self._cuts = self._cuts, set()
        return cuts

    @property
    def segments_changed(self) -> int:
        """A number that changes when the segments of any port do."""
        return self._generation

    def segmenter(self, port: str) -> tampering.Segmenter | None:
        """A new one for a connection to this port, or None where packets are sent as they are."""
        rule = self._segments.get(port)
        return None if rule is None else tampering.Segmenter(*rule)

    def lasting(self, port: str, packet: bytes) -> bytes:
        """A packet with what lasts: tails and unknown sub-packages."""
        tail = self._tails.get(port)
        if interface(port) == "realtime":
            return packet if tail is None else tampering.with_tail(packet, tail)
        if interface(port) == "dashboard" or packet[4] != 16:
            return packet
        if tail is not None:
            packet = tampering.with_tails(packet, tail)
        added = self._sub_packages.get(port)
        return packet if added is None else tampering.with_sub_package(packet, *added)

    def on_the_wire(self, port: str, packet: bytes) -> bytes:
        """What this port sends in place of a packet; what happens once has then happened."""
        packet = self.lasting(port, packet)
        inside, before = self._inside[port], self._before[port]
        if inside:
            packet = tampering.with_garbage_inside(packet, b"".join(inside))
            inside.clear()
        if before:
            packet = b"".join(before) + packet
            before.clear()
        return packet


def _names(port: str | None) -> tuple[str, ...]:
    if port is None:
        return tuple(PORTS)
    if port not in PORTS:
        raise BadValue(f"no port is called {port!r}; there are {', '.join(PORTS)}")
    return (port,)


def _package_ports(port: str | None) -> tuple[str, ...]:
    names = tuple(name for name in _names(port) if interface(name) in ("primary", "secondary"))
    if not names:
        raise BadValue(f"{port} has no packages with types")
    return names


def _byte(kind: int) -> int:
    if kind not in range(256):
        raise BadValue(f"a type is a byte, not {kind!r}")
    return kind


def _seconds(seconds: float) -> float:
    if not 0.0 <= seconds < math.inf:
        raise BadValue(f"a time is zero or more seconds, not {seconds!r}")
    return float(seconds)


# -- faults as text ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class ScheduledFault:
    """A fault with the time at which it is to happen.

    Attributes:
        name: method of `Faults`.
        arguments: of that method.
        at: seconds from the start of the controller; a reboot does not begin them anew.
    """

    name: str
    arguments: tuple[Any, ...]
    at: float

    def happen(self, faults: Faults) -> None:
        """Do it now."""
        getattr(faults, self.name)(*self.arguments)


def _number(text: str) -> float:
    return _seconds(float(text))


def _size(text: str) -> int:
    return tampering.checked_sizes([int(text)])[0]


def _sizes(text: str) -> tuple[int, ...]:
    return tampering.checked_sizes([int(part) for part in text.split("+")])


#: name -> how its argument is read and what it is, or None where it has none, and whether it can be left out
FAULTS: dict[str, tuple[Callable[[str], Any], str, bool] | None] = {
    "protective_stop": None,
    "emergency_stop": None,
    "clear": None,
    "power_off": None,
    "power_on": None,
    "reboot": (Firmware.parse, "the firmware to come back with", True),
    "cut": (lambda text: _names(text)[0], "the port", True),
    "stall": (_number, "seconds", False),
    "split": (_sizes, "sizes of segments, such as 100+200", False),
    "merge": (_size, "packets per segment", False),
    "garbage": (_size, "number of bytes", False),
    "append": (_size, "number of bytes", False),
    "unknown_package": (lambda text: _byte(int(text)), "the type", True),
    "unknown_sub_package": (lambda text: _byte(int(text)), "the type", True),
    "heal": None,
}


def parse_fault(text: str) -> ScheduledFault:
    """``"protective_stop@5"``, ``"reboot=5.12@10"``, ``"split=100+200@0"``: NAME[=ARGUMENT]@SECONDS.

    Raises:
        BadValue: no such fault, an argument too many, missing or unreadable, or no time. The message says which.

    >>> parse_fault("stall=2.5@10")
    ScheduledFault(name='stall', arguments=(2.5,), at=10.0)
    """
    what, at_sign, when = text.rpartition("@")
    if not at_sign:
        raise BadValue(f"{text!r} has no time; expected NAME[=ARGUMENT]@SECONDS, such as protective_stop@5")
    try:
        at = _number(when)
    except ValueError:
        raise BadValue(f"{text!r}: {when!r} is not a number of seconds") from None
    name, equals, argument = what.partition("=")
    if name not in FAULTS:
        raise BadValue(f"{text!r}: no fault is called {name!r}; there are {', '.join(FAULTS)}")
    kind = FAULTS[name]
    if kind is None:
        if equals:
            raise BadValue(f"{text!r}: {name} takes no argument")
        return ScheduledFault(name, (), at)
    read, meaning, optional = kind
    if not equals:
        if not optional:
            raise BadValue(f"{text!r}: {name} needs {meaning}, as in {name}=...@{when}")
        return ScheduledFault(name, (), at)
    try:
        value = read(argument)
    except (ValueError, LocalError) as error:
        raise BadValue(f"{text!r}: {argument!r} does not do as {meaning} ({error})") from None
    return ScheduledFault(name, (value,), at)
