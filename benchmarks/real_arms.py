"""Simulated values against the logs of real arms, by field and joint; and the parameters that follow from the logs.

The targets of each log are the set-points of a simulated arm of the same model, payload and tool. The table shows R²,
the largest error, and mean, standard deviation and correlation of the residual. The residual is the actual value of the
log or of the simulator, minus the target of the log. The force is that at rest, in the frame of the tool. The
correlation is that of neighbouring rows.

    python benchmarks/real_arms.py FOLDER            # folder with ur3e_rtde.csv and other logs
    python benchmarks/real_arms.py FOLDER --json     # prints one JSON object
    python benchmarks/real_arms.py FOLDER --before OLD.json  # prints Markdown, with the values of another version
    python benchmarks/real_arms.py FOLDER --derive   # prints the rows of parameters.tsv that follow from the logs
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from urlink.arm.dynamics import Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.motors import joint_numbers, motors_of
from urlink.arm.parameters import number
from urlink.arm.poses import matrix_to_rotvec, rotvec_to_matrix
from urlink.simulator import Controller
from urlink.simulator.robot.setpoint_sources import Setpoint

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

UR3E, UR5E, UR5, TORQUE = (
    "ur3e_rtde.csv",
    "ur5e_led_by_hand.csv.gz",
    "ur5_cb3_at_rest.csv.gz",
    "ur5e_torque_joint4.csv.gz",
)
#: Log -> model and firmware.
LOGS = {UR3E: ("UR3e", "5.11"), UR5E: ("UR5e", "5.11"), UR5: ("UR5", "3.15")}
#: Field of RTDE -> the field that is subtracted from it in the residual.
FIELDS = {
    "actual_q": "target_q",
    "actual_qd": "target_qd",
    "actual_current": "target_current",
    "joint_control_output": "target_current",
    "target_current": "target_current",
    "target_moment": "target_moment",
    "joint_temperatures": "",
    "actual_tool_accelerometer": "",
    "force_at_rest": "",
}
_SAMPLED = {
    "actual_q": "q_actual",
    "actual_qd": "qd_actual",
    "actual_current": "I_actual",
    "joint_control_output": "I_control",
    "target_current": "I_target",
    "target_moment": "M_target",
    "joint_temperatures": "T_motor",
    "actual_tool_accelerometer": "accelerometer",
    "actual_TCP_force": "force",
    "actual_TCP_pose": "pose_actual",
}
# Number of rows, 40 ms apart, after which the force and the positions have settled after a stop.
_SETTLED = 3


class Row(NamedTuple):
    """One line of the table; the pairs are (real, simulated).

    Attributes:
        field: Name of the field.
        joint: Number of the joint or of the axis, from 1.
        r2: Fraction of the variance of the real values that the simulated values explain; NaN if the real values are
            constant.
        largest: Largest difference of the real and the simulated values.
        mean, spread, correlation: Of the residual.
    """

    field: str
    joint: int
    r2: float
    largest: float
    mean: tuple[float, float]
    spread: tuple[float, float]
    correlation: tuple[float, float]


class Tool(NamedTuple):
    """Payload and tool of a log.

    Attributes:
        payload: Mass, in kg.
        cog: Centre of mass in the frame of the flange, shape (3,), in m.
        tcp: Tool centre point in the frame of the flange, shape (6,), in m and rad.
    """

    payload: float
    cog: tuple[float, ...]
    tcp: tuple[float, ...]


class Derived(NamedTuple):
    """Parameter that follows from a log.

    Attributes:
        name, of: Key in the table of parameters.
        values: One number, or one for each joint or axis.
        interval: Lowest and highest value of the joints, axes or parts of the log; None for several numbers.
        log: Name of the log.
        how: How the numbers follow from the log.
        digits: Number of significant digits.
    """

    name: str
    of: str
    values: tuple[float, ...]
    interval: tuple[float, float] | None
    log: str
    how: str
    digits: int = 3

    @property
    def texts(self) -> tuple[str, str, str, str]:
        """Value, both ends of the interval, and source, as in the table of parameters."""
        low, high = ("", "") if self.interval is None else (f"{each:.{self.digits}g}" for each in self.interval)
        return (
            " ".join(f"{each:.{self.digits}g}" for each in self.values),
            low,
            high,
            f"{self.log.split('.')[0]}: {self.how}",
        )


class Replay:
    """Set-points of a log, with linear interpolation between its rows."""

    is_program = False

    def __init__(self, times: Array, columns: Sequence[Array]) -> None:
        self._times, self._columns, self._time = times - times[0], columns, 0.0

    def start(self, q: Sequence[float]) -> None:
        """Begin with the first row."""

    def advance(self, seconds: float) -> Setpoint:
        """Return the set-point of the next cycle. A set-point of 0 s is the first row."""
        now = self._time
        self._time += seconds
        at = min(int(np.searchsorted(self._times, now + 1e-6, side="right")) - 1, len(self._times) - 1)
        later = min(at + 1, len(self._times) - 1)
        span = self._times[later] - self._times[at]
        share = min(max((now - self._times[at]) / span, 0.0), 1.0) if span > 0.0 else 0.0
        share = share if share > 1e-5 else 0.0
        return Setpoint(*(((1.0 - share) * each[at] + share * each[later]).tolist() for each in self._columns))


def read(path: Path) -> dict[str, Array]:
    """Return the columns of a log by the names of RTDE, with shape (n, 1), (n, 3) or (n, 6)."""
    content = path.read_bytes()
    text = (gzip.decompress(content) if path.suffix == ".gz" else content).decode()
    head, *lines = text.splitlines()
    split = "," if "," in head else " "
    rows = np.loadtxt(lines, delimiter=split)
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(head.strip().split(split)):
        base, _, axis = name.rpartition("_")
        groups.setdefault(base if axis.isdigit() else name, []).append(i)
    return {name: rows[:, places] for name, places in groups.items()}


def tool_of(log: dict[str, Array], model: str) -> Tool:
    """Return payload and tool of a log; a payload that was not logged is fitted to the target moments."""
    arm = Arm(model)
    frame, pose = rotvec_to_matrix(arm.forward(log["actual_q"])[:, 3:]), log["actual_TCP_pose"]
    way = np.einsum("nji,nj->ni", frame, pose[:, :3] - arm.forward(log["actual_q"])[:, :3]).mean(axis=0)
    turn = matrix_to_rotvec(frame[0].T @ rotvec_to_matrix(pose[0, 3:]))
    # The rotation differs from 0 by the calibration of the arm, which is not known.
    turn = turn if np.linalg.norm(turn) > 0.02 else np.zeros(3)
    tcp = (*way.round(4).tolist(), *turn.round(4).tolist())
    if "payload" in log:
        return Tool(float(log["payload"][0, 0]), tuple(log["payload_cog"][0].tolist()), tcp)
    rows = np.flatnonzero(~_moving(log))[::50]
    moments = [np.concatenate([_gravity(arm, log["target_q"][n], *load) for n in rows]) for load in _LOADS]
    bare, *loaded = moments
    columns = np.column_stack([loaded[0] - bare, *(each - loaded[0] for each in loaded[1:])])
    weight = np.linalg.lstsq(columns, log["target_moment"][rows].ravel() - bare, rcond=None)[0]
    mass = max(float(weight[0]), 1e-3)
    return Tool(mass, tuple((weight[1:] / mass).tolist()), tcp)


#: Payload in kg and its centre in m: none, and one kilogram at the flange and one metre along each axis from it.
_LOADS = (
    (0.0, (0.0, 0.0, 0.0)),
    *((1.0, at) for at in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
)


def _gravity(arm: Arm, q: Array, payload: float, cog: Sequence[float]) -> Array:
    return np.asarray(Dynamics(arm, payload=payload, payload_cog=cog).gravity_torque(q))


def simulate(log: dict[str, Array], name: str, *, noise: bool = True, seed: int = 0) -> dict[str, Array]:
    """Return the simulated values at the rows of the log."""
    model, firmware = LOGS[name]
    tool = tool_of(log, model)
    times = log["timestamp"][:, 0]
    columns = [log[each] for each in ("target_q", "target_qd", "target_qdd")]
    controller = Controller(model, firmware, motion=Replay(times, columns), noise=noise, seed=seed)
    controller.arm.payload, controller.arm.payload_cog, controller.arm.tcp = tool.payload, tool.cog, list(tool.tcp)
    found: dict[str, list[list[float]]] = {field: [] for field in _SAMPLED}
    done = 0
    for due in np.rint((times - times[0]) * controller.firmware.rate).astype(int) + 1:
        controller.step(int(due) - done)
        done = int(due)
        sample = controller.arm.sample
        for field, attribute in _SAMPLED.items():
            found[field].append(list(getattr(sample, attribute)))
    return {field: np.array(values) for field, values in found.items()}


def force_of_tool(values: dict[str, Array]) -> Array:
    """Return force and torque along the axes of the tool, shape (n, 6), in N and Nm."""
    turn = rotvec_to_matrix(values["actual_TCP_pose"][:, 3:])
    force = values["actual_TCP_force"]
    return np.concatenate([np.einsum("nji,nj->ni", turn, part) for part in (force[:, :3], force[:, 3:])], axis=1)


def _correlation(values: Array) -> float:
    off = values - values.mean()
    total = float((off * off).sum())
    return float((off[1:] * off[:-1]).sum()) / total if total > 1e-24 else 0.0


def compare(log: dict[str, Array], simulated: dict[str, Array]) -> list[Row]:
    """Return the table of one log."""
    rest = ~_moving(log)
    table = []
    for field, target in FIELDS.items():
        if field == "force_at_rest":
            pair = force_of_tool(log)[rest], force_of_tool(simulated)[rest]
        else:
            pair = log[field], simulated[field]
        for joint in range(pair[0].shape[1]):
            real, made = (each[:, joint] for each in pair)
            base = log[target][:, joint] if target else np.zeros(len(real))
            total = float(((real - real.mean()) ** 2).sum())
            r2 = 1.0 - float(((real - made) ** 2).sum()) / total if total > 1e-12 else float("nan")
            off = [each - base for each in (real, made)]
            table.append(
                Row(
                    field,
                    joint + 1,
                    r2,
                    float(np.abs(real - made).max()),
                    (float(off[0].mean()), float(off[1].mean())),
                    (float(off[0].std()), float(off[1].std())),
                    (_correlation(off[0]), _correlation(off[1])),
                )
            )
    return table


# -- parameters --------------------------------------------------------------------------------------


def _moving(log: dict[str, Array]) -> Flags:
    return np.asarray(log["target_qd"].any(axis=1))


def rests_of(log: dict[str, Array]) -> list[Rows]:
    """Return the rows of each rest."""
    at = np.flatnonzero(~_moving(log))
    return np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)


def derive(folder: Path) -> list[Derived]:
    """Return the parameters that follow from the logs."""
    logs = {name: read(folder / name) for name in (UR3E, UR5E, UR5, TORQUE)}
    parts = _tracking, _currents, _force, _robot_current
    return [
        *(each for part in parts for each in part(logs[UR3E])),
        *_other_forces(logs),
        *_constants(logs),
        _friction(logs[TORQUE]),
    ]


def _rms(values: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    return np.asarray(np.sqrt((values**2).mean(axis=axis)))


def _per_joint(name: str, of: str, values: Array, how: str, log: str = UR3E) -> Derived:
    return Derived(name, of, tuple(values.tolist()), None, log, how)


def _one(name: str, of: str, values: Array, how: str, log: str = UR3E) -> Derived:
    return Derived(name, of, (float(_rms(values)),), (float(values.min()), float(values.max())), log, how)


def _decay(values: Array, floor: float) -> tuple[float, float]:
    """Return value at time 0 and decay time of rms values in rows 40 ms apart, above a constant rms value."""
    times = 0.04 * (np.arange(len(values)) + 0.5)
    above = np.sqrt(np.maximum(values**2 - floor**2, 1e-30))
    slope, begin = np.polyfit(times, np.log(above), 1)
    return float(np.exp(begin)), float(-1.0 / slope)


def _tracking(log: dict[str, Array]) -> Iterator[Derived]:
    moves = _moving(log)
    off = log["actual_q"] - log["target_q"]
    left = (off + number("tracking_lag") * log["target_qd"])[moves]
    noise = number("position_noise")
    how = "standard deviation in motion, less the lag and position_noise"
    yield _per_joint("tracking_error", "", np.sqrt(np.maximum(left.var(axis=0) - noise**2, 0.0)), how)
    left = (log["actual_qd"] - log["target_qd"] + number("speed_lag") * log["target_qdd"])[moves]
    yield _per_joint("speed_noise", "", left.std(axis=0), "standard deviation in motion, less the lag")
    stops = [rows for rows in rests_of(log)[1:] if len(rows) > 2 * _SETTLED - 1]
    creep = np.array([off[rows[: _SETTLED + 1]] - off[rows[-2:]].mean(axis=0) for rows in stops])
    begin, decay = _decay(np.array([_rms(each) for each in np.swapaxes(creep, 0, 1)]), noise)
    how = "first rows after 18 stops, all joints: rms distance from the last two rows of the rest"
    parts = np.array([_rms(creep[:, 0, joint]) for joint in range(6)])
    yield Derived("settling", "", (begin,), (float(parts.min()), float(parts.max())), UR3E, f"{how}, at the stop")
    halves = [
        _decay(np.array([_rms(each) for each in np.swapaxes(half, 0, 1)]), noise)[1]
        for half in (creep[::2], creep[1::2])
    ]
    yield Derived(
        "settling_time", "", (decay,), (min(halves), max(halves)), UR3E, f"{how}, exponential fit; two halves"
    )


def _currents(log: dict[str, Array]) -> Iterator[Derived]:
    moves = _moving(log)
    off = log["actual_current"] - log["target_current"]
    off = off - off.mean(axis=0)
    spread = off[moves].std(axis=0)
    how = "actual_current less target_current in motion, standard deviation"
    yield _per_joint("current_noise", "UR3e", spread, how)
    halves = np.array([each.std(axis=0) for each in np.array_split(off[moves], 2)])
    for of, joints in (("size 0", slice(3, 6)), ("size 1", slice(2, 3)), ("size 2", slice(0, 2))):
        part = halves[:, joints]
        ends = float(part.min()), float(part.max())
        yield Derived(
            "current_noise", of, (float(_rms(spread[joints])),), ends, UR3E, f"{how} of its joints; two halves"
        )
    products = off[1:] * off[:-1]
    both_rest = ~moves[1:] & ~moves[:-1]
    slow = (products.sum(axis=0) - products[both_rest].sum(axis=0)) / (off[moves] ** 2).sum(axis=0)
    how = "actual_current less target_current: correlation of neighbouring rows, of which one is in motion"
    yield _per_joint("current_correlation", "UR3e", np.clip(slow, 0.0, 0.98), how)
    yield _one("current_correlation", "other", np.clip(slow, 0.0, 0.98), f"{how}; six joints")
    yield Derived(
        "current_time",
        "",
        *_half_time(off, moves),
        UR3E,
        "1.5 times the lag at which the mean correlation of current errors in motion has halved; of the joints",
    )
    stops = rests_of(log)
    coulomb = np.array(joint_numbers("coulomb_current", "UR3e"))
    stiction = _between(off, stops, np.full(6, number("current_noise_at_rest"))) / coulomb
    how = "actual_current less target_current, standard deviation of 19 rests by coulomb_current"
    yield _per_joint("stiction", "UR3e", stiction, how)
    yield _one("stiction", "other", stiction, f"{how}; six joints")


def _half_time(off: Array, moves: Flags) -> tuple[tuple[float], tuple[float, float]]:
    lags = range(1, 40)
    pairs = [moves[lag:] & moves[:-lag] for lag in lags]
    alike = np.array([(off[lag:] * off[:-lag])[both].mean(axis=0) for lag, both in zip(lags, pairs, strict=True)])
    alike = alike / alike[0]

    def time(values: Array) -> float:
        below = np.flatnonzero(values < 0.5)
        return 1.5 * 0.04 * float(lags[int(below[0])] if len(below) else lags[-1])

    each = [time(alike[:, joint]) for joint in range(6)]
    return (time(alike.mean(axis=1)),), (min(each), max(each))


def _force(log: dict[str, Array]) -> Iterator[Derived]:
    force, stops = force_of_tool(log), rests_of(log)
    rest = np.concatenate(stops)
    how = "mean at rest in the frame of the tool; 18 programs did not zero it"
    yield _per_joint("force_offset", "UR3e", force[rest].mean(axis=0), how)
    noise = _typical(np.concatenate([np.diff(force[rows[_SETTLED:]], axis=0) for rows in stops]))
    how = "median difference of neighbouring rows of settled rests, by 0.954; three axes"
    yield from _noises("UR3e", "size 2", noise, how, UR3E)
    middle = np.median(force[rest], axis=0)
    calm = [rows for rows in stops if np.abs(force[rows] - middle)[:, :3].max() < 1.5]
    without = " ".join(f"{each:.2g}" for each in _between(force, calm, noise)[:3])
    how = f"standard deviation of 19 rests, less the noise; {without} N without 2 rests in which the tool might touch"
    yield _per_joint("force_wander", "UR3e", _between(force, stops, noise), how)
    moves = np.flatnonzero(_moving(log))
    motion = _typical(np.diff(force, axis=0)[moves[:-1][np.diff(moves) == 1]])
    how = "median difference of neighbouring rows in motion, by 0.954, less the noise at rest"
    yield _per_joint("motion_noise", "", np.sqrt(np.maximum(motion**2 - noise**2, 0.0)), how)
    after = np.array([force[rows[:_SETTLED]] - force[rows[_SETTLED:]].mean(axis=0) for rows in calm if rows[0] > 0])
    after = after[:, :, :3] / noise[:3]
    whole, *halves = (_decay(_rms(each, (0, 2)), 1.0)[1] for each in (after, after[::2], after[1::2]))
    how = "first three rows after stops, exponential fit to the rms of three axes; two halves"
    yield Derived("force_settling_time", "", (whole,), (min(halves), max(halves)), UR3E, how)


def _noises(arm: str, size: str | None, noise: Array, how: str, log: str) -> Iterator[Derived]:
    """Return the noise of force and torque for an arm, and for other arms whose base joint has the same size."""
    for name, part in (("force_noise", noise[:3]), ("torque_noise", noise[3:])):
        one = _one(name, arm, part, how, log)
        yield one._replace(values=tuple(part.tolist()), interval=None)
        if size is not None:
            yield one._replace(of=size)


def _typical(steps: Array) -> Array:
    """Return the standard deviation of normal noise whose differences have the same median size."""
    return np.asarray(1.4826 * np.median(np.abs(steps), axis=0) / np.sqrt(2.0))


def _between(values: Array, stops: Sequence[Rows], noise: Array) -> Array:
    """Return the standard deviation of a quantity from rest to rest, shape (6,), without its noise within a rest."""
    sizes = np.array([len(rows) for rows in stops])
    # The variance of a few values is too small by the variance of their mean.
    share = float((sizes**2).sum()) / float(sizes.sum()) ** 2
    spread = values[np.concatenate(stops)].var(axis=0) - noise**2
    return np.asarray(np.sqrt(spread / (1.0 - share)))


def _robot_current(log: dict[str, Array]) -> Iterator[Derived]:
    def fit(rows: slice) -> Array:
        constants = np.array(motors_of("UR3e").torque_constants)
        current = log["actual_current"][rows]
        power = (current * constants * log["actual_qd"][rows]).sum(axis=1)
        columns = np.column_stack([np.ones(len(power)), power, (current**2).sum(axis=1)])
        return np.asarray(np.linalg.lstsq(columns, log["actual_robot_current"][rows, 0], rcond=None)[0])

    whole, half = fit(slice(None)), len(log["actual_q"]) // 2
    ends = np.sort(np.array([fit(slice(None, half)), fit(slice(half, None)), whole]), axis=0)
    how = "actual_robot_current by 1, motor torques times speeds, and squares of the currents; two halves"
    for i, name in enumerate(("robot_idle_current", "robot_current_of_power", "robot_current_of_heat")):
        yield Derived(name, "", (float(whole[i]),), (float(ends[0, i]), float(ends[-1, i])), UR3E, how)


def _other_forces(logs: dict[str, dict[str, Array]]) -> Iterator[Derived]:
    for name, of, size in ((UR5E, "UR5e", "size 3"), (UR5, "UR5", None)):
        log = logs[name]
        tool = tool_of(log, LOGS[name][0])
        rows, *_ = rests_of(log)
        force = force_of_tool(log)[rows]
        turn = rotvec_to_matrix(np.array(tool.tcp[3:]))
        mean = force.mean(axis=0)
        offset = np.concatenate([turn @ mean[:3], turn @ mean[3:]])
        what = "before a hand moves the arm" if name == UR5E else "a force computed from currents"
        yield _per_joint(
            "force_offset", of, offset, f"mean of the first rest in the frame of the flange, one posture; {what}", name
        )
        steps = np.concatenate([np.diff(force_of_tool(log)[each], axis=0) for each in rests_of(log)])
        noise = np.sqrt(steps.var(axis=0) / 2.0)
        how = "differences of neighbouring rows at rest, by root 2; three axes"
        yield from _noises(of, size, noise, how, name)
        if name == UR5E:
            how = "standard deviation of 5 rests, less the noise; the rests are short"
            yield _per_joint("force_wander", of, _between(force_of_tool(log), rests_of(log), noise), how, name)


def _constants(logs: dict[str, dict[str, Array]]) -> Iterator[Derived]:
    for name, of, field in ((UR5E, "UR5e", "joint_control_output"), (UR5, "UR5", "target_current")):
        moment, current = logs[name]["target_moment"], logs[name][field]
        ratio = (moment * current).sum(axis=0) / np.maximum((current**2).sum(axis=0), 1e-12)
        # The base bears no load.
        ratio[0] = ratio[1]
        yield _per_joint(
            "torque_constant", of, ratio, f"target_moment by {field}; base as shoulder, because it bears no load", name
        )._replace(digits=4)


def _friction(log: dict[str, Array]) -> Derived:
    """Return Coulomb and viscous friction of wrist 2, in A and A s/rad."""
    constant = motors_of("UR5e").torque_constants[4]
    speed, torque = log["dq_des"][:, 0], log["torque"][:, 0]
    found = []
    for step in np.unique(log["dq_step"]):
        at = (np.abs(np.abs(speed) - step) < 1e-6) & (log["ddq_des"][:, 0] == 0.0)
        forward, back = (float(torque[at & (sign * speed > 0.0)].mean()) for sign in (1.0, -1.0))
        found.append((float(step), 0.5 * (forward - back) / constant))
    steps, currents = np.array(found).T
    slope, begin = np.polyfit(steps, currents, 1)
    return Derived(
        "friction",
        "wrist 2",
        (float(begin), float(slope)),
        None,
        TORQUE,
        "half the difference of both directions, by torque_constant, at each speed",
    )


def markdown(tables: dict[str, list[Row]], before: dict[str, list[Row]]) -> Iterator[str]:
    """Return the lines of the tables of all logs; the pairs in a cell are those of the older and of this version."""
    for name, table in tables.items():
        yield f"\n## {name}, {' with firmware '.join(LOGS[name])}\n"
        yield "| field | joint | R² | largest error | mean: real, simulated | spread | correlation |"
        yield "| --- | --- | --- | --- | --- | --- | --- |"
        for old, new in zip(before[name], table, strict=True):
            r2 = "constant" if np.isnan(new.r2) else f"{_limited(old.r2)} → {_limited(new.r2)}"
            largest = f"{old.largest:.3g} → {new.largest:.3g}"
            cells = (f"{b[0]:.3g}: {a[1]:.3g} → {b[1]:.3g}" for a, b in zip(old[4:6], new[4:6], strict=True))
            alike = f"{new.correlation[0]:.2f}: {old.correlation[1]:.2f} → {new.correlation[1]:.2f}"
            yield " | ".join((f"| {new.field}", str(new.joint), r2, largest, *cells, f"{alike} |"))


def _limited(r2: float) -> str:
    return "below -9" if r2 < -9.0 else f"{r2:.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare the simulator with the logs of real arms.")
    parser.add_argument("folder", type=Path, help="folder with the logs")
    parser.add_argument("--no-noise", action="store_true", help="simulate ideal sensors")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise, default 0")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--before", type=Path, help="JSON object of an older version; print Markdown")
    parser.add_argument("--derive", action="store_true", help="print the parameters that follow from the logs")
    args = parser.parse_args()
    if args.derive:
        for each in derive(args.folder):
            print(each.name, each.of, *each.texts, sep="\t")
        return
    tables = {}
    for name in LOGS:
        log = read(args.folder / name)
        tables[name] = compare(log, simulate(log, name, noise=not args.no_noise, seed=args.seed))
    if args.json:
        print(json.dumps({name: [row._asdict() for row in table] for name, table in tables.items()}))
        return
    if args.before is not None:
        old = json.loads(args.before.read_text(encoding="utf-8"))
        rows = {name: [Row(**row) for row in table] for name, table in old.items()}
        print(*markdown(tables, rows), sep="\n")
        return
    for name, table in tables.items():
        print(f"\n{name}: real | simulated")
        print(f"{'field':26} {'':1} {'R²':>8} {'largest':>9} {'mean':>21} {'spread':>21} {'correlation':>13}")
        for row in table:
            mean, spread = (f"{a:10.3g} {b:10.3g}" for a, b in (row.mean, row.spread))
            alike = f"{row.correlation[0]:6.2f} {row.correlation[1]:6.2f}"
            print(f"{row.field:26} {row.joint} {row.r2:8.3f} {row.largest:9.3g} {mean} {spread} {alike}")


if __name__ == "__main__":
    main()
