"""Point streams: points that are appended while the arm moves through the previous points."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from functools import cache, partial
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

#: First firmware with programs that can buffer points.
_BUFFERS = Firmware(3, 4)
#: Maximum number of points that the program buffers, even if they are close together in time. Chosen: the text of the
#: program is then at most half as long as the largest public driver program.
_MOST = 256
#: Time in s within which the robot must answer a replacement, and within which the arm must come to rest before the
#: first point.
_ANSWER = 10.0

T = TypeVar("T")


@slider(stream=SliderEffect.SCALED)
class PointStream(BlockMotion):
    """Motion through points that are appended while the arm moves; see `robot.motion.stream`.

    Use it as a ``with`` block. A program on the robot buffers the next points. If no point is left, the arm brakes. The
    next points then continue the motion. Leaving the block stops the arm immediately. If the arm should reach its last
    point, call `wait_until_dry` before leaving the block.

    Only one thread or task may append and replace points at a time; a concurrent call is rejected. Any thread may call
    `clear`.

    Attributes:
        buffer: Duration of the points that the program on the robot buffers, in s.
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
                else "its URScript does not have the required functions"
            )
            raise LocalError(
                f"firmware {firmware} cannot buffer points of a stream: {why}; {_BUFFERS} or later is required. "
                "Alternatively, servo() moves the arm by one set-point per cycle"
            )
        self.buffer = buffer
        cycle = 1.0 / firmware.rate
        shortest = 2.0 * cycle  # the program reads a message per cycle, and must read points faster than the arm moves
        bounds = Bounds(identity.arm, servoing.speeds, limits, cache(context.limited))
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
        life.on_end(lambda: feed.end(life.error or Closed("the block of this stream was left")))
        self._is_producing = False  # works like a lock, but a second caller gets an error instead of waiting

    def _join(self, pace: MemberPace) -> None:
        """Make the arm pass points at the common pace of several streams.

        Call this method before the stream begins.
        """
        self._feed.pace = pace
        pace.is_paused = partial(getattr, self._program, "is_paused")
        self._life.on_end(pace.leave)

    # -- points ----------------------------------------------------------------------------------------

    def append(self, points: Points, *, wait: bool | float = True) -> float:
        """Append points after the last point of the stream.

        A `TrajectoryPoint` that has only positions is reached in a straight line in joint space at constant speed. A
        point with velocities is reached on a cubic curve, and a point with velocities and accelerations on a quintic
        curve. A `Trajectory` begins at the end of the stream.

        Args:
            points: One point, several points, or a trajectory. Times are in s on the clock of the stream, and must
                increase. The first time must be at least two cycles of the controller after `end`. Exception: if the
                arm rests within 0.05 rad of the first point, this point may have the time `end`.
            wait: Whether to wait until the robot has room for all points. True waits up to 60 s, a number up to this
                number of seconds. If False, points are queued in memory.

        Returns:
            Duration of further points for which the robot has room after the call, in s. The value is negative if
            points are queued in memory.

        Raises:
            BadValue: If the arm could not follow the points. Nothing is appended.
            LinkTimeout: If the robot has no room in time. The points remain in the stream.
            Unreachable: If a pose is out of reach. Nothing is appended.
            Cancelled: If the points were cleared before the robot had room for them, or if the stream was cancelled.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped: If the stream has ended.
            LocalError: If called outside the ``with`` block, or while another thread appends or replaces points.
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
        """Return the end of the stream, and the aims for points after it.

        The points begin at `begins` or later, in s on the clock of the stream.
        """
        mark = self._mark()
        if mark.time < begins:
            with self._context.section.lock:
                self._feed.skip(begins)
            mark = self._mark()
        return mark, self._reader.after(points, mark, begins)

    def _add(self, mark: Mark, aims: Sequence[Aim]) -> Handed | None:
        """Append the aims; return None if another thread has cleared the stream since `_checked`."""
        handed = Handed()
        with self._context.section.lock:
            if self._feed.mark is not mark:
                return None
            self._feed.add(aims, handed)
        return handed

    def _await_room(self, handed: Handed, seconds: float) -> None:
        self._await(handed.future, seconds, "the robot had no room for the points")

    def replace(self, from_time: float, points: Points) -> float:
        """Replace all points after a time by other points.

        Positions, speeds and accelerations are continuous. The points that the robot has buffered are replaced, too.
        The arm leaves its old curve at `from_time`. Then it moves onto the curve through the new points, as soon as the
        limits of acceleration and jerk of the stream allow. After that, the arm reaches each point at the time of this
        point. Therefore the points may begin in the past, for example at the time of the observation from which they
        were computed.

        Args:
            from_time: Time in s on the clock of the stream. If this time is past, or if a message can no longer reach
                the robot before it, the points are replaced as soon as possible.
            points: See `append`. The time of a trajectory begins at `from_time`.

        Returns:
            Time at which the new points take effect, in s on the clock of the stream.

        Raises:
            BadValue: If the arm could not follow the points, if all points are in the past, or if no path within the
                limits leads onto them. The old points remain.
            LocalError, LinkError: If `append` would raise this error.
        """
        since = check_number(from_time, "from_time", 0.0, unit="s")
        with self._producing():
            replaced = self._put(since, self._curve(points, since))
            on_give_up(partial(self._undo, replaced))
            return self._answered(replaced)

    def _undo(self, replaced: Future[float]) -> None:
        """Clear the stream after the task that replaced its points was cancelled.

        Do nothing if the replacement failed.
        """
        if not (replaced.done() and replaced.exception() is not None):
            with contextlib.suppress(LinkError):
                self.clear()

    def _curve(self, points: Points, since: float) -> list[Aim]:
        """Return the aims for new points that replace the old points after `since`."""
        return self._reader.curve(points, since, self._mark())

    def _put(self, since: float, curve: Sequence[Aim]) -> Future[float]:
        """Request that the points after `since` are replaced, or removed if `curve` is empty."""
        with self._context.section.lock:
            if curve:
                check_wanted()
            return self._feed.replace(since, curve)

    def _await_answer(self) -> None:
        """Wait until the robot has answered all requests, so that its buffered points are known."""
        with self._context.section.lock:
            answered = self._feed.answered()
        self._await(answered, _ANSWER, "the robot did not answer")

    def _check(self, since: float, curve: Sequence[Aim]) -> None:
        """Raise `BadValue` if a call of `_put` would be rejected now."""
        with self._context.section.lock:
            self._feed.check(since, curve)

    def _reach(self, later: float) -> float:
        """Return the earliest time that can be replaced `later` seconds from now; see `StreamFeed.reach`."""
        with self._context.section.lock:
            return self._feed.reach(later)

    @property
    def _is_answered(self) -> bool:
        return self._feed.is_answered

    def _answered(self, replaced: Future[float]) -> float:
        return self._await(replaced, _ANSWER, "the robot did not confirm the change of its points")

    def clear(self) -> float:
        """Drop all points, including the points that the robot has buffered, and brake.

        The next points continue the stream.

        Returns:
            New end of the points, in s on the clock of the stream.

        Raises:
            LocalError, LinkError: If `append` would raise this error.
        """
        self._check_open()
        self._mark()
        return self._answered(self._put(0.0, ()))

    def wait_until_dry(self, timeout: float = 60.0) -> None:
        """Wait until the arm has reached the last point and is at rest.

        Raises:
            LinkTimeout: If this takes longer than `timeout` seconds. The stream continues.
            LocalError, LinkError: If `append` would raise this error.
        """
        seconds = check_seconds(timeout, "timeout", finite=True)
        self._check_open()
        self._mark()
        with self._context.section.lock:
            dry = self._feed.dry()
        self._await(dry, seconds, "the stream did not run dry")

    # -- its state -------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Current time on the clock of the stream, in s: the time of the position that the arm is passing.

        The clock begins at 0. It advances with the time of the program on the robot, so the speed slider slows the
        clock down, and a pause stops the clock. The clock also stops while the stream is dry.
        """
        with self._context.section.lock:
            return self._feed.time

    @property
    def end(self) -> float:
        """Time of the last point, in s on the clock of the stream."""
        mark = self._feed.mark
        return 0.0 if mark is None else mark.time

    @property
    def buffered(self) -> float:
        """Remaining time from `time` to `end`, in s."""
        return max(self.end - self.time, 0.0)

    @property
    def room(self) -> float:
        """Duration of further points for which the robot has room, in s; negative if points are queued in memory."""
        return self.buffer - self.buffered

    @property
    def is_dry(self) -> bool:
        """Whether the arm is at rest because no points are left."""
        with self._context.section.lock:
            return self._feed.is_dry

    @property
    def starved(self) -> int:
        """Number of times that the arm had to brake because no points were left.

        The end of the points is not counted if the arm is at rest at the last point.
        """
        return self._feed.starved

    # --------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _producing(self) -> Iterator[None]:
        self._check_open()
        with self._context.section.lock:
            if self._is_producing:
                raise LocalError("another thread or task is appending or replacing points; only one may do so at once")
            self._is_producing = True
        try:
            yield
        finally:
            self._is_producing = False

    def _mark(self) -> Mark:
        self._await(self._feed.begun, _ANSWER, "the arm did not come to rest")
        mark = self._feed.mark
        assert mark is not None
        return mark

    def _await(self, future: Future[T], seconds: float, what: str) -> T:
        """Wait up to `seconds` for the result of a future, and return it.

        If the stream has ended, raise the error that ended it.
        """
        if not future.done():
            with self._context.section.waiting():
                if not clock.is_done(future, seconds):
                    raise LinkTimeout(f"{what} within {seconds:g} s")
        error = future.exception()
        if isinstance(error, LinkError) and self.done and self.error is not None:
            raise self.error
        return future.result()


def _inverse(context: MotionContext, pose: FloatArray, near: FloatArray) -> FloatArray:
    """Return the joint positions for a pose of the TCP that the robot currently uses."""
    arm = context.who.identity.kinematics
    return arm.inverse(pose, near, shown_tcp(arm, context.state()))
