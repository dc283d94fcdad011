"""Makes the set-points of one program: its motion generator, and force mode or freedrive on top of it.

In force mode the program still commands the arm, which follows along the axes that are not compliant. In freedrive with
all axes free, commands of the program have no effect.

Guesses: a stop ends both modes, so that a program which continues after it has to begin them again; a movement that
runs when a mode ends continues from where the arm is then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from urlink.protocol.enums import ControlMode

from ..arm import SimulatedArm
from ..characteristics import ScalingParameters
from ..setpoint_sources import Setpoint
from .compliance import Compliance, ForceTask, FreeJoints, free_tool
from .motion_generator import MotionGenerator

_ALL = (True,) * 6


class ArmDrive:
    """Makes the set-points of one program.

    Args:
        arm: from whose present set-point it goes on; its dynamics, and what acts on it, are those of each cycle.
        scaling: with which it begins.
        parameters: of the scaling.

    Attributes:
        generator: executes the commands of the program.
        setpoint: that of this cycle.
    """

    def __init__(self, arm: SimulatedArm, scaling: float, parameters: ScalingParameters) -> None:
        self.generator = MotionGenerator(arm.kinematics, arm.setpoint, scaling, parameters)
        self.setpoint = arm.setpoint
        self._arm = arm
        # What leads the arm in force mode or freedrive.
        self._compliant: Compliance | FreeJoints | None = None
        self._mode = ControlMode.POSITION
        # Parameters of force mode, as a program has set them.
        self._damping, self._gain = ForceTask.damping, ForceTask.gain

    # -- modes -------------------------------------------------------------------------------------

    @property
    def yields(self) -> bool:
        """Whether force mode or freedrive is on, in which the arm moves without being commanded."""
        return self._compliant is not None

    @property
    def control_mode(self) -> ControlMode:
        """What is controlled in this cycle: position, force, ..."""
        return ControlMode.TORQUE if not self.yields and self.generator.follows_torque else self._mode

    def force_mode(self, task: ForceTask) -> None:
        """Begin force mode, or change its task."""
        task = replace(task, damping=self._damping, gain=self._gain)
        if isinstance(self._compliant, Compliance):
            self._compliant.task = task
        else:
            self.end_mode()
            self._compliant = Compliance(self.generator.arm, self.setpoint, task)
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
        if isinstance(self._compliant, Compliance):
            self._compliant.task = replace(self._compliant.task, damping=self._damping, gain=self._gain)

    def freedrive(self, axes: Sequence[bool], frame: Sequence[float]) -> None:
        """Let the arm be moved by hand, along and about these axes of a frame in the base frame, m and rad."""
        self.end_mode()
        if tuple(axes) == _ALL:
            self._compliant = FreeJoints(self.generator.arm, self._arm.dynamics, self.setpoint)
        else:
            self._compliant = Compliance(self.generator.arm, self.setpoint, free_tool(frame, axes))
        self._mode = ControlMode.TEACH

    def end_mode(self) -> None:
        """End force mode or freedrive."""
        if self.yields:
            self._compliant = None
            self._mode = ControlMode.POSITION
            self.generator.resume(self.setpoint)

    # -- time --------------------------------------------------------------------------------------

    def advance(self, seconds: float) -> Setpoint:
        """The set-point after a cycle of `seconds`.

        Raises:
            LimitViolation: it would break a limit.
        """
        nominal, wrench, torques = self.generator.advance(seconds), self._arm.wrench, self._arm.pushed_joints
        if isinstance(self._compliant, FreeJoints):
            self.setpoint = self._compliant.advance(wrench, torques, seconds)
        elif self._compliant is not None:
            if any(torques):
                arm = self.generator.arm
                across = arm.kinematics.jacobian(self.setpoint.q, arm.tcp).T
                wrench = np.asarray(wrench) + np.linalg.lstsq(across, np.asarray(torques), rcond=None)[0]
            self.setpoint = self._compliant.advance(nominal, wrench, seconds)
        else:
            self.setpoint = nominal
        return self.setpoint

    def start(self, q: Sequence[float]) -> None:
        """Continue from rest at six joint positions, rad, to which a stop has braked the arm; no mode is on."""
        self._compliant = None
        self._mode = ControlMode.POSITION
        self.generator.start(q)
        self.setpoint = self.generator.setpoint
