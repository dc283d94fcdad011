"""Predicted motions of an arm in a session with limits, and their comparison with the limits.

Each kind of motion is predicted as samples: positions and speeds of the joints. `LimitedArm.check` compares the samples
with the limits (`urlink.session.session_limits`). A prediction uses the published shape of the motion: a trapezoid of
the speed along a path, or a constant acceleration from one speed to the next. The speed slider is assumed to be at
100 %, because a lower slider only makes the motion slower.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from linkcore.errors import LocalError

from ..arm.parameters import number
from ..arm.vectors import JOINTS, FloatArray
from ..errors import LimitExceeded
from ..protocol.realtime.packets import RealtimeState
from ..session.identity import KnownIdentity
from ..session.session_limits import MARGIN, SessionLimits

if TYPE_CHECKING:
    from ..arm.kinematics import Arm

#: Largest sum of the turns of all joints between two samples, in rad. Chosen: the TCP of the longest arm (1.9 m) then
#: deviates from the straight line between two samples by at most 1.9 * 0.02² / 8 = 0.1 mm.
STEP = 0.02
#: Smallest and largest number of samples of one prediction.
LEAST_SAMPLES, _MOST_SAMPLES = 64, 20_000
#: Joint speed in rad/s below which the arm counts as at rest.
_RESTING = 1e-3
#: Largest step of a predicted tool speed, in m and rad, and longest predicted way, in m and rad. No arm moves its tool
#: further in one direction.
_TOOL_STEP, _TOOL_TURN, _FURTHEST, _MOST_TURN = 0.02, 0.05, 25.0, 4.0 * math.pi
#: Largest turn of a joint between two samples of a predicted tool speed, in rad. A larger turn is a singularity.
_LEAP = 0.5
#: Time in s by which the start of a program stretches the time of a speed, while the speed scaling rises from 0 to 1.
RAMP = 0.5 / number("start_rate")
#: If the acceleration of a trajectory rises within the first of these times in s, servoj exceeds the speed by this rise
#: in rad/s², times the factor in s. Both are chosen from the simulator (assumption).
_OVERSHOOTS, _OVERSHOOT = (0.15, 0.1, 0.05, 0.0), 0.025
#: A trajectory that begins slowly catches up for a few cycles when its program runs at full speed. So the arm is faster
#: by up to this factor in the first part of the trajectory, in s. Both are chosen from the simulator (assumption): at
#: 125 Hz, the set-points are faster by a tenth for 0.04 s, and the arm by 1.033.
_CATCHES_UP, _FASTER = 0.2, 1.04
#: Deceleration with which the program of a servo brakes at its end (`urlink.script.links.BRAKE`), in rad/s², and
#: rounding error of a set-point, in rad.
_STOPPING, _ROUNDED = 4.0, 2e-6
#: Time in s for the way from the position of the arm to the first set-point of a servo. Chosen: ``servoj`` takes
#: longer.
FIRST_STEP = 0.01
#: Watched motions: number of cycles until the arm begins to brake.
_REACTION = 6
#: Factor by which a joint of an arm that yields to forces becomes faster until the arm brakes. It is chosen from the
#: simulator (assumption), where the joints became faster by 0.3 %.
_RISES = 1.02
#: Largest difference between an arm and the published lengths of its model, in m.
_CALIBRATED = 0.01
#: Parts of a speed of the tool: along the axes, and about the axes.
_LINE_AND_TURN = slice(0, 3), slice(3, 6)


#: Predicted motion: a function that returns positions in rad and speeds in rad/s, (6,) each, at a time in s, and the
#: duration of the motion in s.
Prediction = tuple[Callable[[float], tuple[list[float], list[float]]], float]


class JointCurve(Protocol):
    """Timed curve of the joints, such as a `Trajectory`."""

    @property
    def time(self) -> FloatArray:
        """Times of the points, (n,) s."""

    @property
    def q(self) -> FloatArray:
        """Positions at the points, (n, 6) rad."""

    def at(self, t: FloatArray, /) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, speeds and accelerations at times."""


