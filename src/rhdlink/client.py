"""`connect()` and `Variables`: a robot as a program holds it."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Any, Literal, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkcore.errors import BadValue, Closed, LinkTimeout, LocalError, RemoteError
from linkcore.net.transport import TcpTransport
from linkcore.stamp import Stamp
from linkcore.streaming.backoff import Backoff
from linkcore.streaming.events import ConnectionEvent, ConnectionState
from linkcore.streaming.policy import Policy, drop_oldest
from linkcore.streaming.subscription import Subscription

from .address import parse_address
from .audience import Audience
from .background import Background
from .database import Database, Table, TimeStamp
from .errors import AccessDenied, NotThere
from .limits import Limits
from .link import Link, Transport
from .snapshot import Variable, to_html
from .tape import Tape
from .trial import WIDTHS
from .update import Change, Update
from .variables import Declaration, Declarations
from .wire import Batch

__all__ = ["Access", "Variables", "connect"]

_log = logging.getLogger(__name__)

#: "r" reads what the robot knows; "w" is its master and tells it what to do.
Access = Literal["r", "w"]

#: What a writer says that has set nothing: its request holds a data package all the same (section 4).
_NOTHING_SET = b"dw\0\0\0\0"

R = TypeVar("R", bound="Variables")


@overload
def connect(
    address: str,
    variables: None = None,
    *,
    access: Access = "r",
    fallback: Literal["r"] | None = None,
    timeout: float = 5.0,
    width: int | None = None,
    limits: Limits | None = None,
    record: str | os.PathLike[str] | None = None,
) -> Variables: ...


@overload
def connect(
    address: str,
    variables: type[R],
    *,
    access: Access = "r",
    fallback: Literal["r"] | None = None,
    timeout: float = 5.0,
    width: int | None = None,
    limits: Limits | None = None,
    record: str | os.PathLike[str] | None = None,
) -> R: ...


def connect(
    address: str,
    variables: type[Variables] | None = None,
    *,
    access: Access = "r",
    fallback: Literal["r"] | None = None,
    timeout: float = 5.0,
    width: int | None = None,
    limits: Limits | None = None,
    record: str | os.PathLike[str] | None = None,
) -> Variables:
    """Connect to a robot.

    Args:
        address: ``"localhost:24902"``, ``"rhd://smr12"``; the port is 24902 where none is named.
        variables: the class that declares what the program uses; without one, variables are
            reached by name.
        access: "r" to read, "w" to be the robot's master.
        fallback: "r" makes do with reader access if the robot has a master already; see
            `Variables.access`.
        timeout: seconds for the connection and its handshake, and for each sync that does not say.
        width: 32-bit words of a time stamp, 2 or 4; by default found out from the handshake.
        limits: what the robot may ask for.
        record: a file that does not exist yet, for every byte that the robot sends, with the time at
            which it came; `rhdlink replay` plays it. Each write holds up the sync it belongs to.

    Raises:
        BadAddress, BadValue: an argument that cannot be.
        BadRecording: the file to record into exists, or cannot be made.
        AccessDenied: the robot has a master already.
        WrongVariables: it lacks what was declared; all of it is listed.
        ConnectFailed, ConnectionLost, LinkTimeout: nobody is there, or no longer, or silent.
        WrongPeer, PacketError: what is there is no RHD server.
    """
    place = parse_address(address)
    if access not in ("r", "w") or fallback not in (None, "r"):
        raise BadValue(f"access={access!r}, fallback={fallback!r}; expected 'r' or 'w', and None or 'r'")
    if not timeout > 0:
        raise BadValue(f"timeout is {timeout}; expected a positive number of seconds")
    if width is not None and width not in WIDTHS:
        raise BadValue(f"width is {width}; expected 2 or 4 words")
    robot = (variables or Variables)()
    transport: Transport = TcpTransport(place.host, place.port, silence=timeout)
    robot._connect(
        str(place),
        transport if record is None else Tape(transport, record),
        {"access": access, "fallback": fallback, "width": width, "limits": limits},
        timeout,
    )
    return robot


class Variables(Declarations):
    """A robot: its variables, in step with it by `sync`. A context manager that closes itself.

    Derive from it to declare variables as properties, see `Read` and `Write`; every variable of the
    robot, declared or not, is reached by name too::

        class Smr(Variables):
            encl = Read(Int32, unit="ticks")
            speedl = Write(Int32, unit="cm/s")

        with rhdlink.connect("localhost:24902", Smr, access="w") as robot:
            robot.speedl = 20
            robot.sync()
            print(robot.encl, robot["linesensor"])

    Values change with `sync` and only with it; what is set is sent with the next one. All of it may be
    used from several threads. Made by `connect`.
    """

    _link: Link | None = None
    _transport: Transport | None = None
    _database: Database | None = None

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for attribute in cls.declared():
            if hasattr(Variables, attribute):
                raise BadValue(
                    f"{cls.__name__}.{attribute} would hide what every robot has; "
                    f"call it otherwise, with name={cls.declared()[attribute].name!r}"
                )

    def __setattr__(self, attribute: str, value: object) -> None:
        # A slip of the pen would set an attribute that nobody sends.
        if not attribute.startswith("_") and not hasattr(type(self), attribute):
            raise NotThere(f"{type(self).__name__} declares no {attribute}")
        super().__setattr__(attribute, value)

    def _connect(self, address: str, transport: Transport, options: dict[str, Any], timeout: float) -> None:
        self._address = address
        self._transport = transport
        self._options = options
        self._timeout = timeout
        self._guard = threading.RLock()  # the database
        self._exchange = threading.RLock()  # the connection
        self._audience = Audience(address)
        self._closing = threading.Event()
        self._background: Background | None = None
        self._connections = 0
        self._state = ConnectionState.IDLE
        self._open(time.monotonic() + timeout)

    # -- values --------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> NDArray[np.int32]:
        """The words of a variable, as a read-only array that does not change.

        Of a read and a write variable with the same name this is the read variable.

        Raises:
            NotThere: the robot has no such variable.
        """
        with self._guard:
            table, identity = self._find(name)
            words = table.value(identity).copy()
        words.flags.writeable = False
        return words

    def __setitem__(self, name: str, value: ArrayLike) -> None:
        """Set a write variable: a whole number, or as many as it is long. Sent with the next sync.

        Raises:
            NotThere: the robot has no such write variable.
            BadValue: it is no such number, or as many.
            AccessDenied: the access is "r".
        """
        with self._guard:
            table = self._known.write
            identity = table.find(name)
            if identity is None:
                more = "; it is a read variable" if name in self._known.read else ""
                raise NotThere(f"{self._address} has no write variable {name!r}{more}")
            self._check_access(name)
            length = table.rows[identity].length
            try:
                if length > 1 and np.ndim(value) != 1:
                    raise BadValue(f"expected {length} words, got {value!r}")
                table.set(identity, value)
            except ValueError as error:  # BadValue, or numpy's own for what is no array at all
                raise BadValue(f"{name}: {error}") from None

    def __contains__(self, name: object) -> bool:
        return name in self._known.read or name in self._known.write

    def stamp(self, name: str) -> TimeStamp:
        """When a variable was set last, by the clock of who set it; raises `NotThere`."""
        with self._guard:
            table, identity = self._find(name)
            return table.stamp(identity)

    def updated(self, name: str) -> bool:
        """A read variable was in the last batch; a write variable waits to be sent. Raises `NotThere`.

        A server of the original sends what was set once in every batch for ever; `fresh` tells more.
        """
        return self._flag(name, "updated")

    def changed(self, name: str) -> bool:
        """The value differed from the one before when the variable came last; raises `NotThere`."""
        return self._flag(name, "changed")

    def fresh(self, name: str) -> bool:
        """The variable came with the last sync, and with another time stamp or value; raises `NotThere`."""
        return self._flag(name, "fresh")

    @property
    def variables(self) -> list[Variable]:
        """Every variable at this moment, read variables first."""
        declared = {(each.direction, each.name): each for each in self.declared().values()}
        found = []
        with self._guard:
            for table in (self._known.read, self._known.write):
                for identity, row in enumerate(table):
                    declaration = declared.get((table.direction, row.name))
                    found.append(
                        Variable(
                            name=row.name,
                            direction=table.direction,
                            identity=identity,
                            length=row.length,
                            value=self._value(table, identity, declaration),
                            stamp=table.stamp(identity),
                            updated=bool(table.updated[identity]),
                            changed=bool(table.changed[identity]),
                            fresh=bool(table.fresh[identity]),
                            unit="" if declaration is None else declaration.unit,
                            doc="" if declaration is None else declaration.doc,
                        )
                    )
        return found

    # -- the connection ------------------------------------------------------------------------

    @property
    def address(self) -> str:
        """Host and port."""
        return self._address

    @property
    def access(self) -> Access:
        """What the robot granted: "r", or "w" for its master."""
        return "w" if self._access == "w" else "r"

    @property
    def width(self) -> int:
        """32-bit words of a time stamp in this connection."""
        return self._width

    @property
    def connection(self) -> ConnectionState:
        """What the connection is doing."""
        return self._state

    @property
    def received(self) -> Stamp:
        """When the newest values came, by the clocks of this machine."""
        return self._received

    @property
    def reconnects(self) -> int:
        """Connections after the first."""
        return self._connections - 1

    def sync(self, timeout: float | None = None) -> None:
        """Send what was set, and get what the robot knows: one round trip, at the robot's next tick.

        After a lost connection it first connects again: greets anew and finds the variables by name.
        What was set and not sent when the connection was lost is forgotten, since the robot may have
        stopped meanwhile; what is set after that is sent.

        Args:
            timeout: seconds for all of it; by default that of `connect`.

        Raises:
            LinkTimeout: no answer in time. The connection stays; the answer is waited for by the
                next sync.
            ConnectionLost, PacketError: the connection has ended; the next sync makes another.
            AccessDenied, WrongVariables, ConnectFailed, WrongPeer: it could not be made again.
            Closed: after `close`.
        """
        seconds = self._timeout if timeout is None else timeout
        if not seconds > 0:
            raise BadValue(f"timeout is {seconds}; expected a positive number of seconds")
        until = time.monotonic() + seconds
        if not self._exchange.acquire(timeout=min(seconds, threading.TIMEOUT_MAX)):
            raise LinkTimeout(f"{self.address}: another thread has been in sync() for {seconds:g} s")
        try:
            if self._closing.is_set():
                raise Closed(f"{self._address} was closed")
            link = self._link or self._open(until)
            known = self._known
            with self._guard:
                known.read.begin_round()
                known.write.begin_round(updates=False)
            try:
                link.take_waiting(until)
                link.collect(until)
                link.settle(self._period, until)
                link.request(self._outgoing(link), until)
            except LinkTimeout:
                raise
            except RemoteError as error:
                if self._closing.is_set():
                    raise Closed(f"{self._address} was closed") from error
                self._lose(error)
                raise
            self._received = link.received
        finally:
            self._exchange.release()
        if self._audience.has(Update):
            self._audience.update(self._changes(self._audience.wanted()), self._received)

    def background(self, period: float | None = None, *, backoff: Backoff | None = None) -> Background:
        """Keep in sync from a thread, until it or the robot is closed; reconnects by itself.

        Args:
            period: seconds from sync to sync; None for every tick of the robot.
            backoff: how to reconnect.

        Raises:
            BadValue: a period that is no positive number.
            LocalError: it is kept in sync already.
            Closed: after `close`.
        """
        if self._closing.is_set():
            raise Closed(f"{self._address} was closed")
        if self._background is not None and self._background.is_running:
            raise LocalError(f"{self._address} is kept in sync already")
        self._background = Background(self.sync, period, backoff, name=f"{self._address} sync")
        return self._background

    def subscribe(
        self,
        callback: Callable[[Update], object],
        *names: str,
        policy: Policy | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> Subscription:
        """Call `callback` after each sync that brought something new, in a thread of its own, until closed.

        Args:
            callback: may be slow and may raise; neither harms anybody else.
            names: the variables it is for; all if none is named.
            policy: what to do when it falls behind; by default `drop_oldest(256)`.
            deadline: seconds within which something new has to come.
            on_deadline: called with the seconds since then, once for each silence that lasts longer.

        Raises:
            NotThere: the robot has no such variable.
            Closed: after `close`.
        """
        for name in names:
            self._find(name)
        if deadline is not None and not deadline > 0:
            raise BadValue(f"deadline is {deadline}; expected a positive number of seconds")
        if on_deadline is not None and deadline is None:
            raise BadValue("on_deadline was given without a deadline")
        return self._audience.subscribe(
            Update, callback, frozenset(names) or None, policy or drop_oldest(256), deadline, on_deadline
        )

    def subscribe_connection(
        self, callback: Callable[[ConnectionEvent], object], *, policy: Policy | None = None
    ) -> Subscription:
        """Call `callback` with each change of the connection, in a thread of its own, until closed."""
        return self._audience.subscribe(ConnectionEvent, callback, None, policy or drop_oldest(1024))

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect, and end the background thread and every subscription, within `timeout` seconds.

        A robot is not told: its values stay as they were sent last, until it notices that its master
        is gone. Idempotent, from any thread.

        Raises:
            BadRecording: the disk failed while it was recorded.
        """
        if self._transport is None:
            return
        until = time.monotonic() + timeout
        self._closing.set()
        self._transport.close()
        if self._background is not None:
            self._background.close(timeout)
        if self._state is not ConnectionState.CLOSED:
            self._tell(ConnectionState.CLOSED)
        self._audience.close(until)
        if isinstance(self._transport, Tape):
            self._transport.finish()

    def __enter__(self: R) -> R:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __repr__(self) -> str:
        if self._database is None:
            return f"<{type(self).__name__}, not connected>"
        counts = f"{len(self._database.read)} read and {len(self._database.write)} write variables"
        return f"<{type(self).__name__} {self._address} access {self._access!r}, {counts}, {self._state.value}>"

    def _repr_html_(self) -> str:
        return to_html(repr(self), () if self._database is None else self.variables)

    # ------------------------------------------------------------------------------------------

    @property
    def _known(self) -> Database:
        if self._database is None:
            raise LocalError(f"{type(self).__name__} belongs to no robot yet; it is what connect() takes")
        return self._database

    def _find(self, name: str) -> tuple[Table, int]:
        for table in (self._known.read, self._known.write):
            identity = table.find(name)
            if identity is not None:
                return table, identity
        raise NotThere(f"{self._address} has no variable {name!r}")

    def _flag(self, name: str, flag: str) -> bool:
        with self._guard:
            table, identity = self._find(name)
            return bool(getattr(table, flag)[identity])

    def _value(self, table: Table, identity: int, declaration: Declaration[Any, Any] | None) -> Any:
        words = table.value(identity).copy()
        if declaration is not None and declaration.length == len(words):
            return declaration.unpack(words, declaration.order or self._order)
        words.flags.writeable = False
        return words

    def _check_set(self, declaration: Declaration[Any, Any]) -> None:
        if self._transport is None:
            return  # on the robot's side
        if declaration.direction == "r":
            raise LocalError(f"{declaration.name} is a read variable: the robot sets it")
        self._check_access(declaration.name)

    def _check_access(self, name: str) -> None:
        if self._access != "w":
            raise AccessDenied(f"{name} cannot be set: the access is 'r'; connect with access='w'")

    def _open(self, until: float) -> Link:
        """Connect, and find the variables."""
        if self._closing.is_set() or self._transport is None:
            raise Closed(f"{self._address} was closed")
        self._tell(ConnectionState.CONNECTING)
        try:
            link = Link(self._transport, until=until, deliver=self._apply, **self._options)
        except RemoteError as error:
            self._tell(ConnectionState.LOST, error)
            raise
        handshake = link.handshake
        database = Database(handshake.read, handshake.write)
        for data in handshake.data:
            database.table(data.direction).receive(data, updates=False)
        for table in (database.read, database.write):
            table.begin_round()
        try:
            self._adopt(database)
        except RemoteError as error:
            link.close()
            self._tell(ConnectionState.LOST, error)
            raise
        if self._closing.is_set():  # while connecting: it could not see this connection
            link.close()
            raise Closed(f"{self._address} was closed")
        self._link = link
        self._access, self._width, self._received = link.access, link.width, link.received
        self._connections += 1
        self._period: float | None = None
        self._ticked = self._tick()
        self._tell(ConnectionState.CONNECTED)
        return link

    def _adopt(self, database: Database) -> None:
        """Go over to the tables of a new connection, with what was set since the last one was lost."""
        with self._guard:
            before = self._database
            self.bind(database)
            self._database = database
            if before is None:
                return
            for identity in before.write.pending.take().tolist():
                row = before.write.rows[identity]
                new = database.write.find(row.name)
                if new is not None and database.write.rows[new].length == row.length:
                    database.write.set(new, before.write.value(identity), before.write.stamp(identity))

    def _lose(self, error: RemoteError) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()
        with self._guard:
            write = self._known.write
            write.updated[write.pending.take()] = False
        _log.info("%s: connection lost: %s", self._address, error)
        self._tell(ConnectionState.LOST, error)

    def _outgoing(self, link: Link) -> bytes:
        """The data package of a request; a reader's has none."""
        if link.access != "w":
            return b""
        with self._guard:
            write = self._known.write
            if not write.pending:
                return _NOTHING_SET
            ids = write.pending.take()
            write.updated[ids] = False
            return write.encode(ids, link.width)

    def _apply(self, batch: Batch) -> None:
        with self._guard:
            known = self._known
            for data in batch.data:
                # A write variable's `updated` says that it waits to be sent: receiving never sets it.
                known.table(data.direction).receive(data, updates=data.direction == "r")
        if self._period is None:
            self._measure()

    def _tick(self) -> tuple[int, float] | None:
        """The robot's count of ticks, and when it counted; variable 0 of every server (section 3)."""
        table = self._known.read
        identity = table.find("tick")
        if identity is None:
            return None
        return int(table.value(identity)[0]), table.stamp(identity).time

    def _measure(self) -> None:
        """The time between ticks, from the first batch that shows it."""
        before, after = self._ticked, self._tick()
        if before is not None and after is not None and after[0] > before[0] and after[1] > before[1]:
            self._period = (after[1] - before[1]) / (after[0] - before[0])

    def _changes(self, names: frozenset[str] | None) -> dict[str, Change]:
        """What is fresh, by name; None is for every name."""
        declared = {(each.direction, each.name): each for each in self.declared().values()}
        changes: dict[str, Change] = {}
        with self._guard:
            # Of a read and a write variable with the same name the read variable stands.
            for table in (self._known.write, self._known.read):
                for identity in table.fresh.nonzero()[0].tolist():
                    name = table.rows[identity].name
                    if names is None or name in names:
                        value = self._value(table, identity, declared.get((table.direction, name)))
                        changes[name] = Change(value, table.stamp(identity), bool(table.changed[identity]))
        return changes

    def _tell(self, state: ConnectionState, error: Exception | None = None) -> None:
        self._state = state
        self._audience.tell(ConnectionEvent(state, self._address, error, Stamp.now()))
