"""Dialogue with the program that buffers points (`urlink.script.buffering`): sent points, and position of the arm.

The curve of the points begins at the position where the arm is at rest, and passes each point at the time of this
point. Usually the arm is on this curve. If points came too late or were replaced, a path leads the arm from its
position onto the curve. The clock of the stream shows the time on the curve. This clock stops while the arm brakes or
is at rest because no points are left.

A cut is a message that replaces the buffered points, or lets the program continue from rest or from braking. If a cut
comes too late, or if points arrive after braking has begun, the program refuses them and reports this. The refused
points are then planned again from the new position of the arm.
"""

from __future__ import annotations

import dataclasses
import struct
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from linkcore.errors import BadValue, Cancelled

from ...command.program_time import ProgramTimer
from ...errors import ToleranceExceeded
from ...protocol.realtime.packets import RealtimeState
from ...script.buffering import (
    BRAKING,
    CUT,
    FINE,
    MESSAGE,
    MOVING,
    OPEN,
    POINT,
    REPORTED,
    RESTING,
    PointRegisters,
)
from ...script.links import SCALE, STOP, WAIT
from ...script.messages import LARGEST
from ..servo.following import Rest
from ..servo.setpoints import LinkDialogue
from .common_time import MemberPace
from .feed_life import FeedEvent, FeedLife, FeedPhase
from .program_pace import ProgramPace
from .stream_steps import Aim, Bounds, Handed, JointMoment, Mark, Step, onto

_MESSAGE, _REPORT = struct.Struct(f">{MESSAGE}i"), struct.Struct(f">{REPORTED}i")
_STOP_MESSAGE = _MESSAGE.pack(STOP, *[0] * (MESSAGE - 1))
#: Longest time in s without a report. After this time, the other arms of a group do not count this arm as moving along
#: its points. Chosen: five reports.
_UNANSWERED = 0.1
#: Number of cycles without a state, after which a report may be older than the next state.
_GAP = 2
#: Time that is reserved for a cut to reach the program: at first the sum of a number of cycles and a time in s, and its
#: maximum in s. Each cut that comes too late doubles the reserved time.
_AHEAD, _WAY, _LONGEST_WAY = 6, 0.01, 1.0
#: Number of messages after a pause within which the program must report that the arm was moved. The program is slow at
#: first.
_RESUMING = 50


@dataclasses.dataclass(frozen=True)
class _Sent:
    """A step that the program has buffered, or that is being sent.

    Attributes:
        number: Number of the point at the end of the step.
        message: Number of the message that contained the step.
        step: The step.
        begins, ends: Beginning and end of the step on the clock of the stream, in s.
        until: Total duration of all steps up to the end of this step, in s.
        aim: Point at the end of the step; None if the step is only the first part of a step that a cut has shortened.
    """

    number: int
    message: int
    step: Step
    begins: float
    ends: float
    until: float
    aim: Aim | None

    def clock(self, t: float) -> float:
        """Return the time on the clock of the stream, in s, at `t` seconds after the beginning of the step."""
        return self.begins + (self.ends - self.begins) * max(t, 0.0) / self.step.length


@dataclasses.dataclass(frozen=True)
class _Report:
    messages: int
    epoch: int
    head: int
    base: int
    passed: float
    phase: int


@dataclasses.dataclass
class _Request:
    """Request to replace all points after a time, or to remove them.

    Attributes:
        since: Time on the clock of the stream, in s.
        curve: New points, each with the step from the previous point; empty to remove points only.
        done: Future that gets the time at which the change takes effect.
    """

    since: float
    curve: Sequence[Aim]
    done: Future[float]


@dataclasses.dataclass(frozen=True)
class _Cut:
    """A cut that the program has not answered.

    It contains the numbers of its message and epoch, and the state to restore if the program refuses it.
    """

    message: int
    epoch: int
    head: int
    steps: tuple[_Sent, ...]
    queue: tuple[Aim, ...]
    mark: Mark
    request: _Request | None


