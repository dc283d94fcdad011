"""`execute_trajectory` and `home`: motions as generators, which a client asks for their next state."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import RobotRaconteur as RR

from linkcore import clock
from urlink import BadValue, LinkError, Motion, Trajectory
from urlink.arm.urdf import JOINTS as JOINT_NAMES

from .errors import raised

__all__ = ["MotionGenerator", "read_trajectory"]

#: rad that a joint may be off at the end, where the last waypoint does not say.
_GOAL_TOLERANCE = 0.01
#: Seconds after which a generator tells that a motion goes on.
_TELL = 0.1


def read_trajectory(node: Any, trajectory: Any, here: Any) -> tuple[Trajectory, float | None, float]:
    """A trajectory of the library, and the tolerances that came with it: on the way, if there is one, and at the end.

    Where the first waypoint is not at time 0, the trajectory begins where the arm is.

    Raises:
        BadValue: other joints, other units, or what `Trajectory` refuses.
    """
    names = list(trajectory.joint_names or [])
    if names and names != list(JOINT_NAMES):
        raise BadValue(f"joint_names={names}; expected {list(JOINT_NAMES)}, or none")
    units = node.GetConstants("com.robotraconteur.robotics.joints")["JointPositionUnits"]
    if any(unit not in (units["implicit"], units["radian"]) for unit in trajectory.joint_units or []):
        raise BadValue("joint_units: expected radian")
    waypoints = list(trajectory.waypoints or [])
    time_from_start = [float(point.time_from_start) for point in waypoints]
    q = [_numbers(point.joint_position) for point in waypoints]
    qd = [_numbers(point.joint_velocity) for point in waypoints]
    if time_from_start and time_from_start[0] > 0.0:
        time_from_start.insert(0, 0.0)
        q.insert(0, _numbers(here))
        qd.insert(0, [0.0] * 6 if qd[0] else [])
    followed = Trajectory.from_arrays(time_from_start, q, qd if qd and all(qd) else None)
    # The library has one tolerance for all joints: the strictest. Zero, or none, stands for the default.
    return followed, _least(waypoints[1:-1]), _least(waypoints[-1:]) or _GOAL_TOLERANCE


def _numbers(values: Any) -> list[float]:
    return [] if values is None else np.asarray(values, dtype=np.float64).tolist()


def _least(waypoints: list[Any]) -> float | None:
    given = [value for point in waypoints for value in _numbers(point.position_tolerance) if value > 0.0]
    return min(given, default=None)


class MotionGenerator:
    """A motion that begins when its next state is asked for first, and is cancelled where the generator is closed.

    Args:
        begin: begins it.
        state: the structure that a client gets, of its `ActionStatusCode` and the seconds since it began.
        codes: `ActionStatusCode`.
    """

    def __init__(self, begin: Callable[[], Motion], state: Callable[[int, float], Any], codes: dict[str, int]) -> None:
        self._begin = begin
        self._state = state
        self._codes = codes
        self._lock = threading.Lock()
        self._motion: Motion | None = None
        self._began = 0.0
        self._is_over = False

    def Next(self) -> Any:  # noqa: N802
        """How far it has got; waits for the end, but no longer than 0.1 s."""
        with self._lock:
            if self._is_over:
                raise RR.StopIterationException("the motion is over")
            try:
                if self._motion is None:
                    self._motion = self._begin()
                    self._began = clock.now()
                    return self._state(self._codes["running"], 0.0)
                until = clock.now() + _TELL
                while not self._motion.done and clock.now() < until:
                    clock.sleep(0.005)
                if self._motion.error is not None:
                    raise self._motion.error
            except LinkError as error:
                self._is_over = True
                raise raised(error) from error
            self._is_over = self._motion.done
            return self._state(self._codes["complete" if self._is_over else "running"], clock.now() - self._began)

    def Close(self) -> None:  # noqa: N802
        """Give it up."""
        motion = self._motion
        if motion is not None:
            motion.cancel()

    def Abort(self) -> None:  # noqa: N802
        """Give it up."""
        self.Close()
