"""The programs of a controller: the one that commands the arm, and the secondary ones that run beside it.

Guesses: that a text is ignored while the arm may not move, and on an e-Series that is not in remote control; that a
protective stop pauses a program, which `play` then continues, and that an emergency stop or switching off ends it; that
secondary programs run on through all of these.
"""

from __future__ import annotations

import logging
from collections import deque
from typing import TYPE_CHECKING

from . import messages
from .lines import obey
from .program import Program, ProgramWorld
from .urscript import Execution, Script, ScriptError, compile_script

if TYPE_CHECKING:
    from .controller import Controller

__all__ = ["Programs"]

_log = logging.getLogger("urlink.simulator")

#: Secondary programs that run at once; more than that wait until one of them is over. Nearly all are within a cycle.
MOST_SECONDARY = 32
#: Characters of the secondary programs that wait.
MOST_WAITING = 1 << 20


class Programs:
    """What runs on one controller.

    Attributes:
        main: the program that was started last, also when it is over; None before the first.
        is_paused: what the arm follows does not go on.
        refused: texts that were ignored because of the state that the controller was in.
    """

    def __init__(self, controller: Controller) -> None:
        self.main: Program | None = None
        self.is_paused = False
        self.refused = 0
        self._controller = controller
        self._secondary: list[tuple[Execution, ProgramWorld]] = []
        self._waiting: deque[tuple[Script, int]] = deque()

    @property
    def is_running(self) -> bool:
        """A program that was sent runs, so that every cycle counts."""
        return bool(self._secondary or self._waiting) or (self.main is not None and self.main.is_program)

    def take(self, text: str, compiled: Script | ScriptError | None = None) -> None:
        """A whole program, or a line, as a client has sent it, and what came of compiling it where that is done."""
        controller = self._controller
        if not controller.is_up:
            self._refuse("down", text)
            return
        if controller.firmware.is_e_series and not controller.remote_control:
            self._refuse("in local control", text)
            return
        if obey(controller, text):
            return
        if compiled is None:
            try:
                compiled = compile_script(text, controller.firmware)
            except ScriptError as error:
                compiled = error
        if isinstance(compiled, ScriptError):
            controller.say(messages.runtime_exception(controller, compiled.line, compiled.column, compiled.text, False))
        elif compiled.kind == "sec":
            self._await_turn(compiled, text)
        elif not controller.modes.may_move:
            self._refuse("the arm may not move", text)
        else:
            self.run(compiled)

    def run(self, script: Script) -> None:
        """Stop the running program and run this one."""
        controller = self._controller
        self.stop()
        self.is_paused = False
        self.main = Program(controller, script, self._ended)
        controller.say(messages.program_started(controller, script.name))
        controller.arm.hand_over(self.main)
        controller.show_modes()

    def stop(self) -> bool:
        """End the running program. False without one."""
        if self.main is None or not self.main.is_program:
            return False
        self.main.end()
        return True

    def advance(self) -> None:
        """One controller cycle, before that of the arm."""
        controller = self._controller
        modes = controller.modes
        if modes.holds_program:
            if self.main is not None and self.main.is_program:
                self.is_paused = True
        elif not modes.may_move:
            # The demonstration may have been paused.
            self.stop()
            self.is_paused = False
        if self._secondary or self._waiting:
            self._advance_secondary()

    def close(self) -> None:
        """End everything, as the controller goes down."""
        if self.main is not None:
            self.main.end()
        for execution, world in self._secondary:
            execution.stop()
            world.sockets.close_all()
        self._secondary.clear()
        self._waiting.clear()

    def _await_turn(self, script: Script, text: str) -> None:
        if sum(length for _, length in self._waiting) + len(text) > MOST_WAITING:
            self._refuse("too many secondary programs wait", text)
        else:
            self._waiting.append((script, len(text)))

    def _advance_secondary(self) -> None:
        while self._waiting and len(self._secondary) < MOST_SECONDARY:
            world = ProgramWorld(self._controller)
            self._secondary.append((Execution(self._waiting.popleft()[0], world), world))
        for execution, world in self._secondary:
            execution.advance()
            if execution.is_over:
                world.sockets.close_all()
                if execution.error is not None:
                    self._report(execution.error)
        self._secondary = [pair for pair in self._secondary if not pair[0].is_over]

    def _ended(self, program: Program) -> None:
        self.is_paused = False
        if program.execution.error is not None:
            self._report(program.execution.error)
        self._controller.say(messages.program_stopped(self._controller, program.name))

    def _report(self, error: ScriptError) -> None:
        controller = self._controller
        controller.say(messages.runtime_exception(controller, error.line, error.column, error.text, True))

    def _refuse(self, why: str, text: str) -> None:
        self.refused += 1
        _log.info("ignored, %s: %.60r", why, text)
