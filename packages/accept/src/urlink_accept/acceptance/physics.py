"""Checks of the meaning of the values: modes, positions and their derivatives, kinematics, moments, currents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urlink.arm import poses
from urlink.packets import JointMode, ProgramState, RobotMode, RobotModeCB2, SafetyMode
from urlink.tools import GRAVITY, Dynamics, motors_of, tool_offset

from .arrivals import known_arm, moments
from .evidence import Evidence
from .requirements import Check, Measured, NotTried, counted, how_different

#: Speed in rad/s below which an arm counts as at rest, and speed in rad/s above which its velocities can be judged.
_STANDS, _MOVES = 1e-3, 0.02
#: Moment in Nm above which the current has the direction of the moment despite friction.
_HEAVY = 5.0
#: Largest factor between the torque constants of an arm and those in the table.
_CONSTANTS = 1.7
#: Smallest fraction of the acceleration at rest that is along the axis of the base, if an arm is upright.
_UPRIGHT = 0.95


#: Lowest and highest value of each field for any arm, and the unit. The ranges are estimates, wide enough for all
#: reported values.
_RANGES = (
    ("q_actual", -100.0, 100.0, "rad"),
    ("q_target", -100.0, 100.0, "rad"),
    ("qd_actual", -10.0, 10.0, "rad/s"),
    ("qd_target", -10.0, 10.0, "rad/s"),
    ("qdd_target", -1000.0, 1000.0, "rad/s²"),
    ("I_actual", -60.0, 60.0, "A"),
    ("I_target", -60.0, 60.0, "A"),
    ("I_control", -60.0, 60.0, "A"),
    ("M_target", -1000.0, 1000.0, "Nm"),
    ("tcp_force", -1000.0, 1000.0, "N, Nm"),
    ("motor_temperatures", -10.0, 100.0, "°C"),
    ("speed_scaling", 0.0, 1.01, ""),
    ("V_main", 40.0, 60.0, "V"),
    ("V_robot", -1.0, 60.0, "V"),
    ("V_actual", -1.0, 60.0, "V"),
    ("I_robot", -5.0, 60.0, "A"),
    ("linear_momentum_norm", -1e-6, 500.0, "kg m/s"),
    ("payload_mass", 0.0, 60.0, "kg"),
    ("controller_timer", 0.0, 50.0, "ms"),
)

_ENUMS = {"safety_mode": SafetyMode, "safety_status": SafetyMode, "program_state": ProgramState}


def _column(evidence: Evidence, name: str) -> NDArray[np.float64] | None:
    return evidence.realtime.values(name)


def _wanted(evidence: Evidence, *names: str) -> list[NDArray[np.float64]]:
    moments("realtime", evidence.realtime)  # raises if too few packets have arrived
    found = [_column(evidence, name) for name in names]
    if any(each is None for each in found):
        raise NotTried(f"this firmware does not send {' and '.join(names)}")
    return [each for each in found if each is not None]


def _stands(evidence: Evidence) -> NDArray[np.bool_]:
    """Return, for each packet, whether the arm is running and has been at rest for the last 0.1 s."""
    (qd,) = _wanted(evidence, "qd_target")
    running = RobotModeCB2.RUNNING if evidence.firmware is not None and evidence.firmware.is_cb2 else RobotMode.RUNNING
    modes = _column(evidence, "robot_mode")
    stands: NDArray[np.bool_] = np.abs(qd).max(axis=1) < _STANDS
    rate = 500 if evidence.firmware is None else evidence.firmware.rate
    for at in np.flatnonzero(~stands):
        stands[at : at + rate // 10] = False
    if modes is not None:
        stands &= modes == running
    if not stands.any():
        raise NotTried("the arm was not running, or it was never at rest")
    return stands


def _possible(evidence: Evidence) -> Measured:
    moments("realtime", evidence.realtime)
    wrong, tried = [], 0
    for name, low, high, unit in _RANGES:
        values = _column(evidence, name)
        if values is None:
            continue
        tried += 1
        is_wrong = ~(np.isfinite(values) & (values >= low) & (values <= high))
        if is_wrong.any():
            worst = values[is_wrong].flat[0]
            wrong.append(f"{name}: {worst:.4g} {unit}".rstrip() + f"; expected {low:g} to {high:g}")
    return counted(wrong, f"{tried} fields have values that an arm can have")


def _modes(evidence: Evidence) -> Measured:
    moments("realtime", evidence.realtime)
    is_cb2 = evidence.firmware is not None and evidence.firmware.is_cb2
    lists: dict[str, Any] = {**_ENUMS, "robot_mode": RobotModeCB2 if is_cb2 else RobotMode, "joint_modes": JointMode}
    wrong, seen = [], []
    for name, known in lists.items():
        values = _column(evidence, name)
        if values is None:
            continue
        there = sorted(set(values.flat))
        numbers = {int(each) for each in known}
        unknown = [f"{each:g}" for each in there if each not in numbers]
        if unknown:
            wrong.append(f"{name}: {', '.join(unknown[:5])} is not in the list of modes")
        else:
            seen.append(f"{name} {', '.join(known(int(each)).name for each in there[:4])}")
    return counted(wrong, ", ".join(seen) or "this firmware sends no modes here")


def _tracking(evidence: Evidence) -> Measured:
    stands = _stands(evidence)
    actual, target = _wanted(evidence, "q_actual", "q_target")
    apart = np.abs(actual - target)[stands]
    joint = int(apart.max(axis=0).argmax())
    seen = f"{apart.max() * 1e6:.0f} µrad at joint {joint + 1}, in {int(stands.sum())} packets at rest"
    return Measured(float(apart.max()), seen)


def _velocities(evidence: Evidence) -> Measured:
    times = moments("realtime", evidence.realtime)
    wrong, tried = [], []
    pairs = (("q_target", "qd_target"), ("q_actual", "qd_actual"), ("qd_target", "qdd_target"))
    steps = np.diff(times)
    is_next = (steps > 0.0) & (steps < 1.5 / (evidence.firmware.rate if evidence.firmware is not None else 500))
    (speed,) = _wanted(evidence, "qd_target")
    turns = np.maximum(np.abs(speed[1:]), np.abs(speed[:-1]))[is_next]
    for position, velocity in pairs:
        p, v = _wanted(evidence, position, velocity)
        with np.errstate(divide="ignore", invalid="ignore"):
            derived = (np.diff(p, axis=0) / steps[:, None])[is_next]
        # The mean speed in a cycle is between the speeds at its ends. An arm can brake within a single cycle.
        between = np.clip(derived, np.minimum(v[1:], v[:-1])[is_next], np.maximum(v[1:], v[:-1])[is_next])
        for joint in range(6):
            a, b = derived[:, joint], between[:, joint]
            moving = turns[:, joint] > _MOVES
            if moving.sum() < 20:
                continue
            tried.append(f"{velocity} of joint {joint + 1}")
            slope = float(a[moving] @ b[moving] / max(float(a[moving] @ a[moving]), 1e-12))
            if not 0.7 < slope < 1.3:
                sign = " (its sign is inverted)" if -1.3 < slope < -0.7 else ""
                wrong.append(f"{velocity} of joint {joint + 1} is {slope:.3g} times the derivative of {position}{sign}")
    if not tried:
        raise NotTried("no joint moved during listening")
    return counted(wrong, f"derivatives agree: {', '.join(tried)}")


def _first_tcp(evidence: Evidence) -> list[float]:
    """Return the first reported TCP, in m and rad in the frame of the flange."""
    info = next((state.cartesian_info for state in evidence.primary.states if state.cartesian_info is not None), None)
    tcp = None if info is None else tool_offset(info)
    if tcp is None:
        raise NotTried("this firmware does not report the TCP")
    return tcp


def _kinematics(evidence: Evidence) -> Measured:
    known, _ = known_arm(evidence)
    tcp = _first_tcp(evidence)
    last = evidence.primary.states[-1].cartesian_info
    if last is None or tool_offset(last) != tcp:
        raise NotTried("the TCP changed during the test")
    q, pose = _wanted(evidence, "q_actual", "tool_vector_actual")
    some = np.linspace(0, len(q) - 1, min(len(q), 200)).astype(int)
    expected = known.kinematics.forward(q[some], tcp)
    apart = np.linalg.norm(expected[:, :3] - pose[some, :3], axis=1)
    turned = np.linalg.norm(poses.compose(poses.invert(expected), pose[some])[:, 3:], axis=1)
    which = "its own calibration" if known.dh_table is not None else "the published lengths"
    still = not np.ptp(pose, axis=0).any() and np.ptp(q[:, :3], axis=0).max() > _STANDS
    how = "; tool_vector_actual is frozen" if still else ""
    if apart.max() > 0.01:
        how = how or f"; tool_vector_actual: {how_different(expected[:, :3].ravel(), pose[some, :3].ravel())}"
    seen = f"at most {apart.max() * 1e3:.3f} mm and {turned.max() * 1e3:.3f} mrad, with {which}{how}"
    # A rotation counts as the distance that a point at 1 m from the tool moves.
    return Measured(float(max(apart.max(), turned.max())), seen)


def _gravity(evidence: Evidence) -> Measured:
    stands = _stands(evidence)
    known, _ = known_arm(evidence)
    q, moment = _wanted(evidence, "q_target", "M_target")
    (acceleration,) = _wanted(evidence, "tool_accelerometer")
    payload, cog = _column(evidence, "payload_mass"), _column(evidence, "payload_cog")
    if payload is None or cog is None:
        payload, cog = _fitted_payload(known, q, moment, stands)
    at = np.flatnonzero(stands)[:: max(int(stands.sum()) // 50, 1)]
    felt = poses.rotvec_to_matrix(known.kinematics.forward(q[at[0]])[3:]) @ acceleration[at].mean(axis=0)
    if abs(felt[2]) < _UPRIGHT * float(np.linalg.norm(felt)):
        raise NotTried("the arm is neither upright nor upside down")
    worst, seen = 0.0, ""
    for number in at:
        model = Dynamics(known.kinematics, payload=max(payload[number], 0.0), payload_cog=cog[number])
        expected = model.gravity_torque(q[number])
        apart = np.abs(moment[number] - expected) - 0.2 * np.abs(expected)
        joint = int(apart.argmax())
        if not seen or apart[joint] > worst:
            worst = max(float(apart[joint]), 0.0)
            seen = (
                f"M_target of joint {joint + 1}: {moment[number, joint]:.2f} Nm; expected {expected[joint]:.2f} Nm "
                f"from the masses: {how_different(expected, moment[number])}"
            )
    return Measured(worst, f"{seen}, for an upright arm with {payload[at[0]]:.2f} kg")


def _fitted_payload(
    known: Any, q: NDArray[np.float64], moment: NDArray[np.float64], stands: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the payload that explains the moments best, for firmware that does not report it.

    The masses have the shape (n,), in kg, and the centres of gravity are at the flange, shape (n, 3).
    """
    at = int(np.flatnonzero(stands)[0])
    empty = Dynamics(known.kinematics).gravity_torque(q[at])
    each = Dynamics(known.kinematics, payload=1.0, payload_cog=(0.0, 0.0, 0.0)).gravity_torque(q[at]) - empty
    mass = float(np.clip((moment[at] - empty) @ each / max(float(each @ each), 1e-9), 0.0, _LARGEST_PAYLOAD))
    return np.full(len(q), mass), np.zeros((len(q), 3))


