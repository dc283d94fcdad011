"""A program that runs, seen from the controller."""

from __future__ import annotations

from .code import Script
from .errors import ScriptError
from .machine import Machine
from .world import World

__all__ = ["Execution"]


class Execution:
    """One run of a program.

    Attributes:
        script: the program.
        is_over: its main thread has ended, which ends the others, or it was stopped, or it failed.
        error: the run-time error that ended it.
    """

    def __init__(self, script: Script, world: World) -> None:
        self.script = script
        self.is_over = False
        self.error: ScriptError | None = None
        self._world = world
        self._machine = Machine(script, world)

    def advance(self) -> None:
        """One controller cycle: every thread runs until it waits for a later one."""
        if self.is_over:
            return
        try:
            self._machine.advance()
        except ScriptError as error:
            self.error = error
            self.stop()
        if self._machine.main.is_over:
            self.stop()

    def stop(self) -> None:
        """End all threads, let go of the arm and close the program's sockets."""
        if self.is_over:
            return
        self.is_over = True
        self._machine.stop()
        if self._machine.has_moved:
            self._world.motion.release()
        if self.script.kind == "def":
            self._world.sockets.close_all()
