"""The teach pendant of a simulated controller: the programs that were saved at it, its buttons, its popup and its log.

A dashboard presses the same buttons. That a reboot closes the popup and unloads the program, and leaves files and log
as they are, is a guess.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING

from ..interfaces.enums import ProgramState
from .motion import Still
from .urscript import ScriptError, compile_script

if TYPE_CHECKING:
    from .controller import Controller

__all__ = ["Pendant"]

_log = logging.getLogger("urlink.simulator")


class Pendant:
    """The pendant of one controller. Its buttons are only for the thread that owns the controller.

    Attributes:
        files: path -> URScript of the programs that can be loaded; a real one loads what was saved at it.
        loaded: path of the program that `play` runs, or None.
        popup: text that it shows, or None.
        log: lines that were added by the dashboard.
    """

    def __init__(self, controller: Controller, files: Mapping[str, str]) -> None:
        self._controller = controller
        self.files = dict(files)
        self.loaded: str | None = None
        self.popup: str | None = None
        self.log: list[str] = []

    def restart(self) -> None:
        """The controller comes up."""
        self.loaded = self.popup = None

    def load(self, path: str) -> bool:
        """Load one of the `files`; False if there is none of that name."""
        if path not in self.files:
            return False
        self.stop()
        self.loaded = path
        return True

    def play(self) -> bool:
        """Go on with the program that was paused, or run the loaded one; False if neither can be."""
        controller = self._controller
        programs = controller.programs
        if not controller.is_up or not controller.modes.may_move:
            return False
        if programs.is_paused:
            programs.is_paused = False
            controller.show_modes()
            return True
        if self.loaded is None or controller.program_name is not None:
            return False
        try:
            programs.run(compile_script(self.files[self.loaded], controller.firmware))
        except ScriptError as error:
            _log.info("%s does not compile: %s", self.loaded, error)
            return False
        return True

    def pause(self) -> bool:
        """Let the arm stand and its program wait; False if none plays."""
        controller = self._controller
        if controller.modes.program_state is not ProgramState.PLAYING:
            return False
        controller.programs.is_paused = True
        controller.show_modes()
        return True

    def stop(self) -> bool:
        """End what the arm follows, the demonstration too; False if that is nothing."""
        controller = self._controller
        if not controller.programs.stop():
            if not controller.arm.motion.is_program:
                return False
            controller.programs.is_paused = False
            controller.arm.follow(Still())
        controller.show_modes()
        return True
