"""Checks that compare interfaces: they must report the same quantities in the same cycle of the controller.

Packets of the same cycle are recognised by noisy values that are equal to the last bit, because the clocks of two
interfaces might have started at different times. It is assumed that every controller sends the same bits on both
interfaces; the test checks this.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .arrivals import moments
from .evidence import Came, Evidence
from .requirements import Check, Measured, NotTried, counted

Column = NDArray[np.float64]


class _Field(NamedTuple):
    """Names of one quantity on the real-time interface and in RTDE, and its place in a robot state."""

    realtime: str
    rtde: str
    primary: Callable[[Any], Any] | None = None
    is_float32: bool = False
    is_exact: bool = False


def _part(package: str, name: str) -> Callable[[Any], Any]:
    def read(state: Any) -> Any:
        return getattr(getattr(state, package), name, None)

    return read


def _pose(state: Any) -> Any:
    info = state.cartesian_info
    return None if info is None else [info.X, info.Y, info.Z, info.Rx, info.Ry, info.Rz]


_FIELDS = (
    _Field("q_actual", "actual_q", _part("joint_data", "q_actual")),
    _Field("q_target", "target_q", _part("joint_data", "q_target")),
    _Field("qd_actual", "actual_qd", _part("joint_data", "qd_actual")),
    _Field("qd_target", "target_qd"),
    _Field("qdd_target", "target_qdd"),
    _Field("I_actual", "actual_current", _part("joint_data", "I_actual"), is_float32=True),
    _Field("I_target", "target_current"),
    _Field("I_control", "joint_control_output"),
    _Field("M_target", "target_moment"),
    _Field("tool_vector_actual", "actual_TCP_pose", _pose),
    _Field("tool_vector_target", "target_TCP_pose"),
    _Field("tcp_speed_actual", "actual_TCP_speed"),
    _Field("tcp_speed_target", "target_TCP_speed"),
    _Field("tcp_force", "actual_TCP_force"),
    _Field("motor_temperatures", "joint_temperatures", _part("joint_data", "T_motor"), is_float32=True),
    _Field("V_actual", "actual_joint_voltage", _part("joint_data", "V_actual"), is_float32=True),
    _Field("V_main", "actual_main_voltage"),
    _Field("V_robot", "actual_robot_voltage"),
    _Field("I_robot", "actual_robot_current"),
    _Field("tool_accelerometer", "actual_tool_accelerometer"),
    _Field("elbow_position", "elbow_position"),
    _Field("elbow_velocity", "elbow_velocity"),
    _Field("linear_momentum_norm", "actual_momentum"),
    _Field("speed_scaling", "speed_scaling", _part("robot_mode_data", "speed_scaling")),
    _Field(
        "digital_input_bits",
        "actual_digital_input_bits",
        _part("masterboard_data", "digital_input_bits"),
        is_exact=True,
    ),
    _Field(
        "digital_output_bits",
        "actual_digital_output_bits",
        _part("masterboard_data", "digital_output_bits"),
        is_exact=True,
    ),
    _Field("payload_mass", "payload"),
    _Field("payload_cog", "payload_cog"),
    _Field("payload_inertia", "payload_inertia"),
    _Field("robot_mode", "robot_mode", _part("robot_mode_data", "robot_mode"), is_exact=True),
    _Field("joint_modes", "joint_mode", _part("joint_data", "joint_modes"), is_exact=True),
    _Field("safety_mode", "safety_mode", _part("masterboard_data", "safety_mode"), is_exact=True),
    _Field("safety_status", "safety_status", is_exact=True),
    _Field("program_state", "runtime_state", is_exact=True),
)

#: RTDE variables that are requested while listening to a controller.
RTDE_NAMES = ("timestamp", *(each.rtde for each in _FIELDS), "target_speed_fraction", "time_scale_source")

#: Noisy values that identify packets of the same cycle.
_KEYS = ("q_actual", "I_actual", "qd_actual", "tcp_force", "motor_temperatures", "tool_vector_actual")
#: Minimum number of pairs with which a match is accepted.
_FEWEST = 8
#: Largest relative differences because of rounding, for numbers of 64 and of 32 bits; and the fraction of packets that
#: may differ.
_ROUNDING, _ROUNDING_32, _SOME = 1e-6, 1e-5, 0.02
#: Time in s. A delay of this computer can still affect a packet that arrives within this time after the delay.
_EARLIER = 1.0


class _Joined(NamedTuple):
    """Packets of the same cycle on the real-time interface and on another interface, as pairs of their indices.

    Attributes:
        own: Indices on the real-time interface, shape (n,).
        other: Indices on the other interface, shape (n,).
        offset: Time by which the clock of the other interface is ahead, in s; None if it cannot be found from the
            values.
    """

    own: NDArray[np.intp]
    other: NDArray[np.intp]
    offset: float | None


def _column(evidence: Evidence, which: str, each: _Field) -> Column | None:
    packets: Came = getattr(evidence, which)
    if which in ("primary", "secondary"):
        return None if each.primary is None else packets.column(each.primary)
    return packets.values(each.rtde if which == "rtde" else each.realtime)


def _join(evidence: Evidence, which: str) -> _Joined:
    own, other = moments("realtime", evidence.realtime), moments(which, getattr(evidence, which))
    offset = _offset(evidence, which, own, other)
    ahead = _ahead(evidence, which, own, other) if offset is None else offset
    order = np.argsort(own)
    at = np.clip(np.searchsorted(own[order], other - ahead), 1, len(own) - 1)
    before, after = own[order][at - 1], own[order][at]
    nearest = order[np.where(np.abs(before - (other - ahead)) <= np.abs(after - (other - ahead)), at - 1, at)]
    is_same = np.abs(own[nearest] - (other - ahead)) < 5e-4
    return _Joined(nearest[is_same], np.flatnonzero(is_same), offset)


def _offset(evidence: Evidence, which: str, own: Column, other: Column) -> float | None:
    """Return the time by which the other clock is ahead, in s, computed from values that both interfaces have sent."""
    for each in _FIELDS:
        if each.realtime not in _KEYS:
            continue
        mine, theirs = _column(evidence, "realtime", each), _column(evidence, which, each)
        if mine is None or theirs is None or mine.shape[1:] != theirs.shape[1:]:
            continue
        if each.is_float32 and which in ("primary", "secondary"):
            mine = mine.astype(np.float32).astype(np.float64)
        rows = [row.tobytes() for row in mine]
        once = {key for key, count in Counter(rows).items() if count == 1}
        place = {row: at for at, row in enumerate(rows) if row in once}
        pairs = [(place[key], at) for at, key in enumerate(row.tobytes() for row in theirs) if key in place]
        if len(pairs) >= _FEWEST:
            differences = np.array([other[there] - own[here] for here, there in pairs])
            middle = float(np.median(differences))
            if np.mean(np.abs(differences - middle) < 5e-4) > 0.9:
                return middle
    return None


def _ahead(evidence: Evidence, which: str, own: Column, other: Column) -> float:
    """Return the time by which the other clock is ahead, in s, computed from delays, and rounded to a cycle.

    The smallest delays of both interfaces are compared. This method is used if no values change from cycle to cycle.
    """
    packets: Came = getattr(evidence, which)
    ahead = float((evidence.realtime.arrived - own).min() - (packets.arrived - other).min())
    assert evidence.firmware is not None
    return round(ahead * evidence.firmware.rate) / evidence.firmware.rate


def _agree(evidence: Evidence) -> Measured:
    wrong: dict[str, dict[str, str]] = {}
    count, tried = 0, []
    for which in ("rtde", "primary", "secondary"):
        try:
            joined = _join(evidence, which)
        except NotTried:
            continue
        if len(joined.own) < _FEWEST:
            wrong.setdefault("time", {})[which] = "no packets of the same cycle were found"
            continue
        tried.append(which)
        rows: dict[tuple[str, str], Column] = {}
        for each in _FIELDS:
            for side, chosen in (("realtime", joined.own), (which, joined.other)):
                if (column := _column(evidence, side, each)) is not None:
                    rows[side, each.realtime] = column[chosen]
        for each in _FIELDS:
            mine, theirs = rows.get(("realtime", each.realtime)), rows.get((which, each.realtime))
            if mine is None or theirs is None or mine.shape != theirs.shape:
                continue
            count += 1
            rounding = _ROUNDING_32 if each.is_float32 and which != "rtde" else _ROUNDING
            if each.is_exact:
                arrived = getattr(evidence, which).arrived[joined.other]
                said = _other_mode(mine, theirs, partial(_is_disturbed, evidence, arrived))
            else:
                said = _difference(each.realtime, mine, theirs, rounding, rows)
            if said:
                wrong.setdefault(each.realtime, {})[which] = said
    if not tried:
        raise NotTried("no two interfaces have sent enough packets of the same cycles")
    return counted([_odd_one(name, said, tried) for name, said in wrong.items()], f"{count} pairs of fields agree")


def _odd_one(name: str, said: Mapping[str, str], tried: Sequence[str]) -> str:
    """Return a description of a difference. If a third interface shows which of two is wrong, name the wrong one."""
    each = next((each for each in _FIELDS if each.realtime == name), None)
    odd, first = next(iter(said.items()))
    if each is None or each.primary is None or len(tried) < 2:
        return f"realtime {name} and {', '.join(said)} {each.rtde if each else ''}: {first}".replace("  ", " ")
    if "primary" in said and "rtde" in said:
        return f"realtime {name}, against rtde and primary: {first}"
    if len(said) > 1:
        return f"{' and '.join(said)} {name}, against the others: {first}"
    return f"{odd} {each.rtde if odd == 'rtde' else name}, against the others: {first}"


def _is_disturbed(evidence: Evidence, arrived: Column, at: int) -> bool:
    """Return whether this computer was busy around one of the packets that arrived at these times, in s."""
    begin, end = arrived[max(at - 1, 0)], arrived[min(at + 1, len(arrived) - 1)]
    return evidence.busy(float(begin) - _EARLIER, float(end)) != ""


def _other_mode(own: Column, other: Column, is_disturbed: Callable[[int], bool]) -> str:
    """Return a description of the difference of a mode on two interfaces; "" if there is none.

    A mode may change one state later on one of the interfaces. If only few states differ, a state does not count if
    `is_disturbed` returns True for its index. A busy computer can lose the states before and after it, and a simulated
    controller can be interrupted between two interfaces.
    """
    own, other = own.reshape(len(own), -1), other.reshape(len(other), -1)
    before, after = np.vstack([own[:1], own[:-1]]), np.vstack([own[1:], own[-1:]])
    wrong = ~((other == own) | (other == before) | (other == after))
    rows = np.flatnonzero(wrong.any(axis=1)).tolist()
    if len(rows) <= _SOME * len(own):
        rows = [row for row in rows if not is_disturbed(row)]
    if not rows:
        return ""
    at = rows[0]
    which = int(np.argmax(wrong[at]))
    return f"{other[at, which]:g} instead of {own[at, which]:g} in {len(rows)} of {len(own)} states"


def _difference(field: str, own: Column, other: Column, rounding: float, rows: Mapping[tuple[str, str], Column]) -> str:
    """Return a description of the difference of a field on two interfaces; "" if there is none.

    `rows` contains the rows of all fields.
    """

    def same(a: Column, b: Column) -> bool:
        far = np.abs(a - b) > rounding * np.maximum(1.0, np.abs(a))
        return bool(np.mean(far.reshape(len(far), -1).any(axis=1)) <= _SOME)

    if same(own, other):
        return ""
    worst = float(np.nanmax(np.abs(own - other)))
    twins = {name: found for (side, name), found in rows.items() if side != "realtime"}
    for (side, name), found in rows.items():
        pair = (found, other) if side == "realtime" else (own, found)
        twin = twins.get(name) if side == "realtime" else rows.get(("realtime", name))
        # Some quantities are equal on every arm, such as I_control and I_target.
        if twin is not None and twin.shape == own.shape and same(twin, other if side == "realtime" else own):
            continue
        varies = found.shape == own.shape and np.ptp(found) > 0.0
        if name != field and varies and np.any(own != 0.0) and same(*pair):
            return f"the values of {name} are in its place"
    return f"{likeness(own, other)}, with a difference of up to {worst:.4g}"


def likeness(right: Column, wrong: Column) -> str:
    """Return a description of the difference of `wrong` from `right`.

    >>> likeness(np.array([[1.0, 2.0], [3.0, 5.0]]), np.array([[-1.0, 2.0], [-3.0, 5.0]]))
    'the sign of 1 of 2 components is inverted'
    """
    right, wrong = right.reshape(len(right), -1), wrong.reshape(len(wrong), -1)
    size = max(float(np.abs(right).max()), 1e-9)

    def near(a: Column, b: Column) -> bool:
        return bool(np.abs(a - b).max() <= 1e-5 * size)

    width = right.shape[1]
    flipped = [near(right[:, k], -wrong[:, k]) and not near(right[:, k], wrong[:, k]) for k in range(width)]
    kept = [near(right[:, k], wrong[:, k]) for k in range(width)]
    if any(flipped) and all(a or b for a, b in zip(flipped, kept, strict=True)):
        return f"the sign of {sum(flipped)} of {width} components is inverted"
    if width > 1 and near(np.sort(right, axis=1), np.sort(wrong, axis=1)):
        return "the same components in another order"
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (wrong / right)[np.abs(right) > 1e-3 * size]
    if len(ratios) and np.ptp(ratios) < 1e-4 * abs(float(np.median(ratios))):
        ratio = float(np.median(ratios))
        ratio = 1.0 / ratio if abs(ratio) < 1.0 else ratio
        hint = next((text for factor, text in _FACTORS.items() if abs(ratio / factor - 1.0) < 1e-3), "")
        return f"one is {ratio:.6g} times the other{hint}"
    apart = wrong - right
    if np.all(np.ptp(apart, axis=0) <= 1e-5 * size) and not near(apart, np.zeros_like(apart)):
        return "a constant is added"
    if np.all(np.ptp(wrong, axis=0) == 0.0) and np.any(np.ptp(right, axis=0) > 0.0):
        return "it stays the same while the other changes"
    return "other values"


_FACTORS = {180.0 / np.pi: " (degrees?)", 1000.0: " (thousandths?)", 100.0: " (percent?)"}


def _fresh(which: str) -> Check:
    def check(evidence: Evidence) -> Measured:
        joined = _join(evidence, which)
        packets: Came = getattr(evidence, which)
        if joined.offset is None:
            raise NotTried("no values change from cycle to cycle, so packets of the same cycle cannot be recognised")
        later = packets.arrived[joined.other] - evidence.realtime.arrived[joined.own]
        value = float(np.quantile(later, 0.25))
        seen = f"{value * 1e3:+.1f} ms in {len(later)} cycles; its clock is {joined.offset:+.3f} s ahead"
        return Measured(max(value, 0.0), seen)

    return check


AGREEMENT: Mapping[str, Check] = {
    "fields-agree": _agree,
    "rtde-fresh": _fresh("rtde"),
    "primary-fresh": _fresh("primary"),
}
