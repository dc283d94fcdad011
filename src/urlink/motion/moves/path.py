"""Paths of several segments that blend into each other, and the checks before a path is sent.

The controller moves the arm along the path. This module plans the path before it is sent, to find errors that the
controller would report only during the motion. The plan starts at the current joint positions, and uses the kinematics
and the TCP of the arm.

Controllers refuse blends that overlap (vendor's manual; "overlapping blends" in users' logs). This module checks the
sum of the radii at both ends of a segment. According to users, the controller makes a protective stop if a joint gets
too fast on a line. Two facts are not published: the speed limit for a tool that turns in place, and the shape of a
blend. Therefore corners are checked as if they had no blends. In a session with limits, the speed next to a blend is
assumed to be the whole speed of the segment, and the segment gets a lower speed if it would exceed a limit there.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from linkcore.arguments import check_number
from linkcore.errors import BadValue
from linkcore.handle import Lifecycle, Motion
from linkcore.names import StrictAttributes

from ...arm import parameters
from ...arm.bounds import JOINT_ACCELERATION, JOINT_SPEED, TOOL_ACCELERATION, TOOL_SPEED, check_pose
from ...arm.models import Model
from ...arm.vectors import JOINTS, FloatArray, Numbers, six
from ...errors import LimitExceeded
from ...protocol.realtime.packets import RealtimeState
from ...script import commands
from ..limited import speed_along
from ..slider import SliderEffect, slider

if TYPE_CHECKING:
    from ...arm.curves import Curve
    from ...arm.kinematics import Arm
    from ..limited import LimitedArm

#: Largest blend radius in m. A larger value probably has the wrong unit, because no arm is longer.
_WIDEST = 2.0
#: Maximum number of waypoints of a path. The limit of the controller is unknown. A program with this number of
#: waypoints has 200 kB.
_MOST = 1000
#: Largest distance between two checked positions on a line or an arc, in m and in rad, and the maximum number of steps
#: between them.
_STEP, _TURN, _MOST_STEPS = 0.005, 0.05, 2000
#: Largest turn of a joint between two checked positions, in rad. A larger turn means that the path passes through a
#: singularity.
_LEAP = 0.5
#: Smallest number of steps on a path that is compared with the limits of a session. It is even, so that a position in
#: the middle, where a short motion is fastest, is among them.
_IN_LIMITS = 64
#: Largest distance from the corner at which a blend ends, compared with the distance at which it begins (assumed).
_ENDS_LATER = 2.0
#: Fractions of the speed that are tried for a segment that would exceed a limit of the session next to a blend. At less
#: than half of its speed, the path would be too different from the path that was asked for (chosen).
_SLOWER = tuple(0.05 * part for part in range(19, 9, -1))
#: Distance in m for which the tool needs as much time as for a turn of 1 rad (assumed).
_RADIAN = parameters.number("metres_per_turn")
#: If the tool centre moves at most this distance, in m, the tool is assumed to turn in place. A pose that was read from
#: a robot is not more precise than this distance.
_IN_PLACE = 1e-3


@dataclass(frozen=True)
class Rates:
    """Speed and acceleration of the tool, or of the joint that moves furthest.

    The units are rad/s and rad/s² for a joint, and m/s and m/s² for the tool.
    """

    speed: float
    acceleration: float

    def seconds(self, way: float) -> float:
        """Return the duration in s of a motion from rest to rest over the distance `way`, in m or rad."""
        if way * self.acceleration > self.speed * self.speed:
            return way / self.speed + self.speed / self.acceleration
        return 2.0 * math.sqrt(way / self.acceleration)


def check_joint_positions(values: ArrayLike, name: str, model: Model | None) -> FloatArray:
    """Check joint positions, and return them as a read-only array, (6,) in rad.

    Raises:
        BadValue: If `values` is not six finite numbers, or if a position is out of the range of its joint. For an
            unknown arm, the range is not checked.
    """
    q = six(values, name)
    if model is not None:
        model.check_joints(q)
    return q


class Waypoint(StrictAttributes):
    """Base class of the waypoints of a path: `Joint`, `Linear` and `Circular`.

    A waypoint also defines the motion of the arm to the waypoint.

    Attributes:
        blend: Distance from the waypoint, in m, at which the arm begins to round the corner; 0 to stop at the waypoint.
        rates: Function that returns the speed and the acceleration of the motion to the waypoint.
    """

    def __init__(self, blend: float, speed: float | None, acceleration: float | None) -> None:
        bounds = (JOINT_SPEED, JOINT_ACCELERATION) if isinstance(self, Joint) else (TOOL_SPEED, TOOL_ACCELERATION)
        self.blend = check_number(blend, "blend", 0.0, _WIDEST, "m")
        self._speed = None if speed is None else bounds[0].check(speed, "speed")
        self._acceleration = None if acceleration is None else bounds[1].check(acceleration, "acceleration")

    @property
    def has_motion_of_its_own(self) -> bool:
        """Whether the waypoint has its own blend, speed or acceleration."""
        return bool(self.blend or self._speed or self._acceleration)

    def rates(self, usual: Rates) -> Rates:
        """Return the speed and the acceleration of the waypoint, or the usual values if the waypoint has none."""
        return Rates(self._speed or usual.speed, self._acceleration or usual.acceleration)


class Joint(Waypoint):
    """Waypoint given as joint positions. The arm moves to it in a straight line in joint space.

    Args:
        q: Joint positions, shape (6,), in rad.
        blend: Distance from the waypoint, in m, at which the next segment may begin.
        speed: Speed of the joint that moves furthest, in rad/s; None for the speed of the path.
        acceleration: Acceleration in rad/s²; None for the acceleration of the path.
    """

    def __init__(
        self, q: Numbers, *, blend: float = 0.0, speed: float | None = None, acceleration: float | None = None
    ) -> None:
        super().__init__(blend, speed, acceleration)
        self.q = six(q, "q")

    def __repr__(self) -> str:
        return f"Joint({self.q.tolist()}, blend={self.blend:g})"


class Linear(Waypoint):
    """Waypoint given as a pose in the base frame. The tool moves to it in a straight line.

    Args:
        pose: Position in m, and rotation vector in rad, shape (6,).
        blend: Distance from the waypoint, in m, at which the next segment may begin.
        speed: Speed in m/s; None for the speed of the path.
        acceleration: Acceleration in m/s²; None for the acceleration of the path.
    """

    def __init__(
        self, pose: Numbers, *, blend: float = 0.0, speed: float | None = None, acceleration: float | None = None
    ) -> None:
        super().__init__(blend, speed, acceleration)
        self.pose = check_pose(pose, "pose")

    def __repr__(self) -> str:
        return f"Linear({self.pose.tolist()}, blend={self.blend:g})"


class Circular(Waypoint):
    """Waypoint given as a pose in the base frame. The tool moves to it on a circular arc through another pose.

    Args:
        via: Pose on the arc, shape (6,), in m and rad. Only the position of this pose is used.
        to: Pose at the end, shape (6,), in m and rad.
        blend: Distance from the waypoint, in m, at which the next segment may begin.
        speed: Speed in m/s; None for the speed of the path.
        acceleration: Acceleration in m/s²; None for the acceleration of the path.
    """

    def __init__(
        self,
        via: Numbers,
        to: Numbers,
        *,
        blend: float = 0.0,
        speed: float | None = None,
        acceleration: float | None = None,
    ) -> None:
        super().__init__(blend, speed, acceleration)
        self.via, self.to = check_pose(via, "via"), check_pose(to, "to")

    def __repr__(self) -> str:
        return f"Circular({self.via.tolist()}, {self.to.tolist()}, blend={self.blend:g})"


@dataclass(frozen=True)
class PathSection:
    """One planned segment of a path.

    Attributes:
        seconds: Planned duration from rest to rest, in s. It is the weight of this segment in the progress of the path.
        part: Function that returns, for a state, the fraction of the segment that the arm has passed.
    """

    seconds: float
    part: Callable[[RealtimeState], float]


@dataclass(frozen=True)
class Plan:
    """A path that has been checked.

    Attributes:
        body: Lines of the program that moves the arm along the path.
        sections: Planned segments, one for each waypoint.
    """

    body: list[str]
    sections: list[PathSection]


@slider(path=SliderEffect.SCALED)
class PathMotion(Motion):
    """Motion along a path of waypoints; see `robot.motion.path`."""

    def __init__(
        self, life: Lifecycle, sections: Sequence[PathSection], newest: Callable[[], RealtimeState | None]
    ) -> None:
        super().__init__(life)
        self._sections = sections
        self._newest = newest
        self._segment = 0

    @property
    def segment(self) -> int:
        """Index of the waypoint to which the arm is moving, starting at 0; it changes when a blend begins."""
        return self._segment

    @property
    def segments(self) -> int:
        """Number of waypoints of the path."""
        return len(self._sections)

    def _on_text(self, text: str) -> None:
        """Handle a line of text from the program."""
        segment = commands.segment_of(text)
        if segment is not None and segment < self.segments:
            self._segment = segment

    def _measured(self) -> float:
        segment, state = self._segment, self._newest()
        seconds = [section.seconds for section in self._sections]
        now = 0.0 if state is None else seconds[segment] * min(max(self._sections[segment].part(state), 0.0), 1.0)
        return (sum(seconds[:segment]) + now) / sum(seconds)


def plan(
    waypoints: Sequence[Waypoint],
    joint_rates: Rates,
    tool_rates: Rates,
    arm: Arm | None,
    state: RealtimeState,
    limited: LimitedArm | None = None,
) -> Plan:
    """Check a path that starts at the current position of the arm, and return the plan.

    Args:
        waypoints: Waypoints of the path.
        joint_rates, tool_rates: Speeds and accelerations for waypoints without their own values.
        arm: Kinematics of the arm. If None, reach, joint limits and blends are not checked.
        state: State of the robot, with the joint positions and the pose of the tool.
        limited: The arm with the limits of the session; None if the session has no limits.

    Raises:
        BadValue: If a waypoint cannot be used. The message names the waypoint and the reason.
        LimitExceeded: If the path exceeds a limit of the session.
    """
    if not 0 < len(waypoints) <= _MOST:
        raise BadValue(f"the path has {len(waypoints)} waypoints; expected 1 to {_MOST}")
    for number, waypoint in enumerate(waypoints):
        if not isinstance(waypoint, (Joint, Linear, Circular)):
            raise BadValue(f"waypoint {number} is {waypoint!r}; expected a Joint, Linear or Circular")
    if waypoints[-1].blend:
        raise BadValue(f"waypoint {len(waypoints) - 1} is the last one, so it cannot blend; expected blend=0")
    rates = [each.rates(joint_rates if isinstance(each, Joint) else tool_rates) for each in waypoints]
    if arm is None:
        return Plan(_body(waypoints, rates), [PathSection(1.0, lambda state: 0.0)] * len(waypoints))
    planner = _Planner(arm, shown_tcp(arm, state), np.array(state.q_target), limited)
    before = 0.0
    sections = []
    for number, (waypoint, rate) in enumerate(zip(waypoints, rates, strict=True)):
        try:
            section, rates[number] = planner.section(waypoint, rate, before)
        except BadValue as error:
            raise type(error)(f"waypoint {number}: {error}") from None
        except LimitExceeded as error:
            raise LimitExceeded(error.limit, f"waypoint {number}: {error.value}", error.expected) from None
        sections.append(section)
        before = waypoint.blend
    return Plan(_body(waypoints, rates), sections)


def shown_tcp(arm: Arm, state: RealtimeState) -> FloatArray:
    """Return the tool centre point in the frame of the flange, (6,) in m and rad.

    On every firmware, the pose of the tool in a state includes the TCP that was set with ``set_tcp``.
    """
    from ...arm.poses import compose, invert

    return compose(invert(arm.forward(state.q_actual)), state.tool_vector_actual)


def _body(waypoints: Sequence[Waypoint], rates: Sequence[Rates]) -> list[str]:
    """Return the lines of a program that moves along the waypoints."""
    lines = []
    for number, (waypoint, rate) in enumerate(zip(waypoints, rates, strict=True)):
        lines += [commands.segment(number), *_statement(waypoint, rate)]
    return lines


def _statement(waypoint: Waypoint, rate: Rates) -> list[str]:
    figures = (rate.speed, rate.acceleration)
    if isinstance(waypoint, Joint):
        return commands.move_joints(waypoint.q.tolist(), *figures, blend=waypoint.blend)
    if isinstance(waypoint, Linear):
        return commands.move_linear(waypoint.pose.tolist(), *figures, blend=waypoint.blend)
    assert isinstance(waypoint, Circular)
    return commands.move_circular(waypoint.via.tolist(), waypoint.to.tolist(), *figures, blend=waypoint.blend)


class _Planner:
    """Planner of a path: plans one segment after another, as if there were no blends."""

    def __init__(self, arm: Arm, tcp: FloatArray, q: FloatArray, limited: LimitedArm | None) -> None:
        self._arm = arm
        self._tcp = tcp
        self._q = q
        self._limited = limited
        #: positions of the joints in the blend zone before the next corner, (n, 6) rad
        self._zone: FloatArray = np.zeros((0, 6))

    def section(self, waypoint: Waypoint, rate: Rates, blend: float) -> tuple[PathSection, Rates]:
        """Plan the segment to a waypoint, after a segment that ends with a blend of `blend` m.

        Returns:
            The segment, and its speed and acceleration: `rate`, or a lower speed (`_slowed`).
        """
        if isinstance(waypoint, Joint):
            return self._joint(waypoint, rate, blend)
        return self._curve(waypoint, rate, blend)

    def _joint(self, waypoint: Joint, rate: Rates, blend: float) -> tuple[PathSection, Rates]:
        model = self._arm.model
        model.check_joints(waypoint.q)
        JOINT_SPEED.check(rate.speed, "speed", float(model.max_speed.max()), f"a {model.name}")
        JOINT_ACCELERATION.check(
            rate.acceleration, "acceleration", float(model.max_acceleration.max()), f"a {model.name}"
        )
        start, way = self._q, waypoint.q - self._q
        places = self._arm.forward(np.stack([start, waypoint.q]), self._tcp)
        _check_blends(blend, waypoint.blend, math.dist(places[0, :3].tolist(), places[1, :3].tolist()))
        if self._limited is not None:
            check = partial(self._limited.check_joint_way, waypoint.q, start=start)
            rate = _slowed(rate, blend, waypoint.blend, check)
            parts = np.linspace(0.0, 1.0, _IN_LIMITS)[:, np.newaxis]
            self._check_corner(start + parts * way, blend, waypoint.blend)
        self._q = np.array(waypoint.q)
        squared = float(way @ way)

        def part(state: RealtimeState) -> float:
            return float((state.q_actual - start) @ way) / squared if squared else 1.0

        return PathSection(rate.seconds(float(np.abs(way).max())), part), rate

    def _curve(self, waypoint: Waypoint, rate: Rates, blend: float) -> tuple[PathSection, Rates]:
        from ...arm.curves import Arc, Line

        start = self._arm.forward(self._q, self._tcp).tolist()
        curve: Curve
        if isinstance(waypoint, Linear):
            curve = Line(start, waypoint.pose.tolist())
        else:
            assert isinstance(waypoint, Circular)
            curve = Arc(start, waypoint.via.tolist(), waypoint.to.tolist())
        _check_blends(blend, waypoint.blend, curve.length)
        self._q, rate = self._follow(curve, rate, blend, waypoint.blend)
        section = PathSection(
            rate.seconds(_counted(curve)), lambda state: curve.part(state.tool_vector_actual.tolist())
        )
        return section, rate

    def _check_corner(self, rows: FloatArray, before: float, after: float) -> None:
        """Check the blend at the beginning of a segment, and keep the positions of the blend zone at its end.

        Args:
            rows: Positions of the joints along the segment, (n, 6) rad.
            before, after: Radii of the blends at both ends, in m.
        """
        assert self._limited is not None
        places = self._arm.forward(rows, self._tcp)[:, :3]
        if before > 0.0:
            near = np.linalg.norm(places - places[0], axis=1) <= _ENDS_LATER * before
            self._limited.check_corner(self._zone, rows[0], _thinned(rows[near]))
        self._zone = _thinned(rows[np.linalg.norm(places - places[-1], axis=1) <= after])

    @staticmethod
    def _check_limits(
        limited: LimitedArm,
        curve: Curve,
        rows: FloatArray,
        speed: float,
        acceleration: float,
        *,
        starts_fast: bool = False,
        ends_fast: bool = False,
        zones: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Compare the motion along a curve with the limits of the session."""
        way, steps = _counted(curve), len(rows) - 1
        if way == 0.0:
            return
        parts = np.linspace(0.0, 1.0, steps + 1)
        speeds = speed_along(parts, way, speed, acceleration, starts_fast, ends_fast) * limited.is_beyond(rows, zones)
        limited.check(rows)
        limited.limits.check_tool_speeds(speeds * curve.length / way)
        middles = np.maximum(speeds[1:], speeds[:-1])[:, np.newaxis]
        limited.limits.check_joint_speeds(np.diff(rows, axis=0) * (steps / way) * middles)

    def _follow(self, curve: Curve, rate: Rates, before: float, after: float) -> tuple[FloatArray, Rates]:
        """Check that the arm can follow the curve; return the joint positions at its end, and its rates (`_slowed`).

        Args:
            curve: Path of the tool.
            rate: Speed and acceleration of the tool.
            before, after: Radii of the blends at both ends, in m.

        Raises:
            Unreachable: If the curve is out of reach.
            BadValue: If a joint would exceed a position limit or its largest speed on the curve.
        """
        from ...arm.kinematics import Unreachable

        model = self._arm.model
        least = 1 if self._limited is None else _IN_LIMITS
        steps = min(max(math.ceil(max(curve.length / _STEP, curve.turn / _TURN)), least), _MOST_STEPS)
        parts = np.linspace(0.0, 1.0, steps + 1)
        poses = [curve.pose(part) for part in parts.tolist()]
        try:
            rows = self._arm.inverse_path(poses, self._q, self._tcp)
        except Unreachable as error:
            # Leave out the row number of the original message, because the message contains the pose.
            raise Unreachable(f"the path to this waypoint is out of reach: {str(error).partition(': ')[2]}") from None
        low, high = model.position_limits.T
        beyond = (rows < low) | (rows > high)
        if beyond.any():
            row, joint = map(int, np.argwhere(beyond)[0])
            raise BadValue(
                f"{JOINTS[joint]} would be at {rows[row, joint]:.3f} rad at {parts[row]:.0%} of the path; "
                f"a {model.name} reaches {low[joint]:.4f} to {high[joint]:.4f} rad"
            )
        turns = np.abs(np.diff(rows, axis=0))
        if (turns > _LEAP).any():
            row, joint = map(int, np.argwhere(turns > _LEAP)[0])
            raise BadValue(
                f"{JOINTS[joint]} would jump by {turns[row, joint]:.2f} rad at {parts[row]:.0%} of the path: "
                "the path passes through a singularity"
            )
        if curve.length > _IN_PLACE:
            way = _counted(curve)
            speed = _speed_along(way, rate, steps, before > 0.0, after > 0.0)
            self._check_speeds(turns * (steps / way) * speed, parts)
        if self._limited is not None:
            rate = _slowed(rate, before, after, partial(self._check_limits, self._limited, curve, rows))
            self._check_corner(rows, before, after)
        end: FloatArray = rows[-1]
        return end, rate

    def _check_speeds(self, speeds: FloatArray, parts: FloatArray) -> None:
        """Raise an error if a joint would be too fast.

        Args:
            speeds: Speeds of the joints, shape (steps, 6), in rad/s.
            parts: Fractions of the path at the ends of the steps, shape (steps + 1,).

        Raises:
            BadValue: If a joint would be too fast.
        """
        model = self._arm.model
        excess = speeds / model.max_speed
        if excess.max() > 1.0:
            row, joint = map(int, np.unravel_index(int(excess.argmax()), excess.shape))
            raise BadValue(
                f"{JOINTS[joint]} would have to turn at {speeds[row, joint]:.2f} rad/s at {parts[row]:.0%} of the "
                f"path; the limit of a {model.name} is {model.max_speed[joint]:.2f} rad/s"
            )


