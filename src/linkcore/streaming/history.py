"""History of the last seconds of a stream, as arrays, for filters and for machine learning.

States are kept as they arrive, which takes about a microsecond of the reader for each state. They are converted to
columns when an array is requested.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .. import clock
from ..arguments import check_fields, element_of
from ..errors import BadValue
from ..names import StrictAttributes
from ..threads import Closing
from ..wire.packet import State
from .subscription import Subscription

#: Columns with the arrival time of the bytes.
_WHEN = ("received", "received_wall")


class History(StrictAttributes, Closing):
    """The states of the last seconds, returned by `Feed.history`.

    It stores states until it is closed, and can be used as a context manager. After a reconnection to a firmware with
    other fields, the earlier states are dropped.

    Args:
        kind: Class of the states.
        seconds: Maximum time in s between the arrivals of the oldest kept state and of the newest state.
        subscribe: Function that subscribes a callback to each state.
    """

    def __init__(
        self, kind: type[State], seconds: float, subscribe: Callable[[Callable[[Any], object]], Subscription]
    ) -> None:
        self._kind = kind
        self._seconds = seconds
        # Times and states. Only the reader changes this list, and other threads copy it in one step. A deque cannot be
        # copied in one step. The first states might be too old; see `_keep`.
        self._states: list[tuple[float, State]] = []
        self._subscription = subscribe(self._keep)

    def _keep(self, state: State) -> None:
        """Keep a state. The thread that reads the stream calls this."""
        states = self._states
        if states and states[-1][1]._layout is not state._layout:
            states.clear()
        stamp = state.received
        now = clock.now() if stamp is None else stamp.monotonic
        states.append((now, state))
        oldest = now - self._seconds
        # Old states are deleted together when they are a quarter of all, because a deletion moves the rest of the list.
        if states[len(states) // 4][0] < oldest:
            del states[: _first(states, oldest)]

    def _kept(self) -> list[State]:
        """Return the states that are not too old, with the oldest state first. Any thread may call this."""
        states = list(self._states)
        first = _first(states, states[-1][0] - self._seconds) if states else 0
        return [state for _, state in states[first:]]

    def array(self, *fields: str) -> NDArray[np.void]:
        """Return the states as a structured array, with the oldest state first.

        Args:
            fields: Names of fields, or of one element, such as ``"q_actual_3"``. Without names, all numeric fields that
                this firmware sends.

        Returns:
            Array of shape (n,) with one column for each field in the given order, with the shape of the field:
            ``array["q_actual"]`` is (n, 6). Numbers are float64 or int64, and modes are their numbers. The first two
            columns are the arrival time of the bytes in s: ``received`` by `linkcore.clock.now`, and ``received_wall``
            by `time.time`. The array is empty if no state has arrived yet.

        Raises:
            BadValue: If there is no such field, if it is not numeric, or if this firmware does not send it.
        """
        states = self._kept()
        check_fields(fields)
        places: dict[str, tuple[str, int | None]] = {}
        for name in dict.fromkeys(fields or self._kind.FIELDS):
            place = self._found(name)
            if place is None:
                known = ", ".join(self._kind.FIELDS)
                raise BadValue(f"{self._kind.__name__} has no field {name!r}; expected one of {known}")
            places[name] = place
        columns: dict[str, NDArray[Any]] = {}
        for name, (field, index) in places.items():
            values = [getattr(state, field) for state in states]
            if index is not None:
                values = [None if value is None else value[index] for value in values]
            column = _numbers(values) if states else np.empty((0,))
            if column is not None:
                columns[name] = column
            elif fields:
                why = "is not sent by this firmware" if values[0] is None else "is not numeric"
                raise BadValue(f"{name} of {self._kind.__name__} {why}")
        found = np.empty(
            len(states),
            dtype=[(name, np.float64) for name in _WHEN]
            + [(name, column.dtype, column.shape[1:]) for name, column in columns.items()],
        )
        stamps = [state.received for state in states]
        found["received"] = [np.nan if stamp is None else stamp.monotonic for stamp in stamps]
        found["received_wall"] = [np.nan if stamp is None else stamp.wall for stamp in stamps]
        for name, column in columns.items():
            found[name] = column
        return found

    def _found(self, name: str) -> tuple[str, int | None] | None:
        """Return the field of a name, and the index if it names one element.

        Return None if there is no such field.
        """
        fields = self._kind.FIELDS
        element = None if name in fields else element_of(name)
        if element is None:
            return (name, None) if name in fields else None
        return element if element[0] in fields and element[1] < (fields[element[0]].shape.count or 0) else None

    def __getitem__(self, field: str) -> NDArray[Any]:
        """Return one column of `array`, of shape (n,) or (n, size of the field).

        Raises:
            BadValue: See `array`.
        """
        column: NDArray[Any] = self.array(*(() if field in _WHEN else (field,)))[field]
        return column

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return all columns, for ``numpy.asarray(history)``."""
        return np.asarray(self.array(), dtype)

    def __len__(self) -> int:
        return len(self._kept())

    def close(self) -> None:
        """Stop storing states. Stored states can still be read. Idempotent."""
        self._subscription.close(0)

    def __repr__(self) -> str:
        return f"<History of {len(self)} {self._kind.__name__} in {self._seconds:g} s>"


def _first(states: list[tuple[float, State]], oldest: float) -> int:
    """Return the index of the first state that is not older than `oldest`."""
    return bisect_left(states, oldest, key=itemgetter(0))


def _numbers(values: list[Any]) -> NDArray[Any] | None:
    """Return an array with one row for each value; None if the values are not numbers."""
    array = np.array(values) if values[0] is not None else np.empty(0, dtype=object)
    if array.dtype.kind in "bui":
        return array.astype(np.int64)
    return array.astype(np.float64) if array.dtype.kind == "f" else None
