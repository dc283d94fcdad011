"""Variables of a mission, and the log of their values.

There are variables of the script, and system variables (``$name``) of the robot.

As in MRC, all values are in one pool of doubles, in the order in which they are made. First come ``$condition`` and the
results, then the built-in system variables, then the read and write variables of the robot, and then the variables of
the script. This order has a visible effect, because MRC checks the index of ``a[i]``, but not the index in ``set "a[9]"
1`` or ``log "a[9]"``. With too large an index, these commands use the value after the array.

A system variable has three slots for each of its values: the value, its offset and its gain (`setoffset`, `setgain`).
The values, the offsets and the gains form three blocks, one after the other.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from .arithmetic import format_number

#: Number of doubles in the pool, as in MRC, which writes beyond it.
POOL_SIZE = 10_000

#: State before the first cycle. Compare it by identity, because a lazily filled mapping can be empty too.
_NONE_YET: Mapping[str, Sequence[int]] = {}

_INDEX = re.compile(r"[ \t\n\v\f\r]*([+-]?[0-9]{1,9})")


@dataclass(frozen=True)
class Symbol:
    """Variable of a mission.

    Attributes:
        name: Name without the ``$``.
        place: Index of the first value in the pool.
        size: Number of values.
    """

    name: str
    place: int
    size: int


class Symbols:
    """Variables of a mission.

    Args:
        built_in: Names of the built-in system variables, in order.
        read: Length of each read variable of the robot, by name, in order.
        write: Length of each write variable of the robot, by name, in order.

    Attributes:
        pool: All values.
        user: Variables of the script, by name.
        system: System variables, by name. If two variables have the same name, the first one is used: MRC finds its own
            ``$tick`` before that of the robot.
        inputs, outputs: Read and write variables of the robot, by name.
        raw: Words of the robot's read variables in this cycle; empty before the first cycle.
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
        """Find a system variable, and keep it up to date from now on.

        Return None if there is no such variable.
        """
        symbol = self.system.get(name)
        if symbol is not None and name not in self._live and self.inputs.get(name) is symbol:
            # A robot can have thousands of variables. Convert only the variables that a script uses in each cycle.
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
        """Set the offset or gain of a system variable.

        Return False if the name or index does not exist.
        """
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
        """Number of values that are still free."""
        return POOL_SIZE - self._used

    def make(self, name: str) -> Symbol | None:
        """Make a variable of the script with the value 0; return None if there is no room."""
        return self._make(name, 1, 0)

    def make_array(self, name: str, size: int) -> Symbol | None:
        """Make an array of zeros.

        Return None if there is no room. An existing variable with this name is kept.
        """
        # MRC first makes a plain variable, whose value stays unused.
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
    """Log of values in the pool, with one row per cycle (commands `log` and `control`).

    A column belongs to a variable only by its number. If variables are removed and others are added, earlier rows keep
    the numbers of the old variables, as in MRC. Call `reset` first to avoid this.

    Attributes:
        places: Indices of the logged values in the pool, one per column.
        is_on: Whether rows are added.
    """

    #: Maximum number of rows and columns, as in MRC.
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
        """Drop all rows."""
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
        """Return the rows as MRC writes them to a file.

        Each row has the current number of columns, and a blank follows each number.
        """
        columns = len(self.places)
        rows = [(row + [0.0] * (columns - len(row)))[:columns] for row in self._rows[: self._count]]
        return "".join("".join(f"{format_number(value)} " for value in row) + "\n" for row in rows)


def split_index(text: str) -> tuple[str, int]:
    """Split ``"servo[2]"`` into ``("servo", 2)``.

    The index is 0 if it is missing, or not a number.

    As in MRC, an index of -1 counts as missing.
    """
    name, bracket, rest = text.partition("[")
    found = _INDEX.match(rest) if bracket else None
    index = int(found.group(1)) if found else 0
    return name, 0 if index == -1 else index