def _slowed(rate: Rates, before: float, after: float, check: Callable[..., None]) -> Rates:
    """Return the rates of a segment in a session with limits, after they have been compared with the limits.

    The speed in a blend is not published, so the arm might have its whole speed there. If only this exceeds a limit of
    speed, the segment gets a lower speed.

    Args:
        rate: Rates of the segment.
        before, after: Radii of the blends at both ends, in m.
        check: Function that compares the segment with the limits, like `LimitedArm.check_joint_way`.

    Raises:
        LimitExceeded: If the segment exceeds a limit beyond its blends, or even at a low speed.
    """
    fast = {"starts_fast": before > 0.0, "ends_fast": after > 0.0}
    try:
        check(rate.speed, rate.acceleration, **fast)
    except LimitExceeded as error:
        if not (before or after) or error.limit == "box":
            raise
        refusal = error
    else:
        return rate
    check(rate.speed, rate.acceleration, zones=(_ENDS_LATER * before, after))
    for share in _SLOWER:
        slower = replace(rate, speed=share * rate.speed)
        with contextlib.suppress(LimitExceeded):
            check(slower.speed, slower.acceleration, **fast)
            return slower
    raise refusal


def way_to(limited: LimitedArm, pose: FloatArray) -> float:
    """Return the length of the straight motion of a tool to a pose, in m, as the controller counts it."""
    from ...arm.curves import Line

    return _counted(Line(limited.arm.forward(limited.q, limited.tcp).tolist(), pose.tolist()))


