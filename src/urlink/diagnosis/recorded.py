"""Makes a `StopRecord` from the tables of a recording."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

import numpy as np

from linkcore.errors import LinkError
from linkcore.recording.table import Table

from ..arm.models import MODELS
from ..arm.vectors import FloatArray
from ..protocol.field_names import name_on
from ..protocol.primary.robot_message import KeyMessage, RobotCommMessage
from .stop_record import COLUMNS, Key, Report, StopRecord

#: Streams from which columns are read: the first one that was recorded is used.
_STREAMS = ("realtime", "rtde", "primary", "secondary")


def record_of(tables: Mapping[str, Table], model: str | None, *, is_cb2: bool) -> StopRecord:
    """Return the data of a recording from which stops can be explained.

    Args:
        tables: Table of each recorded stream.
        model: Name of the arm; None if it is unknown.
        is_cb2: Whether the robot modes are those of CB2.
    """
    record = StopRecord(np.empty(0), {}, model=None if model is None else MODELS.get(model), is_cb2=is_cb2)
    for stream in _STREAMS:
        if stream in tables and len(tables[stream]):
            record.time, record.columns = _columns(tables[stream], stream)
            if record.safety is not None:
                break
    else:
        record.missing.append("the safety mode")
    primary = tables.get("primary")
    if primary is not None:
        record.reports = [
            Report(time, int(code), int(argument), text)
            for time, code, argument, text in _rows(primary, RobotCommMessage, "code", "argument", "text")
        ]
        record.keys = [Key(time, title, text) for time, title, text in _rows(primary, KeyMessage, "title", "text")]
    return record


def _columns(table: Table, stream: str) -> tuple[FloatArray, dict[str, FloatArray]]:
    interface = "primary" if stream == "secondary" else stream
    found: dict[str, FloatArray] = {}
    for name in (*COLUMNS, "safety_status_bits"):
        there = name_on(interface, name) or name
        if there not in table.fields:
            continue
        with contextlib.suppress(LinkError, ValueError, TypeError):  # a column that cannot be read is missing
            found[name] = np.asarray(table[there], dtype=np.float64)
    return np.asarray(table.time), found


def _rows(primary: Table, kind: type, *names: str) -> list[tuple]:  # type: ignore[type-arg]
    """Return the time and some fields of each message of one class."""
    of = getattr(primary, "of", None)
    if of is None:
        return []
    table = of(kind)
    if not len(table) or any(name not in table.fields for name in names):
        return []
    columns = [table[name].tolist() for name in names]
    return list(zip(table.time.tolist(), *columns, strict=True))
