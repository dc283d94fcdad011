"""Inertia, torque constants and friction of the motors and gears in the joints of an arm.

    >>> from urlink.arm.motors import motors_of
    >>> motors_of("UR10e").rotor_inertias
    (5.9, 5.9, 1.862, 0.587, 0.587, 0.587)

The published masses do not include these values. The vendor makes joints in a few sizes, so known values of one arm
also apply to joints of the same size in other arms. The evidence and the possible error of each number are in
`urlink.arm.parameters`. If there is no log of an arm, the table contains values of similar arms.

The torque of a joint is the torque of the rigid bodies (`urlink.dynamics`) plus the inertia of its rotor times the
acceleration. Controllers report exactly this sum as `target_moment`. The motor current is this sum divided by the
torque constant, plus a current for friction. Controllers report this current as `target_current`, and as
`joint_control_output`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .models import Model, model
from .parameters import number, numbers, parameters
from .vectors import FloatArray

__all__ = ["FULL_SPEED", "Motors", "force_size", "friction", "joint_numbers", "joint_sizes", "motors_of"]

#: Speed in rad/s up to which Coulomb friction grows with the speed.
FULL_SPEED = number("friction_full_speed")


@dataclass(frozen=True)
class Motors:
    """Motors and gears of one arm, with values at the joints, from base to wrist 3.

    Attributes:
        rotor_inertias: Inertias of rotors and gears, multiplied by the square of the gear ratio, shape (6,), in kg m².
        torque_constants: Joint torques per motor current, shape (6,), in Nm per A.
        coulomb: Currents for the friction that does not depend on the speed, shape (6,), in A.
        viscous: Currents for the friction that grows with the speed, shape (6,), in A s/rad.
    """

    rotor_inertias: tuple[float, ...]
    torque_constants: tuple[float, ...]
    coulomb: tuple[float, ...]
    viscous: tuple[float, ...]

    def current(self, torque: Sequence[float], qd: Sequence[float]) -> list[float]:
        """Return the motor currents for given joint torques and speeds.

        Args:
            torque: Torques of rigid bodies and rotors, shape (6,), in Nm.
            qd: Joint speeds, shape (6,), in rad/s.

        Returns:
            Currents, shape (6,), in A.
        """
        return [
            float(m) / k + friction(c, b, v)
            for m, k, c, b, v in zip(torque, self.torque_constants, self.coulomb, self.viscous, qd, strict=True)
        ]

    def friction_torque(self, qd: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Return the friction torques in Nm, and their slopes in Nm s/rad, shape (6,), for speeds in rad/s."""
        constants = np.array(self.torque_constants)
        rub = [friction(c, b, v) for c, b, v in zip(self.coulomb, self.viscous, qd, strict=True)]
        rises = np.abs(qd) < FULL_SPEED
        slope = np.where(rises, np.array(self.coulomb) / FULL_SPEED, 0.0) + np.array(self.viscous)
        return constants * np.array(rub), constants * slope


def friction(coulomb: float, viscous: float, qd: float) -> float:
    """Return the friction current of a joint in A, as controllers compute it, for a speed in rad/s; zero at rest."""
    return coulomb * min(max(qd / FULL_SPEED, -1.0), 1.0) + viscous * qd


def joint_sizes(name: str) -> list[str]:
    """Return the sizes of the joints of an arm, as the table of parameters names them: "size 3" or "433 Nm"."""
    return [
        f"size {size}" if len(size) == 1 else f"{size} Nm" for size in parameters()["joint_sizes", name].value.split()
    ]


def force_size(name: str) -> str:
    """Return the row of the noise of the force in the table of parameters: the arm if it has one, or a joint size.

    The joint size is that of the base. Larger joints, for which the table has no noise, count as "size 4".
    """
    if ("force_noise", name) in parameters():
        return name
    size = joint_sizes(name)[0]
    return size if ("force_noise", size) in parameters() else "size 4"


def joint_numbers(parameter: str, name: str) -> tuple[float, ...]:
    """Return six values of a parameter: those of this arm if it was logged, or else those of its joint sizes."""
    known = parameters()
    if (parameter, name) in known:
        return numbers(parameter, name)
    return tuple(number(parameter, size if (parameter, size) in known else "other") for size in joint_sizes(name))


def motors_of(arm: Model | str) -> Motors:
    """Return the motors of an arm: logged values of this arm if there are any, else the values of its joint sizes.

    Raises:
        UnknownModel: If no arm has this name.
    """
    name = (arm if isinstance(arm, Model) else model(arm)).name
    return Motors(
        joint_numbers("rotor_inertia", name),
        joint_numbers("torque_constant", name),
        joint_numbers("coulomb_current", name),
        joint_numbers("viscous_current", name),
    )
