"""Motions of a group of arms: the handle, and streams of points on one time base."""

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

#: s by which the points of two arms may end at different times.
_SAME_TIME = 1e-6
#: s within which the ways of all arms onto other points have been found. Chosen: two take a few ms; if it takes longer,
#: some arms go over later.
_PLANNING = 0.01
#: s within which the handle is notified of the end of a stream, and the reason of it.
_REASON = 1.0


class GroupMotion(Motion):
    """A motion of several arms that runs. It is over when that of each arm is; what ends one before its time ends all.

    Attributes:
        motions: those of the arms, in the order of the group.
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
            # In a thread of its own: the one that ends a motion may hold the section of its robot, and must not wait
            # for that of another.
            each.on_end(partial(stopping.call, self._look, number))

    def _measured(self) -> float:
        return min(motion.progress for motion in self.motions)

    def _look(self, number: int) -> None:
        """The motion of one arm is over."""
        motion = self.motions[number]
        error = motion.error
        if error is not None:
            others = [each._life for each in self.motions if each is not motion]
            end_all(others, f"stopped, since that of {self._names[number]} ended: {error}")
            if isinstance(error, Cancelled):
                self._life.cancel(f"cancelled with that of {self._names[number]}: {error}")
            else:
                self._life.fail(of_arm(error, self._names[number]))
        elif all(each.done and each.error is None for each in self.motions):
            self._life.finish()


class GroupStream(GroupMotion):
    """A stream of points for several arms; made by `Group.stream`, open in a ``with`` block.

    As `PointStream`, but each call has the points of all arms. They begin at the same moment, and none goes ahead of
    another: all pass as slowly as the slowest, and stand on their paths while one has no points, or is paused.

    Attributes:
        motions: the streams of the arms.
    """

    motions: tuple[PointStream, ...]

    def __init__(
        self, life: Lifecycle, streams: Sequence[PointStream], names: Sequence[str], stopping: CallbackThread
    ) -> None:
        super().__init__(life, streams, names, stopping)
        #: of all streams; from `__enter__` on
        self._block: contextlib.ExitStack
        #: points are handed to all arms, or taken from all; re-entrant, for signal handlers
        self._handing = threading.RLock()

    @starts_motion
    def __enter__(self) -> Self:
        """Upload the programs and wait until all have connected.

        Raises:
            LocalError, LinkError: as `PointStream`; none has moved.
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
        """Stop all arms, and wait until they stand still. Raises no earlier error."""
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
            points: for each arm, in the order of the group. Their times are s on the one clock of the stream; they end
                at the same time.
            wait: return once all robots have room for all of them, within 60 s or as many as are given.

        Returns:
            s of points for which there is room after that.

        Raises:
            BadValue: not for each arm; they end at different times; or an arm could not follow them. Nothing was
                appended.
            LocalError, LinkError: as `PointStream.append`; or what has ended the stream of another arm.
        """
        seconds = check_wait(wait)
        with self._producing(points):
            handed: list[Handed | None] = []
            while not any(handed):  # another thread has cleared the stream meanwhile
                # After a replacement that some arms took later than others, their points may end at different times.
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
        """Replace all points of all arms after a time, from the same time on; see `PointStream.replace`.

        Each arm goes over onto its new points as soon as its limits allow.

        Args:
            from_time: s on the clock of the stream; if that is past, or one of the robots cannot be reached any more,
                from as soon as all can be.
            points: for each arm, as for `append`; the time of a trajectory begins at `from_time`.

        Returns:
            s on the clock of the stream from which it holds for all.

        Raises:
            BadValue: not for each arm; they end at different times; or an arm could not follow them. The old points of
                all arms stay; but if it came to one robot so late that it cannot go over any more, after others
                have, the stream of all is cleared.
            LocalError, LinkError: as for `append`.
        """
        since = check_number(from_time, "from_time", 0.0, unit="s")
        with self._producing(points):
            curves = [stream._curve(each, since) for stream, each in zip(self.motions, points, strict=True)]
            _check_ends(curves)
            return self._put(since, curves)

    def clear(self) -> float:
        """Drop all points of all arms, and brake, all from the same time on; see `PointStream.clear`.

        Returns:
            s on the clock of the stream at which the points end now.

        Raises:
            LocalError, LinkError: as for `append`.
        """
        with self._reasons():
            for stream in self.motions:
                stream._check_open()
                stream._mark()
            return self._put(0.0, [()] * len(self.motions))

    def _put(self, since: float, curves: Sequence[Sequence[Aim]]) -> float:
        """Replace the points of all arms, if each can go over; returns s from which that holds."""
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
            raise BadValue(f"all points of all arms were cleared: it came too late to {name}: {reason}") from reason
        raise reason

    def _undo(self) -> None:
        """Clear the stream, since the task that replaced its points was cancelled."""
        with contextlib.suppress(LinkError):
            self.clear()

    def wait_until_dry(self, timeout: float = 60.0) -> None:
        """Wait until all arms have come to the end of their points, and rest.

        Raises:
            LinkTimeout: they have not, in `timeout` seconds; they go on.
            LocalError, LinkError: as for `append`.
        """
        until = clock.now() + check_seconds(timeout, "timeout", finite=True)
        with self._reasons():
            for stream in self.motions:
                stream.wait_until_dry(clock.left(until))

    @property
    def time(self) -> float:
        """The clock of the stream, s, as `PointStream.time`: of the arm that is furthest behind."""
        return min(stream.time for stream in self.motions)

    @property
    def end(self) -> float:
        """The time of the last point, s on the clock of the stream."""
        return max(stream.end for stream in self.motions)

    @property
    def buffered(self) -> float:
        """s from `time` to `end`: how much is left."""
        return max(self.end - self.time, 0.0)

    @property
    def room(self) -> float:
        """s of points that all robots have room for; less than zero if points wait in memory."""
        return min(stream.room for stream in self.motions)

    @property
    def is_dry(self) -> bool:
        """Whether all arms rest because there are no points."""
        return all(stream.is_dry for stream in self.motions)

    @property
    def starved(self) -> int:
        """How often one of the arms had to brake because there were no more points."""
        return max(stream.starved for stream in self.motions)

    @contextlib.contextmanager
    def _producing(self, points: Sequence[Points]) -> Iterator[None]:
        """Nobody else appends or replaces."""
        if len(points) != len(self.motions):
            raise BadValue(f"points for {len(points)} arms; expected them for each of the {len(self.motions)}")
        with self._reasons(), contextlib.ExitStack() as stack:
            for stream in self.motions:
                stack.enter_context(stream._producing())
            yield

    @contextlib.contextmanager
    def _reasons(self) -> Iterator[None]:
        """What has ended one stream is the error of all."""
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
    """A copy of the error of one arm, whose message begins with the name of the arm."""
    named = unraised(error)
    if error.args and isinstance(error.args[0], str):
        named.args = (f"{name}: {error.args[0]}", *error.args[1:])
    return named


@contextlib.contextmanager
def naming(name: str) -> Iterator[None]:
    """Raise a `RemoteError` of one arm with the name of the arm."""
    try:
        yield
    except RemoteError as error:
        raise of_arm(error, name) from error.__cause__


def end_all(lives: Sequence[Lifecycle], why: str) -> None:
    """Cancel these, and have their arms brake."""
    for life in lives:
        life.cancel(why, brake=True)
