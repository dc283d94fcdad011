"""Simulated values against the logs of real arms, by field and joint.

Each log's targets are the set-points of a simulated arm of the same model, payload and tool. The table shows R², the
largest error, and mean, standard deviation and correlation of the residual. The residual is the actual value of the log
or of the simulator, less the target of the log; the force has the frame of the tool, at rest. The correlation is that
of neighbouring rows.

    python benchmarks/real_arms.py FOLDER            # folder with ur3e_rtde.csv and other logs
    python benchmarks/real_arms.py FOLDER --json     # prints one JSON object
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from urlink.arm.poses import rotvec_to_matrix
from urlink.simulator import Controller
from urlink.simulator.robot.setpoint_sources import Setpoint

Array = npt.NDArray[np.float64]

#: Log -> model, firmware, payload in kg, its centre and the TCP, in m.
LOGS: dict[str, tuple[str, str, float, tuple[float, ...], tuple[float, ...]]] = {
    "ur3e_rtde.csv": ("UR3e", "5.11", 1.07, (0.0, 0.0, 0.058), (0.0, 0.0, 0.15, 0.0, 0.0, 0.0)),
    "ur5e_led_by_hand.csv.gz": ("UR5e", "5.11", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6),
    "ur5_cb3_at_rest.csv.gz": ("UR5", "3.15", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6),
}
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


class Row(NamedTuple):
    """One line of the table; the pairs are (real, simulated).

    Attributes:
        field: Name of the field.
        joint: Number of the joint or of the axis, from 1.
        r2: Fraction of the variance of the real values that the simulated values explain.
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


class Replay:
    """Set-points of a log, with linear interpolation between its rows."""

    is_program = False

    def __init__(self, times: Array, columns: Sequence[Array]) -> None:
        self._times, self._columns, self._time = times - times[0], columns, 0.0

    def start(self, q: Sequence[float]) -> None:
        """Begin with the first row."""

    def advance(self, seconds: float) -> Setpoint:
        """Return the set-point of the next cycle."""
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


def simulate(log: dict[str, Array], name: str, *, noise: bool = True, seed: int = 0) -> dict[str, Array]:
    """Return the simulated values at the rows of the log."""
    model, firmware, payload, cog, tcp = LOGS[name]
    times = log["timestamp"][:, 0]
    source = Replay(times, [log[each] for each in ("target_q", "target_qd", "target_qdd")])
    controller = Controller(model, firmware, motion=source, noise=noise, seed=seed)
    controller.arm.payload, controller.arm.payload_cog, controller.arm.tcp = payload, cog, list(tcp)
    source.__init__(times, source._columns)  # type: ignore[misc]
    found: dict[str, list[list[float]]] = {field: [] for field in _SAMPLED}
    done = 0
    for due in np.rint((times - times[0]) * controller.firmware.rate).astype(int) + 1:
        controller.step(int(due) - done)
        done = int(due)
        sample = controller.arm.sample
        for field, attribute in _SAMPLED.items():
            found[field].append(list(getattr(sample, attribute)))
    return {field: np.array(values) for field, values in found.items()}


def _at_rest(values: dict[str, Array], rest: npt.NDArray[np.bool_]) -> Array:
    turn = np.swapaxes(rotvec_to_matrix(values["actual_TCP_pose"][rest, 3:]), 1, 2)
    force = values["actual_TCP_force"][rest]
    return np.concatenate([np.einsum("nij,nj->ni", turn, part) for part in (force[:, :3], force[:, 3:])], axis=1)


def _correlation(values: Array) -> float:
    off = values - values.mean()
    total = float((off * off).sum())
    return float((off[1:] * off[:-1]).sum()) / total if total > 1e-24 else 0.0


def compare(log: dict[str, Array], simulated: dict[str, Array]) -> list[Row]:
    """Return the table of one log."""
    rest = np.asarray(~log["target_qd"].any(axis=1))
    table = []
    for field, target in FIELDS.items():
        if field == "force_at_rest":
            pair = _at_rest(log, rest), _at_rest(simulated, rest)
        else:
            pair = log[field], simulated[field]
        for joint in range(pair[0].shape[1]):
            real, made = (each[:, joint] for each in pair)
            base = log[target][:, joint] if target else np.zeros(len(real))
            total = float(((real - real.mean()) ** 2).sum())
            r2 = 1.0 - float(((real - made) ** 2).sum()) / total if total > 0.0 else float("nan")
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


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare the simulator with the logs of real arms.")
    parser.add_argument("folder", type=Path, help="folder with the logs")
    parser.add_argument("--no-noise", action="store_true", help="simulate ideal sensors")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise, default 0")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    tables = {}
    for name in LOGS:
        log = read(args.folder / name)
        tables[name] = compare(log, simulate(log, name, noise=not args.no_noise, seed=args.seed))
    if args.json:
        print(json.dumps({name: [row._asdict() for row in table] for name, table in tables.items()}))
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
