"""Columns for identification, read from a recording or from a table with the names of RTDE variables."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from urlink import BadRecording, load
from urlink.tools import FloatArray, Progress

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
#: Columns that every identification needs.
_NEEDED = ("timestamp", "target_q", "target_qd", "target_qdd")


class Samples(dict[str, FloatArray]):
    """Columns by their RTDE names, shape (n,) or (n, k), finite, in the order of time.

    Attributes:
        path: Path of the file.
        model: Name of the arm; None if the file does not contain it.
        arrival: Arrival time of each row according to the clock of the recording computer, shape (n,), in s; None if
            not recorded.
    """

    def __init__(
        self, path: Path, columns: Mapping[str, FloatArray], model: str | None = None, arrival: FloatArray | None = None
    ) -> None:
        super().__init__(columns)
        for name in _NEEDED:
            if name not in self:
                raise BadRecording(f"{path} has no column {name}; its columns are {', '.join(self) or 'none'}")
        self.path, self.model, self.arrival = path, model, arrival
        if len(self["timestamp"]) < 30:
            raise BadRecording(f"{path} has {len(self['timestamp'])} rows; expected 30 or more")

    @property
    def is_rest(self) -> NDArray[np.bool_]:
        """For each row, whether the targets of all joints are at rest, shape (n,)."""
        return np.asarray(~self["target_qd"].any(axis=1))


def read_samples(path: str | os.PathLike[str], progress: Progress | None = None) -> Samples:
    """Read a recording (`.urlog`), or a table of RTDE variables (`.csv`, as `urlink rtde --csv` prints).

    In a table, a vector has one column for each number, and the names end with `_0` and so on.

    Args:
        path: Path of the file.
        progress: Function that is called with the completed fraction, 0 to 1, while a recording is read.

    Raises:
        BadRecording: If the file does not exist, has another format, or does not contain the targets of the joints.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        return _table(path)
    recording = load(path, progress=progress)
    if "rtde" in recording.channels and {"target_q", "target_qdd"} <= set(recording.rtde.fields):
        table = recording.rtde
        names = {name: name for name in (*COLUMNS, "runtime_state") if name in table.fields}
    elif "realtime" in recording.channels:
        table = recording.realtime
        names = {ours: theirs for ours, theirs in COLUMNS.items() if theirs in table.fields}
    else:
        raise BadRecording(f"{path} has neither the real-time interface nor RTDE targets; record one of them")
    columns = {ours: np.asarray(table[theirs], dtype=np.float64) for ours, theirs in names.items()}
    return Samples(path, columns, recording.model, np.asarray(table.time))


def _table(path: Path) -> Samples:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            head, *rows = list(csv.reader(file))
        values = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])
    except OSError as error:
        raise BadRecording(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise BadRecording(f"{path} is not a table of numbers below one line of names ({error})") from None
    groups: dict[str, list[int]] = {}
    for at, name in enumerate(head):
        stem, _, number = name.rpartition("_")
        groups.setdefault(stem if number.isdecimal() and stem else name, []).append(at)
    columns: dict[str, FloatArray] = {}
    for name, places in groups.items():
        column = values[:, places[0]] if len(places) == 1 else values[:, places]
        if np.isfinite(column).all():
            columns[name] = column
    return Samples(path, columns, None, columns.get("received"))
