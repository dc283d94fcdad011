"""The teach pendant of a simulated controller: its saved programs and its buttons.

The dashboard presses the same buttons.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

from ...interfaces.enums import ProgramState
from ..state import ControllerState
from ..urscript import ScriptError, compile_script
from .runner import ProgramRunner

__all__ = ["Pendant"]

_log = logging.getLogger("urlink.simulator")


class Pendant:
    """The pendant of one controller. Its buttons may be pressed only in the thread that owns the controller.

    Args:
        state: of the controller.
        runner: of its programs.
        files: path -> URScript of the programs that can be loaded.

    Attributes:
        files: path -> URScript of the programs that can be loaded; a real one loads what was saved at it.
    """

    def __init__(self, state: ControllerState, runner: ProgramRunner, files: Mapping[str, str]) -> None:
        self.files = dict(files)
        self._state = state
        self._runner = runner

    @property
    def loaded(self) -> str | None:
        """Path of the program that `play` runs, or None."""
        return self._state.loaded

    @property
    def popup(self) -> str | None:
        """The text that it shows, or None. Setting it to None closes the popup."""
        return self._state.popup

    @popup.setter
    def popup(self, text: str | None) -> None:
        self._state.popup = text

    @property
    def log(self) -> list[str]:
        """Lines that were added by the dashboard."""
        return self._state.log

    def load(self, path: str) -> bool:
        """Load one of the `files`; False if there is none of that name."""
        if path not in self.files:
            return False
        self.stop()
        self._state.loaded = path
        return True

    def play(self) -> bool:
        """Continue the paused program, or run the loaded one; False if neither is possible."""
        state, main = self._state, self._runner.main
        if not state.is_up or not state.modes.may_move:
            return False
        if state.is_paused:
            state.is_paused = False
            state.update_modes(0.0)
            return True
        if state.loaded is None or (main is not None and main.is_program):
            return False
        try:
            self._runner.start(compile_script(self.files[state.loaded], state.firmware))
        except ScriptError as error:
            _log.info("%s does not compile: %s", state.loaded, error)
            return False
        return True

    def pause(self) -> bool:
        """Pause the program, and stop the arm; False if none plays."""
        state = self._state
        if state.modes.program_state is not ProgramState.PLAYING:
            return False
        state.is_paused = True
        state.update_modes(0.0)
        return True

    def stop(self) -> bool:
        """End what runs; False if nothing does. See `ProgramRunner.stop_all`."""
        return self._runner.stop_all()
