"""Windows: the last seconds of an arm, live or from a recording, as arrays for a view."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from urlink import BadRecording, ConnectionState, RealtimeState, Stream, Table
from urlink.tools import FloatArray

#: Shown quantity -> its names on the real-time interface and in RTDE.
FIELDS: Mapping[str, tuple[str, ...]] = {
    "q": ("q_actual", "actual_q"),
    "target": ("q_target", "target_q"),
    "pose": ("tool_vector_actual", "actual_TCP_pose"),
    "force": ("tcp_force", "actual_TCP_force"),
    "robot": ("robot_mode",),
    # The status of newer firmware distinguishes some stops that the mode does not distinguish.
    "safety": ("safety_status", "safety_mode"),
    "program": ("program_state", "runtime_state"),
    "speed": ("speed_scaling",),
}
#: Time in s that is kept and drawn, and maximum number of rows.
SPAN, _ROWS = 10.0, 500


class Window(ABC):
    """Last seconds of an arm. The newest row is shown.

    Attributes:
        time: Times in s, shape (n,), ascending: by the controller's clock if live, since the beginning of the recording
            if recorded.
    """

    time: FloatArray = np.empty(0)

    @property
    @abstractmethod
    def fields(self) -> tuple[str, ...]:
        """Names of the fields."""

    @abstractmethod
    def unit(self, field: str) -> str:
        """Return the unit of a field; "" if it has none."""

    @property
    @abstractmethod
    def status(self) -> tuple[str, bool]:
        """Status of the connection or the recording, and whether the shown values are current."""

    @abstractmethod
    def column(self, field: str) -> FloatArray | None:
        """Return the rows of a field, shape (n, k); None if they are not known."""

    @abstractmethod
    def newest(self, field: str) -> Any:
        """Return the newest value of a field, codes as enumeration members; None if it is not known."""

    def numbers(self, what: str) -> FloatArray | None:
        """Return the current value of a quantity in `FIELDS`; None if it is not known."""
        for field in FIELDS[what]:
            value = self.newest(field)
            if value is not None and np.isfinite(value).all():
                return np.atleast_1d(np.asarray(value, dtype=np.float64))
        return None

    def word(self, what: str) -> str | None:
        """Return the current name of a quantity in `FIELDS`; None if it is not known."""
        value = next((value for field in FIELDS[what] if (value := self.newest(field)) is not None), None)
        return None if value is None else str(getattr(value, "name", value))

    def way(self) -> FloatArray | None:
        """Return the path of the TCP in m, shape (n, 3); None if it is not known."""
        poses = next((rows for field in FIELDS["pose"] if (rows := self.column(field)) is not None), None)
        return None if poses is None else poses[:, :3]


class LiveWindow(Window):
    """Window that takes a state of a stream each time `look` is called.

    Args:
        stream: Stream of real-time states.
    """

    def __init__(self, stream: Stream[RealtimeState]) -> None:
        self._stream = stream
        self._states: deque[RealtimeState] = deque()
        stream.start()

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields of a state."""
        return tuple(RealtimeState.FIELDS)

    def unit(self, field: str) -> str:
        """See `Window`."""
        return RealtimeState.FIELDS[field].unit

    def look(self) -> None:
        """Take the newest state, if it is new."""
        state = self._stream.latest
        if state is None or (self._states and state is self._states[-1]):
            return
        if self._states and state.time < self._states[-1].time:
            self._states.clear()  # the controller has restarted
        if len(self._states) > 1 and self._states[-1].time - self._states[-2].time < SPAN / _ROWS:
            self._states.pop()  # more frequent calls than rows to keep
        self._states.append(state)
        while state.time - self._states[0].time > SPAN:
            self._states.popleft()
        self.time = np.array([each.time for each in self._states])

    @property
    def status(self) -> tuple[str, bool]:
        """See `Window`."""
        connection, state = self._stream.connection, self._states[-1] if self._states else None
        if connection is ConnectionState.CONNECTED:
            return "live", True
        age = "" if state is None or state.received is None else f", shown state is {state.received.age:.0f} s old"
        return f"{connection.value}{age}", False

    def column(self, field: str) -> FloatArray | None:
        """See `Window`."""
        rows = [getattr(state, field, None) for state in self._states]
        if not rows or any(row is None for row in rows):
            return None
        return np.array(rows, dtype=np.float64).reshape(len(rows), -1)

    def newest(self, field: str) -> Any:
        """See `Window`."""
        return getattr(self._states[-1], field, None) if self._states else None


class RecordedWindow(Window):
    """Rows of a table up to a time of the recording.

    Args:
        table: Table of real-time states, or of RTDE variables.

    Raises:
        BadRecording: If the table is empty.
    """

    def __init__(self, table: Table) -> None:
        if not len(table):
            raise BadRecording(f"{table.name} contains no rows to show")
        self._table = table
        self._rows = np.zeros(1, np.intp)
        self.at(0.0)

    @property
    def end(self) -> float:
        """Time of the last row, in s since the beginning of the recording."""
        return float(self._table.time[-1])

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields of the table."""
        return tuple(self._table.fields)

    def unit(self, field: str) -> str:
        """See `Window`."""
        return self._table.fields[field].unit

    def at(self, time: float) -> None:
        """Show the last row that arrived at or before `time`, in s since the recording began, or else the first row."""
        last = max(int(np.searchsorted(self._table.time, time, "right")) - 1, 0)
        first = int(np.searchsorted(self._table.time, time - SPAN))
        # If there are many rows, keep every nth row, and always the last.
        self._rows = np.arange(last, min(first, last) - 1, -max((last - first) // _ROWS + 1, 1))[::-1]
        self.time = self._table.time[self._rows]

    @property
    def status(self) -> tuple[str, bool]:
        """See `Window`."""
        return f"recorded, at {self.time[-1]:.3f} of {self.end:.3f} s", True

    def column(self, field: str) -> FloatArray | None:
        """See `Window`."""
        if field not in self._table:
            return None
        return np.asarray(self._table[field][self._rows], dtype=np.float64).reshape(len(self._rows), -1)

    def newest(self, field: str) -> Any:
        """See `Window`."""
        if field not in self._table:
            return None
        value, meaning = self._table[field][self._rows[-1]], self._table.fields[field].meaning
        return value if meaning is None else meaning(int(value))
