"""`Faults`, whose methods are the faults of a controller, and `FAULTS`, the list of those that a text can name.

Faults of the arm change its modes, as on a real controller. Faults of the link change bytes or connections, while the
controller itself runs on. All methods may be called from any thread; the fault has happened when they return.
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
    """The one port of that name, or all of them.

    Raises:
        BadValue: there is no such port.
    """
    if port is None:
        return tuple(PORTS)
    if port not in PORTS:
        raise BadValue(f"no port is called {port!r}; there are {', '.join(PORTS)}")
    return (port,)


def package_ports(port: str | None) -> tuple[str, ...]:
    """Those of `port_names` whose packages have a type.

    Raises:
        BadValue: none of them.
    """
    names = tuple(name for name in port_names(port) if interface_of(name) in ("primary", "secondary"))
    if not names:
        raise BadValue(f"{port} has no packages with types")
    return names


def type_byte(kind: int) -> int:
    """The type of a package.

    Raises:
        BadValue: it is not 0 to 255.
    """
    if kind not in range(256):
        raise BadValue(f"a type is a byte, not {kind!r}")
    return kind


def request_byte(letter: str) -> int:
    """The type of a request of an RTDE client, by its letter.

    Raises:
        BadValue: none of those that are answered.
    """
    if len(letter) != 1 or letter not in "VvOISP":
        raise BadValue(f"a request is V, v, O, I, S or P, not {letter!r}")
    return ord(letter)


def checked_seconds(seconds: float) -> float:
    """A time.

    Raises:
        BadValue: it is negative or not finite.
    """
    if not 0.0 <= seconds < math.inf:
        raise BadValue(f"a time is zero or more seconds, not {seconds!r}")
    return float(seconds)


def checked_sizes(sizes: Sequence[int]) -> tuple[int, ...]:
    """Segment sizes that can be cut.

    Raises:
        BadValue: none, or not all of them whole numbers of at least one byte.
    """
    if not sizes or any(not isinstance(size, int) or size < 1 for size in sizes):
        raise BadValue(f"segment sizes are whole numbers of bytes, at least 1, not {sizes!r}")
    return tuple(sizes)


@dataclass(frozen=True)
class FaultArgument:
    """The argument of a fault in a text such as ``"stall=2.5@10"``.

    Attributes:
        read: makes the value of its text.
        meaning: what it is, for messages and help.
        is_optional: whether it can be left out.
    """

    read: Callable[[str], Any]
    meaning: str
    is_optional: bool


#: The faults that a text can name -> the argument of each; None for a fault that takes none.
FAULTS: dict[str, FaultArgument | None] = {}

_Method = TypeVar("_Method", bound=Callable[..., None])


def _listed(
    read: Callable[[str], Any] | None = None, meaning: str = "", *, optional: bool = False
) -> Callable[[_Method], _Method]:
    """Add a method of `Faults` to `FAULTS`, and how its argument is read."""

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
    """The faults of one controller.

    In every method `port` is the name of the one port that is affected (`"realtime"`, `"primary_readonly"`, ...), or
    None for all of them.

    Args:
        state: of the controller.
        runner: of its programs.
        link: the faults of its connections.
        rtde: the RTDE interface.
        seed: of random garbage.
        call: calls a function in the thread that owns the controller, and waits until it returns.
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
        """The arm brakes and stands still with its motors on; its program pauses. Ends with `clear`."""
        self._do(lambda: self._state.modes.protective_stop())

    @_listed()
    def safeguard_stop(self, resumes: bool = True) -> None:
        """The arm brakes and stands still with its motors on; its program pauses. Ends with `clear`.

        Args:
            resumes: whether the program then goes on by itself; else it has to be played. Both are settings of the
                safety inputs on a real controller.
        """

        def stop() -> None:
            self._state.resumes = resumes and not self._state.is_paused
            self._state.modes.safeguard_stop()

        self._do(stop)

    @_listed()
    def emergency_stop(self) -> None:
        """The arm brakes, stands still and loses its power; its program stops. Ends with `clear`, then `power_on`."""
        self._do(lambda: self._state.modes.emergency_stop())

    @_listed()
    def clear(self) -> None:
        """Unlock a protective stop, or end a safeguard stop, after which the motion goes on from rest; or release the
        emergency stop button, after which the power is still off."""
        self._do(lambda: self._state.modes.clear())

    @_listed()
    def power_off(self) -> None:
        """The arm brakes, stands still and loses its power."""
        self._do(lambda: self._state.modes.power_off())

    @_listed()
    def power_on(self) -> None:
        """Power the arm up and release its brakes; the motion begins again. No effect in an emergency stop."""
        self._do(lambda: self._state.modes.power_on())

    # -- connections ---------------------------------------------------------------------------------

    @_listed(Firmware.parse, "the firmware to come back with", optional=True)
    def reboot(self, firmware: Firmware | str | None = None, downtime: float = 1.0) -> None:
        """Reset all connections, refuse new ones for `downtime` seconds, then come back with the time at 0.

        The controller comes back running; a real one waits to be powered on.

        Args:
            firmware: to come back with; None for the present one.
            downtime: seconds.

        Raises:
            BadValue: the firmware does not go with the model, or the time is negative or not finite.
        """
        chosen = None if firmware is None else firmware_for(self._state.model, firmware)
        wait = checked_seconds(downtime)
        self._do(lambda: self._reboot(chosen, wait))

    def _reboot(self, firmware: Firmware | None, downtime: float) -> None:
        self._runner.close()
        self._state.go_down(firmware, downtime)

    @_listed(_port, "the port", optional=True)
    def cut(self, port: str | None = None) -> None:
        """Reset the connections; new ones are accepted at once."""
        names = port_names(port)
        self._do(lambda: self._link.cut(names))

    @_listed(_seconds, "seconds")
    def stall(self, seconds: float, port: str | None = None) -> None:
        """Stay connected and silent for this time. Packets of that time are lost; new clients wait.

        Raises:
            BadValue: the time is negative or not finite.
        """
        names, cycles = port_names(port), self._cycles(seconds)
        self._do(lambda: self._link.stall(names, cycles))

    # -- segments ------------------------------------------------------------------------------------

    @_listed(_sizes, "sizes of segments, such as 100+200")
    def split(self, sizes: Sequence[int] | int, port: str | None = None) -> None:
        """Cut the stream of each connection into segments of these sizes, in turn, until `heal`.

        The rest of a packet that does not fill a segment waits for the next packet, so packets arrive in parts.
        `split(1460)` is what a real capture shows. The receiver may get segments joined again if it does not read in
        time.

        Raises:
            BadValue: a size is not a whole number of at least 1.
        """
        checked = checked_sizes([sizes] if isinstance(sizes, int) else list(sizes))
        self._segment(port, checked, 1)

    @_listed(_size, "packets per segment")
    def merge(self, count: int, port: str | None = None) -> None:
        """Send `count` packets at a time as one segment, until `heal`.

        Raises:
            BadValue: `count` is not a whole number of at least 1.
        """
        self._segment(port, (), checked_sizes([count])[0])

    def _segment(self, port: str | None, sizes: tuple[int, ...], count: int) -> None:
        names = port_names(port)
        self._do(lambda: self._link.segment(names, sizes, count))

    # -- bytes ---------------------------------------------------------------------------------------

    @_listed(_size, "number of bytes")
    def garbage(self, data: bytes | int, port: str | None = None, *, inside: bool = False) -> None:
        """Send bytes that belong to no packet, once: before the next packet of a port, or in the middle of it.

        Args:
            data: the bytes, or a number of random ones, which depend on the controller's seed.
            inside: in the middle of the next packet, whose size does not count them.

        Raises:
            BadValue: a number of bytes that is not at least 1.
        """
        garbage, names = self._bytes(data), port_names(port)
        self._do(lambda: self._link.insert(names, garbage, inside))

    @_listed(_size, "number of bytes")
    def append(self, tail: bytes | int, port: str | None = None) -> None:
        """Append bytes that no known layout explains to packets, as a newer release does; until `heal`.

        Real-time packets grow by the tail, robot states by one tail per sub-package, and their size fields say so.
        Messages stay as they are.

        Args:
            tail: the bytes, or how many random ones. A newer release appends whole cells of 8 bytes to a real-time
                packet.

        Raises:
            BadValue: a number of bytes that is not at least 1.
        """
        appended, names = self._bytes(tail), port_names(port)
        self._do(lambda: self._link.append(names, appended))

    @_listed(_type, "the type", optional=True)
    def unknown_package(self, kind: int = 99, payload: bytes = b"unknown", port: str | None = None) -> None:
        """Send a package of this type once, on the primary and secondary ports.

        Raises:
            BadValue: the type is not 0 to 255, or the port is neither.
        """
        made, names = package(type_byte(kind), payload), package_ports(port)
        self._do(lambda: self._link.insert(names, made))

    @_listed(_type, "the type", optional=True)
    def unknown_sub_package(self, kind: int = 77, payload: bytes = b"unknown", port: str | None = None) -> None:
        """Let robot states end in a sub-package of this type, until `heal`.

        Raises:
            BadValue: the type is not 0 to 255, or the port is neither.
        """
        byte, names = type_byte(kind), package_ports(port)
        self._do(lambda: self._link.add_sub_package(names, byte, payload))

    # -- RTDE ----------------------------------------------------------------------------------------

    def rtde_text(self, text: str, source: str = "simulator", level: int = MessageLevel.INFO) -> None:
        """Send a text message to all RTDE clients, once.

        Args:
            text: of at most 255 bytes, or it is cut.
            source: sender of the text, as shown in the message.
            level: 0 exception, 1 error, 2 warning, 3 info.
        """
        self._do(lambda: self._rtde.send_text(text, source, MessageLevel(level)))

    @_listed()
    def rtde_hello(self, text: str = "SafetySetup has not been confirmed yet") -> None:
        """Begin each RTDE connection with a text, as a PolyScope X whose safety was not confirmed; until `heal`.

        The control interface of ur_rtde cannot connect then.
        """
        self._disturb(hello=text)

    @_listed()
    def rtde_refuse_protocol_2(self) -> None:
        """Accept protocol 1 alone; until `heal`."""
        self._disturb(protocols=(1,))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_text_before_reply(self, request: str = "S", text: str = "a text before the reply") -> None:
        """Send a text before each reply to one kind of request; until `heal`.

        Args:
            request: its letter: V, v, O, I, S or P.
            text: of at most 255 bytes, or it is cut.

        Raises:
            BadValue: there is no such request.
        """
        kind = request_byte(request)
        self._do(lambda: self._rtde.disturbance.text_before.update({kind: text}))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_text_instead_of_reply(self, request: str = "S", text: str = "a text in place of the reply") -> None:
        """Answer the next request of one kind with a text, once; the reply is not sent.

        Raises:
            BadValue: there is no such request.
        """
        self._instead(request, lambda session: session.send_text(text))

    @_listed()
    def rtde_data_before_start(self) -> None:
        """Send a data package before each reply to a start, as PolyScope X sometimes does; until `heal`."""
        self._disturb(data_before_start=True)

    @_listed()
    def rtde_refuse_start(self) -> None:
        """Refuse to start; until `heal`."""
        self._disturb(refuses_start=True)

    @_listed()
    def rtde_no_data(self) -> None:
        """Accept a start, but send no data packages; until `heal`."""
        self._disturb(sends_no_data=True)

    @_listed(_seconds, "seconds")
    def rtde_late_data(self, seconds: float) -> None:
        """Send data packages this much later than they were made; until `heal`.

        Raises:
            BadValue: the time is negative or not finite.
        """
        self._disturb(late=self._cycles(seconds))

    @_listed(_seconds, "seconds")
    def rtde_stale_inputs(self, seconds: float) -> None:
        """Keep the inputs of connections that end held for this time, as real controllers do; until `heal`.

        Raises:
            BadValue: the time is negative or not finite.
        """
        self._disturb(stale=self._cycles(seconds))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_reboot_at_request(self, request: str = "O", downtime: float = 1.0) -> None:
        """Reboot instead of answering the next request of one kind: in the middle of a handshake.

        Raises:
            BadValue: there is no such request, or the time is negative or not finite.
        """
        wait = checked_seconds(downtime)
        self._instead(request, lambda session: self._reboot(None, wait))

    # -- the end of faults ----------------------------------------------------------------------------

    @_listed()
    def heal(self) -> None:
        """End all faults of the link (stalls, segments, garbage, tails, unknown sub-packages) and of RTDE."""

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
