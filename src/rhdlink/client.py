"""Function `connect`, and class `Variables`, the robot object of a client program."""

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

from .address import MqttAddress, is_mqtt, parse_address, parse_mqtt_address
from .errors import AccessDenied, NotThere
from .recording import RecordedTransport
from .sync.connection import Connection
from .sync.replica import Replica, Unsent
from .sync.sync_thread import Subscribers, SyncThread
from .variables.database import TimeStamp, database_of
from .variables.declarations import Declaration, Declarations, bind, refuse_hiding
from .variables.snapshot import Update, Variable, to_html
from .wire.decoder import Limits
from .wire.schema import WIDTHS
from .wire.transport import Transport

_log = logging.getLogger(__name__)

#: "r" is a client that can read the robot's variables. "w" is the robot's master, which can also write them.
Access = Literal["r", "w"]

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    #: Class that declares a robot's variables.
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
        address: Address such as ``"localhost:24902"`` or ``"rhd://smr12"``. The default port is 24902. The address of a
            robot with MQTT is ``"mqtt://192.168.0.55"``, ``"mqtt://192.168.0.55:1883"`` or
            ``"mqtt://192.168.0.55?dialect=2026"``.
        variables: Class that declares the variables of your program. Without it, variables are available by name only.
        access: "r" to read; "w" to be the robot's master, which also writes.
        fallback: "r" accepts read access if the robot already has a master; see `Variables.access`.
        timeout: Maximum time for the connection and its handshake, in seconds. It is also the default timeout of each
            sync.
        unsent: Treatment of values that were set but not yet sent when a sync finds the connection lost or cannot
            reconnect. "discard" drops them, because old commands should not move a robot that has lost its master.
            "send" keeps them for the next successful sync, however late that is.
        width: Number of 32-bit words of a time stamp, 2 or 4. By default it is detected from the handshake.
        limits: Limits on the data that the robot may send.
        record: Path of a new file in which to record every byte that the robot sends, with its arrival time. The
            command `rhdlink replay` plays the file. Each write to the file delays its sync.

    Raises:
        BadAddress: If `address` is not valid.
        BadValue: If another argument is not valid.
        LocalError: If the address begins with ``mqtt://``, and paho-mqtt is not installed.
        BadRecording: If the file of `record` already exists or cannot be created.
        AccessDenied: If the robot already has a master.
        WrongVariables: If the robot's variables do not match the declared ones. The error lists every difference.
        ConnectFailed: If no robot answers at the address.
        ConnectionLost: If the robot closes the connection.
        LinkTimeout: If the robot does not answer in time.
        WrongPeer, PacketError: If the peer is not an RHD server.
    """
    place = parse_mqtt_address(address) if is_mqtt(address) else parse_address(address)
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
    transport: Transport
    if isinstance(place, MqttAddress):
        from .mqtt.mqtt_transport import MqttTransport  # only here: most programs need no host

        transport = MqttTransport(place, access=access, fallback=fallback, width=width, silence=timeout)
    else:
        transport = TcpTransport(place.host, place.port, silence=timeout)
    robot._connect(
        str(place),
        transport if record is None else RecordedTransport(transport, record),
        {"access": access, "fallback": fallback, "width": width, "limits": limits},
        timeout,
        unsent,
    )
    return robot


class Variables(StrictAttributes, Declarations, Closing):
    """Robot with its variables, whose values `sync` exchanges with the robot.

    Use it as a context manager to close it at the end of a block.

    Derive a class to declare variables as properties; see `Read` and `Write`. Every variable of the robot, declared or
    not, is also available by name::

        class Smr(Variables):
            encl = Read(Int32, unit="ticks")
            speedl = Write(Int32, unit="cm/s")

        with rhdlink.connect("localhost:24902", Smr, access="w") as robot:
            robot.speedl = 20
            robot.sync()
            print(robot.encl, robot["linesensor"])

    Values change only with `sync`, and values that you set are sent by the next `sync`. All methods can be called from
    several threads. Instances are made by `connect`.
    """

    _connection: Connection | None = None
    _transport: Transport | None = None
    _replica: Replica

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        refuse_hiding(cls, Variables)

    def __setattr__(self, attribute: str, value: object) -> None:
        # Reject unknown names, because a misspelt name would set an attribute that is never sent.
        if not attribute.startswith("_") and not hasattr(type(self), attribute):
            raise NotThere(
                f"{type(self).__name__} does not declare {attribute}{similar(attribute, list(self.declared()))}"
            )
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
        self._background = threading.Lock()  # held by a thread that starts the sync thread
        self._sync_thread: SyncThread | None = None
        self._connections = 0
        self._state = ConnectionState.IDLE
        self._telling = threading.RLock()  # held from a change of the state until its event is queued
        self._open(clock.now() + timeout)

    # -- values --------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Any:
        """Return the words of a variable: an int if it has one word, otherwise a read-only int32 array.

        The array is a copy that does not change. If a read and a write variable have the same name, the read variable
        is returned.

        Raises:
            NotThere: If the robot has no such variable.
        """
        replica = self._known()
        with replica.lock:
            table, identity = replica.find(name)
            return table.words(identity)

    def __setitem__(self, name: str, value: ArrayLike) -> None:
        """Set a write variable to an integer, or to a sequence with one integer for each word.

        The next sync sends the value.

        Raises:
            NotThere: If the robot has no such write variable.
            BadValue: If the values are not integers, or their number is not the length of the variable.
            AccessDenied: If the access is "r".
        """
        replica = self._known()
        if self._access != "w":
            replica.find_to_set(name)  # if the name is wrong as well, report that first
            self._require_write_access(name)
        replica.set(name, value)

    def __contains__(self, name: object) -> bool:
        database = self._known().database
        return name in database.read or name in database.write

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of all variables, read variables first."""
        return iter(self._known().names())

    def _ipython_key_completions_(self) -> list[str]:
        return [] if self._transport is None else self._known().names()

    def stamp(self, name: str) -> TimeStamp:
        """Return the time at which a variable was last set, on the clock of the side that has set it.

        Raises `NotThere`.
        """
        replica = self._known()
        with replica.lock:
            table, identity = replica.find(name)
            return table.stamp(identity)

    def updated(self, name: str) -> bool:
        """Whether a read variable was in the last batch, or whether a write variable still has to be sent.

        Raises `NotThere`.

        The original server sends a variable in every batch after it has been set once. `fresh` shows real updates.
        """
        return self._flag(name, "updated")

    def changed(self, name: str) -> bool:
        """Whether the last arrival of the variable brought a different value. Raises `NotThere`."""
        return self._flag(name, "changed")

    def fresh(self, name: str) -> bool:
        """Whether the last sync brought the variable with a new time stamp or value.

        Raises `NotThere`.
        """
        return self._flag(name, "fresh")

    @property
    def variables(self) -> list[Variable]:
        """All variables with their current values, read variables first."""
        replica = self._known()
        with replica.lock:
            return list(replica.snapshot())

    # -- the connection ------------------------------------------------------------------------

    @property
    def address(self) -> str:
        """Host and port of the robot."""
        self._known()
        return self._address

    @property
    def access(self) -> Access:
        """Access that the robot granted: "r" for a reader, "w" for its master."""
        self._known()
        return "w" if self._access == "w" else "r"

    @property
    def width(self) -> int:
        """Number of 32-bit words of a time stamp in this connection."""
        self._known()
        return self._width

    @property
    def connection(self) -> ConnectionState:
        """Current state of the connection."""
        return ConnectionState.IDLE if self._transport is None else self._state

    @property
    def received(self) -> Stamp:
        """Time at which the newest values arrived, on the clocks of this computer."""
        self._known()
        return self._received

    @property
    def reconnects(self) -> int:
        """Number of connections after the first."""
        self._known()
        return self._connections - 1

    @property
    def discarded(self) -> int:
        """Number of set values that were lost with a connection.

        These are values that were not sent, or were sent without an answer.

        See the argument `unsent` of `connect`.
        """
        return self._known().discarded

    def sync(self, timeout: float | None = None) -> None:
        """Send the set values, and receive the robot's values, in one round trip at the robot's next tick.

        If the connection was lost, `sync` first reconnects, repeats the handshake and finds the variables by name. If
        `sync` finds the connection lost or cannot reconnect, it discards the values that were set before, unless
        `connect` was called with ``unsent="send"``. Set them again if they are still needed. Values that are set after
        that are sent.

        Args:
            timeout: Maximum time for the whole call, in seconds. The default is the timeout of `connect`.

        Raises:
            LinkTimeout: If the answer does not arrive in time. The connection stays open, and the next sync waits for
                the answer. Also raised immediately if a signal handler has interrupted a sync of its own thread and
                calls `sync`; the next sync then sends the values.
            ConnectionLost, PacketError: If the connection ends. The next sync reconnects.
            AccessDenied, WrongVariables, ConnectFailed, WrongPeer: If reconnecting fails.
            Closed: If the robot object was closed.
            LocalError: If called in a forked child of the process that connected.
        """
        replica = self._known()
        seconds = self._timeout
        if timeout is not None:
            seconds = check_seconds(timeout, "timeout", positive=True, finite=True)
        self._home.check()
        # Use one deadline for the whole call, including waiting for another thread, connecting, and each receive.
        until = clock.now() + seconds
        otherwise = f"{self.address}: another thread has been in sync() for {seconds:g} s"
        with alone(self._exchange, seconds, otherwise):
            if self._closing.is_set():
                raise Closed(f"{self._address} was closed")
            self._sync(replica, until)
            # Do this before another thread syncs. Its sync would clear the `fresh` flags, and updates must be delivered
            # in order.
            self._subscribers.update(replica.changes, self._received)

    def background(self, period: float | None = None, *, backoff: Backoff | None = None) -> SyncThread:
        """Start a thread that syncs and reconnects until the thread or the robot object is closed.

        Args:
            period: Seconds from one sync to the next. If None, sync at every tick of the robot.
            backoff: Delays between attempts to reconnect.

        Raises:
            BadValue: If `period` is not a positive number.
            LocalError: If a sync thread is already running, or the system cannot start another thread.
            Closed: If the robot object was closed.
        """
        self._known()
        if self._closing.is_set():
            raise Closed(f"{self._address} was closed")
        # Do not wait for the lock: a signal handler might find it held by the thread that it interrupted.
        is_first = self._background.acquire(blocking=False)
        try:
            if not is_first or (self._sync_thread is not None and self._sync_thread.is_running):
                raise LocalError(f"{self._address} already has a sync thread")
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
        """Call `callback` in a dedicated thread after each sync that brought new values.

        The calls end when the subscription or the robot object is closed.

        Args:
            callback: Function that is called with each `Update`. If it is slow or raises an exception, other callbacks
                and the sync are not affected.
            names: Names of the wanted variables; all variables if none is given.
            policy: Policy of the queue when the callback falls behind. The default is `drop_oldest(256)`.
            lifespan: Maximum age of an update when its turn comes, in seconds; None for no maximum. Older updates are
                dropped and counted in `stats.expired`.
            deadline: Maximum seconds between two updates.
            on_deadline: Function that is called with the seconds since the last update, once for each silence longer
                than `deadline`.

        Raises:
            NotThere: If the robot has no such variable.
            BadValue: If an argument is not valid.
            Closed: If the robot object was closed.
        """
        replica = self._known()
        # Check the names: if the robot lacked one of them, the callback would never be called, without any error.
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
        """Call `callback` in a dedicated thread at each change of the connection state.

        The calls end when the subscription or the robot object is closed.
        """
        self._known()
        policy = drop_oldest(1024) if policy is None else policy
        return self._subscribers.subscribe(ConnectionEvent, callback, None, policy, owner=self)

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect, and end the sync thread and every subscription, within `timeout` seconds.

        Wait up to 0.7 s until the robot's side has acknowledged the data that the last sync sent. The robot receives no
        message: its values stay as they were last sent, until it notices that its master has disconnected. A robot
        with MQTT is stopped instead, with the commands ``rc 0 0`` and ``stop``. Idempotent, from any thread.

        Raises:
            BadRecording: If the disk failed during recording.
        """
        if self._transport is None or not self._home.is_here:
            return
        timeout = check_seconds(timeout, "timeout")
        until = clock.now() + timeout
        # The order is important: when closing the transport wakes a thread in `sync`, this thread finds the flag and
        # raises Closed.
        self._closing.set()
        self._transport.close()
        if self._sync_thread is not None:
            self._sync_thread.close(timeout)
        self._tell(ConnectionState.CLOSED)
        self._subscribers.close(until)
        if isinstance(self._transport, RecordedTransport):
            self._transport.finish()

    def __del__(self) -> None:
        # No warning is needed if the connection was never made, or if this is a forked child of the process that made
        # it.
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
            raise LocalError(f"{type(self).__name__} is not connected; use the object that rhdlink.connect() returns")
        return self._replica

    def _flag(self, name: str, flag: str) -> bool:
        replica = self._known()
        with replica.lock:
            table, identity = replica.find(name)
            return bool(getattr(table, flag)[identity])

    def _check_set(self, declaration: Declaration[Any, Any]) -> None:
        if self._transport is None:
            return  # this is an object of a host
        if declaration.direction == "r":
            raise LocalError(f"{declaration.name} is a read variable; only the robot can set it")
        self._require_write_access(declaration.name)

    def _require_write_access(self, name: str) -> None:
        if self._access != "w":
            raise AccessDenied(f"{name} cannot be set with access 'r'; connect with access='w'")

    def _sync(self, replica: Replica, until: float) -> None:
        """Perform one exchange. The calling thread holds `_exchange`."""
        try:
            connection = self._connection or self._open(until)
            replica.begin_round()
            # First deliver batches that have already arrived. If an unsolicited batch stayed in the buffer, it would be
            # read as the reply to this request, and each later reply as the reply to the next request.
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
                raise  # the connection stays; the robot keeps its master, and the next sync sends any unsent values
            self._lose(replica, error)
            raise

    def _open(self, until: float) -> Connection:
        """Connect, and find the declared variables."""
        if self._closing.is_set() or self._transport is None:
            raise Closed(f"{self._address} was closed")
        self._tell(ConnectionState.CONNECTING)
        replica = self._replica
        connection = Connection(self._transport, until=until, deliver=replica.apply, **self._options)
        # Find the variables again by name: a restarted robot might have other variables, in another order.
        database = database_of(connection.handshake)
        try:
            with replica.lock:
                bind(self, database, replica.lock)
                replica.adopt(database)
        except RemoteError:
            connection.abort()
            raise
        if self._closing.is_set():  # closed during connecting, so `close` could not close this connection
            connection.abort()
            raise Closed(f"{self._address} was closed")
        self._connection = connection
        self._access, self._width, self._received = connection.access, connection.width, connection.received
        self._connections += 1
        self._tell(ConnectionState.CONNECTED)
        return connection

    def _lose(self, replica: Replica, error: RemoteError) -> None:
        """Handle a lost connection, or a failed attempt to connect."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.abort()
            _log.info("%s: connection lost: %s", self._address, error)
        replica.give_up()  # before subscribers are notified: values that they set from then on will be sent
        self._tell(ConnectionState.LOST, error)

    def _tell(self, state: ConnectionState, error: Exception | None = None) -> None:
        with self._telling:
            if self._state is ConnectionState.CLOSED or (
                self._closing.is_set() and state is not ConnectionState.CLOSED
            ):
                return  # told already, or `close` interrupted this sync
            self._state = state
            self._subscribers.tell(ConnectionEvent(state, self._address, error, Stamp.now()))
