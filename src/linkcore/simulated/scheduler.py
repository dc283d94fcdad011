"""Real threads, run one at a time on a clock of their own, in an order that a seed decides.

A thread that takes part is a `Task`. It runs until it waits, or until it passes a lock, a queue or a socket at a moment
that the seed has drawn; then it hands over to the next one. When all wait, the clock jumps to the earliest deadline. So
the same program with the same seed takes the same steps, however fast or busy the computer is, and an hour in which
nothing happens costs nothing.

Threads change between two lines of a program only where that was asked for (`preemption`), and never between two steps
of one line, or within a function of C.
"""

from __future__ import annotations

import heapq
import random
import sys
import traceback
import zlib
from _thread import LockType, allocate_lock, get_ident
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from struct import Struct
from types import FrameType
from typing import Any, Protocol

#: As `sys.settrace` takes it.
Tracer = Callable[[FrameType, str, Any], Any]

#: Seconds that each step costs. Without it a program that looks at the clock until it is late enough would not end.
STEP = 1e-7
#: Bounds of the mean number of steps after which a running task has to yield for another one; the seed draws the
#: mean once, so that some runs change threads at nearly every step and others hardly ever.
SWITCHES = (2.0, 500.0)
#: Real seconds that a thread has to end in when the simulation ends, and how often it may catch `Ended`.
_TO_END = 5.0
_ENDINGS = 100
#: What the trace has of each choice: the number of the task, and the time.
_CHOICE = Struct("<Id")
_NEVER = float("inf")


class Deadlock(Exception):
    """Every thread waits for another one, without a deadline. The message has all their stacks."""


class TimeLimit(Exception):
    """The simulated time has passed the limit that was set for it."""


class Ended(SystemExit):
    """Raised in a task that still waits when the simulation ends, so that its thread ends too."""


class TaskComputer(Protocol):
    """The computer that a task runs on: `linkcore.simulated.network.Computer`, as the scheduler uses it."""

    rate: float
    offset: float
    jumped: float
    is_running: bool
    starts_threads: bool
    held: list[Task]


@dataclass(eq=False, slots=True)
class Task:
    """A thread that takes part."""

    name: str
    number: int
    computer: TaskComputer
    #: held while it does not run
    baton: LockType = field(default_factory=allocate_lock)
    ident: int = 0
    is_ready: bool = False
    is_over: bool = False
    #: until when it waits; None without a limit, and while it does not wait
    deadline: float | None = None
    #: when the scheduler looks at its deadline next: most waits end before, and leave nothing to be looked at then
    alarm: float = _NEVER
    #: whether the deadline came first
    is_late: bool = False
    #: where who is to make it ready finds it
    waiters: deque[Task] | None = None
    #: raised when it runs next
    error: BaseException | None = None
    #: how often it has gone on after `Ended`
    endings: int = 0
    joiners: deque[Task] = field(default_factory=deque)
    #: what its lines are traced by for the scheduler, and what they were before
    tracer: Tracer | None = None
    before: Any = None

    def __post_init__(self) -> None:
        self.baton.acquire()


