"""Streams without an end: points that are appended while the arm moves through those before."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from functools import partial
from typing import TypeVar

from linkcore import clock
from linkcore.arguments import check_number, check_seconds, check_wait
from linkcore.errors import Closed, LinkError, LinkTimeout, LocalError
from linkcore.pending_call import check_wanted, on_give_up

from ...arm.vectors import FloatArray
from ...protocol.firmware import Firmware
from ...script.buffering import buffering
from ..context import MotionContext
from ..moves.path import shown_tcp
from ..servo.block_motion import BlockMotion
from ..servo.jerk_limited import JointLimit
from ..servo.linked_program import Link
from ..servo.setpoints import Servoing
from ..slider import SliderEffect, slider
from .common_time import MemberPace
from .stream_feed import StreamFeed
from .stream_points import PointReader, Points
from .stream_steps import Aim, Bounds, Handed, Mark

#: The first firmware on which a program can hold points.
_BUFFERS = Firmware(3, 4)
#: Most points that the program holds, whatever their distance. Chosen: its text stays within half of that of the
#: largest public driver program.
_MOST = 256
#: s that the robot may take to answer a replacement, or the arm to come to rest before the first point.
_ANSWER = 10.0

T = TypeVar("T")


@slider(stream=SliderEffect.SCALED)
class PointStream(BlockMotion):
    """Moves through points that are appended while it runs; made by `robot.motion.stream`, open in a ``with`` block.

    A program on the robot holds the next points. Where none is left the arm brakes, and goes on with the next ones.
    Leaving the block stops the arm where it is: `wait_until_dry` before lets it come to the end of its points.

    One thread, or one task, appends and replaces; a call while another one's is under way is refused. `clear` is for
    any thread.

    Attributes:
        buffer: s of points that the program on the robot holds.
    """

    def __init__(
        self,
        context: MotionContext,
        buffer: float,
        limits: Sequence[JointLimit],
        servoing: Servoing,
        open_link: Callable[[], Link],
    ) -> None:
        identity = context.who.identity
        firmware = identity.firmware
        if firmware < _BUFFERS:
            why = (
                "CB2 controllers cannot read binary messages"
                if firmware.is_cb2
                else "its URScript lacks what that needs"
            )
            raise LocalError(
                f"firmware {firmware} cannot hold points of a stream: {why}; {_BUFFERS} is the first. servo leads the "
                "arm by a set-point in each cycle"
            )
        self.buffer = buffer
        cycle = 1.0 / firmware.rate
        shortest = 2.0 * cycle  # the program reads one message in each cycle, and has to gain on the arm
        bounds = Bounds(identity.arm, servoing.speeds, limits)
        self._reader = PointReader(bounds, shortest, partial(_inverse, context))
        capacity = min(round(buffer / shortest) + 4, _MOST)
        write = partial(
            buffering,
            firmware,
            capacity=capacity,
            acceleration=[limit.acceleration for limit in limits],
            jerk=[limit.jerk for limit in limits],
            watchdog=servoing.watchdog,
            lookahead_time=servoing.lookahead_time,
            gain=servoing.gain,
        )
        self._feed = StreamFeed(write, context.section.lock, bounds, cycle, capacity, buffer)
        super().__init__(context, "stream", self._feed, open_link)
        feed = self._feed
        life = self._life
        life.on_end(lambda: feed.end(life.error or Closed("the block of the stream was left")))
        self._is_producing = False  # a lock without waiting: a second caller is refused

    def _join(self, pace: MemberPace) -> None:
        """Go on with other streams, before it begins."""
        self._feed.pace = pace
        pace.is_paused = partial(getattr, self._program, "is_paused")
        self._life.on_end(pace.leave)

    # -- points ----------------------------------------------------------------------------------------

    def append(self, points: Points, *, wait: bool | float = True) -> float:
        """Append points after the last one.

        A `TrajectoryPoint` that carries positions only is reached in a straight line at constant speed; with velocities
        on a cubic curve, with accelerations too on a quintic one. A `Trajectory` begins where the points end.

        Args:
            points: one, several, or a trajectory. Times are s on the clock of the stream, and increase; the first must
                be two cycles of the controller after `end`, but for a place within 0.05 rad of where the arm rests.
            wait: return once the robot has room for all of them, within 60 s or as many as are given. With False they
                wait in memory.

        Returns:
            s of points for which there is room after that; less than zero if points wait in memory.

        Raises:
            BadValue: the arm could not follow them; nothing was appended.
            LinkTimeout: the robot has not had room in time; the points stay.
            Unreachable: a pose is out of reach; nothing was appended.
            Cancelled: they were cleared before the robot had room; or the stream was.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped: the stream is over.
            LocalError: not within the block, or another thread appends or replaces.
        """
        seconds = check_wait(wait)
        with self._producing():
            handed = None
            while handed is None:
                handed = self._add(*self._checked(points))
            if seconds:
                self._await_room(handed, seconds)
        return self.room

    def _checked(self, points: Points, begins: float = 0.0) -> tuple[Mark, list[Aim]]:
        """Where the stream ends, and what is to be appended there, from `begins`, s on its clock, if that is later."""
        mark = self._mark()
        if mark.time < begins:
            with self._context.section.lock:
                self._feed.skip(begins)
            mark = self._mark()
        return mark, self._reader.after(points, mark, begins)

    def _add(self, mark: Mark, aims: Sequence[Aim]) -> Handed | None:
        """Append them; None where another thread has cleared the stream meanwhile."""
        handed = Handed()
        with self._context.section.lock:
            if self._feed.mark is not mark:
                return None
            self._feed.add(aims, handed)
        return handed

    def _await_room(self, handed: Handed, seconds: float) -> None:
        self._await(handed.future, seconds, "the robot has had no room for the points")

    def replace(self, from_time: float, points: Points) -> float:
        """Replace all points after a time by others, with continuous positions, speeds and accelerations.

        What the robot holds already is replaced too. From where the arm is at that time it goes over onto the curve
        through the new points as soon as the acceleration and the jerk of the stream allow, and is at each of the
        points after that at its time. So the points may begin in the past: at the time of the observation that they
        were computed from.

        Args:
            from_time: s on the clock of the stream; if that is past, or cannot be reached any more, from as soon as
                possible.
            points: as for `append`; the time of a trajectory begins at `from_time`.

        Returns:
            s on the clock of the stream from which it holds.

        Raises:
            BadValue: the arm could not follow them, they are past, or no path within the limits leads onto them; the
                old points stay.
            LocalError, LinkError: as for `append`.
        """
        since = check_number(from_time, "from_time", 0.0, unit="s")
        with self._producing():
            replaced = self._put(since, self._curve(points, since))
            on_give_up(partial(self._undo, replaced))
            return self._answered(replaced)

    def _undo(self, replaced: Future[float]) -> None:
        """Clear the stream, since the task that replaced its points was cancelled; unless that has failed anyway."""
        if not (replaced.done() and replaced.exception() is not None):
            with contextlib.suppress(LinkError):
                self.clear()

    def _curve(self, points: Points, since: float) -> list[Aim]:
        """What the points are replaced by."""
        return self._reader.curve(points, since, self._mark())

    def _put(self, since: float, curve: Sequence[Aim]) -> Future[float]:
        """Have the points after a time replaced, by none too."""
        with self._context.section.lock:
            if curve:
                check_wanted()
            return self._feed.replace(since, curve)

    def _await_answer(self) -> None:
        """Wait until it is known which points the robot holds."""
        with self._context.section.lock:
            answered = self._feed.answered()
        self._await(answered, _ANSWER, "the robot has not answered")

    def _check(self, since: float, curve: Sequence[Aim]) -> None:
        """Raise BadValue if it is known now that `_put` would be refused."""
        with self._context.section.lock:
            self._feed.check(since, curve)

    def _reach(self, later: float) -> float:
        """See `StreamFeed.reach`."""
        with self._context.section.lock:
            return self._feed.reach(later)

    @property
    def _is_answered(self) -> bool:
        return self._feed.is_answered

    def _answered(self, replaced: Future[float]) -> float:
        return self._await(replaced, _ANSWER, "the robot has not taken the change of its points")

    def clear(self) -> float:
        """Drop all points, also those that the robot holds, and brake; the stream goes on with the next points.

        Returns:
            s on the clock of the stream at which the points end now.

        Raises:
            LocalError, LinkError: as for `append`.
        """
        self._check_open()
        self._mark()
        return self._answered(self._put(0.0, ()))

    def wait_until_dry(self, timeout: float = 60.0) -> None:
        """Wait until the arm has come to the end of all points, and rests.

        Raises:
            LinkTimeout: it has not, in `timeout` seconds; it goes on.
            LocalError, LinkError: as for `append`.
        """
        seconds = check_seconds(timeout, "timeout", finite=True)
        self._check_open()
        self._mark()
        with self._context.section.lock:
            dry = self._feed.dry()
        self._await(dry, seconds, "the stream has not run dry")

    # -- where it is -----------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """The clock of the stream, s: the time of the points at which the arm is led now.

        It begins at 0, goes as slow as the robot does (speed slider, pause), and stands while the stream is dry.
        """
        with self._context.section.lock:
            return self._feed.time

    @property
    def end(self) -> float:
        """The time of the last point, s on the clock of the stream."""
        mark = self._feed.mark
        return 0.0 if mark is None else mark.time

    @property
    def buffered(self) -> float:
        """s from `time` to `end`: how much is left."""
        return max(self.end - self.time, 0.0)

    @property
    def room(self) -> float:
        """s of points that the robot has room for; less than zero if points wait in memory."""
        return self.buffer - self.buffered

    @property
    def is_dry(self) -> bool:
        """Whether the arm rests because there are no points."""
        with self._context.section.lock:
            return self._feed.is_dry

    @property
    def starved(self) -> int:
        """How often the arm had to brake because there were no more points, after one at which it was not at rest."""
        return self._feed.starved

    # --------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _producing(self) -> Iterator[None]:
        self._check_open()
        with self._context.section.lock:
            if self._is_producing:
                raise LocalError("another thread or task appends or replaces points; a stream has one producer")
            self._is_producing = True
        try:
            yield
        finally:
            self._is_producing = False

    def _mark(self) -> Mark:
        self._await(self._feed.begun, _ANSWER, "the arm does not come to rest")
        mark = self._feed.mark
        assert mark is not None
        return mark

    def _await(self, future: Future[T], seconds: float, what: str) -> T:
        """The result, within so many seconds; raises what has ended the stream."""
        if not future.done():
            with self._context.section.waiting():
                if not clock.is_done(future, seconds):
                    raise LinkTimeout(f"{what} within {seconds:g} s")
        error = future.exception()
        if isinstance(error, LinkError) and self.done and self.error is not None:
            raise self.error
        return future.result()


def _inverse(context: MotionContext, pose: FloatArray, near: FloatArray) -> FloatArray:
    """The joint positions for a pose, with the TCP that the robot shows."""
    arm = context.who.identity.kinematics
    return arm.inverse(pose, near, shown_tcp(arm, context.state()))
