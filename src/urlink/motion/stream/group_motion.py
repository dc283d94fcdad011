"""Motions of a group of arms: the handle of such a motion, and point streams with a common time."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from linkcore import clock
from linkcore.arguments import check_number, check_seconds, check_wait
from linkcore.errors import BadValue, Cancelled, LinkError, RemoteError, unraised
from linkcore.handle import Lifecycle, Motion
from linkcore.pending_call import on_give_up, starts_motion
from linkcore.threads import CallbackThread

from .point_stream import PointStream
from .stream_points import Points
from .stream_steps import Aim, Handed

if TYPE_CHECKING:
    from typing_extensions import Self

E = TypeVar("E", bound=Exception)

#: Largest difference in s between the ends of the points of two arms.
_SAME_TIME = 1e-6
#: Time in s that is reserved for planning the paths of all arms onto other points. Chosen: for two arms, planning takes
#: a few ms. If planning takes longer, some arms change to their new points later.
_PLANNING = 0.01
#: Longest time in s to wait until the handle is notified of the end of a stream and of the reason.
_REASON = 1.0


class GroupMotion(Motion):
    """Handle of a motion of several arms.

    The group motion ends when the motions of all arms have ended. If the motion of one arm fails or is cancelled, the
    motions of all arms are ended.

    Attributes:
        motions: Motions of the arms, in the order of the group.
    """

    def __init__(
        self, life: Lifecycle, motions: Sequence[Motion], names: Sequence[str], stopping: CallbackThread
    ) -> None:
        super().__init__(life)
        self.motions = tuple(motions)
        self._names = tuple(names)
        self._stopping = stopping
        lives = [motion._life for motion in motions]
        life.brake = partial(end_all, lives, f"cancelled with its group of {len(lives)}")
        for number, each in enumerate(lives):
            # Call `_look` in a dedicated thread. The thread that ends a motion may hold the lock of its robot, and must
            # not wait for the lock of another robot.
            each.on_end(partial(stopping.call, self._look, number))

    def _measured(self) -> float:
        return min(motion.progress for motion in self.motions)

    def _look(self, number: int) -> None:
        """Handle the end of the motion of one arm."""
        motion = self.motions[number]
        error = motion.error
        if error is not None:
            others = [each._life for each in self.motions if each is not motion]
            end_all(others, f"stopped because the motion of {self._names[number]} ended: {error}")
            if isinstance(error, Cancelled):
                self._life.cancel(f"cancelled with the motion of {self._names[number]}: {error}")
            else:
                self._life.fail(of_arm(error, self._names[number]))
        elif all(each.done and each.error is None for each in self.motions):
            self._life.finish()


class GroupStream(GroupMotion):
    """Stream of points for several arms; see `Group.stream`.

    Use it as a ``with`` block. This class works like `PointStream`, but each call contains the points of all arms. All
    arms begin at the same moment, and no arm goes ahead of another. All arms advance as slowly as the slowest arm. If
    one arm has no points or is paused, all arms stop on their paths.

    Attributes:
        motions: Streams of the arms.
    """

    motions: tuple[PointStream, ...]

    def __init__(
        self, life: Lifecycle, streams: Sequence[PointStream], names: Sequence[str], stopping: CallbackThread
    ) -> None:
        super().__init__(life, streams, names, stopping)
        #: exit stack that closes all streams; set by `__enter__`
        self._block: contextlib.ExitStack
        #: lock that is held while points are passed to all arms or removed from all arms; re-entrant, for signal
        #: handlers
        self._handing = threading.RLock()

    @starts_motion
    def __enter__(self) -> Self:
        """Upload the programs and wait until all have connected.

        Raises:
            LocalError, LinkError: If a `PointStream` would raise this error. No arm has moved.
        """
        self._stopping.start()
        try:
            with contextlib.ExitStack() as begun:
                for stream, name in zip(self.motions, self._names, strict=True):
                    with naming(name):
                        begun.enter_context(stream)
                self._block = begun.pop_all()
        except BaseException as error:
            self._life.fail(error if isinstance(error, Exception) else Cancelled(f"{self.name} was interrupted"))
            raise
        self._life.begin()
        return self

    def __exit__(self, *exc: object) -> None:
        """Stop all arms, and wait until they are at rest. Earlier errors are not raised."""
        try:
            with self._block:
                for stream in self.motions:
                    with contextlib.suppress(LinkError):
                        stream._program.finish()
            with contextlib.suppress(LinkError):
                self.wait(_REASON)
        except BaseException as error:
            self._give_up(error)
            raise

    def append(self, points: Sequence[Points], *, wait: bool | float = True) -> float:
        """Append points for each arm; see `PointStream.append`.

        Args:
            points: Points for each arm, in the order of the group. The times of points are in s on the common clock of
                the stream. The points of all arms must end at the same time.
            wait: Whether to wait until all robots have room for all points. True waits up to 60 s, a number up to this
                number of seconds.

        Returns:
            Duration of further points for which all robots have room after the call, in s.

        Raises:
            BadValue: If the points of an arm are missing, if the points of two arms end at different times, or if an
                arm could not follow its points. Nothing is appended.
            LocalError, LinkError: If `PointStream.append` would raise this error, or if the stream of another arm has
                ended. Then the error states the reason.
        """
        seconds = check_wait(wait)
        with self._producing(points):
            handed: list[Handed | None] = []
            while not any(handed):  # repeat if another thread has cleared the stream meanwhile
                # If a replacement took effect later on some arms, the points of the arms may end at different times.
                begins = max(stream._mark().time for stream in self.motions)
                checked = [stream._checked(each, begins) for stream, each in zip(self.motions, points, strict=True)]
                _check_ends([aims for _, aims in checked])
                with self._handing:
                    handed = [stream._add(*each) for stream, each in zip(self.motions, checked, strict=True)]
            until = clock.now() + seconds
            for stream, each in zip(self.motions, handed, strict=True):
                if seconds and each is not None:
                    stream._await_room(each, clock.left(until))
        return self.room

    def replace(self, from_time: float, points: Sequence[Points]) -> float:
        """Replace all points of all arms after the same time; see `PointStream.replace`.

        Each arm moves onto its new points as soon as the limits of this arm allow.

        Args:
            from_time: Time in s on the clock of the stream. If this time is past, or if a message can no longer reach
                one of the robots in time, the points are replaced as soon as this is possible for all arms.
            points: Points for each arm; see `append`. The time of a trajectory begins at `from_time`.

        Returns:
            Time at which the new points have taken effect for all arms, in s on the clock of the stream.

        Raises:
            BadValue: If the points of an arm are missing, if the points of two arms end at different times, or if an
                arm could not follow its points. The old points of all arms remain. Exception: if the change reaches one
                robot too late, but has taken effect on another robot, the points of all arms are cleared.
            LocalError, LinkError: If `append` would raise this error.
        """
        since = check_number(from_time, "from_time", 0.0, unit="s")
        with self._producing(points):
            curves = [stream._curve(each, since) for stream, each in zip(self.motions, points, strict=True)]
            _check_ends(curves)
            return self._put(since, curves)

    def clear(self) -> float:
        """Drop all points of all arms, so that all arms brake at the same time; see `PointStream.clear`.

        Returns:
            New end of the points, in s on the clock of the stream.

        Raises:
            LocalError, LinkError: If `append` would raise this error.
        """
        with self._reasons():
            for stream in self.motions:
                stream._check_open()
                stream._mark()
            return self._put(0.0, [()] * len(self.motions))

    def _put(self, since: float, curves: Sequence[Sequence[Aim]]) -> float:
        """Replace the points of all arms, if this is possible for each arm; return the time of the change, in s."""
        replaced: list[Future[float]] = []
        while not replaced:
            for stream in self.motions:
                stream._await_answer()
            with self._handing:
                if all(stream._is_answered for stream in self.motions):
                    begin = max(since, *(stream._reach(_PLANNING) for stream in self.motions))
                    for stream, curve in zip(self.motions, curves, strict=True):
                        stream._check(begin, curve)
                    replaced = [stream._put(begin, curve) for stream, curve in zip(self.motions, curves, strict=True)]
        if any(curves):
            on_give_up(self._undo)
        times, refused = [], []
        for stream, name, each in zip(self.motions, self._names, replaced, strict=True):
            try:
                times.append(stream._answered(each))
            except BadValue as error:
                refused.append((name, error))
        if not refused:
            return max(times)
        name, reason = refused[0]
        if times:
            self.clear()
            raise BadValue(
                f"all points of all arms were cleared, because the change reached {name} too late: {reason}"
            ) from reason
        raise reason

    def _undo(self) -> None:
        """Clear the stream after the task that replaced its points was cancelled."""
        with contextlib.suppress(LinkError):
            self.clear()

    def wait_until_dry(self, timeout: float = 60.0) -> None:
        """Wait until all arms have reached their last points and are at rest.

        Raises:
            LinkTimeout: If this takes longer than `timeout` seconds. The stream continues.
            LocalError, LinkError: If `append` would raise this error.
        """
        until = clock.now() + check_seconds(timeout, "timeout", finite=True)
        with self._reasons():
            for stream in self.motions:
                stream.wait_until_dry(clock.left(until))

    @property
    def time(self) -> float:
        """Current time of the slowest arm on the clock of the stream, in s; see `PointStream.time`."""
        return min(stream.time for stream in self.motions)

    @property
    def end(self) -> float:
        """Time of the last point, in s on the clock of the stream."""
        return max(stream.end for stream in self.motions)

    @property
    def buffered(self) -> float:
        """Remaining time from `time` to `end`, in s."""
        return max(self.end - self.time, 0.0)

    @property
    def room(self) -> float:
        """Duration of further points for which all robots have room, in s; negative if points are queued in memory."""
        return min(stream.room for stream in self.motions)

    @property
    def is_dry(self) -> bool:
        """Whether all arms are at rest because no points are left."""
        return all(stream.is_dry for stream in self.motions)

    @property
    def starved(self) -> int:
        """Number of times that an arm had to brake because no points were left; the largest number of all arms."""
        return max(stream.starved for stream in self.motions)

    @contextlib.contextmanager
    def _producing(self, points: Sequence[Points]) -> Iterator[None]:
        """Prevent other threads and tasks from appending or replacing points while the block is open."""
        if len(points) != len(self.motions):
            raise BadValue(
                f"points has entries for {len(points)} arms; expected one for each of the {len(self.motions)}"
            )
        with self._reasons(), contextlib.ExitStack() as stack:
            for stream in self.motions:
                stack.enter_context(stream._producing())
            yield

    @contextlib.contextmanager
    def _reasons(self) -> Iterator[None]:
        """If the stream of one arm has ended, raise the error of the group instead of a follow-up error."""
        try:
            yield
        except LinkError:
            if any(stream.done for stream in self.motions):
                self._life.wait(_REASON)
            if self.error is not None:
                raise self.error from None
            raise


def _check_ends(aims: Sequence[Sequence[Aim]]) -> None:
    ends = [each[-1].time for each in aims]
    if max(ends) - min(ends) > _SAME_TIME:
        raise BadValue(f"the points end at {', '.join(f'{end:g}' for end in ends)} s; expected the same time for all")


def of_arm(error: E, name: str) -> E:
    """Return a copy of the error of one arm. The message of the copy begins with the name of the arm."""
    named = unraised(error)
    if error.args and isinstance(error.args[0], str):
        named.args = (f"{name}: {error.args[0]}", *error.args[1:])
    return named


@contextlib.contextmanager
def naming(name: str) -> Iterator[None]:
    """Add the name of the arm to each `RemoteError` that is raised in the block."""
    try:
        yield
    except RemoteError as error:
        raise of_arm(error, name) from error.__cause__


def end_all(lives: Sequence[Lifecycle], why: str) -> None:
    """Cancel these motions, and brake their arms."""
    for life in lives:
        life.cancel(why, brake=True)
