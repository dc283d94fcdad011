"""Variable database: the values that a robot reports and receives, by name.

There are two tables. Read variables go from the robot to programs, and write variables go from programs to the robot.
The words "read" and "write" take the view of the programs, as in the original. A `Database` belongs to one thread. If
several threads share it, they must hold a lock around each access.

The meaning of `updated` and `changed` depends on the side and the direction (docs/protocols/rhd.md, Updated and
changed):

=========  =========  =============================================  =====================================
side       direction  updated                                        changed
=========  =========  =============================================  =====================================
host       read       set when the robot sets it, never cleared      not used
host       write      received in the round that began last, even    a word differed when it was last
                      with the same value                            received
client     read       it was in the last batch                       a word differed when it was last
                                                                     received
client     write      the program set it, and it has not been sent   a word differed when it was last
                                                                     received from another client
=========  =========  =============================================  =====================================

Here `changed` follows the ordinary sources; the original's ``_64`` sources leave it undefined. Neither flag shows
whether a read variable is *new*, because the original sends a variable in every batch once it has been set. The flag
`fresh`, which the original does not have, shows this. It is set when a variable arrived in the last batch with a
different time stamp or value.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkcore.errors import BadValue, LocalError

from ..wire.data import DataPackage, Ids, Selection, Stamps, TableLayout, Words, read_only, remember
from ..wire.messages import END, LONGEST_NAME, Handshake, SymbolRow, encode_access, encode_data, encode_table
from ..wire.schema import WORD
from .dirty_set import DirtySet

#: A word, and a time stamp, in the memory of a table.
_WORD_FORM, _STAMP_FORM = struct.Struct("=i"), struct.Struct("=qq")


class TimeStamp(NamedTuple):
    """Time at which a variable was set, on the clock of the side that set it.

    The side is the robot or the writing program.

    Attributes:
        seconds: Seconds since 1970 UTC. With most servers, it is 0 for a variable that was never set.
        microseconds: Microseconds. They are not checked, and the writer could send any number.
    """

    seconds: int
    microseconds: int

    @property
    def time(self) -> float:
        """Seconds since 1970 as one number, like `time.time`."""
        return self.seconds + 1e-6 * self.microseconds


def now() -> TimeStamp:
    """Return the current time on this computer's clock."""
    # Use whole nanoseconds: a float of seconds has steps of 0.2 us, and rounding could carry into the second.
    nanoseconds = time.time_ns()
    return TimeStamp(nanoseconds // 1_000_000_000, nanoseconds // 1000 % 1_000_000)


def _fitting(words: ArrayLike | int, size: int) -> ArrayLike:
    """Check that the words fit a variable of `size` words.

    One word can be given for all words of the variable.
    """
    if isinstance(words, int):
        if not -(2**31) <= words < 2**31:
            raise BadValue(f"{words} is out of range; expected a 32-bit integer")
        return words
    array = np.asarray(words)
    # A scalar sets all words, like the original's setVariable in a loop. Any other value needs one number per word.
    if array.shape not in ((), (size,)):
        raise BadValue(f"expected {size} words, got an array of shape {array.shape}")
    # numpy would silently truncate a float and wrap a number of 64 bits, and the robot would move at another speed.
    if array.dtype != np.int32 and size:
        if array.dtype.kind not in "iub":
            raise BadValue(f"{words!r} are not 32-bit integers")
        if not -(2**31) <= int(array.min()) <= int(array.max()) < 2**31:
            raise BadValue(f"values from {array.min()} to {array.max()} are out of range; expected 32-bit integers")
    return array


class VariableTable:
    """Table of the variables of one direction. The id of a variable is its position in the table.

    Attributes:
        direction: "r" or "w".
        rows: Name and length of each variable.
        layout: Position of each variable in `values`.
        values: Words of all variables, one after another.
        memory: The same words as bytes, in the byte order of this machine.
        stamps: Seconds and microseconds of each variable, shape (n, 2).
        updated: Flag of each variable; see the module.
        changed: Flag of each variable; see the module.
        fresh: Flag of each variable; see the module.
        dirty: Variables that were set here since this set was last taken.
        clock: Function that returns the current time. It stamps values that are set here without a time stamp.

    The arrays and the memory are replaced when a variable is added. Do not keep references to them before the table is
    frozen.
    """

    def __init__(self, direction: str, rows: Sequence[SymbolRow] = ()) -> None:
        self.direction = direction
        self.is_frozen = False
        self.clock: Callable[[], TimeStamp] = now
        self.rows: list[SymbolRow] = []
        self._ids: dict[str, int] = {}
        self.memory = bytearray()
        self.values: Words = np.empty(0, np.int32)
        self._stamp_memory = bytearray()
        self.stamps: Stamps = np.empty((0, 2), np.int64)
        self.updated: NDArray[np.bool_] = np.empty(0, np.bool_)
        self.dirty = DirtySet(0)
        self._extend(rows)

    def _extend(self, rows: Sequence[SymbolRow]) -> None:
        for row in rows:
            self._ids.setdefault(row.name, len(self.rows))  # if names are equal, the first is found
            self.rows.append(row)
        # Everything is rebuilt, so the cost of `add` grows with the number of variables. This is acceptable, because
        # plugins add their variables once, before the first tick.
        self.layout = TableLayout([row.length for row in self.rows])
        self._sizes, self._starts = self.layout.sizes, self.layout.offsets.tolist()
        count, before = self.layout.count, len(self.updated)
        # Earlier values are kept. The original zeroes its pool here (docs/protocols/rhd.md, Defects, 16).
        self.memory = bytearray(self.memory).ljust(WORD * self.layout.words, b"\0")
        self.values = np.frombuffer(self.memory, np.int32)
        self._stamp_memory = bytearray(self._stamp_memory).ljust(_STAMP_FORM.size * count, b"\0")
        self.stamps = np.frombuffer(self._stamp_memory, np.int64).reshape(-1, 2)
        self.updated = np.concatenate((self.updated, np.zeros(count - before, np.bool_)))
        self.changed: NDArray[np.bool_] = np.zeros(count, np.bool_)
        self.fresh: NDArray[np.bool_] = np.zeros(count, np.bool_)
        self._received: list[slice | Ids] = []
        self._selections: dict[tuple[int, int], Selection] = {}  # by width and number of variables
        # Variables that one plugin set before the next plugin added variables must still be sent.
        kept = self.dirty.take()
        self.dirty = DirtySet(count)
        self.dirty.add_many(kept, ordered=True)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[SymbolRow]:
        return iter(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self._ids

    def find(self, name: str) -> int | None:
        """Return the id of the variable with this name; if there are several, the id of the first.

        Return None if there is none.
        """
        return self._ids.get(name)

    def add(self, name: str, length: int = 1) -> int:
        """Add a variable and return its id.

        Raises:
            BadValue: If the name does not have 1 to 32 characters of Latin-1 or already exists, or if the length is not
                valid.
            LocalError: If the table is frozen, because it has been sent to clients.
        """
        if self.is_frozen:
            raise LocalError(f"{name!r} cannot be added: the variables are fixed once the server runs")
        # Two variables with one name are legal on the wire, but the second could never be reached.
        if name in self._ids:
            raise BadValue(f"there is already a {'read' if self.direction == 'r' else 'write'} variable {name!r}")
        if not name:
            raise BadValue(f"the name of a variable is empty; expected 1 to {LONGEST_NAME} characters")
        row = SymbolRow(name, length)
        encode_table(self.direction, [row])  # raises an error for a name or a length that the wire cannot carry
        self._extend([row])
        return len(self.rows) - 1

    # -- one variable --------------------------------------------------------------------------

    def value(self, identity: int) -> Words:
        """Return the words of a variable, as a read-only view that changes with the variable.

        Raises:
            BadValue: If there is no variable with this id.
        """
        start = self.start(identity)
        # Make the view read-only: writing to it would set no time stamp and no flag, so the value would never be sent.
        return read_only(self.values[start : start + self._sizes[identity]])

    def words(self, identity: int) -> int | Words:
        """Return the words of a variable for users: an int if there is one word, otherwise a read-only copy.

        Raises:
            BadValue: If there is no variable with this id.
        """
        words = self.value(identity)
        return int(words[0]) if len(words) == 1 else read_only(words.copy())

    def stamp(self, identity: int) -> TimeStamp:
        """Return the time at which a variable was last set."""
        return TimeStamp(*self.stamps[identity].tolist())

    def set(self, identity: int, words: ArrayLike, stamp: TimeStamp | None = None) -> None:
        """Set a whole variable on this side, and mark it as updated and dirty.

        Args:
            identity: Id of the variable.
            words: 32-bit integers, as many as the variable has words, or one integer for all words.
            stamp: Time stamp. The default is the current time of `clock`.

        Raises:
            BadValue: If there is no variable with this id, or it cannot hold the words.
        """
        start, size = self.start(identity), self._sizes[identity]
        words = _fitting(words, size)
        if size == 1 and type(words) is int:
            # This is the usual case, for which numpy would take five times as long.
            _WORD_FORM.pack_into(self.memory, WORD * start, words)
        else:
            self.values[start : start + size] = words
        _STAMP_FORM.pack_into(self._stamp_memory, _STAMP_FORM.size * identity, *(stamp or self.clock()))
        self.updated[identity] = True
        self.dirty.add(identity)

    def start(self, identity: int) -> int:
        """Return the index of the first word of a variable in `values`.

        This index does not change when variables are added.

        Raises:
            BadValue: If there is no variable with this id.
        """
        if not 0 <= identity < len(self._starts):
            raise BadValue(f"id {identity} is not valid; expected 0 to {len(self._starts) - 1}")
        start: int = self._starts[identity]
        return start

    # -- many at once --------------------------------------------------------------------------

    def select(self, ids: Sequence[int] | Ids, width: int = 2) -> Selection:
        """Prepare variables for `set_many` and for sending.

        This is fast if the variables are the same as in the last call.

        Raises:
            BadValue: If there is no variable with one of the ids.
        """
        wanted = np.asarray(ids, np.int64)
        key = (width, len(wanted))
        known = self._selections.get(key)
        if known is not None and known.selects(wanted):
            return known
        if len(wanted) and not 0 <= int(wanted.min()) <= int(wanted.max()) < len(self.rows):
            raise BadValue(f"ids {wanted} are not all valid; expected 0 to {len(self.rows) - 1}")
        if wanted.flags.writeable:
            wanted = read_only(wanted.copy())  # the owner of the array might change it
        selection = Selection(self.layout, wanted, width)
        remember(self._selections, key, selection)
        return selection

    def set_many(self, selection: Selection, words: ArrayLike, stamp: TimeStamp | None = None) -> None:
        """Set many variables on this side, and mark them as updated and dirty.

        Args:
            selection: Variables, made by `select`.
            words: Words of all variables, one after another, or one word for all of them.
            stamp: Time stamp. The default is the current time of `clock`.

        Raises:
            BadValue: If the number of words is wrong, or a word is not a 32-bit integer.
        """
        self.values[selection.cells] = _fitting(words, selection.size - (1 + selection.width) * len(selection.ids))
        self.stamps[selection.rows] = stamp or self.clock()
        self.updated[selection.rows] = True
        self.dirty.add_many(selection.ids, ordered=selection.is_ordered)

    def receive(self, data: DataPackage, *, updates: bool = True) -> None:
        """Store values that were received over the wire.

        Mark the variables as fresh, as changed if a word differs, and as updated if `updates`.

        If the package contains a variable twice, its last value is used.
        """
        selection = data.selection
        if not len(data):
            return
        rows, cells = selection.rows, selection.cells
        values, stamps, before = data.values, data.stamps, self.stamps[rows]
        differs = self.values[cells] != values
        # Reduce one flag per word to one flag per variable. If each variable has one word, they are the same.
        changed = differs if len(differs) == len(data) else np.logical_or.reduceat(differs, selection.starts)
        self.changed[rows] = changed
        self.fresh[rows] = changed | (before[:, 0] != stamps[:, 0]) | (before[:, 1] != stamps[:, 1])
        self.values[cells] = values
        self.stamps[rows] = stamps
        if updates:
            self.updated[rows] = True
        # Remember these variables, so that `begin_round` clears only their flags. Clearing all flags at each sync would
        # take longer with more variables.
        self._received.append(rows)

    def begin_round(self, *, updates: bool = True) -> None:
        """Clear `fresh` of the variables received since the last call, and `updated` if `updates`."""
        for rows in self._received:
            self.fresh[rows] = False
            if updates:
                self.updated[rows] = False
        self._received.clear()

    def encode(self, ids: Ids, width: int = 2) -> bytes:
        """Encode a data package with these variables."""
        return encode_data(self.direction, self.select(ids, width), self.values, self.stamps)


class Database:
    """Database that consists of the two tables of variables.

    Attributes:
        read: Table of the variables from the robot to programs.
        write: Table of the variables from programs to the robot.

    Args:
        read: Initial read variables.
        write: Initial write variables.
    """

    def __init__(self, read: Sequence[SymbolRow] = (), write: Sequence[SymbolRow] = ()) -> None:
        self.read = VariableTable("r", read)
        self.write = VariableTable("w", write)
        self._tables: bytes | None = None

    def table(self, direction: str) -> VariableTable:
        """Return the table of "r" or "w".

        Raises:
            BadValue: If `direction` is neither.
        """
        if direction not in ("r", "w"):
            raise BadValue(f"direction is {direction!r}; expected 'r' or 'w'")
        return self.read if direction == "r" else self.write

    def freeze(self) -> None:
        """Prevent that more variables are added."""
        self.read.is_frozen = self.write.is_frozen = True

    def encode_handshake(self, granted: str | None, width: int = 2) -> bytes:
        """Encode the handshake of a server: access, both tables, and a value of each variable.

        This freezes the tables.

        Args:
            granted: "r" or "w"; None for no access, which is the original's refusal.
            width: Number of 32-bit words of a time stamp.
        """
        # The tables are sent to a client only once, so no variable may be added afterwards.
        self.freeze()
        if self._tables is None:
            self._tables = encode_table("w", self.write.rows) + encode_table("r", self.read.rows)
        data = [table.encode(np.arange(len(table)), width) for table in (self.write, self.read)]
        return b"".join((b"" if granted is None else encode_access(granted), self._tables, *data, END))


def database_of(handshake: Handshake) -> Database:
    """Return a database with the tables and values of a handshake.

    Every variable that was ever set is fresh.
    """
    database = Database(handshake.read, handshake.write)
    for data in handshake.data:
        database.table(data.direction).receive(data, updates=False)
    return database
