"""Teach pendant of a simulated controller: saved programs and buttons.

Commands of the dashboard call the methods of the same object.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

from linkcore.errors import BadValue

from ...protocol.enums import ProgramState
from ..robot.generator import ArmDrive, OutOfReach
from ..state import ControllerState
from ..urscript import ProgramError, compile_script
from .runner import ProgramRunner

_log = logging.getLogger("urlink.simulator")


class Pendant:
    """Teach pendant of one controller. Call its methods only in the thread that owns the controller.

    Args:
        state: State of the controller.
        runner: Runner of its programs.
        files: Programs that can be loaded: path -> URScript.

    Attributes:
        files: Programs that can be loaded: path -> URScript. They represent the programs that were saved on a real
            pendant.
        directory: Directory of the programs, for relative paths: ``load("/programs/a.urp")`` loads the file `a.urp`.
    """

    def __init__(self, state: ControllerState, runner: ProgramRunner, files: Mapping[str, str]) -> None:
        self.files = dict(files)
        self.directory = "/programs"
        self._state = state
        self._runner = runner

    @property
    def loaded(self) -> str | None:
        """Path of the program that `play` runs, or None."""
        return self._state.loaded

    @property
    def popup(self) -> str | None:
        """Text of the popup that the pendant shows, or None. Set this property to None to close the popup."""
        return self._state.popup

    @popup.setter
    def popup(self, text: str | None) -> None:
        self._state.popup = text

    @property
    def log(self) -> list[str]:
        """Lines that the dashboard has added."""
        return self._state.log

    def load(self, path: str) -> bool:
        """Load one of the `files`.

        The path can be a key of `files`, or a path in `directory`; see `directory`.

        Returns:
            False if there is no such file.
        """
        name = path if path in self.files else path.removeprefix(f"{self.directory}/")
        if name not in self.files:
            return False
        self.stop()
        self._state.loaded = name
        return True

    def play(self) -> bool:
        """Continue the paused program, or start the loaded program; return False if neither is possible."""
        state = self._state
        if not state.is_up or not state.modes.may_move:
            return False
        if state.is_paused:
            state.is_paused, state.by_hand = False, None
            state.update_modes(0.0)
            return True
        if state.loaded is None or self._runner.program is not None:
            return False
        try:
            self._runner.start(compile_script(self.files[state.loaded], state.firmware))
        except ProgramError as error:
            _log.info("%s: does not compile: %s", state.loaded, error)
            return False
        return True

    def pause(self) -> bool:
        """Pause the program and stop the arm; return False if no program plays."""
        state = self._state
        if state.modes.program_state is not ProgramState.PLAYING:
            return False
        state.is_paused = True
        state.update_modes(0.0)
        return True

    def jog(self, q: Sequence[float], speed: float = 0.3) -> bool:
        """Begin to move the arm to six joint positions while no program plays. The arm stays there.

        Args:
            q: Joint positions, shape (6,), in rad.
            speed: Speed of the joint that moves furthest, in rad/s.

        Returns:
            False if a program plays, or the arm has not come to rest.

        Raises:
            BadValue: If `q` is not six finite numbers or is out of range, or `speed` is not a valid speed.
        """
        drive = self._drive()
        if drive is None:
            return False
        try:
            drive.generator.movej(q, 1.4, speed)
        except OutOfReach as error:
            raise BadValue(str(error)) from None
        self._state.by_hand = drive
        return True

    def freedrive(self, is_on: bool = True) -> bool:
        """Let the arm yield to external forces while no program plays, or let the arm hold its position again.

        Args:
            is_on: Whether the arm yields. If False, the arm holds its position again.

        Returns:
            False if a program plays, or the arm has not come to rest.
        """
        if not is_on:
            self._state.by_hand = None
            return True
        drive = self._drive()
        if drive is None:
            return False
        drive.freedrive((True,) * 6, (0.0,) * 6)
        self._state.by_hand = drive
        return True

    def _drive(self) -> ArmDrive | None:
        """Return a drive that moves the arm by hand; None if the arm may not move."""
        state = self._state
        plays = state.source.is_program and not state.is_paused
        if not (state.is_up and state.modes.may_move) or plays or state.arm.is_moving:
            return None
        return ArmDrive(state.arm, 1.0, state.scaling_parameters)

    def stop(self) -> bool:
        """End the running program; return False if there is none. See `ProgramRunner.stop_all`."""
        return self._runner.stop_all()
