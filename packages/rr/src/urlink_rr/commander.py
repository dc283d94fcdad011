"""Commands of clients to the arm: the command mode, the motion of one client, and commands by wire."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from linkcore import clock
from urlink import BadValue, Expiry, LinkError, LocalError, Motion, Robot
from urlink.motion import Servo

__all__ = ["Commander"]

_log = logging.getLogger("urlink.rr")

#: Time, in s, without a new command by wire after which the arm stops.
_STALE = 0.25
#: Maximum number of velocity commands to pass on per second: each is a program that the controller has to read.
_VELOCITY_RATE = 25.0
#: Time, in s, for which a velocity applies if no other follows; the robot then brakes on its own.
_VELOCITY_HOLDS = 0.25
#: Codes of `JointPositionUnits` and `JointVelocityUnits`, and the size of each unit in rad or rad/s.
_POSITION_UNITS = {0: 1.0, 2: 1.0, 3: np.pi / 180.0, 5: 2.0 * np.pi / 2**20}
_VELOCITY_UNITS = {0: 1.0, 17: 1.0, 18: np.pi / 180.0, 20: 2.0 * np.pi / 2**20}


class Commander:
    """Command modes of one robot.

    A mode ends when another mode is chosen, or when the client that chose it is lost. In both cases the current motion
    is cancelled; after a loss, the mode is "halt". A stop of the robot ends motions, but not the mode: new motions are
    refused while the stop lasts.

    Args:
        robot: Robot that is commanded.
        read: Function that returns the newest value of the wire "position_command" or "velocity_command": number,
            command, codes of its units, endpoint of its client. It returns None if there is no value, or if the value
            is too old.
        expiry: Check for commands that their client might have abandoned.
    """

    def __init__(self, robot: Robot, read: Callable[[str], tuple[int, Any, Any, int] | None], expiry: Expiry) -> None:
        self._robot = robot
        self._read = read
        self._expiry = expiry
        self._changed = threading.Condition()
        self._mode = "halt"
        self._owner: int | None = None
        self._motion: Motion | None = None
        self._is_closed = False
        #: monotonic time of the last command by the wire of the mode
        self._heard = -1e9
        self._thread = threading.Thread(target=self._follow_wires, name="urlink-rr commands", daemon=True)
        self._thread.start()

    # -- modes -----------------------------------------------------------------------------------------

    @property
    def mode(self) -> str:
        """Name of the `RobotCommandMode`."""
        return self._mode

    @property
    def motion(self) -> Motion | None:
        """Unfinished motion that a client started; None if there is none."""
        motion = self._motion
        return None if motion is None or motion.done else motion

    @property
    def is_commanded_by_wire(self) -> bool:
        """Whether commands are arriving over the wire of the current mode."""
        return clock.now() - self._heard < _STALE

    def choose(self, mode: str, endpoint: int) -> None:
        """Change to another mode; the current motion is cancelled.

        Raises:
            LinkError: If the arm must not move now, or the command might have been abandoned. The mode is "halt" then.
        """
        self.halt()
        if mode == "halt":
            return
        self._expiry.check()
        refusal = self._robot.safety.refusal
        if refusal is not None:
            raise refusal
        with self._changed:
            self._mode, self._owner = mode, endpoint
            self._changed.notify_all()

    def halt(self) -> None:
        """Brake, and accept no commands until another mode is chosen."""
        with self._changed:
            self._mode, self._owner = "halt", None
            motion, self._motion = self._motion, None
            self._changed.notify_all()
        if motion is not None:
            motion.cancel()

    def lost(self, endpoint: int) -> None:
        """End the motion of a client that is lost."""
        with self._changed:
            is_owner = endpoint == self._owner
        if is_owner:
            _log.warning("%s: halted: the client in command is lost", self._robot.address)
            self.halt()

    def begin(self, mode: str, endpoint: int, move: Callable[[], Motion]) -> Motion:
        """Start a motion for the client that chose its mode.

        Raises:
            LocalError: If another mode is active, or another client chose it.
            LinkError: If `move` raises it.
        """
        with self._changed:
            if self._mode != mode:
                raise LocalError(f"the command mode is {self._mode}; choose {mode} first")
            if self._owner != endpoint:
                raise LocalError("another client is in command; set the command mode again to take over")
        self._expiry.check()
        motion = move()
        with self._changed:
            if self._mode == mode and self._owner == endpoint:
                self._motion = motion
                return motion
        motion.cancel()
        raise LocalError("the command mode changed while the motion was starting; set it again")

    def close(self) -> None:
        """Halt, and end the thread."""
        self._is_closed = True
        self.halt()
        self._thread.join(5.0)

    # -- commands by wire ------------------------------------------------------------------------------

    def _follow_wires(self) -> None:
        while not self._is_closed:
            with self._changed:
                clock.wait(
                    partial(self._changed.wait_for, lambda: self._is_closed or self._mode.endswith("_command")), 1.0
                )
                mode = self._mode
            try:
                if mode == "position_command":
                    self._follow_positions()
                elif mode == "velocity_command":
                    self._follow_velocities()
            except LinkError as error:
                # A stop, or an invalid or old command. The next command tries again.
                _log.warning("%s: %s", self._robot.address, error)
                clock.sleep(0.1)

    def _next(self, mode: str, seen: int | None, seconds: float) -> tuple[int, Any] | None:
        """Return the next command of a mode's wire; None after the time limit or a change of mode."""
        units = _POSITION_UNITS if mode == "position_command" else _VELOCITY_UNITS
        until = clock.now() + seconds
        while self._mode == mode:
            found = self._read(mode)
            # Accept only commands of the client that chose the mode.
            if found is not None and found[3] == self._owner and found[0] != seen:
                self._expiry.check()
                self._heard = clock.now()
                return found[0], _in_radians(found[1], found[2], units)
            if clock.now() > until:
                return None
            clock.sleep(0.001)
        return None

    def _follow_positions(self) -> None:
        """Pass commands on to a servo, which stays open as long as commands arrive."""
        mode = "position_command"
        seen = self._read(mode)
        first = self._next(mode, None if seen is None else seen[0], 1.0)
        if first is None:
            return
        number, q = first
        servo: Servo = self._robot.motion.servo(watchdog=2.0 * _STALE)
        with servo:
            self._hold(mode, servo)
            while True:
                servo.send(q)
                following = self._next(mode, number, _STALE)
                if following is None:
                    return
                number, q = following

    def _follow_velocities(self) -> None:
        mode = "velocity_command"
        seen = self._read(mode)
        number = None if seen is None else seen[0]
        while True:
            following = self._next(mode, number, 1.0)
            if following is None:
                return
            number, qd = following
            motion = self._robot.motion.speed_joints(qd, duration=_VELOCITY_HOLDS)
            self._hold(mode, motion)
            clock.sleep(1.0 / _VELOCITY_RATE)

    def _hold(self, mode: str, motion: Motion) -> None:
        with self._changed:
            if self._mode == mode:
                self._motion = motion
                return
        with contextlib.suppress(LinkError):
            motion.cancel()


def _in_radians(values: Any, codes: Any, units: dict[int, float]) -> Any:
    """Convert a command of six numbers to rad or rad/s.

    Raises:
        BadValue: If there are not six numbers, or a unit is unknown.
    """
    command = np.asarray(values, dtype=np.float64)
    given = np.asarray(codes if codes is not None and len(codes) else np.zeros(6), dtype=int)
    if command.shape != (6,) or given.shape != (6,) or not np.isfinite(command).all():
        raise BadValue(f"the command is {command.tolist()} in units {given.tolist()}; expected six finite numbers")
    unknown = [code for code in given.tolist() if code not in units]
    if unknown:
        raise BadValue(f"unknown joint unit {unknown[0]}; expected one of {', '.join(map(str, units))}")
    return command * np.array([units[code] for code in given.tolist()])
