"""Copy of a robot's variables in the client. Each batch from the robot updates it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue
from linkcore.text import similar

from ..errors import NotThere
from ..variables.database import Database, VariableTable
from ..variables.declarations import Declarations
from ..variables.snapshot import Change, Variable, changes_in
from ..wire.data import Ids
from ..wire.messages import Batch

_log = logging.getLogger(__name__)

#: Whether values that were set but not sent are kept when the connection is lost.
Unsent = Literal["discard", "send"]

#: A writer's request contains a data package even if it sets nothing, as in librhd.
_NOTHING_SET = b"dw\0\0\0\0"
_NONE: Ids = np.empty(0, np.int64)


class Replica:
    """Copy of a robot's database that threads share.

    Args:
        robot: Address of the robot, used in error and log messages.
        unsent: "discard" drops values that were set but not sent when the connection is lost; "send" keeps them.
        variables: Class whose declarations define the types of the values.

    Attributes:
        database: Tables of the newest connection; empty before the first.
        lock: Lock that is held around every access to the database.
        discarded: Number of set values that were lost with a connection, either unsent or sent without an answer.
        period: Seconds between ticks of the robot; None until two batches of a connection have shown it.
    """

    def __init__(self, robot: str, unsent: Unsent, variables: type[Declarations]) -> None:
        self.lock = threading.RLock()
        self.discarded = 0
        self.period: float | None = None
        self._robot = robot
        self._unsent = unsent
        self._declared = {(each.direction, each.name): each for each in variables.declared().values()}
        self._order = variables._word_order
        self._is_new_round = False
        self._has_warned = False
        self._unanswered: Ids = _NONE  # variables in a request that is not yet answered
        self.database = Database()
        self._first_tick: tuple[int, float] | None = None

    # -- one variable --------------------------------------------------------------------------

    def find(self, name: str) -> tuple[VariableTable, int]:
        """Find the table and id of a variable. If two have the same name, return the read variable.

        Raises:
            NotThere: If the robot has no such variable.
        """
        for table in (self.database.read, self.database.write):
            identity = table.find(name)
            if identity is not None:
                return table, identity
        raise NotThere(f"{self._robot} has no variable {name!r}{similar(name, self.names())}")

    def names(self) -> list[str]:
        """Return the names of all variables, read variables first."""
        return [row.name for row in (*self.database.read, *self.database.write)]

    def find_to_set(self, name: str) -> tuple[VariableTable, int]:
        """Find the table and id of a write variable.

        Raises:
            NotThere: If the robot has no such write variable.
        """
        write = self.database.write
        identity = write.find(name)
        if identity is None:
            is_read = name in self.database.read
            more = "; it is a read variable" if is_read else similar(name, [row.name for row in write])
            raise NotThere(f"{self._robot} has no write variable {name!r}{more}")
        return write, identity

    def set(self, name: str, value: ArrayLike) -> None:
        """Set a write variable to an integer, or to as many integers as it has words.

        Raises:
            NotThere: If the robot has no such write variable.
            BadValue: If the values are not integers, or their number is not the length of the variable.
        """
        with self.lock:
            table, identity = self.find_to_set(name)
            length = table.rows[identity].length
            try:
                if length > 1 and np.ndim(value) != 1:
                    raise BadValue(f"expected {length} words, got {value!r}")
                table.set(identity, value)
            except ValueError as error:  # BadValue, or numpy's ValueError for a value that cannot become an array
                raise BadValue(f"{name}: {error}") from None

    # -- all of them ---------------------------------------------------------------------------

    def snapshot(self) -> Iterator[Variable]:
        """Yield all variables with their current values, read variables first. The caller holds the lock."""
        for table in (self.database.read, self.database.write):
            for identity, row in enumerate(table):
                declaration = self._declared.get((table.direction, row.name))
                yield Variable(
                    name=row.name,
                    direction=table.direction,
                    identity=identity,
                    length=row.length,
                    value=self._value(table, identity),
                    stamp=table.stamp(identity),
                    updated=bool(table.updated[identity]),
                    changed=bool(table.changed[identity]),
                    fresh=bool(table.fresh[identity]),
                    unit="" if declaration is None else declaration.unit,
                    doc="" if declaration is None else declaration.doc,
                )

    def changes(self, names: frozenset[str] | None) -> dict[str, Change]:
        """Return the variables that changed in the newest batch; only `names`, unless it is None.

        A variable has changed if its time stamp or value is different.
        """
        with self.lock:
            return changes_in(self.database, names, self._value)

    def _value(self, table: VariableTable, identity: int) -> Any:
        """Return the value of a variable, in its declared type.

        Return its words if the variable is not declared, or has another length.
        """
        row = table.rows[identity]
        declaration = self._declared.get((table.direction, row.name))
        if declaration is None or declaration.length != row.length:
            return table.words(identity)
        return declaration.unpack(table.value(identity), declaration.order or self._order)

    # -- a connection --------------------------------------------------------------------------

    def adopt(self, database: Database) -> None:
        """Replace the tables by the tables of a new connection.

        Values that were set since the last sync are kept.

        The caller holds the lock.
        """
        for table in (database.read, database.write):
            table.begin_round()  # nothing in a handshake counts as new
        before, self.database = self.database, database
        self.period = None
        self._first_tick = self._tick()
        lacking = []
        for identity in before.write.dirty.take().tolist():
            row = before.write.rows[identity]
            new = database.write.find(row.name)
            if new is not None and database.write.rows[new].length == row.length:
                database.write.set(new, before.write.value(identity), before.write.stamp(identity))
            else:
                lacking.append(row.name)
        self._note_discarded(lacking, "the robot no longer has these variables")

    def give_up(self) -> None:
        """Handle a lost or failed connection: discard unsent values, unless they must be kept.

        Discarded values are never sent. A robot stops when its master has disconnected. An old command would move the
        robot again when the network is back, perhaps much later.
        """
        with self.lock:
            write = self.database.write
            lost, self._unanswered = self._unanswered.tolist(), _NONE
            if self._unsent == "discard":
                ids = write.dirty.take()
                write.updated[ids] = False
                lost += ids.tolist()
            self._note_discarded([write.rows[identity].name for identity in lost], "the connection was lost")

    def _note_discarded(self, names: list[str], reason: str) -> None:
        self.discarded += len(names)
        if names and not self._has_warned:  # once per outage, because a control loop would fill the disk
            self._has_warned = True
            _log.warning("%s: lost the values set for %s: %s", self._robot, ", ".join(map(repr, names)), reason)

    def begin_round(self) -> None:
        """Let the next batch clear the flags. Until this batch arrives, the flags describe the last batch."""
        self._is_new_round = True

    def outgoing(self, access: str, width: int) -> bytes:
        """Return the data package of a request; empty for a reader."""
        if access != "w":
            return b""
        with self.lock:
            write = self.database.write
            if not write.dirty:
                return _NOTHING_SET
            ids = write.dirty.take()
            write.updated[ids] = False
            self._unanswered = ids
            return write.encode(ids, width)

    def answered(self) -> None:
        """Note that the request was answered, so its values have reached the robot."""
        self._unanswered = _NONE
        self._has_warned = False

    def apply(self, batch: Batch) -> None:
        """Apply the values that the robot sent."""
        with self.lock:
            # `updated` of a write variable means that it was set here and has yet to be sent. No batch changes that.
            if self._is_new_round:
                self._is_new_round = False
                self.database.read.begin_round()
                self.database.write.begin_round(updates=False)
            for data in batch.data:
                self.database.table(data.direction).receive(data, updates=data.direction == "r")
            if self.period is None:
                self._measure_period()

    def _tick(self) -> tuple[int, float] | None:
        """Return the robot's tick count and its time stamp, or None; `tick` is variable 0 of every server."""
        table = self.database.read
        identity = table.find("tick")
        if identity is None:
            return None
        return int(table.value(identity)[0]), table.stamp(identity).time

    def _measure_period(self) -> None:
        """Compute the time between ticks from the first batch that shows it."""
        # Use the robot's own time stamps, so that network delays have no effect. The period stays unknown if the
        # robot's tick does not advance, or if it has no tick.
        before, after = self._first_tick, self._tick()
        if before is not None and after is not None and after[0] > before[0] and after[1] > before[1]:
            self.period = (after[1] - before[1]) / (after[0] - before[0])
