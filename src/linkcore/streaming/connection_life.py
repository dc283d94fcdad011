"""State machine of a connection: phases, events, and the states that subscribers get. It uses no sockets (sans-IO).

`TRANSITIONS` contains all transitions; docs/architecture.md shows the table. An event that is not in the table raises
an error, so that a defect in a reader is found immediately. `ConnectionLife` also decides whether to reconnect, and
after how many seconds.

Subscribers get a `ConnectionEvent` for each change. Recorders also get the received bytes. `Backoff` defines the waits
before the next tries.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from ..arguments import check_seconds
from ..clock import Stamp
from ..errors import BadValue, WrongPeer, unraised
from ..names import StrictAttributes


class ConnectionState(enum.Enum):
    """State of the connection of a stream."""

    IDLE = "idle"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    LOST = "lost"
    CLOSED = "closed"


class ConnectionEvent(NamedTuple):
    """Change of the connection of a stream. You can subscribe to this class as to a class of packets.

    Attributes:
        state: New state.
        stream: Name of the stream.
        error: Error that ended the connection, or None.
        received: Time at which the change was noticed.
    """

    state: ConnectionState
    stream: str
    error: Exception | None
    received: Stamp


class Traffic(StrictAttributes):
    """Class for subscriptions: a subscriber to this class gets every `Chunk` and every `ConnectionEvent`, in order."""

    IS_EVENT = True


class Chunk(NamedTuple):
    """Received bytes, and the time of their arrival."""

    data: bytes
    received: Stamp


@dataclass(frozen=True)
class Backoff:
    """Waits before the attempts to reconnect. They grow exponentially up to a maximum.

    The jitter prevents many clients from reconnecting at the same time.

    Attributes:
        first: Wait before the first try, in seconds.
        factor: Growth of the wait from try to try.
        most: Maximum wait, in seconds.
        jitter: Fraction by which each wait is changed at random, 0 to 1.
        tries: Maximum number of tries; None for no limit, 0 for no try.

    Raises:
        BadValue: If a time is not a number of seconds, `factor` is below 1, `jitter` is outside 0 to 1, or `tries` is
            negative.
    """

    first: float = 0.1
    factor: float = 2.0
    most: float = 5.0
    jitter: float = 0.2
    tries: int | None = None

    def __post_init__(self) -> None:
        check_seconds(self.first, "first")
        check_seconds(self.most, "most")
        if not (self.factor >= 1 and 0 <= self.jitter <= 1 and (self.tries is None or self.tries >= 0)):
            raise BadValue(f"{self}; expected a factor of at least 1, a jitter from 0 to 1, and 0 or more tries")

    def waits(self) -> Iterator[float]:
        """Yield the seconds to wait before each try; end after the last try.

        >>> list(Backoff(first=0.1, most=0.3, jitter=0, tries=4).waits())
        [0.1, 0.2, 0.3, 0.3]
        """
        # Imported here, because it also imports hashlib, and importing the library must stay fast.
        import random

        wait, done = self.first, 0
        while self.tries is None or done < self.tries:
            yield min(wait * (1 + random.uniform(-self.jitter, self.jitter)), self.most)
            wait = min(wait * self.factor, self.most)
            done += 1


class ConnectionPhase(enum.Enum):
    """Phase of a connection. `STATES` contains the state that users get in each phase."""

    IDLE = "idle"  # it was never used, or the last reader gave up; the next use starts a new reader
    STARTING = "starting"  # its reader is being started
    CONNECTING = "connecting"
    CONNECTED = "connected"
    WAITING = "waiting"  # it waits until the next try
    GIVING_UP = "giving up"  # its subscriptions are ending with an error
    FINISHING = "finishing"  # the last packet of a recording has been read, and its subscriptions are ending
    OVER = "over"  # the last packet of a recording has been read, and its subscriptions have ended
    CLOSING = "closing"  # it was closed, but the reader has not ended yet
    CLOSED = "closed"


class LifeEvent(enum.Enum):
    """Event in the life of a connection."""

    USE = "use"  # a caller wants to receive packets, or to send
    CONNECT = "connect"  # the reader starts to connect
    OPEN = "open"  # it is connected
    LOSE = "lose"  # it was lost, or connecting failed
    GIVE_UP = "give up"  # the reader does not try again
    FINISH = "finish"  # the peer has no more packets, or it was closed
    CLOSE = "close"  # the program closes it
    REST = "rest"  # the reader has ended, or could not be started


#: Phase -> the state that users see.
STATES: Mapping[ConnectionPhase, ConnectionState] = MappingProxyType(
    {
        ConnectionPhase.IDLE: ConnectionState.IDLE,
        ConnectionPhase.STARTING: ConnectionState.IDLE,
        ConnectionPhase.CONNECTING: ConnectionState.CONNECTING,
        ConnectionPhase.CONNECTED: ConnectionState.CONNECTED,
        ConnectionPhase.WAITING: ConnectionState.LOST,
        ConnectionPhase.GIVING_UP: ConnectionState.IDLE,
        ConnectionPhase.FINISHING: ConnectionState.CLOSED,
        ConnectionPhase.OVER: ConnectionState.CLOSED,
        ConnectionPhase.CLOSING: ConnectionState.CLOSED,
        ConnectionPhase.CLOSED: ConnectionState.CLOSED,
    }
)

_READING = (ConnectionPhase.STARTING, ConnectionPhase.CONNECTING, ConnectionPhase.CONNECTED, ConnectionPhase.WAITING)
_ENDING = (*_READING, ConnectionPhase.GIVING_UP, ConnectionPhase.FINISHING)

_Cause = tuple[ConnectionPhase, LifeEvent]
_Effect = tuple[ConnectionPhase, ConnectionState | None]

#: (phase, event) -> the next phase, and the state that subscribers get, or None.
TRANSITIONS: Mapping[_Cause, _Effect] = MappingProxyType(
    {
        (ConnectionPhase.IDLE, LifeEvent.USE): (ConnectionPhase.STARTING, None),
        (ConnectionPhase.STARTING, LifeEvent.REST): (ConnectionPhase.IDLE, None),
        (ConnectionPhase.STARTING, LifeEvent.CONNECT): (ConnectionPhase.CONNECTING, ConnectionState.CONNECTING),
        (ConnectionPhase.WAITING, LifeEvent.CONNECT): (ConnectionPhase.CONNECTING, ConnectionState.CONNECTING),
        (ConnectionPhase.CONNECTING, LifeEvent.OPEN): (ConnectionPhase.CONNECTED, ConnectionState.CONNECTED),
        (ConnectionPhase.CONNECTING, LifeEvent.LOSE): (ConnectionPhase.WAITING, ConnectionState.LOST),
        (ConnectionPhase.CONNECTED, LifeEvent.LOSE): (ConnectionPhase.WAITING, ConnectionState.LOST),
        **{(phase, LifeEvent.GIVE_UP): (ConnectionPhase.GIVING_UP, ConnectionState.IDLE) for phase in _READING},
        **{(phase, LifeEvent.FINISH): (ConnectionPhase.FINISHING, ConnectionState.CLOSED) for phase in _READING},
        (ConnectionPhase.GIVING_UP, LifeEvent.REST): (ConnectionPhase.IDLE, None),
        (ConnectionPhase.FINISHING, LifeEvent.REST): (ConnectionPhase.OVER, None),
        # The program may close it in any phase. The reader continues until it notices this.
        (ConnectionPhase.IDLE, LifeEvent.CLOSE): (ConnectionPhase.CLOSED, None),
        (ConnectionPhase.OVER, LifeEvent.CLOSE): (ConnectionPhase.CLOSED, None),
        **{(phase, LifeEvent.CLOSE): (ConnectionPhase.CLOSING, None) for phase in _ENDING},
        (ConnectionPhase.CLOSING, LifeEvent.CLOSE): (ConnectionPhase.CLOSING, None),
        (ConnectionPhase.CLOSING, LifeEvent.CONNECT): (ConnectionPhase.CLOSING, None),
        (ConnectionPhase.CLOSING, LifeEvent.OPEN): (ConnectionPhase.CLOSING, None),
        (ConnectionPhase.CLOSING, LifeEvent.LOSE): (ConnectionPhase.CLOSING, ConnectionState.LOST),
        (ConnectionPhase.CLOSING, LifeEvent.GIVE_UP): (ConnectionPhase.CLOSING, ConnectionState.CLOSED),
        (ConnectionPhase.CLOSING, LifeEvent.FINISH): (ConnectionPhase.CLOSING, ConnectionState.CLOSED),
        (ConnectionPhase.CLOSING, LifeEvent.REST): (ConnectionPhase.CLOSED, None),
        (ConnectionPhase.CLOSED, LifeEvent.CLOSE): (ConnectionPhase.CLOSED, None),
    }
)


class Attempt:
    """Result of the first connection of a reader.

    Each reader has its own attempt, because the next one might start immediately after a failure.

    Attributes:
        is_patient: Whether no caller waits for the connection, so that a failure is retried.
        is_settled: Whether the outcome is known: the connection was made and subscribers were notified, or it cannot be
            made.
        has_opened: Whether the connection was made.
        failure: Error that prevented the connection, or None.
    """

    def __init__(self, is_patient: bool) -> None:
        self.is_patient = is_patient
        self.is_settled = self.has_opened = False
        self.failure: Exception | None = None


class ConnectionLife:
    """Life of one connection: its phase, and the times of the attempts to reconnect.

    Args:
        name: Name, used in messages.
        backoff: Waits between the attempts to reconnect.

    Attributes:
        phase: Current phase.
        attempt: First connection of the current reader, or of the last one.
        failure: Error that ended it; None if it was closed on purpose.
        error: Error that ended the last connection, or the last attempt to connect.
    """

    def __init__(self, name: str, backoff: Backoff) -> None:
        self.phase = ConnectionPhase.IDLE
        self.attempt = Attempt(is_patient=False)
        self.failure: Exception | None = None
        self.error: Exception | None = None
        self._name = name
        self._events = 0  # number of recorded events
        self._backoff = backoff
        self._waits = backoff.waits()
        self._received = 0  # number of packets before the current try

    @property
    def is_ending(self) -> bool:
        """Whether its subscriptions are ending, so that a new subscription belongs to the next reader."""
        return self.phase in (ConnectionPhase.GIVING_UP, ConnectionPhase.FINISHING)

    @property
    def is_closed(self) -> bool:
        """Whether the program has closed it."""
        return self.phase in (ConnectionPhase.CLOSING, ConnectionPhase.CLOSED)

    @property
    def is_over(self) -> bool:
        """Whether no packet will ever arrive again."""
        return self.is_closed or self.phase in (ConnectionPhase.FINISHING, ConnectionPhase.OVER)

    def fire(self, event: LifeEvent) -> ConnectionState | None:
        """Record an event; return the state that subscribers must get, or None.

        Raises:
            RuntimeError: If the event cannot happen in this phase.
        """
        effect = self._record(event)
        if effect is None:
            raise RuntimeError(f"{self._name}: {event.value!r} cannot happen while it is {self.phase.value}")
        return effect[1]

    def _record(self, event: LifeEvent) -> _Effect | None:
        """Record an event, and return its effect; None if the event cannot happen in this phase."""
        is_recorded = False
        while not is_recorded:
            events = self._events
            effect = TRANSITIONS.get((self.phase, event))
            if effect is None:
                return None
            # A signal handler might have recorded an event between these lines. Then this event follows it.
            new = (effect[0], events + 1, True)
            self.phase, self._events, is_recorded = new if self._events == events else (self.phase, self._events, False)
        return effect

    def use(self, is_patient: bool, received: int) -> bool:
        """Start the life of a new reader. Return False if there is a reader, or if the connection was closed.

        Args:
            is_patient: Whether no caller waits for its first connection. See `Attempt`.
            received: Number of packets received so far.
        """
        if self._record(LifeEvent.USE) is None:
            return False
        self.failure = self.error = None
        self.attempt = Attempt(is_patient)
        self._waits = self._backoff.waits()
        self._received = received
        return True

    def end(self, failure: Exception | None) -> ConnectionState | None:
        """Record that the reader ends; return the state that subscribers must get, or None.

        Args:
            failure: Error that ended it; None if the peer has no more packets, or if the connection was closed here.
        """
        self.failure = failure
        if not self.attempt.has_opened:
            self.attempt.failure = failure
        return self.fire(LifeEvent.FINISH if failure is None else LifeEvent.GIVE_UP)

    def lose(self, error: Exception | None) -> ConnectionState | None:
        """Record that a connection has ended, or could not be made.

        Return the state that subscribers must get.
        """
        self.error = None if error is None else unraised(error)
        return self.fire(LifeEvent.LOSE)

    def retry_after(self, received: int) -> float | None:
        """Return the seconds until the next try; None if there is no next try.

        Args:
            received: Number of packets received so far.
        """
        never_was_the_right_one = isinstance(self.error, WrongPeer) and not received
        if never_was_the_right_one or not (self.attempt.has_opened or self.attempt.is_patient):
            return None
        if received > self._received:
            self._received = received
            self._waits = self._backoff.waits()  # received packets reset the waits, but a connection alone does not
        return next(self._waits, None)
