"""Settings: payload, tool centre point and speed slider. Sends them and confirms that they took effect.

Settings are sent as RTDE inputs if these are available, and otherwise as URScript text. An RTDE input takes effect in
the next cycle of the controller, without a program that must be compiled and run. But it belongs to one client at a
time, the controller might be too old for it, or its port might be closed. Text can always be sent. Therefore RTDE is
tried for the first setting of each kind on each connection to the robot. If it is refused, text is sent from then on,
until the robot has reconnected.

An e-Series controller in local control ignores network commands without reporting an error. Therefore each setting that
the robot shows in its own states is confirmed there. According to the public packet layouts, the real-time state shows
the payload since 5.10, and the robot state shows the tool offset since 3.2. Every generation shows the slider, the
outputs and the tool voltage. Popups, flags and gravity are not shown anywhere. On CB2, it is unknown whether the
"speed fraction" is the slider, and which bits are the tool outputs, so these are not confirmed.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from linkcore import clock
from linkcore.arguments import check_number, other_unit
from linkcore.errors import BadValue, Closed, ConnectionLost, LinkError, LocalError
from linkcore.streaming.connection import Connection
from linkcore.text import printable

from ..arm.bounds import COG, TOOL_LENGTH, check_pose
from ..arm.models import indistinguishable
from ..arm.poses import to_matrix
from ..errors import LimitExceeded, NotConfirmed
from ..protocol.firmware import Firmware
from ..protocol.primary.robot_state import CartesianInfo, RobotModeData, tool_offset
from ..protocol.realtime.packets import RealtimeState
from ..script import commands
from ..script.text import floats
from ..script.wrapping import StartPlace
from ..session.identity import KnownIdentity
from ..session.session_limits import SessionLimits
from .channel import CommandChannel
from .section import Section

_log = logging.getLogger(__name__)

T = TypeVar("T")

#: Largest allowed ratio of a mass to the payload of the arm. Software updates have raised the payload of some arms by a
#: quarter (UR10e from 10 to 12.5 kg, UR20 from 20 to 25 kg). `urlink.models` has the latest figures; the factor leaves
#: room for the next update.
_PAYLOAD_MARGIN = 1.25
#: Tolerance, in m, rad or kg, between the reported and the sent value; texts carry ten digits.
_EXACT = 1e-6
#: Tolerance of the slider, whose position on the pendant is a whole percentage.
_SLIDER = 0.005
#: First firmware that shows the payload, the tool offset, and the slider.
_SHOWS_PAYLOAD, _SHOWS_TCP, _SHOWS_SLIDER = Firmware(5, 10), Firmware(3, 2), Firmware(3, 0)
#: Function that returns the RTDE inputs of a setting, masks included; None if only text is possible. It is called when
#: the robot is known to be running.
Values = Callable[[], Mapping[str, Any] | None]
#: Time, in seconds, in which a sent text might not have been executed yet, so that an RTDE package would overtake it.
_SETTLED = 0.5


class BriefInputs(Protocol):
    """RTDE inputs of a robot, claimed while settings follow one another."""

    def claim(self, names: tuple[str, ...], *, wait: bool) -> Callable[[Mapping[str, Any]], None] | None:
        """Return a function that writes these inputs without waiting; None if claiming them would require waiting.

        Raises `LinkError` if the inputs cannot be claimed.
        """

    def abort(self) -> None:
        """Discard written values that have not arrived."""


class SettingChannel:
    """Sends settings, which move nothing.

    Args:
        channel: Channel that sends text.
        connection: Connection to the robot. A refusal of RTDE is remembered until it is replaced by a new connection.
        section: Critical section of the robot.
        inputs: Function that returns the RTDE inputs; None to send only text.
        clock: Monotonic clock, in seconds.
    """

    def __init__(
        self,
        channel: CommandChannel,
        connection: Connection,
        section: Section,
        inputs: Callable[[], BriefInputs] | None,
        clock: Callable[[], float] = clock.now,
    ) -> None:
        self._channel = channel
        self._connection = connection
        self._section = section
        self._inputs = inputs
        self._clock = clock
        #: For names of inputs, the number of the connection on which they were refused; () means all inputs.
        self._refused: dict[tuple[str, ...], int] = {}
        self._sent_text_at = -math.inf

    def send(self, text: str, values: Values | None = None, *, wait: bool = True) -> None:
        """Send a setting.

        Args:
            text: Whole lines of URScript.
            values: The same setting as RTDE inputs; None if there are none.
            wait: Whether to wait for a claim of the inputs, up to a quarter of a second. Otherwise they must already
                be claimed.

        Raises:
            NotRunning: If the robot is not running, or its state is unknown. Nothing is sent.
            RemoteError: If the setting could not be sent.
        """
        if values is not None and self._inputs is not None:
            self._channel.check_running()
            write = self._writer(self._inputs, values, wait)
            if write is not None:
                # RTDE might have just been released or disconnected; the next setting claims it again.
                with contextlib.suppress(ConnectionLost, Closed):
                    self._channel.beside(write)
                    return
            self._sent_text_at = self._clock()
        self._channel.command(text)

    def doubt(self) -> None:
        """Handle a setting that is not shown: discard unsent RTDE values; send later settings as text."""
        if self._inputs is not None and not self._is_refused(()):
            self._refuse(())
            with contextlib.suppress(LinkError):
                self._inputs().abort()

    def _writer(self, inputs: Callable[[], BriefInputs], values: Values, wait: bool) -> Callable[[], None] | None:
        """Return a function that writes a setting to RTDE inputs; None if that is not possible."""
        if self._clock() - self._sent_text_at < _SETTLED or self._is_refused(()):
            return None
        written = values()
        if written is None or self._is_refused(tuple(written)):
            return None
        try:
            write = inputs().claim(tuple(written), wait=wait and self._section.may_wait)
        except LinkError as error:
            # Imported here: RTDE is not needed before the first setting.
            from ..protocol.rtde.protocol import RtdeRefused

            names = tuple(written) if isinstance(error, RtdeRefused) else ()
            self._refuse(names)
            _log.info("%s: %s are sent by script: %s", self._connection.name, names or "settings", printable(error))
            return None
        return None if write is None else partial(write, written)

    def _is_refused(self, names: tuple[str, ...]) -> bool:
        return self._refused.get(names) == self._connection.counters.connections

    def _refuse(self, names: tuple[str, ...]) -> None:
        self._refused[names] = self._connection.counters.connections


@dataclass(frozen=True)  # a NamedTuple cannot be generic before Python 3.11
class Echo(Generic[T]):
    """Packet that reports a setting.

    Attributes:
        kind: Class of the packet.
        shown: Function that returns the reported value in a packet; None if the packet does not report it.
        is_right: Function that returns whether the reported value is the value that was set.
    """

    kind: type[T]
    shown: Callable[[T], Any]
    is_right: Callable[[Any], bool]


class Settings:
    """Sends settings, and waits until the robot shows them.

    Args:
        channel: Channel that sends the settings.
        primary, realtime: Connections whose states show the settings.
        who: Identity of the controller.
        section: Critical section of the robot.
        is_remote: Function that returns whether an e-Series is in remote control; None if unknown. It must be fast.
        start_place: Place of the start permission; users may not set its flags.
        limits: Limits of the session; None if it has none.
        is_moving: Function that returns whether a motion of this session is running.
    """

    def __init__(
        self,
        channel: SettingChannel,
        primary: Connection,
        realtime: Connection,
        who: KnownIdentity,
        section: Section,
        is_remote: Callable[[], bool | None],
        start_place: StartPlace,
        limits: SessionLimits | None = None,
        is_moving: Callable[[], bool] = lambda: False,
    ) -> None:
        self._limits = limits
        self._is_moving = is_moving
        self._channel = channel
        self._primary = primary
        self._realtime = realtime
        self._who = who
        self._section = section
        self._is_remote = is_remote
        self._start_place = start_place

    @property
    def firmware(self) -> Firmware:
        """Firmware of the controller."""
        return self._who.identity.firmware

    def payload(
        self,
        mass: float,
        cog: Sequence[float] | None,
        inertia: Sequence[float] | None,
        confirm: float | None,
        transition_time: float = 0.0,
    ) -> None:
        """See `Robot.set_payload`."""
        identity = self._who.identity
        # Converted first, because they are compared with plain numbers from the packets.
        centre = None if cog is None else floats(cog, 3, "payload cog")
        moments = None if inertia is None else floats(inertia, 6, "payload inertia")
        mass = check_number(mass, "payload mass", unit="kg")
        transition_time = check_number(transition_time, "transition_time", unit="s")
        statement = commands.payload(identity.firmware, mass, centre, moments, transition_time)
        if confirm is not None:
            confirm = check_number(confirm, "confirm", 1e-3) + transition_time
        for axis, metres in zip("xyz", centre or (), strict=False):
            check_number(metres, f"{axis} of the payload's cog", -COG.most, COG.most, COG.unit)
        arm = identity.arm
        if arm is not None:
            arms = indistinguishable(arm)
            most = max(each.payload for each in arms)
            if mass > most * _PAYLOAD_MARGIN:
                names = " or ".join(each.name for each in arms)
                asked = other_unit(mass, "kg", 0.1, most)
                raise BadValue(f"payload mass is {mass:g} kg; a {names} carries at most {most:g} kg{asked}")
        wanted = [mass, *(centre or ())]

        def shown(state: RealtimeState) -> list[Any] | None:
            cog = state.payload_cog  # reported together with the mass
            return None if cog is None else [state.payload_mass, *cog.tolist()][: len(wanted)]

        echo = Echo(RealtimeState, shown, lambda values: _close(values, wanted))
        self.apply(
            commands.secondary(statement), "the payload", echo if identity.firmware >= _SHOWS_PAYLOAD else None, confirm
        )

    def tcp(self, pose: Sequence[float], confirm: float | None) -> None:
        """See `Robot.set_tcp`."""
        offset = check_pose(pose, "tcp", TOOL_LENGTH)
        if self._limits is not None and (confirm is None or self._is_moving()):
            # The next motion is predicted with the TCP that the states show, and a motion with the TCP at its start.
            what = "without confirmation" if confirm is None else "during a motion"
            raise LimitExceeded("start", f"the TCP would be set {what}", "confirm= in seconds, and no running motion")
        text = commands.secondary(commands.tcp(offset.tolist()))
        wanted = to_matrix(offset)
        # Compare matrices: the same rotation has several rotation vectors, and one might turn by more than 180 degrees.
        echo = Echo(CartesianInfo, tool_offset, lambda values: _close(to_matrix(values), wanted))
        self.apply(text, "the tool centre point", echo if self.firmware >= _SHOWS_TCP else None, confirm)

    def gravity(self, acceleration: Sequence[float]) -> None:
        """See `Robot.set_gravity`."""
        self._channel.send(commands.secondary(commands.gravity(acceleration)))

    def speed_slider(self, fraction: float, confirm: float | None) -> None:
        """See `Robot.set_speed_slider`."""
        fraction = check_number(fraction, "speed slider", 0.0, 1.0)
        if self._limits is not None:
            self._limits.check_slider(fraction)
        echo = Echo(
            RobotModeData, lambda mode: mode.target_speed_fraction, lambda value: abs(value - fraction) <= _SLIDER
        )
        text = commands.speed_slider(fraction)
        inputs = {"speed_slider_mask": 1, "speed_slider_fraction": fraction}
        self.apply(text, "the speed slider", echo if self.firmware >= _SHOWS_SLIDER else None, confirm, lambda: inputs)

    def zero_force_sensor(self) -> None:
        """See `Robot.zero_force_sensor`."""
        if self.firmware.is_cb2:
            raise LocalError(f"firmware {self.firmware} cannot zero its force sensor; 3.0 or later is required")
        self._channel.send(commands.secondary("zero_ftsensor()"))

    def popup(self, text: str, title: str, warning: bool, error: bool) -> None:
        """See `Robot.popup`."""
        self._channel.send(commands.secondary(commands.popup(text, title, warning, error)))

    def flag(self, number: int, on: bool) -> None:
        """See `IO.set_flag`."""
        statement = commands.flag(number, on)
        if number in self._start_place.on(self.firmware).flags:
            raise BadValue(
                f"flag {number} is reserved for start permissions; choose others with connect(start_flags=...)"
            )
        self._channel.send(commands.secondary(statement))

    def apply(
        self, text: str, what: str, echo: Echo[T] | None, confirm: float | None, values: Values | None = None
    ) -> None:
        """Send a setting, and wait until the robot shows it.

        Args:
            text: Whole lines of URScript.
            what: Name of the setting, used in messages.
            echo: Packet that shows the setting; None if no packet shows it.
            confirm: Time to wait for the confirmation, in seconds; None does not wait.
            values: The same setting as RTDE inputs; None if there are none.

        Raises:
            BadValue: If `confirm` is not a number of seconds.
            LocalError: If called in the thread that would have to receive the state.
            NotRunning: If the robot is not running, or its state is unknown. Nothing is sent.
            NotConfirmed: If the robot does not show the setting in time.
            RemoteError: If the setting could not be sent.
        """
        timeout = None if confirm is None else check_number(confirm, "confirm", 1e-3)
        if timeout is None or echo is None:
            self._channel.send(text, values, wait=False)
            return
        self._section.check_waiting()
        shown: list[Any] = [None]
        is_shown: SimpleQueue[None] = SimpleQueue()

        def look(packet: T) -> None:
            value = echo.shown(packet)
            if value is not None:
                shown[0] = value
                if echo.is_right(value):
                    is_shown.put(None)

        connection = self._realtime if echo.kind is RealtimeState else self._primary
        with connection.subscribe_inline(echo.kind, look):
            self._channel.send(text, values)
            try:
                with self._section.waiting():
                    clock.get(is_shown, timeout)
            except Empty:
                self._channel.doubt()
                raise self._not_confirmed(what, shown[0], timeout) from None

    def _not_confirmed(self, what: str, shown: Any, timeout: float) -> NotConfirmed:
        is_remote: bool | None = None
        if self.firmware.is_e_series:
            with contextlib.suppress(LinkError):
                is_remote = self._is_remote()
        if is_remote is False:
            why = "the robot is in local control, in which an e-Series ignores network commands"
        elif is_remote is None and self.firmware.is_e_series:
            why = "an e-Series in local control ignores network commands; check the mode on the pendant"
        else:
            why = "the controller might have been delayed, or its installation or another program sets it too"
        state = "no value" if shown is None else f"{shown}"
        return NotConfirmed(
            f"{what} was sent, but the robot did not show it within {timeout:g} s: its states show {state}; {why}"
        )


def _close(values: ArrayLike, wanted: ArrayLike) -> bool:
    return np.allclose(values, wanted, rtol=0.0, atol=_EXACT)
