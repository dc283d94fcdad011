"""`connect()` and `Variables`: a robot as a program holds it."""

from __future__ import annotations

import logging
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Literal, cast

from numpy.typing import ArrayLike

from linkcore import clock
from linkcore.arguments import check_choice, check_seconds
from linkcore.clock import Stamp
from linkcore.errors import BadValue, Closed, LinkTimeout, LocalError, RemoteError
from linkcore.names import StrictAttributes
from linkcore.net.transport import TcpTransport
from linkcore.process import HomeProcess
from linkcore.streaming.connection_life import Backoff, ConnectionEvent, ConnectionState
from linkcore.streaming.packet_queue import Policy, drop_oldest
from linkcore.streaming.subscription import Subscription
from linkcore.text import similar
from linkcore.threads import Closing, ReentrantEvent, alone

from .address import parse_address
from .connection import Connection, Transport
from .errors import AccessDenied, NotThere
from .recording import RecordedTransport
from .replica import Replica, Unsent
from .sync_thread import Subscribers, SyncThread
from .variables.database import TimeStamp, database_of
from .variables.declarations import Declaration, Declarations, bind, refuse_hiding
from .variables.snapshot import Update, Variable, to_html
from .wire.decoder import Limits
from .wire.schema import WIDTHS

_log = logging.getLogger(__name__)

#: "r" reads the robot's variables; "w" is its master and writes them too.
Access = Literal["r", "w"]

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    #: The class that declares a robot's variables.
    R = TypeVar("R", bound="Variables", default="Variables")
else:
    from typing import TypeVar

    R = TypeVar("R")


def connect(
    address: str,
    variables: type[R] | None = None,
    *,
    access: Access = "r",
    fallback: Literal["r"] | None = None,
    timeout: float = 5.0,
    unsent: Unsent = "discard",
    width: int | None = None,
    limits: Limits | None = None,
    record: str | os.PathLike[str] | None = None,
) -> R:
    """Connect to a robot.

    Args:
        address: ``"localhost:24902"``, ``"rhd://smr12"``; the port is 24902 where none is named.
        variables: the class that declares what the program uses; without one, variables are
            reached by name.
        access: "r" to read, "w" to be the robot's master.
        fallback: "r" makes do with reader access if the robot has a master already; see
            `Variables.access`.
        timeout: seconds for the connection and its handshake, and for each sync that does not say.
        unsent: what becomes of values that were set and not sent when a sync finds the connection lost, or cannot make
            it again. "discard" forgets them: a robot that has lost its master should not be set moving by what was
            written before. "send" leaves them to the next sync that succeeds, however late that is.
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
        WrongPeer, PacketError: what answers is not an RHD server.
    """
    place = parse_address(address)
    if variables is not None and not (isinstance(variables, type) and issubclass(variables, Variables)):
        raise BadValue(f"variables={variables!r}; expected a class that derives from rhdlink.Variables")
    check_choice(access, "access", ("r", "w"))
    check_choice(fallback, "fallback", (None, "r"))
    check_choice(unsent, "unsent", ("discard", "send"))
    check_choice(width, "width", (None, *WIDTHS))
    timeout = check_seconds(timeout, "timeout", positive=True, finite=True)
    if limits is not None and not isinstance(limits, Limits):
        raise BadValue(f"limits={limits!r}; expected rhdlink.variables.Limits(...)")
    robot = cast("R", Variables()) if variables is None else variables()
    transport: Transport = TcpTransport(place.host, place.port, silence=timeout)
    robot._connect(
        str(place),
        transport if record is None else RecordedTransport(transport, record),
        {"access": access, "fallback": fallback, "width": width, "limits": limits},
        timeout,
        unsent,
    )
    return robot