class StreamFeed(LinkDialogue):
    """Dialogue that sends points to the program, as long as the buffer of the program has room.

    Args:
        write: Function that returns the lines of the program.
        section: Lock of the robot. It is needed because points and states arrive in different threads.
        bounds: Bounds for the steps of the stream.
        cycle: Cycle of the controller, in s.
        capacity: Maximum number of points that the program buffers.
        buffer: Duration of the points that the program should buffer, in s.

    Attributes:
        pace: Pace of this stream in a group of streams; None for a single stream.
        begun: Future that gets its result when the arm is at rest, so that points can be appended.
        starved: Number of times that the arm had to brake because no points were left.
        margin: Time in s that is reserved for a cut to reach the program.
    """

    farewell = _STOP_MESSAGE

    def __init__(
        self,
        write: Callable[[Any], list[str]],
        section: AbstractContextManager[object],
        bounds: Bounds,
        cycle: float,
        capacity: int,
        buffer: float,
    ) -> None:
        super().__init__(write)
        self._section = section
        self._bounds = bounds
        self._cycle = cycle
        self._capacity = capacity
        self._buffer = buffer
        self.begun: Future[None] = Future()
        self.starved = 0
        self.margin = _AHEAD * cycle + _WAY
        self.mark: Mark | None = None
        self.pace: MemberPace | None = None
        self._timer = ProgramTimer(cycle)
        self._life = FeedLife()
        self._program_pace = ProgramPace()
        self._begin = Rest("the stream")
        self._is_lossy = False
        self._received = b""
        self._messages = self._last_answered = self._epoch = self._head = 0
        #: time in s that has passed on the steps since the first state: now, and at the last report
        self._passed = self._reported = 0.0
        #: duration of a gap before the newest state, in s; 0 if no states were missed; set by the first state
        self._unseen: float
        self._report = _Report(0, 0, 0, 0, 0.0, RESTING)
        #: the steps that were sent and not yet passed, including the current step
        self._steps: deque[_Sent] = deque()
        #: the last step that was passed, and the braking from its end while the epoch is closed
        self._last: _Sent
        self._brake: Step
        #: number of the step in which the arm continued from braking; -1 if there is none
        self._resumed = -1
        self._queue: deque[Aim] = deque()
        #: the cut that the program has not answered; None if there is none
        self._cut: _Cut | None = None
        #: requests that are processed after the answer to the cut
        self._requests: deque[_Request] = deque()
        self._may_skip = False
        #: after a pause: the number of messages before the pause, and the moment of the arm after it
        self._found: tuple[int, JointMoment] | None = None
        self._answered: list[Future[None]] = []
        self._dry: list[Future[None]] = []

    # -- methods for the thread that appends; called with the lock held ------------------------------

    def add(self, aims: Sequence[Aim], handed: Handed) -> None:
        """Append points after the end of the stream (`mark`)."""
        self._queue.extend(dataclasses.replace(aim, handed=handed) for aim in aims)
        self.mark = Mark(aims[-1].time, aims[-1].moment)

    def replace(self, since: float, curve: Sequence[Aim]) -> Future[float]:
        """Replace the points after the time `since`, or as soon as possible.

        If `curve` is empty, the stream ends at this time.
        """
        request = _Request(since, curve, Future())
        self._requests.append(request)
        if not self._life.is_cut:
            self._attend()
        return request.done

    def check(self, since: float, curve: Sequence[Aim]) -> None:
        """Raise the error that `replace` would raise now, assuming that the program has answered every cut.

        Raises:
            BadValue: If no path within the limits leads onto the points.
        """
        self._planned(_Request(since, curve, Future()))

    def reach(self, later: float) -> float:
        """Return the earliest time that can be replaced `later` seconds from now, in s on the clock of the stream."""
        if not self._life.is_open:
            return self._last.ends
        place = self._place(self.margin + later)
        if place is None:
            return self._end_of_sent.ends
        sent, t = place
        return sent.clock(t)

    def skip(self, time: float) -> None:
        """Set the clock of the stream forward to `time`, in s, if no points are left."""
        if not self._life.is_open and not self._queue and self.is_answered and self.mark is not None:
            self._last = dataclasses.replace(self._last, ends=max(time, self._last.ends))
            self.mark = Mark(self._last.ends, self.mark.moment)

    def forget(self, handed: Handed) -> None:
        """Drop the points of `handed` that have not yet been sent."""
        kept = [aim for aim in self._queue if aim.handed is not handed]
        if len(kept) < len(self._queue):
            self._queue = deque(kept)
            end = kept[-1] if kept else self._steps[-1].aim if self._steps else None
            if end is not None:
                self.mark = Mark(end.time, end.moment)
            elif self._steps:
                self.mark = Mark(self._steps[-1].ends, self._steps[-1].step.end)
            else:
                self.mark = Mark(self._last.ends, JointMoment.at_rest(self._brake.end.q))

    def answered(self) -> Future[None]:
        """Return a future that gets its result when the program has answered every cut."""
        self._answered.append(Future())
        future = self._answered[-1]
        self._settle()
        return future

    def dry(self) -> Future[None]:
        """Return a future that gets its result when the arm is at rest and no points are left."""
        self._dry.append(Future())
        future = self._dry[-1]
        self._settle()
        return future

    @property
    def is_answered(self) -> bool:
        """Whether the program has answered every cut, so that its buffered points are known."""
        return not (self._life.is_cut or self._requests)

    @property
    def is_dry(self) -> bool:
        """Whether the arm is at rest and no points are left."""
        if self._queue or not self.is_answered:
            return False
        if self._report.phase == OPEN:  # all points were dropped before the first point was sent
            return not self._steps
        return not self._life.is_open and self._report.phase == RESTING

    @property
    def time(self) -> float:
        """Time on the clock of the stream, in s."""
        if self.mark is None:
            return 0.0
        place = self._place(0.0)
        if place is None:
            # The arm is at rest, or has passed all points that were sent so far.
            return self._steps[-1].ends if self._steps and self._report.phase == MOVING else self._last.ends
        sent, t = place
        return sent.clock(t)

    @property
    def ahead(self) -> float:
        """Remaining duration of the steps that were sent and not yet passed, in s."""
        return max(self._steps[-1].until - self._here, 0.0) if self._steps else 0.0

    @property
    def _here(self) -> float:
        """Total duration of the steps up to the current position of the arm, in s."""
        return self._last.until + self._report.passed + self._passed - self._reported

    def end(self, error: Exception) -> None:
        """Set an error as the result of all futures, because nothing more will be sent."""
        with self._section:
            for aim in self._queue:
                if aim.handed is not None:
                    aim.handed.settle(error)
            waiting: list[Future[None] | Future[float]] = [self.begun, *self._answered, *self._dry]
            waiting += [request.done for request in self._requests]
            if self._cut is not None and self._cut.request is not None:
                waiting.append(self._cut.request.done)
            for future in waiting:
                if not future.done():
                    future.set_exception(error)

    # -- the dialogue ----------------------------------------------------------------------------------

    def body(self, link: Any) -> list[str]:
        self._is_lossy = isinstance(link, PointRegisters)
        return super().body(link)

    def resume(self, state: RealtimeState) -> None:
        """Continue after a pause with the next points.

        If the arm was moved during the pause, the motion continues from its position after braking.
        """
        with self._section:
            self._timer.restart()
            self._found = self._messages, JointMoment.at_rest(state.q_target)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        """Return the message that answers a state.

        Raises:
            LinkTimeout: If the arm does not come to rest in time before the first point.
            ToleranceExceeded: If no path leads from the position of the arm after braking to the points.
        """
        with self._section:
            seconds = self._timer.passed(state, now)[1]
            self._passed += self._program_pace.passed(self._report.phase, seconds)
            self._unseen = seconds if seconds > _GAP * self._cycle else 0.0
            self._messages += 1
            self._received += received
            while len(self._received) >= _REPORT.size:
                messages, epoch, head, base, passed, phase = _REPORT.unpack_from(self._received)
                self._received = self._received[_REPORT.size :]
                # In registers, the message number after the largest number is 1. The calculation assumes that the
                # program never reports a message that has not been sent.
                messages = self._messages - (self._messages - messages) % LARGEST
                self._take(_Report(messages, epoch, head, base, passed / SCALE, phase))
            if self.pace is not None:
                is_idle = not (self._steps or self._queue or self._life.is_cut)
                is_answered = (self._messages - self._last_answered) * self._cycle < _UNANSWERED
                is_led = self._report.phase == MOVING and is_answered
                rate = self._timer.rate
                self._program_pace.want(
                    self.pace.look(state.time, now, self.time, rate, is_led=is_led, is_idle=is_idle)
                )
            if self.mark is None:
                # The future is already done if another thread has ended the stream meanwhile.
                if not self.begun.done() and self._begin.is_reached(state, now):
                    self.mark = Mark(0.0, JointMoment.at_rest(state.q_target))
                    self._brake = Step.braking(self.mark.moment, self._bounds.limits)
                    self._last = _Sent(0, 0, self._brake, 0.0, 0.0, 0.0, None)
                    self._life.fire(FeedEvent.REST)
                    self.begun.set_result(None)
                return self._wait_message()
            for handed in {aim.handed for aim in self._queue if aim.handed is not None}:
                if handed.call is not None and handed.call.is_given_up:
                    self.forget(handed)
                    handed.settle(Cancelled("the task that appended these points was cancelled"))
            return self._next()

    def _wait_message(self) -> bytes:
        return _MESSAGE.pack(WAIT, 0, round(SCALE * self._program_pace.send()), *[0] * (MESSAGE - 3))

    def _next(self) -> bytes:
        while self._requests and not self._life.is_cut:
            self._attend()
        self._settle()
        if self._life.phase is FeedPhase.CLOSED and self._queue:
            self._resume()
        if self._cut is not None and (self._cut.message == 0 or self._is_lossy):
            # If messages may be lost, send the cut in every message until the program has answered it. So if the
            # program has read any later message, it has also read the cut.
            if self._cut.message == 0:
                self._cut = dataclasses.replace(self._cut, message=self._messages)
            return self._cut_message
        if self._life.is_open and self._queue and self._has_room and self._program_pace.has_room_for_a_point:
            self._program_pace.send_point()
            aim = self._queue.popleft()
            assert aim.step is not None
            before = self._end_of_sent
            self._head += 1
            # The step begins at the exact end of the previous step, because the program on the robot computes it in
            # this way.
            step = Step.to(before.step.end, aim.moment, aim.step.length, aim.degree)
            until = before.until + step.length
            self._steps.append(_Sent(self._head, self._messages, step, before.ends, aim.time, until, aim))
            if aim.handed is not None and not any(each.handed is aim.handed for each in self._queue):
                aim.handed.settle()
            return self._message(POINT, self._head, aim.step.length, aim.degree, aim.moment)
        return self._wait_message()

    @property
    def _end_of_sent(self) -> _Sent:
        """Newest step that was sent, or the last step that the arm has passed."""
        return self._steps[-1] if self._steps else self._last

    @property
    def _has_room(self) -> bool:
        return self._head - self._report.base < self._capacity - 1 and self.ahead < self._buffer

    def _message(self, what: int, number: int, length: float, degree: int, moment: JointMoment) -> bytes:
        numbers = [round(FINE * each) for each in moment.q.tolist()]
        numbers += [round(SCALE * each) for row in (moment.qd, moment.qdd) for each in row.tolist()]
        return _MESSAGE.pack(what, self._epoch, number, round(SCALE * length), degree, *numbers)

    # -- reports of the program ------------------------------------------------------------------------

    def _take(self, report: _Report) -> None:
        time, found = self.time, None
        has_moved = self._report.phase == report.phase == MOVING
        here = self._here if has_moved else 0.0
        if self._found is not None and report.messages > self._found[0]:
            if report.phase == RESTING:
                found = self._found[1]
            if found is not None or report.messages > self._found[0] + _RESUMING:
                self._found = None
        self._report, self._reported, self._last_answered = report, self._passed, self._messages
        cut = self._cut
        if cut is not None and 0 < cut.message <= report.messages:
            self._cut = None
            if report.epoch == cut.epoch:
                is_clearing = cut.request is not None and not cut.request.curve
                self._life.fire(FeedEvent.CLEAR if is_clearing else FeedEvent.ACCEPT)
                if cut.request is not None:
                    cut.request.done.set_result(cut.request.since)
            else:
                self._undo_cut(cut)
        while self._steps and self._steps[0].number <= report.base:
            self._last = self._steps.popleft()
        if has_moved and 0.0 < here - self._here <= self._unseen:
            self._reported -= here - self._here  # the program sent this report before this computer was delayed
        if self._life.is_cut or self.mark is None:
            return
        is_closed = report.phase in (RESTING, BRAKING)
        # While the arm moves, the program refuses a point if its message is too old. While the arm brakes, the program
        # refuses all points that arrive.
        refused = [
            sent for sent in self._steps if sent.number > report.head and (is_closed or sent.message <= report.messages)
        ]
        if refused:
            self._head = refused[0].number - 1
            again = [sent for sent in self._steps if sent.number > self._head]
            self._steps = deque(sent for sent in self._steps if sent.number <= self._head)
            self._queue.extendleft(sent.aim for sent in reversed(again) if sent.aim is not None)
        if is_closed and (self._life.is_open or found is not None):
            is_cleared = self._life.phase is FeedPhase.CLEARED
            self._life.fire(FeedEvent.CLOSE)
            if found is not None:
                self._last = dataclasses.replace(self._last, ends=time)
                # The controller has braked the arm along the path, so the points that the arm has passed are left out.
                self._may_skip = True
                assert self.mark is not None
                if not self._queue:  # the stream was cleared, or the arm has passed the last point
                    self.mark = Mark(time, found)
            self._brake = Step.braking(found or self._last.step.end, self._bounds.limits)
            if self._last.number == self._resumed and not is_cleared:
                # The arm had continued from braking, but the points after the cut came too late. The arm is still in
                # the same braking, so it is not counted again.
                self._reach_later()
            elif self._brake.length > self._cycle and not is_cleared:
                self.starved += 1

    def _undo_cut(self, cut: _Cut) -> None:
        """Restore the state before a cut that came too late."""
        self._life.fire(FeedEvent.REFUSE)
        self._reach_later()
        new = [sent.aim for sent in self._steps if sent.number > cut.head and sent.aim is not None]
        self._head, self._steps = cut.head, deque(cut.steps)
        if cut.request is not None:
            self._queue, self.mark = deque(cut.queue), cut.mark
            self._requests.appendleft(cut.request)
        else:
            self._queue.extendleft(reversed([aim for aim in new if aim not in self._queue]))

    def _reach_later(self) -> None:
        """Plan future cuts further ahead."""
        self.margin = min(2.0 * self.margin, _LONGEST_WAY)

    def _settle(self) -> None:
        for waiting, is_so in ((self._answered, self.is_answered), (self._dry, self.is_dry)):
            if is_so:
                for future in waiting:
                    if not future.done():
                        future.set_result(None)
                waiting.clear()

    # -- planning --------------------------------------------------------------------------------------

    def _place(self, later: float) -> tuple[_Sent, float] | None:
        """Return the step that the arm will execute `later` seconds from now, and the time since this step began.

        Return None if this step is unknown.
        """
        left = self._report.passed + self._passed - self._reported + later
        if self._report.phase not in (MOVING, OPEN):
            return None
        if self._report.phase == OPEN:
            left = later
        for sent in self._steps:
            if left < sent.step.length:
                return sent, left
            left -= sent.step.length
        return None

    def _open(self, number: int, length: float, degree: int, moment: JointMoment, cut: _Cut) -> None:
        """Open an epoch with a cut. The next message contains this cut."""
        self._epoch += 1
        self._cut = dataclasses.replace(cut, epoch=self._epoch)
        self._cut_message = self._message(CUT, number, length, degree, moment)
        self._head = number + 1
        self._life.fire(FeedEvent.RESUME if cut.request is None else FeedEvent.REPLACE)

    def _kept(self, request: _Request | None) -> _Cut:
        assert self.mark is not None
        return _Cut(0, 0, self._head, tuple(self._steps), tuple(self._queue), self.mark, request)

    def _resume(self) -> None:
        """Continue from braking or from rest to the queued points."""
        report, time = self._report, self._last.ends
        if report.phase == RESTING:
            t, here = 0.0, JointMoment.at_rest(self._brake.end.q)
        else:
            t = report.passed + self._passed - self._reported + self.margin
            if t > self._brake.length - self._cycle:
                return  # the arm will be at rest before a cut can reach the program
            here = self._brake.at(t)
        shortest = 2.0 * self._cycle
        if self._may_skip:
            for first, aim in enumerate(self._queue):
                span = aim.time - time
                if span >= shortest and self._bounds.first_within([Step.to(here, aim.moment, span, 5)]) is not None:
                    self._queue = deque(list(self._queue)[first:])
                    break
            self._may_skip = False
        aim = self._queue[0]
        if aim.step is None or not aim.step.begins_in(here):
            # If the accelerations of the points have jumps, or exceed the limits of the stream, the path ends with zero
            # acceleration.
            least, still = max(aim.time - time, shortest), dataclasses.replace(aim.moment, qdd=np.zeros(6))
            landings = [aim.moment, still] if aim.degree == 5 else [still]
            ways = ((self._bounds.way(here, landing, least), landing) for landing in landings)
            way, landing = next((each for each in ways if each[0] is not None), (None, still))
            if way is None:
                raise ToleranceExceeded(
                    "no path within the limits leads from the arm's position after braking to the point at "
                    f"{aim.time:g} s"
                )
            self._queue[0] = dataclasses.replace(aim, step=way, moment=landing)
        kept = self._kept(None)
        self._open(report.base, t, 5, here, kept)
        step = self._brake.cut(t)
        self._resumed = self._head
        self._steps.append(_Sent(self._head, 0, step, time, time, self._last.until + t, None))

    def _attend(self) -> None:
        """Process the first request."""
        request = self._requests.popleft()
        try:
            self._planned(request)()
        except BadValue as error:
            request.done.set_exception(error)

    def _planned(self, request: _Request) -> Callable[[], None]:
        """Return a function that replaces or removes points as requested.

        Nothing changes before this function is called.

        Raises:
            BadValue: If no path within the limits leads onto the points.
        """
        now = self._place(self.margin)
        if not self._life.is_open:
            return self._planned_at_rest(request)
        if now is None or request.since >= self._end_of_sent.ends:
            return self._planned_unsent(request)
        return self._planned_sent(request, *now)

    def _planned_at_rest(self, request: _Request) -> Callable[[], None]:
        time = self._last.ends
        aims = [aim for aim in request.curve if aim.time > max(request.since, time)]
        if request.curve and not aims:
            raise BadValue(
                f"all points are in the past: the last is at {request.curve[-1].time:g} s, but the stream is at "
                f"{time:g} s"
            )

        def replace() -> None:
            self._put(aims)
            if aims:
                self._may_skip = True
            else:
                self.mark = Mark(time, JointMoment.at_rest(self._brake.end.q))
            request.done.set_result(time)

        return replace

    def _planned_unsent(self, request: _Request) -> Callable[[], None]:
        """Plan a change that keeps all sent points.

        It is used if the arm is too close to the end of the sent points, or if the change should begin after them.
        """
        end = self._end_of_sent
        assert self.mark is not None
        since = min(max(request.since, end.ends), self.mark.time)
        kept: list[Aim] = []
        begin, time = end.step.end, end.ends
        for aim in self._queue:
            if aim.time <= since:
                kept.append(aim)
                begin, time = aim.moment, aim.time
            else:
                assert aim.step is not None
                t = aim.step.length - (aim.time - since)
                if t > 0.5 * self._cycle:
                    begin, time = aim.step.at(t), since
                    step = aim.step.cut(t)
                    kept.append(Aim(since, begin, step, aim.handed))
                break
        aims = self._onto(request, begin, time)

        def replace() -> None:
            self._put([*kept, *aims])
            if not aims:
                self._life.fire(FeedEvent.CLEAR)
                self.mark = Mark(time, self._bounds.braked(begin))
            request.done.set_result(time)

        return replace

    def _planned_sent(self, request: _Request, place: _Sent, t: float) -> Callable[[], None]:
        time = place.clock(t)
        if request.since > time:
            time = request.since
            place = next(sent for sent in self._steps if sent.ends > time)
            t = place.step.length * (time - place.begins) / (place.ends - place.begins)
        # The step must not have zero length, because no polynomial can be calculated for it.
        t = max(t, 0.5 * self._cycle)
        here = place.step.at(t)
        aims = self._onto(request, here, time)

        def replace() -> None:
            kept = self._kept(dataclasses.replace(request, since=time))
            self._put(aims)
            step = place.step.cut(t)
            self._open(place.number - 1, t, step.degree, here, kept)
            while self._steps and self._steps[-1].number >= place.number:
                self._steps.pop()
            until = place.until - place.step.length + t
            self._steps.append(_Sent(place.number, 0, step, place.begins, time, until, None))
            if not aims:
                self.mark = Mark(time, self._bounds.braked(here))

        return replace

    def _onto(self, request: _Request, here: JointMoment, time: float) -> list[Aim]:
        return onto(self._bounds, request.curve, here, time, 2.0 * self._cycle) if request.curve else []

    def _put(self, aims: Sequence[Aim]) -> None:
        """Use these points instead of all points that have not yet been sent."""
        left = {id(aim.handed) for aim in aims}
        for aim in self._queue:
            if aim.handed is not None and id(aim.handed) not in left:
                aim.handed.settle(Cancelled("the points were replaced or cleared before the robot had room for them"))
        self._queue = deque(aims)
        if aims:
            self.mark = Mark(aims[-1].time, aims[-1].moment)
