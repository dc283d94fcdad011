"""Finds the cause of a stop: from the code of the controller, and from the fields that real logs have.

Each possible cause gets a score from 0 to 1 for the evidence of each kind, and the scores of independent evidence are
combined. The texts of the controller are not used. A field that is missing gives no evidence, and is listed in
`StopExplanation.missing`; it never raises an error.

All thresholds are assumed. They are several times larger than the noise, lag and drift of the real arms whose logs were
read, and smaller than the values in simulated stops.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from linkcore.errors import LinkError
from linkcore.streaming.flight_record import Sent

from ..arm.dynamics import GRAVITY
from ..arm.kinematics import Arm
from ..arm.models import MODELS, Model
from ..arm.motors import motors_of
from ..arm.vectors import JOINTS, FloatArray
from ..errors.stop_explanation import StopCause, StopCurves, StopExplanation
from ..protocol.enums import SafetyMode
from ..script.links import STOP, WAIT
from ..script.messages import MESSAGE_SIZE, read_message
from .codes import Code, code_of
from .stop_record import Key, Report, StopMoment, StopRecord

#: Time before and after the stop that is examined, in s.
BEFORE, AFTER = 2.0, 1.0
#: Time before the stop in which a cause shows itself, in s. The values before it are the base for comparisons.
_ONSET = 0.12
#: Period before the stop from which the base values are computed, in s.
_BASE = (1.5, 0.25)
#: Longest time from the stop to the report with its code, and from the report to the stop, in s.
_REPORT_AFTER, _REPORT_BEFORE = 1.0, 0.5
#: Deviation of a joint, in rad: largest normal one, and one that is a clear sign.
_DEVIATION, _CLEAR_DEVIATION = 0.003, 0.02
#: Change of the force at the tool, in N: largest normal one, and one that is a clear sign.
_FORCE, _CLEAR_FORCE = 25.0, 80.0
#: Change of the external torque of a joint as a fraction of the maximum torque: largest normal one, and a clear sign.
_TORQUE, _CLEAR_TORQUE = 0.12, 0.4
#: Unknown mass at the flange, in kg: largest normal one, and one that is a clear sign. Smallest share of the torques
#: that the weight of the mass must explain.
_MASS, _CLEAR_MASS, _EXPLAINED = 0.8, 2.0, 0.8
#: Distance between shoulder and wrist, as a fraction of the length of both arm links, from which the arm is stretched.
_STRETCHED, _CLEARLY_STRETCHED = 0.93, 0.98
#: Speed of the elbow in rad/s from which it counts as straightening.
_STRAIGHTENING = 0.2
#: The same fractions as `_STRETCHED` for a fast elbow while the tool moves more slowly than `_SLOW_TOOL`, in m/s.
_STRETCHING, _SLOW_TOOL = (0.91, 0.96), 0.6
#: Distance of a joint from the end of its range, in rad, that counts as close.
_CLOSE = 0.06
#: Sine of the angle of wrist 2 below which the wrist is close to singular, and clearly singular.
_WRIST, _CLEAR_WRIST = 0.2, 0.05
#: Horizontal distance of the wrist from the axis of the base in m, in addition to the offset of the arm, that is close.
_SHOULDER, _CLEAR_SHOULDER = 0.1, 0.02
#: Acceleration as a multiple of the limit of the joint that no target should have, and one that is a clear sign.
_SUDDEN, _CLEARLY_SUDDEN = 1.5, 4.0
#: Maximum joint speeds in rad/s if the model is unknown: those of most e-Series arms.
_SPEEDS = np.full(6, np.pi)
#: Beginning of the text with which urlink permits a program to start.
_PERMISSION = b"sec urlink_permission"
#: Time in which the start of one program and the end of another belong together, in s.
_TOGETHER = 0.3

_EMERGENCY = (
    SafetyMode.SYSTEM_EMERGENCY_STOP,
    SafetyMode.ROBOT_EMERGENCY_STOP,
    SafetyMode.IMMI_EMERGENCY_STOP,
    SafetyMode.PROFISAFE_EMERGENCY_STOP,
)
_SAFEGUARD = (
    SafetyMode.SAFEGUARD_STOP,
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP,
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP,
    SafetyMode.TP_THREE_POSITION_ENABLING_STOP,
    SafetyMode.IMMI_SAFEGUARD_STOP,
    SafetyMode.PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP,
    SafetyMode.PROFISAFE_SAFEGUARD_STOP,
    SafetyMode.SAFETY_API_SAFEGUARD_STOP,
)

#: What to do about each cause.
_REMEDIES = {
    "another client": "find out which program or person uses this robot too, and let only one of them command it",
    "clamping": "choose a path on which the tool stays away from the lower arm",
    "contact": "remove what the arm touched, or move more slowly and use force mode or until_contact for contacts",
    "emergency": "release the emergency stop button, and switch the arm on again",
    "fault": "restart the controller; if it happens again, contact the service",
    "fieldbus": "reconnect the fieldbus",
    "joint speed": "lower the speed, or give the motion more time",
    "joint torque": "lower the acceleration, and check the payload setting",
    "position deviation": "check payload, centre of gravity, acceleration and the joint; the data show no contact",
    "program request": "read the program that called protective_stop()",
    "reach": "choose targets inside the workspace; a stretched arm or a joint near its end cannot continue",
    "safeguard": "close the gate, or release the device at the safeguard input; then let the program continue",
    "singularity": "use a joint motion here, or choose a path or posture away from the singularity",
    "sudden change of target": "send set-points without jumps: limit speed and acceleration, and send them on time",
    "wrong payload": "set mass and centre of gravity of the load that the arm really carries",
}


class _Sign(NamedTuple):
    """Evidence for one cause."""

    cause: str
    score: float
    observed: str
    text: str = ""
    joint: int | None = None
    value: float | None = None
    limit: float | None = None
    unit: str = ""


def explain(record: StopRecord) -> list[StopExplanation]:
    """Return the explanations of all stops in a record, in order of time."""
    found = [explain_stop(record, stop) for stop in record.stops]
    found += _program_stops(record, [each.at for each in found if each.at is not None])
    return sorted(found, key=lambda each: each.at or 0.0)


def explain_stop(record: StopRecord, stop: StopMoment) -> StopExplanation:
    """Return the explanation of one safety stop."""
    at = float(record.time[stop.row])
    near = record.between(at - BEFORE, at + AFTER)
    return _explained(near, at, stop.mode, _kind(stop.mode), had_begun=stop.had_begun)


def explain_mode(record: StopRecord, mode: SafetyMode, at: float, *, had_begun: bool = False) -> StopExplanation:
    """Return the explanation of a stop at a known time, even if no row of the record shows it."""
    return _explained(record.between(at - BEFORE, at + AFTER), at, mode, _kind(mode), had_begun=had_begun)


def _kind(mode: SafetyMode) -> str:
    if mode is SafetyMode.UNDEFINED:
        return "stop (inferred: no column contains the safety mode)"
    name = mode.name.replace("_", " ").lower()
    return name if "stop" in name or name in ("violation", "fault") else f"safety mode {name}"


def _explained(near: StopRecord, at: float, mode: SafetyMode, kind: str, *, had_begun: bool) -> StopExplanation:
    report, code = _report(near, at)
    missing = [*near.missing, *_missing(near, report)]
    if had_begun:
        missing.append("everything before the stop: the data begin during the stop")
    curves: tuple[StopCurves, ...] = ()
    commanded: tuple[str, ...] = ()
    signs = _by_mode(mode)
    if code is not None:
        signs += _by_code(code)
    observed = _Observed(near, at)
    if not had_begun:
        signs += _observations(observed, is_protective=not signs or code is not None)
        curves, commanded = observed.curves(code), observed.commanded()
        signs += _by_programs(near, at, code)
    causes = _ranked(signs) or (
        StopCause("unknown", 0.0, "The data show no cause.", remedy="Read the log on the pendant."),
    )
    name = None if report is None else f"C{report.code}A{max(report.argument, 0)}"
    return StopExplanation(
        kind,
        causes,
        at,
        name,
        None if code is None else _sentence(_named(code.text, code.joint)),
        None if code is None else code.source,
        None if code is None else code.evidence,
        commanded,
        tuple(dict.fromkeys(missing)),
        curves,
    )


# -- evidence from modes, codes and programs ---------------------------------------------------------------


def _by_mode(mode: SafetyMode) -> list[_Sign]:
    if mode in _EMERGENCY:
        whose = "an external emergency stop" if mode is SafetyMode.SYSTEM_EMERGENCY_STOP else "an emergency stop"
        return [_Sign("emergency", 1.0, f"the safety mode is {mode.name}", f"{whose} was pressed")]
    if mode in _SAFEGUARD:
        text = "a safeguard input stopped the arm, for example a gate, a light curtain or an enabling switch"
        return [_Sign("safeguard", 1.0, f"the safety mode is {mode.name}", text)]
    if mode is SafetyMode.FAULT:
        return [_Sign("fault", 0.5, "the safety mode is FAULT", "the safety system reports a fault")]
    return []


def _report(near: StopRecord, at: float) -> tuple[Report | None, Code | None]:
    """Return the report of this stop, and the meaning of its code."""
    reports = [
        each for each in near.reports or () if at - _REPORT_BEFORE <= each.time <= at + _REPORT_AFTER and each.code > 0
    ]
    known = [(each, code) for each in reports if (code := code_of(each.code, each.argument)) is not None]
    if known:
        # The first code that names a cause is nearer to the origin than the codes that follow from it.
        return known[0]
    return (reports[0], None) if reports else (None, None)


def _by_code(code: Code) -> list[_Sign]:
    # C153 reports what a joint measured, which a contact or a wrong payload can cause too.
    score = {153: 0.55, 159: 0.55}.get(int(code.name[1:].partition("A")[0]), 0.8)
    return [_Sign(code.cause, score, f"the controller reports {code.name}", _named(code.text, code.joint), code.joint)]


def _by_programs(near: StopRecord, at: float, code: Code | None) -> list[_Sign]:
    """Return the evidence that a program of another client requested the stop."""
    if code is None or code.cause != "program request" or near.is_own is None:
        return []
    started = [each for each in near.keys or () if each.title.endswith("STARTED") and each.time <= at + _TOGETHER]
    if started and not near.is_own(started[-1].text):
        name = started[-1].text
        return [_Sign("another client", 0.9, f"the program {name!r} was not sent by this program")]
    return []


def _program_stops(record: StopRecord, stops: Sequence[float]) -> list[StopExplanation]:
    """Return the explanations of programs that ended because another client replaced or stopped them."""
    found = []
    for end in record.keys or ():
        if not end.title.endswith("STOPPED") or any(abs(end.time - at) < 1.0 for at in stops):
            continue
        sign = _of_program(record, end)
        if sign is not None:
            near = record.between(end.time - BEFORE, end.time + AFTER)
            observed = _Observed(near, end.time)
            missing = tuple(dict.fromkeys([*near.missing, *_missing(near, None, needs_code=False)]))
            found.append(
                StopExplanation(
                    "program stopped",
                    _ranked([sign]),
                    end.time,
                    commanded=observed.commanded(),
                    missing=missing,
                    curves=observed.curves(None),
                )
            )
    return found


def _of_program(record: StopRecord, end: Key) -> _Sign | None:
    others = [
        each
        for each in record.keys or ()
        if each.title.endswith("STARTED") and each.text != end.text and abs(each.time - end.time) < _TOGETHER
    ]
    if record.is_own is not None:
        if not record.is_own(end.text):
            return None
        foreign = [each for each in others if not record.is_own(each.text)]
        if foreign:
            text = f"the program {foreign[0].text!r} of another client replaced the program of this client"
            return _Sign("another client", 0.95, f"{foreign[0].title} {foreign[0].text!r}", text)
        if not others and not _was_stopped_here(record, end) and _was_moving(record, end.time):
            text = "another client, the dashboard or the pendant stopped the program while the arm moved"
            return _Sign("another client", 0.7, "this program sent no stop", text)
        return None
    foreign = [each for each in others if _owner(each.text) != _owner(end.text)]
    if foreign and _was_moving(record, end.time):
        text = f"the program {foreign[0].text!r} replaced {end.text!r} while the arm moved"
        return _Sign("another client", 0.6, f"{foreign[0].title} {foreign[0].text!r}", text)
    return None


def _owner(name: str) -> str:
    """Return the part of the name of a program that all programs of one `Robot` share."""
    parts = name.split("_")
    return "_".join(parts[:2]) if len(parts) > 2 else name


def _was_stopped_here(record: StopRecord, end: Key) -> bool:
    words = (b"stop", b"halt", b"power off", b"pause", b"urlink_stop", b"abort", b"def ")
    return any(
        end.time - 1.0 <= each.time <= end.time + 0.05 and any(word in each.data.lower() for word in words)
        for each in record.sent
        if each.channel in ("primary", "dashboard", "interpreter")
    ) or any(
        # This message ends a program that follows set-points.
        end.time - 1.0 <= each.time <= end.time + 0.05 and message[1] == STOP
        for each in record.sent
        if (message := _message(each)) is not None
    )


def _was_moving(record: StopRecord, at: float) -> bool:
    speeds = record.columns.get("qd_target", record.columns.get("qd_actual"))
    if speeds is None or speeds.ndim != 2:
        return False
    rows = (record.time >= at - 0.15) & (record.time <= at + 0.02)
    return bool(rows.any() and np.nanmax(np.abs(speeds[rows]), initial=0.0) > 0.02)


# -- evidence from the fields --------------------------------------------------------------------------------


class _Observed:
    """Quantities around a stop, computed from the columns that there are."""

    def __init__(self, near: StopRecord, at: float) -> None:
        self.near, self.at = near, at
        self.time = near.time - at
        step = float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.008
        self.step = max(step, 1e-3)
        # The last row before the stop, and at slow rates one more, in which the arm might brake already.
        end = int(np.searchsorted(self.time, 0.0, side="left"))
        begin = int(np.searchsorted(self.time, -max(_ONSET, 1.5 * self.step), side="left"))
        self.onset = slice(max(min(begin, end - 1), 0), end + 1)
        self.base = slice(*np.searchsorted(self.time, (-_BASE[0], -_BASE[1])).tolist())
        self.model = near.model

    def rows(self, name: str) -> FloatArray | None:
        """Return a column of vectors with six numbers, or None."""
        column = self.near.columns.get(name)
        if column is None or column.ndim != 2 or column.shape[1] != 6 or not np.isfinite(column).any():
            return None
        return column

    @cached_property
    def speeds(self) -> FloatArray | None:
        """Target speeds of the joints; else differences of the target positions; else actual speeds."""
        found = self.rows("qd_target")
        if found is None and (q := self.rows("q_target")) is not None and len(q) > 1:
            found = np.gradient(q, axis=0) / self.step
        return self.rows("qd_actual") if found is None else found

    @cached_property
    def max_speed(self) -> FloatArray:
        return _SPEEDS if self.model is None else self.model.max_speed

    @cached_property
    def deviation(self) -> FloatArray | None:
        """Deviation of the joints from their targets, in rad."""
        actual, target = self.rows("q_actual"), self.rows("q_target")
        if actual is None or target is None:
            return None
        return actual - target

    @cached_property
    def posture(self) -> FloatArray | None:
        """Joint positions at the stop."""
        for name in ("q_target", "q_actual"):
            q = self.rows(name)
            if q is not None:
                known = q[self.onset][np.isfinite(q[self.onset]).all(axis=1)]
                if len(known):
                    last: FloatArray = known[-1]
                    return last
        return None

    @cached_property
    def external(self) -> FloatArray | None:
        """External torques of the joints according to the currents, in Nm; needs the model."""
        actual, target = self.rows("I_actual"), self.rows("I_target")
        if actual is None or target is None or self.model is None:
            return None
        found: FloatArray = -np.array(motors_of(self.model).torque_constants) * (actual - target)
        return found

    def baseline(self, column: FloatArray) -> FloatArray | None:
        """Return the median of the rows well before the stop; None if there are too few of them."""
        rows = column[self.base]
        rows = rows[np.isfinite(rows).all(axis=1)]
        return np.median(rows, axis=0) if len(rows) >= 3 else None

    def commanded(self) -> tuple[str, ...]:
        """Return what was commanded at the stop."""
        said = []
        if (speeds := self.rows("qd_target")) is not None and len(rows := speeds[self.onset]):
            peak = rows[int(np.argmax(np.nan_to_num(np.abs(rows)).max(axis=1)))]
            said.append(f"joint speeds {_list(peak, 3)} rad/s")
        if (tool := self.rows("tcp_speed_target")) is not None and len(rows := tool[self.onset]):
            speed = float(np.nan_to_num(np.linalg.norm(rows[:, :3], axis=1)).max())
            said.append(f"a tool speed of {speed:.3f} m/s")
        if (q := self.posture) is not None:
            said.append(f"joint positions {_list(q, 3)} rad")
        scaling = self.near.columns.get("speed_scaling")
        if scaling is not None and scaling.ndim == 1 and len(known := scaling[self.onset]) and np.isfinite(known[0]):
            said.append(f"a speed scaling of {100 * float(known[0]):.0f} %")
        running = [
            each.text for each in self.near.keys or () if each.title.endswith("STARTED") and each.time <= self.at
        ]
        if running:
            said.append(f"the program {running[-1]!r}")
        before = [each for each in self.near.sent if each.time <= self.at + self.step]
        texts = [
            each
            for each in before
            if each.channel in ("primary", "dashboard", "interpreter") and not each.data.startswith(_PERMISSION)
        ]
        if texts:
            words = texts[-1].data.decode("utf-8", "replace").strip().splitlines() or [""]
            said.append(f"{self.at - texts[-1].time:.2f} s before, to {texts[-1].channel}: {words[0][:60]!r}")
        setpoints = [each for each in before if each.channel == "program" and self.at - each.time < 1.0]
        if setpoints:
            said.append(
                f"{len(setpoints)} set-points in the last second, the last {self.at - setpoints[-1].time:.3f} s before"
            )
        return tuple(said)

    def curves(self, code: Code | None) -> tuple[StopCurves, ...]:
        """Return the curves of the last second."""
        rows = np.flatnonzero((self.time >= -1.0) & (self.time <= 0.15))
        if not len(rows):
            return ()
        rows = rows[:: max(len(rows) // 600, 1)]
        time = tuple(self.time[rows].tolist())
        shown: list[tuple[str, str, FloatArray | None, Sequence[str], float | None]] = [
            ("actual minus target positions", "rad", self.deviation, JOINTS, None),
            ("target joint speeds", "rad/s", self.speeds, JOINTS, float(self.max_speed.min())),
            ("force at the tool", "N", self.rows("tcp_force"), ("x", "y", "z"), None),
        ]
        return tuple(
            StopCurves(
                name, unit, tuple(labels), time, tuple(map(tuple, values[rows].T[: len(labels)].tolist())), limit
            )
            for name, unit, values, labels, limit in shown
            if values is not None
        )


_Look = Callable[[_Observed], "list[_Sign]"]


def _observations(observed: _Observed, *, is_protective: bool) -> list[_Sign]:
    """Return the evidence of all fields for the causes of a protective stop."""
    if not is_protective or not len(observed.time):
        return []
    looks: tuple[_Look, ...] = (_deviation, _force, _payload, _speed, _posture, _sudden, _sudden_sent)
    signs: list[_Sign] = []
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of numpy, for rows that contain only unknown values
        for look in looks:
            try:
                signs += look(observed)
            except (LinkError, ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError):
                continue  # fields that do not fit together give no evidence
    if not any(sign.score >= 0.35 for sign in signs) and observed.speeds is not None and observed.deviation is not None:
        text = "the targets were refused before the arm followed them"
        signs.append(_Sign("sudden change of target", 0.3, "nothing else is unusual before the stop", text))
    return signs


def _share(value: float, normal: float, clear: float) -> float:
    """Return 0 for a normal value, 1 for a clear one, and a share between them."""
    return float(min(max((value - normal) / (clear - normal), 0.0), 1.0))


def _deviation(observed: _Observed) -> list[_Sign]:
    deviation = observed.deviation
    if deviation is None:
        return []
    speeds = observed.rows("qd_actual")
    # An actual position lags behind its target by a few milliseconds, also in logs with slow rates.
    allowed = 0.0 if speeds is None else 0.004 * np.abs(speeds)
    size = np.maximum(np.abs(deviation) - allowed, 0.0)[observed.onset]
    base = observed.baseline(np.abs(deviation))
    peaks = np.nanmax(size, axis=0) - (0.0 if base is None else np.minimum(base, _DEVIATION))
    joint = int(np.nanargmax(peaks))
    peak = float(np.nanmax(np.abs(deviation[observed.onset][:, joint])))
    share = _share(float(peaks[joint]), _DEVIATION, _CLEAR_DEVIATION)
    if not share:
        return []
    text = f"{JOINTS[joint]} was {peak:.4f} rad away from its target"
    return [
        _Sign("position deviation", 0.75 * share, text, text, joint, peak, _DEVIATION, "rad"),
        *([_Sign("contact", 0.2 * share, text)] if observed.rows("tcp_force") is None else []),
    ]


def _force(observed: _Observed) -> list[_Sign]:
    signs = []
    force = observed.rows("tcp_force")
    if force is not None and (base := observed.baseline(force)) is not None:
        change = np.linalg.norm((force - base)[observed.onset][:, :3], axis=1)
        steady = np.linalg.norm((force - base)[observed.base][:, :3], axis=1)
        noise = float(np.nanpercentile(steady, 95))
        peak = float(np.nanmax(change))
        share = _share(peak, max(_FORCE, 3.0 * noise), max(_CLEAR_FORCE, 6.0 * noise))
        if share:
            text = f"the force at the tool changed by {peak:.0f} N"
            signs.append(_Sign("contact", 0.8 * share, text, text, None, peak, max(_FORCE, 3.0 * noise), "N"))
    external, deviation = observed.external, observed.deviation
    if external is not None and (base := observed.baseline(external)) is not None and observed.model is not None:
        change = np.abs(external - base)[observed.onset] / observed.model.max_torque
        joint = int(np.nanargmax(np.nanmax(change, axis=0)))
        peak = float(np.nanmax(change[:, joint]))
        # A joint that deviates is pushed by the controller, which is not a contact.
        is_pushed = deviation is not None and float(np.nanmax(np.abs(deviation[observed.onset][:, joint]))) > _DEVIATION
        share = 0.0 if is_pushed else _share(peak, _TORQUE, _CLEAR_TORQUE)
        if share:
            text = f"the external torque of {JOINTS[joint]} changed by {peak * observed.model.max_torque[joint]:.0f} Nm"
            signs.append(_Sign("contact", 0.5 * share, text, text, joint))
    return signs


def _payload(observed: _Observed) -> list[_Sign]:
    """Compare persistent external torques, and the persistent force, with those of a weight at the flange."""
    q, signs = observed.posture, []
    if q is None:
        return []
    external, force = observed.external, observed.rows("tcp_force")
    mass_of_currents: float | None = None
    if external is not None and observed.model is not None:
        steady = observed.baseline(external)
        if steady is None:
            steady = np.nanmedian(external[observed.onset], axis=0)
        weight = Arm(observed.model).jacobian(q).T @ np.array([0.0, 0.0, -GRAVITY, 0.0, 0.0, 0.0])
        loaded = np.array([1, 2, 3])
        fit = float(steady[loaded] @ weight[loaded] / max(weight[loaded] @ weight[loaded], 1e-9))
        rest = steady[loaded] - fit * weight[loaded]
        explained = 1.0 - float(rest @ rest) / max(float(steady[loaded] @ steady[loaded]), 1e-9)
        mass_of_currents = fit if explained > _EXPLAINED else 0.0
    mass_of_force: float | None = None
    if force is not None:
        steady_force = observed.baseline(force)
        if steady_force is None:
            steady_force = np.nanmedian(force[observed.onset], axis=0)
        across, down = float(np.hypot(*steady_force[:2])), -float(steady_force[2])
        mass_of_force = down / GRAVITY if abs(down) > 2.0 * across else 0.0
    masses = [mass for mass in (mass_of_currents, mass_of_force) if mass is not None]
    if masses:
        # If there are both, they have to agree: a sensor that was never zeroed shows a force without a load.
        same = len(masses) == 1 or (masses[0] * masses[1] > 0.0 and 0.5 < abs(masses[0] / masses[1]) < 2.0)
        mass = float(np.mean(masses)) if same else 0.0
        score = 0.85 if len(masses) == 2 else (0.75 if mass_of_currents is not None else 0.4)
        share = _share(abs(mass), _MASS, _CLEAR_MASS)
        if share:
            text = f"the arm carried {abs(mass):.1f} kg {'more' if mass > 0 else 'less'} than the payload setting"
            signs.append(_Sign("wrong payload", score * share, text, text, None, abs(mass), _MASS, "kg"))
    return signs


def _speed(observed: _Observed) -> list[_Sign]:
    speeds = observed.speeds
    if speeds is None:
        return []
    ratios = np.abs(speeds[observed.onset]) / observed.max_speed
    joint = int(np.nanargmax(np.nanmax(ratios, axis=0)))
    ratio = float(np.nanmax(ratios[:, joint]))
    share = _share(ratio, 0.9, 0.99)
    if not share:
        return []
    value, limit = ratio * float(observed.max_speed[joint]), float(observed.max_speed[joint])
    text = f"the target speed of {JOINTS[joint]} reached {value:.2f} rad/s of {limit:.2f} rad/s"
    return [_Sign("joint speed", 0.75 * share, text, text, joint, value, limit, "rad/s")]


def _posture(observed: _Observed) -> list[_Sign]:
    """Compare the posture with the limits of the workspace and with the singular postures."""
    q = observed.posture
    if q is None:
        return []
    signs = []
    speeds = observed.speeds
    fast = 0.0 if speeds is None else float(np.nanmax(np.abs(speeds[observed.onset]) / observed.max_speed))
    turning = 0.0 if speeds is None else float(np.nanmax(np.abs(speeds[observed.onset][:, 0]) / observed.max_speed[0]))
    wrists = 0.0 if speeds is None else float(np.nanmax(np.abs(speeds[observed.onset][:, [3, 5]])))
    tool = observed.rows("tcp_speed_target")
    tool_speed = None if tool is None else float(np.nanmax(np.linalg.norm(tool[observed.onset][:, :3], axis=1)))
    model = observed.model or MODELS["UR5e"]
    outer = _outer(model, q)
    share = _share(outer, _STRETCHED, _CLEARLY_STRETCHED)
    if speeds is not None:
        straightening = float(np.nanmax(-np.sign(q[2]) * speeds[observed.onset][:, 2]))
        if straightening < _STRAIGHTENING:
            share *= 0.5  # the elbow is not what limits the motion
        elif straightening > 0.5 * float(observed.max_speed[2]) and tool_speed is not None and tool_speed < _SLOW_TOOL:
            share = max(share, _share(outer, *_STRETCHING))  # a slow tool needs a fast elbow
    if share:
        text = f"the arm was stretched to {100 * outer:.1f} % of its length"
        signs.append(_Sign("reach", 0.85 * share, text, text, None, outer, 1.0, "of the length"))
    if observed.model is not None:
        left = np.minimum(q - model.position_limits[:, 0], model.position_limits[:, 1] - q)
        joint = int(np.argmin(left))
        if left[joint] < _CLOSE:
            text = f"{JOINTS[joint]} was {max(float(left[joint]), 0.0):.3f} rad from the end of its range"
            limit = float(model.position_limits[joint, int(q[joint] > 0)])
            signs.append(_Sign("reach", 0.8, text, text, joint, float(q[joint]), limit, "rad"))
    # A singular posture stops the arm only if the tool has to move in a direction that it cannot have.
    urgent = max(_share(fast, 0.25, 0.6), 0.25)
    sine = abs(float(np.sin(q[4])))
    share = _share(_WRIST - sine, 0.0, _WRIST - _CLEAR_WRIST)
    if share and wrists > 0.3 and share * urgent > 0.05:
        text = f"wrist 2 was at {float(q[4]):.3f} rad, where the axes of wrist 1 and wrist 3 are parallel"
        signs.append(_Sign("singularity", 0.9 * share * urgent, text, text, 4, sine, _WRIST, "(sine)"))
    distance = _beside_axis(model, q)
    share = _share(_SHOULDER - distance, 0.0, _SHOULDER - _CLEAR_SHOULDER)
    if share and turning > 0.2:
        text = f"the wrist was {distance:.3f} m from the axis of the base, above or below the shoulder"
        urgent = max(_share(turning, 0.25, 0.6), 0.25)
        signs.append(_Sign("singularity", 0.9 * share * urgent, text, text, 0))
    return signs


def _outer(model: Model, q: FloatArray) -> float:
    """Return the distance from the shoulder to wrist 1 as a fraction of the length of both arm links."""
    a2, a3 = abs(float(model.dh_a[1])), abs(float(model.dh_a[2]))
    return float(np.sqrt(a2 * a2 + a3 * a3 + 2.0 * a2 * a3 * np.cos(q[2]))) / (a2 + a3)


def _beside_axis(model: Model, q: FloatArray) -> float:
    """Return how much further from the axis of the base the centre of the wrist is than the offset of the arm, in m."""
    a2, a3, d4, d5 = float(model.dh_a[1]), float(model.dh_a[2]), float(model.dh_d[3]), float(model.dh_d[4])
    along = a2 * np.cos(q[1]) + a3 * np.cos(q[1] + q[2]) + d5 * np.sin(q[1] + q[2] + q[3])
    return float(np.hypot(along, d4)) - d4


def _sudden(observed: _Observed) -> list[_Sign]:
    speeds = observed.rows("qd_target")
    if speeds is None or observed.step > 0.012:
        return []  # at lower rates, a difference of two rows is not an acceleration
    rows = speeds[max(observed.onset.start - 1, 0) : observed.onset.stop - 1]
    if len(rows) < 2:
        return []
    limits = np.full(6, 40.0) if observed.model is None else observed.model.max_acceleration
    ratios = np.abs(np.diff(rows, axis=0)) / observed.step / limits
    joint = int(np.nanargmax(np.nanmax(ratios, axis=0)))
    ratio = float(np.nanmax(ratios[:, joint]))
    share = _share(ratio, _SUDDEN, _CLEARLY_SUDDEN)
    if not share:
        return []
    value, limit = ratio * float(limits[joint]), float(limits[joint])
    text = f"the target of {JOINTS[joint]} accelerated by {value:.0f} rad/s²"
    return [_Sign("sudden change of target", 0.8 * share, text, text, joint, value, limit, "rad/s²")]


def _sudden_sent(observed: _Observed) -> list[_Sign]:
    """Compare neighbouring set-points that this program sent over the reverse link."""
    points = [
        (each.time, np.array(message[0]))
        for each in observed.near.sent
        if -0.4 <= each.time - observed.at <= 0.02
        if (message := _message(each)) is not None and message[1] not in (STOP, WAIT)
    ]
    worst: tuple[float, int, float] | None = None
    for (before, old), (after, new) in itertools.pairwise(points):
        seconds = max(after - before, observed.step)
        ratios = np.abs(new - old) / (seconds * observed.max_speed)
        joint = int(np.argmax(ratios))
        if worst is None or ratios[joint] > worst[0]:
            worst = float(ratios[joint]), joint, float(abs(new[joint] - old[joint]))
    if worst is None or worst[0] < 2.0:
        return []
    text = f"a set-point moved {JOINTS[worst[1]]} by {worst[2]:.3f} rad at once"
    limit = worst[2] / worst[0]
    return [_Sign("sudden change of target", 0.85, text, text, worst[1], worst[2], limit, "rad")]


def _message(sent: Sent) -> tuple[list[float], int] | None:
    """Return joint positions in rad and the command of a message over the reverse link; None for other bytes."""
    if sent.channel != "program" or len(sent.data) < MESSAGE_SIZE:
        return None
    q, _, command = read_message(sent.data[:MESSAGE_SIZE])
    return q, command


# -- combination -----------------------------------------------------------------------------------------------


def _ranked(signs: Sequence[_Sign]) -> tuple[StopCause, ...]:
    """Combine the evidence for each cause, and return the causes with the best supported one first."""
    signs = _without_consequences(signs)
    causes = []
    for name in dict.fromkeys(sign.cause for sign in signs):
        own = [sign for sign in signs if sign.cause == name]
        doubt = float(np.prod([1.0 - min(sign.score, 0.99) for sign in own]))
        best = max(own, key=lambda sign: (sign.value is not None, bool(sign.text), sign.score))
        text = best.text or best.observed
        joint = next((sign.joint for sign in own if sign.joint is not None), None)
        causes.append(
            StopCause(
                name,
                round(1.0 - doubt, 3),
                _sentence(text),
                tuple(dict.fromkeys(sign.observed for sign in sorted(own, key=lambda sign: -sign.score))),
                _sentence(_REMEDIES.get(name, "read the log on the pendant")),
                None if joint is None else JOINTS[joint],
                best.value,
                best.limit,
                best.unit,
            )
        )
    return tuple(sorted(causes, key=lambda cause: -cause.score))


def _without_consequences(signs: Sequence[_Sign]) -> list[_Sign]:
    """Lower the scores of causes that are only consequences of a better cause."""
    most = {name: max(sign.score for sign in signs if sign.cause == name) for name in {sign.cause for sign in signs}}
    weaker: dict[str, float] = {}
    posture = max(most.get("singularity", 0.0), most.get("reach", 0.0))
    if posture >= 0.4:
        # Close to a singular posture, and at the end of the reach, slow motions of the tool need fast joints.
        weaker |= {"joint speed": 0.4, "sudden change of target": 0.4}
    if most.get("reach", 0.0) >= 0.5:
        weaker["singularity"] = 0.6  # a stretched arm is singular too
    if most.get("contact", 0.0) >= 0.5:
        weaker["position deviation"] = 0.6
    if most.get("wrong payload", 0.0) >= 0.6:
        weaker |= {"contact": 0.6, "position deviation": 0.6}
    return [sign._replace(score=sign.score * weaker.get(sign.cause, 1.0)) for sign in signs]


def _missing(near: StopRecord, report: Report | None, *, needs_code: bool = True) -> list[str]:
    lacking = []
    if needs_code and near.reports is None:
        lacking.append("the code of the controller: messages of the primary interface were not recorded")
    elif needs_code and report is None:
        lacking.append("the code of the controller: it sent none")
    for names, what in (
        (("q_target",), "target positions"),
        (("q_actual",), "actual positions"),
        (("qd_target",), "target speeds"),
        (("I_actual", "I_target"), "currents"),
        (("tcp_force",), "the force at the tool"),
    ):
        if not all(name in near.columns for name in names):
            lacking.append(what)
    if near.model is None:
        lacking.append("the model of the arm")
    return lacking


def _named(text: str, joint: int | None) -> str:
    return text if joint is None else text.replace("this joint", JOINTS[joint])


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}" if text else ""


def _list(values: FloatArray, digits: int) -> str:
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values.tolist()) + "]"
