"""Machine that runs a compiled program. The threads of the program take turns in each controller cycle.

A function of the program is a list of instructions. The machine does not use recursion. A frame is a plain list that
contains the program's globals, the running thread, and the variables of the function. An instruction is a Python
function that is called with the frame. It returns the number of the next instruction. If there is no next instruction,
it returns `SWITCHED`, `WAITING` or `ENDED`.

In each cycle, every thread runs, in the order in which the threads were started. A thread runs until it calls a
function that takes time, or until its slice of the cycle is used up. The thread then continues in the next cycle. So a
loop that waits for a variable lets the other threads run. An example of such a variable is a timer, which PolyScope
counts in a separate thread. The program is stopped in two cases (assumed). The first is that all threads use up their
slices in the same cycle. The second is that a thread loops for half a second while no other thread assigns to a global
variable. The order of the threads on a real controller is unknown. According to the manual, each thread has a slice of
every cycle.

On a real controller, the only effect of a critical section is that other threads do not run while a thread is inside
it. A driver in use waits for its socket inside a critical section, and joins a thread that enters one. In the
simulator, threads take turns only when time passes, so a critical section has no effect.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Generator, Iterable
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
from .world import BegunMove, ScriptWorld, SensorValues

Frame = list[Any]
Instruction = Callable[[Frame], int]

#: Positions of the globals, the thread and the first variable in a frame.
GLOBALS, THREAD, FIRST = 0, 1, 2
#: Return values of instructions: another function continues; the thread waits for a later cycle; the thread has ended.
SWITCHED, WAITING, ENDED = -1, -2, -3


@dataclass(eq=False)
class Code:
    """Compiled function of a program.

    Attributes:
        source: Text of the program.
        size: Size of the frame of the function.
        instructions: Instructions in the order of execution.
        places: Character offset of each instruction in the text.
    """

    source: SourceText
    size: int = FIRST
    instructions: list[Instruction] = field(default_factory=list)
    places: list[int] = field(default_factory=list)


class StatementCode(NamedTuple):
    """Compiled statement that arrived in interpreter mode.

    The statement runs in the frame of the function that has called `interpreter_mode`.

    Attributes:
        code: Instructions of the statement.
        n_globals: Number of global variables of the program, including variables that the statement adds.
    """

    code: Code
    n_globals: int


@dataclass(eq=False)
class Script:
    """Compiled program.

    Attributes:
        name: Name after `def` or `sec`; "unnamed" (assumed) if the program consists only of statements.
        kind: Kind of the program. A `sec` program runs in addition to the program that moves the arm.
        main: Code that runs first.
        n_globals: Number of global variables.
        is_connected: Whether the program calls a function that opens connections or executes statements of clients.
    """

    name: str
    kind: Literal["def", "sec"]
    main: Code
    n_globals: int
    is_connected: bool = False


#: Call of a function that takes time. It yields once for every cycle that it waits, and then returns the value of the
#: call.
Waiting = Generator[None, None, Any]

#: Maximum number of instructions for a thread that has used up its slice in the previous cycle. Such a thread probably
#: waits in a loop for another thread.
_SPINNING = 1000
# Size above which a frame counts as memory. For smaller frames, the limit of the program's length is sufficient.
_SMALL_FRAME = 64


class ScriptThread:
    """Thread of a program, with its frames and the call for which it waits.

    Attributes:
        is_over: Whether the thread has ended or was killed.
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
        # Global variables at the moment at which the thread had used up its slice of the previous cycle, and number of
        # such cycles since another thread has assigned to a global variable.
        self._seen: list[Any] | None = None
        self._spins = 0
        self._stack: list[tuple[Code, Frame, int, int]] = []
        self._wait: Waiting | None = None
        self._destination = 0
        frame[THREAD] = self

    def call(self, code: Code, frame: Frame, after: int, destination: int) -> int:
        """Enter a function. The return value will be stored in the caller's slot `destination`."""
        self._depth += 1
        if self._depth > MAX_CALL_DEPTH:
            raise Fault(f"calls are nested too deeply; the limit is {MAX_CALL_DEPTH}")
        if code.size > _SMALL_FRAME:
            self.machine.charge(code.size)
        self._stack.append((self._code, self._frame, after, destination))
        self._code, self._frame, self._next = code, frame, 0
        return SWITCHED

    def leave(self, value: Any) -> int:
        """Return from the current function."""
        if not self._stack:
            self.end()
            return ENDED
        self._depth -= 1
        self._code, self._frame, self._next, destination = self._stack.pop()
        self._frame[destination] = value
        return SWITCHED

    def await_(self, waiting: Waiting, after: int, destination: int) -> int:
        """Begin a call that takes time. The return value will be stored in the slot `destination`."""
        try:
            next(waiting)
        except StopIteration as done:
            self._frame[destination] = done.value
            return after
        self._wait, self._next, self._destination = waiting, after, destination
        return WAITING

    def end(self) -> None:
        """End the thread, wherever it is in the program."""
        if not self.is_over:
            self.is_over = True
            wait, self._wait = self._wait, None
            if wait is not None:
                wait.close()
            self._stack.clear()
            self._frame = []
            self.machine.forget(self)
            del self.machine  # breaks a reference cycle

    def run(self) -> None:
        """Run until the thread waits or ends.

        Raises:
            ProgramError: If there is a run-time error.
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
                at = instructions[at](frame)  # if the instruction raises, `at` is still its number
                if at < 0:
                    if at == SWITCHED:
                        at, frame, instructions = self._next, self._frame, self._code.instructions
                    else:
                        machine.left -= most - left + 1
                        return
            machine.left -= most
            self._next = at
            # If any thread has read from a socket in this cycle, the program waits for a peer, so it is not an endless
            # loop.
            if most and not machine.reads:
                self._seen = list(frame[GLOBALS])
                machine.spinning += 1
        except Fault as fault:
            raise self._error(at, str(fault), fault.place) from None
        except (ArithmeticError, ValueError) as error:
            raise self._error(at, str(error), None) from None

    def _waited(self, variables: list[Any]) -> int:
        """Return the number of instructions for a thread that used up its slice in the previous cycle.

        Raises:
            Fault: If the thread has used up its slices for too long, while no other thread has assigned to a global
                variable.
        """
        seen, self._seen = self._seen or [], None
        self._spins = self._spins + 1 if all(map(is_, seen, variables)) else 0
        if self._spins > self.world.firmware.rate // 2:
            raise endless(self.world.firmware)
        return _SPINNING

    def endless(self) -> ProgramError:
        """Return the error for a program in which no thread waits for a later cycle."""
        return self._error(self._next, str(endless(self.world.firmware)), None)

    def _error(self, at: int, text: str, place: int | None) -> ProgramError:
        places = self._code.places
        where = places[min(max(at, 0), len(places) - 1)] if place is None else place
        return self._code.source.failure(where, text)

    @property
    def memory(self) -> int:
        """Number of elements and characters in the variables of the thread."""
        frames = [self._frame, *(frame for _, frame, _, _ in self._stack)]
        return sum(len(frame) + sum(map(weight, frame)) for frame in frames)


class Machine:
    """Machine of one program, which runs all its threads.

    Attributes:
        world: Controller, as the program uses it.
        statements: Statements from clients, in interpreter mode.
        left: Number of instructions that can still run in this cycle.
        slice: Number of instructions that one thread may run in this cycle.
        spinning: Number of threads that have used up their slice in this cycle.
        reads: Number of reads from sockets in this cycle.
        remote_calls: Number of calls of remote methods so far.
        random: Source of random numbers for the function `random`. The numbers are the same in every run.
        has_matrices: Whether the firmware supports arithmetic with matrices.
        history: Sensors of past cycles; the newest are last.
        has_moved: Whether the program has begun any motion.
    """

    def __init__(self, script: Script, world: ScriptWorld) -> None:
        self.world = world
        self.statements: StatementQueue[StatementCode] = StatementQueue()
        self.statements.aborts = self.abort_motion
        self.left = self.slice = MAX_INSTRUCTIONS
        self.spinning = self.reads = self.remote_calls = 0
        self.random = random.Random(0)
        self.history: deque[SensorValues] = deque(maxlen=500)
        self.has_moved = False
        self._owner: ScriptThread | None = None
        self._move: BegunMove | None = None
        self._is_aborted = self._awaits_motion = False
        self.has_matrices = world.firmware in HAS_MATRICES
        self._globals: list[Any] = [UNSET] * script.n_globals
        self._work = 0
        self._made = 0
        self._threads: list[ScriptThread] = []
        self.main = self.start(script.main, [self._globals, None, *[UNSET] * (script.main.size - 2)])

    def start(self, code: Code, frame: Frame) -> ScriptThread:
        """Start a thread. It runs in the same cycle, after the existing threads."""
        if len(self._threads) >= MAX_THREADS:
            raise Fault(f"Too many threads: {MAX_THREADS}")
        thread = ScriptThread(self, code, frame)
        self._threads.append(thread)
        return thread

    def advance(self) -> None:
        """Run one cycle.

        Raises:
            ProgramError: If there is a run-time error.
        """
        threads = self._threads
        self.left = MAX_INSTRUCTIONS
        self.slice = MAX_INSTRUCTIONS // len(threads)
        self.spinning = self.reads = self._work = 0
        self.history.append(self.world.sensors)
        # The loop also runs new threads, because `start` appends them to this list.
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
        """End all threads. The caller must stop the arm."""
        self._owner = None
        for thread in self._threads:
            thread.end()
        self._threads = []
        self._globals.clear()
        self.statements.aborts = lambda: None  # breaks a reference cycle

    def forget(self, thread: ScriptThread) -> None:
        """Process the end of a thread. If this thread commanded the arm, the arm brakes."""
        if self._owner is thread:
            self._owner = None
            self.world.motion.release()

    def moving(self, thread: ScriptThread, begin: Callable[[], BegunMove]) -> Waiting:
        """Command the arm, and wait until the motion has ended.

        Raises:
            Fault: If a motion of another thread has not ended.
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
        yield  # even a motion to the current position takes a cycle
        self._awaits_motion = True
        try:
            while not (move.is_over or self._is_aborted):
                yield
        finally:
            self._awaits_motion = False
        if self._owner is thread:
            self._owner = None

    @property
    def only_awaits_motion(self) -> bool:
        """Whether the program does nothing until its motion has ended: it has one thread, which waits for this."""
        return self._awaits_motion and len(self._threads) == 1 and not self._is_aborted

    def abort_motion(self) -> None:
        """End the motion that a thread waits for.

        The arm brakes, and the thread continues in the next cycle.
        """
        if self._owner is not None and self._move is not None and not self._move.is_over:
            self._is_aborted = True
            self.world.motion.release()

    # -- bounds ------------------------------------------------------------------------------------

    def spend(self, work: int) -> None:
        """Count work that costs as much as the creation of `work` elements."""
        self._work += work
        if self._work > MAX_WORK:
            raise endless(self.world.firmware)

    def charge(self, elements: int) -> None:
        """Count the creation of elements, as work and as memory."""
        self.spend(elements)
        self._made += elements
        if self._made > MAX_MEMORY // 4:
            self._made = 0
            held = sum(map(weight, self._globals)) + sum(thread.memory for thread in self._threads)
            if held > MAX_MEMORY:
                raise Fault(f"Out of memory: the variables hold {held} elements")


