"""Motion generator: it converts the commands of a program to one set-point in each cycle.

Every command continues from the current motion, with a continuous speed. Path moves (movej, movel, movep, movec,
servoc) begin where the arm can come to rest, and a blend is added that takes over its speed. Speeds and stops change
the current speed. servoj follows its set-point from there.

A controller's algorithm is not published. So it is assumed how hard it brakes without a command, or when a path move
preempts another motion (a quarter of the model's acceleration).

The speed scaling stretches the time of every command except a stop. For the rate at which it changes, see
`ScalingParameters`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from linkcore.errors import BadValue
from urlink.arm.curves import Arc, Line
from urlink.arm.dynamics import Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.motors import Motors
from urlink.arm.vectors import FloatArray

from ..characteristics import ScalingParameters, approached
from ..setpoint_sources import BRAKING, REST, Setpoint
from .compliance import TorqueMotion
from .joint_limits import ArmWithTool, JointLimits, LimitViolation, OutOfReach, checked, positive
from .path_motion import Blend, Command, JointPath, MotionPath, PathMove, ToolPath, Trapezoid, timed
from .streamed_motion import JointSpeed, ServoMotion, ToolSpeed, lag_of

# Scaling above which servoj takes over the whole speed of the joints in its stretched time. Below it, a part is taken
# over.
_TAKES_OVER = 0.1
# Minimum length, in rad or m, for computing speed and acceleration from a time.
_SHORTEST = 1e-9
#: Length below which a path is considered to lead nowhere, in m or rad.
_NOTHING = 1e-12


class MotionGenerator:
    """Makes the set-points of six joints.

    Args:
        kinematics: Kinematics of the arm, with its limits.
        setpoint: Current set-point. The arm brakes until a command comes.
        scaling: Initial scaling.
        parameters: Parameters of the scaling.

    Attributes:
        setpoint: Set-point of this cycle.
        arm: Arm with its tool. A motion that has begun keeps its own copy.
        speed_fraction: Position of the speed slider, in [0, 1]. It scales everything except stops.
        scaling: Fraction of their speed with which commands are executed. It approaches `speed_fraction`.
    """

    def __init__(
        self,
        kinematics: Arm,
        setpoint: Setpoint,
        scaling: float = 1.0,
        parameters: ScalingParameters = ScalingParameters(),  # noqa: B008 -- it is frozen
    ) -> None:
        self.setpoint = setpoint
        self.speed_fraction = 1.0
        self.scaling = scaling
        self._parameters = parameters
        # The scaling rises from 0 at this rate, in 1/s, until it has reached the slider.
        self._rise = parameters.start_rate
        self.arm = ArmWithTool(kinematics, JointLimits(kinematics.model), list(REST))
        self._limits = self.arm.limits
        self._gentle = [BRAKING * limit for limit in self._limits.acceleration]
        self._command: Command | None = None
        self._refusal: LimitViolation | None = None
        if any(setpoint.qd):
            self.release()

    @property
    def tcp(self) -> list[float]:
        """TCP in the flange frame, in m and rad."""
        return list(self.arm.tcp)

    @tcp.setter
    def tcp(self, pose: Sequence[float]) -> None:
        self.arm = self.arm._replace(tcp=checked(pose, "a TCP"))

    @property
    def is_standing(self) -> bool:
        """Whether no joint moves or is about to move."""
        return (self._command is None or self._command.is_at_rest) and not any(self.setpoint.qd)

    @property
    def follows_torque(self) -> bool:
        """Whether torques move the joints in this cycle."""
        return isinstance(self._command, TorqueMotion) and not self._command.is_at_rest

    @property
    def waypoint(self) -> list[float] | None:
        """Pose of the TCP at the end of the current path move, in m and rad; None if there is none."""
        command = self._command
        return command.end_pose if isinstance(command, PathMove) and not command.is_at_rest else None

    # -- time --------------------------------------------------------------------------------------

    def advance(self, seconds: float) -> Setpoint:
        """Return the set-point after a cycle of `seconds`.

        Raises:
            LimitViolation: If the set-point would exceed a limit. The set-point then stays the same until another
                command or `start`.
        """
        if self._refusal is not None:
            raise self._refusal
        last = self.setpoint
        before = self.scaling
        rate = self._rise if before < self.speed_fraction else self._parameters.slider_rate
        self.scaling = approached(before, self.speed_fraction, rate * seconds)
        if self.scaling == self.speed_fraction:
            self._rise = self._parameters.slider_rate
        change = self.scaling - before
        if self._command is not None:
            try:
                setpoint = self._command.advance(last, seconds, self.scaling, change)
                self._limits.check(last, setpoint, seconds)
            except LimitViolation as refusal:
                self._refusal = refusal
                raise
            self.setpoint = setpoint
        return self.setpoint

    def start(self, q: Sequence[float]) -> None:
        """Continue from rest at six joint positions, in rad, after a stop has braked the arm.

        A path move continues to its end, and a speed is approached again. In three cases the command is discarded and
        the arm stays at rest: the command had ended, it has exceeded a limit, or it is a set-point of servoj.
        """
        is_over = self._refusal is not None or isinstance(self._command, ServoMotion)
        self.setpoint = Setpoint(checked(q, "joint positions"), REST, REST)
        self.scaling, self._rise = 0.0, self._parameters.resume_rate
        if is_over:
            self._begin(JointSpeed(REST, self._gentle, None))
        else:
            self.resume(self.setpoint)

    def resume(self, setpoint: Setpoint) -> None:
        """Continue from a set-point that another mode has reached; like `start`, but with its speed."""
        self.setpoint = setpoint
        command = self._command
        if command is None or command.is_at_rest:
            self._begin(JointSpeed(REST, self._gentle, None))
        elif isinstance(command, PathMove):
            way = [b - a for a, b in zip(setpoint.q, command.place, strict=True)]
            # Return to the path at half of the allowed joint speeds: the peak of the blend is 3/2 of its mean.
            furthest = max(abs(d) / limit for d, limit in zip(way, self._limits.speed, strict=True))
            command.restart(Blend(way, setpoint.qd, max(3.0 * furthest, 0.1), self._gentle))
        elif isinstance(command, ToolSpeed):
            command.restart(setpoint)

    # -- path moves --------------------------------------------------------------------------------

    def movej(self, q: Sequence[float], a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> Command:
        """Move all joints together to positions; the joint that moves furthest determines the speed.

        Args:
            q: Joint positions, shape (6,), in rad.
            a: Acceleration of that joint, in rad/s², lowered to the limits of the model.
            v: Speed of that joint, in rad/s, lowered to the limits of the model.
            t: Duration, in s. If above zero, `a` and `v` have no effect.
            r: Blend radius, in m.

        Raises:
            BadValue: If an argument is invalid.
            OutOfReach: If a joint would leave its range.
        """
        end = checked(q, "joint positions")
        try:
            self._limits.check_target(end)
        except LimitViolation as violation:
            raise OutOfReach(str(violation)) from None
        start, blend = self._take_over()
        path = JointPath(self.arm, start, end)
        return self._follow_path(path, start, blend, a, v, t, r)

    def movel(self, pose: Sequence[float], a: float = 1.2, v: float = 0.25, t: float = 0.0, r: float = 0.0) -> Command:
        """Move the TCP straight to a pose in the base frame, turning about one axis.

        If the pose is out of reach, the TCP approaches it until the arm cannot continue, which violates a limit.
        PolyScope uses this: it writes a node that moves in a direction until contact as a move to a pose 1000 m away.

        Args:
            pose: Pose of the TCP, shape (6,), in m and rad.
            a: Acceleration, in m/s².
            v: Speed, in m/s.
            t: Duration, in s. If above zero, `a` and `v` have no effect.
            r: Blend radius, in m.

        Raises:
            BadValue: If an argument is invalid.
        """
        return self._move_line(pose, a, v, t, r)

    def movec(
        self, via: Sequence[float], to: Sequence[float], a: float = 1.2, v: float = 0.25, r: float = 0.0, mode: int = 0
    ) -> Command:
        """Move the TCP along the circle through one pose to another.

        Args:
            via: Pose on the circle, shape (6,), in m and rad. Only its position has an effect.
            to: Pose at the end, shape (6,), in m and rad.
            a: Acceleration, in m/s².
            v: Speed, in m/s.
            r: Blend radius, in m.
            mode: 0 turns the tool to the orientation of `to`; 1 keeps its orientation relative to the path.

        Raises:
            BadValue: If an argument is invalid.
            OutOfReach: If the points are not on a circle.
        """
        if mode not in (0, 1):
            raise BadValue(f"the mode of an arc is {mode!r}; expected 0 or 1")
        start, blend = self._take_over()
        ends = checked(via, "a pose"), checked(to, "a pose")
        try:
            arc = Arc(self.arm.pose(start), *ends, is_fixed=mode == 1)
        except BadValue as error:
            raise OutOfReach(str(error)) from None
        path = ToolPath(self.arm, arc, start)
        return self._follow_path(path, start, blend, a, v, 0.0, r)

    def movep(self, pose: Sequence[float], a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Command:
        """Move like `movel`. With blends between such moves, the tool keeps about the same speed."""
        return self.movel(pose, a, v, 0.0, r)

    def optimovel(self, pose: Sequence[float], a: float, v: float, r: float) -> Command:
        """Move like `movel`, but lower `a` and `v` so that no joint exceeds its limits on the path."""
        return self._move_line(pose, a, v, 0.0, r, is_bounded=True)

    def servoc(self, pose: Sequence[float], a: float, v: float, r: float) -> Command:
        """Move like `movel`.

        A controller also follows a circular blend; here, only the straight part is modelled.
        """
        return self.movel(pose, a, v, 0.0, r)

    # -- set-points, speeds, stops -----------------------------------------------------------------

    def servoj(self, q: Sequence[float], t: float, lookahead_time: float, gain: float) -> Command:
        """Follow joint positions for a cycle, or for `t` s if that is longer.

        See the module `streamed_motion`.

        Args:
            q: Joint positions, shape (6,), in rad.
            t: Time of the set-point, in s.
            lookahead_time: Look-ahead time, in s; zero on firmware without it.
            gain: Gain; zero on firmware without it.

        Raises:
            BadValue: If an argument is not such a number.
        """
        end = checked(q, "joint positions")
        seconds = _not_negative(t, "a time")
        lag = lag_of(seconds, _not_negative(lookahead_time, "a look-ahead time"), _not_negative(gain, "a gain"))
        stretches, old = self._parameters.servoj_lag_stretches, self._command
        if isinstance(old, ServoMotion):
            begin, speeds, excess = old.goal, old.speeds, old.excess
        else:
            scaling = max(self.scaling, _TAKES_OVER) if stretches else 1.0
            begin, speeds = self.setpoint.q, [v / scaling for v in self.setpoint.qd]
            excess = [max(0.0, 1.0 - self.scaling / scaling) * v for v in self.setpoint.qd] if stretches else REST
        return self._begin(
            ServoMotion(
                self._limits,
                begin,
                end,
                seconds,
                lag,
                begun=self._overrun,
                speeds=speeds,
                excess=excess,
                stretches=stretches,
            )
        )

    def speedj(self, qd: Sequence[float], a: float, t: float | None) -> Command:
        """Change the joint speeds to `qd`, and keep them.

        Args:
            qd: Joint speeds, shape (6,), in rad/s.
            a: Acceleration of the joint whose speed changes most, in rad/s².
            t: Time until the command ends, in s.

        Raises:
            BadValue: If an argument is not such a number.
        """
        return self._begin(JointSpeed(checked(qd, "joint speeds"), self._at_most(a), self._time(t)))

    def speedl(self, xd: Sequence[float], a: float, t: float | None, a_rot: float | None = None) -> Command:
        """Change the speed of the TCP to `xd`, and keep it.

        Args:
            xd: Speed in the base frame, shape (6,), in m/s and rad/s.
            a: Acceleration, in m/s².
            t: Time until the command ends, in s.
            a_rot: Angular acceleration, in rad/s². If it is not above zero, the value of `a` is used.

        Raises:
            BadValue: If an argument is not such a number.
        """
        return self._begin(self._tool_speed(checked(xd, "a tool speed"), a, a_rot, self._time(t)))

    def stopj(self, a: float) -> Command:
        """Brake all joints in proportion; the command ends at rest.

        The fastest joint brakes with `a` rad/s², or less if the model's limit is lower.

        Raises:
            BadValue: If `a` is not above zero.
        """
        return self._begin(JointSpeed(REST, self._at_most(a), None))

    def stopl(self, a: float, a_rot: float | None = None) -> Command:
        """Brake the tool along its direction; the command ends at rest.

        Args:
            a: Deceleration, in m/s².
            a_rot: Angular deceleration, in rad/s². If it is not above zero, the value of `a` is used.
        Raises:
            BadValue: If an argument is not such a number.
        """
        return self._begin(self._tool_speed(REST, a, a_rot, None))

    def release(self) -> None:
        """End the commands and brake to rest.

        If the last path move is in its blend and no command follows, it continues to its end.
        """
        if isinstance(self._command, PathMove) and self._command.blends:
            return
        if not self.is_standing:
            self._begin(JointSpeed(REST, self._gentle, None))

    def direct_torque(
        self, dynamics: Dynamics, motors: Motors, torque: FloatArray, friction: Sequence[float]
    ) -> Command:
        """Move the joints by torques for one cycle; see the module `compliance`.

        Args:
            dynamics: Dynamics of the arm with its rotors and its payload; gravity has no effect.
            motors: Motors of the arm.
            torque: Joint torques, shape (6,), in Nm, including external torques.
            friction: Fraction of its friction that acts on each joint, shape (6,).
        """
        return self._begin(TorqueMotion(dynamics, motors, torque, friction, self._limits.acceleration))

    # -- beginning ---------------------------------------------------------------------------------

    def _begin(self, command: Command) -> Command:
        if self._command is not None:
            self._command.is_over = True
        self._command = command
        self._refusal = None
        return command

    def _move_line(
        self, pose: Sequence[float], a: float, v: float, t: float, r: float, is_bounded: bool = False
    ) -> Command:
        start, blend = self._take_over()
        line = Line(self.arm.pose(start), checked(pose, "a pose"))
        path = ToolPath(self.arm, line, start)
        return self._follow_path(path, start, blend, a, v, t, r, is_bounded)

    def _follow_path(
        self,
        path: MotionPath,
        start: list[float],
        blend: Blend | None,
        a: float,
        v: float,
        t: float,
        r: float,
        is_bounded: bool = False,
    ) -> Command:
        """Begin a path. If `is_bounded`, lower `a` and `v` to the joint limits even on a tool path."""
        radius = _not_negative(r, "a blend radius")
        # A path to the current pose may have a length of some 1e-17 m, which depends on the C library.
        length = path.length if path.length > _NOTHING else 0.0
        if _not_negative(t, "a time") > 0.0:
            speed, acceleration = timed(max(path.length, _SHORTEST), t, *path.fastest())
        else:
            speed, acceleration = positive(v, "a speed"), positive(a, "an acceleration")
            if (is_bounded and length) or isinstance(path, JointPath):
                fastest, hardest = path.fastest()
                speed, acceleration = min(speed, fastest), min(acceleration, hardest)
        profile = Trapezoid(length, speed, acceleration)
        if blend is not None and profile.duration > 0.0:
            # Speed up no faster than the old speed decreases, so that the sum never exceeds the larger of both.
            rise = min(acceleration, profile.peak / (blend.duration * max(self.scaling, 0.01)))
            profile = Trapezoid(length, profile.peak, acceleration, rise)
        if self._command is not None and blend is None and self.scaling == self.speed_fraction:
            self.scaling, self._rise = 0.0, self._parameters.move_rate
        return self._begin(PathMove(path, profile, start, blend, radius))

    def _take_over(self) -> tuple[list[float], Blend | None]:
        """Return the start of a path, and the blend from the current motion to it."""
        q, qd, _ = self.setpoint
        # Brake evenly, with at most the gentle deceleration.
        duration = max(abs(v) / limit for v, limit in zip(qd, self._gentle, strict=True))
        if duration < 1e-9:  # s: at rest, or too slow to matter; a blend divides by its duration
            return list(q), None
        if isinstance(self._command, PathMove) and self._command.blends:
            corner, duration = self._command.corner()
            way = [b - a for a, b in zip(q, corner, strict=True)]
            return corner, Blend(way, qd, duration, self._limits.acceleration)
        way = [0.5 * duration * v for v in qd]
        return [a + d for a, d in zip(q, way, strict=True)], Blend(way, qd, duration, self._limits.acceleration)

    def _tool_speed(self, xd: Sequence[float], a: float, a_rot: float | None, t: float | None) -> ToolSpeed:
        line = positive(a, "an acceleration")
        turn = line if not a_rot else positive(a_rot, "an angular acceleration")
        old = self._command if isinstance(self._command, ToolSpeed) else None
        return ToolSpeed(self.arm, self.setpoint, xd, line, turn, t, old)

    @property
    def _overrun(self) -> float:
        """Scaled time, in s, by which the last cycle exceeded the time of its command."""
        return 0.0 if self._command is None else self._command.overrun

    def _time(self, t: float | None) -> float | None:
        """Return the remaining part of a time."""
        return None if t is None else _not_negative(t, "a time") - self._overrun

    def _at_most(self, a: float) -> list[float]:
        acceleration = positive(a, "an acceleration")
        return [min(acceleration, limit) for limit in self._limits.acceleration]


def _not_negative(value: float, what: str) -> float:
    if not 0.0 <= value < math.inf:
        raise BadValue(f"{what} must be a finite number of zero or more, not {value!r}")
    return float(value)