class Scheduler:
    """Runs tasks one at a time.

    Args:
        seed: decides who runs when.
        limit: seconds of simulated time after which the first task gets `TimeLimit`.

    Attributes:
        now: seconds since the beginning.
        trace: checksum of every step that was decided so far.
        steps: how often the tasks passed the seam.
        numbered: how many threads and tasks of asyncio were made.
    """

    def __init__(self, seed: int, limit: float) -> None:
        self.random = random.Random(seed)
        self.now = 0.0
        self.trace = 0
        self.steps = 0
        self.numbered = 0
        self.limit = limit
        self.is_ending = False
        self.tasks: list[Task] = []
        self._ready: list[Task] = []
        # When, a number that keeps what is due together in order, and what to do: a call, or the task of an alarm.
        self._due: list[tuple[float, int, Callable[[], object] | None, Task | None]] = []
        self._numbers = 0
        low, high = SWITCHES
        self._mean = low * (high / low) ** self.random.random()
        self._left = self._draw()
        # Whether what is called is due, rather than a step of the running task.
        self._is_choosing = False
        # Released by a thread that `end` has ended.
        self._ended = allocate_lock()
        self.running: Task  # since `adopt`
        #: of the thread that runs
        self.ident = 0
        self._tracer: Tracer | None = None

    # -- tasks -----------------------------------------------------------------------------------------

    def adopt(self, name: str, computer: TaskComputer) -> Task:
        """Make the calling thread the first task. It runs."""
        task = self.spawn(name, computer, is_ready=False)
        task.ident = self.ident = get_ident()
        self.running = task
        return task

    def spawn(self, name: str, computer: TaskComputer, *, is_ready: bool = True) -> Task:
        """A task whose thread waits for its baton."""
        task = Task(name, len(self.tasks), computer)
        self.tasks.append(task)
        if is_ready:
            self.make_ready(task)
        return task

    def begin(self, task: Task) -> None:
        """The first thing that the thread of a task does: wait until it is to run."""
        task.baton.acquire()
        task.ident = self.ident = get_ident()
        if self.is_ending:
            raise Ended
        if self._tracer is not None:
            self._follow(task)

    def finish(self, task: Task) -> None:
        """The last thing that the thread of a task does."""
        task.is_over = True
        for joiner in task.joiners:
            self.make_ready(joiner)
        task.joiners.clear()
        if self.is_ending:
            self._ended.release()
        else:
            self._hand_over(self._next())

    # -- what a running task does ------------------------------------------------------------------------

    def step(self) -> None:
        """Pass the seam: time goes on by a little, and another task may be let in."""
        self.now += STEP
        self.steps += 1
        self._left -= 1
        if self._left <= 0:
            self._left = self._draw()
            if not self.is_ending:
                self.yield_()

    def yield_(self) -> None:
        """Let the others run, if there are any that can."""
        task = self.running
        due = self._due
        if not self._ready and task.computer.is_running and not (due and due[0][0] <= self.now) and self._is_same(task):
            # No other task can run, so the task continues without a change of threads.
            self.trace = zlib.crc32(_CHOICE.pack(task.number, self.now), self.trace)
            return
        self.make_ready(task)
        self._change(task)

    def _is_same(self, task: Task) -> bool:
        """Whether a task that continues has nothing to do first: no error, no other tracer, no end."""
        return task.error is None and task.tracer is self._tracer and not self.is_ending and not task.is_ready

    def wait(self, deadline: float | None, waiters: deque[Task] | None = None) -> bool:
        """Wait until somebody makes this task ready; False if the deadline came first.

        Args:
            deadline: simulated time; None for none.
            waiters: where the task is found by who is to make it ready; it is taken out at the deadline.
        """
        task = self.running
        task.is_late = False
        task.deadline = deadline
        task.waiters = waiters
        if waiters is not None:
            waiters.append(task)
        if deadline is not None and deadline < task.alarm:
            self._set_alarm(task, deadline)
        self._change(task)
        task.deadline = None
        return not task.is_late

    def deadline(self, seconds: float | None) -> float | None:
        """When so many seconds of the running task's computer are over."""
        if seconds is None:
            return None
        return self.now + max(seconds, 0.0) / self.running.computer.rate

    # -- what anybody does while a task runs -------------------------------------------------------------

    def make_ready(self, task: Task) -> None:
        """Have a task run when it is its turn."""
        if task.is_ready or task.is_over:
            return
        task.is_ready = True
        (self._ready if task.computer.is_running else task.computer.held).append(task)

    def wake_one(self, waiters: deque[Task]) -> None:
        """Make one of those that wait ready, which the seed chooses."""
        if waiters:
            number = 0 if len(waiters) == 1 else int(self.random.random() * len(waiters))
            task = waiters[number]
            del waiters[number]
            self.make_ready(task)

    def call_at(self, when: float, call: Callable[[], object]) -> None:
        """Call something at a simulated time, between two steps of the tasks. It must not wait."""
        self._numbers += 1
        heapq.heappush(self._due, (when, self._numbers, call, None))

    def note(self, data: bytes) -> None:
        """Add what has happened to the trace."""
        self.trace = zlib.crc32(data, self.trace)

    def suspend(self, computer: TaskComputer) -> None:
        """No task of it runs until `resume`."""
        computer.is_running = False
        computer.held += [task for task in self._ready if task.computer is computer]
        self._ready[:] = [task for task in self._ready if task.computer is not computer]
        if not self._is_choosing and self.running.computer is computer:
            self.yield_()

    def resume(self, computer: TaskComputer) -> None:
        """Its tasks run again."""
        computer.is_running = True
        self._ready += computer.held
        computer.held.clear()

    def end(self) -> None:
        """End every other task, one after the other: who waits gets `Ended`."""
        self.trace_lines(None)
        self.is_ending = True
        mine = get_ident()
        for task in self.tasks:
            if not task.is_over and task.ident != mine:
                self.running, self.ident = task, task.ident
                self._ended.acquire(blocking=False)
                task.baton.release()
                self._ended.acquire(timeout=_TO_END)
        self.ident = mine

    # -- lines -----------------------------------------------------------------------------------------

    @property
    def is_between_lines(self) -> bool:
        """The calling thread is the task that runs, and no call that is due: it may wait."""
        return self.ident == get_ident() and not self._is_choosing and not self.is_ending

    def trace_lines(self, tracer: Tracer | None) -> None:
        """Have the lines of all tasks traced from now on; None ends that, and puts back what there was before."""
        self._tracer = tracer
        if self.is_between_lines:
            self._follow(self.running)

    def _follow(self, task: Task) -> None:
        """Have the lines of the calling thread traced as those of the others are."""
        if task.tracer is None:
            task.before = sys.gettrace()
        tracer = self._tracer
        task.tracer = tracer
        sys.settrace(task.before if tracer is None else tracer)
        frame = None if tracer is None else sys._getframe()
        while tracer is not None and frame is not None:
            if frame.f_trace is None:
                frame.f_trace = tracer(frame, "call", None)
            frame = frame.f_back

    # -- inside ----------------------------------------------------------------------------------------

    def _draw(self) -> int:
        return 1 + int(self.random.expovariate(1.0 / self._mean))

    def _change(self, task: Task) -> None:
        """Hand over from the running task, and return when it runs again."""
        if not self.is_ending:
            chosen = self._next()
            if chosen is not task:
                self._hand_over(chosen)
                self._take(task)
        if self.is_ending:
            task.endings += 1
            if task.endings > _ENDINGS:  # it goes on whatever is raised: leave it here
                self._ended.release()
                allocate_lock().acquire()
                task.baton.acquire()
            raise Ended
        if task.tracer is not self._tracer:
            self._follow(task)
        if task.error is not None:
            error, task.error = task.error, None
            raise error

    def _take(self, task: Task) -> None:
        """Wait for the baton. Ctrl-C meanwhile is raised when it has come."""
        while True:
            try:
                task.baton.acquire()
            except KeyboardInterrupt as error:
                task.error = error
                self.make_ready(task)
            else:
                break
        self.ident = task.ident

    def _hand_over(self, task: Task) -> None:
        self.running = task
        self.ident = task.ident
        task.baton.release()

    def _set_alarm(self, task: Task, when: float) -> None:
        task.alarm = when
        self._numbers += 1
        heapq.heappush(self._due, (when, self._numbers, None, task))

    def _ring(self, task: Task) -> None:
        """The alarm of a task: its deadline is over, or that of a later wait is still to come, or it does not wait."""
        task.alarm = _NEVER
        deadline = task.deadline
        if deadline is None or task.is_ready or task.is_over:
            return
        if deadline > self.now:
            self._set_alarm(task, deadline)
        else:
            task.is_late = True
            if task.waiters is not None:
                task.waiters.remove(task)
            self.make_ready(task)

    def _next(self) -> Task:
        """The task that runs next. Time goes on until there is one."""
        due, ready = self._due, self._ready
        while True:
            while due and due[0][0] <= self.now:
                when, _, call, task = heapq.heappop(due)
                if call is not None:
                    self._is_choosing = True
                    call()
                    self._is_choosing = False
                elif task is not None and task.alarm == when:
                    self._ring(task)
            if ready:
                if len(ready) == 1:
                    task = ready.pop()
                else:
                    number = int(self.random.random() * len(ready))
                    task = ready[number]
                    ready[number] = ready[-1]
                    ready.pop()
                task.is_ready = False
                self.trace = zlib.crc32(_CHOICE.pack(task.number, self.now), self.trace)
                return task
            first = self.tasks[0]
            if not due:
                self._interrupt(first, Deadlock(f"at {self.now:.6f} s every thread waits\n{self.stacks()}"))
            elif due[0][0] > self.limit:
                error = TimeLimit(f"{self.limit:g} s of simulated time are over\n{self.stacks()}")
                self.limit = _NEVER
                self._interrupt(first, error)
            else:
                self.now = due[0][0]

    def _interrupt(self, task: Task, error: BaseException) -> None:
        task.error = error
        task.computer.is_running = True
        task.is_ready = False
        self.make_ready(task)

    def stacks(self) -> str:
        """What every task is doing."""
        frames = sys._current_frames()
        text = []
        for task in self.tasks:
            if not task.is_over and task.ident in frames:
                text.append(f"-- {task.name}\n{''.join(traceback.format_stack(frames[task.ident]))}")
        return "\n".join(text)


#: The scheduler of the simulation that goes on, in a list of one.
_current: list[Scheduler | None] = [None]


def current() -> Scheduler | None:
    """The scheduler, if the calling thread is the task that runs."""
    scheduler = _current[0]
    return scheduler if scheduler is not None and scheduler.ident == get_ident() else None


def install(scheduler: Scheduler | None) -> None:
    """Make this the scheduler of the process."""
    _current[0] = scheduler
