"""The machine that runs compiled programs: threads that take turns, cycle by cycle.

A function is a list of instructions, and nothing in the machine calls itself. A frame is a plain list: the program's
globals, the thread that runs, and the function's own variables. An instruction is a Python function of the frame that
returns the number of the next instruction, or one of the three numbers below that say why there is none.

In each cycle every thread runs, in the order in which they were started, until it does something that takes time, or
until its slice of the cycle is over: then it goes on in the next one. So a loop that waits for a variable, such as the
timers that PolyScope counts in a thread of their own, lets the other threads run. The program is stopped if none of its
threads waits for anything, or if one loops for half a second while no other assigns to a global variable (a guess).
Which thread a real controller runs first is not known; its manual says that each has a slice of every cycle.

A critical section keeps a controller from taking turns in the middle of it, and nothing more: a driver in the field
waits for its socket, and joins a thread that enters one, inside of one. Here turns are taken only where time passes,
so that it changes nothing.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from operator import is_
from typing import Any, Literal, NamedTuple

from ..robot.generator import OutOfReach
from .errors import (
    MAX_CALL_DEPTH,
    MAX_INSTRUCTIONS,
    MAX_MEMORY,
    MAX_THREADS,
    MAX_WORK,
    Fault,
    ProgramError,
    endless,
)
from .matrices import HAS_MATRICES
from .statements import StatementQueue
from .tokens import SourceText
from .values import UNSET, weight
from .world import BegunMove, ScriptWorld

Frame = list[Any]
Instruction = Callable[[Frame], int]

#: Where in a frame the globals, the thread and the first variable are.
GLOBALS, THREAD, FIRST = 0, 1, 2
#: Another function goes on; the thread waits for a later cycle; the thread is over.
SWITCHED, WAITING, ENDED = -1, -2, -3


@dataclass(eq=False)
class Code:
    """A function.

    Attributes:
        source: the text.
        size: of its frame.
        instructions: one after the other.
        places: where in the text each stands.
    """

    source: SourceText
    size: int = FIRST
    instructions: list[Instruction] = field(default_factory=list)
    places: list[int] = field(default_factory=list)


class StatementCode(NamedTuple):
    """A statement that came while the program runs; it runs in the frame of the function whose scope it has.

    Attributes:
        code: its instructions.
        n_globals: how many global variables the program has by now.
    """

    code: Code
    n_globals: int


@dataclass(eq=False)
class Script:
    """A program that compiles.

    Attributes:
        name: as after `def` or `sec`; "unnamed" (a guess) for statements alone.
        kind: `sec` runs beside the program that moves the arm.
        main: where it begins.
        n_globals: how many global variables it has.
    """

    name: str
    kind: Literal["def", "sec"]
    main: Code
    n_globals: int


#: A function that takes time: it yields once for every cycle that it waits, and returns its value.
Waiting = Generator[None, None, Any]

#: Instructions of a thread that has used up its slice in the cycle before: it waits for another thread.
_SPINNING = 1000
# Small frames are part of the text's bound; larger ones count as memory.
_SMALL_FRAME = 64


class ScriptThread:
    """A thread of a program: its frames, and what it waits for.

    Attributes:
        is_over: whether it has ended or was killed.
    """

    __slots__ = (
        "_code",
        "_depth",
        "_destination",
        "_frame",
        "_next",
        "_seen",
        "_spins",
        "_stack",
        "_wait",
        "is_over",
        "machine",
        "world",
    )

    def __init__(self, machine: Machine, code: Code, frame: Frame) -> None:
        self.machine = machine
        self.world = machine.world
        self.is_over = False
        self._code = code
        self._frame = frame
        self._next = 0
        self._depth = 0
        # The global variables after it had used up its slice of the cycle before, and the cycles since another thread
        # has assigned to one.
        self._seen: list[Any] | None = None
        self._spins = 0
        self._stack: list[tuple[Code, Frame, int, int]] = []
        self._wait: Waiting | None = None
        self._destination = 0
        frame[THREAD] = self

    def call(self, code: Code, frame: Frame, after: int, destination: int) -> int:
        """Enter a function; its value is stored in the caller's slot `destination`."""
        self._depth += 1
        if self._depth > MAX_CALL_DEPTH:
            raise Fault(f"Too many calls in one another: {MAX_CALL_DEPTH}")
        if code.size > _SMALL_FRAME:
            self.machine.charge(code.size)
        self._stack.append((self._code, self._frame, after, destination))
        self._code, self._frame, self._next = code, frame, 0
        return SWITCHED

    def leave(self, value: Any) -> int:
        """Return from the function."""
        if not self._stack:
            self.end()
            return ENDED
        self._depth -= 1
        self._code, self._frame, self._next, destination = self._stack.pop()
        self._frame[destination] = value
        return SWITCHED

    def await_(self, waiting: Waiting, after: int, destination: int) -> int:
        """Begin something that takes time; its value is stored in the slot `destination`."""
        try:
            next(waiting)
        except StopIteration as done:
            self._frame[destination] = done.value
            return after
        self._wait, self._next, self._destination = waiting, after, destination
        return WAITING

    def end(self) -> None:
        """End it, at any place."""
        if not self.is_over:
            self.is_over = True
            wait, self._wait = self._wait, None
            if wait is not None:
                wait.close()
            self._stack.clear()
            self._frame = []
            self.machine.forget(self)

    def run(self) -> None:
        """Run until it waits or ends.

        Raises:
            ProgramError: a run-time error.
        """
        at = self._next - 1
        machine = self.machine
        try:
            if self._wait is not None:
                try:
                    next(self._wait)
                    return
                except StopIteration as done:
                    self._wait = None
                    self._frame[self._destination] = done.value
            at, frame, instructions = self._next, self._frame, self._code.instructions
            most = machine.left if machine.left < machine.slice else machine.slice
            if self._seen is not None:
                most = min(most, self._waited(frame[GLOBALS]))
            for left in range(most, 0, -1):
                at = instructions[at](frame)  # still the number of this one where it fails
                if at < 0:
                    if at == SWITCHED:
                        at, frame, instructions = self._next, self._frame, self._code.instructions
                    else:
                        machine.left -= most - left + 1
                        return
            machine.left -= most
            self._next = at
            # A program waits for a socket anyway: after a read, it continues in the next cycle.
            if most and not machine.reads:
                self._seen = list(frame[GLOBALS])
                machine.spinning += 1
        except Fault as fault:
            raise self._error(at, str(fault), fault.place) from None
        except (ArithmeticError, ValueError) as error:
            raise self._error(at, str(error), None) from None

    def _waited(self, variables: list[Any]) -> int:
        """Instructions for a thread that has used up its slice of the cycle before.

        Raises:
            Fault: it has done so for too long, while no other thread has assigned to a global variable.
        """
        seen, self._seen = self._seen or [], None
        self._spins = self._spins + 1 if all(map(is_, seen, variables)) else 0
        if self._spins > self.world.firmware.rate // 2:
            raise endless(self.world.firmware)
        return _SPINNING

    def endless(self) -> ProgramError:
        """The error of a program of which no thread waits for anything."""
        return self._error(self._next, str(endless(self.world.firmware)), None)

    def _error(self, at: int, text: str, place: int | None) -> ProgramError:
        places = self._code.places
        where = places[min(max(at, 0), len(places) - 1)] if place is None else place
        return self._code.source.failure(where, text)

    @property
    def memory(self) -> int:
        """Number of elements and characters in its variables."""
        frames = [self._frame, *(frame for _, frame, _, _ in self._stack)]
        return sum(len(frame) + sum(map(weight, frame)) for frame in frames)


