"""Motion generator, which converts the commands of a program to one set-point in each cycle.

Every command continues from the current motion, so that the speed is continuous. The path of a path move (movej, movel,
movep, movec, servoc) begins at a position where the arm could come to rest, and a blend is added that starts with the
current speed of the arm. Speed and stop commands change the current speed. servoj approaches its set-point from the
current position and speed.

The algorithm of a real controller is not published. Therefore the deceleration is assumed: it is a quarter of the
model's maximum acceleration if there is no command, or if a path move preempts another motion.

The speed scaling stretches the time of every command except stops. For the rate at which the scaling changes, see
`ScalingParameters`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from linkcore.errors import BadValue
from urlink.arm.curves import Arc, Line
from urlink.arm.dynamics import Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.motors import Motors
from urlink.arm.parameters import number
from urlink.arm.vectors import FloatArray

from ..characteristics import ScalingParameters, approached
from ..setpoint_sources import BRAKING, REST, Setpoint
from .compliance import TorqueMotion
from .joint_limits import SINGULAR, ArmWithTool, JointLimits, LimitViolation, OutOfReach, checked, positive
from .path_motion import Blend, Command, JointPath, MotionPath, PathMove, ToolPath, Trapezoid, timed
from .streamed_motion import JointSpeed, ServoMotion, ToolSpeed, lag_of

# Scaling above which servoj takes over the whole speed of the joints, divided by the scaling. Below this scaling, it
# takes over only a part of the speed, and the rest decays.
_TAKES_OVER = 0.1
# Minimum length, in rad or m, that is used to compute speed and acceleration from a duration.
_SHORTEST = 1e-9
#: Number of cycles whose set-points `glide` computes at once.
_AHEAD = 64
#: Length below which a path is considered to lead nowhere, in m or rad.
_NOTHING = 1e-12


#: Singular value of the flange's Jacobian below which a posture counts as near a singularity. A tool at 0.25 m/s then
#: requires joint speeds near their limits.
_NEAR_SINGULARITY = number("near_singularity")


class MotionGenerator:
    """Generator of the set-points of six joints.

    Args:
        kinematics: Kinematics of the arm, which include the joint limits.
        setpoint: Current set-point. If the arm moves, it brakes until a command begins.
        scaling: Initial speed scaling.
        parameters: Parameters of the speed scaling.

    Attributes:
        setpoint: Set-point of this cycle.
        arm: Arm with its tool. A new TCP does not affect a motion that has already begun.
        speed_fraction: Fraction of the speed slider, 0 to 1. It scales all commands except stops.
        scaling: Speed at which commands are executed, as a fraction of the commanded speed. It approaches
            `speed_fraction`.
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
        # Rate at which the scaling rises until it has reached `speed_fraction`, in 1/s.
        self._rise = parameters.start_rate
        self.arm = ArmWithTool(kinematics, JointLimits(kinematics.model), list(REST))
        self._limits = self.arm.limits
        self._gentle = [BRAKING * limit for limit in self._limits.acceleration]
        self._command: Command | None = None
        self._refusal: LimitViolation | None = None
        # Set-points of the next cycles for `glide`, after the command and the set-point that they continue. A change of
        # the scaling makes another set-point.
        self._ahead: tuple[Command | None, Setpoint, deque[Setpoint]] = (None, setpoint, deque())
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
        """Whether no joint moves, and no command will move one."""
        return (self._command is None or self._command.is_at_rest) and not any(self.setpoint.qd)

    @property
    def is_unchanging(self) -> bool:
        """Whether every later set-point equals the current one until another command begins."""
        return (
            self._refusal is None
            and self.scaling == self.speed_fraction
            and self.is_standing
            and not any(self.setpoint.qdd)
        )

    @property
    def follows_torque(self) -> bool:
        """Whether the joints are moved by direct torque in this cycle."""
        # `isinstance` takes several times as long, because commands have an abstract base class.
        return type(self._command) is TorqueMotion and not self._command.is_at_rest

    @property
    def waypoint(self) -> list[float] | None:
        """Pose of the TCP at the end of the current path move, in m and rad; None if no path move is active."""
        command = self._command
        return command.end_pose if isinstance(command, PathMove) and not command.is_at_rest else None

    # -- time --------------------------------------------------------------------------------------

    def advance(self, seconds: float) -> Setpoint:
        """Return the set-point one cycle of `seconds` later.

        Raises:
            LimitViolation: If the set-point would exceed a limit. Every later call then raises the same error until
                another command begins or `start` is called.
        """
        if self._refusal is not None:
            raise self._refusal
        last = self.setpoint
        before = self.scaling
        if before != self.speed_fraction:
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
                if isinstance(self._command, (PathMove, ToolSpeed)) and self._is_near_singularity(last.q):
                    refusal.code = SINGULAR
                self._refusal = refusal
                raise
            self.setpoint = setpoint
        return self.setpoint

    def course(self, cycles: int, seconds: float) -> FloatArray | None:
        """Return the set-points of at most this number of cycles, shape (3, n, 6), if only the path determines them.

        None if they are only known cycle by cycle. They equal those of `advance`, to the last bit.
        """
        command = self._command
        if self._refusal is not None or self.scaling != self.speed_fraction or not isinstance(command, PathMove):
            return None
        course = command.course(cycles, seconds, self.scaling)
        if course is None:
            return None
        return course[:, : self._limits.count_allowed(self.setpoint, course, seconds)]

    def advance_along(self, cycles: int, seconds: float, last: Setpoint) -> None:
        """Advance by this number of cycles of `course`, to the set-point `last`."""
        assert isinstance(self._command, PathMove)
        self._command.advance_along(cycles, seconds, self.scaling, last)
        self._rise = self._parameters.slider_rate
        self.setpoint = last

    def glide(self, seconds: float) -> Setpoint | None:
        """Advance by one cycle of `course`, and return its set-point.

        Return None, and do nothing, if the set-point is only known by `advance`.
        """
        command = self._command
        if self._refusal is not None or self.scaling != self.speed_fraction or type(command) is not PathMove:
            return None
        begun, last, ahead = self._ahead
        if begun is not command or last is not self.setpoint or not ahead:
            course = self.course(_AHEAD, seconds)
            if course is None or not course.size:
                return None
            ahead = deque(map(Setpoint._make, course.transpose(1, 0, 2).tolist()))
        setpoint = ahead.popleft()
        command.advance_along(1, seconds, self.scaling, setpoint)
        self._rise = self._parameters.slider_rate
        self.setpoint = setpoint
        self._ahead = command, setpoint, ahead
        return setpoint

    def _is_near_singularity(self, q: Sequence[float]) -> bool:
        """Whether a slow motion of the flange can require high joint speeds at these positions."""
        jacobian = self.arm.kinematics.jacobian(q)
        return float(np.linalg.svd(jacobian, compute_uv=False)[-1]) < _NEAR_SINGULARITY

    def start(self, q: Sequence[float]) -> None:
        """Continue from rest at six joint positions, in rad, after a stop has braked the arm.

        A path move continues to its end, and a speed command accelerates to its speed again. In three cases, the
        command is discarded and the arm stays at rest: the command had already ended, it had exceeded a limit, or it is
        a servoj command.
        """
        is_over = self._refusal is not None or isinstance(self._command, ServoMotion)
        self.setpoint = Setpoint(checked(q, "joint positions"), REST, REST)
        self.scaling, self._rise = 0.0, self._parameters.resume_rate
        if is_over:
            self._begin(JointSpeed(REST, self._gentle, None))
        else:
            self.resume(self.setpoint)

    def resume(self, setpoint: Setpoint) -> None:
        """Continue the current command from the position and the speed that force mode or freedrive has reached."""
        self.setpoint = setpoint
        command = self._command
        if command is None or command.is_at_rest:
            self._begin(JointSpeed(REST, self._gentle, None))
        elif isinstance(command, PathMove):
            way = [b - a for a, b in zip(setpoint.q, command.place, strict=True)]
            # Return to the path at no more than half of the maximum joint speeds. The maximum speed of a blend is 3/2
            # of its mean speed.
            furthest = max(abs(d) / limit for d, limit in zip(way, self._limits.speed, strict=True))
            command.restart(Blend(way, setpoint.qd, max(3.0 * furthest, 0.1), self._gentle))
        elif isinstance(command, ToolSpeed):
            command.restart(setpoint)

    # -- path moves --------------------------------------------------------------------------------

    def movej(self, q: Sequence[float], a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> Command:
        """Move all joints to target positions, so that they arrive together.

        Args:
            q: Joint positions, shape (6,), in rad.
            a: Acceleration of the joint that moves furthest, in rad/s². It is lowered to the limits of the model.
            v: Speed of the joint that moves furthest, in rad/s. It is lowered to the limits of the model.
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
        """Move the TCP along a straight line to a pose in the base frame, while the tool turns about one axis.

        If the pose is out of reach, the TCP approaches it until the arm cannot continue, and `advance` then raises
        `LimitViolation`. PolyScope relies on this: for a node that moves in a direction until a contact, it writes a
        move to a pose that is 1000 m away.

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
        """Move the TCP along an arc through one pose to another pose.

        Args:
            via: Pose on the arc, shape (6,), in m and rad. Its orientation is ignored.
            to: Pose at the end, shape (6,), in m and rad.
            a: Acceleration, in m/s².
            v: Speed, in m/s.
            r: Blend radius, in m.
            mode: 0 turns the tool to the orientation of `to`. 1 keeps the orientation of the tool relative to the path.

        Raises:
            BadValue: If an argument is invalid.
            OutOfReach: If no circle passes through the start and both poses.
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
        """Move like `movel`. If such moves are joined with blends, the tool keeps approximately the same speed."""
        return self.movel(pose, a, v, 0.0, r)

    def optimovel(self, pose: Sequence[float], a: float, v: float, r: float) -> Command:
        """Move like `movel`, but lower `a` and `v` so that no joint exceeds its limits on the path."""
        return self._move_line(pose, a, v, 0.0, r, is_bounded=True)

    def servoc(self, pose: Sequence[float], a: float, v: float, r: float) -> Command:
        """Move like `movel`.

        A real controller also blends with an arc. The simulator models only the straight line.
        """
        return self.movel(pose, a, v, 0.0, r)

    # -- set-points, speeds, stops -----------------------------------------------------------------

    def servoj(self, q: Sequence[float], t: float, lookahead_time: float, gain: float) -> Command:
        """Follow joint positions for one cycle, or for `t` seconds if this is longer.

        See the module `streamed_motion`.

        Args:
            q: Joint positions, shape (6,), in rad.
            t: Time of the set-point, in s.
            lookahead_time: Look-ahead time, in s; zero on firmware that does not have this argument.
            gain: Gain; zero on firmware that does not have this argument.

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
        """Accelerate the joints to the speeds `qd`, and keep these speeds.

        Args:
            qd: Joint speeds, shape (6,), in rad/s.
            a: Acceleration of the joint whose speed changes most, in rad/s².
            t: Time until the command ends, in s.

        Raises:
            BadValue: If an argument is not such a number.
        """
        return self._begin(JointSpeed(checked(qd, "joint speeds"), self._at_most(a), self._time(t)))

    def speedl(self, xd: Sequence[float], a: float, t: float | None, a_rot: float | None = None) -> Command:
        """Accelerate the TCP to the speed `xd`, and keep this speed.

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
        """Brake all joints in proportion. The command ends when the arm is at rest.

        The fastest joint brakes with `a` rad/s², or less if the model's limit is lower.

        Raises:
            BadValue: If `a` is not above zero.
        """
        return self._begin(JointSpeed(REST, self._at_most(a), None))

    def stopl(self, a: float, a_rot: float | None = None) -> Command:
        """Brake the tool along the direction of its motion. The command ends when the arm is at rest.

        Args:
            a: Deceleration, in m/s².
            a_rot: Angular deceleration, in rad/s². If it is not above zero, the value of `a` is used.
        Raises:
            BadValue: If an argument is not such a number.
        """
        return self._begin(self._tool_speed(REST, a, a_rot, None))

    def release(self) -> None:
        """End the current command, and brake until the arm is at rest.

        If the current command is a path move that waits to be blended with the next one, it continues to its end.
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
            torque: Joint torques including external torques, shape (6,), in Nm.
            friction: For each joint, the fraction of the friction that is not compensated, shape (6,).
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
        """Begin a path move. If `is_bounded`, lower `a` and `v` to the joint limits, even for a tool path."""
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
            # Do not accelerate faster than the old speed decreases, so that the sum of both speeds never exceeds the
            # larger one.
            rise = min(acceleration, profile.peak / (blend.duration * max(self.scaling, 0.01)))
            profile = Trapezoid(length, profile.peak, acceleration, rise)
        if self._command is not None and blend is None and self.scaling == self.speed_fraction:
            self.scaling, self._rise = 0.0, self._parameters.move_rate
        return self._begin(PathMove(path, profile, start, blend, radius))

    def _take_over(self) -> tuple[list[float], Blend | None]:
        """Return the start of a new path, and the blend from the current motion to this path."""
        q, qd, _ = self.setpoint
        # Duration of a braking with constant deceleration, which is at most `_gentle` for each joint.
        duration = max(abs(v) / limit for v, limit in zip(qd, self._gentle, strict=True))
        if duration < 1e-9:  # the arm is at rest, or slow enough to be stopped at once; a blend divides by its duration
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
        """Scaled time, in s, by which the last cycle exceeded the duration of its command."""
        return 0.0 if self._command is None else self._command.overrun

    def _time(self, t: float | None) -> float | None:
        """Return a duration minus `_overrun`; None if the duration is None."""
        return None if t is None else _not_negative(t, "a time") - self._overrun

    def _at_most(self, a: float) -> list[float]:
        acceleration = positive(a, "an acceleration")
        return [min(acceleration, limit) for limit in self._limits.acceleration]


def _not_negative(value: float, what: str) -> float:
    if not 0.0 <= value < math.inf:
        raise BadValue(f"{what} must be a finite number of zero or more, not {value!r}")
    return float(value)