#: Largest payload that is fitted if the firmware does not report the payload, in kg.
_LARGEST_PAYLOAD = 10.0


def _currents(evidence: Evidence) -> Measured:
    stands = _stands(evidence)
    _, arm = known_arm(evidence)
    moment, current = _wanted(evidence, "M_target", "I_target")
    moment, current = moment[stands].mean(axis=0), current[stands].mean(axis=0)
    constants = motors_of(arm).torque_constants
    wrong, tried = [], 0
    for joint in range(6):
        if abs(moment[joint]) < _HEAVY:
            continue
        tried += 1
        ratio = current[joint] * constants[joint] / moment[joint]
        if not 1.0 / _CONSTANTS < ratio < _CONSTANTS:
            said = f"is {ratio:.3g} times as large as with torque_constant, {constants[joint]:g} Nm/A"
            if ratio < 0.0:
                said = "has the opposite direction"
            wrong.append(f"I_target of joint {joint + 1}: {current[joint]:.3f} A at {moment[joint]:.2f} Nm {said}")
    (actual,) = _wanted(evidence, "I_actual")
    actual = actual[stands].mean(axis=0)
    heavy = np.abs(moment) >= _HEAVY
    if heavy.any():
        slope = float(np.sum(actual[heavy] * current[heavy]) / max(float(np.sum(current[heavy] ** 2)), 1e-12))
        # Static friction carries up to half of the weight, so the actual current can be much smaller.
        if not 0.4 < slope < _CONSTANTS:
            how = how_different(current, actual)
            how = how if "sign" in how else f"impossible torque constants, {how}"
            wrong.append(f"I_actual is {slope:.3g} times I_target at rest: {how}")
    if not tried:
        raise NotTried(f"no joint holds {_HEAVY:g} Nm in this posture")
    return counted(wrong, f"{tried} joints: {np.round(current, 2).tolist()} A at {np.round(moment, 1).tolist()} Nm")


