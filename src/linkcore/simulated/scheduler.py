"""Scheduler that runs real threads one at a time on a simulated clock. A seed determines their order.

Each thread of the simulation is a `Task`. A task runs until it waits, or until it uses a lock, a queue or a socket at a
moment that the seed has selected. Then the next task runs. When all tasks wait, the clock jumps to the earliest
deadline. So the same program with the same seed takes the same steps, even on a slower or busier computer. A simulated
hour in which nothing happens takes no real time.

Threads switch between two lines of a program only on request (`preemption`). They never switch between two steps of one
line, or within a function in C.
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
from typing import Any, Protocol, TypeVar

from .processor import Processor

T = TypeVar("T")

#: Trace function for `sys.settrace`.
Tracer = Callable[[FrameType, str, Any], Any]

#: Simulated time that each step costs, in s. Without this cost, a program that reads the clock in a loop until a time
#: is reached would not end.
STEP = 1e-7
#: Minimum and maximum of the mean number of steps after which a running task must yield to another task. The seed
#: selects the mean once per run. So threads are switched at nearly every step in some runs, and rarely in other runs.
SWITCHES = (2.0, 500.0)
#: Real time, in s, in which a thread must end after the simulation, and maximum number of times that it may catch
#: `Ended`.
_TO_END = 5.0
_ENDINGS = 100
#: Record of each choice in the trace: number of the task, and time.
_CHOICE = Struct("<Id")
_NEVER = float("inf")


class Deadlock(Exception):
    """Error: every thread waits for another thread, without a deadline. The message shows all stacks."""


class TimeLimit(Exception):
    """Error: the simulated time has exceeded its limit."""


class Ended(SystemExit):
    """Exception that is raised in a task which still waits when the simulation ends, so that its thread ends too."""


class TaskComputer(Protocol):
    """Computer of a task: `linkcore.simulated.network.Computer`, as the scheduler uses it."""

    rate: float
    offset: float
    jumped: float
    is_running: bool
    starts_threads: bool
    held: list[Task]


@dataclass(frozen=True, slots=True)
class Check:
    """Call of `call_at` that does nothing except in rare cases.

    Attributes:
        look: Function that is called. It has no effect on anything else unless `is_needed` returns True.
        is_needed: Function that returns whether the call has work to do.
    """

    look: Callable[[], object]
    is_needed: Callable[[], bool]

    def __call__(self) -> object:
        return self.look()


@dataclass(eq=False, slots=True)
class Task:
    """Thread of the simulation."""

    name: str
    number: int
    computer: TaskComputer
    #: Lock that is held while the task does not run.
    baton: LockType = field(default_factory=allocate_lock)
    ident: int = 0
    is_ready: bool = False
    is_over: bool = False
    #: Deadline of a wait; None without a deadline, and while the task does not wait.
    deadline: float | None = None
    #: Time of the scheduler's next check of the deadline. Most waits end earlier; the check then finds nothing to do.
    alarm: float = _NEVER
    #: Whether the last wait ended at its deadline.
    is_late: bool = False
    #: Queue where the code that makes the task ready finds it.
    waiters: deque[Task] | None = None
    #: Exception to raise when the task runs next.
    error: BaseException | None = None
    #: Whether the task also runs while its computer is suspended.
    is_never_held: bool = False
    #: Number of times that the task has continued after `Ended`.
    endings: int = 0
    joiners: deque[Task] = field(default_factory=deque)
    #: Trace function that the scheduler has set for the task, and the previous one.
    tracer: Tracer | None = None
    before: Any = None

    def __post_init__(self) -> None:
        self.baton.acquire()


class Scheduler:
    """Scheduler that runs tasks one at a time.

    Args:
        seed: Seed that decides the order of the tasks.
        limit: Simulated time after which the first task gets `TimeLimit`, in s.

    Attributes:
        now: Simulated time since the beginning, in s.
        trace: Checksum of every decided step so far.
        steps: Number of times that tasks have called `step`.
        numbered: Number of threads and asyncio tasks that were made.
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
        # Time, a number that orders entries with the same time, and the action: a call, or the task of an alarm.
        self._due: list[tuple[float, int, Callable[[], object] | None, Task | None]] = []
        self._numbers = 0
        low, high = SWITCHES
        self._mean = low * (high / low) ** self.random.random()
        self._left = self._draw()
        # Whether the scheduler currently runs a due call, and not a step of the running task.
        self._is_choosing = False
        # Whether a function of `stand_in` runs.
        self._stands_in = False
        # Lock that is released by a thread which `end` has ended.
        self._ended = allocate_lock()
        self.running: Task  # since `adopt`
        #: Thread id of the running task.
        self.ident = 0
        self._tracer: Tracer | None = None
        self._processor = Processor()

    # -- tasks -----------------------------------------------------------------------------------------

    def adopt(self, name: str, computer: TaskComputer) -> Task:
        """Make the calling thread the first task, and let it run."""
        task = self.spawn(name, computer, is_ready=False)
        task.ident = self.ident = get_ident()
        self.running = task
        return task

    def spawn(self, name: str, computer: TaskComputer, *, is_ready: bool = True, is_never_held: bool = False) -> Task:
        """Make a task. Its thread must first call `begin`, which waits until the task may run."""
        task = Task(name, len(self.tasks), computer, is_never_held=is_never_held)
        self.tasks.append(task)
        if is_ready:
            self.make_ready(task)
        return task

    def begin(self, task: Task) -> None:
        """Wait until the task may run. The thread of the task calls this first."""
        task.baton.acquire()
        task.ident = self.ident = get_ident()
        if self.is_ending:
            raise Ended
        if self._tracer is not None:
            self._follow(task)

    def finish(self, task: Task) -> None:
        """End the task. The thread of the task calls this last."""
        task.is_over = True
        for joiner in task.joiners:
            self.make_ready(joiner)
        task.joiners.clear()
        if self.is_ending:
            self._ended.release()
        else:
            self._hand_over(self._next())

    # -- called by the running task ----------------------------------------------------------------------

    def step(self) -> None:
        """Let a little simulated time pass, and possibly let another task run."""
        self.now += STEP
        self.steps += 1
        self._left -= 1
        if self._left <= 0:
            self._left = self._draw()
            if not self.is_ending and not self._stands_in:
                self.yield_()

    def yield_(self) -> None:
        """Let other tasks run, if any can."""
        task = self.running
        due = self._due
        if not self._ready and task.computer.is_running and not (due and due[0][0] <= self.now) and self._is_same(task):
            # No other task can run, so the task continues without a change of threads.
            self.trace = zlib.crc32(_CHOICE.pack(task.number, self.now), self.trace)
            return
        self.make_ready(task)
        self._change(task)

    def _is_same(self, task: Task) -> bool:
        """Whether a task can continue directly: without an error, another tracer, or the end."""
        return task.error is None and task.tracer is self._tracer and not self.is_ending and not task.is_ready

    def wait(self, deadline: float | None, waiters: deque[Task] | None = None) -> bool:
        """Wait until other code makes this task ready; return False if the deadline came first.

        Args:
            deadline: Simulated time, in s; None for none.
            waiters: Queue where other code finds the task. At the deadline, the task is removed from it.
        """
        if self._stands_in:
            raise RuntimeError(f"work that was done in place of the thread {self.running.name!r} must not wait")
        task = self.running
        # If a call of `call_at` waits although it must not, the task was already waiting, and waits again afterwards.
        outer, outer_waiters = (task.deadline, task.waiters) if self._is_choosing else (None, None)
        task.is_late = False
        task.deadline = deadline
        task.waiters = waiters
        if waiters is not None:
            waiters.append(task)
        if deadline is not None and deadline < task.alarm:
            self.set_alarm(task, deadline)
        self._change(task)
        task.deadline, task.waiters = outer, outer_waiters
        if outer is not None and outer < task.alarm:
            self.set_alarm(task, outer)
        return not task.is_late

    def deadline(self, seconds: float | None) -> float | None:
        """Return the simulated time after `seconds` on the clock of the running task's computer."""
        if seconds is None:
            return None
        return self.now + max(seconds, 0.0) / self.running.computer.rate

    # -- called by any thread while a task is running ----------------------------------------------------

    def make_ready(self, task: Task) -> None:
        """Put a task into the queue of tasks that can run."""
        if task.is_ready or task.is_over:
            return
        task.is_ready = True
        (self._ready if task.computer.is_running or task.is_never_held else task.computer.held).append(task)

    def wake_one(self, waiters: deque[Task]) -> None:
        """Make one of the waiting tasks ready; the seed selects it."""
        if waiters:
            number = 0 if len(waiters) == 1 else int(self.random.random() * len(waiters))
            task = waiters[number]
            del waiters[number]
            self.make_ready(task)

    def call_at(self, when: float, call: Callable[[], object]) -> None:
        """Call a function at a simulated time, between two steps of the tasks. It must not wait."""
        self._numbers += 1
        heapq.heappush(self._due, (when, self._numbers, call, None))

    def stand_in(self, task: Task, call: Callable[[], T]) -> T:
        """Call a function in place of a waiting task, without a change of threads.

        Use it only in a call of `call_at`. The function runs on the computer of the task. It must not wait, and must
        not depend on `threading.current_thread`, which is the thread that would have waited otherwise.
        """
        self.trace = zlib.crc32(_CHOICE.pack(task.number, self.now), self.trace)
        before = self.running, self.ident, self._stands_in
        self.running, self.ident, self._stands_in = task, get_ident(), True
        try:
            return call()
        finally:
            self.running, self.ident, self._stands_in = before

    @property
    def is_idle(self) -> bool:
        """Whether every task waits, so that none was interrupted while it held a lock.

        While lines are traced, a task might be interrupted anywhere.
        """
        return not self._ready and self._tracer is None

    @property
    def quiet_until(self) -> float:
        """Time until which nothing can happen, except for the call of `call_at` that is running."""
        due = self._due
        while due and self.is_idle:
            when, _, call, task = due[0]
            if isinstance(call, Check) and not call.is_needed():
                heapq.heappop(due)
                call()
            elif task is not None and (task.alarm != when or task.deadline is None or task.deadline > when):
                heapq.heappop(due)
                if task.alarm == when:
                    self._ring(task)
            else:
                return min(when, self.limit)
        return self.now

    def note(self, data: bytes) -> None:
        """Add data to the checksum of the trace."""
        self.trace = zlib.crc32(data, self.trace)

    def suspend(self, computer: TaskComputer) -> None:
        """Stop all tasks of a computer until `resume`."""
        computer.is_running = False
        held = [task for task in self._ready if task.computer is computer and not task.is_never_held]
        computer.held += held
        self._ready[:] = [task for task in self._ready if task not in held]
        if not self._is_choosing and self.running.computer is computer:
            self.yield_()

    def resume(self, computer: TaskComputer) -> None:
        """Let the tasks of a computer run again."""
        computer.is_running = True
        self._ready += computer.held
        computer.held.clear()

    def end(self) -> None:
        """End every other task, one after the other; a waiting task gets `Ended`."""
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
        """Whether the calling thread is the running task outside of a due call, so that it may wait."""
        return self.ident == get_ident() and not self._is_choosing and not self.is_ending

    def trace_lines(self, tracer: Tracer | None) -> None:
        """Trace the lines of all tasks. None ends this, and restores the previous trace functions."""
        self._tracer = tracer
        if self.is_between_lines:
            self._follow(self.running)

    def _follow(self, task: Task) -> None:
        """Trace the lines of the calling thread in the same way as the other tasks' lines."""
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
                narrowed = self._processor.narrow()
                try:
                    self._hand_over(chosen)
                    self._take(task)
                finally:
                    self._processor.widen(narrowed)
        if self.is_ending:
            task.endings += 1
            if task.endings > _ENDINGS:  # it catches every exception and continues: block it here
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
        """Wait until the task may run. If Ctrl-C is pressed during the wait, the exception is raised afterwards."""
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

    def set_alarm(self, task: Task, when: float) -> None:
        """Check the deadline of a waiting task at this time."""
        task.alarm = when
        self._numbers += 1
        heapq.heappush(self._due, (when, self._numbers, None, task))

    def _ring(self, task: Task) -> None:
        """Handle the alarm of a task.

        There are three cases: the deadline has passed, a later wait has a later deadline, or the task is not waiting.
        """
        task.alarm = _NEVER
        deadline = task.deadline
        if deadline is None or task.is_ready or task.is_over:
            return
        if deadline > self.now:
            self.set_alarm(task, deadline)
        else:
            task.is_late = True
            if task.waiters is not None and task in task.waiters:
                task.waiters.remove(task)
            self.make_ready(task)

    def _next(self) -> Task:
        """Return the task that runs next, after letting time pass until there is one."""
        due, ready = self._due, self._ready
        while True:
            while due and due[0][0] <= self.now:
                when, _, call, task = heapq.heappop(due)
                if call is not None:
                    self._is_choosing = True
                    call()
                    self._is_choosing = False
                    host = self.running
                    if host.deadline is not None and host.alarm == _NEVER and not host.is_ready:
                        # The call has waited although it must not, and the alarm rang meanwhile.
                        self.set_alarm(host, host.deadline)
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
            if not due:
                self.interrupt(Deadlock(f"at {self.now:.6f} s every thread waits forever\n{self.stacks()}"))
            elif due[0][0] > self.limit:
                error = TimeLimit(f"the simulated time exceeds its limit of {self.limit:g} s\n{self.stacks()}")
                self.limit = _NEVER
                self.interrupt(error)
            else:
                self.now = due[0][0]

    def interrupt(self, error: BaseException) -> None:
        """Raise an error in the first task, as soon as it runs."""
        task = self.tasks[0]
        task.error = error
        task.computer.is_running = True
        task.is_ready = False
        self.make_ready(task)

    def stacks(self) -> str:
        """Return the stack of every task, as text."""
        frames = sys._current_frames()
        text = []
        for task in self.tasks:
            if not task.is_over and task.ident in frames:
                text.append(f"-- {task.name}\n{''.join(traceback.format_stack(frames[task.ident]))}")
        return "\n".join(text)


#: The active scheduler, in a list with one element.
installed: list[Scheduler | None] = [None]


def current() -> Scheduler | None:
    """Return the scheduler if the calling thread is the running task; else None."""
    scheduler = installed[0]
    return scheduler if scheduler is not None and scheduler.ident == get_ident() else None


def install(scheduler: Scheduler | None) -> None:
    """Make this the scheduler of the process."""
    installed[0] = scheduler
