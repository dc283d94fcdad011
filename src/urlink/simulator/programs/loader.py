"""Loader that assembles programs from the lines of clients, compiles them and starts them.

See docs/protocols/urscript.md, Sending a program. A program begins with `def` or `sec` in the first column and ends
with `end` in the first column. Every other line is a program with one line, or one of a few commands that are not
URScript.

The programs of one client begin in the order of their arrival. Short programs are compiled immediately, up to `BUDGET`
characters per cycle. Compiling a long program can take up to a second, and the simulator's clock must not wait for
this. Therefore a long program is compiled in another thread, and later programs of the same client wait for it. Other
clients have to wait only if they also send long programs, because only one long program is compiled at a time.

Assumptions: while the arm may not move, the controller ignores programs, except secondary programs. An e-Series
controller in local control ignores all programs and commands.
"""

from __future__ import annotations

import logging
import re
import threading
from collections import deque
from collections.abc import Callable

from linkcore import clock
from urlink.protocol.firmware import Firmware

from .. import messages
from ..robot.modes import StopState
from ..state import ControllerState
from ..urscript import ProgramError, Script, compile_script
from .runner import ProgramRunner

_log = logging.getLogger("urlink.simulator")

#: Maximum length of a program in characters. A longer program is discarded up to its `end`. The compiler's limit is
#: lower.
LONGEST_PROGRAM = 1 << 20
#: Length in characters from which a program is compiled in another thread. Compiling this length takes about 20 ms.
LONG = 1 << 13
#: Maximum number of characters that are queued for one client.
MOST_WAITING = 1 << 20
#: Number of characters, summed over all clients, after which no more programs are compiled in a cycle. A program counts
#: as at least `LEAST` characters, because compiling and starting even a short program takes time.
BUDGET, LEAST = 8192, 200
#: Maximum time to wait for the end of a compilation when the controller is closed, in seconds.
_JOIN_TIMEOUT = 4.0

_BEGIN = re.compile(r"(?:def|sec)\b")
_END = re.compile(r"end\b\s*(?:#.*)?$")
_NOTHING = re.compile(r"\s*(?:#.*)?$")
_SPEED = re.compile(r"set speed ([0-9]+(?:\.[0-9]+)?|\.[0-9]+)")


