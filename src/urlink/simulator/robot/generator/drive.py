"""Makes the set-points of one program: its motion generator, and force mode or freedrive on top of it.

In force mode the program still commands the arm, which follows along the axes that are not compliant. In freedrive with
all axes free, commands of the program have no effect.

Guesses: a stop ends both modes, so that a program which continues after it has to begin them again; a movement that
runs when a mode ends continues from where the arm is then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from urlink.dynamics import Dynamics
from urlink.interfaces.enums import ControlMode
from urlink.kinematics import Arm

from ..robot_parameters import ScalingParameters
from ..sources import Setpoint
from .compliance import Compliance, ForceTask, FreeJoints, free_tool
from .motion_generator import MotionGenerator

_ALL = (True,) * 6


class ArmDrive:
    """Makes the set-points of one program.

    Args:
        kinematics: of the arm.
        dynamics: called for the masses of the arm with its present payload.
        setpoint: the present one.
        scaling: with which it begins.
        parameters: of the scaling.

    Attributes:
        generator: executes the commands of the program.
        setpoint: that of this cycle.
    """

    def __init__(
        self,
        kinematics: Arm,
        dynamics: Callable[[], Dynamics],
        setpoint: Setpoint,
        scaling: float,
        parameters: ScalingParameters,
    ) -> None:
        self.generator = MotionGenerator(kinematics, setpoint, scaling, parameters)
        self.setpoint = setpoint
        self._dynamics = dynamics
        self._compliance: Compliance | None = None
        self._free: FreeJoints | None = None
        self._mode = ControlMode.POSITION
        # Parameters of force mode, as a program has set them.
        self._damping, self._gain = ForceTask.damping, ForceTask.gain

    # -- modes -------------------------------------------------------------------------------------

    @property
    def yields(self) -> bool:
        """Whether force mode or freedrive is on, in which the arm moves without being commanded."""
        return self._compliance is not None or self._free is not None

    @property
    def control_mode(self) -> ControlMode:
        """What is controlled in this cycle: position, force, ..."""
        return ControlMode.TORQUE if not self.yields and self.generator.follows_torque else self._mode

    def force_mode(self, task: ForceTask) -> None:
        """Begin force mode, or change its task."""
        task = replace(task, damping=self._damping, gain=self._gain)
        if self._compliance is not None:
            self._compliance.task = task
        else:
            self.end_mode()
            self._compliance = Compliance(self.generator.arm, self.setpoint, task)
        self._mode = ControlMode.FORCE

    def set_damping(self, damping: float) -> None:
        """Set the damping of force mode, 0 to 1: of the present one, and of those that follow."""
        self._damping = damping
        self._adjust()

    def set_gain(self, gain: float) -> None:
        """Set the gain of force mode, 0 to 2; as `set_damping`."""
        self._gain = gain
        self._adjust()

    def _adjust(self) -> None:
        if self._compliance is not None:
            self._compliance.task = replace(self._compliance.task, damping=self._damping, gain=self._gain)

    def freedrive(self, axes: Sequence[bool], frame: Sequence[float]) -> None:
        """Let the arm be moved by hand, along and about these axes of a frame in the base frame, m and rad."""
        self.end_mode()
        if tuple(axes) == _ALL:
            self._free = FreeJoints(self.generator.arm, self._dynamics(), self.setpoint)
        else:
            self._compliance = Compliance(self.generator.arm, self.setpoint, free_tool(frame, axes))
        self._mode = ControlMode.TEACH

    def end_mode(self) -> None:
        """End force mode or freedrive."""
        if self.yields:
            self._compliance = self._free = None
            self._mode = ControlMode.POSITION
            self.generator.resume(self.setpoint)

    # -- time --------------------------------------------------------------------------------------

    def advance(self, seconds: float, wrench: Sequence[float], torques: Sequence[float]) -> Setpoint:
        """The set-point after a cycle of `seconds`.

        Args:
            wrench: (6,) what acts on the TCP, N and Nm in the base frame.
            torques: (6,) Nm, on the joints in addition.

        Raises:
            LimitViolation: it would break a limit.
        """
        nominal = self.generator.advance(seconds)
        if self._free is not None:
            self.setpoint = self._free.advance(wrench, torques, seconds)
        elif self._compliance is not None:
            if any(torques):
                arm = self.generator.arm
                across = arm.kinematics.jacobian(self.setpoint.q, arm.tcp).T
                wrench = np.asarray(wrench) + np.linalg.lstsq(across, np.asarray(torques), rcond=None)[0]
            self.setpoint = self._compliance.advance(nominal, wrench, seconds)
        else:
            self.setpoint = nominal
        return self.setpoint

    def start(self, q: Sequence[float]) -> None:
        """Continue from rest at six joint positions, rad, to which a stop has braked the arm; no mode is on."""
        self._compliance = self._free = None
        self._mode = ControlMode.POSITION
        self.generator.start(q)
        self.setpoint = self.generator.setpoint
