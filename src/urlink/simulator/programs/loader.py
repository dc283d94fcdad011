"""From the lines that clients send to programs that run (docs/protocols/urscript.md, Sending a program).

A program begins with `def` or `sec` in the first column and ends with `end` in the first column; every other line is a
program by itself, or one of a few commands that are no URScript.

The programs of one client begin in the order in which they came. Short ones are compiled at once, so many in a cycle as
cost no more than `BUDGET`. A long one can take up to a second, for which the clock would stand still, so it is compiled
in a thread beside it, and what the same client sends after it waits. No client waits for the text of another one,
unless both are long: one is compiled at a time.

Guess: a text is ignored while the arm may not move, and on an e-Series that is not in remote control.
"""

from __future__ import annotations

import logging
import re
import threading
from collections import deque
from collections.abc import Callable

from urlink.firmware import Firmware

from .. import messages
from ..robot.modes import Stop
from ..state import ControllerState
from ..urscript import Script, ScriptError, compile_script
from .runner import ProgramRunner

__all__ = ["LineAssembler", "ProgramLoader", "ProgramQueue", "obey"]

_log = logging.getLogger("urlink.simulator")

#: Characters of a program; with more it is thrown away, to its `end`. The compiler's limit is lower.
LONGEST_PROGRAM = 1 << 20
#: Characters from which on a program is compiled in a thread: some 20 ms of work.
LONG = 1 << 13
#: Characters of one client that may wait for their turn.
MOST_WAITING = 1 << 20
#: Characters of all clients that are compiled in one cycle, give or take one program. A program counts as `LEAST`
#: characters at least, since to compile and begin one costs something however short it is.
BUDGET, LEAST = 8192, 200
#: Seconds that the end of a compilation is waited for when the controller closes.
_JOIN_TIMEOUT = 4.0

_BEGIN = re.compile(r"(?:def|sec)\b")
_END = re.compile(r"end\b\s*(?:#.*)?$")
_NOTHING = re.compile(r"\s*(?:#.*)?$")
_SPEED = re.compile(r"set speed (\d*\.?\d+)")