class Machine:
    """All threads of one program.

    Attributes:
        world: the controller.
        statements: from clients, in interpreter mode.
        left: instructions that may still be run in this cycle.
        slice: those of them that one thread may run.
        spinning: number of threads that have used up their slice in this cycle.
        reads: number of reads from sockets in this cycle.
        remote_calls: number of calls of methods of servers so far.
        random: for the function of that name; it gives the same numbers in every run.
        has_matrices: whether arithmetic takes matrices.
        history: the joint positions of past cycles, newest last.
        has_moved: whether a motion was begun.
    """

    def __init__(self, script: Script, world: ScriptWorld) -> None:
        self.world = world
        self.statements: StatementQueue[StatementCode] = StatementQueue()
        self.statements.aborts = self.abort_motion
        self.left = self.slice = MAX_INSTRUCTIONS
        self.spinning = self.reads = self.remote_calls = 0
        self.random = random.Random(0)
        self.history: deque[tuple[float, ...]] = deque(maxlen=500)
        self.has_moved = False
        self._owner: ScriptThread | None = None
        self._move: BegunMove | None = None
        self._is_aborted = False
        self.has_matrices = world.firmware in HAS_MATRICES
        self._globals: list[Any] = [UNSET] * script.n_globals
        self._work = 0
        self._made = 0
        self._threads: list[ScriptThread] = []
        self.main = self.start(script.main, [self._globals, None, *[UNSET] * (script.main.size - 2)])

    def start(self, code: Code, frame: Frame) -> ScriptThread:
        """Start a thread. It runs after the existing ones, in the same cycle."""
        if len(self._threads) >= MAX_THREADS:
            raise Fault(f"Too many threads: {MAX_THREADS}")
        thread = ScriptThread(self, code, frame)
        self._threads.append(thread)
        return thread

    def advance(self) -> None:
        """Run one cycle.

        Raises:
            ProgramError: a run-time error.
        """
        threads = self._threads
        self.left = MAX_INSTRUCTIONS
        self.slice = MAX_INSTRUCTIONS // len(threads)
        self.spinning = self.reads = self._work = 0
        self.history.append(tuple(self.world.q_actual))
        # A thread that is started appends itself.
        for thread in threads:
            if not thread.is_over:
                thread.run()
                if self.main.is_over:
                    return
        if self.spinning and self.spinning == sum(not thread.is_over for thread in threads):
            raise self.main.endless()
        if any(thread.is_over for thread in threads):
            self._threads = [thread for thread in threads if not thread.is_over]

    def stop(self) -> None:
        """End all threads. The caller has to stop the arm."""
        self._owner = None
        for thread in self._threads:
            thread.end()
        self._threads = []
        self._globals.clear()

    def forget(self, thread: ScriptThread) -> None:
        """Handle the end of a thread: if it commanded the arm, the arm brakes."""
        if self._owner is thread:
            self._owner = None
            self.world.motion.release()

    def moving(self, thread: ScriptThread, begin: Callable[[], BegunMove]) -> Waiting:
        """Command the arm, and wait until that is over.

        Raises:
            Fault: another thread's motion is not over.
        """
        if self._owner is not None and self._owner is not thread and self._move is not None and not self._move.is_over:
            raise Fault("Another thread is already controlling the robot")
        self._owner, self._move = thread, None
        self._is_aborted = False
        self.has_moved = True
        try:
            move = self._move = begin()
        except OutOfReach as unreachable:
            raise Fault(str(unreachable)) from None
        yield  # even a motion without a distance takes a cycle
        while not (move.is_over or self._is_aborted):
            yield
        if self._owner is thread:
            self._owner = None

    def abort_motion(self) -> None:
        """End the motion that a thread waits for: the arm brakes, and the thread continues in the next cycle."""
        if self._owner is not None and self._move is not None and not self._move.is_over:
            self._is_aborted = True
            self.world.motion.release()

    # -- bounds ------------------------------------------------------------------------------------

    def spend(self, work: int) -> None:
        """Count work that costs as much as making this many elements."""
        self._work += work
        if self._work > MAX_WORK:
            raise endless(self.world.firmware)

    def charge(self, elements: int) -> None:
        """Count the making of this many elements."""
        self.spend(elements)
        self._made += elements
        if self._made > MAX_MEMORY // 4:
            self._made = 0
            held = sum(map(weight, self._globals)) + sum(thread.memory for thread in self._threads)
            if held > MAX_MEMORY:
                raise Fault(f"Out of memory: the variables hold {held} elements")


class Execution:
    """One run of a program.

    Attributes:
        script: the program.
        is_over: whether its main thread has ended, which ends the others, or it was stopped, or it failed.
        error: the run-time error that ended it.
    """

    def __init__(self, script: Script, world: ScriptWorld) -> None:
        self.script = script
        self.is_over = False
        self.error: ProgramError | None = None
        self._world = world
        self._machine = Machine(script, world)

    @property
    def statements(self) -> StatementQueue[StatementCode]:
        """The statements from clients in interpreter mode."""
        return self._machine.statements

    def advance(self) -> None:
        """Run one controller cycle: every thread runs until it waits for a later one."""
        if self.is_over:
            return
        try:
            self._machine.advance()
        except ProgramError as error:
            self.error = error
            self.stop()
        if self._machine.main.is_over:
            self.stop()

    def stop(self) -> None:
        """End all threads, release the arm, and close the program's sockets."""
        if self.is_over:
            return
        self.is_over = True
        self._machine.stop()
        if self._machine.has_moved:
            self._world.motion.release()
        self._world.sockets.close_all()
