"""Generators of `execute_trajectory` and `home`: a client asks them for the next state of a motion."""

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

#: Tolerance of a joint at the end, in rad, if the last waypoint does not give one.
_GOAL_TOLERANCE = 0.01
#: Time, in s, after which a generator reports that the motion is still running.
_TELL = 0.1


def read_trajectory(node: Any, trajectory: Any, here: Any) -> tuple[Trajectory, float | None, float]:
    """Return the trajectory, its tolerance on the path (or None), and its tolerance at the end.

    If the first waypoint is not at time 0, the trajectory starts at the current position of the arm.

    Raises:
        BadValue: If joints or units differ, or `Trajectory` rejects the waypoints.
    """
    names = list(trajectory.joint_names or [])
    if names and names != list(JOINT_NAMES):
        raise BadValue(f"joint_names={names}; expected {list(JOINT_NAMES)} or no names")
    units = node.GetConstants("com.robotraconteur.robotics.joints")["JointPositionUnits"]
    if any(unit not in (units["implicit"], units["radian"]) for unit in trajectory.joint_units or []):
        raise BadValue("unsupported joint_units; expected radian")
    waypoints = list(trajectory.waypoints or [])
    time_from_start = [float(point.time_from_start) for point in waypoints]
    q = [_numbers(point.joint_position) for point in waypoints]
    qd = [_numbers(point.joint_velocity) for point in waypoints]
    if time_from_start and time_from_start[0] > 0.0:
        time_from_start.insert(0, 0.0)
        q.insert(0, _numbers(here))
        qd.insert(0, [0.0] * 6 if qd[0] else [])
    followed = Trajectory.from_arrays(time_from_start, q, qd if qd and all(qd) else None)
    # urlink has one tolerance for all joints, so take the strictest. Zero or no value selects the default.
    return followed, _least(waypoints[1:-1]), _least(waypoints[-1:]) or _GOAL_TOLERANCE


def _numbers(values: Any) -> list[float]:
    return [] if values is None else np.asarray(values, dtype=np.float64).tolist()


def _least(waypoints: list[Any]) -> float | None:
    given = [value for point in waypoints for value in _numbers(point.position_tolerance) if value > 0.0]
    return min(given, default=None)


class MotionGenerator:
    """Motion that starts at the first `Next`, and is cancelled when the generator is closed.

    Args:
        begin: Function that starts the motion.
        state: Function that returns the structure for the client, from `ActionStatusCode` and the time, in s, since the
            start.
        codes: Values of `ActionStatusCode`, by name.
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
        """Return the current state of the motion; wait at most 0.1 s for its end."""
        with self._lock:
            if self._is_over:
                raise RR.StopIterationException("the motion has ended")
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
        """Cancel the motion."""
        motion = self._motion
        if motion is not None:
            motion.cancel()

    def Abort(self) -> None:  # noqa: N802
        """Cancel the motion."""
        self.Close()
