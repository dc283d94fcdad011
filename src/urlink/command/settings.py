"""Settings: payload, tool centre point, speed slider; how they are sent, and the confirmation that they took effect.

They are sent by RTDE inputs where these are available, by URScript text otherwise. An input of RTDE takes effect in the
next cycle of the controller, and nothing has to be compiled or run for it. But it belongs to one client at a time, and
a controller may be too old for it, or its port closed. Text can always be sent. So RTDE is tried for the first setting
of a kind on each connection to the robot; where it is refused, text is sent from then on, until the robot has been
connected anew.

An e-Series controller in local control ignores commands of the network without an error. So each setting that the
robot shows in its own states is waited for there. By the public layouts of the packets, the real-time state shows the
payload from 5.10 on, the robot state the offset of the tool from 3.2 on, and in every generation the slider, the
outputs and the voltage of the tool. Popups, flags and gravity show nowhere. That the "speed fraction" of CB2 is its
slider is not known, and which bits are its tool outputs neither: they are not waited for.
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
from ..errors import NotConfirmed
from ..protocol.firmware import Firmware
from ..protocol.primary.robot_state import CartesianInfo, RobotModeData, tool_offset
from ..protocol.realtime.packets import RealtimeState
from ..script import commands
from ..script.text import floats
from ..script.wrapping import StartPlace
from ..session.identity import KnownIdentity
from .channel import CommandChannel
from .section import Section

_log = logging.getLogger(__name__)

T = TypeVar("T")

#: Factor by which a mass may exceed the payload of the arm. Software updates have raised that of some arms by a quarter
#: (UR10e from 10 to 12.5 kg, UR20 from 20 to 25 kg); `urlink.models` has the latest figures, this leaves room for the
#: next.
_PAYLOAD_MARGIN = 1.25
#: m, rad, kg: by how much the reported value may differ from the one that was set; texts carry ten digits.
_EXACT = 1e-6
#: The same for the slider, whose place on the pendant is a whole percentage.
_SLIDER = 0.005
#: The first firmware that shows the payload, the offset of the tool, and a slider.
_SHOWS_PAYLOAD, _SHOWS_TCP, _SHOWS_SLIDER = Firmware(5, 10), Firmware(3, 2), Firmware(3, 0)
#: RTDE inputs of a setting, masks included; called when it is known that the robot runs. None where only text will do.
Values = Callable[[], Mapping[str, Any] | None]
#: Seconds in which a text that was sent may not have been executed yet: an RTDE package would overtake it.
_SETTLED = 0.5


class BriefInputs(Protocol):
    """RTDE inputs of a robot, which are claimed for as long as settings follow one another."""

    def claim(self, names: tuple[str, ...], *, wait: bool) -> Callable[[Mapping[str, Any]], None] | None:
        """What writes these inputs without waiting; None where that would have to be waited for.

        Raises `LinkError` where they cannot be had.
        """

    def abort(self) -> None:
        """Discard what was written and has not arrived."""


class SettingChannel:
    """Sends settings, which move nothing.

    Args:
        channel: sends text.
        connection: of the robot; whether RTDE is refused is remembered for as long as it lasts.
        section: of the robot.
        inputs: gives those of RTDE; None to send text only.
        clock: seconds that only grow.
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
        #: names of inputs -> number of the connection on which they could not be had; () stands for all
        self._refused: dict[tuple[str, ...], int] = {}
        self._sent_text_at = -math.inf

    def send(self, text: str, values: Values | None = None, *, wait: bool = True) -> None:
        """Send a setting.

        Args:
            text: whole lines of URScript.
            values: the same as RTDE inputs; None where there are none.
            wait: for a claim of the inputs, a quarter of a second at most; otherwise they have to be claimed already.

        Raises:
            NotRunning: the robot does not run, or nothing is known of it; nothing was sent.
            RemoteError: it could not be sent.
        """
        if values is not None and self._inputs is not None:
            self._channel.check_running()
            write = self._writer(self._inputs, values, wait)
            if write is not None:
                # Perhaps RTDE was given back just now, or is cut; the next setting claims it anew.
                with contextlib.suppress(ConnectionLost, Closed):
                    self._channel.beside(write)
                    return
            self._sent_text_at = self._clock()
        self._channel.command(text)

    def doubt(self) -> None:
        """What was sent does not show: nothing of it is to arrive later over RTDE, and what follows goes by text."""
        if self._inputs is not None and not self._is_refused(()):
            self._refuse(())
            with contextlib.suppress(LinkError):
                self._inputs().abort()

    def _writer(self, inputs: Callable[[], BriefInputs], values: Values, wait: bool) -> Callable[[], None] | None:
        """What writes a setting to RTDE inputs; None where that cannot be."""
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
            _log.info("%s: %s by script: %s", self._connection.name, names or "settings", printable(error))
            return None
        return None if write is None else partial(write, written)

    def _is_refused(self, names: tuple[str, ...]) -> bool:
        return self._refused.get(names) == self._connection.counters.connections

    def _refuse(self, names: tuple[str, ...]) -> None:
        self._refused[names] = self._connection.counters.connections


