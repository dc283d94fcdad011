"""Impedance: springs and dampers between the arm and a target, computed on the controller.

On firmware 5.23 or later (PolyScope X: 10.11 or later), the springs are attached to the joints or to the tool, and
direct torque produces their forces. On older firmware, the springs are attached to the tool only. They need a force
sensor in the wrist: the program moves the arm according to the measured force.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue

from ...arm.bounds import check_pose
from ...arm.vectors import FloatArray, Numbers
from ...protocol.realtime.packets import RealtimeState
from ...script.links import FOLLOW, Writer
from ...script.messages import packed
from ...script.springs import GAINS, LONGEST, POSTURE, RAMP
from ..context import MotionContext
from ..limited import STEP, LimitedArm
from ..moves.path import check_joint_positions, shown_tcp
from ..slider import SliderEffect, slider
from .block_motion import BlockMotion
from .impedance_parameters import ImpedanceParameters, damping_of, stiffness_of
from .jog import FrameName
from .linked_program import Link
from .setpoints import LinkDialogue

#: Step of a counter, and fraction of the messages that contain the gains or the posture. The step is not a simple
#: fraction. Therefore a program that receives only every n-th message still receives all kinds of messages.
_GOLDEN, _GAINS_SHARE = 0.6180339887, 0.25
#: Largest time in s until the program has taken a target (chosen). An arm can swing beyond the speed of its aim. If it
#: exceeds this speed by up to the second number, as a share, speeds are limited in advance. Beyond that, the arm is
#: only watched.
_LATEST, _MOST_SWING = 0.1, 0.9


@slider(impedance=SliderEffect.SCALED)
class Impedance(BlockMotion):
    """Springs and dampers that pull the arm to a target; see `robot.motion.impedance`.

    Args:
        context: The robot.
        parameters: Parameters as the user passed them.
        open_link: Function that opens the link to the program.

    Raises:
        BadValue, LocalError: If an argument is rejected; see `Motions.impedance`.

    Attributes:
        frame: "joints" for springs of the joints; "base" or "tool" for springs of the tool along the axes of this
            frame.
    """

    def __init__(self, context: MotionContext, parameters: ImpedanceParameters, open_link: Callable[[], Link]) -> None:
        parameters = parameters.slowed(context.limits)
        firmware, model = context.who.identity.firmware, context.who.identity.arm
        body, stiffness, has_posture = parameters.program(firmware, model)
        damping = damping_of(parameters.frame, parameters.damping).tolist()
        self.frame: FrameName = parameters.frame
        self._tcp: FloatArray | None = None
        self._messages = _Messages(body, stiffness.tolist(), damping, has_posture=has_posture)
        super().__init__(context, "impedance", self._messages, open_link)
        self._limited: LimitedArm | None = None
        self._fastest = RAMP * float(parameters.fastest().max())
        self._ramp: _Ramp | None = None

    def _seconds_to(self, target: Sequence[float]) -> float:
        """Return the shortest duration of the movement to a target within the limits of the session, in s.

        Raises:
            LimitExceeded: If the target, or the straight way to it, is outside of the box.
        """
        if self._limited is None:
            self._limited = self._context.limited()
        limited = self._limited
        if limited is None:
            return 0.0
        if self.frame != "joints":
            limited.limits.check_places(np.array([target[:3]]))
            return 0.0
        now, end = self._context.clock(), np.array(target)
        shortest = seconds = 0.0
        begins = [limited.q] if self._ramp is None else self._ramp.places(now)
        for begin in begins:
            way = end - begin
            parts = np.linspace(0.0, 1.0, max(math.ceil(float(np.abs(way).sum()) / STEP), 1) + 1)[:, np.newaxis]
            rows = begin + parts * way
            limited.check(rows)
            seconds = max(seconds, limited.shortest(rows, _swing(min(self._messages.gains[1])) * way))
            shortest = max(shortest, seconds, float(np.abs(way).max()) / self._fastest)
        longest = max(shortest, LONGEST) + _LATEST
        self._ramp = _Ramp(begins[-1], end, now, shortest, longest)
        return seconds

    @property
    def target(self) -> FloatArray | None:
        """Target as joint positions, (6,) rad, or as a pose of the tool; None before the first target.

        Until the first target, the springs hold the arm at its position.
        """
        return None if self._messages.target is None else np.array(self._messages.target)

    @property
    def posture(self) -> FloatArray | None:
        """Joint positions that the posture springs pull to, (6,) rad.

        None before the first target, and always None for springs of the joints.
        """
        return None if self._messages.posture is None else np.array(self._messages.posture)

    @property
    def stiffness(self) -> FloatArray:
        """Newest stiffness, (6,), in Nm/rad.

        For springs of the tool, the stiffness is in N/m along the axes of the frame, and in Nm/rad about these axes.
        """
        return np.array(self._messages.gains[0])

    @property
    def damping(self) -> FloatArray:
        """Newest damping ratios, (6,); 1 is critical damping."""
        return np.array(self._messages.gains[1])

    def send(self, target: Numbers, posture: Numbers | None = None) -> None:
        """Pull the arm to a target from now on.

        Targets may be sent at any rate: 10 or 500 per second, or only once. The program moves to each target in the
        time between the last targets. Therefore the arm is about one such interval behind the targets. The program
        never moves faster than 0.7 of the largest speed. The tool turns to an orientation by the shorter rotation.

        Args:
            target: Joint positions, shape (6,), in rad. With the frame "base" or "tool", the pose of the TCP in the
                base frame.
            posture: Joint positions that the posture springs pull to, shape (6,), in rad. They apply in addition to a
                pose. If None, urlink uses the inverse-kinematics solution of the pose that is closest to the previous
                posture.

        Raises:
            BadValue: If these are not six numbers, if a number is out of the range of its joint, or if a posture is
                passed for springs of the joints or without direct torque. In this case and in the cases below, the
                target does not change.
            Unreachable: If the tool cannot reach this pose.
            LimitExceeded: If the target, or the straight way to it, leaves the box of the session. If the session
                limits the speed, the program moves to the target as slowly as necessary.
            LinkError: If the impedance has ended; the error states the reason.
            LocalError: If called outside the ``with`` block.
        """
        self._check_open()
        identity = self._context.who.identity
        if posture is not None and not self._messages.has_posture:
            raise BadValue("posture applies only to springs of the tool with direct torque; omit it")
        if self.frame == "joints":
            values = check_joint_positions(target, "target", identity.arm).tolist()
            self._messages.lead(values, None, self._seconds_to(values))
            return
        goal, state = check_pose(target, "target"), self._context.state()
        if self._tcp is None:
            self._tcp = shown_tcp(identity.kinematics, state)
        near = state.q_actual if self._messages.posture is None else self._messages.posture
        bent = identity.kinematics.inverse(goal, near, self._tcp)
        wanted = bent if posture is None else check_joint_positions(posture, "posture", identity.arm)
        self._messages.lead(goal.tolist(), wanted.tolist(), self._seconds_to(goal.tolist()))

    def set_gains(self, stiffness: ArrayLike | None = None, damping: ArrayLike | None = None) -> None:
        """Change stiffness and damping gradually, within a few tenths of a second.

        Args:
            stiffness: Stiffness in Nm/rad, or for springs of the tool in N/m and Nm/rad: one number for all axes, or
                shape (6,). If None, the stiffness does not change.
            damping: Damping ratio, one number or shape (6,). If None, the damping ratio does not change.

        Raises:
            BadValue: If a number is out of range. The gains do not change.
            LinkError: If the impedance has ended; the error states the reason.
            LocalError: If called outside the ``with`` block.
        """
        self._check_open()
        old = self._messages.gains
        self._messages.gains = (
            old[0] if stiffness is None else stiffness_of(self.frame, stiffness).tolist(),
            old[1] if damping is None else damping_of(self.frame, damping).tolist(),
        )


@dataclass(frozen=True)
class _Ramp:
    """Movement of the aim in the program to the newest target, as far as this computer knows it.

    Attributes:
        begin, end: Positions of the joints at both ends, (6,) rad.
        since: Monotonic time at which the target was sent, in s.
        shortest, longest: Bounds of the time until the aim arrives, in s.
    """

    begin: FloatArray
    end: FloatArray
    since: float
    shortest: float
    longest: float

    def places(self, now: float) -> list[FloatArray]:
        """Return the foremost and the rearmost position that the aim can have now, (6,) rad each."""
        passed = now - self.since
        parts = [min(passed / each, 1.0) if each > 0.0 else 1.0 for each in (self.shortest, self.longest)]
        return [self.begin + part * (self.end - self.begin) for part in parts]


def _swing(ratio: float) -> float:
    """Return the largest speed of a damped arm behind an aim that changes its speed, relative to the speed of the aim.

    The arm is a spring with a damper that brakes its speed relative to the aim. The response of its speed to a sudden
    speed of the aim swings by the share `r` beyond it, and then by smaller and smaller shares. In the worst case, the
    aim changes its direction in time with all these swings.

    Args:
        ratio: Damping ratio.
    """
    angle = math.acos(min(ratio, 1.0))
    r = math.exp(-2.0 * ratio * angle / math.sin(angle)) if angle > 1e-6 else math.exp(-2.0)
    return (1.0 + r) / (1.0 - min(r, _MOST_SWING))


class _Messages(LinkDialogue):
    """Dialogue with the program of an impedance. It answers each state with the target, the gains or the posture.

    Attributes:
        target, posture: Newest target and posture, shape (6,); None before the first target.
        gains: Stiffness and damping, shape (6,) each. Any thread may set them.
        has_posture: Whether the program accepts a posture.
    """

    def __init__(
        self, write: Writer, stiffness: Sequence[float], damping: Sequence[float], *, has_posture: bool
    ) -> None:
        super().__init__(write)
        self.gains = list(stiffness), list(damping)
        self.has_posture = has_posture
        self._goal: tuple[int, list[float], list[float] | None, float] = (0, [0.0] * 6, None, 0.0)
        self._turn = 0.0

    @property
    def target(self) -> list[float] | None:
        number, values, _, _ = self._goal
        return values if number else None

    @property
    def posture(self) -> list[float] | None:
        return self._goal[2]

    def lead(self, target: list[float], posture: list[float] | None, seconds: float) -> None:
        """Set another target and posture, and the shortest duration of the movement to the target, in s."""
        self._goal = (self._goal[0] % 1000 + 1, target, posture, seconds)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        self._turn = (self._turn + _GOLDEN) % 1.0
        number, target, posture, seconds = self._goal
        counted = [float(number), seconds, 0.0, 0.0, 0.0, 0.0]
        if self.has_posture and posture is not None and self._turn < 0.5 * _GAINS_SHARE:
            return packed(posture, counted, POSTURE)
        if self._turn < _GAINS_SHARE:
            stiffness, damping = self.gains
            return packed([each / 1000.0 for each in stiffness], damping, GAINS)
        return packed(target, counted, FOLLOW)
