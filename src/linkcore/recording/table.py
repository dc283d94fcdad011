"""Class `Table`: recorded packets as columns, with their arrival times."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arguments import check_choice, element_of
from ..errors import BadValue
from ..names import StrictAttributes, needs
from ..wire.cycles import Gap, Missing, gaps_of
from .columns import ArrayColumns, Column, Columns, PacketColumns, is_continuous

if TYPE_CHECKING:
    from typing_extensions import Self

#: Maximum number of gaps whose times are listed.
_LISTED = 5


class ClockColumn(NamedTuple):
    """Column with the clock of the peer, and the period of its packets.

    Attributes:
        field: Name of the column.
        unit: Seconds per unit of the column.
        periods: Possible times in s from one row to the next; several if the period is unknown.
    """

    field: str
    unit: float
    periods: tuple[float, ...]


class Table(StrictAttributes):
    """Columns of one kind of packet: ``table["q_actual"]`` is an array of shape (n, 6).

    Numbers are in the byte order of this machine, and floats are float64. A column is made when it is first used, and
    then stored. Arrays are read-only. Codes are numbers; `fields` has their enumeration.

    Args:
        name: Name, used in messages.
        columns: Source of the columns.
        time: Arrival of each row in s since the start of the recording, shape (n,).
        wall: Arrival of each row in UTC, shape (n,), datetime64[ns].
        begins: First row of each connection, except of the first connection.
        missing: Descriptions of recorded data that could not be read.
        clock: Column that shows missing rows; None if there is no such column.
    """

    def __init__(
        self,
        name: str,
        columns: Columns,
        time: NDArray[np.float64],
        wall: NDArray[np.datetime64],
        begins: Sequence[int] = (),
        missing: Sequence[str] = (),
        clock: ClockColumn | None = None,
    ) -> None:
        self.name = name
        self._missing = tuple(missing)
        self._clock = clock if clock is not None and clock.field in columns.known else None
        self._columns = columns
        self._time = _frozen(time)
        self._wall = _frozen(wall)
        self._begins = [row for row in begins if 0 < row < len(time)]
        self._rows = (0, len(time))
        self._made: dict[str, NDArray[Any]] = {}

    def _with_rows(self, begin: int, end: int) -> Self:
        part = type(self).__new__(type(self))
        part.__dict__.update(self.__dict__)
        part.__dict__.pop("gaps", None)
        part._time, part._wall = self._time[begin:end], self._wall[begin:end]
        part._begins = [row - begin for row in self._begins if begin < row < end]
        part._rows = (self._rows[0] + begin, self._rows[0] + end)
        part._made = {name: column[begin:end] for name, column in self._made.items()}
        return part

    # -- contents ----------------------------------------------------------------------------------

    @property
    def time(self) -> NDArray[np.float64]:
        """Arrival of each row in s since the start of the recording, shape (n,)."""
        return self._time

    @property
    def wall(self) -> NDArray[np.datetime64]:
        """Arrival of each row in UTC, shape (n,), datetime64[ns]."""
        return self._wall

    @property
    def begins(self) -> list[int]:
        """First row of each connection, except of the first connection.

        Packets are missing before these rows.
        """
        return list(self._begins)

    @cached_property
    def gaps(self) -> Sequence[Gap]:
        """Gaps of missing rows, found with the controller's own clock, which continues while packets are lost.

        Gaps between two connections are not included; see `begins`. The result is empty if no column contains such a
        clock: for RTDE without ``timestamp``, for robot states of CB2, and for resampled tables.
        """
        if self._clock is None or len(self) < 2:
            return ()
        moments = self[self._clock.field].astype(np.float64) * self._clock.unit
        return tuple(gaps_of(moments, self._time, self._clock.periods, self._begins))

    @property
    def missing(self) -> tuple[str, ...]:
        """Descriptions of recorded data that could not be read, and of missing packets."""
        gaps = self.gaps
        if not gaps:
            return self._missing
        missing = Missing(sum(gap.cycles for gap in gaps), len(gaps), max(gap.seconds for gap in gaps))
        where = ", ".join(f"{gap.start:.3f} to {gap.end:.3f}" for gap in gaps[:_LISTED])
        others = f" and {len(gaps) - _LISTED} more" if len(gaps) > _LISTED else ""
        return (*self._missing, f"{missing.text(len(self))}: {where} s{others}")

    @property
    def fields(self) -> Mapping[str, Column]:
        """Name -> unit, meaning and shape of each column."""
        return MappingProxyType(dict(self._columns.known))

    def __len__(self) -> int:
        return len(self._time)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._found(name) is not None

    def _found(self, name: str) -> tuple[str, int | None] | None:
        """Return the field of a name, and the index if it names one element.

        Return None if there is no such field.
        """
        if name in self._columns.known:
            return name, None
        element = element_of(name) if isinstance(name, str) else None
        column = None if element is None else self._columns.known.get(element[0])
        return element if element and column and element[1] < (column.width or 0) else None

    def _fields_of(self, names: Iterable[str]) -> list[str]:
        """Return the fields of these names, each once.

        Raises:
            BadValue: If there is no such field.
        """
        fields = []
        for name in names:
            found = self._found(name)
            if found is None:
                raise BadValue(self._complaint(name))
            fields.append(found[0])
        return list(dict.fromkeys(fields))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return one column, or one element of it, such as ``table["q_actual_3"]``.

        Raises:
            BadValue: If there is no such field; the message suggests similar names.
        """
        return self.arrays(name)[name]

    def arrays(self, *names: str) -> dict[str, NDArray[Any]]:
        """Return several columns, or all of them; this is faster than one column after the other.

        Raises:
            BadValue: If there is no such field; the message suggests similar names.
        """
        wanted = list(names or self._columns.known)
        lacking = [field for field in self._fields_of(wanted) if field not in self._made]
        if lacking:
            made = self._columns.read(lacking, *self._rows)
            self._made.update((name, _frozen(column)) for name, column in made.items())
        return {name: self._column(name) for name in wanted}

    def _column(self, name: str) -> NDArray[Any]:
        if name in self._columns.known:
            return self._made[name]
        field, _, index = name.rpartition("_")
        return self._made[field][:, int(index)]

    def _hint(self, name: str) -> str | None:
        return f"; it is a column; write table[{name!r}]" if name in self else None

    def _complaint(self, name: str) -> str:
        known = self._columns.known
        if isinstance(self._columns, PacketColumns) and name in self._columns.partial:
            return f"{self.name} has {name!r} only in some of its parts, because the firmware changed; use table.parts"
        near = difflib.get_close_matches(str(name), known, n=3)
        hint = f"; did you mean {' or '.join(near)}?" if near else ""
        return f"{self.name} has no field {name!r}{hint}; its fields are: {', '.join(known) or 'none'}"

    # -- parts -------------------------------------------------------------------------------------

    def between(self, t0: float, t1: float) -> Self:
        """Return the rows that arrived at `t0` or later, and before `t1`.

        Args:
            t0: Start, in s since the start of the recording, as in `time`.
            t1: End, in s since the start of the recording.

        Raises:
            BadValue: If `t1` is before `t0`.
        """
        if not t0 <= t1:
            raise BadValue(f"t0={t0!r}, t1={t1!r}; expected two times with t0 <= t1")
        begin, end = np.searchsorted(self._time, [t0, t1]).tolist()
        return self._with_rows(begin, end)

    def with_fields(self, *names: str) -> Table:
        """Return the same rows with some of the columns.

        Raises:
            BadValue: If there is no such field; the message suggests similar names.
        """
        arrays = self.arrays(*names)
        known = {}
        for name in arrays:
            (field,) = self._fields_of([name])
            column = self._columns.known[field]
            known[name] = column if name == field else column._replace(name=name, width=None)
        return Table(
            self.name, ArrayColumns(known, arrays), self._time, self._wall, self._begins, self._missing, self._clock
        )

    @property
    def parts(self) -> list[Table]:
        """Separate tables for the rows of each layout.

        There are several if the firmware or the recipe changed during the recording. Each part has all fields of its
        layout. This table has only the fields that all layouts have.
        """
        if not isinstance(self._columns, PacketColumns):
            return [self]
        found = []
        for columns, begin, end in self._columns.by_layout(*self._rows):
            part = self._with_rows(begin - self._rows[0], end - self._rows[0])
            part._columns, part._rows, part._made = columns, (0, end - begin), {}
            found.append(part)
        return found

    def resampled(self, rate: float) -> Table:
        """Return the same data at `rate` rows per second, from the first row to the last.

        Numbers are interpolated linearly, and the rotation vector of a pose along the shorter rotation. Codes, masks,
        counters and text are taken from the previous row. Between the last row of a lost connection and the first row
        of the next connection, numbers are NaN.

        Raises:
            BadValue: If `rate` is not a positive number, or there are no rows.
        """
        if not 0 < rate < float("inf"):
            raise BadValue(f"rate={rate!r}; expected a positive number of rows per second")
        if not len(self):
            raise BadValue(f"{self.name} has no rows to resample")
        old = self._time
        count = int((old[-1] - old[0]) * rate * (1 + 1e-12)) + 1
        time = old[0] + np.arange(count) / rate
        before = np.clip(np.searchsorted(old, time, side="right") - 1, 0, len(old) - 1)
        is_lost = np.zeros(count, bool)
        for row in self._begins:
            is_lost |= (time > old[row - 1]) & (time < old[row])
        arrays = {}
        for name, column in self._columns.known.items():
            values = self[name]
            if is_continuous(column):
                is_pose = column.unit == "m, rad" and column.width == 6
                made = _interpolated(time, old, values, before, is_pose)
                made[is_lost] = np.nan
                arrays[name] = made
            else:
                arrays[name] = values[before]
        start = self._wall[0].astype(np.int64)
        wall = (start + np.round((time - time[0]) * 1e9).astype(np.int64)).astype("M8[ns]")
        return Table(f"{self.name} at {rate:g} Hz", ArrayColumns(self.fields, arrays), time, wall)

    def to_frame(self, *names: str, library: str | None = None) -> Any:
        """Return a data frame of all columns, or of the named columns.

        A vector is split into ``q_actual_0`` to ``q_actual_5``.

        Args:
            names: Names of fields; without names, all fields.
            library: "pandas" or "polars"; None for the first of them that is installed.

        Returns:
            A `pandas.DataFrame` with `time` as its index ``t``, or a `polars.DataFrame` with a column ``t``. Both have
            a column ``wall``.

        Raises:
            BadValue: If there is no such field or library.
            LocalError: If the library is not installed; the message has the command that installs it.
        """
        if library is not None:
            check_choice(library, "library", ("pandas", "polars"))
        columns = flat_columns(self, *names)
        if library != "polars":
            with contextlib.suppress(ImportError) if library is None else needs("pandas", "to_frame"):
                import pandas

                return pandas.DataFrame(columns).set_index("t")
        with needs("polars", "to_frame"):
            import polars

            return polars.DataFrame(columns)

    # -- display -----------------------------------------------------------------------------------

    def __repr__(self) -> str:
        if not len(self):
            return f"<Table {self.name}: no rows>"
        return f"<Table {self.name}: {len(self)} rows, {self._time[0]:.3f} to {self._time[-1]:.3f} s>"

    def _repr_html_(self) -> str:
        from ..text import html_table  # imported here: importing the library stays fast

        columns = self._columns.known.values()
        rows = [(column.name, (len(self), *column.shape), column.unit, column.doc) for column in columns]
        return html_table(repr(self), ("field", "shape", "unit", "meaning"), rows, self.missing)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._columns.known)


