"""A slow motion that shows what identification needs, inside a box that is known before anything moves.

Each joint swings alone about where it stands, first as fast as the tool may go, by which rotor, friction and the ramp
of programs show, and then slowly; at last all of them together, which turns the weight of the tool in other ways. It is
a `movej` after the other, each in a program of its own and between points that are planned before. It can be planned
for a single joint, too.
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

#: rad by which each joint swings to either side, and by which it may be beside that before it is stopped.
SWING, BESIDE = 0.3, 0.05
#: m/s that no point of the arm's centre lines exceeds: the reduced speed of ISO 10218-1.
_TIP = 0.25
#: rad/s of the fast and the slow swings, rad/s² of both, and the part of the way that the slow ones take.
_FAST, _SLOW, _ACCELERATION, _SHORT = 0.5, 0.08, 1.0, 0.2
#: s at rest after the swings of each joint, before the first one and after the last one.
_REST, _ENDS = 0.7, 1.0
#: Points of each leg at which the arm is computed; s that a program may take beside its motion; s for what is asked.
_POINTS, _SPARE, _SOON = 25, 10.0, 5.0
#: s that a program costs beside its trapezoid, roughly: the ramp, and that it is sent.
_PROGRAM = 0.2
#: What rounding may move a standing joint by, rad.
_STILL = 1e-3
#: The first firmware that shows its speed slider.
SHOWS_SLIDER = Firmware(3, 0)


@dataclass(frozen=True)
class Leg:
    """One movement.

    Attributes:
        goal: (6,) rad.
        speed: of the joint that moves furthest, rad/s.
        seconds: that it takes at a slider of 100 %.
        rest: s at rest after it.
    """

    goal: FloatArray
    speed: float
    seconds: float
    rest: float


@dataclass(frozen=True)
class Exercise:
    """A planned motion, which ends where it begins.

    Attributes:
        start: (6,) rad, where the arm stands.
        swing: rad by which each joint is moved to either side.
        legs: in their order.
        low, high: (3,) m in the base frame, between which the joints, the centre lines between them and the TCP stay.
    """

    start: FloatArray
    swing: float
    legs: tuple[Leg, ...]
    low: FloatArray
    high: FloatArray

    @property
    def seconds(self) -> float:
        """s that it takes at a slider of 100 %, roughly."""
        return _ENDS + sum(leg.seconds + leg.rest + _PROGRAM for leg in self.legs)


class Guard:
    """Stops the arm when a joint leaves its box, or when nobody holds the switch any more; subscribe it to the states.

    It goes by this computer and the network: a courtesy, and no safety function.

    Args:
        box: rad by which any joint may be away from where it stands now, or six of them, one for each.
        is_held: whether the arm may move, by a state.
        on_stop: called with why it has stopped the arm.

    Raises:
        Cancelled: a program runs or is paused, which could move the arm later, or the arm moves already.
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
            # A motion that was begun at the moment of the stop.
            if state.qd_target.any() and (self._stop is None or self._stop.done):
                self._stop = self._robot.motion.stop()
            return
        away = np.abs(state.q_actual - self.start)
        if (outside := away > self._box).any():
            self._trip(f"a joint was {math.degrees(float(away[outside].max())):.1f} degrees away from where it stood")
        elif not self.is_held(state):
            self._trip("the dead man's input was let go of")

    def _trip(self, why: str) -> None:
        self.tripped = why
        self._on_stop(why)
        self._stop = self._robot.motion.stop()

    def check(self) -> None:
        """Raise `Cancelled` once it has stopped the arm."""
        if self.tripped:
            raise Cancelled(f"stopped: {self.tripped}")


def _where_it_stands(robot: Robot) -> FloatArray:
    """(6,) rad, when nothing moves the arm and no program could go on."""
    robot.realtime.wait(_SOON)
    try:
        modes = robot.primary.of(RobotModeData)
        modes.wait_until(lambda mode: not (mode.is_program_running or mode.is_program_paused), _SOON)
        return robot.realtime.wait_until(lambda state: not state.qd_target.any(), _SOON).q_target.copy()
    except LinkTimeout as error:
        raise Cancelled(f"a program runs or is paused, or the arm moves: stop it first ({error})") from None


def plan(arm: Arm, start: FloatArray, tcp: FloatArray, swing: float = SWING, joint: int | None = None) -> Exercise:
    """Plan it.

    Args:
        arm: with its calibration, if it is known.
        start: (6,) rad, where the arm stands.
        tcp: (6,) pose of the TCP in the frame of the flange.
        swing: rad to either side. Less than 0.1 does not show the calibration.
        joint: that alone swings, 0 to 5; None for each alone and then all of them together.

    Raises:
        BadValue: a joint would leave its position limits; the message names it.
    """
    legs, where, at = [], [], start
    for goal, fastest, rest in _goals(start, swing, joint):
        arm.model.check_joints(goal)
        way = at + np.linspace(0.0, 1.0, _POINTS)[:, np.newaxis] * (goal - at)
        points = _points(arm, way, tcp)
        far = float(np.abs(goal - at).max())
        # m that the fastest point goes while the leading joint turns by one rad.
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
    """Plan it from where the arm stands, with its TCP; the arguments are those of `plan`.

    Raises:
        BadValue: see `plan`.
        LocalError: the controller does not say which arm it has.
        LinkTimeout: no state came.
    """
    state = robot.realtime.wait(_SOON)
    arm = robot.kinematics
    return plan(arm, state.q_target.copy(), shown_tcp(arm, state), swing, joint)


def exercise(
    robot: Robot, planned: Exercise, guard: Guard, began: Callable[[int], object] = lambda number: None
) -> None:
    """Move, and end where it began.

    Args:
        planned: from where the arm stands.
        guard: that stops it; its box is to be a little larger than the swing.
        began: called as each leg begins, with its number.

    Raises:
        Cancelled: the arm stands elsewhere, the guard has stopped it, or the switch is not held at the beginning.
        LinkError: what else has ended it.
    """
    state = robot.realtime.wait(_SOON)
    if float(np.abs(state.q_target - planned.start).max()) > _STILL:
        raise Cancelled("the arm does not stand where this motion was planned")
    if not guard.is_held(state):
        raise Cancelled("the dead man's input is not held")
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
    """Whether a digital input is on, as a guard asks it."""
    return lambda state: bool(state.digital_input_bits >> number & 1)


def slider_of(robot: Robot) -> float:
    """The speed slider, 0 to 1; 1 where the firmware does not show it."""
    if robot.firmware < SHOWS_SLIDER:
        return 1.0
    return float(robot.primary.of(RobotModeData).wait(_SOON).target_speed_fraction or 0.0)


def _goals(start: FloatArray, swing: float, alone: int | None) -> Iterator[tuple[FloatArray, float, float]]:
    """Goals, the fastest speed on the way there, and the rest after it."""
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
    """(n, 8, 3) the ends of the links and the TCP."""
    frames = arm.frames(q)[..., :3, 3]
    return np.concatenate((frames, arm.forward(q, tcp)[:, np.newaxis, :3]), axis=1)
