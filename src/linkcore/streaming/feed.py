"""Class `Feed`: the public interface to the packets of one class on a stream."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from .. import clock
from ..arguments import check_callable, check_seconds, element_of
from ..errors import BadValue, Closed, LinkTimeout
from ..names import Elsewhere, StrictAttributes
from ..pending_call import interruptible, pending_call
from ..wire.packet import State
from .connection import Connection
from .connection_life import ConnectionEvent, ConnectionState
from .history import History
from .packet_queue import PacketQueue, Policy, block, check_lifespan, check_policy, drop_oldest, latest
from .subscription import Subscription, check_deadline

if TYPE_CHECKING:
    from .plotting import Plot

T = TypeVar("T")

#: Maximum number of queued packets for a consumer that must examine every packet.
LAGGARD = 1024


class Feed(StrictAttributes, Generic[T]):
    """The packets of one class on a stream: iterate, subscribe, read the newest, or wait for the next.

    `Stream.of` returns a feed. A stream is itself the feed of its main class.
    """

    def __init__(self, connection: Connection, kind: type[T], *, lossless: bool = False, owner: object = None) -> None:
        self._connection = connection
        self._kind = kind
        self._lossless = lossless
        self._owner = owner  # prevents the garbage collection of the stream while one of its feeds exists

    def _hint(self, name: str) -> str | None:
        from inspect import getattr_static  # imported here: importing the library stays fast

        field = getattr_static(self._kind, name, None)
        own = field.own if isinstance(field, Elsewhere) else None if field is None else name
        return None if own is None else self._field_hint(own)

    def _field_hint(self, name: str) -> str:
        return f"; it is a field of the packets: use wait().{name} for the next packet, or latest.{name} for the newest"

    @property
    def latest(self) -> T | None:
        """Newest packet of the current connection, or None. Never blocks.

        It is None before the first packet arrives, and again after the connection is lost, so that old data is never
        shown as new. A finished recording keeps its last packet. If the stream has not connected yet, reading this
        property starts the connection.
        """
        self._connection.start_quietly()
        return self._connection.fan_out.newest(self._kind)

    def wait(self, timeout: float = 5.0) -> T:
        """Wait for the next packet, and return it.

        Args:
            timeout: Maximum wait in seconds.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
            LinkTimeout: If no packet arrives within `timeout` seconds.
            RemoteError: If the first connection cannot be made, or the stream has stopped reconnecting.
            LocalError: If called in an inline callback, where no packet could arrive.
            Closed: If the stream was closed.
        """
        timeout = check_seconds(timeout, "timeout")
        connection, kind = self._connection, self._kind
        connection.refuse_to_wait("wait()")
        queue = connection.open_queue(kind, latest)
        try:
            packet = _taking(queue)(timeout)
        finally:
            connection.close_queue(queue)
        if packet is None:
            raise self._why_nothing(timeout)
        return next(iter(connection.fan_out.expand(kind, packet)))

    def wait_until(self, condition: Callable[[T], object], timeout: float = 5.0) -> T:
        """Wait for a packet that meets a condition, and return it.

        The newest packet is examined first, then every packet as it arrives, all in this thread. If the condition is so
        slow that more than 1024 packets are queued, the oldest ones are dropped. For events (`State.IS_EVENT`), only
        events that arrive from now on are examined.

        Args:
            condition: Function that is called with each packet. An exception that it raises ends the wait.
            timeout: Maximum wait in seconds.

        Raises:
            BadValue: If `condition` is not callable, or `timeout` is not a number of seconds.
            LinkTimeout: If no packet meets the condition within `timeout` seconds; the message contains the number of
                examined packets.
            RemoteError, LocalError, Closed: See `wait`.
        """
        check_callable(condition, "condition")
        timeout = check_seconds(timeout, "timeout")
        end = clock.now() + timeout
        connection, kind = self._connection, self._kind
        connection.refuse_to_wait("wait_until()")
        queue = connection.open_queue(kind, drop_oldest(LAGGARD))
        take = _taking(queue)
        looked_at = 0
        try:
            # Read it after the queue was opened, so that no packet is missed. The same packet might come twice.
            newest = None if self._has_events else connection.fan_out.newest(kind)
            if newest is not None and condition(newest):
                return newest
            while (packet := take(clock.left(end))) is not None:
                for each in connection.fan_out.expand(kind, packet):
                    looked_at += 1
                    if condition(each):
                        return each
        finally:
            connection.close_queue(queue)
        raise self._why_none_of(looked_at, timeout)

    def iterate(
        self, policy: Policy | None = None, timeout: float | None = None, lifespan: float | None = None
    ) -> Iterator[T]:
        """Iterate over the packets with your own policy or timeout.

        A plain ``for`` keeps only the newest state, or 1024 events. `Stream.stats` counts the packets that a slow loop
        does not get, as `dropped`.

        The iteration ends when the stream is closed, or when a recording has ended. Without a timeout, it waits for a
        disconnected robot for as long as the back-off allows; a `ConnectionEvent` reports the disconnection.

        Args:
            policy: Behaviour when the loop falls behind. See `subscribe`.
            timeout: Maximum wait for each packet, in seconds.
            lifespan: See `subscribe`.

        Raises:
            BadValue: If `policy` is not a policy, or a time is not a number of seconds.
            LinkTimeout: If no packet arrives within `timeout` seconds.
            RemoteError: If the first connection cannot be made, or the stream has stopped reconnecting.
            LocalError: If called in an inline callback, where no packet could arrive.
        """
        policy = self._policy(policy, latest)
        if timeout is not None:
            timeout = check_seconds(timeout, "timeout")
        lifespan = check_lifespan(lifespan)
        self._connection.refuse_to_wait("iterating")
        return self._packets(policy, timeout, lifespan)

    def _packets(self, policy: Policy, timeout: float | None, lifespan: float | None) -> Generator[T, None, None]:
        connection, kind = self._connection, self._kind
        expand = connection.fan_out.expander(kind)
        queue = connection.open_queue(kind, policy, lifespan)
        take = _taking(queue)
        connection.counters.loop_began(queue)
        try:
            while True:
                packet = take(timeout)
                if packet is not None:
                    if expand is None:
                        yield packet
                    else:
                        yield from expand(packet)
                elif queue.is_over:
                    break
                elif timeout is not None:
                    raise self._why_nothing(timeout)
        finally:
            connection.close_queue(queue)
            connection.counters.loop_ended(queue)
        if connection.failure is not None:
            raise connection.failure

    def __iter__(self) -> Iterator[T]:
        return self.iterate()

    def subscribe(
        self,
        callback: Callable[[T], object],
        *,
        policy: Policy | None = None,
        lifespan: float | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
        inline: bool = False,
    ) -> Subscription:
        """Call `callback` with each packet, in order and one at a time, until the subscription is closed.

        Each subscription has its own queue and its own thread. So a callback may be slow, and may raise, without
        causing another subscriber to lose a packet. With ``inline=True``, the thread that reads the stream makes the
        call, so that no other thread has to be woken. Such a callback must be quick: until it returns, nothing is read,
        and no other subscriber of this stream gets a packet. Calls of more than 0.5 ms are counted in `Stream.stats`.

        Args:
            callback: Function that is called with each packet.
            policy: Behaviour when the callback falls behind: `latest`, `drop_oldest(n)` or `block`; default
                `drop_oldest(256)`, and `drop_oldest(1024)` for events. Not allowed for an inline callback, which has no
                queue.
            lifespan: Maximum age of a packet in seconds after its arrival; None for no limit. If a packet is older than
                this when it would be delivered, it is dropped and counted as `expired`. Not allowed for an inline
                callback.
            deadline: Maximum time between two packets, in seconds.
            on_deadline: Function that is called with the seconds since the last packet, once for each time that exceeds
                `deadline`; by default a warning is logged. For an inline callback it is called in a dedicated thread.
            inline: Whether to make the calls in the thread that reads the stream.

        Raises:
            BadValue: If an argument is invalid.
            RemoteError: If the first connection cannot be made.
            LocalError: If the system has no thread left.
            Closed: If the stream was closed.
        """
        check_callable(callback, "callback")
        deadline = check_deadline(deadline, on_deadline)
        lifespan = check_lifespan(lifespan)
        connection, kind, owner = self._connection, self._kind, self._owner
        if inline:
            if policy is not None or lifespan is not None:
                raise BadValue("inline=True delivers without a queue, so it cannot be combined with policy or lifespan")
            return connection.subscribe_inline(kind, callback, deadline=deadline, on_deadline=on_deadline, owner=owner)
        policy = self._policy(policy, drop_oldest(256))
        return connection.subscribe(
            kind, callback, policy=policy, lifespan=lifespan, deadline=deadline, on_deadline=on_deadline, owner=owner
        )

    def history(self, seconds: float) -> History:
        """Start to keep the states of the last seconds, which can be read as arrays.

        Args:
            seconds: Time for which each state is kept, in s. A state takes about a kilobyte of memory.

        Raises:
            BadValue: If `seconds` is not a positive number, or if the class of the packets has no fields.
            RemoteError, LocalError, Closed: See `subscribe`.
        """
        seconds = check_seconds(seconds, "seconds", positive=True, finite=True)
        if not (issubclass(self._kind, State) and self._kind.FIELDS):
            raise BadValue(f"{self._kind.__name__} has no fields to keep; select one of its parts with of()")
        return History(self._kind, seconds, lambda keep: self.subscribe(keep, inline=True))

    def plot(self, *fields: str, seconds: float = 10.0, window: float = 10.0, period: float = 0.2) -> None:
        """Plot fields while they arrive, below the cell of a notebook or in a window.

        Returns after `seconds`.

        Args:
            fields: Names of the fields. Each has its own panel, and a vector has a line for each element.
            seconds: Duration in seconds, counted from the connection. The last plot shows every state of the window.
            window: Length of the time axis in seconds, with the newest state on the right.
            period: Interval between two plots, in seconds.

        Raises:
            BadValue: If no field is given, a field does not exist or is not numeric, or a time is not a number of
                seconds.
            LocalError: If matplotlib is not installed; the message has the command that installs it.
            LinkTimeout: If no state arrives within `seconds`.
            RemoteError, LocalError, Closed: See `subscribe`.
        """
        from .plotting import SHORTEST, LivePlot  # imported here: importing the library stays fast

        seconds = check_seconds(seconds, "seconds", positive=True, finite=True)
        period = check_seconds(period, "period", positive=True, finite=True)
        live = LivePlot()
        try:
            with self.history(window) as history:
                end = clock.now() + seconds
                for picture in self._pictures(history, fields, end):
                    if picture is None:
                        self.wait(clock.left(end))
                    else:
                        live.update(picture, min(period, max(end - clock.now(), SHORTEST)))
                if not len(history):
                    raise self._why_nothing(seconds)
        finally:
            live.close()

    def _pictures(self, history: History, fields: Sequence[str], end: float) -> Iterator[Plot | None]:
        """Yield the next plot until the monotonic time `end`, in s.

        Yield None if nothing has arrived yet. The last plot is made after `end`. It shows every state, even if drawing
        takes longer than receiving.
        """
        from .plotting import Curves, Plot

        units = {name: field.unit for name, field in getattr(self._kind, "FIELDS", {}).items()}
        is_over = False
        while not is_over:
            is_over = clock.now() >= end
            states = history.array(*fields)
            if len(states):
                when = states["received"] - clock.now()  # after the last state has been received
                curves = [
                    Curves(name, units.get(name) or units.get((element_of(name) or ("",))[0], ""), when, states[name])
                    for name in fields
                ]
                yield Plot(curves, self._connection.name)
            elif not is_over:
                yield None

    def _policy(self, policy: Policy | None, for_states: Policy) -> Policy:
        """Return `policy`, or a default that keeps events and replaces states by newer ones."""
        if policy is not None:
            return check_policy(policy)
        if self._lossless:
            return block
        return drop_oldest(LAGGARD) if self._has_events else for_states

    @property
    def _has_events(self) -> bool:
        """Whether the packets are events, each of which occurs once, and not samples of a continuous quantity."""
        return bool(getattr(self._kind, "IS_EVENT", self._kind is ConnectionEvent))

    def _why_nothing(self, timeout: float) -> Exception:
        """Return the error for a wait in which nothing arrived within `timeout` seconds."""
        connection = self._connection
        if connection.failure is not None:
            return connection.failure
        if connection.is_over:
            return Closed(f"{connection.name} was closed, or has ended")
        because = ""
        if connection.state is not ConnectionState.CONNECTED and connection.error is not None:
            because = f"; it is not connected: {connection.error}"
        return LinkTimeout(f"no {self._kind.__name__} from {connection.name} within {timeout:g} s{because}")

    def _why_none_of(self, looked_at: int, timeout: float) -> Exception:
        """Return the error for a wait in which none of `looked_at` packets met the condition."""
        connection = self._connection
        if looked_at and connection.failure is None and not connection.is_over:
            what = f"{looked_at} {self._kind.__name__} from {connection.name}"
            return LinkTimeout(f"no packet met the condition within {timeout:g} s; examined {what}")
        return self._why_nothing(timeout)

    def __repr__(self) -> str:
        return f"<Feed of {self._kind.__name__} from {self._connection.name}>"


def _taking(queue: PacketQueue) -> Callable[[float | None], Any]:
    """Return `queue.next`.

    If this thread is making a pending call, abandoning the call ends the wait.
    """
    if pending_call() is None:
        return queue.next

    def take(timeout: float | None) -> Any:
        with interruptible(queue.end):
            return queue.next(timeout)

    return take
