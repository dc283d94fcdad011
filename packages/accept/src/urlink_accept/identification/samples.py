"""Columns for identification, read from a recording or from a table with the names of RTDE variables."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from urlink import BadRecording, BadValue, load
from urlink.tools import FloatArray, Progress, read_text_table

from .differentiation import averaged, averaged_acceleration, averaged_speed

#: Names of columns in RTDE, and their names on the real-time interface.
COLUMNS = {
    "timestamp": "time",
    "target_q": "q_target",
    "target_qd": "qd_target",
    "target_qdd": "qdd_target",
    "target_moment": "M_target",
    "target_current": "I_target",
    "actual_q": "q_actual",
    "actual_qd": "qd_actual",
    "actual_current": "I_actual",
    "joint_control_output": "I_control",
    "target_TCP_pose": "tool_vector_target",
    "actual_TCP_pose": "tool_vector_actual",
    "actual_TCP_force": "tcp_force",
    "actual_tool_accelerometer": "tool_accelerometer",
    "speed_scaling": "speed_scaling",
    "payload": "payload_mass",
    "payload_cog": "payload_cog",
}
#: What is done without a column. The positions are not listed, because nothing can be done without them.
_WITHOUT = {
    "timestamp": "the time step is estimated from positions and speeds, or is 1/rate",
    "target_q": "actual_q is used; lag and offsets of the positions stay unknown",
    "target_qd": "the positions are differentiated; the ramp of programs stays unknown",
    "target_qdd": "the speeds or positions are differentiated; the ramp of programs stays unknown",
    "target_moment": "payload and rotor inertias stay unknown; the currents are fitted to moments of the model",
    "target_current": "torque constants and friction come from actual_current, if it exists",
    "actual_q": "lag and noise of the positions stay unknown",
    "actual_current": "the noise of the currents stays unknown",
    "joint_control_output": "the noise of the currents and stiction stay unknown",
    "target_TCP_pose": "the calibration stays unknown",
    "actual_TCP_pose": "the offset of the force sensor stays unknown",
    "actual_TCP_force": "noise and offset of the force sensor stay unknown",
}
#: Pairs of columns that are never equal on a real arm: target, and the measured value that might have been copied.
_PAIRS = (
    ("target_q", "actual_q"),
    ("target_qd", "actual_qd"),
    ("target_current", "actual_current"),
    ("joint_control_output", "actual_current"),
    ("target_TCP_pose", "actual_TCP_pose"),
)
#: Largest difference of a column and its copy, as a fraction of the range of the column.
_COPY = 1e-6
#: Largest speed of a joint at rest in rad/s, if the speed was computed from positions.
_REST = 2e-3
#: Largest time step in s that differentiation needs.
_STEP = 0.02
#: Number of a vector's element at the end of a name: name_0, name0, name[0], name.0.
_ELEMENT = re.compile(r"(.*?)(?:_|\.|)\[?(\d+)\]?")


class Samples(dict[str, FloatArray]):
    """Columns by their RTDE names, shape (n,) or (n, k), finite, in the order of time.

    Missing targets of the joints are computed from the other columns. A column that is a copy of another one is left
    out.

    Args:
        path: Path of the file.
        columns: Columns by their RTDE names.
        model: Name of the arm; None if unknown.
        arrival: Arrival time of each row, shape (n,), in s; None if unknown.
        rate: Rows per second, for columns without timestamp; None to estimate it.

    Attributes:
        path: Path of the file.
        model: Name of the arm; None if the file does not contain it.
        arrival: Arrival time of each row according to the clock of the recording computer, shape (n,), in s; None if
            not recorded.
        derived: Names of the targets that were computed.
        missing: Name of a column that the file does not contain -> what is done without it.
        remarks: Warnings, such as a rate that is too low.

    Raises:
        BadRecording: If there are no positions, no times, or fewer than 30 rows. The message names all columns that
            are missing.
    """

    def __init__(
        self,
        path: Path,
        columns: Mapping[str, FloatArray],
        model: str | None = None,
        arrival: FloatArray | None = None,
        rate: float | None = None,
    ) -> None:
        super().__init__(columns)
        self.path, self.model, self.arrival = path, model, arrival
        self.remarks: list[str] = []
        self._drop_copies()
        self.missing = {name: effect for name, effect in _WITHOUT.items() if name not in self}
        self.derived = frozenset(self.missing) & {"target_q", "target_qd", "target_qdd"}
        if not {"target_q", "actual_q"} & self.keys():
            known = ", ".join(columns) or "none"
            others = ", ".join(name for name in self.missing if name not in ("target_q", "actual_q"))
            raise BadRecording(
                f"{path} has neither target_q nor actual_q, which every identification needs; it also lacks {others}; "
                f"its columns are {known}; map other names, for example --map target_q=joint_positions"
            )
        self["target_q"] = self.get("target_q", self.get("actual_q"))  # type: ignore[assignment]
        for name in ("target_q", "target_qd", "target_qdd"):
            if name in self and self[name].shape[1:] != (6,):
                raise BadRecording(f"{path}: {name} has the shape {self[name].shape}; expected six joints, (n, 6)")
        if len(self["target_q"]) < 30:
            raise BadRecording(f"{path} has {len(self['target_q'])} rows; expected 30 or more")
        if "timestamp" not in self:
            self._number_rows(rate)
        self._keep_order()
        self._differentiate()

    @property
    def is_rest(self) -> NDArray[np.bool_]:
        """For each row, whether the targets of all joints are at rest, shape (n,)."""
        least = _REST if self.derived else 0.0
        return np.asarray(np.abs(self["target_qd"]).max(axis=1) <= least)

    @property
    def fitted(self) -> Mapping[str, FloatArray]:
        """Columns for fits of moments and currents.

        If the accelerations were computed, they are averages over a short time. Then all other columns are averages
        over the same time, so that the fit has no bias.
        """
        if not self.derived:
            return self
        names = ("target_moment", "target_current", "actual_current", "target_q")
        every = {name: averaged(self["timestamp"], self[name]) for name in names if name in self}
        qd = self["target_qd"] if "target_qd" in self.derived else averaged(self["timestamp"], self["target_qd"])
        every |= {name: self[name] for name in ("payload", "payload_cog") if name in self}
        return every | {"target_qd": np.where(self.is_rest[:, np.newaxis], 0.0, qd), "target_qdd": self["target_qdd"]}

    def _drop_copies(self) -> None:
        for target, measured in _PAIRS:
            if not {target, measured} <= self.keys() or self[target].shape != self[measured].shape:
                continue
            ranges = np.ptp(self[measured], axis=0).max(initial=0.0)
            if np.abs(self[target] - self[measured]).max(initial=0.0) <= _COPY * ranges and ranges > 0.0:
                del self[target]
                self.remarks.append(f"{target} is a copy of {measured}, so it is ignored")

    def _number_rows(self, rate: float | None) -> None:
        q, count = self["target_q"], len(self["target_q"])
        qd = self.get("target_qd", self.get("actual_qd"))
        if rate is None:
            if qd is None or not (qd != 0.0).any():
                raise BadRecording(f"{self.path} has no timestamp and no speeds; give the rows per second with --rate")
            middle = 0.5 * (qd[1:] + qd[:-1])
            rate = float((middle**2).sum() / max(float((middle * np.diff(q, axis=0)).sum()), 1e-12))
            self.remarks.append(f"no timestamp: positions and speeds show {rate:.4g} rows per second")
        self["timestamp"] = np.arange(count) / rate

    def _keep_order(self) -> None:
        """Leave out rows whose time does not grow, such as repeated ones."""
        times = self["timestamp"]
        before = np.maximum.accumulate(np.concatenate(([-np.inf], times[:-1])))
        keep = times > before
        if keep.all():
            return
        self.remarks.append(f"{int((~keep).sum())} rows are left out because their timestamp does not grow")
        for name in self:
            self[name] = self[name][keep]
        if self.arrival is not None:
            self.arrival = self.arrival[keep]

    def _differentiate(self) -> None:
        if not self.derived:
            return
        times = self["timestamp"]
        if "target_qdd" in self.derived:
            has_speeds = "target_qd" not in self.derived
            self["target_qdd"] = (
                averaged_speed(times, self["target_qd"])
                if has_speeds
                else averaged_acceleration(times, self["target_q"])
            )
        if "target_qd" in self.derived:
            self["target_qd"] = averaged_speed(times, self["target_q"])
        step = float(np.median(np.diff(times)))
        if step > _STEP:
            self.remarks.append(
                f"{1.0 / step:.0f} rows per second are too few to differentiate positions without bias; rotor inertias "
                f"may be too small; record target_qdd, or {1.0 / _STEP:.0f} rows per second or more"
            )


def read_samples(
    path: str | os.PathLike[str],
    progress: Progress | None = None,
    *,
    names: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Samples:
    """Read a recording (`.urlog`), or a table of RTDE variables, such as `urlink rtde --csv` prints.

    The cells of a table are separated by commas, semicolons, tabs or spaces. In a table, a vector has one column for
    each number. The names end with `_0` and so on, or with `_1` and so on. The table may be compressed (`.csv.gz`).

    Args:
        path: Path of the file.
        progress: Function that is called with the completed fraction, 0 to 1, while a recording is read.
        names: RTDE name of a column -> its name in the table, if they differ. A vector has the name without the
            number, or the names of all its columns, separated by commas.
        rate: Rows per second, for tables without timestamp; None to estimate it from positions and speeds.

    Raises:
        BadRecording: If the file does not exist, has another format, or does not contain the positions of the joints.
        BadValue: If the table does not have a name in `names`, or `rate` is not positive.
    """
    path = Path(path)
    if rate is not None and not rate > 0.0:
        raise BadValue(f"rate is {rate!r}; expected a positive number of rows per second")
    if path.suffix.lower() in (".csv", ".txt", ".tsv", ".dat", ".gz"):
        return _table(path, names or {}, rate)
    if names or rate is not None:
        raise BadValue(f"{path} is not a table; names and rate are only for tables (.csv, .txt, .tsv, .dat, .csv.gz)")
    recording = load(path, progress=progress)
    if "rtde" in recording.channels and {"target_q", "actual_q"} & set(recording.rtde.fields):
        table = recording.rtde
        found = {name: name for name in (*COLUMNS, "runtime_state") if name in table.fields}
    elif "realtime" in recording.channels:
        table = recording.realtime
        found = {ours: theirs for ours, theirs in COLUMNS.items() if theirs in table.fields}
    else:
        raise BadRecording(f"{path} has neither the real-time interface nor RTDE positions; record one of them")
    columns = {ours: np.asarray(table[theirs], dtype=np.float64) for ours, theirs in found.items()}
    return Samples(path, columns, recording.model, np.asarray(table.time))


def _table(path: Path, names: Mapping[str, str], rate: float | None) -> Samples:
    columns = read_columns(path, names)
    return Samples(path, columns, None, columns.get("received"), rate)


def read_columns(path: str | os.PathLike[str], names: Mapping[str, str]) -> dict[str, FloatArray]:
    """Return the columns of a table by their RTDE names. The arguments and errors are those of `read_samples`."""
    path = Path(path)
    groups = _columns(*_cells(path))
    known = {theirs: ours for ours, theirs in COLUMNS.items()}
    columns = {known.get(name, name): column for name, column in groups.items()}
    singles = {name: column for name, column in groups.items() if column.ndim == 1}
    for ours, theirs in names.items():
        parts = [part.strip() for part in theirs.split(",")]
        every = [_columns_named(part, groups, singles) for part in parts]
        lost = [part for part, column in zip(parts, every, strict=True) if column is None]
        if lost:
            raise BadValue(
                f"{path} has no column {', '.join(lost)} for {ours}; its columns are {', '.join(groups) or 'none'}"
            )
        found = [column for column in every if column is not None]
        columns[ours] = found[0] if len(found) == 1 else np.column_stack(found)
    return columns


def _columns_named(name: str, groups: Mapping[str, FloatArray], singles: Mapping[str, FloatArray]) -> FloatArray | None:
    if name in groups:
        return groups[name]
    if name in singles:
        return singles[name]
    # One element of a vector.
    match = _ELEMENT.fullmatch(name)
    vector = None if match is None else groups.get(match[1])
    number = -1 if match is None else int(match[2])
    return vector[:, number] if vector is not None and vector.ndim == 2 and number < vector.shape[1] else None


def _cells(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the names and the rows of a table, in which each row has a cell for each name."""
    head, rows = read_text_table(path)
    for number, row in enumerate(rows, 2):
        if len(row) != len(head):
            raise BadRecording(f"{path}: row {number} has {len(row)} cells; expected {len(head)}, one for each name")
    return head, rows


def _columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[str, FloatArray]:
    """Return the columns that contain numbers only, with the elements of each vector in their order."""
    groups: dict[str, list[tuple[int, int]]] = {}
    for at, name in enumerate(head):
        match = _ELEMENT.fullmatch(name)
        if match is not None and match[1]:
            groups.setdefault(match[1], []).append((int(match[2]), at))
        else:
            groups.setdefault(name, []).append((0, at))
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(head)
    found: dict[str, FloatArray] = {}
    for name, places in groups.items():
        try:
            values = [np.array([float(cell) for cell in cells[at]]) for _, at in sorted(places)]
        except ValueError:
            # Texts and empty cells are not samples.
            continue
        if all(np.isfinite(column).all() for column in values):
            # A name with a single number, such as output_double_register_3, is not a vector.
            found[name if len(places) > 1 else head[places[0][1]]] = (
                values[0] if len(places) == 1 else np.column_stack(values)
            )
    return found
