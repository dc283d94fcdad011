"""A session with a robot: its messages, and the commands of its master.

A robot obeys commands of any client, and keeps the ID of one master. The first message ``alive ID`` makes its sender
the master. The robot answers each further ``alive`` with the ID of its master. A client that reads the ID of another
client must end, and sends nothing more, not even a stop: the other client drives the robot.

The robot of 2025 stops about 2 s after the last ``alive`` (log). The robot of 2026 does not stop (its source), so last
wills are needed. MQTT has one last will for each connection, and a master sends two commands at its end, ``rc 0 0`` and
``stop``. Therefore a master has two connections for commands, each with one of them as its last will. Each of the two
commands alone stops the wheels (log), so one lost connection or one lost message is not a danger.

The dialect must be known before these connections are opened, because it determines the last wills. It is recognised by
the answer to ``alive``: the session sends ``alive`` in both dialects, with another ID in each of them. A robot ignores
the command of the other dialect, and answers with the ID that it has understood.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from datetime import datetime, timedelta

from linkcore import clock
from linkcore.arguments import check_seconds
from linkcore.errors import BadValue, Closed, ConnectFailed, ConnectionLost, LinkError, LinkTimeout, LocalError
from linkcore.threads import ReentrantEvent, started

from ..address import MqttAddress
from ..errors import AccessDenied
from .broker import BrokerConnection
from .commands import DIALECTS, STANDSTILL, Command, Dialect, alive, find_dialect, new_identity, stop
from .topics import DRIVE, Message, decode

_log = logging.getLogger(__name__)

#: Seconds between two messages ``alive``, as in the course's client of 2026.
ALIVE_PERIOD = 0.5
#: Seconds between two attempts to become the master, and maximum time for all attempts. A robot answers the second
#: attempt within milliseconds.
_ATTEMPT, _CLAIM_TIMEOUT = 0.1, 2.0
#: Maximum wait for the session's own thread at the end, in s.
_CLOSE_TIMEOUT = 2.0


class RobotSession:
    """A session with a robot.

    Args:
        address: Address of the broker, and the dialect of the robot if it is known.
        on_message: Function that gets each decoded message, in the thread of paho-mqtt.
        timeout: Maximum time until the broker has accepted the connection, in seconds.
        silence: Seconds without a message of the robot after which it counts as lost.

    Attributes:
        address: See the argument `address`.
        dialect: Dialect of the robot; None if it is not known.
        identity: ID of this client; "" until it is the master.
        received: Number of messages with a known topic.
        bad: Number of these messages that could not be decoded.
        failure: Error that ended the session; None while it is running.

    Raises:
        BadValue: If an argument is not valid.
        LocalError, ConnectFailed, LinkTimeout: If connecting fails; see `BrokerConnection`.
    """

    def __init__(
        self,
        address: MqttAddress,
        on_message: Callable[[Message], object],
        *,
        timeout: float = 5.0,
        silence: float = 5.0,
    ) -> None:
        self.address = address
        self.dialect = None if address.dialect is None else find_dialect(address.dialect)
        self.identity = ""
        self.received = self.bad = 0
        self.failure: LinkError | None = None
        self._on_message = on_message
        self._silence = check_seconds(silence, "silence", positive=True)
        self._lock = threading.RLock()
        self._closing = ReentrantEvent()
        self._has_message = ReentrantEvent()
        self._has_heartbeat = ReentrantEvent()
        self._has_answer = ReentrantEvent()
        self._master = ""
        self._repeated: Command | None = None
        self._drivers: list[BrokerConnection] = []
        self._thread: threading.Thread | None = None
        self._last = clock.now()
        self._receiver = BrokerConnection(
            address,
            check_seconds(timeout, "timeout", positive=True, finite=True),
            topics=(f"{DRIVE}#",),
            on_message=self._take,
            on_lost=self._lose,
        )

    # -- messages --------------------------------------------------------------------------------------

    def wait_for_robot(self, timeout: float) -> None:
        """Wait for the first message of the robot.

        Raises:
            ConnectFailed: If none arrives within `timeout` seconds.
        """
        if not clock.wait(self._has_message.wait, timeout):
            raise ConnectFailed(
                f"{self.address}: there is a broker, but no robot has published on {DRIVE}# within {timeout:.1f} s; "
                "is teensy_interface running?"
            )

    def wait_for_values(self, timeout: float) -> None:
        """Wait for a heartbeat, which is the rarest message of a robot that a program might read at once.

        Return after `timeout` seconds, because a robot might not publish it.
        """
        clock.wait(self._has_heartbeat.wait, timeout)

    def check(self) -> None:
        """Raise the error that ended the session, if there is one.

        Raises:
            AccessDenied: If another client drives the robot.
            ConnectionLost: If the broker is lost, or the robot is silent.
            Closed: If the session was closed.
        """
        if self.failure is None and clock.now() - self._last > self._silence:
            self._fail(ConnectionLost(f"{self.address}: the robot has sent no message for {self._silence:g} s"))
        if self.failure is not None:
            raise self.failure
        if self._closing.is_set():
            raise Closed(f"{self.address} was closed")

    def _take(self, topic: str, payload: bytes, is_retained: bool) -> None:
        try:
            message = decode(topic, payload)
        except BadValue as error:
            self.received += 1
            self.bad += 1
            if self.bad == 1:  # once, because a robot might send hundreds of them in each second
                _log.warning("%s", error)
            return
        self._last = clock.now()
        self._has_message.set()
        if message is None:
            return
        self.received += 1
        if message.topic == "master" and not is_retained:
            self._take_master(message.values["master"])
        try:
            self._on_message(message)
        except Exception:  # paho would end its thread
            _log.exception("%s: a message could not be processed", self.address)
        if message.topic == "T0/hbt":
            self._has_heartbeat.set()

    def _take_master(self, identity: str) -> None:
        with self._lock:
            if not self.identity:
                self._master = identity
                self._has_answer.set()
                return
            if identity.startswith(self.identity):
                return
            self._fail(self._denied(identity))
        # Otherwise the broker would publish the last wills if this process is killed later. Not within the block,
        # because the threads of these connections might wait for the lock.
        for connection in self._drivers:
            connection.close()

    def _denied(self, identity: str) -> AccessDenied:
        return AccessDenied(
            f"{self.address}: another client drives the robot: its master is {identity!r}; this client has stopped "
            "sending commands"
        )

    # -- commands --------------------------------------------------------------------------------------

    @property
    def is_master(self) -> bool:
        """Whether this client is the master of the robot."""
        return bool(self.identity) and self.failure is None

    def drive(self, timeout: float) -> None:
        """Become the master of the robot within `timeout` seconds, stop it, and request its measurements.

        Raises:
            AccessDenied: If another client is the master.
            LinkTimeout: If the robot does not answer.
            ConnectFailed, ConnectionLost: If the broker is lost.
        """
        until = clock.now() + timeout
        self.dialect, self.identity = self._claim(min(until, clock.now() + _CLAIM_TIMEOUT))
        for command in (STANDSTILL, stop()):
            will = self.dialect.encode(command)
            self._drivers.append(BrokerConnection(self.address, clock.left(until), will=will, on_lost=self._lose))
        # Values from the previous master must not move the robot.
        for command in (STANDSTILL, *self.dialect.requests):
            self.send(command)
        self._thread = started(threading.Thread(target=self._keep, name=f"{self.address} alive", daemon=True))

    def _claim(self, until: float) -> tuple[Dialect, str]:
        dialects = [self.dialect] if self.dialect is not None else [DIALECTS["2026"], DIALECTS["2025"]]
        # A robot compares IDs only up to the length of the new one, so all of them have the same length.
        began = datetime.fromisoformat(new_identity())
        claimed = {
            (began + timedelta(microseconds=number)).isoformat(sep=" ", timespec="microseconds"): dialect
            for number, dialect in enumerate(dialects)
        }
        self._has_answer.clear()  # of another master, before this claim
        while not self._has_answer.is_set():
            if clock.now() >= until:
                names = " or ".join(dialect.name for dialect in dialects)
                raise LinkTimeout(f"{self.address}: the robot does not answer alive messages of the dialect {names}")
            for identity, dialect in claimed.items():
                self._receiver.publish(*dialect.encode(alive(identity)))
            clock.wait(self._has_answer.wait, min(_ATTEMPT, clock.left(until)))
        for identity, dialect in claimed.items():
            # A robot might append the end of a longer ID that it had before.
            if self._master.startswith(identity):
                return dialect, identity
        raise self._denied(self._master)

    def send(self, command: Command) -> None:
        """Send a command to the robot.

        Raises:
            LocalError: If this client is not the master.
            AccessDenied, ConnectionLost: See `check`.
        """
        if self.dialect is None or not self._drivers:
            raise LocalError(f"{self.address}: only the master can send commands; connect with access='w'")
        with self._lock:
            self.check()
            if command.keyword == STANDSTILL.keyword:
                self._repeated = command
            elif command == stop():
                self._repeated = None
            self._drivers[0].publish(*self.dialect.encode(command))

    def _keep(self) -> None:
        """Send ``alive`` until the end, and repeat the newest velocity, because messages can be lost."""
        due = clock.now()
        while not clock.wait(self._closing.wait, clock.left(due)):
            due = max(due + ALIVE_PERIOD, clock.now())
            with contextlib.suppress(LinkError), self._lock:
                self.send(alive(self.identity))
                if self._repeated not in (None, STANDSTILL):
                    assert self._repeated is not None
                    self.send(self._repeated)

    # -- the end ---------------------------------------------------------------------------------------

    def _lose(self, reason: str) -> None:
        self._fail(ConnectionLost(f"{self.address}: the connection to the broker was lost: {reason}"))

    def _fail(self, error: LinkError) -> None:
        with self._lock:
            if self.failure is None and not self._closing.is_set():
                self._stop_robot(error)
                self.failure = error
                _log.warning("%s", error)

    def _stop_robot(self, error: LinkError | None) -> None:
        """Send the commands of the end, unless another client drives the robot."""
        if self.dialect is None or not self.identity or isinstance(error, AccessDenied):
            return
        for connection in self._drivers:
            with contextlib.suppress(ConnectionLost):
                for command in (STANDSTILL, stop()):
                    connection.publish(*self.dialect.encode(command))
                return  # the other connection is needed only if this one is lost

    def close(self) -> None:
        """Stop the robot if this client is its master, and disconnect. Idempotent, from any thread."""
        with self._lock:
            is_first = not self._closing.is_set()
            self._closing.set()
            if is_first and self.failure is None:
                self._stop_robot(None)
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            clock.join(thread, _CLOSE_TIMEOUT)
        for connection in (*self._drivers, self._receiver):
            connection.close()
