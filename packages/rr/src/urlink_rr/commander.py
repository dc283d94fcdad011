"""What clients ask of the arm: the command mode, the motion of one client, and commands that come by wire."""

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

#: Seconds without a new command by wire after which the arm is let stand.
_STALE = 0.25
#: Velocity commands a second that are passed on: each is a program that the controller has to read.
_VELOCITY_RATE = 25.0
#: Seconds for which a velocity holds where no other follows; the robot then brakes by itself.
_VELOCITY_HOLDS = 0.25
#: Codes of `JointPositionUnits` and `JointVelocityUnits` -> rad, or rad/s, for one of them.
_POSITION_UNITS = {0: 1.0, 2: 1.0, 3: np.pi / 180.0, 5: 2.0 * np.pi / 2**20}
_VELOCITY_UNITS = {0: 1.0, 17: 1.0, 18: np.pi / 180.0, 20: 2.0 * np.pi / 2**20}


class Commander:
    """The command modes of one robot.

    A mode is left by choosing another, and by the loss of the client that chose it: then what moves is cancelled, and
    the mode is "halt". A stop of the robot ends motions; the mode stays, and refuses new ones while the stop holds.

    Args:
        robot: what is moved.
        read: of "position_command" or "velocity_command", gives the newest value of that wire: number, command, codes
            of its units, endpoint of its client; None where there is none, or where it is too old.
        expiry: whether a command may have been given up.
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
        #: when a command came by the wire of the mode last, monotonic
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
        """The motion that a client has begun, as long as it is not over."""
        motion = self._motion
        return None if motion is None or motion.done else motion

    @property
    def is_commanded_by_wire(self) -> bool:
        """Commands arrive by the wire of the mode."""
        return clock.now() - self._heard < _STALE

    def choose(self, mode: str, endpoint: int) -> None:
        """Go over to another mode; what moves is cancelled.

        Raises:
            LinkError: the arm may not be moved now, or the command may have been given up; the mode is "halt" then.
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
        """Brake, and take no commands until another mode is chosen."""
        with self._changed:
            self._mode, self._owner = "halt", None
            motion, self._motion = self._motion, None
            self._changed.notify_all()
        if motion is not None:
            motion.cancel()

    def lost(self, endpoint: int) -> None:
        """A client is gone: what it has begun ends."""
        with self._changed:
            is_owner = endpoint == self._owner
        if is_owner:
            _log.warning("%s: the client in command is lost", self._robot.address)
            self.halt()

    def begin(self, mode: str, endpoint: int, move: Callable[[], Motion]) -> Motion:
        """Begin a motion, which a client may do that has chosen its mode.

        Raises:
            LocalError: another mode holds, or another client has chosen it.
            LinkError: whatever `move` raises.
        """
        with self._changed:
            if self._mode != mode:
                raise LocalError(f"the command mode is {self._mode}; {mode} has to be chosen first")
            if self._owner != endpoint:
                raise LocalError("another client is in command; choose the command mode anew to take over")
        self._expiry.check()
        motion = move()
        with self._changed:
            if self._mode == mode and self._owner == endpoint:
                self._motion = motion
                return motion
        motion.cancel()
        raise LocalError("the command mode was changed meanwhile")

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
                # A stop, a command that makes no sense or is too old: the next command tries again.
                _log.warning("%s: %s", self._robot.address, error)
                clock.sleep(0.1)

    def _next(self, mode: str, seen: int | None, seconds: float) -> tuple[int, Any] | None:
        """The next command that comes by the wire of a mode; None when time is up, or the mode is another."""
        units = _POSITION_UNITS if mode == "position_command" else _VELOCITY_UNITS
        until = clock.now() + seconds
        while self._mode == mode:
            found = self._read(mode)
            # Only of the client that chose the mode.
            if found is not None and found[3] == self._owner and found[0] != seen:
                self._expiry.check()
                self._heard = clock.now()
                return found[0], _in_radians(found[1], found[2], units)
            if clock.now() > until:
                return None
            clock.sleep(0.001)
        return None

    def _follow_positions(self) -> None:
        """Hand on what comes, by a servo that is open as long as commands come."""
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
    """Six numbers in rad or rad/s.

    Raises:
        BadValue: not six numbers, or a unit that is not known.
    """
    command = np.asarray(values, dtype=np.float64)
    given = np.asarray(codes if codes is not None and len(codes) else np.zeros(6), dtype=int)
    if command.shape != (6,) or given.shape != (6,) or not np.isfinite(command).all():
        raise BadValue(f"a command of {command.tolist()} in units {given.tolist()}; expected six finite numbers")
    unknown = [code for code in given.tolist() if code not in units]
    if unknown:
        raise BadValue(f"unit {unknown[0]} of a joint is not known; expected one of {', '.join(map(str, units))}")
    return command * np.array([units[code] for code in given.tolist()])
