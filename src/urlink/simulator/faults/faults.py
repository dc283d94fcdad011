"""Faults of a controller: `Faults` has a method for each, and `FAULTS` lists them by name.

`FAULTS` contains only the faults that a text can name. Faults of the arm change its modes, as on a real controller.
Faults of the link change bytes or connections, while the controller itself keeps running. Any thread may call all
methods. When a method returns, the fault has happened.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from linkcore.errors import BadValue
from linkcore.names import StrictAttributes
from urlink.protocol.firmware import Firmware
from urlink.protocol.ports import PORTS, interface_of
from urlink.protocol.rtde.packets import MessageLevel

from ..interfaces.interface import package
from ..interfaces.rtde import Disturbance, RtdeInterface, RtdeSession
from ..programs.runner import ProgramRunner
from ..state import ControllerState, firmware_for
from .link import LinkFaults


def port_names(port: str | None) -> tuple[str, ...]:
    """Return the port of that name, or all ports.

    Raises:
        BadValue: If there is no such port.
    """
    if port is None:
        return tuple(PORTS)
    if port not in PORTS:
        raise BadValue(f"no port is called {port!r}; expected one of {', '.join(PORTS)}")
    return (port,)


def package_ports(port: str | None) -> tuple[str, ...]:
    """Return the ports of `port_names` whose packages have a type.

    Raises:
        BadValue: If there are none.
    """
    names = tuple(name for name in port_names(port) if interface_of(name) in ("primary", "secondary"))
    if not names:
        raise BadValue(f"port={port!r} has no packages with types; expected a primary or secondary port")
    return names


def type_byte(kind: int) -> int:
    """Check the type of a package.

    Raises:
        BadValue: If it is not 0 to 255.
    """
    if kind not in range(256):
        raise BadValue(f"the package type is {kind!r}; expected 0 to 255")
    return kind


def request_byte(letter: str) -> int:
    """Return the type of an RTDE client's request, given its letter.

    Raises:
        BadValue: If the simulator answers no such request.
    """
    if len(letter) != 1 or letter not in "VvOISP":
        raise BadValue(f"the request is {letter!r}; expected V, v, O, I, S or P")
    return ord(letter)


def checked_seconds(seconds: float) -> float:
    """Check a time.

    Raises:
        BadValue: If it is negative or not finite.
    """
    if not 0.0 <= seconds < math.inf:
        raise BadValue(f"the time is {seconds!r}; expected a finite number of seconds, 0 or more")
    return float(seconds)


def checked_sizes(sizes: Sequence[int]) -> tuple[int, ...]:
    """Check the sizes of segments.

    Raises:
        BadValue: If there are none, or a size is not a whole number of at least one byte.
    """
    if not sizes or any(not isinstance(size, int) or size < 1 for size in sizes):
        raise BadValue(f"the segment sizes are {sizes!r}; expected whole numbers of bytes, at least 1")
    return tuple(sizes)


@dataclass(frozen=True)
class FaultArgument:
    """Argument of a fault in a text such as ``"stall=2.5@10"``.

    Attributes:
        read: Function that converts the text to the value.
        meaning: Description of the argument, used in messages and help.
        is_optional: Whether the argument can be omitted.
    """

    read: Callable[[str], Any]
    meaning: str
    is_optional: bool


#: Faults that a text can name -> the argument of each; None for a fault without an argument.
FAULTS: dict[str, FaultArgument | None] = {}

_Method = TypeVar("_Method", bound=Callable[..., None])


def _listed(
    read: Callable[[str], Any] | None = None, meaning: str = "", *, optional: bool = False
) -> Callable[[_Method], _Method]:
    """Add a method of `Faults` to `FAULTS`, with the function that reads its argument."""

    def add(method: _Method) -> _Method:
        FAULTS[method.__name__] = None if read is None else FaultArgument(read, meaning, optional)
        return method

    return add


def _seconds(text: str) -> float:
    return checked_seconds(float(text))


def _size(text: str) -> int:
    return checked_sizes([int(text)])[0]


def _sizes(text: str) -> tuple[int, ...]:
    return checked_sizes([int(part) for part in text.split("+")])


def _port(text: str) -> str:
    return port_names(text)[0]


def _type(text: str) -> int:
    return type_byte(int(text))


def _request(text: str) -> str:
    request_byte(text)
    return text


class Faults(StrictAttributes):
    """Faults of one controller.

    In every method, `port` is the name of the affected port (`"realtime"`, `"primary_readonly"`, ...), or None for all
    ports.

    Args:
        state: State of the controller.
        runner: Runner of its programs.
        link: Faults of its connections.
        rtde: RTDE interface.
        seed: Seed of random garbage.
        call: Function that calls a function in the thread that owns the controller, and waits until it returns.
    """

    def __init__(
        self,
        state: ControllerState,
        runner: ProgramRunner,
        link: LinkFaults,
        rtde: RtdeInterface,
        *,
        seed: int,
        call: Callable[[Callable[[], object]], None],
    ) -> None:
        self._state = state
        self._runner = runner
        self._link = link
        self._rtde = rtde
        self._random = random.Random(seed)
        self._do = call

    # -- the arm -----------------------------------------------------------------------------------

    @_listed()
    def protective_stop(self) -> None:
        """Cause a protective stop, until `clear`.

        The arm brakes and comes to rest with its motors on. Its program pauses.
        """
        self._do(lambda: self._state.modes.protective_stop())

    @_listed()
    def safeguard_stop(self, resumes: bool = True) -> None:
        """Cause a safeguard stop, until `clear`.

        The arm brakes and comes to rest with its motors on. Its program pauses. Both values of `resumes` are settings
        of the safety inputs on a real controller.

        Args:
            resumes: Whether the program then continues automatically. If False, `play` must continue it.
        """

        def stop() -> None:
            self._state.resumes = resumes and not self._state.is_paused
            self._state.modes.safeguard_stop()

        self._do(stop)

    @_listed()
    def emergency_stop(self) -> None:
        """Cause an emergency stop, until `clear` and then `power_on`.

        The arm brakes, comes to rest and loses its power. Its program stops.
        """
        self._do(lambda: self._state.modes.emergency_stop())

    @_listed()
    def clear(self) -> None:
        """Unlock a protective stop, end a safeguard stop, or release the emergency stop button.

        After a safeguard stop, the motion continues from rest. After an emergency stop, the power is still off.
        """
        self._do(lambda: self._state.modes.clear())

    @_listed()
    def power_off(self) -> None:
        """Switch the arm off: it brakes, comes to rest and loses its power."""
        self._do(lambda: self._state.modes.power_off())

    @_listed()
    def power_on(self) -> None:
        """Power the arm and release its brakes, after which the motion begins again.

        No effect in an emergency stop.
        """
        self._do(lambda: self._state.modes.power_on())

    # -- connections ---------------------------------------------------------------------------------

    @_listed(Firmware.parse, "the firmware after the reboot", optional=True)
    def reboot(self, firmware: Firmware | str | None = None, downtime: float = 1.0) -> None:
        """Reset all connections, refuse new ones for a time, then come back with the time at 0.

        The controller comes back running. A real controller waits until it is powered on.

        Args:
            firmware: Firmware after the reboot; None for the current one.
            downtime: Time without connections, in s.

        Raises:
            BadValue: If the firmware does not run on the model, or the time is negative or not finite.
        """
        chosen = None if firmware is None else firmware_for(self._state.model, firmware)
        wait = checked_seconds(downtime)
        self._do(lambda: self._reboot(chosen, wait))

    def _reboot(self, firmware: Firmware | None, downtime: float) -> None:
        self._runner.close()
        self._state.go_down(firmware, downtime)

    @_listed(_port, "the port", optional=True)
    def cut(self, port: str | None = None) -> None:
        """Reset the connections; new ones are accepted immediately."""
        names = port_names(port)
        self._do(lambda: self._link.cut(names))

    @_listed(_seconds, "seconds")
    def stall(self, seconds: float, port: str | None = None) -> None:
        """Stay connected and silent for this time.

        Packets of this time are lost. New clients are connected, but served only afterwards.

        Raises:
            BadValue: If the time is negative or not finite.
        """
        names, cycles = port_names(port), self._cycles(seconds)
        self._do(lambda: self._link.stall(names, cycles))

    # -- segments ------------------------------------------------------------------------------------

    @_listed(_sizes, "sizes of segments, such as 100+200")
    def split(self, sizes: Sequence[int] | int, port: str | None = None) -> None:
        """Cut the stream of each connection into segments of these sizes, in turn, until `heal`.

        If the rest of a packet does not fill a segment, it waits for the next packet, so packets arrive in parts. A
        real capture shows `split(1460)`. The receiver might get segments joined again if it does not read in time.

        Raises:
            BadValue: If a size is not a whole number of at least 1.
        """
        checked = checked_sizes([sizes] if isinstance(sizes, int) else list(sizes))
        self._segment(port, checked, 1)

    @_listed(_size, "packets per segment")
    def merge(self, count: int, port: str | None = None) -> None:
        """Send `count` packets at a time as one segment, until `heal`.

        Raises:
            BadValue: If `count` is not a whole number of at least 1.
        """
        self._segment(port, (), checked_sizes([count])[0])

    def _segment(self, port: str | None, sizes: tuple[int, ...], count: int) -> None:
        names = port_names(port)
        self._do(lambda: self._link.segment(names, sizes, count))

    # -- bytes ---------------------------------------------------------------------------------------

    @_listed(_size, "number of bytes")
    def garbage(self, data: bytes | int, port: str | None = None, *, inside: bool = False) -> None:
        """Send bytes that belong to no packet once, before a port's next packet or inside it.

        Args:
            data: The bytes, or a number of random bytes, which depend on the controller's seed.
            inside: Whether the bytes are inserted in the middle of the next packet; the size field of the packet does
                not count them.

        Raises:
            BadValue: If the number of bytes is less than 1.
        """
        garbage, names = self._bytes(data), port_names(port)
        self._do(lambda: self._link.insert(names, garbage, inside))

    @_listed(_size, "number of bytes")
    def append(self, tail: bytes | int, port: str | None = None) -> None:
        """Append bytes of no known layout to packets, as a newer release does; until `heal`.

        Real-time packets grow by the tail, and robot states by one tail per sub-package. Their size fields count the
        tails. Messages do not change.

        Args:
            tail: The bytes, or a number of random bytes. A newer release appends whole cells of 8 bytes to a real-time
                packet.

        Raises:
            BadValue: If the number of bytes is less than 1.
        """
        appended, names = self._bytes(tail), port_names(port)
        self._do(lambda: self._link.append(names, appended))

    @_listed(_type, "the type", optional=True)
    def unknown_package(self, kind: int = 99, payload: bytes = b"unknown", port: str | None = None) -> None:
        """Send a package of this type once, on the primary and secondary ports.

        Raises:
            BadValue: If the type is not 0 to 255, or `port` is not a primary or secondary port.
        """
        made, names = package(type_byte(kind), payload), package_ports(port)
        self._do(lambda: self._link.insert(names, made))

    @_listed(_type, "the type", optional=True)
    def unknown_sub_package(self, kind: int = 77, payload: bytes = b"unknown", port: str | None = None) -> None:
        """Append a sub-package of this type to robot states, until `heal`.

        Raises:
            BadValue: If the type is not 0 to 255, or `port` is not a primary or secondary port.
        """
        byte, names = type_byte(kind), package_ports(port)
        self._do(lambda: self._link.add_sub_package(names, byte, payload))

    # -- RTDE ----------------------------------------------------------------------------------------

    def rtde_text(self, text: str, source: str = "simulator", level: int = MessageLevel.INFO) -> None:
        """Send a text message to all RTDE clients, once.

        Args:
            text: Text of the message. It is cut after 255 bytes.
            source: Sender of the text, as shown in the message.
            level: Level of the message: 0 exception, 1 error, 2 warning, 3 info.
        """
        self._do(lambda: self._rtde.send_text(text, source, MessageLevel(level)))

    @_listed()
    def rtde_hello(self, text: str = "SafetySetup has not been confirmed yet") -> None:
        """Send a text at the beginning of each RTDE connection, until `heal`.

        A PolyScope X whose safety was not confirmed does this. The control interface of ur_rtde then cannot connect.
        """
        self._disturb(hello=text)

    @_listed()
    def rtde_refuse_protocol_2(self) -> None:
        """Accept only protocol 1, until `heal`."""
        self._disturb(protocols=(1,))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_text_before_reply(self, request: str = "S", text: str = "a text before the reply") -> None:
        """Send a text before each reply to one kind of request, until `heal`.

        Args:
            request: Letter of the request: V, v, O, I, S or P.
            text: Text of the message. It is cut after 255 bytes.

        Raises:
            BadValue: If there is no such request.
        """
        kind = request_byte(request)
        self._do(lambda: self._rtde.disturbance.text_before.update({kind: text}))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_text_instead_of_reply(self, request: str = "S", text: str = "a text in place of the reply") -> None:
        """Send a text instead of the reply to the next request of one kind, once.

        Raises:
            BadValue: If there is no such request.
        """
        self._instead(request, lambda session: session.send_text(text))

    @_listed()
    def rtde_data_before_start(self) -> None:
        """Send a data package before each reply to a start, until `heal`.

        PolyScope X sometimes does this.
        """
        self._disturb(data_before_start=True)

    @_listed()
    def rtde_refuse_start(self) -> None:
        """Reject requests to start, until `heal`."""
        self._disturb(refuses_start=True)

    @_listed()
    def rtde_no_data(self) -> None:
        """Accept a start, but send no data packages, until `heal`."""
        self._disturb(sends_no_data=True)

    @_listed(_seconds, "seconds")
    def rtde_late_data(self, seconds: float) -> None:
        """Send data packages this much later than they were made, until `heal`.

        Raises:
            BadValue: If the time is negative or not finite.
        """
        self._disturb(late=self._cycles(seconds))

    @_listed(_seconds, "seconds")
    def rtde_stale_inputs(self, seconds: float) -> None:
        """Keep the inputs of ended connections held for this time, until `heal`.

        Real controllers do this.

        Raises:
            BadValue: If the time is negative or not finite.
        """
        self._disturb(stale=self._cycles(seconds))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_reboot_at_request(self, request: str = "O", downtime: float = 1.0) -> None:
        """Reboot instead of answering the next request of one kind, in the middle of a handshake.

        Raises:
            BadValue: If there is no such request, or the time is negative or not finite.
        """
        wait = checked_seconds(downtime)
        self._instead(request, lambda session: self._reboot(None, wait))

    # -- the end of faults ----------------------------------------------------------------------------

    @_listed()
    def heal(self) -> None:
        """End all faults of the link and of RTDE.

        Faults of the link are stalls, segments, garbage, tails and unknown sub-packages.
        """

        def heal() -> None:
            self._link.heal()
            self._rtde.disturbance = Disturbance()

        self._do(heal)

    def _bytes(self, data: bytes | int) -> bytes:
        return self._random.randbytes(checked_sizes([data])[0]) if isinstance(data, int) else data

    def _cycles(self, seconds: float) -> int:
        return math.ceil(checked_seconds(seconds) * self._state.rate)

    def _disturb(self, **changes: Any) -> None:
        def disturb() -> None:
            self._rtde.disturbance = replace(self._rtde.disturbance, **changes)

        self._do(disturb)

    def _instead(self, request: str, happens: Callable[[RtdeSession], object]) -> None:
        kind = request_byte(request)
        self._do(lambda: self._rtde.disturbance.instead.update({kind: happens}))