#: Measured quantities that have noise on every arm, and quantities that are suspicious if all six joints have the same
#: value.
_NOISY = ("q_actual", "I_actual", "tool_accelerometer")
_UNEQUAL = ("q_actual", "I_actual", "motor_temperatures", "V_actual")
#: Duration in s after which a constant measurement is suspicious. In the logs of a UR3e, a UR5e and a UR5 CB3 at rest,
#: no noisy measurement is the same for all joints or axes in two rows, which are 8 to 40 ms apart.
_CONSTANT = 1.5


def _alive(evidence: Evidence) -> Measured:
    stands = _stands(evidence)
    times = moments("realtime", evidence.realtime)[stands]
    if evidence.firmware is None or evidence.firmware.is_cb2:
        raise NotTried("the noise of a CB2 is unknown")
    if times[-1] - times[0] < _CONSTANT:
        raise NotTried(f"the arm was at rest for less than {_CONSTANT:g} s")
    still, tried, wrong = [], 0, []
    for name in dict.fromkeys((*_NOISY, *_UNEQUAL)):
        values = _column(evidence, name)
        if values is None:
            continue
        tried += 1
        values = values[stands]
        is_constant = not np.ptp(values, axis=0).any()
        if is_constant and name in _NOISY:
            still.append(name)
        if is_constant and name in _UNEQUAL and not np.ptp(values[0]):
            wrong.append(f"{name}: six identical constants, {values[0, 0]:g}")
    # If no measurement has noise, the arm is simulated without noise, and this is not a defect.
    if len(still) < len(_NOISY):
        frozen = (f"{name} is frozen: it never changes, although other measurements have noise" for name in still)
        wrong = [*frozen, *(each for each in wrong if each.partition(":")[0] not in still)]
    return counted(wrong, f"{tried} measurements change from cycle to cycle, or from joint to joint")


