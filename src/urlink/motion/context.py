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
from ..session.session_limits import SessionLimits
from .limited import LimitedArm
from .links.register_link import PointRegisterLink, RegisterLink, RegisterPort
from .links.reverse import ReversePort
from .moves.path import shown_tcp


@dataclass(frozen=True)
class MotionContext:
    """The parts of a robot that motions use.

    Attributes:
        programs: Sender of programs.
        channel: Channel for all commands that move the arm. It sends them only if the interlock permits this.
        realtime: Stream with the joint positions and the controller's clock.
        who: Identity of the controller.
        reverse: Port to which programs on the robot connect.
        registers: Claimed input registers, which replace the connection if programs do not connect.
        point_registers: Claimed input registers for a program that buffers points. This program answers in output
            registers.
        section: Lock of the robot. A thread releases this lock while it waits.
        clock: Function that returns monotonic time, in s.
        limits: Limits of the session; None if it has none.
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
    limits: SessionLimits | None = None

    def state(self) -> RealtimeState:
        """Return the newest state that has arrived since the last program ended; wait for one if there is none.

        One interface reports the end of a program, another interface sends the states. So when the end of a motion is
        reported, the newest state may be as old as `stale_after`. Such a state may show the arm at the position where
        the motion began.

        Raises:
            LocalError: If there is no such state yet, and the caller is the thread that receives states.
            LinkTimeout, RemoteError: If no state arrives.
        """
        newest, ended = self.realtime.latest, self.programs.ended

        def is_newer(state: RealtimeState) -> bool:
            return state.received is not None and state.received.monotonic > ended

        if newest is not None and is_newer(newest):
            return newest
        with self.section.waiting():
            first = self.realtime.wait_until(is_newer)
        # If states were delayed and arrived together, the first of them may be older than the end of the program.
        return self.realtime.latest or first

    def limited(self) -> LimitedArm | None:
        """Return the arm with its current state, for a comparison of a motion with the limits; None without limits.

        Raises:
            LocalError: If the model of the arm is unknown.
            LinkTimeout, RemoteError: If no state arrives.
        """
        return None if self.limits is None else LimitedArm(self.limits, self.who, self.state(), shown_tcp)

    def limited_at_rest(self) -> LimitedArm | None:
        """Return the arm like `limited`, after checking that it is at rest with its tool in the box.

        Raises:
            LimitExceeded: If the arm is moving, or its tool is outside of the box.
        """
        limited = self.limited()
        if limited is not None:
            limited.check_start()
        return limited