class LineAssembler:
    """Assembler that makes programs from the lines of one client.

    Attributes:
        refused: Number of characters in programs that were too long.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._lines: list[str] = []
        self._length = 0

    def feed(self, line: str) -> str | None:
        """Add a line, and return the program that this line completes; None if no program is complete."""
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
    """Execute a line if it is a command to the controller; return False if it is URScript.

    Such commands are known from a forum and from public drivers. The UR Client Library ends programs with `stop
    program`, which ends every running program, even one that another client started (docs/protocols/urscript.md,
    Sending a program). The reply of a real controller is unknown; the simulator does not reply. `set robotmode
    freedrive` is accepted and has no effect.
    """
    words = " ".join(line.split())
    speed = _SPEED.fullmatch(words)
    if words == "stop program":
        runner.stop_all()
    elif speed:
        state.speed_fraction = min(max(float(speed[1]), 0.0), 1.0)
    elif words == "power on":
        state.modes.power_on(release_brakes=False)
    elif words == "power off":
        state.modes.power_off()
    elif words == "set robotmode run":
        state.modes.power_on()
    elif words == "set unlock protective stop":
        if state.modes.stop is StopState.PROTECTIVE:
            state.modes.clear()
    else:
        return words == "set robotmode freedrive"
    return True


class _Compilation(threading.Thread):
    """Compilation of one long program.

    Attributes:
        queue: Queue from which the program was taken.
        text: Text of the program.
        result: Script or error; None until the compilation has ended.
    """

    def __init__(self, queue: ProgramQueue, text: str, firmware: Firmware, on_end: Callable[[], object]) -> None:
        super().__init__(name="urlink sim compiling", daemon=True)
        self.queue = queue
        self.text = text
        self.result: Script | ProgramError | None = None
        self._firmware = firmware
        self._on_end = on_end

    def run(self) -> None:
        self.result = _compiled(self.text, self._firmware)
        self._on_end()


class ProgramQueue:
    """Queue of the programs that one client has sent and that have not begun. It is made by `ProgramLoader.open`."""

    def __init__(self, loader: ProgramLoader) -> None:
        self._loader = loader
        self.texts: deque[str] = deque()
        #: Number of characters in all queued texts.
        self.length = 0

    def put(self, text: str) -> bool:
        """Add a complete program or a line. If the queue is full, discard the text and return False."""
        if self.length + len(text) > MOST_WAITING:
            return False
        self.texts.append(text)
        self.length += len(text)
        self._loader.serve(self)
        return True

    def take(self) -> str:
        """Remove and return the next text."""
        text = self.texts.popleft()
        self.length -= len(text)
        return text

    def clear(self) -> None:
        """Discard all texts."""
        self.texts.clear()
        self.length = 0


class ProgramLoader:
    """Loader that compiles and starts the programs which the clients of one controller have sent.

    The compilation of long programs runs in another thread. Everything else runs in the thread that owns the
    controller.

    Args:
        state: State of the controller.
        runner: Runner that runs the programs.

    Attributes:
        on_compiled: Function that is called from another thread when `advance` has work to do.
    """

    def __init__(self, state: ControllerState, runner: ProgramRunner) -> None:
        self.on_compiled: Callable[[], object] = lambda: None
        self._state = state
        self._runner = runner
        # Queues that are not empty. The first queue is served next.
        self._queues: deque[ProgramQueue] = deque()
        self._compilation: _Compilation | None = None
        # Latest cycle in which programs were compiled, and number of characters compiled in this cycle.
        self._cycle = -1
        self._spent = 0

    @property
    def is_waiting(self) -> bool:
        """Whether any queued program waits only for the next cycle, and not for a compilation of the same client."""
        return any(queue.texts and not self._compiles(queue) for queue in self._queues)

    @property
    def is_busy(self) -> bool:
        """Whether `advance` might have work to do."""
        return bool(self._queues) or self._compilation is not None

    def open(self) -> ProgramQueue:
        """Return a queue for a new client."""
        return ProgramQueue(self)

    def load(self, text: str) -> None:
        """Compile a complete program or a line, and start it before this call returns."""
        if self._may_load(text):
            self._begin(text, _compiled(text, self._state.firmware))

    def advance(self) -> None:
        """Start the long program that was compiled, and the programs that have waited for this cycle."""
        compilation = self._compilation
        if compilation is not None and compilation.result is not None:
            self._compilation = None
            self._begin(compilation.text, compilation.result)
        for _ in range(len(self._queues)):
            queue = self._queues.popleft()
            self.serve(queue)

    def serve(self, queue: ProgramQueue) -> None:
        """Start as many programs of one client as this cycle allows; `advance` starts the rest."""
        if self._cycle != self._state.cycle:
            self._cycle, self._spent = self._state.cycle, 0
        texts = queue.texts
        while texts and not self._compiles(queue) and self._spent < BUDGET:
            if len(texts[0]) < LONG:
                text = queue.take()
                self._spent += max(len(text), LEAST)
                self.load(text)
            elif self._compilation is not None:
                break
            elif self._may_load(text := queue.take()):
                self._compilation = _Compilation(queue, text, self._state.firmware, self.on_compiled)
                self._compilation.start()
        if (texts or self._compiles(queue)) and queue not in self._queues:
            self._queues.append(queue)

    def clear(self) -> None:
        """Discard all programs, because the controller goes down."""
        for queue in self._queues:
            queue.clear()
        self._queues.clear()
        self._compilation = None

    def close(self) -> None:
        """Discard all programs, and wait until the compilation has ended."""
        compilation = self._compilation
        self.clear()
        if compilation is not None:
            clock.join(compilation, _JOIN_TIMEOUT)

    def _compiles(self, queue: ProgramQueue) -> bool:
        """Whether a long program of this client is being compiled, so that later programs of the client must wait."""
        return self._compilation is not None and self._compilation.queue is queue

    def _may_load(self, text: str) -> bool:
        """Execute the text if it is a command. Return whether it is a program that the controller accepts now."""
        state = self._state
        if not state.is_up:
            return self._refuse("the controller is down", text)
        if state.is_local:
            return self._refuse("the controller is in local control", text)
        return not obey(state, self._runner, text)

    def _begin(self, text: str, compiled: Script | ProgramError) -> None:
        state = self._state
        if isinstance(compiled, ProgramError):
            state.outbox.put(messages.runtime_exception(state, compiled, is_running=False))
        elif compiled.kind == "sec":
            if not self._runner.start_secondary(compiled, len(text)):
                self._refuse("too many secondary programs are queued", text)
        elif not state.modes.may_move:
            self._refuse("the arm may not move", text)
        else:
            self._runner.start(compiled)

    def _refuse(self, why: str, text: str) -> bool:
        self._state.counters.refused_programs += 1
        _log.info("program ignored: %s: %.60r", why, text)
        return False


def _compiled(text: str, firmware: Firmware) -> Script | ProgramError:
    try:
        return compile_script(text, firmware)
    except ProgramError as error:
        return error