class Execution:
    """Execution of a program.

    Attributes:
        script: Compiled program.
        is_over: Whether the program has ended. A program ends when its main thread ends, when it is stopped, or when it
            fails.
        error: Run-time error that has ended the program, or None.
    """

    def __init__(self, script: Script, world: ScriptWorld) -> None:
        self.script = script
        self.is_over = False
        self.error: ProgramError | None = None
        self._world = world
        self._machine = Machine(script, world)

    @property
    def statements(self) -> StatementQueue[StatementCode]:
        """Statements from clients in interpreter mode."""
        return self._machine.statements

    def advance(self) -> None:
        """Run one controller cycle: every thread runs until it waits for a later cycle."""
        if self.is_over:
            return
        try:
            self._machine.advance()
        except ProgramError as error:
            self.error = error
            self.stop()
        if self._machine.main.is_over:
            self.stop()

    @property
    def only_awaits_motion(self) -> bool:
        """Whether the program does nothing until its motion has ended."""
        return not self.is_over and self._machine.only_awaits_motion

    def remember(self, sensors: Iterable[SensorValues]) -> None:
        """Add the sensors of cycles in which the program only waited for its motion to the history."""
        self._machine.history.extend(sensors)

    def stop(self) -> None:
        """End all threads, let the arm brake, and close the sockets of the program."""
        if self.is_over:
            return
        self.is_over = True
        self._machine.stop()
        if self._machine.has_moved:
            self._world.motion.release()
        self._world.sockets.close_all()