class Variables(StrictAttributes, Declarations, Closing):
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

    _connection: Connection | None = None
    _transport: Transport | None = None
    _replica: Replica

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        refuse_hiding(cls, Variables)

    def __setattr__(self, attribute: str, value: object) -> None:
        # A misspelt name would set an attribute that is never sent.
        if not attribute.startswith("_") and not hasattr(type(self), attribute):
            raise NotThere(f"{type(self).__name__} declares no {attribute}{similar(attribute, list(self.declared()))}")
        super().__setattr__(attribute, value)

    def _connect(
        self, address: str, transport: Transport, options: dict[str, Any], timeout: float, unsent: Unsent
    ) -> None:
        self._address = address
        self._transport = transport
        self._options = options
        self._timeout = timeout
        self._home = HomeProcess(address)
        self._replica = Replica(address, unsent, type(self))
        self._exchange = threading.RLock()  # held by the thread that uses the connection
        self._subscribers = Subscribers(address)
        self._closing = ReentrantEvent()
        self._background = threading.Lock()  # held by the thread that begins to keep it in sync
        self._sync_thread: SyncThread | None = None
        self._connections = 0
        self._state = ConnectionState.IDLE
        self._open(clock.now() + timeout)

    # -- values --------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Any:
        """The words of a variable: an int if it is one, else a read-only int32 array that does not change.

        Of a read and a write variable with the same name this is the read variable.

        Raises:
            NotThere: the robot has no such variable.
        """
        replica = self._known()
        with replica.lock:
            table, identity = replica.find(name)
            return table.words(identity)

    def __setitem__(self, name: str, value: ArrayLike) -> None:
        """Set a write variable: a whole number, or as many as it is long. Sent with the next sync.

        Raises:
            NotThere: the robot has no such write variable.
            BadValue: these are not whole numbers, or not as many as the variable is long.
            AccessDenied: the access is "r".
        """
        replica = self._known()
        if self._access != "w":
            replica.find_to_set(name)  # of two mistakes, the wrong name is the one that is reported
            self._require_write_access(name)
        replica.set(name, value)

    def __contains__(self, name: object) -> bool:
        database = self._known().database
        return name in database.read or name in database.write

    def __iter__(self) -> Iterator[str]:
        """The names of all variables, read variables first."""
        return iter(self._known().names())

    def _ipython_key_completions_(self) -> list[str]:
        return [] if self._transport is None else self._known().names()

    def stamp(self, name: str) -> TimeStamp:
        """When a variable was set last, by the clock of the side that set it; raises `NotThere`."""
        replica = self._known()
        with replica.lock:
            table, identity = replica.find(name)
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
        replica = self._known()
        with replica.lock:
            return list(replica.snapshot())

    # -- the connection ------------------------------------------------------------------------

    @property
    def address(self) -> str:
        """Host and port."""
        self._known()
        return self._address

    @property
    def access(self) -> Access:
        """The access that the robot granted: "r", or "w" for its master."""
        self._known()
        return "w" if self._access == "w" else "r"

    @property
    def width(self) -> int:
        """32-bit words of a time stamp in this connection."""
        self._known()
        return self._width

    @property
    def connection(self) -> ConnectionState:
        """What the connection is doing."""
        return ConnectionState.IDLE if self._transport is None else self._state

    @property
    def received(self) -> Stamp:
        """When the newest values came, by the clocks of this machine."""
        self._known()
        return self._received

    @property
    def reconnects(self) -> int:
        """Connections after the first."""
        self._known()
        return self._connections - 1

    @property
    def discarded(self) -> int:
        """Values that were set and lost with a connection: not sent, or sent and not answered.

        See the argument `unsent` of `connect`.
        """
        return self._known().discarded

    def sync(self, timeout: float | None = None) -> None:
        """Send what was set, and get what the robot knows: one round trip, at the robot's next tick.

        After a lost connection it first connects again: greets anew and finds the variables by name. When the
        connection is lost, or cannot be made again, what was set before is forgotten, unless `connect` was given
        ``unsent="send"``: set it again. What is set after that is sent.

        Args:
            timeout: seconds for all of it; by default that of `connect`.

        Raises:
            LinkTimeout: no answer in time. The connection stays; the answer is waited for by the
                next sync. At once, if a signal handler calls it and has interrupted another sync of its own thread;
                what was set is sent by the next sync.
            ConnectionLost, PacketError: the connection has ended; the next sync makes another.
            AccessDenied, WrongVariables, ConnectFailed, WrongPeer: it could not be made again.
            Closed: after `close`.
            LocalError: in a process that was forked from the one which connected.
        """
        replica = self._known()
        seconds = self._timeout
        if timeout is not None:
            seconds = check_seconds(timeout, "timeout", positive=True, finite=True)
        self._home.check()
        # One deadline for everything: waiting for another thread, connecting, and each receive take what is left of it.
        until = clock.now() + seconds
        otherwise = f"{self.address}: another thread has been in sync() for {seconds:g} s"
        with alone(self._exchange, seconds, otherwise):
            if self._closing.is_set():
                raise Closed(f"{self._address} was closed")
            self._sync(replica, until)
            # Before another thread syncs: what is fresh now is not afterwards, and updates go out in order.
            self._subscribers.update(replica.changes, self._received)

    def background(self, period: float | None = None, *, backoff: Backoff | None = None) -> SyncThread:
        """Keep in sync from a thread, until it or the robot is closed; reconnects by itself.

        Args:
            period: seconds from sync to sync; None for every tick of the robot.
            backoff: how to reconnect.

        Raises:
            BadValue: a period that is not a positive number.
            LocalError: it is kept in sync already, or the system has no thread left.
            Closed: after `close`.
        """
        self._known()
        if self._closing.is_set():
            raise Closed(f"{self._address} was closed")
        # Without waiting: it may be a signal handler that finds it held, by the thread that it interrupts.
        is_first = self._background.acquire(blocking=False)
        try:
            if not is_first or (self._sync_thread is not None and self._sync_thread.is_running):
                raise LocalError(f"{self._address} is kept in sync already")
            made = self._sync_thread = SyncThread(self.sync, period, backoff, name=f"{self._address} sync")
            return made
        finally:
            if is_first:
                self._background.release()

    def subscribe(
        self,
        callback: Callable[[Update], object],
        *names: str,
        policy: Policy | None = None,
        lifespan: float | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> Subscription:
        """Call `callback` after each sync that brought something new, in a thread of its own, until closed.

        Args:
            callback: may be slow and may raise; neither harms anybody else.
            names: the variables it is for; all if none is named.
            policy: what to do when it falls behind; by default `drop_oldest(256)`.
            lifespan: seconds after its arrival for which an update is worth having; None for ever. One that is older
                when its turn comes is dropped, and counted in `stats.expired`.
            deadline: seconds within which something new has to come.
            on_deadline: called with the seconds since then, once for each silence that lasts longer.

        Raises:
            NotThere: the robot has no such variable.
            BadValue: an argument that cannot be.
            Closed: after `close`.
        """
        replica = self._known()
        # For a name that the robot lacks the callback would never be called, without any error.
        for name in names:
            replica.find(name)
        return self._subscribers.subscribe(
            Update,
            callback,
            frozenset(names) or None,
            drop_oldest(256) if policy is None else policy,
            lifespan,
            deadline,
            on_deadline,
            owner=self,
        )

    def subscribe_connection(
        self, callback: Callable[[ConnectionEvent], object], *, policy: Policy | None = None
    ) -> Subscription:
        """Call `callback` with each change of the connection, in a thread of its own, until closed."""
        self._known()
        policy = drop_oldest(1024) if policy is None else policy
        return self._subscribers.subscribe(ConnectionEvent, callback, None, policy, owner=self)

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect, and end the sync thread and every subscription, within `timeout` seconds.

        What the last sync sent is waited for until the robot's side has acknowledged it, for 0.7 s at most. A robot
        gets no message: its values stay as they were sent last, until it notices that its master is gone. Idempotent,
        from any thread.

        Raises:
            BadRecording: the disk failed while it was recorded.
        """
        if self._transport is None or not self._home.is_here:
            return
        timeout = check_seconds(timeout, "timeout")
        until = clock.now() + timeout
        # In this order: a thread in `sync` finds the flag when closing the transport wakes it, and raises Closed.
        self._closing.set()
        self._transport.close()
        if self._sync_thread is not None:
            self._sync_thread.close(timeout)
        if self._state is not ConnectionState.CLOSED:
            self._tell(ConnectionState.CLOSED)
        self._subscribers.close(until)
        if isinstance(self._transport, RecordedTransport):
            self._transport.finish()

    def __del__(self) -> None:
        # A connection that was never made, or was closed in a parent process, needs no warning.
        if self._connection is not None and not self._closing.is_set() and self._home.is_here:
            try:
                warnings.warn(f"{self!r} was dropped without close()", ResourceWarning, source=self, stacklevel=2)
            finally:
                self.close(0.0)

    def __repr__(self) -> str:
        if self._transport is None or not self._connections:
            return f"<{type(self).__name__}, not connected>"
        database = self._replica.database
        counts = f"{len(database.read)} read and {len(database.write)} write variables"
        return f"<{type(self).__name__} {self._address} access {self._access!r}, {counts}, {self._state.value}>"

    def _repr_html_(self) -> str:
        return to_html(repr(self), () if self._transport is None else self.variables)

    # ------------------------------------------------------------------------------------------

    def _known(self) -> Replica:
        if self._transport is None:
            raise LocalError(f"{type(self).__name__} belongs to no robot yet; it is what connect() takes")
        return self._replica

    def _flag(self, name: str, flag: str) -> bool:
        replica = self._known()
        with replica.lock:
            table, identity = replica.find(name)
            return bool(getattr(table, flag)[identity])

    def _check_set(self, declaration: Declaration[Any, Any]) -> None:
        if self._transport is None:
            return  # on the robot's side
        if declaration.direction == "r":
            raise LocalError(f"{declaration.name} is a read variable: the robot sets it")
        self._require_write_access(declaration.name)

    def _require_write_access(self, name: str) -> None:
        if self._access != "w":
            raise AccessDenied(f"{name} cannot be set: the access is 'r'; connect with access='w'")

    def _sync(self, replica: Replica, until: float) -> None:
        """One exchange, by the thread that holds the connection."""
        try:
            connection = self._connection or self._open(until)
            replica.begin_round()
            # First what has come already. An unsolicited batch that stayed in the buffer would be taken for the reply
            # to this request, and each reply after it for that to the next.
            connection.take_waiting(until)
            connection.collect(until)
            replica.answered()
            connection.settle(replica.period, until)
            connection.request(replica.outgoing(connection.access, connection.width), until)
            replica.answered()
            self._received = connection.received
        except RemoteError as error:
            if self._closing.is_set():
                raise Closed(f"{self._address} was closed") from error
            if isinstance(error, LinkTimeout) and self._connection is not None:
                raise  # the robot still has its master, and is sent with the next sync what it could not be sent now
            self._lose(replica, error)
            raise

    def _open(self, until: float) -> Connection:
        """Connect, and find the variables."""
        if self._closing.is_set() or self._transport is None:
            raise Closed(f"{self._address} was closed")
        self._tell(ConnectionState.CONNECTING)
        replica = self._replica
        connection = Connection(self._transport, until=until, deliver=replica.apply, **self._options)
        # Found anew by name: a robot that was started again may have other variables, in another order.
        database = database_of(connection.handshake)
        try:
            with replica.lock:
                bind(self, database, replica.lock)
                replica.adopt(database)
        except RemoteError:
            connection.abort()
            raise
        if self._closing.is_set():  # closed while connecting: `close` could not see this connection
            connection.abort()
            raise Closed(f"{self._address} was closed")
        self._connection = connection
        self._access, self._width, self._received = connection.access, connection.width, connection.received
        self._connections += 1
        self._tell(ConnectionState.CONNECTED)
        return connection

    def _lose(self, replica: Replica, error: RemoteError) -> None:
        """The connection is lost, or could not be made."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.abort()
            _log.info("%s: connection lost: %s", self._address, error)
        replica.give_up()  # before anybody hears of it: what is set then is sent
        self._tell(ConnectionState.LOST, error)

    def _tell(self, state: ConnectionState, error: Exception | None = None) -> None:
        if self._closing.is_set() and state is not ConnectionState.CLOSED:
            return  # a sync that `close` has interrupted
        self._state = state
        self._subscribers.tell(ConnectionEvent(state, self._address, error, Stamp.now()))
