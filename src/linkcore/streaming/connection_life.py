"""The life of a connection: what it is doing, what can happen next, and which state its subscribers get. Sans-IO.

`TRANSITIONS` is the whole of it; docs/architecture.md shows the table. What is not in the table cannot happen: it
raises, so that a mistake in what reads the connection is seen where it is made. `ConnectionLife` adds what decides
between the events: whether to try again, and after how long.

Subscribers get `ConnectionEvent`, and recorders the bytes as they were received too. `Backoff` says how long to wait
before trying again.
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
    """What a stream's connection is doing."""

    IDLE = "idle"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    LOST = "lost"
    CLOSED = "closed"


class ConnectionEvent(NamedTuple):
    """A change of a stream's connection; subscribe to it as to a packet.

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
    """Base class of `Chunk` and `ConnectionEvent`: a subscription to it gets both, in order."""

    IS_EVENT = True


class Chunk(NamedTuple):
    """Bytes as they came, and when."""

    data: bytes
    received: Stamp


@dataclass(frozen=True)
class Backoff:
    """Exponential, bounded, with jitter so that many clients do not come back in step.

    Attributes:
        first: Wait before the first try, in seconds.
        factor: Growth of the wait from try to try.
        most: Maximum wait, in seconds.
        jitter: Share by which each wait is varied at random, 0 to 1.
        tries: Maximum number of tries; None for no limit, 0 for no try.

    Raises:
        BadValue: a time that is not a number of seconds, a factor below 1, a jitter outside 0 to 1, or tries that are
            not a number.
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
            raise BadValue(f"{self}; expected a factor of at least 1, a jitter from 0 to 1, and no tries below 0")

    def waits(self) -> Iterator[float]:
        """Seconds to wait before each try; ends when it is time to give up.

        >>> list(Backoff(first=0.1, most=0.3, jitter=0, tries=4).waits())
        [0.1, 0.2, 0.3, 0.3]
        """
        # Imported here: it brings hashlib with it, and importing the library stays cheap.
        import random

        wait, done = self.first, 0
        while self.tries is None or done < self.tries:
            yield min(wait * (1 + random.uniform(-self.jitter, self.jitter)), self.most)
            wait = min(wait * self.factor, self.most)
            done += 1


class ConnectionPhase(enum.Enum):
    """What a connection is doing."""

    IDLE = "idle"  # nothing has used it, or it was given up: the next use begins anew
    STARTING = "starting"  # its reader has been asked for
    CONNECTING = "connecting"
    CONNECTED = "connected"
    WAITING = "waiting"  # until the next try
    GIVING_UP = "giving up"  # its subscriptions end with an error
    FINISHING = "finishing"  # its subscriptions end: the last packet of a recording has been read
    OVER = "over"  # it has been
    CLOSING = "closing"  # closed here; the reader has not ended yet
    CLOSED = "closed"


class LifeEvent(enum.Enum):
    """What can happen to it."""

    USE = "use"  # somebody wants packets, or to send
    CONNECT = "connect"
    OPEN = "open"
    LOSE = "lose"  # it is lost, or could not be made
    GIVE_UP = "give up"
    FINISH = "finish"
    CLOSE = "close"
    REST = "rest"  # the reader has ended, or could not be started


#: What users see of each phase.
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

#: (phase, event) -> the phase after it, and the state that subscribers get.
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
        # Closed here, at any time. The reader goes on until it notices.
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
    """How the first connection of a reader goes. Each has its own: as soon as one has failed, another may begin.

    Attributes:
        is_patient: nobody waits for it, so a failure is retried.
        is_settled: it was made and subscribers were notified, or it cannot be made.
        has_opened: it was made.
        failure: why it could not be made.
    """

    def __init__(self, is_patient: bool) -> None:
        self.is_patient = is_patient
        self.is_settled = self.has_opened = False
        self.failure: Exception | None = None


class ConnectionLife:
    """What one connection is doing, and when it is tried again.

    Args:
        name: for messages.
        backoff: how to connect again.

    Attributes:
        phase: what it is doing.
        attempt: the first connection of the present reader, or of the last one.
        failure: what ended it, where it was not closed on purpose.
        error: what ended the last connection, or kept the next one from being made.
    """

    def __init__(self, name: str, backoff: Backoff) -> None:
        self.phase = ConnectionPhase.IDLE
        self.attempt = Attempt(is_patient=False)
        self.failure: Exception | None = None
        self.error: Exception | None = None
        self._name = name
        self._backoff = backoff
        self._waits = backoff.waits()
        self._received = 0  # packets, at the try before this one

    @property
    def is_ending(self) -> bool:
        """Its subscriptions are being ended: one that begins now belongs to the next reader."""
        return self.phase in (ConnectionPhase.GIVING_UP, ConnectionPhase.FINISHING)

    @property
    def is_closed(self) -> bool:
        """It was closed here."""
        return self.phase in (ConnectionPhase.CLOSING, ConnectionPhase.CLOSED)

    @property
    def is_over(self) -> bool:
        """No packet will ever come again."""
        return self.is_closed or self.phase in (ConnectionPhase.FINISHING, ConnectionPhase.OVER)

    def fire(self, event: LifeEvent) -> ConnectionState | None:
        """Something has happened: the state that subscribers are to get, if any.

        Raises:
            RuntimeError: it cannot happen now.
        """
        after = TRANSITIONS.get((self.phase, event))
        if after is None:
            raise RuntimeError(f"{self._name}: {event.value!r} cannot happen while it is {self.phase.value}")
        self.phase, news = after
        return news

    def use(self, is_patient: bool, received: int) -> None:
        """Begin with a new reader; with `is_patient` nobody waits for its first connection.

        Args:
            is_patient: as of `Attempt`.
            received: packets until now.
        """
        self.fire(LifeEvent.USE)
        self.failure = self.error = None
        self.attempt = Attempt(is_patient)
        self._waits = self._backoff.waits()
        self._received = received

    def end(self, failure: Exception | None) -> ConnectionState | None:
        """The reader ends: the state that subscribers are to get.

        Args:
            failure: why; None where the peer has no more, or the connection was closed here.
        """
        self.failure = failure
        if not self.attempt.has_opened:
            self.attempt.failure = failure
        return self.fire(LifeEvent.FINISH if failure is None else LifeEvent.GIVE_UP)

    def lose(self, error: Exception | None) -> ConnectionState | None:
        """A connection has ended, or could not be made: the state that subscribers are to get."""
        self.error = None if error is None else unraised(error)
        return self.fire(LifeEvent.LOSE)

    def retry_after(self, received: int) -> float | None:
        """Seconds until the next try; None where there is none.

        Args:
            received: packets until now.
        """
        never_was_the_right_one = isinstance(self.error, WrongPeer) and not received
        if never_was_the_right_one or not (self.attempt.has_opened or self.attempt.is_patient):
            return None
        if received > self._received:
            self._received = received
            self._waits = self._backoff.waits()  # reset by success: by packets, not by a mere connection
        return next(self._waits, None)