@dataclass(frozen=True)  # a NamedTuple cannot be generic before Python 3.11
class Echo(Generic[T]):
    """The packet in which a robot reports a setting.

    Attributes:
        kind: class of the packet.
        shown: the reported value in a packet; None if it does not report it.
        is_right: whether that is the value that was set.
    """

    kind: type[T]
    shown: Callable[[T], Any]
    is_right: Callable[[Any], bool]


class Settings:
    """Sends settings, and waits until the robot shows them.

    Args:
        channel: sends them.
        primary, realtime: the connections whose states show them.
        who: the identity of the controller.
        section: of the robot.
        is_remote: asks whether an e-Series is in remote control; None if that cannot be found out. It must be quick.
        start_place: where programs find their permission; users may not set its flags.
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
    ) -> None:
        self._channel = channel
        self._primary = primary
        self._realtime = realtime
        self._who = who
        self._section = section
        self._is_remote = is_remote
        self._start_place = start_place

    @property
    def firmware(self) -> Firmware:
        """What the controller runs."""
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
        # Converted first: the packets that report them are compared with plain numbers.
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
                raise BadValue(f"payload mass is {mass:g} kg; a {names} carries {most:g} kg at most{asked}")
        wanted = [mass, *(centre or ())]

        def shown(state: RealtimeState) -> list[Any] | None:
            cog = state.payload_cog  # which comes with the mass
            return None if cog is None else [state.payload_mass, *cog.tolist()][: len(wanted)]

        echo = Echo(RealtimeState, shown, lambda values: _close(values, wanted))
        self.apply(
            commands.secondary(statement), "the payload", echo if identity.firmware >= _SHOWS_PAYLOAD else None, confirm
        )

    def tcp(self, pose: Sequence[float], confirm: float | None) -> None:
        """See `Robot.set_tcp`."""
        offset = check_pose(pose, "tcp", TOOL_LENGTH)
        text = commands.secondary(commands.tcp(offset.tolist()))
        wanted = to_matrix(offset)
        # As matrices: of two rotation vectors of one rotation, one may turn by more than 180 degrees.
        echo = Echo(CartesianInfo, tool_offset, lambda values: _close(to_matrix(values), wanted))
        self.apply(text, "the tool centre point", echo if self.firmware >= _SHOWS_TCP else None, confirm)

    def gravity(self, acceleration: Sequence[float]) -> None:
        """See `Robot.set_gravity`."""
        self._channel.send(commands.secondary(commands.gravity(acceleration)))

    def speed_slider(self, fraction: float, confirm: float | None) -> None:
        """See `Robot.set_speed_slider`."""
        fraction = check_number(fraction, "speed slider", 0.0, 1.0)
        echo = Echo(
            RobotModeData, lambda mode: mode.target_speed_fraction, lambda value: abs(value - fraction) <= _SLIDER
        )
        text = commands.speed_slider(fraction)
        inputs = {"speed_slider_mask": 1, "speed_slider_fraction": fraction}
        self.apply(text, "the speed slider", echo if self.firmware >= _SHOWS_SLIDER else None, confirm, lambda: inputs)

    def zero_force_sensor(self) -> None:
        """See `Robot.zero_force_sensor`."""
        if self.firmware.is_cb2:
            raise LocalError(f"firmware {self.firmware} has no zero of its force sensor; 3.0 is the first that has")
        self._channel.send(commands.secondary("zero_ftsensor()"))

    def popup(self, text: str, title: str, warning: bool, error: bool) -> None:
        """See `Robot.popup`."""
        self._channel.send(commands.secondary(commands.popup(text, title, warning, error)))

    def flag(self, number: int, on: bool) -> None:
        """See `IO.set_flag`."""
        statement = commands.flag(number, on)
        if number in self._start_place.on(self.firmware).flags:
            raise BadValue(f"flag {number} lets uploaded programs begin; connect(start_flags=...) has them use others")
        self._channel.send(commands.secondary(statement))

    def apply(
        self, text: str, what: str, echo: Echo[T] | None, confirm: float | None, values: Values | None = None
    ) -> None:
        """Send a setting, and wait until the robot shows it.

        Args:
            text: whole lines of URScript.
            what: it sets, for messages.
            echo: where it shows; None if nowhere.
            confirm: seconds to wait; None not to wait.
            values: the same as RTDE inputs; None where there are none.

        Raises:
            BadValue: `confirm` is not a number of seconds.
            LocalError: this is the thread that would have to receive it.
            NotRunning: the robot does not run, or nothing is known of it; nothing was sent.
            NotConfirmed: the robot does not show it in time.
            RemoteError: it could not be sent.
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
            why = "The robot is in local control, in which an e-Series ignores what comes over the network"
        elif is_remote is None and self.firmware.is_e_series:
            why = "In local control an e-Series ignores what comes over the network: look at the pendant"
        else:
            why = "Perhaps the controller was held up, or its installation or another program sets it too"
        state = "nothing of it" if shown is None else f"{shown}"
        return NotConfirmed(
            f"{what} was sent, and the robot did not show it within {timeout:g} s: its states show {state}. {why}."
        )


def _close(values: ArrayLike, wanted: ArrayLike) -> bool:
    return np.allclose(values, wanted, rtol=0.0, atol=_EXACT)
