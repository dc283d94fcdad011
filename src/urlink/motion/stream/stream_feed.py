"""The dialogue with the buffering program (`urlink.script.buffering`): points that are sent, and its position.

There are two curves. That of the points begins where the arm rests, and each point is reached at its own time. The
arm is on it, but where the points came too late, or were replaced: then a path leads from where it is to a moment of
that curve, and takes the time that it needs. The clock of the stream shows the time on the curve of the points; it
stands while the arm brakes and rests for want of points.

A cut can come too late, and points can come after the braking has begun: the program refuses them, and reports it. Then
what was refused is planned again, from where the arm is by then.
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
from ..links.messages import LARGEST
from ..servo.following import Rest
from ..servo.setpoints import LinkDialogue
from .common_time import MemberPace
from .feed_life import FeedEvent, FeedLife, FeedPhase
from .program_pace import ProgramPace
from .stream_steps import Aim, Bounds, Handed, JointMoment, Mark, Step, onto

_MESSAGE, _REPORT = struct.Struct(f">{MESSAGE}i"), struct.Struct(f">{REPORTED}i")
_STOP_MESSAGE = _MESSAGE.pack(STOP, *[0] * (MESSAGE - 1))
#: s without a report after which a program counts as one that goes through no points, for others. Chosen: five reports.
_UNANSWERED = 0.1
#: Cycles without a state, from which on a report may be older than the state that comes next.
_GAP = 2
#: Cycles, and s, that a cut takes to the program at first, and s at most: each that comes too late doubles the time.
_AHEAD, _WAY, _LONGEST_WAY = 6, 0.01, 1.0
#: Messages within which a program has found out where the arm is, after a pause in which it was slow at first.
_RESUMING = 50


@dataclasses.dataclass(frozen=True)
class _Sent:
    """A step that the program holds, or is being sent.

    Attributes:
        number: of the point at its end.
        message: number of the message that it came with.
        begins, ends: on the clock of the stream, s.
        until: s of all steps up to its end.
        aim: what it leads to; None for the beginning of a step that was cut.
    """

    number: int
    message: int
    step: Step
    begins: float
    ends: float
    until: float
    aim: Aim | None

    def clock(self, t: float) -> float:
        """`t` s after it began, on the clock of the stream, s."""
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
    """A replacement of the tail, or its removal.

    Attributes:
        since: on the clock of the stream, s.
        curve: the points, each with the step from the one before; none to remove the tail.
        done: resolved to the time from which it holds.
    """

    since: float
    curve: Sequence[Aim]
    done: Future[float]


@dataclasses.dataclass(frozen=True)
class _Cut:
    """A cut that the program has not answered: its message and epoch, and what holds again if it is refused."""

    message: int
    epoch: int
    head: int
    steps: tuple[_Sent, ...]
    queue: tuple[Aim, ...]
    mark: Mark
    request: _Request | None


class StreamFeed(LinkDialogue):
    """Sends points to the program, as many as it is to hold.

    Args:
        write: makes the lines of the program.
        section: of the robot: points and states come in different threads.
        bounds: what may be asked of the arm.
        cycle: s of the controller's cycle.
        capacity: points that the program holds.
        buffer: s that it is to hold.

    Attributes:
        pace: of the streams of several arms; None for one by itself.
        begun: resolved once the arm rests, so that points can be appended.
        starved: how often the arm had to brake because no points were left.
        margin: s before which the program cannot be reached.
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
        #: s on the steps since the first state, as far as states show it, and at the last report
        self._passed = self._reported = 0.0
        #: s of which no state came, before the newest; from the first one on
        self._unseen: float
        self._report = _Report(0, 0, 0, 0, 0.0, RESTING)
        #: the steps from the present one on that were sent
        self._steps: deque[_Sent] = deque()
        #: the end of the step before these; while the epoch is closed, the braking from there
        self._last: _Sent
        self._brake: Step
        #: number of the step with which it went on from braking, of what was left of that; -1 before
        self._resumed = -1
        self._queue: deque[Aim] = deque()
        #: while a cut has no answer
        self._cut: _Cut | None = None
        #: those that wait for the answer to the cut
        self._requests: deque[_Request] = deque()
        self._may_skip = False
        #: after a pause: the messages before it, and where the arm stood
        self._found: tuple[int, JointMoment] | None = None
        self._answered: list[Future[None]] = []
        self._dry: list[Future[None]] = []

    # -- for the one who appends; in the section -----------------------------------------------------

    def add(self, aims: Sequence[Aim], handed: Handed) -> None:
        """Append points, whose steps begin at the mark."""
        self._queue.extend(dataclasses.replace(aim, handed=handed) for aim in aims)
        self.mark = Mark(aims[-1].time, aims[-1].moment)

    def replace(self, since: float, curve: Sequence[Aim]) -> Future[float]:
        """Replace what comes after a time, or as soon as possible after it; without points, end there."""
        request = _Request(since, curve, Future())
        self._requests.append(request)
        if not self._life.is_cut:
            self._attend()
        return request.done

    def check(self, since: float, curve: Sequence[Aim]) -> None:
        """Raise what `replace` would now, if the program has answered every cut.

        Raises:
            BadValue: no way within the limits leads onto the points.
        """
        self._planned(_Request(since, curve, Future()))

    def reach(self, later: float) -> float:
        """s on the clock of the stream from which points can be replaced, `later` s from now."""
        if not self._life.is_open:
            return self._last.ends
        place = self._place(self.margin + later)
        if place is None:
            return self._end_of_sent.ends
        sent, t = place
        return sent.clock(t)

    def skip(self, time: float) -> None:
        """Where no points are left, set the clock of the stream forward to `time`, s."""
        if not self._life.is_open and not self._queue and self.is_answered and self.mark is not None:
            self._last = dataclasses.replace(self._last, ends=max(time, self._last.ends))
            self.mark = Mark(self._last.ends, self.mark.moment)

    def forget(self, handed: Handed) -> None:
        """Drop those of these points that were not sent."""
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
        """Resolved once the program has answered every cut."""
        self._answered.append(Future())
        future = self._answered[-1]
        self._settle()
        return future

    def dry(self) -> Future[None]:
        """Resolved once the arm rests and no point is left."""
        self._dry.append(Future())
        future = self._dry[-1]
        self._settle()
        return future

    @property
    def is_answered(self) -> bool:
        """Whether the program has answered every cut, so that it is known which points it holds."""
        return not (self._life.is_cut or self._requests)

    @property
    def is_dry(self) -> bool:
        """Whether the arm rests and no point is left."""
        if self._queue or not self.is_answered:
            return False
        if self._report.phase == OPEN:  # its points were dropped before the first of them was sent
            return not self._steps
        return not self._life.is_open and self._report.phase == RESTING

    @property
    def time(self) -> float:
        """On the clock of the stream, s."""
        if self.mark is None:
            return 0.0
        place = self._place(0.0)
        if place is None:
            # It stands, or is led beyond what was sent by now.
            return self._steps[-1].ends if self._steps and self._report.phase == MOVING else self._last.ends
        sent, t = place
        return sent.clock(t)

    @property
    def ahead(self) -> float:
        """s of the steps that were sent and not passed."""
        return max(self._steps[-1].until - self._here, 0.0) if self._steps else 0.0

    @property
    def _here(self) -> float:
        """s of all steps that were passed."""
        return self._last.until + self._report.passed + self._passed - self._reported

    def end(self, error: Exception) -> None:
        """Nothing is sent any more."""
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
        """Go on after a pause: with the points, or where the arm has braked to, if the program finds it elsewhere."""
        with self._section:
            self._timer.restart()
            self._found = self._messages, JointMoment.at_rest(state.q_target)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        """The message that answers a state.

        Raises:
            LinkTimeout: the arm does not come to rest before the first point.
            ToleranceExceeded: no path leads onto the points from where the arm has braked to.
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
                # In registers they begin at 1 again after the largest; the program is never ahead of this computer.
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
                # Done where another thread has ended it since this one began to look.
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
                    handed.settle(Cancelled("the task that appended these points has given them up"))
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
            # Again until it is answered, where messages may be lost: so what sees a later message has seen a cut.
            if self._cut.message == 0:
                self._cut = dataclasses.replace(self._cut, message=self._messages)
            return self._cut_message
        if self._life.is_open and self._queue and self._has_room and self._program_pace.has_room_for_a_point:
            self._program_pace.send_point()
            aim = self._queue.popleft()
            assert aim.step is not None
            before = self._end_of_sent
            self._head += 1
            # From where the step before ends, as the program does it.
            step = Step.to(before.step.end, aim.moment, aim.step.length, aim.degree)
            until = before.until + step.length
            self._steps.append(_Sent(self._head, self._messages, step, before.ends, aim.time, until, aim))
            if aim.handed is not None and not any(each.handed is aim.handed for each in self._queue):
                aim.handed.settle()
            return self._message(POINT, self._head, aim.step.length, aim.degree, aim.moment)
        return self._wait_message()

    @property
    def _end_of_sent(self) -> _Sent:
        """The newest step that was sent, or the one that the arm has behind it."""
        return self._steps[-1] if self._steps else self._last

    @property
    def _has_room(self) -> bool:
        return self._head - self._report.base < self._capacity - 1 and self.ahead < self._buffer

    def _message(self, what: int, number: int, length: float, degree: int, moment: JointMoment) -> bytes:
        numbers = [round(FINE * each) for each in moment.q.tolist()]
        numbers += [round(SCALE * each) for row in (moment.qd, moment.qdd) for each in row.tolist()]
        return _MESSAGE.pack(what, self._epoch, number, round(SCALE * length), degree, *numbers)

    # -- what the program reports ----------------------------------------------------------------------

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
            self._reported -= here - self._here  # it is from before this computer stood still
        if self._life.is_cut or self.mark is None:
            return
        is_closed = report.phase in (RESTING, BRAKING)
        # While it moves, a point is refused if its message was too old; once it brakes, all that were on their way are.
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
                # The controller has braked it along its path: what is behind it is left out.
                self._may_skip = True
                assert self.mark is not None
                if not self._queue:  # it was cleared, or is past its last point
                    self.mark = Mark(time, found)
            self._brake = Step.braking(found or self._last.step.end, self._bounds.limits)
            if self._last.number == self._resumed and not is_cleared:
                # It had gone on from braking, and its points came too late after the cut: it is the same braking.
                self._reach_later()
            elif self._brake.length > self._cycle and not is_cleared:
                self.starved += 1

    def _undo_cut(self, cut: _Cut) -> None:
        """The cut came too late."""
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
        """Plan cuts further ahead from now on."""
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
        """The step in which the arm is `later` s from now, if all goes well, and the time since it began."""
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
        """Open an epoch with a cut, which is sent with the next message."""
        self._epoch += 1
        self._cut = dataclasses.replace(cut, epoch=self._epoch)
        self._cut_message = self._message(CUT, number, length, degree, moment)
        self._head = number + 1
        self._life.fire(FeedEvent.RESUME if cut.request is None else FeedEvent.REPLACE)

    def _kept(self, request: _Request | None) -> _Cut:
        assert self.mark is not None
        return _Cut(0, 0, self._head, tuple(self._steps), tuple(self._queue), self.mark, request)

    def _resume(self) -> None:
        """Go on from the braking, or from rest, onto the points that wait."""
        report, time = self._report, self._last.ends
        if report.phase == RESTING:
            t, here = 0.0, JointMoment.at_rest(self._brake.end.q)
        else:
            t = report.passed + self._passed - self._reported + self.margin
            if t > self._brake.length - self._cycle:
                return  # it rests before a cut could reach it
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
            # Where the points let accelerations leap, or ask for more than the stream may, it lands without one.
            least, still = max(aim.time - time, shortest), dataclasses.replace(aim.moment, qdd=np.zeros(6))
            landings = [aim.moment, still] if aim.degree == 5 else [still]
            ways = ((self._bounds.way(here, landing, least), landing) for landing in landings)
            way, landing = next((each for each in ways if each[0] is not None), (None, still))
            if way is None:
                raise ToleranceExceeded(
                    f"no way within the limits leads from where the arm has braked to onto the point at {aim.time:g} s"
                )
            self._queue[0] = dataclasses.replace(aim, step=way, moment=landing)
        kept = self._kept(None)
        self._open(report.base, t, 5, here, kept)
        step = self._brake.cut(t)
        self._resumed = self._head
        self._steps.append(_Sent(self._head, 0, step, time, time, self._last.until + t, None))

    def _attend(self) -> None:
        """Begin with the first request."""
        request = self._requests.popleft()
        try:
            self._planned(request)()
        except BadValue as error:
            request.done.set_exception(error)

    def _planned(self, request: _Request) -> Callable[[], None]:
        """What replaces the tail, or cuts it off; nothing changes before it is called.

        Raises:
            BadValue: no path within the limits leads onto the points.
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
                f"all points are past: the last is at {request.curve[-1].time:g} s, and the stream at {time:g} s"
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
        """What was sent stays; the arm is too near to its end, or the replacement is to begin later."""
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
        # A step of no length has no polynomial.
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
        """These, in place of all that were not sent."""
        left = {id(aim.handed) for aim in aims}
        for aim in self._queue:
            if aim.handed is not None and id(aim.handed) not in left:
                aim.handed.settle(Cancelled("the points were replaced or cleared before the robot had room for them"))
        self._queue = deque(aims)
        if aims:
            self.mark = Mark(aims[-1].time, aims[-1].moment)
