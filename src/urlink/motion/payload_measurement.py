"""Measurement of the payload: rests in several postures, to which the arm moves automatically or is guided by hand.

In an automatic measurement only the wrist joints move. The postures are planned before the arm moves, and each motion
is a `movej` in its own program. The plan keeps the largest angles of the wrists and the box of the tool on the whole
way. While the arm moves, each state is compared with the same limits, and the motion is cancelled if a state exceeds
them. This comparison depends on this computer and the network, so it is not a safety function.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from linkcore import clock
from linkcore.arguments import check_callable, check_number
from linkcore.errors import BadValue, Cancelled, LinkTimeout, LocalError
from linkcore.names import StrictAttributes
from linkcore.pending_call import starts_motion
from linkcore.streaming.stream import Stream

from ..arm import payload as fits
from ..arm.kinematics import Arm
from ..arm.payload import MeasuredPayload, Rest, gravity_in, information
from ..arm.vectors import JOINTS, FloatArray, numbers
from ..protocol.primary.robot_state import RobotModeData, RobotState
from ..protocol.realtime.packets import RealtimeState
from .motions import Motions
from .moves.path import shown_tcp
from .servo.force_control import Freedrive

#: Largest angle of a wrist joint from the current posture that a caller can allow, in rad.
_FURTHEST = math.pi
#: Distances of the planned postures from the current posture, as fractions of the largest angle.
_FRACTIONS = (-1.0, -0.5, 0.0, 0.5, 1.0)
#: Number of checked points of each way; part of each limit that the plan leaves unused, for the deviation of an arm
#: that moves: angle in rad, distance in m.
_POINTS, _ANGLE, _DISTANCE = 41, 0.005, 0.002
#: Largest deviation of a joint at rest or of a joint that does not move, in rad; largest speed at rest, in rad/s.
_STILL, _SLOW = 3e-3, 1e-2
#: Time in s until a reading counts after the arm has come to rest; timeout of queries, in s; time in s that a program
#: may take in addition to its motion.
_SETTLE, _SOON, _SPARE = 0.5, 5.0, 20.0
#: Smallest change of the direction of the tool between two postures that a person chooses, in rad.
_NEW = math.radians(20.0)


@dataclass(frozen=True)
class WristLimits:
    """Limits of an automatic measurement.

    Attributes:
        start: Current joint positions, shape (6,), in rad.
        wrists: Largest angles of wrists 1, 2 and 3 from the current posture, shape (3,), in rad.
        low, high: Corners of the box in the base frame in which the TCP and the flange stay, shape (3,), in m.
        tcp: TCP in the frame of the flange, shape (6,).
    """

    start: FloatArray
    wrists: FloatArray
    low: FloatArray
    high: FloatArray
    tcp: FloatArray

    def outside(self, arm: Arm, q: FloatArray, spare: float) -> str:
        """Return the limit that joint positions exceed; "" if they are inside.

        Args:
            arm: Arm.
            q: Joint positions, shape (n, 6), in rad.
            spare: Part of the limits that must stay unused: 1 for a plan, 0 for states.
        """
        away = np.abs(q - self.start).max(axis=0)
        most = np.concatenate((np.full(3, _STILL), self.wrists - spare * _ANGLE))
        if (away > most + 1e-9).any():
            joint = int((away - most).argmax())
            return f"{JOINTS[joint]} is {away[joint]:.3g} rad away from its start; at most {most[joint]:.3g} rad"
        for name, tool in (("TCP", self.tcp), ("flange", None)):
            points = arm.forward(q, tool)[:, :3]
            past = np.maximum(self.low + spare * _DISTANCE - points, points - self.high + spare * _DISTANCE)
            if (past > 1e-9).any():
                row, axis = np.unravel_index(int(past.argmax()), past.shape)
                inside = f"{self.low[axis]:.3f} to {self.high[axis]:.3f} m"
                return f"{'xyz'[axis]} of the {name} is {points[row, axis]:.3f} m; expected {inside}"
        return ""


def way(begin: FloatArray, end: FloatArray) -> FloatArray:
    """Return points of a straight line in joint space, shape (points, 6)."""
    return begin + np.linspace(0.0, 1.0, _POINTS)[:, np.newaxis] * (end - begin)


def plan(arm: Arm, limits: WristLimits, postures: int, gravity: ArrayLike = fits.UPRIGHT) -> list[FloatArray]:
    """Plan postures in which gravity has very different directions in the tool.

    The first posture is the current one. Each further posture adds the most information. The way to each posture stays
    inside the limits.

    Args:
        arm: Arm.
        limits: Limits of the wrists and of the tool.
        postures: Number of postures.
        gravity: See `MeasuredPayload`.

    Returns:
        Joint positions, each of shape (6,), in rad.

    Raises:
        BadValue: If the arm is not inside the limits, or no postures inside them determine the payload.
    """
    if outside := limits.outside(arm, limits.start[np.newaxis], 1.0):
        raise BadValue(f"box does not contain the current posture with 2 mm to spare: {outside}")
    steps = np.array(list(itertools.product(_FRACTIONS, repeat=3))) * np.maximum(limits.wrists - _ANGLE, 0.0)
    candidates = limits.start + np.hstack((np.zeros_like(steps), steps))
    low, high = arm.model.position_limits.T
    candidates = candidates[((candidates >= low) & (candidates <= high)).all(axis=1)]
    candidates = np.array([q for q in candidates if not limits.outside(arm, q[np.newaxis], 1.0)])
    down = gravity_in(arm, candidates, gravity)
    taken = [limits.start]
    shown = gravity_in(arm, limits.start[np.newaxis], gravity)
    while len(taken) < postures:
        worth = [information(np.concatenate((shown, each[np.newaxis]))) for each in down]
        for chosen in np.argsort(worth)[::-1]:
            if not limits.outside(arm, way(taken[-1], candidates[chosen]), 1.0):
                break
        else:
            raise BadValue("no posture inside the box can be reached; expected a larger box")
        taken.append(candidates[chosen])
        shown = np.concatenate((shown, down[chosen][np.newaxis]))
    try:
        fits.check_turned(shown)
    except BadValue as error:
        raise BadValue(f"the limits are too narrow: {error}") from None
    if limits.outside(arm, way(taken[-1], limits.start), 1.0):
        raise BadValue("the way back to the current posture leaves the box; expected a larger box")
    return taken


class PayloadMeasurement(StrictAttributes):
    """Measurement of the payload of one robot; see `Robot.measure_payload`.

    Args:
        motions: Motions of the robot.
        realtime: Stream of states.
        primary: Stream that reports whether a program runs.
        arm: Arm, with its calibration if it is known.
        has_sensor: Whether the wrist has a force sensor.
        postures: Number of postures, 6 to 10.
        rest: Time of each reading, in s.
        set_payload: Mass in kg and centre in m that are set on the controller; None if the states show them.
        gravity: See `MeasuredPayload`.
        timeout: Maximum time of the measurement, in s.
        on_posture: Function that is called after each reading with its number, beginning at 1.
    """

    def __init__(
        self,
        motions: Motions,
        realtime: Stream[RealtimeState],
        primary: Stream[RobotState],
        arm: Arm,
        has_sensor: bool,
        *,
        postures: int,
        rest: float,
        set_payload: Sequence[float] | None,
        gravity: Sequence[float],
        timeout: float,
        on_posture: Callable[[int], object] | None,
    ) -> None:
        fewest, most = fits.POSTURES
        if isinstance(postures, bool) or not isinstance(postures, int) or not fewest <= postures <= most:
            raise BadValue(f"postures is {postures!r}; expected a whole number from {fewest} to {most}")
        self._postures = postures
        self._rest = check_number(rest, "rest", 0.1, 60.0, "s")
        self._timeout = check_number(timeout, "timeout", 1.0, 3600.0, "s")
        self._set_payload = None if set_payload is None else fits.check_set_payload(set_payload)
        self._gravity = numbers(gravity, "gravity")
        if self._gravity.shape != (3,) or not 5.0 <= float(np.linalg.norm(self._gravity)) <= 15.0:
            raise BadValue(f"gravity is {gravity!r}; expected three numbers with a norm of 5 to 15 m/s²")
        if on_posture is not None:
            check_callable(on_posture, "on_posture")
        self._on_posture = on_posture or (lambda number: None)
        self._motions = motions
        self._realtime = realtime
        self._primary = primary
        self._arm = arm
        self._has_sensor = has_sensor

    # -- automatic -----------------------------------------------------------------------------------

    @starts_motion
    def automatic(
        self, wrists: ArrayLike, box: ArrayLike | None, speed: float, acceleration: float, may_move: bool
    ) -> MeasuredPayload:
        """Move to the postures, and return the payload; see `Robot.measure_payload`."""
        angles = numbers(wrists, "wrists")
        angles = np.full(3, float(angles)) if angles.ndim == 0 else angles
        if angles.shape != (3,) or not (np.isfinite(angles) & (angles >= 0.0) & (angles <= _FURTHEST)).all():
            raise BadValue(f"wrists is {wrists!r}; expected one angle or three angles from 0 to {_FURTHEST:.4g} rad")
        corners = np.array([[-np.inf] * 3, [np.inf] * 3]) if box is None else numbers(box, "box")
        if corners.shape != (2, 3) or not (corners[0] < corners[1]).all():
            raise BadValue(f"box is {box!r}; expected its lower and its upper corner, shape (2, 3), in m")
        speed = check_number(speed, "speed", 0.01, 1.0, "rad/s")
        acceleration = check_number(acceleration, "acceleration", 0.05, 2.0, "rad/s²")
        end = clock.now() + self._timeout
        state = self._start()
        tcp = shown_tcp(self._arm, state)
        limits = WristLimits(state.q_target.copy(), angles, corners[0], corners[1], tcp)
        planned = plan(self._arm, limits, self._postures, self._gravity)
        if may_move is not True:
            swept = np.concatenate([way(a, b) for a, b in itertools.pairwise([*planned, limits.start])])
            tool = self._arm.forward(swept, tcp)[:, :3]
            low, high = (np.round(each, 3).tolist() for each in (tool.min(axis=0), tool.max(axis=0)))
            raise BadValue(
                f"missing consent; measure_payload moves the wrist joints, and the TCP from {low} to {high} m in the "
                "base frame; pass may_move=True if this space is free"
            )
        known = self._known(state)
        rests = []
        for number, goal in enumerate(planned, 1):
            if number > 1:
                self._move(goal, limits, speed, acceleration, end)
            rests.append(self._read(clock.left(end), lambda state: True, lambda: None))
            self._on_posture(number)
        self._move(limits.start, limits, speed, acceleration, end)
        return self._fit(rests, tcp, known)

    def _start(self) -> RealtimeState:
        """Return a state of the arm at rest. No program may run, because the first motion would preempt it."""
        try:
            modes = self._primary.of(RobotModeData)
            modes.wait_until(lambda mode: not (mode.is_program_running or mode.is_program_paused), _SOON)
            self._realtime.wait(_SOON)
            return self._realtime.wait_until(lambda state: not state.qd_target.any(), _SOON)
        except LinkTimeout as error:
            raise Cancelled(f"a program is running or paused, or the arm is moving; stop it first ({error})") from None

    def _move(self, goal: FloatArray, limits: WristLimits, speed: float, acceleration: float, end: float) -> None:
        motion = self._motions.move_joints(goal, speed, acceleration)

        def ends(state: RealtimeState) -> bool:
            outside = limits.outside(self._arm, state.q_actual[np.newaxis], 0.0)
            if outside:
                motion.cancel()
                raise Cancelled(f"stopped: {outside}")
            return motion.done

        far = float(np.abs(goal - limits.start).max())
        longest = min(2.0 * far / speed * 10.0 + _SPARE, clock.left(end))
        self._realtime.wait_until(ends, max(longest, 1e-3))
        motion.wait(_SOON)

    # -- by hand -------------------------------------------------------------------------------------

    @starts_motion
    def by_hand(self, make_freedrive: Callable[[], Freedrive], posture_timeout: float) -> MeasuredPayload:
        """Read the postures that a person chooses in freedrive; see `Robot.measure_payload_by_hand`."""
        if not self._has_sensor:
            raise LocalError(
                f"a {self._arm.model.name} has no force sensor, and its currents in freedrive do not show the payload; "
                "use measure_payload"
            )
        each_timeout = check_number(posture_timeout, "posture_timeout", 1.0, 3600.0, "s")
        end = clock.now() + self._timeout
        state = self._start()
        tcp, known = shown_tcp(self._arm, state), self._known(state)
        rests: list[Rest] = []
        seen: list[FloatArray] = []

        def is_new(state: RealtimeState) -> bool:
            down = gravity_in(self._arm, state.q_actual[np.newaxis], self._gravity)[0]
            return all(_angle(down, each) > _NEW for each in seen)

        freedrive = make_freedrive()

        def check() -> None:
            if freedrive.error is not None:
                raise freedrive.error

        with freedrive:
            for number in range(1, self._postures + 1):
                try:
                    rest = self._read(min(each_timeout, clock.left(end)), is_new, check)
                except LinkTimeout as error:
                    raise LinkTimeout(
                        f"posture {number} of {self._postures} did not come in time: turn the tool by 20 degrees or "
                        f"more from all earlier postures, and release it ({error})"
                    ) from None
                rests.append(rest)
                seen.append(gravity_in(self._arm, rest.q[np.newaxis], self._gravity)[0])
                self._on_posture(number)
        return self._fit(rests, tcp, known)

    # -- both ----------------------------------------------------------------------------------------

    def _read(self, timeout: float, is_new: Callable[[RealtimeState], bool], check: Callable[[], None]) -> Rest:
        """Return the mean of the states of the next rest that counts as new."""
        states: list[RealtimeState] = []

        def is_complete(state: RealtimeState) -> bool:
            check()
            first = states[0] if states else state
            moved = float(np.abs(state.q_actual - first.q_actual).max()) > _STILL
            if moved or float(np.abs(state.qd_actual).max()) > _SLOW:
                states.clear()
                return False
            if not states and not is_new(state):
                return False
            states.append(state)
            return state.time - states[0].time >= _SETTLE + self._rest

        self._realtime.wait_until(is_complete, max(timeout, 1e-3))
        used = [each for each in states if each.time - states[0].time >= _SETTLE]

        def mean(values: list[FloatArray]) -> FloatArray:
            return np.asarray(np.mean(values, axis=0))

        return Rest(
            (used[0].time + used[-1].time) / 2.0,
            mean([each.q_actual for each in used]),
            mean([each.tcp_force for each in used]),
            mean([each.I_target - each.I_actual for each in used]),
        )

    def _known(self, state: RealtimeState) -> tuple[float, float, float, float]:
        """Return the payload that is set on the controller."""
        if self._set_payload is not None:
            return self._set_payload
        if state.payload_mass is None or state.payload_cog is None:
            raise BadValue(
                "missing set_payload; this firmware does not report its payload in each state (5.10 or later does), so "
                "pass the mass in kg and the centre in m that are set: (mass, x, y, z)"
            )
        x, y, z = state.payload_cog.tolist()
        return state.payload_mass, x, y, z

    def _fit(self, rests: list[Rest], tcp: FloatArray, known: tuple[float, float, float, float]) -> MeasuredPayload:
        gravity = self._gravity.tolist()
        if self._has_sensor:
            return fits.fit_sensor(self._arm, rests, tcp, known, gravity)
        return fits.fit_currents(self._arm, rests, known, gravity)


def _angle(first: FloatArray, second: FloatArray) -> float:
    cosine = float(first @ second) / float(np.linalg.norm(first) * np.linalg.norm(second))
    return math.acos(min(max(cosine, -1.0), 1.0))
