"""Stage 3: each joint swings alone about its start position, to check the table of parameters.

The joints swing as in `urlink exercise`, so that the arm can be identified. Each joint needs its own consent, which
names the box that the arm sweeps. A guard stops any other motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from operator import attrgetter
from pathlib import Path

import numpy as np

from urlink import BadRecording, BadValue, Cancelled, Firmware, LinkError, RealtimeState, Robot
from urlink.tools import (
    JOINTS,
    MOTORS,
    ArmFile,
    Estimate,
    FloatArray,
    Parameter,
    force_size,
    joint_sizes,
    numbers,
    parameters,
)

from ..identification import identify
from ..identification.exercise import BESIDE, SWING, Exercise, Guard, exercise, plan_from_here, slider_of
from ..identification.force_sensor import fixed_force
from ..identification.samples import COLUMNS, Samples
from .arrivals import known_arm
from .evidence import Evidence
from .logbook import Logbook
from .requirements import Check, Measured, NotTried

#: Factor for the interval of a value in the row of an arm, if the row has no interval and the joints were not
#: measured. The value is the largest factor that the source of such a row states.
_FACTOR = 1.5
#: Weight of the unexplained current of wrist 3. This current is mostly friction, which the model explains less well.
_WRIST_3 = 0.1
#: Relative tolerance at the ends of an interval. The tolerance is needed for an arm without noise, because the fitted
#: interval then has no width.
_ROUNDING = 1e-6
#: Number of digits for rounding the residual of a fit. Further digits differ between computers.
_DIGITS = 9

#: Fewest joints that must swing to measure the error of the currents. This error changes slowly, so a single swing has
#: too few independent values of it.
_JOINTS_FOR_NOISE = 3
#: Largest width in N of the interval of a force that is compared with its limit.
_FORCE_WIDTH = 6.0

_SHOWS_ARM, _HAS_SENSOR = Firmware(3, 0), Firmware(5, 0)


def _step_of(joint: int) -> str:
    """Return the step name of the swing of a joint, for example "swing-wrist-1"."""
    return f"swing-{JOINTS[joint].replace(' ', '-')}"


def swing(robot: Robot, book: Logbook, is_held: Callable[[RealtimeState], bool], consent: Callable[[str], str]) -> None:
    """Let each joint swing for which there is consent. After the guard has stopped the arm, no other joint swings.

    Args:
        robot: Robot that was connected while the logbook was open, running, and in remote control if it has this mode.
        book: Logbook to write to.
        is_held: Function that takes a state, and returns whether the arm may move.
        consent: Function that is called before each joint with a description of its motion. The function returns the
            reason why the joint may not swing, or "".

    Raises:
        Cancelled: If the guard has stopped the arm, the dead-man switch is not held at the beginning, or a motion
            fails.
        LinkError: If the arm is not known, or a joint would leave its limits.
    """
    if robot.firmware < _SHOWS_ARM:
        book.note("swinging", skipped="this firmware does not report which arm it has")
        return
    slider = slider_of(robot)
    start = robot.realtime.wait(5.0).q_target
    book.note("swinging", start=start.tolist(), slider=slider)
    for joint in range(6):
        step = _step_of(joint)
        planned = plan_from_here(robot, SWING, joint)
        if refused := consent(_does(joint, planned, slider)):
            book.note(step, event="end", skipped=refused)
            continue
        box = np.full(6, BESIDE)
        box[joint] += SWING
        guard = Guard(robot, box, is_held, lambda why: book.note("guard", why=why))
        book.note(step, event="begin")
        try:
            exercise(robot, planned, guard)
        except LinkError as error:
            book.note(step, event="end", error=f"{type(error).__name__}: {error}")
            raise Cancelled(f"the {JOINTS[joint]} did not swing: {guard.tripped or error}") from error
        book.note(step, event="end", error=None)


def _does(joint: int, planned: Exercise, slider: float) -> str:
    pairs = zip("xyz", planned.low.tolist(), planned.high.tolist(), strict=True)
    box = ", ".join(f"{axis} {low:.2f} to {high:.2f} m" for axis, low, high in pairs)
    return (
        f"moves the {JOINTS[joint]} alone, by {math.degrees(planned.swing):.0f} degrees to either side, in "
        f"{planned.seconds / max(slider, 0.01):.0f} s; joints, the lines between them and the TCP stay within {box} of "
        "the base frame, and the arm is thicker than these lines"
    )


def contradictions(found: Iterable[tuple[Parameter, Estimate]]) -> tuple[str, ...]:
    """Return the contradicted parameters: the interval of the parameter does not overlap the measured interval."""
    return tuple(
        f"{row.name}{f' of {row.of}' if row.of else ''}: measured {_text(each)}{f' {row.unit}' if row.unit else ''}; "
        f"the table has {row.low:g} to {row.high:g} ({row.evidence}: {row.source})"
        for row, each in found
        if each.is_known and row.low is not None and row.high is not None
        if each.high < row.low - _ROUNDING * abs(row.low) or each.low > row.high + _ROUNDING * abs(row.high)
    )


def _text(each: Estimate) -> str:
    return f"{each.value:.4g}" if each.low == each.high else f"{each.value:.4g} ({each.low:.4g} to {each.high:.4g})"


def rows_of(name: str, arm: str) -> list[Parameter]:
    """Return the rows of a joint parameter for an arm. Each row has the interval of its joint."""
    of_size = [parameters()[name, size] for size in joint_sizes(arm)]
    own = parameters().get((name, arm))
    if own is None:
        return of_size
    found = []
    for value, size in zip(numbers(name, arm), of_size, strict=True):
        # The interval of a joint size comes from measured arms. The interval is valid for this arm if it contains the
        # value of the arm.
        low, high = size.low or 0.0, size.high or math.inf
        if not low <= value <= high:
            low, high = value / _FACTOR, value * _FACTOR
        found.append(replace(own, value=str(value), low=low, high=high))
    return found


class _Swings:
    """Recorded data of the joints that have swung.

    Attributes:
        joints: Numbers of the joints.
        packets: Packets of the real-time interface during the stage.
        away: Distance of each joint from its position at the beginning of the stage, shape (n, 6), in rad.
        spans: Monotonic start and end times of each swing, in s. The keys are the numbers of the joints.
    """

    def __init__(self, evidence: Evidence) -> None:
        began = evidence.last("swinging")
        if began is None or began.get("skipped"):
            raise NotTried("the stage did not begin" if began is None else began["skipped"])
        said = {joint: evidence.said(_step_of(joint)) for joint in range(6)}
        self.spans: dict[int, tuple[float, float]] = {}
        for joint, notes in said.items():
            if len(notes) == 2 and notes[1].said["error"] is None:
                self.spans[joint] = (notes[0].at, notes[1].at)
        self.joints = sorted(self.spans)
        begin, end = evidence.said("swinging")[-1].at, evidence.stage(3)[1]
        self.packets = evidence.realtime.between(begin, end)
        q = self.packets.column(lambda state: state.q_actual)
        if q is None:
            raise NotTried("no packet of the real-time interface arrived")
        self.away: FloatArray = np.abs(q - np.array(began["start"]))

    def names(self, values: Iterable[float], form: Callable[[float], str]) -> str:
        """Return a text with a value for each joint that has swung."""
        return ", ".join(f"{JOINTS[joint]} {form(value)}" for joint, value in zip(self.joints, values, strict=True))


def _box(evidence: Evidence) -> Measured:
    swings = _Swings(evidence)
    most = swings.away.max(axis=0)
    return Measured(float(most.max()), f"the {JOINTS[int(most.argmax())]}, by {math.degrees(most.max()):.2f} degrees")


def _alone(evidence: Evidence) -> Measured:
    swings = _Swings(evidence)
    worst = Measured(-1.0, "")
    for joint, (begin, end) in swings.spans.items():
        during = swings.away[(swings.packets.arrived >= begin) & (swings.packets.arrived <= end)]
        others = np.delete(during, joint, axis=1)
        if others.size and others.max() > worst.value:
            seen = f"another joint by {others.max() * 1e6:.0f} µrad while the {JOINTS[joint]} swung"
            worst = Measured(float(others.max()), seen)
    if not worst.seen:
        raise NotTried("no joint was moved in the swing test")
    return worst


@lru_cache(maxsize=1)
def _identified(evidence: Evidence) -> tuple[_Swings, ArmFile]:
    """Return the swings, and the arm that is identified from the recording of the stage.

    Raises:
        NotTried: If the recording cannot be evaluated. The message is the reason.
    """
    swings = _Swings(evidence)
    if not swings.joints:
        raise NotTried("no joint was moved in the swing test")
    _, arm = known_arm(evidence)
    columns = {}
    for ours, theirs in COLUMNS.items():
        column = swings.packets.column(attrgetter(theirs))
        if column is not None:
            columns[ours] = column
    try:
        return swings, identify(Samples(Path("the logbook"), columns, arm.name, swings.packets.arrived))
    except (BadRecording, BadValue) as error:
        raise NotTried(f"the recording cannot be evaluated: {error}") from None


def _of_joints(swings: _Swings, found: ArmFile, *names: str) -> Iterator[tuple[Parameter, Estimate]]:
    for name in names:
        rows = rows_of(name, found.model)
        for joint in swings.joints:
            yield replace(rows[joint], of=f"{rows[joint].of}, the {JOINTS[joint]}"), found.estimates[name][joint]


def _of_arm(found: ArmFile, *names: str) -> Iterator[tuple[Parameter, Estimate]]:
    for name in names:
        if name in found.estimates:
            rows = "", force_size(found.model), joint_sizes(found.model)[0], "other"
            of = next(each for each in rows if (name, each) in parameters())
            yield parameters()[name, of], found.estimates[name][0]


def _explained(swings: _Swings, r2: tuple[float, ...], last: float = 1.0) -> tuple[float, str]:
    """Return the largest unexplained fraction of a quantity, and a text with the explained fraction of each joint."""
    left = np.array([round(1.0 - r2[joint], _DIGITS) * (last if joint == 5 else 1.0) for joint in swings.joints])
    if np.isnan(left).any():
        raise NotTried("the moment or the current of a moved joint did not vary")
    return float(left.max()), swings.names((r2[joint] for joint in swings.joints), "{:.5f}".format)


def _moments(evidence: Evidence) -> Measured:
    swings, found = _identified(evidence)
    left, seen = _explained(swings, found.torque_r2)
    rotors = MOTORS["rotor_inertias"]
    return Measured(left, f"explained by masses and rotors: {seen}", contradictions(_of_joints(swings, found, rotors)))


def _currents(evidence: Evidence) -> Measured:
    swings, found = _identified(evidence)
    left, seen = _explained(swings, found.current_r2, _WRIST_3)
    names = (MOTORS[field] for field in ("torque_constants", "coulomb", "viscous"))
    refuted = contradictions(_of_joints(swings, found, *names))
    return Measured(left, f"explained by moments and friction: {seen}", refuted)


def _force(evidence: Evidence) -> Measured:
    swings = _Swings(evidence)
    if evidence.firmware is None or evidence.firmware < _HAS_SENSOR:
        raise NotTried("this controller computes the force from motor currents")
    pose, wrench = (swings.packets.column(attrgetter(name)) for name in ("tool_vector_actual", "tcp_force"))
    if not swings.joints or pose is None or wrench is None:
        raise NotTried("no joint was moved in the swing test")
    turning, staying = fixed_force(pose, wrench)
    known = [(axis, each) for axis, each in zip("xyz", staying, strict=True) if each.high - each.low < _FORCE_WIDTH]
    if not known:
        raise NotTried("the tool did not turn enough to compare the force in several postures")
    # The end of the interval that is nearer to 0: a real arm can have the force.
    least = max(max(each.low, -each.high, 0.0) for _, each in known)
    size = float(np.linalg.norm([each.value for each in turning]))
    seen = ", ".join(f"{axis} {_text(each)} N" for axis, each in known)
    return Measured(least, f"in the base frame {seen}; the offset that turns with the tool has {size:.1f} N")


def _of(name: str, judged: Callable[[float], float], seen: str, *others: str) -> Check:
    """Return a check of one identified number.

    The parameters `others` are identified from the same swings, and the check can contradict them too.
    """

    def check(evidence: Evidence) -> Measured:
        swings, found = _identified(evidence)
        (each,) = found.estimates[name]
        if not each.is_known:
            raise NotTried(f"{name} cannot be determined; {each.needs} is needed")
        known = [one for one in others if one != "current_noise" or len(swings.joints) >= _JOINTS_FOR_NOISE]
        return Measured(abs(judged(each.value)), f"{_text(each)} {seen}", contradictions(_of_arm(found, name, *known)))

    return check


#: Parameters that are identified from sensor noise, in addition to the noise of the positions.
_NOISE = ("position_offset", "current_noise_at_rest", "current_noise", "stiction", "force_noise", "torque_noise")


SWINGS: Mapping[str, Check] = {
    "swing-box": _box,
    "swing-alone": _alone,
    "swing-moments": _moments,
    "swing-currents": _currents,
    "swing-force": _force,
    "swing-lag": _of("tracking_lag", lambda lag: lag, "s behind the targets"),
    "swing-ramp": _of("start_rate", lambda rate: 0.5 / rate, "1/s, rate at which the scaling of a program rises"),
    "swing-noise": _of("position_noise", lambda noise: noise, "rad at rest, standard deviation", *_NOISE),
}
