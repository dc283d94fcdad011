"""Impedance: springs and dampers between the arm and a target, computed on the controller.

From 5.23 and 10.11 on by direct torque, of the joints or of the tool; before that of the tool, by the force that the
wrist measures, where it has a sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue

from ...arm.bounds import check_pose
from ...arm.vectors import FloatArray, Numbers
from ...protocol.realtime.packets import RealtimeState
from ...script.links import FOLLOW, Writer
from ...script.springs import GAINS, POSTURE
from ..context import MotionContext
from ..links.messages import packed
from ..moves.path import check_joint_positions, shown_tcp
from ..slider import SliderEffect, slider
from .block_motion import BlockMotion
from .impedance_parameters import ImpedanceParameters, damping_of, stiffness_of
from .jog import FrameName
from .linked_program import Link
from .setpoints import LinkDialogue

#: One message of so many has the gains or the posture. No simple fraction: a program that takes each n-th message meets
#: them all the same.
_GOLDEN, _GAINS_SHARE = 0.6180339887, 0.25


@slider(impedance=SliderEffect.SCALED)
class Impedance(BlockMotion):
    """Draws the arm to a target by springs and dampers; made by `robot.motion.impedance`.

    Args:
        context: the robot.
        parameters: what it was asked for.
        open_link: opens the link to the program.

    Raises:
        BadValue, LocalError: as `Motions.impedance`.

    Attributes:
        frame: "joints", or of the axes of the springs of the tool: "base" or "tool".
    """

    def __init__(self, context: MotionContext, parameters: ImpedanceParameters, open_link: Callable[[], Link]) -> None:
        firmware, model = context.who.identity.firmware, context.who.identity.arm
        body, stiffness, has_posture = parameters.program(firmware, model)
        damping = damping_of(parameters.frame, parameters.damping).tolist()
        self.frame: FrameName = parameters.frame
        self._tcp: FloatArray | None = None
        self._messages = _Messages(body, stiffness.tolist(), damping, has_posture=has_posture)
        super().__init__(context, "impedance", self._messages, open_link)

    @property
    def target(self) -> FloatArray | None:
        """(6,) rad of the joints, or the pose of the tool; None before the first, when the arm is held where it was."""
        return None if self._messages.target is None else np.array(self._messages.target)

    @property
    def posture(self) -> FloatArray | None:
        """(6,) rad that the joints are drawn to beside the tool; None before the first target, and without a tool."""
        return None if self._messages.posture is None else np.array(self._messages.posture)

    @property
    def stiffness(self) -> FloatArray:
        """(6,) as they were set last: Nm/rad, or N/m along and Nm/rad about the axes of the frame."""
        return np.array(self._messages.gains[0])

    @property
    def damping(self) -> FloatArray:
        """(6,) ratios, as they were set last; 1 is critical."""
        return np.array(self._messages.gains[1])

    def send(self, target: Numbers, posture: Numbers | None = None) -> None:
        """Draw the arm to a target from now on, at any rate: 10 or 500 a second, or one for all.

        The program goes to each in as long as the last ones took to come, so it is about one interval behind, and never
        faster than 0.7 of the largest speed. Orientations are approached by the shorter rotation.

        Args:
            target: (6,) rad of the joints; or, with the frame "base" or "tool", the pose of the TCP in the base frame.
            posture: (6,) rad to which the joints are drawn beside such a pose; None for those of the pose that are
                closest to the posture before.

        Raises:
            BadValue: not six numbers, or out of the range of a joint; a posture for joints, or without direct torque.
                The target is as before, here and below.
            Unreachable: the tool cannot get to this pose.
            LinkError: the impedance is over; the error says why.
            LocalError: not within the block.
        """
        self._check_open()
        identity = self._context.who.identity
        if posture is not None and not self._messages.has_posture:
            raise BadValue("a posture is for springs of the tool by direct torque; expected none")
        if self.frame == "joints":
            self._messages.lead(check_joint_positions(target, "target", identity.arm).tolist(), None)
            return
        goal, state = check_pose(target, "target"), self._context.state()
        if self._tcp is None:
            self._tcp = shown_tcp(identity.kinematics, state)
        near = state.q_actual if self._messages.posture is None else self._messages.posture
        bent = identity.kinematics.inverse(goal, near, self._tcp)
        wanted = bent if posture is None else check_joint_positions(posture, "posture", identity.arm)
        self._messages.lead(goal.tolist(), wanted.tolist())

    def set_gains(self, stiffness: ArrayLike | None = None, damping: ArrayLike | None = None) -> None:
        """Go over to another stiffness and damping, within some tenths of a second.

        Args:
            stiffness: Nm/rad, or N/m and Nm/rad of the tool, of all axes or (6,) of each; None leaves it.
            damping: ratio, likewise.

        Raises:
            BadValue: out of range; the gains are as before.
            LinkError: the impedance is over; the error says why.
            LocalError: not within the block.
        """
        self._check_open()
        old = self._messages.gains
        self._messages.gains = (
            old[0] if stiffness is None else stiffness_of(self.frame, stiffness).tolist(),
            old[1] if damping is None else damping_of(self.frame, damping).tolist(),
        )


class _Messages(LinkDialogue):
    """The dialogue with the program: each state is answered with the target, or with the gains or the posture.

    Attributes:
        target, posture: (6,) sent last; None before.
        gains: stiffness and damping, (6,) each; may be set by any thread.
        has_posture: whether the program takes one.
    """

    def __init__(
        self, write: Writer, stiffness: Sequence[float], damping: Sequence[float], *, has_posture: bool
    ) -> None:
        super().__init__(write)
        self.gains = list(stiffness), list(damping)
        self.has_posture = has_posture
        self._goal: tuple[int, list[float], list[float] | None] = (0, [0.0] * 6, None)
        self._turn = 0.0

    @property
    def target(self) -> list[float] | None:
        number, values, _ = self._goal
        return values if number else None

    @property
    def posture(self) -> list[float] | None:
        return self._goal[2]

    def lead(self, target: list[float], posture: list[float] | None) -> None:
        """Go to another target."""
        self._goal = (self._goal[0] % 1000 + 1, target, posture)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        self._turn = (self._turn + _GOLDEN) % 1.0
        number, target, posture = self._goal
        counted = [float(number), 0.0, 0.0, 0.0, 0.0, 0.0]
        if self.has_posture and posture is not None and self._turn < 0.5 * _GAINS_SHARE:
            return packed(posture, counted, POSTURE)
        if self._turn < _GAINS_SHARE:
            stiffness, damping = self.gains
            return packed([each / 1000.0 for each in stiffness], damping, GAINS)
        return packed(target, counted, FOLLOW)
