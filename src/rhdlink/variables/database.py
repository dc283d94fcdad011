"""The variable database: what a robot reports and what it is sent, by name.

Two tables. Read variables go from the robot to programs, write variables from programs to the robot; the words are
those of the programs, as in the original. A `Database` belongs to one thread; who shares it among several puts a lock
around it.

What `updated` and `changed` mean depends on the side and the direction (docs/protocols/rhd.md, Updated and changed):

=========  =========  =============================================  =====================================
side       direction  updated                                        changed
=========  =========  =============================================  =====================================
host       read       set when the robot sets it, never cleared      not used
host       write      it was received (be it the same value) in the  a word differed when it was received
                      round that began last                          last
client     read       it was in the last batch                       a word differed when it was received
                                                                     last
client     write      the program set it and it has not been sent    a word differed when it was received
                                                                     last, from another client
=========  =========  =============================================  =====================================

Here `changed` is what the ordinary sources do; the original's ``_64`` sources leave it undefined. Neither tells whether
a read variable is *new*, since the original sends what was set once in every batch for ever: hence `fresh`, which the
original has not. It is set when a variable came in the last batch with another time stamp or another value than it had.
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

#: A word, and a time stamp, as tables have them in memory.
_WORD_FORM, _STAMP_FORM = struct.Struct("=i"), struct.Struct("=qq")


class TimeStamp(NamedTuple):
    """When a variable was set, by the clock of who set it: the robot, or the writing program.

    Attributes:
        seconds: since 1970 UTC; 0 for a variable that was never set, with most servers.
        microseconds: not checked; whoever wrote the variable could send anything.
    """

    seconds: int
    microseconds: int

    @property
    def time(self) -> float:
        """Seconds since 1970 as one number, as `time.time`."""
        return self.seconds + 1e-6 * self.microseconds


def now() -> TimeStamp:
    """The present, by this machine's clock."""
    # From whole nanoseconds: a float of seconds has steps of 0.2 us, and rounding could carry into the second.
    nanoseconds = time.time_ns()
    return TimeStamp(nanoseconds // 1_000_000_000, nanoseconds // 1000 % 1_000_000)


def _fitting(words: ArrayLike | int, size: int) -> ArrayLike:
    """Words that can be stored in so many, or one for all."""
    if isinstance(words, int):
        if not -(2**31) <= words < 2**31:
            raise BadValue(f"{words} does not fit 32 bits")
        return words
    array = np.asarray(words)
    # A scalar is for all words, as the original's setVariable in a loop; anything else has to have one for each.
    if array.shape not in ((), (size,)):
        raise BadValue(f"expected {size} words, got the shape {array.shape}")
    # numpy would cut a float and wrap a number of 64 bits without a word, and set a robot moving at another speed.
    if array.dtype != np.int32 and size:
        if array.dtype.kind not in "iub":
            raise BadValue(f"{words!r} are not whole numbers of 32 bits")
        if not -(2**31) <= int(array.min()) <= int(array.max()) < 2**31:
            raise BadValue(f"{array.min()} to {array.max()} do not fit 32 bits")
    return array


class VariableTable:
    """The variables of one direction. A variable's id is its place.

    Attributes:
        direction: "r" or "w".
        rows: name and length of each variable.
        layout: where each lies in `values`.
        values: the words of all variables, one after another.
        memory: the same words as bytes, in the order of this machine.
        stamps: seconds and microseconds of each variable, shape (n, 2).
        updated: a flag for each variable; see the module.
        changed: likewise.
        fresh: likewise.
        dirty: the variables set here since this was last taken.
        clock: gives the present, for what is set here without a time stamp.

    The arrays and the memory are replaced when a variable is added: do not keep them before the table is frozen.
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
            self._ids.setdefault(row.name, len(self.rows))  # of several, the first is found
            self.rows.append(row)
        # All of it anew, which makes each `add` as costly as there are variables. Plugins add theirs once, before the
        # first tick.
        self.layout = TableLayout([row.length for row in self.rows])
        self._sizes, self._starts = self.layout.sizes, self.layout.offsets.tolist()
        count, before = self.layout.count, len(self.updated)
        # Whatever was set before stays: the original zeroes its pool here (docs/protocols/rhd.md, Defects, 16).
        self.memory = bytearray(self.memory).ljust(WORD * self.layout.words, b"\0")
        self.values = np.frombuffer(self.memory, np.int32)
        self._stamp_memory = bytearray(self._stamp_memory).ljust(_STAMP_FORM.size * count, b"\0")
        self.stamps = np.frombuffer(self._stamp_memory, np.int64).reshape(-1, 2)
        self.updated = np.concatenate((self.updated, np.zeros(count - before, np.bool_)))
        self.changed: NDArray[np.bool_] = np.zeros(count, np.bool_)
        self.fresh: NDArray[np.bool_] = np.zeros(count, np.bool_)
        self._received: list[slice | Ids] = []
        self._selections: dict[tuple[int, int], Selection] = {}  # by width and number of variables
        # What a plugin set before the next one added variables is still to be sent.
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
        """Id of the variable of this name; the first, where there are several. None if there is none."""
        return self._ids.get(name)

    def add(self, name: str, length: int = 1) -> int:
        """Make a variable; its id.

        Raises:
            BadValue: the name is not of 1 to 32 characters of Latin-1, or is there already; or no such
                length.
            LocalError: the table is frozen: clients have been sent it.
        """
        if self.is_frozen:
            raise LocalError(f"{name!r} cannot be made: the variables are fixed once the server runs")
        # Two of a name are legal on the wire, but nobody could ever reach the second.
        if name in self._ids:
            raise BadValue(f"there is a {'read' if self.direction == 'r' else 'write'} variable {name!r} already")
        if not name:
            raise BadValue(f"a variable has to have a name of 1 to {LONGEST_NAME} characters")
        row = SymbolRow(name, length)
        encode_table(self.direction, [row])  # raises for a name or a length that the wire cannot carry
        self._extend([row])
        return len(self.rows) - 1

    # -- one variable --------------------------------------------------------------------------

    def value(self, identity: int) -> Words:
        """The words of a variable, as a view that is read only and changes with it.

        Raises:
            BadValue: no variable has such an id.
        """
        start = self.start(identity)
        # Read only: writing here would set no stamp and no flag, so nobody would be sent it.
        return read_only(self.values[start : start + self._sizes[identity]])

    def words(self, identity: int) -> int | Words:
        """The words of a variable as users get them: an int if it is one, else a read-only copy.

        Raises:
            BadValue: no variable has such an id.
        """
        words = self.value(identity)
        return int(words[0]) if len(words) == 1 else read_only(words.copy())

    def stamp(self, identity: int) -> TimeStamp:
        """When a variable was set last."""
        return TimeStamp(*self.stamps[identity].tolist())

    def set(self, identity: int, words: ArrayLike, stamp: TimeStamp | None = None) -> None:
        """Set a whole variable, here; marks it updated and dirty.

        Args:
            identity: its id.
            words: as many numbers of 32 bits as it is long, or one for all.
            stamp: by default what `clock` says.

        Raises:
            BadValue: no variable has such an id, or it cannot hold that.
        """
        start, size = self.start(identity), self._sizes[identity]
        words = _fitting(words, size)
        if size == 1 and type(words) is int:
            # The usual case, in which numpy would take five times as long.
            _WORD_FORM.pack_into(self.memory, WORD * start, words)
        else:
            self.values[start : start + size] = words
        _STAMP_FORM.pack_into(self._stamp_memory, _STAMP_FORM.size * identity, *(stamp or self.clock()))
        self.updated[identity] = True
        self.dirty.add(identity)

    def start(self, identity: int) -> int:
        """The first word of a variable in `values`; stays the same when variables are added.

        Raises:
            BadValue: no variable has such an id.
        """
        if not 0 <= identity < len(self._starts):
            raise BadValue(f"id {identity} is not among 0 to {len(self._starts) - 1}")
        start: int = self._starts[identity]
        return start

    # -- many at once --------------------------------------------------------------------------

    def select(self, ids: Sequence[int] | Ids, width: int = 2) -> Selection:
        """These variables, prepared for `set_many` and for sending; quick where they are those of last time.

        Raises:
            BadValue: no variable has such an id.
        """
        wanted = np.asarray(ids, np.int64)
        key = (width, len(wanted))
        known = self._selections.get(key)
        if known is not None and known.selects(wanted):
            return known
        if len(wanted) and not 0 <= int(wanted.min()) <= int(wanted.max()) < len(self.rows):
            raise BadValue(f"ids {wanted} are not all among 0 to {len(self.rows) - 1}")
        if wanted.flags.writeable:
            wanted = read_only(wanted.copy())  # whoever has it may change it
        selection = Selection(self.layout, wanted, width)
        remember(self._selections, key, selection)
        return selection

    def set_many(self, selection: Selection, words: ArrayLike, stamp: TimeStamp | None = None) -> None:
        """Set many variables, here; marks them updated and dirty.

        Args:
            selection: of `select`.
            words: the words of all of them, one after another, or one for all.
            stamp: by default what `clock` says.

        Raises:
            BadValue: not as many, or not of 32 bits.
        """
        self.values[selection.cells] = _fitting(words, selection.size - (1 + selection.width) * len(selection.ids))
        self.stamps[selection.rows] = stamp or self.clock()
        self.updated[selection.rows] = True
        self.dirty.add_many(selection.ids, ordered=selection.is_ordered)

    def receive(self, data: DataPackage, *, updates: bool = True) -> None:
        """Take what came over the wire; marks it changed and fresh, and updated if `updates`.

        Where a variable is in it twice, the last counts.
        """
        selection = data.selection
        if not len(data):
            return
        rows, cells = selection.rows, selection.cells
        values, stamps, before = data.values, data.stamps, self.stamps[rows]
        differs = self.values[cells] != values
        # One flag for each variable out of one for each word; with one word each they are the same.
        changed = differs if len(differs) == len(data) else np.logical_or.reduceat(differs, selection.starts)
        self.changed[rows] = changed
        self.fresh[rows] = changed | (before[:, 0] != stamps[:, 0]) | (before[:, 1] != stamps[:, 1])
        self.values[cells] = values
        self.stamps[rows] = stamps
        if updates:
            self.updated[rows] = True
        # Remembered so that `begin_round` clears these flags and no others: to clear all would cost more the more
        # variables there are, at each sync.
        self._received.append(rows)

    def begin_round(self, *, updates: bool = True) -> None:
        """Clear `fresh` of what was received since the last call, and `updated` if `updates`."""
        for rows in self._received:
            self.fresh[rows] = False
            if updates:
                self.updated[rows] = False
        self._received.clear()

    def encode(self, ids: Ids, width: int = 2) -> bytes:
        """A data package with these variables."""
        return encode_data(self.direction, self.select(ids, width), self.values, self.stamps)


class Database:
    """Both tables.

    Attributes:
        read: from the robot to programs.
        write: from programs to the robot.

    Args:
        read: the variables that there are to begin with.
        write: likewise.
    """

    def __init__(self, read: Sequence[SymbolRow] = (), write: Sequence[SymbolRow] = ()) -> None:
        self.read = VariableTable("r", read)
        self.write = VariableTable("w", write)
        self._tables: bytes | None = None

    def table(self, direction: str) -> VariableTable:
        """The table of "r" or "w".

        Raises:
            BadValue: neither.
        """
        if direction not in ("r", "w"):
            raise BadValue(f"{direction!r} is neither 'r' nor 'w'")
        return self.read if direction == "r" else self.write

    def freeze(self) -> None:
        """Allow no more variables."""
        self.read.is_frozen = self.write.is_frozen = True

    def encode_handshake(self, granted: str | None, width: int = 2) -> bytes:
        """What a server says first: access, both tables, a value for each variable; freezes them.

        Args:
            granted: "r" or "w"; None for none, as the original refuses.
            width: words of a time stamp.
        """
        # A client that has been sent the tables is never sent another variable.
        self.freeze()
        if self._tables is None:
            self._tables = encode_table("w", self.write.rows) + encode_table("r", self.read.rows)
        data = [table.encode(np.arange(len(table)), width) for table in (self.write, self.read)]
        return b"".join((b"" if granted is None else encode_access(granted), self._tables, *data, END))


def database_of(handshake: Handshake) -> Database:
    """The tables and the values of a handshake; what was ever set is fresh."""
    database = Database(handshake.read, handshake.write)
    for data in handshake.data:
        database.table(data.direction).receive(data, updates=False)
    return database
