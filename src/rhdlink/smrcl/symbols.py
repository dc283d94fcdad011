"""The variables of a mission: those of the script, the system variables (``$name``) of the robot, and their log.

As in MRC all values stand in one pool of doubles, in the order in which they are made: first ``$condition`` and the
results, then the built-in system variables, then the read and the write variables of the robot, then the script's. The
order is kept because it shows: MRC checks the index of ``a[i]`` but not the one in ``set "a[9]" 1`` or ``log "a[9]"``,
which reach whatever stands behind the array.

A system variable has three slots for each of its values: the value, its offset and its gain (`setoffset`, `setgain`),
as three blocks one after the other.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from .arithmetic import format_number

#: Doubles in the pool, as in MRC, which writes beyond it.
POOL_SIZE = 10_000

#: Before the first cycle. A mapping that is filled when it is asked may be empty too.
_NONE_YET: Mapping[str, Sequence[int]] = {}

_INDEX = re.compile(r"[ \t\n\v\f\r]*([+-]?[0-9]{1,9})")


@dataclass(frozen=True)
class Symbol:
    """A variable.

    Attributes:
        name: without the ``$``.
        place: of its first value in the pool.
        size: how many values it has.
    """

    name: str
    place: int
    size: int


class Symbols:
    """The variables of a mission.

    Args:
        built_in: names of the built-in system variables, in order.
        read: length of each read variable of the robot, by name, in order.
        write: likewise of the write variables.

    Attributes:
        pool: every value.
        user: the variables of the script by name.
        system: the system variables by name. Of two with the same name the first counts: MRC finds its own ``$tick``
            before the robot's.
        inputs, outputs: the robot's read and write variables among them.
        raw: the robot's read variables of this cycle; empty before the first.
    """

    def __init__(self, built_in: Iterable[str], read: Mapping[str, int], write: Mapping[str, int]) -> None:
        self.pool = [0.0] * POOL_SIZE
        self.raw: Mapping[str, Sequence[int]] = _NONE_YET
        self.user: dict[str, Symbol] = {}
        self.system: dict[str, Symbol] = {}
        self._used = 0
        self._live: dict[str, Symbol] = {}
        self.inputs: dict[str, Symbol] = {}
        self.outputs: dict[str, Symbol] = {}
        self.system["condition"] = Symbol("condition", self._reserve(1), 1)
        for name in built_in:
            self.system.setdefault(name, Symbol(name, self._reserve(3), 1))
        for table, lengths in ((self.inputs, read), (self.outputs, write)):
            for name, length in lengths.items():
                symbol = Symbol(name, self._reserve(3 * length), length)
                self.pool[symbol.place + 2 * length : symbol.place + 3 * length] = [1.0] * length
                table.setdefault(name, symbol)
                self.system.setdefault(name, symbol)

    def find_system(self, name: str) -> Symbol | None:
        """The system variable of a name, from now on kept up to date; None if there is none."""
        symbol = self.system.get(name)
        if symbol is not None and name not in self._live and self.inputs.get(name) is symbol:
            # A robot may have thousands of variables. Only those that a script uses are converted in each cycle.
            self._live[name] = symbol
            self._refresh(symbol)
        return symbol

    def refresh(self, raw: Mapping[str, Sequence[int]]) -> None:
        """Take the robot's read variables of a new cycle."""
        self.raw = raw
        for symbol in self._live.values():
            self._refresh(symbol)

    def _refresh(self, symbol: Symbol) -> None:
        if self.raw is _NONE_YET:
            return
        words = self.raw[symbol.name]
        pool, place, size = self.pool, symbol.place, symbol.size
        for index in range(size):
            here = place + index
            pool[here] = (words[index] + pool[here + size]) * pool[here + 2 * size]

    def set_scale(self, name: str, index: int, *, offset: float | None = None, gain: float | None = None) -> bool:
        """Set offset or gain of a system variable. False if there is none of that name and index."""
        symbol = self.find_system(name)
        if symbol is None or not 0 <= index < symbol.size:
            return False
        if offset is not None:
            self.pool[symbol.place + symbol.size + index] = offset
        if gain is not None:
            self.pool[symbol.place + 2 * symbol.size + index] = gain
        return True

    @property
    def free(self) -> int:
        """Values that can still be made."""
        return POOL_SIZE - self._used

    def make(self, name: str) -> Symbol | None:
        """A new variable of the script, of value 0; None where there is no room."""
        return self._make(name, 1, 0)

    def make_array(self, name: str, size: int) -> Symbol | None:
        """A new array of zeros; None where there is no room. A variable of that name stays what it is."""
        # MRC makes a plain variable first and leaves its value unused.
        return self._make(name, size, 1)

    def _make(self, name: str, size: int, unused: int) -> Symbol | None:
        if not 0 <= size <= self.free - unused:
            return None
        symbol = Symbol(name, self._reserve(unused + size) + unused, size)
        self.pool[symbol.place : symbol.place + size] = [0.0] * size
        return self.user.setdefault(name, symbol)

    def _reserve(self, count: int) -> int:
        place = self._used
        self._used += count
        if self._used > POOL_SIZE:
            raise MemoryError(f"the robot's variables need more than {POOL_SIZE} values")
        return place


class DataLog:
    """The log (`log`, `control`): values of the pool, a row for each cycle.

    A column belongs to a variable by its number only: when variables are removed and others added, the rows before keep
    the numbers of the old ones, as in MRC. `reset` before that.

    Attributes:
        places: of the values that are logged, in the pool: a column for each.
        is_on: whether rows are added.
    """

    #: Rows and columns, as in MRC.
    MOST_ROWS, MOST_COLUMNS = 100_000, 50

    def __init__(self, pool: Sequence[float]) -> None:
        self._pool = pool
        self.places: list[int] = []
        self._rows: list[list[float]] = []
        self._count = 0
        self.is_on = True

    def __len__(self) -> int:
        return self._count

    def reset(self) -> None:
        """Forget the rows."""
        self._count = 0

    def update(self) -> None:
        """Add a row for this cycle."""
        if not (self.is_on and self.places) or self._count >= self.MOST_ROWS:
            return
        pool = self._pool
        values = [pool[place] for place in self.places]
        if self._count < len(self._rows):
            self._rows[self._count][: len(values)] = values
        else:
            self._rows.append(values)
        self._count += 1

    @property
    def text(self) -> str:
        """The rows as MRC writes them to a file, each as long as there are columns now; a blank follows each number."""
        columns = len(self.places)
        rows = [(row + [0.0] * (columns - len(row)))[:columns] for row in self._rows[: self._count]]
        return "".join("".join(f"{format_number(value)} " for value in row) + "\n" for row in rows)


def split_index(text: str) -> tuple[str, int]:
    """``"servo[2]"`` to ``("servo", 2)``; the index is 0 where there is none, and for what is not a number.

    As in MRC an index of -1 counts as none.
    """
    name, bracket, rest = text.partition("[")
    found = _INDEX.match(rest) if bracket else None
    index = int(found.group(1)) if found else 0
    return name, 0 if index == -1 else index
