"""Reads the table of a log of another program, such as the RTDE variables that the vendor's example records."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from linkcore.errors import BadRecording
from linkcore.recording.text_table import read_text_table

from ..arm.models import Model
from ..arm.vectors import FloatArray
from ..protocol.field_names import name_on
from .stop_record import StopRecord

#: Suffixes of tables.
SUFFIXES = (".csv", ".tsv", ".txt", ".gz")

# Element of a vector: actual_q_0, actual_q[0], actual_q.0
_ELEMENT = re.compile(r"(.*?)[_.\[](\d)\]?$")
_TIMES = ("time", "t", "received", "seconds", "controller_time")
#: Rate in Hz that is assumed for a table without a column of times.
_RATE = 125.0


def read_table(path: str | os.PathLike[str], model: Model | None = None) -> StopRecord:
    """Read a table with one line of names, which are separated by commas, semicolons, tabs or spaces.

    The names are those of RTDE, or of the real-time interface. A vector has one column for each number, with names that
    end with `_0` to `_5`, or with `_1` to `_6`. Other columns are ignored. A cell that is not a number counts as
    unknown.

    Args:
        path: Path of the table. It may be compressed (.gz).
        model: Model of the arm; None if it is unknown.

    Raises:
        BadRecording: If the file cannot be read, or is not such a table.
    """
    path = Path(path)
    names, rows = read_text_table(path)
    if not rows:
        raise BadRecording(f"{path} has no rows; expected one line of names and rows of numbers")
    cells = np.array([_numbers(row, len(names)) for row in rows])
    columns = _grouped(names, cells)
    record = StopRecord(np.empty(0), columns, model=model)
    time = next((columns[name] for name in _TIMES if name in columns and columns[name].ndim == 1), None)
    if time is None or not np.isfinite(time).all() or (np.diff(time) < 0.0).any():
        time = np.arange(len(cells)) / _RATE
        record.missing.append(f"times that increase; {_RATE:g} rows per second are assumed")
    record.time = time - time[0]
    return record


def _numbers(row: list[str], count: int) -> list[float]:
    found = []
    for cell in row[:count]:
        try:
            found.append(float(cell))
        except ValueError:
            found.append(float({"true": 1.0, "false": 0.0}.get(cell.strip().lower(), "nan")))
    return found + [float("nan")] * (count - len(found))


def _grouped(names: list[str], cells: FloatArray) -> dict[str, FloatArray]:
    """Return the columns by their names on the real-time interface, with the elements of each vector together."""
    groups: dict[str, dict[int, int]] = {}
    for at, name in enumerate(names):
        element = _ELEMENT.match(name)
        stem = name if element is None else element[1]
        groups.setdefault(stem, {})[0 if element is None else int(element[2])] = at
    found: dict[str, FloatArray] = {}
    for stem, places in groups.items():
        own = name_on("realtime", stem) or stem
        values = np.column_stack([cells[:, at] for _, at in sorted(places.items())])
        if np.isfinite(values).any() and own not in found:
            found[own] = values[:, 0] if len(places) == 1 else values
    return found
