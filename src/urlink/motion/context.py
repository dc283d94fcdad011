"""The parts of a robot that motions use."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from linkcore.streaming.stream import Stream

from ..commanding.channel import CommandChannel
from ..commanding.programs import Programs
from ..commanding.section import Section
from ..identity import KnownIdentity
from ..interfaces.realtime.packets import RealtimeState
from .register_link import RegisterPort
from .reverse import ReversePort

__all__ = ["MotionContext"]


@dataclass(frozen=True)
class MotionContext:
    """The robot, as motions use it.

    Attributes:
        programs: uploads programs.
        channel: sends set-points.
        realtime: where the joints are, and the controller's clock.
        who: tells who the controller is.
        reverse: the port to which its programs connect.
        registers: claims the input registers from which its programs read set-points, if not over a connection.
        section: of the robot; left while a thread waits.
        clock: seconds that only grow.
    """

    programs: Programs
    channel: CommandChannel
    realtime: Stream[RealtimeState]
    who: KnownIdentity
    reverse: ReversePort
    registers: RegisterPort
    section: Section
    clock: Callable[[], float] = time.monotonic

    def state(self) -> RealtimeState:
        """The newest state, or the next one.

        Raises:
            LocalError: there is none yet, and this is the thread that would have to read it.
            LinkTimeout, RemoteError: none comes.
        """
        newest = self.realtime.latest
        if newest is not None:
            return newest
        with self.section.waiting():
            return self.realtime.wait()
