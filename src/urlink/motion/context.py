"""`MotionContext`: the parts of a robot that motions use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from linkcore import clock
from linkcore.streaming.stream import Stream

from ..command.channel import CommandChannel
from ..command.programs import Programs
from ..command.section import Section
from ..protocol.realtime.packets import RealtimeState
from ..session.identity import KnownIdentity
from .links.register_link import PointRegisterLink, RegisterLink, RegisterPort
from .links.reverse import ReversePort


@dataclass(frozen=True)
class MotionContext:
    """The parts of a robot that motions use.

    Attributes:
        programs: uploads programs.
        channel: sends what moves the arm, through the interlock.
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
    clock: Callable[[], float] = clock.now

    def state(self) -> RealtimeState:
        """The newest state that has come since the last program ended; if there is none, the next one.

        Both interfaces report by themselves: when the end of a motion is known, the newest state may be as old as
        `stale_after`, and show the arm standing where that motion began.

        Raises:
            LocalError: there is none yet, and this is the thread that receives states.
            LinkTimeout, RemoteError: no state comes.
        """
        newest, ended = self.realtime.latest, self.programs.ended

        def is_newer(state: RealtimeState) -> bool:
            return state.received is not None and state.received.monotonic > ended

        if newest is not None and is_newer(newest):
            return newest
        with self.section.waiting():
            first = self.realtime.wait_until(is_newer)
        # Of states that were held up and came in the same bytes, the first may be from before the end.
        return self.realtime.latest or first
