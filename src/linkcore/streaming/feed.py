"""`Feed`: the packets of one class on a stream, for users."""

from __future__ import annotations

import contextlib
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
    from ..plotting import Plot

T = TypeVar("T")

#: Packets that may wait for a consumer that has to look at every one.
LAGGARD = 1024


class Feed(StrictAttributes, Generic[T]):
    """The packets of one class on a stream: iterate, subscribe, look at the newest, wait for the next.

    Made by `Stream.of`; a stream is the feed of its main class.
    """

    def __init__(self, connection: Connection, kind: type[T], *, lossless: bool = False, owner: object = None) -> None:
        self._connection = connection
        self._kind = kind
        self._lossless = lossless
        self._owner = owner  # keeps the stream from being collected as long as one of its feeds is held

    def _hint(self, name: str) -> str | None:
        from inspect import getattr_static  # imported here: importing the library stays cheap

        field = getattr_static(self._kind, name, None)
        own = field.own if isinstance(field, Elsewhere) else None if field is None else name
        return None if own is None else self._field_hint(own)

    def _field_hint(self, name: str) -> str:
        return f"; its packets have it: wait().{name} of the next one, latest.{name} of the newest one"

    @property
    def latest(self) -> T | None:
        """The newest packet of this connection, or None. Never blocks.

        None before the first packet came and again as soon as the connection is lost: old data is never shown as new. A
        recording that is over keeps its last one. Begins to connect, if nothing has yet.
        """
        self._connection.start_quietly()
        return self._connection.fan_out.newest(self._kind)

    def wait(self, timeout: float = 5.0) -> T:
        """The next packet that arrives.

        Raises:
            BadValue: `timeout` is not a number of seconds.
            LinkTimeout: If no packet arrived within `timeout` seconds.
            RemoteError: the first connection could not be made, or the stream gave up.
            LocalError: called in an inline callback, where nothing could come.
            Closed: the stream was closed.
        """
        timeout = check_seconds(timeout, "timeout")
        self._connection.refuse_to_wait("wait()")
        with contextlib.closing(self._packets(latest, timeout, None, is_loop=False)) as packets:
            for packet in packets:
                return packet
        raise self._why_nothing(timeout)

    def wait_until(self, condition: Callable[[T], object], timeout: float = 5.0) -> T:
        """The first packet for which a condition holds: the newest that there is, or one that arrives.

        Every packet is looked at as it comes, in this thread. One that falls more than 1024 packets behind misses the
        oldest. Of events (`State.IS_EVENT`) only those count that arrive from now on.

        Args:
            condition: gets each packet; what it raises ends the waiting.
            timeout: seconds.

        Raises:
            BadValue: `condition` cannot be called, or `timeout` is not a number of seconds.
            LinkTimeout: If it did not hold within `timeout` seconds; the message contains the number of packets.
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
            # After the queue was opened, so that no packet is missed between the two; it may come twice.
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
        """Iterate with a policy or a timeout of your own; a plain ``for`` keeps the newest state, or 1024 events.

        `Stream.stats` counts the packets that a slow loop does not get, as `dropped`.

        Ends when the stream is closed, or a recording is over. Without a timeout it waits for as long as the back-off
        allows for a robot that went away; `ConnectionEvent` tells of that.

        Args:
            policy: what to do when the loop falls behind, as for `subscribe`.
            timeout: Maximum wait for each packet, in seconds.
            lifespan: See `subscribe`.

        Raises:
            BadValue: If `policy` is not a policy, or a time is not a number of seconds.
            LinkTimeout: If nothing arrived within `timeout` seconds.
            RemoteError: the first connection could not be made, or the stream gave up.
            LocalError: called in an inline callback, where nothing could come.
        """
        policy = self._policy(policy, latest)
        if timeout is not None:
            timeout = check_seconds(timeout, "timeout")
        lifespan = check_lifespan(lifespan)
        self._connection.refuse_to_wait("iterating")
        return self._packets(policy, timeout, lifespan)

    def _packets(
        self, policy: Policy, timeout: float | None, lifespan: float | None, *, is_loop: bool = True
    ) -> Generator[T, None, None]:
        connection, kind = self._connection, self._kind
        expand = connection.fan_out.expander(kind)
        queue = connection.open_queue(kind, policy, lifespan)
        take = _taking(queue)
        if is_loop:
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
        """Call `callback` with each packet, in order and one at a time, until closed.

        Each subscription has a queue and a thread of its own, so a callback may be slow and may raise: no packet of
        anybody else's is lost by that. ``inline=True`` does without both, and so without the time that waking a thread
        takes: the thread that reads calls back at once. Then it has to be quick, since until it returns nothing is read
        and nobody else on this stream gets anything; calls of more than 0.5 ms are counted in `Stream.stats`.

        Args:
            callback: Function that is called with each packet.
            policy: what to do when it falls behind: `latest`, `drop_oldest(n)` or `block`; by default
                `drop_oldest(256)`, and 1024 for events. An inline callback has no queue, so it takes none.
            lifespan: seconds after its arrival for which a packet is worth having; None for ever. One that is older
                when its turn comes is dropped and counted as `expired`. Inline there is none: nothing waits.
            deadline: Maximum time between two packets, in seconds.
            on_deadline: called with the seconds since the last packet, once for each time that it is longer than
                `deadline`; by default the log gets a warning. Inline, it has a thread of its own.
            inline: Whether to call it in the thread that reads.

        Raises:
            BadValue: If an argument is invalid.
            RemoteError: If the first connection could not be made.
            LocalError: If the system has no thread left.
            Closed: If the stream was closed.
        """
        check_callable(callback, "callback")
        deadline = check_deadline(deadline, on_deadline)
        lifespan = check_lifespan(lifespan)
        connection, kind, owner = self._connection, self._kind, self._owner
        if inline:
            if policy is not None or lifespan is not None:
                raise BadValue(
                    "an inline callback has no queue in which packets could wait, so it takes no policy and no lifespan"
                )
            return connection.subscribe_inline(kind, callback, deadline=deadline, on_deadline=on_deadline, owner=owner)
        policy = self._policy(policy, drop_oldest(256))
        return connection.subscribe(
            kind, callback, policy=policy, lifespan=lifespan, deadline=deadline, on_deadline=on_deadline, owner=owner
        )

    def history(self, seconds: float) -> History:
        """Keep the states of the last seconds, from now on, to look back at as arrays.

        Args:
            seconds: for which each is kept: memory is some kilobyte for a state.

        Raises:
            BadValue: no positive number of seconds, or a class without fields of its own.
            RemoteError, LocalError, Closed: as `subscribe`.
        """
        seconds = check_seconds(seconds, "seconds", positive=True, finite=True)
        if not (issubclass(self._kind, State) and self._kind.FIELDS):
            raise BadValue(f"a {self._kind.__name__} has no fields of its own to keep; take a part of it with of()")
        return History(self._kind, seconds, lambda keep: self.subscribe(keep, inline=True))

    def plot(self, *fields: str, seconds: float = 10.0, window: float = 10.0, period: float = 0.2) -> None:
        """Draw fields while they come: in a notebook below its cell, elsewhere in a window. Returns when time is up.

        Args:
            fields: names, a panel for each; vectors have a line for each element.
            seconds: Duration in seconds, from the connection on. The last plot shows every state of the window.
            window: seconds that are shown, the newest on the right.
            period: Interval between two plots, in seconds.

        Raises:
            BadValue: no field, or one that is not there or is not a number, or a time that is not a number of seconds.
            LocalError: matplotlib is not installed; says how to.
            LinkTimeout: If nothing arrived within `seconds`.
            RemoteError, LocalError, Closed: as `subscribe`.
        """
        from ..plotting import SHORTEST, LivePlot  # imported here: importing the library stays cheap

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
        """What to show next, until `end`, monotonic s; None if nothing has arrived yet.

        The last one is made after `end`. It shows every state, even if drawing takes longer than receiving.
        """
        from ..plotting import Curves, Plot

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
        """The policy; of those who do not say: events are kept, states are replaced by newer ones."""
        if policy is not None:
            return check_policy(policy)
        if self._lossless:
            return block
        return drop_oldest(LAGGARD) if self._has_events else for_states

    @property
    def _has_events(self) -> bool:
        """The packets are news that come once, rather than samples of something that goes on."""
        return bool(getattr(self._kind, "IS_EVENT", self._kind is ConnectionEvent))

    def _why_nothing(self, timeout: float) -> Exception:
        """What to raise when nothing came within `timeout` seconds."""
        connection = self._connection
        if connection.failure is not None:
            return connection.failure
        if connection.is_over:
            return Closed(f"{connection.name} was closed, or is over")
        because = ""
        if connection.state is not ConnectionState.CONNECTED and connection.error is not None:
            because = f"; it is not connected: {connection.error}"
        return LinkTimeout(f"no {self._kind.__name__} from {connection.name} within {timeout:g} s{because}")

    def _why_none_of(self, looked_at: int, timeout: float) -> Exception:
        """What to raise when a condition held for none of so many packets within `timeout` seconds."""
        connection = self._connection
        if looked_at and connection.failure is None and not connection.is_over:
            what = f"{looked_at} {self._kind.__name__} from {connection.name}"
            return LinkTimeout(f"the condition held for none of {what} within {timeout:g} s")
        return self._why_nothing(timeout)

    def __repr__(self) -> str:
        return f"<Feed of {self._kind.__name__} from {self._connection.name}>"


def _taking(queue: PacketQueue) -> Callable[[float | None], Any]:
    """`PacketQueue.next`; if this thread makes a pending call, abandoning the call ends the wait."""
    if pending_call() is None:
        return queue.next

    def take(timeout: float | None) -> Any:
        with interruptible(queue.end):
            return queue.next(timeout)

    return take