class LineAssembler:
    """Makes programs of the lines of one client.

    Attributes:
        refused: characters of programs that were too long.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._lines: list[str] = []
        self._length = 0

    def feed(self, line: str) -> str | None:
        """The program that this line completes, if it does."""
        if not self._length and not _BEGIN.match(line):
            return None if _NOTHING.match(line) else line
        self._length += len(line) + 1
        if self._length <= LONGEST_PROGRAM:
            self._lines.append(line)
        else:
            self._lines.clear()
        if not _END.match(line):
            return None
        lines, length = self._lines, self._length
        self._lines, self._length = [], 0
        if length > LONGEST_PROGRAM:
            self.refused += length
            return None
        return "\n".join(lines) + "\n"


def obey(state: ControllerState, runner: ProgramRunner, line: str) -> bool:
    """Do what a line says, if it is a command to the controller and no URScript.

    Such lines are known from a forum and from public drivers; `stop program` is how the UR Client Library ends what
    runs. What a real controller answers is not known; this one stays silent. `set robotmode freedrive` is taken and
    does nothing.
    """
    words = " ".join(line.split())
    speed = _SPEED.fullmatch(words)
    if words == "stop program":
        runner.stop()
    elif speed:
        state.speed_fraction = min(max(float(speed[1]), 0.0), 1.0)
    elif words == "power on":
        state.modes.power_on(release_brakes=False)
    elif words == "power off":
        state.modes.power_off()
    elif words == "set robotmode run":
        state.modes.power_on()
    elif words == "set unlock protective stop":
        if state.modes.stop is Stop.PROTECTIVE:
            state.modes.clear()
    else:
        return words == "set robotmode freedrive"
    return True


class _Compilation(threading.Thread):
    """One long program, being compiled.

    Attributes:
        result: what came of it; None until it is over.
    """

    def __init__(self, text: str, firmware: Firmware, on_end: Callable[[], object]) -> None:
        super().__init__(name="urlink sim compiling", daemon=True)
        self.text = text
        self.result: Script | ScriptError | None = None
        self._firmware = firmware
        self._on_end = on_end

    def run(self) -> None:
        self.result = _compiled(self.text, self._firmware)
        self._on_end()


class ProgramQueue:
    """The programs that one client has sent, until they begin. Made by `ProgramLoader.open`."""

    def __init__(self, loader: ProgramLoader) -> None:
        self._loader = loader
        self.texts: deque[str] = deque()
        self.compilation: _Compilation | None = None

    def put(self, text: str) -> bool:
        """A whole program, or a line. False where so much waits that it is thrown away."""
        if sum(map(len, self.texts)) + len(text) > MOST_WAITING:
            return False
        self.texts.append(text)
        self._loader.serve(self)
        return True


class ProgramLoader:
    """Compiles the programs that clients of one controller have sent, and begins them.

    Everything but the compiling of long programs is done in the thread that owns the controller.

    Args:
        state: of the controller.
        runner: runs them.

    Attributes:
        on_compiled: called from another thread when `advance` has something to do.
    """

    def __init__(self, state: ControllerState, runner: ProgramRunner) -> None:
        self.on_compiled: Callable[[], object] = lambda: None
        self._state = state
        self._runner = runner
        # Those with something in them; the first has its turn next.
        self._queues: deque[ProgramQueue] = deque()
        self._compilation: _Compilation | None = None
        # The cycle for which it is counted what was compiled, and the characters.
        self._cycle = -1
        self._spent = 0

    @property
    def is_waiting(self) -> bool:
        """Some programs wait for the next cycle rather than for a compilation."""
        return any(queue.texts and queue.compilation is None for queue in self._queues)

    @property
    def is_compiling(self) -> bool:
        """A long program is being compiled in a thread."""
        return self._compilation is not None

    def open(self) -> ProgramQueue:
        """The queue of a new client."""
        return ProgramQueue(self)

    def load(self, text: str) -> None:
        """Compile a whole program, or a line, and begin it before this returns."""
        if self._may_load(text):
            self._begin(text, _compiled(text, self._state.firmware))

    def advance(self) -> None:
        """Begin what has been compiled, and what has waited for this cycle."""
        compilation = self._compilation
        if compilation is not None and compilation.result is not None:
            self._compilation = None
            for queue in self._queues:
                if queue.compilation is compilation:
                    queue.compilation = None
                    self._begin(compilation.text, compilation.result)
        for _ in range(len(self._queues)):
            queue = self._queues.popleft()
            self.serve(queue)

    def serve(self, queue: ProgramQueue) -> None:
        """Begin the programs of one client, as far as that can be in this cycle; the rest has its turn in `advance`."""
        if self._cycle != self._state.cycle:
            self._cycle, self._spent = self._state.cycle, 0
        texts = queue.texts
        while texts and queue.compilation is None and self._spent < BUDGET:
            if len(texts[0]) < LONG:
                text = texts.popleft()
                self._spent += max(len(text), LEAST)
                self.load(text)
            elif self._compilation is not None:
                break
            elif self._may_load(text := texts.popleft()):
                self._compilation = queue.compilation = _Compilation(text, self._state.firmware, self.on_compiled)
                self._compilation.start()
        if (texts or queue.compilation is not None) and queue not in self._queues:
            self._queues.append(queue)

    def clear(self) -> None:
        """Forget all of it: the controller goes down."""
        for queue in self._queues:
            queue.texts.clear()
            queue.compilation = None
        self._queues.clear()
        self._compilation = None

    def close(self) -> None:
        """Forget all of it, and wait for the thread."""
        compilation = self._compilation
        self.clear()
        if compilation is not None:
            compilation.join(_JOIN_TIMEOUT)

    def _may_load(self, text: str) -> bool:
        """Whether it is a program, and the controller takes programs now; a command is carried out."""
        state = self._state
        if not state.is_up:
            return self._refuse("down", text)
        if state.firmware.is_e_series and not state.remote_control:
            return self._refuse("in local control", text)
        return not obey(state, self._runner, text)

    def _begin(self, text: str, compiled: Script | ScriptError) -> None:
        state = self._state
        if isinstance(compiled, ScriptError):
            error = compiled
            state.outbox.put(messages.runtime_exception(state, error.line, error.column, error.text, False))
        elif compiled.kind == "sec":
            if not self._runner.start_secondary(compiled, len(text)):
                self._refuse("too many secondary programs wait", text)
        elif not state.modes.may_move:
            self._refuse("the arm may not move", text)
        else:
            self._runner.start(compiled)

    def _refuse(self, why: str, text: str) -> bool:
        self._state.counters.refused_programs += 1
        _log.info("ignored, %s: %.60r", why, text)
        return False


def _compiled(text: str, firmware: Firmware) -> Script | ScriptError:
    try:
        return compile_script(text, firmware)
    except ScriptError as error:
        return error
