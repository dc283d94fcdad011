"""The parts of a robot that motions use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from linkcore.clock import monotonic
from linkcore.streaming.stream import Stream

from ..commanding.channel import CommandChannel
from ..commanding.programs import Programs
from ..commanding.section import Section
from ..identity import KnownIdentity
from ..interfaces.realtime.packets import RealtimeState
from .point_registers import PointRegisterLink
from .register_link import RegisterLink, RegisterPort
from .reverse import ReversePort

__all__ = ["MotionContext"]


@dataclass(frozen=True)
class MotionContext:
    """The parts of a robot that motions use.

    Attributes:
        programs: uploads programs.
        realtime: the stream with the joint positions and the controller's clock.
        who: returns the identity of the controller.
        reverse: the port to which its programs connect.
        registers: claims the input registers that are used if programs do not connect.
        point_registers: those for a program that holds points, which answers in output registers.
        section: of the robot; left while a thread waits.
        clock: returns monotonic seconds.
    """

    programs: Programs
    channel: CommandChannel
    realtime: Stream[RealtimeState]
    who: KnownIdentity
    reverse: ReversePort
    registers: RegisterPort[RegisterLink]
    point_registers: RegisterPort[PointRegisterLink]
    section: Section
    clock: Callable[[], float] = monotonic

    def state(self) -> RealtimeState:
        """The newest state; if there is none, the next one.

        Raises:
            LocalError: there is none yet, and this is the thread that receives states.
            LinkTimeout, RemoteError: no state comes.
        """
        newest = self.realtime.latest
        if newest is not None:
            return newest
        with self.section.waiting():
            return self.realtime.wait()