def check_tool_way(waypoint: Linear | Circular, rates: Rates, limited: LimitedArm) -> None:
    """Compare the motion from the position of the arm to a waypoint with the limits of the session.

    Raises:
        LimitExceeded: If the motion exceeds a limit.
        BadValue: If the arm cannot follow the path.
    """
    _Planner(limited.arm, limited.tcp, limited.q, limited).section(waypoint, rates, 0.0)


def _thinned(rows: FloatArray) -> FloatArray:
    """Return at most ten rows, always with the first and the last one."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, 10).astype(int))] if len(rows) else rows


def _counted(curve: Curve) -> float:
    """Return the length, in m, of a straight line for which the tool needs as much time as for the curve."""
    return max(curve.length, _RADIAN * curve.turn)


def _speed_along(length: float, rate: Rates, steps: int, is_fast_at_start: bool, is_fast_at_end: bool) -> FloatArray:
    """Return the speed of the tool in the middle of each step, (steps, 1) in m/s."""
    middles = (np.arange(steps) + 0.5) / steps
    speeds = speed_along(middles, length, rate.speed, rate.acceleration, is_fast_at_start, is_fast_at_end)
    return speeds[:, np.newaxis]


def _check_blends(before: float, after: float, length: float) -> None:
    """Raise an error if the blends at the two ends of a segment overlap."""
    if before + after > length and (before or after):
        raise BadValue(
            f"blends of {before:g} m at the beginning and {after:g} m at the end do not fit on a segment of "
            f"{length:.4g} m"
        )