def _flags(evidence: Evidence) -> Measured:
    if evidence.firmware is None or evidence.firmware.is_cb2:
        raise NotTried("the flags of CB2 are not compared")
    wrong, tried = [], 0
    for name in ("primary", "secondary"):
        runs: dict[str, int] = {}
        for state in getattr(evidence, name).states:
            mode, board = state.robot_mode_data, state.masterboard_data
            if mode is None or board is None or board.safety_mode is None:
                continue
            tried += 1
            is_on = int(mode.robot_mode) >= int(RobotMode.IDLE)
            is_emergency = board.safety_mode in _EMERGENCIES
            is_protective = board.safety_mode == SafetyMode.PROTECTIVE_STOP
            differs = {
                f"is_power_on is {mode.is_power_on}": (is_on and not mode.is_power_on)
                or (mode.robot_mode == RobotMode.POWER_OFF and mode.is_power_on),
                f"is_robot_connected is {mode.is_robot_connected}": is_on and not mode.is_robot_connected,
                f"is_emergency_stopped is {mode.is_emergency_stopped}": mode.is_emergency_stopped != is_emergency,
                f"is_protective_stopped is {mode.is_protective_stopped}": (
                    is_protective and not mode.is_protective_stopped
                )
                or (board.safety_mode == SafetyMode.NORMAL and mode.is_protective_stopped),
            }
            for text, is_wrong in differs.items():
                runs[text] = runs.get(text, 0) + 1 if is_wrong else 0
                # A flag may change one state later than its mode.
                if runs[text] == 2:
                    modes = f"robot_mode {mode.robot_mode.name} and safety_mode {board.safety_mode.name}"
                    wrong.append(f"{name} {text} with {modes}")
    if not tried:
        raise NotTried("no robot state with modes arrived")
    return counted(list(dict.fromkeys(wrong)), f"the flags of {tried} robot states agree with their modes")


_EMERGENCIES = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)


