"""Faults of a controller: `Faults` has one method for each fault, and `FAULTS` lists faults by name.

`FAULTS` contains only the faults that a text such as ``"stall=2.5@10"`` can name. Faults of the arm change the modes of
the controller, as they do on a real controller. Faults of the link change bytes or connections, while the controller
itself keeps running. Any thread may call these methods. When a method returns, the fault has taken effect.
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
    """Return the names of the selected ports: the given name, or all names if it is None.

    Raises:
        BadValue: If there is no such port.
    """
    if port is None:
        return tuple(PORTS)
    if port not in PORTS:
        raise BadValue(f"no port is called {port!r}; expected one of {', '.join(PORTS)}")
    return (port,)


def package_ports(port: str | None) -> tuple[str, ...]:
    """Return those ports of `port_names` that send packages with a type: the primary and secondary ports.

    Raises:
        BadValue: If there are no such ports.
    """
    names = tuple(name for name in port_names(port) if interface_of(name) in ("primary", "secondary"))
    if not names:
        raise BadValue(f"the packages of port={port!r} have no type; expected a primary or secondary port")
    return names


def type_byte(kind: int) -> int:
    """Check the type of a package, and return it.

    Raises:
        BadValue: If the type is not 0 to 255.
    """
    if kind not in range(256):
        raise BadValue(f"the package type is {kind!r}; expected 0 to 255")
    return kind


def request_byte(letter: str) -> int:
    """Return the type byte of an RTDE request, given the letter of the request.

    Raises:
        BadValue: If the letter is not one of V, v, O, I, S and P.
    """
    if len(letter) != 1 or letter not in "VvOISP":
        raise BadValue(f"the request is {letter!r}; expected V, v, O, I, S or P")
    return ord(letter)


def checked_seconds(seconds: float) -> float:
    """Check a time in seconds, and return it as a float.

    Raises:
        BadValue: If the time is negative or not finite.
    """
    if not 0.0 <= seconds < math.inf:
        raise BadValue(f"the time is {seconds!r}; expected a finite number of seconds, 0 or more")
    return float(seconds)


def checked_sizes(sizes: Sequence[int]) -> tuple[int, ...]:
    """Check the sizes of segments in bytes, and return them as a tuple.

    Raises:
        BadValue: If the sequence is empty, or a size is not a whole number of at least 1.
    """
    if not sizes or any(not isinstance(size, int) or size < 1 for size in sizes):
        raise BadValue(f"the segment sizes are {sizes!r}; expected whole numbers of bytes, at least 1")
    return tuple(sizes)


@dataclass(frozen=True)
class FaultArgument:
    """Description of the argument that a fault has in a text such as ``"stall=2.5@10"``.

    Attributes:
        read: Function that converts the text to the value.
        meaning: Description of the argument, used in messages and help.
        is_optional: Whether the argument can be omitted.
    """

    read: Callable[[str], Any]
    meaning: str
    is_optional: bool


#: Name of a fault -> its argument in a text; None for a fault without an argument.
FAULTS: dict[str, FaultArgument | None] = {}

_Method = TypeVar("_Method", bound=Callable[..., None])


def _listed(
    read: Callable[[str], Any] | None = None, meaning: str = "", *, optional: bool = False
) -> Callable[[_Method], _Method]:
    """Return a decorator that adds a method of `Faults` to `FAULTS`, with the description of its argument."""

    def add(method: _Method) -> _Method:
        FAULTS[method.__name__] = None if read is None else FaultArgument(read, meaning, optional)
        return method

    return add


def _seconds(text: str) -> float:
    return checked_seconds(float(text))


def checked_joint(joint: int) -> int:
    """Check the number of a joint, and return it.

    Raises:
        BadValue: If the number is not 0 to 5.
    """
    if joint not in range(6):
        raise BadValue(f"the joint is {joint!r}; expected 0 to 5")
    return joint


def _joint(text: str) -> int:
    return checked_joint(int(text))


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
        call: Function that executes a given function in the thread that owns the controller, and waits for the end of
            this function.
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
        """Cause a protective stop, which lasts until `clear`.

        The arm brakes and comes to rest with its motors on. Its program pauses.
        """
        self._do(lambda: self._state.modes.protective_stop())

    @_listed(_joint, "the joint, 0 to 5")
    def drag(self, joint: int, share: float = 0.5) -> None:
        """Let a joint fall behind its target until `clear`, as with a defective brake or too little torque.

        When the deviation exceeds the limit, the controller stops the arm protectively.

        Args:
            joint: Number of the joint, 0 (base) to 5 (wrist 3).
            share: Fraction of its motion that the joint does not follow, above 0, at most 1.

        Raises:
            BadValue: If the joint does not exist, or the fraction is invalid.
        """
        joint = checked_joint(joint)
        if not 0.0 < share <= 1.0:
            raise BadValue(f"share={share!r}; expected a number above 0, at most 1")
        self._do(lambda: self._state.arm.drags.update({joint: share}))

    @_listed()
    def safeguard_stop(self, resumes: bool = True) -> None:
        """Cause a safeguard stop, which lasts until `clear`.

        The arm brakes and comes to rest with its motors on. Its program pauses. On a real controller, the safety inputs
        can be configured for both values of `resumes`.

        Args:
            resumes: Whether the program continues automatically after the stop. If False, the program continues after
                `play`.
        """

        def stop() -> None:
            self._state.resumes = resumes and not self._state.is_paused
            self._state.modes.safeguard_stop()

        self._do(stop)

    @_listed()
    def emergency_stop(self) -> None:
        """Cause an emergency stop. `clear` ends it, and then `power_on` switches the arm on again.

        The arm brakes, comes to rest and loses its power. The program stops.
        """
        self._do(lambda: self._state.modes.emergency_stop())

    @_listed()
    def clear(self) -> None:
        """Unlock a protective stop, end a safeguard stop, or release the emergency stop button.

        After a safeguard stop, the motion continues from rest. After an emergency stop, the power stays off. A dragged
        joint (`drag`) follows its target again.
        """

        def clear() -> None:
            self._state.arm.drags.clear()
            self._state.modes.clear()

        self._do(clear)

    @_listed()
    def power_off(self) -> None:
        """Switch the arm off: the arm brakes, comes to rest and loses its power."""
        self._do(lambda: self._state.modes.power_off())

    @_listed()
    def power_on(self) -> None:
        """Switch the arm on and release its brakes. The motion then begins again.

        No effect in an emergency stop.
        """
        self._do(lambda: self._state.modes.power_on())

    # -- connections ---------------------------------------------------------------------------------

    @_listed(Firmware.parse, "the firmware after the reboot", optional=True)
    def reboot(self, firmware: Firmware | str | None = None, downtime: float = 1.0) -> None:
        """Reboot: reset all connections, refuse new ones for a time, and restart the controller's time at 0.

        After the reboot, the arm is powered and its brakes are released. On a real controller, the arm stays off until
        it is powered on.

        Args:
            firmware: Firmware after the reboot; None selects the current firmware.
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
        """Reset the connections. New connections are accepted immediately."""
        names = port_names(port)
        self._do(lambda: self._link.cut(names))

    @_listed(_seconds, "seconds")
    def stall(self, seconds: float, port: str | None = None) -> None:
        """Keep connections open, but send nothing for this time.

        Packets that would be sent in this time are lost. New clients can connect, but they are served only afterwards.

        Raises:
            BadValue: If the time is negative or not finite.
        """
        names, cycles = port_names(port), self._cycles(seconds)
        self._do(lambda: self._link.stall(names, cycles))

    # -- segments ------------------------------------------------------------------------------------

    @_listed(_sizes, "sizes of segments, such as 100+200")
    def split(self, sizes: Sequence[int] | int, port: str | None = None) -> None:
        """Divide the bytes of each connection into segments of these sizes, used in turn, until `heal`.

        If the rest of a packet does not fill a segment, the rest is sent together with the next packet, so packets
        arrive in parts. A capture of a real controller shows segments like those of `split(1460)`. If the receiver does
        not read in time, the network might join segments again.

        Raises:
            BadValue: If a size is not a whole number of at least 1.
        """
        checked = checked_sizes([sizes] if isinstance(sizes, int) else list(sizes))
        self._segment(port, checked, 1)

    @_listed(_size, "packets per segment")
    def merge(self, count: int, port: str | None = None) -> None:
        """Join every `count` packets to one segment, until `heal`.

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
        """Once, send bytes that belong to no packet, before the next packet of a port or inside this packet.

        Args:
            data: The bytes, or a number of random bytes, which depend on the controller's seed.
            inside: Whether the bytes are inserted in the middle of the next packet. The size field of this packet does
                not count the inserted bytes.

        Raises:
            BadValue: If the number of bytes is less than 1.
        """
        garbage, names = self._bytes(data), port_names(port)
        self._do(lambda: self._link.insert(names, garbage, inside))

    @_listed(_size, "number of bytes")
    def append(self, tail: bytes | int, port: str | None = None) -> None:
        """Append bytes that no layout describes to packets, as a newer release does, until `heal`.

        These bytes are a tail. A real-time packet gets one tail at its end. In a robot state, each sub-package gets one
        tail. The size fields count the tails. Messages do not change.

        Args:
            tail: The bytes, or a number of random bytes. To a real-time packet, a newer release appends a multiple of 8
                bytes.

        Raises:
            BadValue: If the number of bytes is less than 1.
        """
        appended, names = self._bytes(tail), port_names(port)
        self._do(lambda: self._link.append(names, appended))

    @_listed(_type, "the type", optional=True)
    def unknown_package(self, kind: int = 99, payload: bytes = b"unknown", port: str | None = None) -> None:
        """Once, send a package of this type on the primary and secondary ports.

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
        """Once, send a text message to all RTDE clients.

        Args:
            text: Text of the message. A text of more than 255 bytes is truncated.
            source: Sender of the text, as shown in the message.
            level: Level of the message: 0 exception, 1 error, 2 warning, 3 info.
        """
        self._do(lambda: self._rtde.send_text(text, source, MessageLevel(level)))

    @_listed()
    def rtde_hello(self, text: str = "SafetySetup has not been confirmed yet") -> None:
        """Send a text message at the beginning of each RTDE connection, until `heal`.

        A PolyScope X controller does this if its safety configuration has not been confirmed. The control interface of
        ur_rtde then cannot connect.
        """
        self._disturb(hello=text)

    @_listed()
    def rtde_refuse_protocol_2(self) -> None:
        """Accept only RTDE protocol version 1, until `heal`."""
        self._disturb(protocols=(1,))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_text_before_reply(self, request: str = "S", text: str = "a text before the reply") -> None:
        """Send a text message before each reply to requests of one type, until `heal`.

        Args:
            request: Letter of the request: V, v, O, I, S or P.
            text: Text of the message. A text of more than 255 bytes is truncated.

        Raises:
            BadValue: If there is no such request.
        """
        kind = request_byte(request)
        self._do(lambda: self._rtde.disturbance.text_before.update({kind: text}))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_text_instead_of_reply(self, request: str = "S", text: str = "a text in place of the reply") -> None:
        """Once, send a text message instead of the reply to the next request of one type.

        Raises:
            BadValue: If there is no such request.
        """
        self._instead(request, lambda session: session.send_text(text))

    @_listed()
    def rtde_data_before_start(self) -> None:
        """Send a data package before each reply to a start request, until `heal`.

        PolyScope X sometimes does this.
        """
        self._disturb(data_before_start=True)

    @_listed()
    def rtde_refuse_start(self) -> None:
        """Reject RTDE start requests, until `heal`."""
        self._disturb(refuses_start=True)

    @_listed()
    def rtde_no_data(self) -> None:
        """Accept RTDE start requests, but send no data packages, until `heal`."""
        self._disturb(sends_no_data=True)

    @_listed(_seconds, "seconds")
    def rtde_late_data(self, seconds: float) -> None:
        """Delay RTDE data packages by this time, until `heal`.

        Raises:
            BadValue: If the time is negative or not finite.
        """
        self._disturb(late=self._cycles(seconds))

    @_listed(_seconds, "seconds")
    def rtde_stale_inputs(self, seconds: float) -> None:
        """Keep the inputs of ended RTDE connections claimed for this time, until `heal`.

        Real controllers also release the inputs only after a while.

        Raises:
            BadValue: If the time is negative or not finite.
        """
        self._disturb(stale=self._cycles(seconds))

    @_listed(_request, "the letter of the request", optional=True)
    def rtde_reboot_at_request(self, request: str = "O", downtime: float = 1.0) -> None:
        """Reboot instead of replying to the next RTDE request of one type, for example in the middle of a handshake.

        Raises:
            BadValue: If there is no such request, or the time is negative or not finite.
        """
        wait = checked_seconds(downtime)
        self._instead(request, lambda session: self._reboot(None, wait))

    # -- the end of faults ----------------------------------------------------------------------------

    @_listed()
    def heal(self) -> None:
        """End all faults of the link and of RTDE.

        The faults of the link are stalls, segments, garbage, tails and unknown sub-packages.
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
