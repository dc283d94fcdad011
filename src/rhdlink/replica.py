"""The robot's variables as a client has them: a copy of its database, brought up to date by each batch."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue
from linkcore.text import similar

from .errors import NotThere
from .variables.database import Database, VariableTable
from .variables.declarations import Declarations
from .variables.snapshot import Change, Variable, changes_in
from .wire.data import Ids
from .wire.messages import Batch

_log = logging.getLogger(__name__)

#: Whether values that were set and not sent are kept when the connection is lost.
Unsent = Literal["discard", "send"]

#: A writer's request that sets nothing holds a data package all the same, as librhd's does.
_NOTHING_SET = b"dw\0\0\0\0"
_NONE: Ids = np.empty(0, np.int64)


class Replica:
    """A copy of a robot's database that threads share.

    Args:
        robot: its address, for messages.
        unsent: "discard" forgets what was set and not sent when the connection is lost; "send" keeps it.
        variables: the class whose declarations say what values mean.

    Attributes:
        database: the tables of the newest connection; empty before the first.
        lock: held around every access to the database.
        discarded: values that were set and lost with a connection: not sent, or sent and not answered.
        period: seconds between ticks of the robot, once two batches of a connection have shown it.
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
        self._unanswered: Ids = _NONE  # variables in a request that has not been answered
        self.database = Database()
        self._first_tick: tuple[int, float] | None = None

    # -- one variable --------------------------------------------------------------------------

    def find(self, name: str) -> tuple[VariableTable, int]:
        """Where a variable is; of a read and a write variable with the same name the read variable.

        Raises:
            NotThere: the robot has no such variable.
        """
        for table in (self.database.read, self.database.write):
            identity = table.find(name)
            if identity is not None:
                return table, identity
        raise NotThere(f"{self._robot} has no variable {name!r}{similar(name, self.names())}")

    def names(self) -> list[str]:
        """The names of all variables, read variables first."""
        return [row.name for row in (*self.database.read, *self.database.write)]

    def find_to_set(self, name: str) -> tuple[VariableTable, int]:
        """Where a write variable is.

        Raises:
            NotThere: the robot has no such write variable.
        """
        write = self.database.write
        identity = write.find(name)
        if identity is None:
            is_read = name in self.database.read
            more = "; it is a read variable" if is_read else similar(name, [row.name for row in write])
            raise NotThere(f"{self._robot} has no write variable {name!r}{more}")
        return write, identity

    def set(self, name: str, value: ArrayLike) -> None:
        """Set a write variable: a whole number, or as many as it is long.

        Raises:
            NotThere: the robot has no such write variable.
            BadValue: not such a number, or not as many.
        """
        with self.lock:
            table, identity = self.find_to_set(name)
            length = table.rows[identity].length
            try:
                if length > 1 and np.ndim(value) != 1:
                    raise BadValue(f"expected {length} words, got {value!r}")
                table.set(identity, value)
            except ValueError as error:  # BadValue, or numpy's own for what cannot be an array
                raise BadValue(f"{name}: {error}") from None

    # -- all of them ---------------------------------------------------------------------------

    def snapshot(self) -> Iterator[Variable]:
        """Every variable at this moment, read variables first; the caller holds the lock."""
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
        """The variables whose time stamp or value has changed in the newest batch; of these, or of all for None."""
        with self.lock:
            return changes_in(self.database, names, self._value)

    def _value(self, table: VariableTable, identity: int) -> Any:
        """The value of a variable: as it is declared, where it is and is as long."""
        row = table.rows[identity]
        declaration = self._declared.get((table.direction, row.name))
        if declaration is None or declaration.length != row.length:
            return table.words(identity)
        return declaration.unpack(table.value(identity), declaration.order or self._order)

    # -- a connection --------------------------------------------------------------------------

    def adopt(self, database: Database) -> None:
        """Go over to the tables of a new connection, with what was set since the last sync.

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
        self._note_discarded(lacking, "which the robot no longer has")

    def give_up(self) -> None:
        """The connection is lost, or could not be made: forget what has not been sent, unless that is to be kept.

        What is given up is never sent. A robot stops when its master is gone, and a command of before that would set
        it moving again however much later the network is back.
        """
        with self.lock:
            write = self.database.write
            lost, self._unanswered = self._unanswered.tolist(), _NONE
            if self._unsent == "discard":
                ids = write.dirty.take()
                write.updated[ids] = False
                lost += ids.tolist()
            self._note_discarded([write.rows[identity].name for identity in lost], "with the connection")

    def _note_discarded(self, names: list[str], reason: str) -> None:
        self.discarded += len(names)
        if names and not self._has_warned:  # once for each outage: a control loop would fill the disk
            self._has_warned = True
            _log.warning("%s: lost what was set of %s, %s", self._robot, ", ".join(map(repr, names)), reason)

    def begin_round(self) -> None:
        """Let the next batch clear the flags: until it has come, they are those of the last one."""
        self._is_new_round = True

    def outgoing(self, access: str, width: int) -> bytes:
        """The data package of a request; a reader's request has none."""
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
        """The request has been answered: what it set has arrived."""
        self._unanswered = _NONE
        self._has_warned = False

    def apply(self, batch: Batch) -> None:
        """Take what the robot says."""
        with self.lock:
            # `updated` of a write variable says that it was set here and waits to be sent, which no batch changes.
            if self._is_new_round:
                self._is_new_round = False
                self.database.read.begin_round()
                self.database.write.begin_round(updates=False)
            for data in batch.data:
                self.database.table(data.direction).receive(data, updates=data.direction == "r")
            if self.period is None:
                self._measure_period()

    def _tick(self) -> tuple[int, float] | None:
        """The robot's count of ticks, and when it counted: `tick` is variable 0 of every server."""
        table = self.database.read
        identity = table.find("tick")
        if identity is None:
            return None
        return int(table.value(identity)[0]), table.stamp(identity).time

    def _measure_period(self) -> None:
        """Work the time between ticks out from the first batch that shows it."""
        # By the robot's own stamps, so that the network has no part in it. A robot whose tick stands still, or that has
        # none, never shows it.
        before, after = self._first_tick, self._tick()
        if before is not None and after is not None and after[0] > before[0] and after[1] > before[1]:
            self.period = (after[1] - before[1]) / (after[0] - before[0])
