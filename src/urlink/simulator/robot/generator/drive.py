"""Drive of one program: combines the motion generator with force mode and freedrive.

In force mode, the arm still follows the commands of the program along the axes that are not compliant. In freedrive
with all axes free, the commands of the program have no effect.

Two things are assumed. A stop ends force mode and freedrive, so a program that continues after the stop must begin the
mode again. If a motion is running when a mode ends, the motion continues from the current position of the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from urlink.arm.vectors import FloatArray
from urlink.protocol.enums import ControlMode

from ..arm import SimulatedArm
from ..characteristics import ScalingParameters
from ..setpoint_sources import Setpoint
from .compliance import Compliance, ForceTask, FreeJoints, free_tool
from .motion_generator import MotionGenerator

_ALL = (True,) * 6


class ArmDrive:
    """Generator of the set-points for one program.

    Args:
        arm: Arm to move. The drive continues from the current set-point of the arm, and in each cycle uses its current
            dynamics and external forces.
        scaling: Initial speed scaling.
        parameters: Parameters of the speed scaling.

    Attributes:
        generator: Motion generator, which executes the commands of the program.
        setpoint: Set-point of this cycle.
    """

    def __init__(self, arm: SimulatedArm, scaling: float, parameters: ScalingParameters) -> None:
        self.generator = MotionGenerator(arm.kinematics, arm.setpoint, scaling, parameters)
        self.setpoint = arm.setpoint
        self._arm = arm
        # Force mode or freedrive; None if neither is active.
        self._compliant: Compliance | FreeJoints | None = None
        self._mode = ControlMode.POSITION
        # Damping and gain of force mode that the program has set.
        self._damping, self._gain = ForceTask.damping, ForceTask.gain

    # -- modes -------------------------------------------------------------------------------------

    @property
    def yields(self) -> bool:
        """Whether force mode or freedrive is active, so that the arm can move without a command."""
        return self._compliant is not None

    @property
    def is_unchanging(self) -> bool:
        """Whether every later set-point equals the current one until another command begins."""
        return not self.yields and self.setpoint == self.generator.setpoint and self.generator.is_unchanging

    @property
    def control_mode(self) -> ControlMode:
        """Quantity that is controlled in this cycle, such as position or force."""
        return ControlMode.TORQUE if not self.yields and self.generator.follows_torque else self._mode

    def force_mode(self, task: ForceTask) -> None:
        """Begin force mode, or change the task of the active force mode."""
        task = replace(task, damping=self._damping, gain=self._gain)
        if isinstance(self._compliant, Compliance):
            self._compliant.task = task
        else:
            self.end_mode()
            self._compliant = Compliance(self.generator.arm, self.setpoint, task)
        self._mode = ControlMode.FORCE

    def set_damping(self, damping: float) -> None:
        """Set the damping (0 to 1) of the active force mode and of later ones."""
        self._damping = damping
        self._adjust()

    def set_gain(self, gain: float) -> None:
        """Set the gain (0 to 2) of the active force mode and of later ones."""
        self._gain = gain
        self._adjust()

    def _adjust(self) -> None:
        if isinstance(self._compliant, Compliance):
            self._compliant.task = replace(self._compliant.task, damping=self._damping, gain=self._gain)

    def freedrive(self, axes: Sequence[bool], frame: Sequence[float]) -> None:
        """Let a person move the arm by hand, along and about some axes of a frame.

        Args:
            axes: Whether each axis is free, shape (6,).
            frame: Pose of the frame in the base frame, shape (6,), in m and rad.
        """
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
        """Return the set-point one cycle of `seconds` later.

        Raises:
            LimitViolation: If the set-point would exceed a limit.
        """
        nominal = self.generator.advance(seconds)
        if isinstance(self._compliant, FreeJoints):
            self.setpoint = self._compliant.advance(self._arm.pushing_wrench, self._arm.pushed_joints, seconds)
        elif self._compliant is not None:
            wrench, torques = self._arm.wrench, self._arm.pushed_joints
            if any(torques):
                arm = self.generator.arm
                across = arm.kinematics.jacobian(self.setpoint.q, arm.tcp).T
                wrench = np.asarray(wrench) + np.linalg.lstsq(across, np.asarray(torques), rcond=None)[0]
            self.setpoint = self._compliant.advance(nominal, wrench, seconds)
        else:
            self.setpoint = nominal
        return self.setpoint

    def course(self, cycles: int, seconds: float) -> FloatArray | None:
        """See `MotionGenerator.course`."""
        return None if self.yields else self.generator.course(cycles, seconds)

    def advance_along(self, cycles: int, seconds: float, last: Setpoint) -> None:
        """Advance by this number of cycles of `course`, to the set-point `last`."""
        self.generator.advance_along(cycles, seconds, last)
        self.setpoint = last

    def glide(self, seconds: float) -> Setpoint | None:
        """See `MotionGenerator.glide`."""
        setpoint = None if self.yields else self.generator.glide(seconds)
        if setpoint is not None:
            self.setpoint = setpoint
        return setpoint

    def start(self, q: Sequence[float]) -> None:
        """Continue from rest at six joint positions, in rad, after a stop has braked the arm.

        Force mode and freedrive are ended.
        """
        self._compliant = None
        self._mode = ControlMode.POSITION
        self.generator.start(q)
        self.setpoint = self.generator.setpoint
