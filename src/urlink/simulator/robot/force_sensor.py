"""The force sensor of a simulated arm: what acts on the TCP, minus the offset of `zero`.

It measures the forces of the surroundings, and the weight of a load that the controller does not know; `zero` makes the
present value the new zero. That the offset turns with the tool, as with a sensor in the tool, is a guess for arms that
have none and compute the force from their currents. Forces are in N and Nm, in the directions of the base frame,
moments about the TCP; that they are those on the tool, and not those of the tool, is a guess too.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from urlink.dynamics import GRAVITY
from urlink.kinematics import Arm
from urlink.poses import rotvec_to_matrix
from urlink.vectors import FloatArray

from .sources import Setpoint
from .surroundings import Surroundings

__all__ = ["ForceSensor"]

# N at which a contact is detected, and below which it has not begun. The sensitivity of controllers is not published.
_NOTICED, _BEGUN = 5.0, 1.0
# Cycles that are kept.
_REMEMBERED = 500
_NONE = [0.0] * 6


class ForceSensor:
    """The sensor of one arm.

    Args:
        kinematics: of the arm.
        surroundings: what acts on it.

    Attributes:
        external: (6,) what acts on the TCP in this cycle, with the weight that the controller does not know.
        wrench: (6,) that, minus the offset.
        grows: whether the force at the TCP is above the limit, and larger than a cycle ago.
    """

    def __init__(self, kinematics: Arm, surroundings: Surroundings) -> None:
        self._kinematics = kinematics
        self._surroundings = surroundings
        self._offset: FloatArray | None = None  # in the frame of the TCP
        self._turn: list[float] = [0.0] * 3  # of the TCP in the base frame: a rotation vector
        self._felt: deque[tuple[float, float, float]] = deque(maxlen=_REMEMBERED)
        self.external: Sequence[float] = _NONE
        self.wrench: Sequence[float] = _NONE
        self.grows = False

    def advance(self, setpoint: Setpoint, tcp: Sequence[float], payload: float, cog: Sequence[float]) -> None:
        """Advance by one cycle, at these targets, with this tool and the load, kg and m, that the controller knows."""
        before = math.hypot(*self.wrench[:3])
        if self._surroundings.is_empty and self._offset is None:
            self.external = self.wrench = _NONE
            self._felt.clear()
        else:
            self._feel(setpoint, tcp, payload, cog)
            x, y, z = self.wrench[:3]
            self._felt.append((x, y, z))
        force = math.hypot(*self.wrench[:3])
        self.grows = force > max(self._surroundings.force_limit, before + 1e-6)

    def _feel(self, setpoint: Setpoint, tcp: Sequence[float], payload: float, cog: Sequence[float]) -> None:
        pose: list[float] = self._kinematics.forward(setpoint.q, tcp).tolist()
        velocity = _NONE
        if any(setpoint.qd):
            velocity = self._kinematics.velocity(setpoint.q, setpoint.qd, tcp).tolist()
        external = np.array(self._surroundings.wrench(pose[:3], velocity[:3]))
        self._turn = pose[3:]
        load = self._surroundings.load
        if load is not None:
            # From the frame of the flange to that of the TCP, of which the pose is known.
            turn, way = rotvec_to_matrix(tcp[3:]), np.array(tcp[:3])
            external += self._weight(load[0], turn.T @ (np.array(load[1]) - way))
            external -= self._weight(payload, turn.T @ (np.array(cog) - way))
        self.external = external.tolist()
        if self._offset is None:
            self.wrench = self.external
        else:
            rotation = rotvec_to_matrix(self._turn)
            self.wrench = (
                external - np.concatenate((rotation @ self._offset[:3], rotation @ self._offset[3:]))
            ).tolist()

    def _weight(self, mass: float, place: FloatArray) -> FloatArray:
        """The weight of a mass at a place in the frame of the TCP: force, and moment about the TCP."""
        force = np.array((0.0, 0.0, -GRAVITY * mass))
        return np.concatenate((force, np.cross(rotvec_to_matrix(self._turn) @ place, force)))

    def zero(self) -> None:
        """Make the present value the new zero; if nothing acts on the tool, the offset is zero."""
        self._offset = None
        self.wrench = _NONE
        if any(self.external):
            back, external = rotvec_to_matrix(self._turn).T, np.array(self.external)
            self._offset = np.concatenate((back @ external[:3], back @ external[3:]))

    def contact_steps(self, direction: Sequence[float]) -> int:
        """Cycles since a contact began that opposes a movement of the tool; 0 without one.

        Args:
            direction: (3,) of the movement in the base frame, of any length; zero for contacts of every direction.
        """
        length = math.hypot(*direction)

        def opposed(force: Sequence[float]) -> float:
            if length == 0.0:
                return math.hypot(*force)
            return -sum(f * d for f, d in zip(force, direction, strict=True)) / length

        if not self._felt or opposed(self._felt[-1]) < _NOTICED:
            return 0
        steps = 0
        for force in reversed(self._felt):
            if opposed(force) < _BEGUN:
                break
            steps += 1
        return steps
