"""The last seconds of a stream as arrays, for filters and for code that learns.

States are kept as they came, which costs the reader a microsecond each, and are taken apart when an array is asked for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
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

#: Columns that say when the bytes came.
_WHEN = ("received", "received_wall")


class History(StrictAttributes, Closing):
    """The states of the last seconds; made by `Feed.history`. A context manager: close it, or it goes on.

    States of before a reconnect to another firmware, whose fields differ, are dropped.

    Args:
        kind: class of the states.
        seconds: before the newest state for which others are kept, by when their bytes came.
        subscribe: begins to call back with each state.
    """

    def __init__(
        self, kind: type[State], seconds: float, subscribe: Callable[[Callable[[Any], object]], Subscription]
    ) -> None:
        self._kind = kind
        self._seconds = seconds
        self._states: deque[tuple[float, State]] = deque()
        self._subscription = subscribe(self._keep)

    def _keep(self, state: State) -> None:
        """In the thread that reads."""
        states = self._states
        if states and states[-1][1]._layout is not state._layout:
            states.clear()
        stamp = state.received
        now = clock.now() if stamp is None else stamp.monotonic
        states.append((now, state))
        oldest = now - self._seconds
        while states[0][0] < oldest:
            states.popleft()

    def array(self, *fields: str) -> NDArray[np.void]:
        """The states as a structured array, oldest first.

        Args:
            fields: Names of fields, or of one element, such as ``"q_actual_3"``. Without any, all fields that this
                firmware sends and that are numbers.

        Returns:
            (n,) with one column for each field, in the order asked for, of its shape: ``array["q_actual"]`` is (n, 6).
            Numbers are float64 or int64; modes are their numbers. Before them stand ``received``, when the bytes came
            by `linkcore.clock.now`, and ``received_wall`` by `time.time`, s. Empty where nothing has come yet.

        Raises:
            BadValue: no such field, or one that is not a number, or that this firmware does not send.
        """
        # In one step: the reader goes on.
        states = [state for _, state in self._states.copy()]
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
                why = "is not sent by this firmware" if values[0] is None else "is no number"
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
        """The field of a name, and the index if it names one element of it; None if there is no such field."""
        fields = self._kind.FIELDS
        element = None if name in fields else element_of(name)
        if element is None:
            return (name, None) if name in fields else None
        return element if element[0] in fields and element[1] < (fields[element[0]].shape.count or 0) else None

    def __getitem__(self, field: str) -> NDArray[Any]:
        """One column of `array`, (n,) or (n, size of the field).

        Raises:
            BadValue: as of `array`.
        """
        column: NDArray[Any] = self.array(*(() if field in _WHEN else (field,)))[field]
        return column

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """All columns, for ``numpy.asarray(history)``."""
        return np.asarray(self.array(), dtype)

    def __len__(self) -> int:
        return len(self._states)

    def close(self) -> None:
        """Keep no more; what was kept stays. Idempotent."""
        self._subscription.close(0)

    def __repr__(self) -> str:
        return f"<History of {len(self)} {self._kind.__name__} in {self._seconds:g} s>"


def _numbers(values: list[Any]) -> NDArray[Any] | None:
    """One row for each value; None where they are not numbers."""
    array = np.array(values) if values[0] is not None else np.empty(0, dtype=object)
    if array.dtype.kind in "bui":
        return array.astype(np.int64)
    return array.astype(np.float64) if array.dtype.kind == "f" else None