def _tcp_speed(evidence: Evidence) -> Measured:
    known, _ = known_arm(evidence)
    tcp = _first_tcp(evidence)
    begin, end = evidence.stage(2)[0], evidence.stage(3)[0]
    begin = min(begin, end)
    packets = evidence.realtime.between(begin, np.inf)
    if len(packets.states) < 100:
        raise NotTried("no joint moved")
    wrong, seen = [], []
    for speed, q, qd in (("tcp_speed_actual", "q_actual", "qd_actual"), ("tcp_speed_target", "q_target", "qd_target")):
        columns = [packets.column(lambda state, n=n: getattr(state, n)) for n in (speed, q, qd)]  # type: ignore[misc]
        if any(each is None for each in columns):
            continue
        v, at, rates = (each for each in columns if each is not None)
        moving = np.flatnonzero(np.abs(rates).max(axis=1) > _MOVES)
        moving = moving[:: max(len(moving) // 2000, 1)]
        if len(moving) < 20:
            continue
        expected = known.kinematics.velocity(at[moving], rates[moving], tcp)
        size = float(np.sqrt(np.mean(expected**2)))
        # The median is robust to single states at the ends of a motion.
        apart = float(np.median(np.abs(expected - v[moving]).max(axis=1)) / size)
        seen.append(f"{speed}: {apart:.2%}")
        if apart > _FRAME:
            turned = abs(np.linalg.norm(v[moving]) / np.linalg.norm(expected) - 1.0) < _FRAME
            still = not np.ptp(v[moving], axis=0).any()
            how = "it is frozen" if still else how_different(expected.ravel(), v[moving].ravel())
            how = "it is in another frame or order" if how == "other values" and turned else how
            ratio = float(np.sum(v[moving] * expected) / np.sum(expected**2))
            wrong.append(
                f"{speed} differs from the Jacobian times {qd} by {apart:.0%}: {how}, {ratio:.3g} times as much"
            )
    if not seen:
        raise NotTried("no joint moved, or this firmware does not report the speed of the TCP")
    return counted(wrong, f"equal to the Jacobian times the joint speeds: {', '.join(seen)}")


#: Relative difference of two speeds of the TCP above which they count as different.
_FRAME = 0.2


def _accelerometer(evidence: Evidence) -> Measured:
    if evidence.firmware is None or evidence.firmware < (1, 7):
        raise NotTried("before firmware 1.7, this field has no meaning")
    stands = _stands(evidence)
    (acceleration,) = _wanted(evidence, "tool_accelerometer")
    mean = acceleration[stands].mean(axis=0)
    size = float(np.linalg.norm(mean))
    if evidence.firmware.is_e_series and (expected := _upright(evidence)) is not None:
        apart = mean - expected
        how = f": {how_different(expected, mean)}" if np.linalg.norm(apart) > 2.0 else ""
        seen = f"tool_accelerometer {np.round(mean, 2).tolist()}; expected {np.round(expected, 2).tolist()} m/s²{how}"
        return Measured(float(np.linalg.norm(apart)), f"{size:.2f} m/s²: {seen}")
    return Measured(abs(size - GRAVITY), f"{size:.2f} m/s² along {np.round(mean / max(size, 1e-9), 2).tolist()}")


def _upright(evidence: Evidence) -> NDArray[np.float64] | None:
    """Return the mean acceleration that a tool at rest measures, shape (3,), in m/s²; None if the arm might be tilted.

    The arm counts as upright if the target moments agree with the gravity torques of the published masses.
    """
    try:
        stands = _stands(evidence)
        known, _ = known_arm(evidence)
        q, moment = _wanted(evidence, "q_target", "M_target")
    except NotTried:
        return None
    at = np.flatnonzero(stands)[:: max(int(stands.sum()) // 50, 1)]
    weight = np.array([Dynamics(known.kinematics).gravity_torque(q[n]) for n in at])
    if np.abs(weight).max() < _HEAVY or float(np.sum(weight * moment[at])) < 0.5 * float(np.sum(weight**2)):
        return None
    turned = [poses.rotvec_to_matrix(known.kinematics.forward(q[n])[3:])[2] for n in at]
    mean: NDArray[np.float64] = GRAVITY * np.mean(turned, axis=0)
    return mean


PHYSICS: Mapping[str, Check] = {
    "values-live": _alive,
    "flags": _flags,
    "tcp-speed": _tcp_speed,
    "values-possible": _possible,
    "modes-known": _modes,
    "tracking": _tracking,
    "velocities": _velocities,
    "kinematics": _kinematics,
    "gravity": _gravity,
    "currents": _currents,
    "accelerometer": _accelerometer,
}