def flat_columns(table: Table, *names: str) -> dict[str, NDArray[Any]]:
    """Return a column for each number of a row, in the form for files of tables.

    Args:
        table: Table.
        names: Names of fields; without names, all fields.

    Returns:
        The columns ``t`` and ``wall``, followed by the fields. A vector is split into ``q_actual_0`` to ``q_actual_5``.
    """
    columns: dict[str, NDArray[Any]] = {"t": table.time, "wall": table.wall}
    for name, array in table.arrays(*names).items():
        if array.ndim == 1:
            columns[name] = array
        else:
            columns.update(
                (f"{name}_{place}", np.ascontiguousarray(array[:, place])) for place in range(array.shape[1])
            )
    return columns


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array


def _interpolated(
    time: NDArray[np.float64], old: NDArray[np.float64], values: NDArray[Any], before: NDArray[np.intp], is_pose: bool
) -> NDArray[np.float64]:
    """Return the values at `time`, interpolated between the rows; `before` is the last row before each time."""
    after = np.minimum(before + 1, len(old) - 1)
    first, last = values[before], values[after]
    if is_pose:
        last = np.concatenate([last[:, :3], _closer(first[:, 3:], last[:, 3:])], axis=1)
    step = old[after] - old[before]
    part = np.divide(time - old[before], step, out=np.zeros(len(time)), where=step > 0)
    made: NDArray[np.float64] = first + (last - first) * (part if values.ndim == 1 else part[:, None])
    return made


def _closer(first: NDArray[np.float64], last: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vectors of the rotations `last`, shape (n, 3), that are closest to `first`.

    Each rotation has two such vectors, `last` and one in the opposite direction.
    """
    angle = np.linalg.norm(last, axis=1, keepdims=True)
    other = last - 2 * np.pi * np.divide(last, angle, out=np.zeros_like(last), where=angle > 0)
    is_closer = np.linalg.norm(other - first, axis=1) < np.linalg.norm(last - first, axis=1)
    return np.where(is_closer[:, None], other, last)