class LimitedArm:
    """Arm of a session with limits, with the tool that it has now.

    Args:
        limits: Limits of the session.
        who: Identity of the controller.
        state: State of the robot, which shows the position of the arm.
        tcp_of: Function that returns the TCP in the flange frame that a state shows.

    Raises:
        LocalError: If the model of the arm is unknown, so that its motions cannot be predicted.
    """

    def __init__(
        self,
        limits: SessionLimits,
        who: KnownIdentity,
        state: RealtimeState,
        tcp_of: Callable[[Arm, RealtimeState], FloatArray],
    ) -> None:
        identity = who.identity
        if identity.arm is None:
            raise LocalError("the controller does not report a known model of the arm, so limits cannot be checked")
        self.limits = limits
        self.cycle = 1.0 / identity.firmware.rate
        self.arm: Arm = identity.kinematics
        self.tcp = tcp_of(self.arm, state)
        self.q: FloatArray = np.array(state.q_target)
        self.qd: FloatArray = np.array(state.qd_target)
        #: whether the arm moves
        self.is_moving = bool(np.abs(self.qd).max() > _RESTING)

    # -- comparisons -----------------------------------------------------------------------------------

    def check(self, q: FloatArray, qd: FloatArray | None = None, margin: float = MARGIN) -> None:
        """Compare samples of a motion with the limits.

        Args:
            q: Positions of the joints, shape (n, 6), in rad.
            qd: Speeds of the joints, shape (n, 6), in rad/s; None if the speeds are known to be within the limits.
            margin: Distance from the faces of the box, in m.

        Raises:
            LimitExceeded: If a sample exceeds a limit.
        """
        limits = self.limits
        if limits.box is not None:
            limits.check_places(self.arm.forward(q, self.tcp)[..., :3].reshape(-1, 3), margin)
        if qd is not None:
            limits.check_joint_speeds(qd)
            if limits.tool_speed is not None:
                limits.check_tool_speeds(self.tool_speeds(q, qd))

    def tool_speeds(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return the speeds of the TCP, shape (n,), in m/s."""
        jacobians = self.arm.jacobian(q, self.tcp)[..., :3, :]
        speeds: FloatArray = np.linalg.norm(np.einsum("...ij,...j->...i", jacobians, qd), axis=-1)
        return speeds

    def shortest(self, q: FloatArray, way: FloatArray) -> float:
        """Return the shortest duration, in s, of a motion at constant speed of the joints within the limits of speed.

        Args:
            q: Positions on the way, (n, 6) rad.
            way: Turns of the joints, (6,) rad.
        """
        seconds = 0.0
        if self.limits.joint_speed is not None:
            seconds = float(np.abs(way).max()) / self.limits.joint_speed
        if self.limits.tool_speed is not None:
            furthest = float(self.tool_speeds(q, np.broadcast_to(way, q.shape)).max())
            seconds = max(seconds, furthest / self.limits.tool_speed)
        return seconds

    def check_start(self) -> None:
        """Raise `LimitExceeded` unless the arm is at rest, with its tool in the box."""
        if self.is_moving:
            raise LimitExceeded(
                "start", "the arm is moving, so the path from its position cannot be predicted", "an arm at rest"
            )
        self.check_inside()

    def check_inside(self) -> None:
        """Raise `LimitExceeded` unless the tool is in the box."""
        try:
            # The arm may rest on the margin: rounding must not lock it in.
            self.check(self.q[np.newaxis], margin=0.0)
        except LimitExceeded as error:
            raise LimitExceeded(
                "box",
                f"before the motion, {error.value.replace('would be', 'is')}",
                f"{error.expected}; move the arm with the pendant, or connect without limits",
            ) from None

    # -- predictions -----------------------------------------------------------------------------------

    def check_joint_way(
        self,
        end: FloatArray,
        speed: float,
        acceleration: float,
        *,
        starts_fast: bool = False,
        ends_fast: bool = False,
        zones: tuple[float, float] = (0.0, 0.0),
        start: FloatArray | None = None,
    ) -> None:
        """Check a motion that is straight in joint space, with a trapezoid of the speed of the leading joint.

        Args:
            end: Positions of the joints at the end, (6,) rad.
            speed, acceleration: Speed and acceleration of the joint that moves furthest, in rad/s and rad/s².
            starts_fast, ends_fast: Whether the motion begins or ends with a blend, so that it is fast there.
            zones: Radii in m about both ends. The speeds in these zones are not checked.
            start: Positions at the beginning; None for the position of the arm.
        """
        start = self.q if start is None else start
        way = end - start
        length = float(np.abs(way).max())
        if length == 0.0:
            return
        model = self.arm.model
        shares = np.abs(way) / length
        # The controller lowers both to the limits of the joints.
        with np.errstate(divide="ignore"):
            speed = min(speed, float((model.max_speed / shares).min()))
        parts = np.linspace(0.0, 1.0, _count(float(np.abs(way).sum()) / STEP))
        rates = speed_along(parts, length, speed, acceleration, starts_fast, ends_fast)
        rows = start + parts[:, np.newaxis] * way
        self.check(rows, (rates * self.is_beyond(rows, zones) / length)[:, np.newaxis] * way)

    def is_beyond(self, rows: FloatArray, zones: tuple[float, float]) -> NDArray[np.bool_]:
        """Return whether the TCP is beyond the zones about both ends of a path.

        Args:
            rows: Positions of the joints on the path, (n, 6) rad.
            zones: Radii of the zones about the first and the last position, in m.
        """
        if not any(zones):
            return np.ones(len(rows), dtype=np.bool_)
        places = self.arm.forward(rows, self.tcp)[:, :3]
        first, last = (np.linalg.norm(places - end, axis=1) for end in (places[0], places[-1]))
        return np.asarray((first >= zones[0]) & (last >= zones[1]))

    def check_corner(self, before: FloatArray, corner: FloatArray, after: FloatArray) -> None:
        """Check the positions of a blend: it stays between the corner and the paths on both sides of it.

        Args:
            before, after: Positions of the joints in the blend zones before and after the corner, (n, 6) rad.
            corner: Positions of the joints at the corner, (6,) rad.
        """
        if self.limits.box is not None and len(before) and len(after):
            middles = 0.5 * (before[:, np.newaxis] + after[np.newaxis])
            self.check(np.concatenate([middles.reshape(-1, 6), corner[np.newaxis]]))

    def check_joint_speed(self, qd: FloatArray, acceleration: float, seconds: float) -> None:
        """Check a motion at speeds of the joints: change of speed, constant speed, and braking.

        Args:
            qd: Speeds, (6,) rad/s.
            acceleration: Acceleration of the joint whose speed changes most, in rad/s².
            seconds: Time until the arm brakes, in s.
        """
        rise = float(np.abs(qd - self.qd).max()) / acceleration
        reached = qd if rise <= seconds else self.qd + (qd - self.qd) * seconds / rise
        speeds = [self.qd, reached, reached, np.zeros(6)]
        times = [min(rise, seconds), max(seconds - rise, 0.0), float(np.abs(reached).max()) / acceleration]
        q, rows, rates = self.q, [self.q], [self.qd]
        for first, last, length in zip(speeds, speeds[1:], times, strict=False):
            n = _count(float(np.abs(first).sum() + np.abs(last).sum()) * length / STEP, 2)
            part = np.linspace(0.0, 1.0, n)[1:, np.newaxis]
            rows += list(q + length * part * (first + 0.5 * part * (last - first)))
            rates += list(first + part * (last - first))
            q = q + 0.5 * length * (first + last)
        self.check(np.array(rows), np.array(rates))

    def check_tool_speed(self, xd: FloatArray, acceleration: float, seconds: float) -> None:
        """Check a motion at a speed of the tool in the base frame: change of speed, constant speed, and braking.

        Args:
            xd: Speed of the tool, (6,) in m/s and rad/s.
            acceleration: Acceleration in m/s² and rad/s², also for braking.
            seconds: Time until the tool brakes, in s.
        """
        poses, dt = self._tool_poses(xd, acceleration, seconds)
        if self.limits.box is not None:
            self.limits.check_places(poses[:, :3])
        rows = self.arm.inverse_path(poses, self.q, self.tcp)
        turns = np.diff(rows, axis=0)
        if np.abs(turns).max(initial=0.0) > _LEAP:
            joint = int(np.abs(turns).max(axis=0).argmax())
            raise LimitExceeded(
                "joint_speed", f"{JOINTS[joint]} would jump: the path passes through a singularity", "no jump"
            )
        self.check(0.5 * (rows[1:] + rows[:-1]), turns / dt)

    def _tool_poses(self, xd: FloatArray, acceleration: float, seconds: float) -> tuple[FloatArray, float]:
        """Return poses of the tool at equal times, and the time between two of them, in s."""
        from ..arm.poses import compose

        pose: list[float] = self.arm.forward(self.q, self.tcp).tolist()
        velocity: FloatArray = self.arm.velocity(self.q, self.qd, self.tcp)
        line, turn = (max(float(np.linalg.norm(each[part])) for each in (xd, velocity)) for part in _LINE_AND_TURN)
        total = seconds + max(line, turn) / acceleration
        if line * total > _FURTHEST or turn * total > _MOST_TURN:
            raise LimitExceeded(
                "start",
                f"the tool would move for {seconds:g} s, too far to predict its path",
                f"at most {_FURTHEST:g} m and {_MOST_TURN:.3g} rad in one call",
            )
        n = _count(
            max(
                total / self.cycle if total < 1.0 else 500.0,
                line * total / _TOOL_STEP,
                turn * total / _TOOL_TURN,
            )
        )
        dt = total / n
        poses = [pose]
        for step in range(n):
            wanted = xd if (step + 0.5) * dt <= seconds else np.zeros(6)
            before, goal = velocity.tolist(), wanted.tolist()
            new = np.array([v for p in _LINE_AND_TURN for v in _towards(before[p], goal[p], acceleration * dt)])
            way = (0.5 * dt * (velocity + new)).tolist()
            velocity = new
            place = [a + b for a, b in zip(pose[:3], way[:3], strict=True)]
            turned_to: list[float] = pose[3:]
            if any(way[3:]):
                turned_to = compose((0.0, 0.0, 0.0, *way[3:]), (0.0, 0.0, 0.0, *pose[3:])).tolist()[3:]
            pose = [*place, *turned_to]
            poses.append(pose)
        return np.array(poses), dt

    def check_tool_stop(self, xd: FloatArray, acceleration: float, seconds: float) -> None:
        """Check that a tool could come to rest within the limits after some more time at a speed.

        This method needs a small part of the time of `check_tool_speed`, so a loop can call it in each cycle.

        Args:
            xd: Speed of the tool in the base frame, (6,) in m/s and rad/s.
            acceleration: Acceleration in m/s² and rad/s², also for braking.
            seconds: Time until the tool brakes, in s.
        """
        q, jacobian = self.q, self.arm.jacobian(self.q, self.tcp)
        before: list[float] = (jacobian @ self.qd).tolist()
        goal, most = xd.tolist(), acceleration * seconds
        reached = [value for part in _LINE_AND_TURN for value in _towards(before[part], goal[part], most)]
        line, turn = (math.hypot(*reached[part]) for part in _LINE_AND_TURN)
        if self.limits.box is not None:
            rise = min(math.dist(reached[:3], before[:3]) / acceleration, seconds)
            place: list[float] = self.arm.forward(q, self.tcp)[:3].tolist()
            points = _until_rest(place, before[:3], reached[:3], rise, seconds, line / acceleration)
            if not self._box_contains(points, MARGIN):
                self.limits.check_places(np.array(points))
        try:
            qd = np.linalg.solve(jacobian, np.array(reached))
            # At the same speed of the tool, the joints are faster closer to a singularity.
            later = [seconds, seconds + 0.375 * max(line, turn) / acceleration]
            jacobians = np.array([self.arm.jacobian(q + each * qd, self.tcp) for each in later])
            speeds = np.linalg.solve(jacobians, np.array([reached, [0.5 * each for each in reached]])[..., np.newaxis])
        except np.linalg.LinAlgError:
            raise LimitExceeded("joint_speed", "the arm is at a singularity", "an arm outside of it") from None
        self.limits.check_joint_speeds(np.concatenate([qd[np.newaxis], speeds[..., 0]]))
        self.limits.check_tool_speeds(np.array([line]))

    def check_joint_stop(self, qd: FloatArray, acceleration: float, seconds: float) -> None:
        """Check that the joints could come to rest within the limits after some more time at their speeds.

        The verdict is that of `check_joint_speed`. This method needs a small part of its time unless the arm is close
        to a limit, so a loop can call it in each cycle.

        Args:
            qd: Speeds, (6,) rad/s.
            acceleration: Acceleration of the joint whose speed changes most, in rad/s².
            seconds: Time until the arm brakes, in s.
        """
        if not self._stops_surely(qd.tolist(), acceleration, seconds):
            self.check_joint_speed(qd, acceleration, seconds)

    def _stops_surely(self, qd: list[float], acceleration: float, seconds: float) -> bool:
        """Whether an upper bound of the motion of `check_joint_stop` is within the limits.

        The position of the TCP is computed as if it were linear in the turns of the joints. The second derivatives
        limit the error. For two joints, the derivative is at most the distance of the TCP from the axis of the second.
        """
        before: list[float] = self.qd.tolist()
        rise = max(abs(b - a) for a, b in zip(before, qd, strict=True)) / acceleration
        part = 1.0 if rise <= seconds else seconds / rise
        reached = [a + part * (b - a) for a, b in zip(before, qd, strict=True)]
        most = [max(abs(a), abs(b)) for a, b in zip(before, reached, strict=True)]
        limits = self.limits
        if limits.joint_speed is not None and not max(most) <= limits.joint_speed:
            return False
        braking = max(map(abs, reached)) / acceleration
        # Largest acceleration of the TCP, in m/s², at these speeds of the joints. The order of two joints counts twice.
        bend = inner = 0.0
        for radius, speed in zip(self._radii, most, strict=True):
            bend += radius * speed * (speed + 2.0 * inner)
            inner += speed
        now, then = (self.arm.velocity(self.q, each, self.tcp)[:3].tolist() for each in (before, reached))
        if limits.tool_speed is not None:
            fastest = max(math.hypot(*now), math.hypot(*then)) + seconds * bend
            # While the arm brakes, the fraction `left` of the speed is left. Then the TCP is at most at the speed
            # left * (fastest + change * (1 - left²) / 2). This is largest at the beginning, or at this fraction:
            change = braking * bend
            if change > fastest:
                left = math.sqrt((fastest + 0.5 * change) / (1.5 * change))
                fastest = left * (fastest + 0.5 * change * (1.0 - left * left))
            if not fastest <= limits.tool_speed:
                return False
        if limits.box is None:
            return True
        place: list[float] = self.arm.forward(self.q, self.tcp)[:3].tolist()
        points = _until_rest(place, now, then, min(rise, seconds), seconds, braking)
        return self._box_contains(points, MARGIN + _ROUNDED + 0.5 * (seconds + 0.5 * braking) ** 2 * bend)

    def _box_contains(self, points: Sequence[Sequence[float]], margin: float) -> bool:
        """Whether points, in m, are in the box, and at least `margin` m from its faces."""
        assert self.limits.box is not None
        low, high = self.limits.box
        return all(
            least + margin <= value <= most - margin
            for point in points
            for least, value, most in zip(low, point, high, strict=True)
        )

    def check_curve(
        self,
        sample: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
        times: FloatArray,
        offset: FloatArray | None = None,
    ) -> None:
        """Check a timed curve of the joints.

        Args:
            sample: Function that returns positions (n, 6) in rad and speeds (n, 6) in rad/s at n times in s.
            times: Times of the points of the curve, in s. Between two points, the curve is smooth.
            offset: Difference between the arm and the first point, (6,) rad, which is faded out; None for none.
        """
        rough = _between(times, 9)
        q, _ = sample(rough)
        furthest = float(np.abs(np.diff(q, axis=0)).sum(axis=1).max(initial=0.0))
        q, qd = sample(_between(times, min(max(math.ceil(8.0 * furthest / STEP), 32), 256) + 1))
        margin = MARGIN
        if offset is not None and np.abs(offset).max() > 0.0:
            # The difference fades within 0.2 s or at 0.25 rad/s (`urlink.motion.servo.follower`). It moves the TCP by
            # at most the length of the arm times the sum of the differences.
            margin += self._reach * float(np.abs(offset).sum())
            seconds = max(6.0 * float(np.abs(offset).max()), 0.2)
            qd = qd + np.sign(qd) * 1.5 * np.abs(offset) / seconds
        self.check(q, qd, margin)

    def check_trajectory(self, trajectory: JointCurve, *, begins_slowly: bool) -> None:
        """Check a trajectory that begins close to the position of the arm.

        Args:
            trajectory: The trajectory.
            begins_slowly: Whether the time of the trajectory passes slowly at first, like the time of a program that
                has just started (`ProgramTimer.restart`). Otherwise the arm falls behind and catches up.
        """
        offset = self.q - trajectory.q[0]

        def followed(t: FloatArray) -> tuple[FloatArray, FloatArray]:
            q, qd, _ = trajectory.at(t)
            if begins_slowly:
                return q, qd * np.where(t <= _CATCHES_UP, _FASTER, 1.0)[:, np.newaxis]
            # Accelerations of the last _OVERSHOOTS in the direction of the motion, the oldest one first.
            recent = [np.sign(qd) * trajectory.at(t - lag)[2] for lag in _OVERSHOOTS]
            overshoot = _OVERSHOOT * np.maximum(np.max(recent, axis=0) - recent[0], 0.0)
            return q, qd + np.sign(qd) * overshoot

        self.check_curve(followed, trajectory.time, offset if np.abs(offset).max() < 0.5 else None)

    def check_contact(self, direction: FloatArray, speed: float, acceleration: float, distance: float) -> None:
        """Check a straight motion until a contact, over its whole distance, and braking at its end.

        Args:
            direction: Unit vector in the base frame, (3,).
            speed, acceleration: Speed and acceleration of the tool, in m/s and m/s².
            distance: Longest distance, in m.
        """
        # The program moves for the first two times if nothing is touched (`urlink.script.force_control.until_contact`).
        # Its start stretches the motion by `RAMP`. If the speed is reached sooner, the tool is slower meanwhile, so the
        # distance grows by less. In the simulator, the program ends up to one cycle later.
        seconds = distance / speed + speed / acceleration + min(RAMP, 0.5 * speed / acceleration) + self.cycle
        xd = np.concatenate([speed * direction, np.zeros(3)])
        self.check_tool_speed(xd, acceleration, seconds)

    def check_setpoint(self, before: Sequence[float], q: Sequence[float], seconds: float) -> None:
        """Check one set-point of a servo: its place, the speed from the last set-point, and braking after it.

        Args:
            before, q: The last set-point and this one, (6,) rad.
            seconds: Time for the motion between both, in s.
        """
        speeds = [(b - a) / seconds for a, b in zip(before, q, strict=True)]
        braking = max(map(abs, speeds)) / (2.0 * _STOPPING)
        rest = [a + braking * v for a, v in zip(q, speeds, strict=True)]
        # Single rows: a loop calls this method in each cycle, and they are faster than arrays.
        places = np.array([self.arm.forward(each, self.tcp)[:3] for each in (before, q, rest)])
        self.limits.check_places(places[1:])
        # Set-points are rounded to millionths.
        exact = np.abs(speeds) - _ROUNDED / seconds
        self.limits.check_joint_speeds(np.maximum(exact, 0.0)[np.newaxis])
        way = float(np.linalg.norm(places[1] - places[0])) - _ROUNDED
        self.limits.check_tool_speeds(np.array([way / seconds]))

    def can_coast(self, q: Sequence[float], qd: Sequence[float], seconds: float) -> bool:
        """Whether the tool stays in the box if the joints continue from `q` at `qd` for `seconds`."""
        try:
            self.check(np.array([[a + part * seconds * b for a, b in zip(q, qd, strict=True)] for part in (0.5, 1.0)]))
        except LimitExceeded:
            return False
        return True

    @property
    def _reach(self) -> float:
        """Upper bound of the distance of the TCP from the axis of any joint, in m."""
        model = self.arm.model
        return float(np.abs(model.dh_a).sum() + np.abs(model.dh_d).sum() + np.linalg.norm(self.tcp[:3]))

    @cached_property
    def _radii(self) -> list[float]:
        """Upper bounds of the distances of the TCP from the axes of the joints, (6,) m, for any arm of the model."""
        model = self.arm.model
        along, across = np.abs(model.dh_d).tolist(), np.abs(model.dh_a).tolist()
        beyond = float(np.linalg.norm(self.tcp[:3])) + _CALIBRATED
        return [sum(across[joint:]) + sum(along[joint + 1 :]) + beyond for joint in range(6)]

    def watch(self, q: FloatArray, qd: FloatArray, *, yields: bool = False) -> None:
        """Check that an arm that is moved by forces could come to rest within the limits.

        Args:
            q, qd: Positions and speeds of the joints now, (6,) rad and rad/s.
            yields: Whether the arm yields to forces with its tool, so that the joints become faster close to a
                singularity. The joints are then stopped slightly below their limit.

        Raises:
            LimitExceeded: If the arm is too fast, or would leave the box before it is at rest.
        """
        seconds = _REACTION * self.cycle
        braking = float(np.abs(qd).max()) / (2.0 * _STOPPING)
        rest = q + (seconds + braking) * qd
        self.check(np.stack([q, 0.5 * (q + rest), rest]), np.stack([qd, qd, qd]))
        if yields:
            self.limits.check_joint_speeds(_RISES * qd[np.newaxis])


def check_targets(limited: LimitedArm, predictions: Sequence[Prediction]) -> None:
    """Check predicted motions of a target filter.

    Raises:
        LimitExceeded: If one of the motions exceeds a limit.
    """
    for after, duration in predictions:
        rough = np.array([after(t)[0] for t in np.linspace(0.0, duration, LEAST_SAMPLES)])
        n = _count(2.0 * float(np.abs(np.diff(rough, axis=0)).sum()) / STEP)
        samples = [after(t) for t in np.linspace(0.0, duration, n).tolist()]
        limited.check(np.array([q for q, _ in samples]), np.array([qd for _, qd in samples]))


def speed_along(
    parts: FloatArray, length: float, speed: float, acceleration: float, starts_fast: bool, ends_fast: bool
) -> FloatArray:
    """Return the speed at fractions of a path, (n,): at rest at both ends, except at an end with a blend.

    Args:
        parts: Fractions of the path, 0 to 1.
        length: Length of the path, in m or rad.
        speed, acceleration: Largest speed and acceleration along the path.
        starts_fast, ends_fast: Whether the path begins or ends with a blend.
    """
    speeds = np.full(len(parts), speed)
    if not starts_fast:
        speeds = np.minimum(speeds, np.sqrt(2.0 * acceleration * length * parts))
    if not ends_fast:
        speeds = np.minimum(speeds, np.sqrt(2.0 * acceleration * length * (1.0 - parts)))
    return speeds


def evenly_timed(length: float, seconds: float) -> tuple[float, float]:
    """Return the speed and the acceleration of a motion that takes `seconds`.

    The arm accelerates for a third of the time, and brakes for a third. In a session with limits, a move with `time` is
    sent with these values instead of its time, because the shape of a timed move is not published.
    """
    return max(1.5 * length / seconds, 1e-3), max(4.5 * length / seconds**2, 1e-3)


def _count(wanted: float, least: int = LEAST_SAMPLES) -> int:
    # An odd number has a sample in the middle, where a short motion is fastest.
    return min(max(math.ceil(wanted), least), _MOST_SAMPLES) // 2 * 2 + 1


def _between(times: FloatArray, places: int) -> FloatArray:
    """Return `places` times in each section between two times, without duplicates."""
    parts = np.linspace(0.0, 1.0, places)[:-1]
    inner = (times[:-1, np.newaxis] + np.diff(times)[:, np.newaxis] * parts).ravel()
    return np.append(inner, times[-1])


def _towards(now: list[float], target: list[float], most: float) -> list[float]:
    """Return `now`, changed towards the target by at most `most`."""
    distance = math.dist(now, target)
    return target if distance <= most else [a + most / distance * (b - a) for a, b in zip(now, target, strict=True)]


def _until_rest(
    place: list[float], before: list[float], reached: list[float], rise: float, seconds: float, braking: float
) -> list[list[float]]:
    """Return points whose convex hull contains the way of a tool at changing speed, and until it is at rest.

    Args:
        place: Position of the tool, (3,) m.
        before, reached: Speeds of the tool now, and after `rise` s, (3,) m/s.
        rise: Time in s in which the speed changes evenly.
        seconds: Time until the tool brakes, in s.
        braking: Time in s in which the tool brakes evenly.
    """
    points = [place]
    # While the speed changes, the tool moves on a parabola. It lies in the triangle of its ends and of the point where
    # the tangents of both meet. The rest of the path is straight.
    for speed, length in ((before, 0.5 * rise), (reached, 0.5 * rise), (reached, seconds - rise + 0.5 * braking)):
        points.append([a + length * v for a, v in zip(points[-1], speed, strict=True)])
    return points
