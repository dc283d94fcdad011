"""Slow motion for identification, inside a box that is known before the arm moves.

Each joint swings alone about its current position. First, it swings as fast as the speed limit of the tool allows. The
rotor inertia, the friction and the ramp of programs are found from this motion. Then it swings slowly. At the end, all
joints swing together, so that the weight of the tool acts in other directions. Each motion is a `movej` in its own
program, between points that are planned in advance. The motion can also be planned for a single joint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from linkcore import clock
from urlink import Cancelled, Firmware, LinkTimeout, Motion, RealtimeState, Robot, RobotModeData
from urlink.arm.kinematics import Arm
from urlink.tools import FloatArray, shown_tcp

#: Swing of each joint to either side in rad, and additional tolerance in rad before the arm is stopped.
SWING, BESIDE = 0.3, 0.05
#: Maximum speed of every point of the centre lines of the arm, in m/s: the reduced speed of ISO 10218-1.
_TIP = 0.25
#: Speeds of the fast and the slow swings in rad/s, acceleration of both in rad/s², and relative size of the slow
#: swings.
_FAST, _SLOW, _ACCELERATION, _SHORT = 0.5, 0.08, 1.0, 0.2
#: Time at rest in s: after the swings of each joint, and before the first and after the last one.
_REST, _ENDS = 0.7, 1.0
#: Number of computed points of each leg; time in s that a program may take in addition to its motion; timeout of
#: queries in s.
_POINTS, _SPARE, _SOON = 25, 10.0, 5.0
#: Approximate time in s that a program takes in addition to its trapezoidal motion, for the ramp and for sending the
#: program.
_PROGRAM = 0.2
#: Maximum motion of a joint at rest because of rounding, in rad.
_STILL = 1e-3
#: First firmware that reports its speed slider.
SHOWS_SLIDER = Firmware(3, 0)


@dataclass(frozen=True)
class Leg:
    """One motion of the exercise.

    Attributes:
        goal: Joint positions at the end, shape (6,), in rad.
        speed: Speed of the joint that moves furthest, in rad/s.
        seconds: Duration at a slider of 100 %, in s.
        rest: Time at rest after the leg, in s.
    """

    goal: FloatArray
    speed: float
    seconds: float
    rest: float


@dataclass(frozen=True)
class Exercise:
    """Planned motion that ends at its start position.

    Attributes:
        start: Current joint positions, shape (6,), in rad.
        swing: Motion of each joint to either side, in rad.
        legs: Legs in their order.
        low: Lower corner of the box in the base frame, shape (3,), in m. The joints, the centre lines between them and
            the TCP stay in this box.
        high: Upper corner of the box, shape (3,), in m.
    """

    start: FloatArray
    swing: float
    legs: tuple[Leg, ...]
    low: FloatArray
    high: FloatArray

    @property
    def seconds(self) -> float:
        """Approximate duration at a slider of 100 %, in s."""
        return _ENDS + sum(leg.seconds + leg.rest + _PROGRAM for leg in self.legs)


class Guard:
    """Callback that stops the arm if a joint leaves its box or the dead-man switch is released. Subscribe it to states.

    The guard depends on this computer and the network, so it is an additional precaution and not a safety function.

    Args:
        robot: Robot to stop.
        box: Allowed distance of the joints from their current positions, in rad: one number for all joints, or one for
            each joint, shape (6,).
        is_held: Function that takes a state, and returns whether the arm may move.
        on_stop: Function that is called with the reason after the guard has stopped the arm.

    Raises:
        Cancelled: If a program runs or is paused, because it could move the arm later, or if the arm is already moving.
    """

    def __init__(
        self,
        robot: Robot,
        box: float | FloatArray,
        is_held: Callable[[RealtimeState], bool] = lambda state: True,
        on_stop: Callable[[str], object] = lambda why: None,
    ) -> None:
        self.start = _where_it_stands(robot)
        self.tripped = ""
        self._stop: Motion | None = None
        self.is_held = is_held
        self._robot = robot
        self._box = box
        self._on_stop = on_stop

    def __call__(self, state: RealtimeState) -> None:
        if self.tripped:
            # Stop again, because a motion might have started at the moment of the first stop.
            if state.qd_target.any() and (self._stop is None or self._stop.done):
                self._stop = self._robot.motion.stop()
            return
        away = np.abs(state.q_actual - self.start)
        if (outside := away > self._box).any():
            self._trip(f"a joint was {math.degrees(float(away[outside].max())):.1f} degrees away from its start")
        elif not self.is_held(state):
            self._trip("the dead-man switch was released")

    def _trip(self, why: str) -> None:
        self.tripped = why
        self._on_stop(why)
        self._stop = self._robot.motion.stop()

    def check(self) -> None:
        """Raise `Cancelled` if the guard has stopped the arm."""
        if self.tripped:
            raise Cancelled(f"stopped: {self.tripped}")


def _where_it_stands(robot: Robot) -> FloatArray:
    """Return the joint positions in rad, shape (6,). The arm must be at rest, and no program may run or be paused."""
    robot.realtime.wait(_SOON)
    try:
        modes = robot.primary.of(RobotModeData)
        modes.wait_until(lambda mode: not (mode.is_program_running or mode.is_program_paused), _SOON)
        return robot.realtime.wait_until(lambda state: not state.qd_target.any(), _SOON).q_target.copy()
    except LinkTimeout as error:
        raise Cancelled(f"a program is running or paused, or the arm is moving; stop it first ({error})") from None


def plan(arm: Arm, start: FloatArray, tcp: FloatArray, swing: float = SWING, joint: int | None = None) -> Exercise:
    """Plan the exercise.

    Args:
        arm: Arm, with its calibration if it is known.
        start: Current joint positions, shape (6,), in rad.
        tcp: Pose of the TCP in the flange frame, shape (6,).
        swing: Motion to either side, in rad. With less than 0.1, the calibration cannot be found from the motion.
        joint: Number of the only joint that swings, 0 to 5. If None, each joint swings alone, and then all joints
            together.

    Raises:
        BadValue: If a joint would leave its position limits. The message names the joint.
    """
    legs, where, at = [], [], start
    for goal, fastest, rest in _goals(start, swing, joint):
        arm.model.check_joints(goal)
        way = at + np.linspace(0.0, 1.0, _POINTS)[:, np.newaxis] * (goal - at)
        points = _points(arm, way, tcp)
        far = float(np.abs(goal - at).max())
        # Distance in m that the fastest point moves while the leading joint turns by one rad.
        lever = float(np.linalg.norm(np.diff(points, axis=0), axis=2).max()) * (_POINTS - 1) / far
        speed = min(fastest, _TIP / max(lever, 1e-9))
        ramps = min(speed / _ACCELERATION, math.sqrt(far / _ACCELERATION))
        seconds = far / (ramps * _ACCELERATION) + ramps
        legs.append(Leg(goal, speed, seconds, rest))
        where.append(points.reshape(-1, 3))
        at = goal
    swept = np.concatenate(where)
    return Exercise(start, swing, tuple(legs), swept.min(axis=0), swept.max(axis=0))


def plan_from_here(robot: Robot, swing: float = SWING, joint: int | None = None) -> Exercise:
    """Plan the exercise from the current position and TCP of the arm. The arguments are the same as those of `plan`.

    Raises:
        BadValue: See `plan`.
        LocalError: If the controller does not report which arm it has.
        LinkTimeout: If no state arrives.
    """
    state = robot.realtime.wait(_SOON)
    arm = robot.kinematics
    return plan(arm, state.q_target.copy(), shown_tcp(arm, state), swing, joint)


def exercise(
    robot: Robot, planned: Exercise, guard: Guard, began: Callable[[int], object] = lambda number: None
) -> None:
    """Execute the exercise. The arm ends at its start position.

    Args:
        robot: Robot to move.
        planned: Exercise, planned from the current position of the arm.
        guard: Guard that stops the arm. Its box should be slightly larger than the swing.
        began: Function that is called at the beginning of each leg, with the number of the leg.

    Raises:
        Cancelled: If the arm is at another position, the guard has stopped it, or the dead-man switch is not held at
            the beginning.
        LinkError: If another error ends the motion.
    """
    state = robot.realtime.wait(_SOON)
    if float(np.abs(state.q_target - planned.start).max()) > _STILL:
        raise Cancelled("the arm is not at the position for which this motion was planned")
    if not guard.is_held(state):
        raise Cancelled("the dead-man switch is not held")
    slider = max(slider_of(robot), 0.01)
    with robot.realtime.subscribe(guard):
        clock.sleep(_ENDS)
        for number, leg in enumerate(planned.legs):
            guard.check()
            began(number)
            motion = robot.motion.move_joints(leg.goal, leg.speed, _ACCELERATION)
            try:
                motion.wait(leg.seconds / slider + _SPARE)
            except LinkTimeout:
                motion.cancel()
                raise
            clock.sleep(leg.rest)
        guard.check()


def input_is_on(number: int) -> Callable[[RealtimeState], bool]:
    """Return a function for `Guard.is_held` that returns whether a digital input is on."""
    return lambda state: bool(state.digital_input_bits >> number & 1)


def slider_of(robot: Robot) -> float:
    """Return the speed slider, 0 to 1; 1 if the firmware does not report it."""
    if robot.firmware < SHOWS_SLIDER:
        return 1.0
    return float(robot.primary.of(RobotModeData).wait(_SOON).target_speed_fraction or 0.0)


def _goals(start: FloatArray, swing: float, alone: int | None) -> Iterator[tuple[FloatArray, float, float]]:
    """Yield goals, the maximum speed of the motion to each goal, and the time at rest after this motion."""
    for joint in range(6) if alone is None else (alone,):
        for speed, part in ((_FAST, 1.0), (_SLOW, _SHORT)):
            for side in (1.0, -1.0, 0.0):
                goal = start.copy()
                goal[joint] += side * part * swing
                yield goal, speed, 0.0 if side else _REST
    if alone is not None:
        return
    together = np.array([1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    for sides in (together, -together, together[::-1], 0.0 * together):
        yield start + swing * sides, _FAST, 0.0 if sides.any() else _ENDS


def _points(arm: Arm, q: FloatArray, tcp: FloatArray) -> FloatArray:
    """Return the ends of the links and the TCP, shape (n, 8, 3)."""
    frames = arm.frames(q)[..., :3, 3]
    return np.concatenate((frames, arm.forward(q, tcp)[:, np.newaxis, :3]), axis=1)
