"""Files and plots of trajectories.

A file is a CSV table with the columns ``time,q0,...,q5``, and optionally with velocities and accelerations.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from linkcore.errors import BadValue, LocalError

from ...arm.models import Model
from ...arm.vectors import JOINTS, FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_QUANTITIES = ("q", "qd", "qdd")


def _names(quantities: int) -> list[str]:
    return ["time", *(f"{name}{joint}" for name in _QUANTITIES[:quantities] for joint in range(6))]


def read_points(path: Path) -> tuple[list[FloatArray], int]:
    """Read the points of a trajectory from a CSV file.

    Returns:
        A list with times (n,) and positions (n, 6), then velocities and accelerations (n, 6) if the file has them; and
        the number of the line that contains point 0.

    Raises:
        BadValue: If the file cannot be read, or is not a table with these columns.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadValue(f"{path} is not a text file: {error.reason} at byte {error.start}") from None
    except (OSError, ValueError) as error:
        raise BadValue(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    reader = csv.reader(io.StringIO(text))
    lines: list[int] = []
    rows: list[list[float]] = []
    columns: list[str] = []
    try:
        for row in reader:
            if not row:
                continue
            if not columns:
                columns = [cell.strip() for cell in row]
                _check_header(path, reader.line_num, columns)
                continue
            rows.append(_numbers_of(path, reader.line_num, row, columns))
            lines.append(reader.line_num)
    except csv.Error as error:
        raise BadValue(f"{path}, line {reader.line_num}: {error}") from None
    if len(rows) < 2:
        raise BadValue(f"{path} has {len(rows)} points; expected at least two")
    order = [columns.index(name) for name in _names(_quantities(columns))]
    table = np.array(rows, dtype=np.float64)[:, order]
    return [table[:, 0], *np.split(table[:, 1:], table.shape[1] // 6, axis=1)], lines[0]


def write_points(path: Path, arrays: Sequence[FloatArray]) -> None:
    """Write a table that `read_points` can read, with all digits of the numbers.

    Raises:
        BadValue: If the file cannot be written.
    """
    try:
        with open(path, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(_names(len(arrays) - 1))
            writer.writerows(np.column_stack(arrays).tolist())
    except OSError as error:
        raise BadValue(f"{path}: {error.strerror or error}") from error


def _quantities(columns: list[str]) -> int:
    """Return the number of quantities: 1 for positions, 2 with velocities, 3 with accelerations.

    Each quantity has six columns after the time.
    """
    return len(columns) // 6


def _check_header(path: Path, line: int, columns: list[str]) -> None:
    if sorted(columns) != sorted(_names(max(_quantities(columns), 1))):
        raise BadValue(
            f"{path}, line {line}: the columns are {','.join(columns)[:200]}; expected time,q0,...,q5, optionally with "
            "qd0,...,qd5 and with qdd0,...,qdd5"
        )


def _numbers_of(path: Path, line: int, row: list[str], columns: list[str]) -> list[float]:
    if len(row) != len(columns):
        raise BadValue(f"{path}, line {line} has {len(row)} values; expected {len(columns)}")
    values = []
    for name, cell in zip(columns, row, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = float("nan")
        if not math.isfinite(value):
            raise BadValue(f"{path}, line {line}, column {name}: {cell[:50]!r} is not a finite number")
        values.append(value)
    return values


#: Number of times at which the curve is drawn.
_PLACES = 1000
_LABELS = ("position, rad", "speed, rad/s", "acceleration, rad/s²")


def plot(
    time: FloatArray, q: FloatArray, at: Callable[[FloatArray], Sequence[FloatArray]], model: Model | None
) -> Figure:
    """Plot a trajectory; see `Trajectory.plot`.

    Args:
        time: Times of the points, shape (n,), in s; the first is 0.
        q: Positions of the points, shape (n, 6), in rad.
        at: Function that returns positions, velocities and accelerations at given times.
        model: Model of the arm; its limits are drawn. None for no limits.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise LocalError("a plot needs matplotlib: pip install 'urlink-robot[plot]'") from None
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    rows = figure.subplots(3, 1, sharex=True)
    duration = float(time[-1])
    # The acceleration jumps at a point, so the curve is drawn at a time shortly before and shortly after each point.
    beside = 1e-6 * duration
    times = np.unique(
        np.concatenate(
            [
                np.linspace(0.0, duration, _PLACES),
                time,
                np.clip(time - beside, 0.0, None),
                np.clip(time + beside, None, duration),
            ]
        )
    )
    limits = (None, None, None) if model is None else (None, model.max_speed, model.max_acceleration)
    for axes, values, label, most in zip(rows, at(times), _LABELS, limits, strict=True):
        lines = axes.plot(times, values)
        axes.set_ylabel(label)
        if most is not None:
            for line, limit in zip(lines, most.tolist(), strict=True):
                for sign in (-1.0, 1.0):
                    axes.axhline(sign * limit, color=line.get_color(), linestyle="dotted")
    rows[0].plot(time, q, ".", color="black")
    figure.legend(lines, JOINTS, ncols=len(JOINTS), loc="outside upper center", fontsize="small")
    rows[2].set_xlabel("time, s")
    return figure
