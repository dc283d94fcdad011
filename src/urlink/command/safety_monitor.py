"""Updates the interlock with the states of a robot's streams, and calls functions when it closes."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from functools import partial
from operator import methodcaller
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from linkcore import clock
from linkcore.errors import Cancelled, LinkError
from linkcore.pending_call import current_call, stopped_here
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.threads import CallbackThread
from linkcore.wire.packet import State

from ..errors import SafetyStop
from ..protocol.primary.robot_message import SafetyModeMessage
from ..protocol.primary.robot_state import RobotState
from ..protocol.realtime.packets import RealtimeState
from .interlock import Interlock, Status, raise_if
from .section import Section

if TYPE_CHECKING:
    from .flight_recorder import FlightRecorder

#: Timeout for the first state of an interface, in seconds.
_FIRST_REPORT = 2.0
#: Maximum time, in seconds, until every working interface reports again, even over a new connection. The slowest
#: interface sends ten times a second. The rest is a reserve for a busy computer.
_NEXT_REPORT = 0.5

_Stop = Callable[[LinkError], object]


class _Listening:
    """The subscriptions of one interface, to be closed when the monitor stops listening."""

    def __init__(self) -> None:
        self.is_over = False
        self._ends: list[Callable[[], object]] = []

    def add(self, end: Callable[[], object]) -> None:
        self._ends.append(end)

    def end(self) -> None:
        self.is_over = True
        while self._ends:
            try:
                end = self._ends.pop()
            except IndexError:  # another thread has taken the last one
                break
            end()


class SafetyMonitor:
    """Updates an interlock from the streams, and decides whether motions may be sent.

    It listens to the primary interface at 10 Hz from its first use. From the first motion, it also listens to the
    real-time interface, so that a stop is received within one or two cycles. The reader threads call it in the order in
    which packets arrive.

    Args:
        primary, realtime: Connections to the two interfaces.
        interlock: Interlock that makes the decisions.
        section: Critical section of the robot, which protects the interlock.
        callbacks: Thread that calls users' callbacks.
        clock: Monotonic clock, in seconds.
        flight: See the attribute `flight`.

    Attributes:
        clock: See the argument `clock`.
        is_closed: Whether `close` was called; then no packet arrives any more.
        flight: Flight recorder of the robot; None for none.
    """

    def __init__(
        self,
        primary: Connection,
        realtime: Connection,
        interlock: Interlock,
        section: Section,
        callbacks: CallbackThread,
        clock: Callable[[], float] = clock.now,
        flight: FlightRecorder | None = None,
    ) -> None:
        self.flight = flight
        interlock.flight = flight
        self._connections = {"primary": primary, "realtime": realtime}
        self._interlock = interlock
        self._section = section
        self._callbacks = callbacks
        self.clock = clock
        self._listening: dict[str, _Listening] = {}
        #: Queues of waiting threads. Lists, because adding and removing an item is a single step for signal handlers.
        self._waiting: list[SimpleQueue[None]] = []
        self._hooks: list[_Stop] = []
        self._silence_hooks: list[Callable[[float], object]] = []
        self._stop_callbacks: dict[object, _Stop] = {}
        #: Number and name of the last stop; see `linkcore.pending_call`.
        self._last_stop: tuple[int, str] = (0, "")
        self.is_closed = False

    # -- decisions -----------------------------------------------------------------------------------

    @contextlib.contextmanager
    def decision(self) -> Iterator[Interlock]:
        """Provide the interlock for reading or changing it; waiting threads are notified afterwards."""
        with self._section.lock:
            yield self._interlock
        self._wake()

    def refusal_to_begin(self) -> LinkError | None:
        """Return the error that refuses a motion of this thread's call now, or None."""
        with self._section.lock:
            call = current_call()
            order = None if call is None else call.order
            refusal = self._interlock.refusal_to_begin(self.clock())
            return refusal or (None if order is None else self.overtaken(order))

    def refusal_to_stop(self) -> LinkError | None:
        """Return the error that prevents stopping the arm with a program now, or None.

        A stop does not need `enable()`, and a later stop does not invalidate it.
        """
        with self._section.lock:
            return self._interlock.blocked(self.clock())

    def require(self, is_stop: bool = False) -> None:
        """Raise the error of `refusal_to_stop` if this is a stop, otherwise the error of `refusal_to_begin`."""
        raise_if(self.refusal_to_stop() if is_stop else self.refusal_to_begin())

    def require_running(self) -> None:
        """Raise an error if even commands that move nothing are refused; a stop does not matter.

        Raises:
            NotRunning: If the robot is not running, or its state is unknown.
        """
        with self._section.lock:
            raise_if(self._interlock.absence(self.clock()))

    # -- the order of calls and stops ------------------------------------------------------------------

    def overtake(self, why: str) -> None:
        """Refuse every motion that was called before this moment; `why` names the stop in error messages."""
        with self._section.lock:
            self._last_stop = (stopped_here(), why)

    def overtaken(self, order: int) -> Cancelled | None:
        """Return the error for the call with this number if a stop came after the call, else None."""
        stop, why = self._last_stop
        return Cancelled(f"{why} after this call began, so it sends nothing") if order < stop else None

    # -- waiting for reports -------------------------------------------------------------------------

    def listen(self, closely: bool = False) -> None:
        """Subscribe, if not done yet, and wait for the first report; with `closely` on the real-time interface too.

        Raises:
            RemoteError: If the first connection could not be made.
            Closed: If the robot was closed.
        """
        for name in ("primary", "realtime") if closely else ("primary",):
            is_expected = methodcaller("is_expected", name)
            if name not in self._listening:
                self._begin_to_listen(name)
            elif self._section.may_wait and not self._is(is_expected):
                # Another thread has just subscribed, and waits for the first report too.
                self.wait_for(is_expected, _FIRST_REPORT)

    def _begin_to_listen(self, name: str) -> None:
        self._subscribe(name)
        if self._section.may_wait:
            self.wait_for(lambda interlock: interlock.has_reported(name), _FIRST_REPORT)
        with self.decision() as interlock:
            # Not before the first state: an interface that sends no first state must not close an open interlock.
            interlock.expect(name)

    def await_news(self, moves: bool) -> None:
        """If motions are refused, wait for the next report of every source, because the last one might be outdated.

        So a caller that has just switched the arm on, and has received the dashboard's reply, does not have to wait. A
        caller that was delayed first reads the states that arrived meanwhile.
        """
        began = self.clock()

        def is_settled(interlock: Interlock) -> bool:
            now = self.clock()
            in_the_way = interlock.blocked(now) if moves else interlock.absence(now)
            return in_the_way is None or interlock.has_reported_since(began)

        if self._section.may_wait:
            self.wait_for(is_settled, _NEXT_REPORT)
        elif not self._is(is_settled):
            for connection in self._connections.values():
                if connection.reads_here():
                    connection.look()

    @property
    def may_wait(self) -> bool:
        """Whether the current thread may wait for reports: it does not have to receive them itself."""
        return self._section.may_wait

    def wait_for(self, condition: Callable[[Interlock], object], timeout: float) -> bool:
        """Wait until the interlock meets a condition; return False after a timeout, or if the robot was closed.

        Raises:
            LocalError: If called in a thread that would have to receive the report itself.
        """
        until = clock.now() + timeout
        news: SimpleQueue[None] = SimpleQueue()
        self._waiting.append(news)
        try:
            while not self._is(condition):
                left = until - clock.now()
                if left <= 0.0 or self.is_closed:
                    return False
                with self._section.waiting(), contextlib.suppress(Empty):
                    clock.get(news, left)
            return True
        finally:
            self._waiting.remove(news)

    def _is(self, condition: Callable[[Interlock], object]) -> bool:
        with self._section.lock:
            return bool(condition(self._interlock))

    @property
    def is_connected(self) -> bool:
        """Whether all subscribed interfaces are connected. The interlock might be notified of a loss slightly later."""
        names = list(self._listening)
        return all(self._connections[name].state is ConnectionState.CONNECTED for name in names)

    # -- notifications -------------------------------------------------------------------------------

    def on_close(self, hook: _Stop) -> None:
        """Call `hook` immediately when the interlock closes, in the receiving thread, which it must not block."""
        self._hooks.append(hook)

    def on_silence(self, hook: Callable[[float], object]) -> None:
        """Call `hook` with the length of a too long silence, in seconds. See `on_close`."""
        self._silence_hooks.append(hook)

    def on_stop(self, callback: _Stop) -> Callable[[], None]:
        """Call a user's function when the interlock closes, in the thread for callbacks; return its remover."""
        key = object()
        self._stop_callbacks[key] = callback

        def remove() -> None:
            self._stop_callbacks.pop(key, None)

        return remove

    # -- received packets ---------------------------------------------------------------------------

    def _subscribe(self, name: str) -> None:
        connection = self._connections[name]
        on_state: Callable[[Any], None] = self._on_primary if name == "primary" else self._on_realtime
        kind: type = State if name == "primary" else RealtimeState
        listening = _Listening()
        try:
            # The reader reports silence, not a clock, because this process might have been delayed itself.
            seconds = min(self._interlock.stale_after, connection.silence.limit or math.inf)
            listening.add(connection.silence.watch(seconds, partial(self._fall_silent, name)))
            on_event = partial(self._on_event, name, listening)
            listening.add(connection.subscribe_inline(ConnectionEvent, on_event).close)
            subscription = connection.subscribe_inline(
                kind, on_state, only_changes=self._needs_only_changes, on_steady=partial(self._renew, name)
            )
            listening.add(subscription.close)
        except BaseException:
            listening.end()
            with self._section.lock:
                self._interlock.forget(name)
            raise
        if self._listening.setdefault(name, listening) is not listening:
            listening.end()  # another thread, or a signal handler of this thread, was faster
            return
        newest = connection.fan_out.newest(RobotState if name == "primary" else RealtimeState)
        if newest is not None:
            on_state(newest)
        if connection.state is not ConnectionState.CONNECTED:
            self._observe(lambda: self._interlock.lose(name, "not connected"))

    def _on_event(self, name: str, listening: _Listening, event: ConnectionEvent) -> None:
        if event.state in (ConnectionState.CONNECTING, ConnectionState.CONNECTED) or listening.is_over:
            return
        why = str(event.error or "closed")
        self._observe(lambda: self._interlock.lose(name, why))
        if event.state in (ConnectionState.IDLE, ConnectionState.CLOSED):  # gave up: subscribe again when needed
            self._listening.pop(name, None)
            listening.end()

    def _fall_silent(self, name: str, seconds: float) -> None:
        self._observe(lambda: self._interlock.fall_silent(name, seconds))
        for hook in tuple(self._silence_hooks):
            hook(seconds)

    def _on_primary(self, packet: State) -> None:
        if isinstance(packet, RobotState):
            mode, board = packet.robot_mode_data, packet.masterboard_data
            if mode is None:
                return
            status = Status(
                mode.robot_mode,
                board.safety_mode if board is not None else None,
                mode.is_emergency_stopped,
                mode.is_protective_stopped,
                board.master_safety_state if board is not None else None,
            )
            self._observe(lambda: self._interlock.report("primary", status, self._came(packet)))
        elif isinstance(packet, SafetyModeMessage):
            news = Status(safety_mode=packet.safety_mode)
            self._observe(lambda: self._interlock.amend("primary", news, self._came(packet)))

    def _on_realtime(self, state: RealtimeState) -> None:
        status = Status(state.robot_mode, state.safety_mode)
        self._observe(lambda: self._interlock.report("realtime", status, self._came(state)))

    def _needs_only_changes(self) -> bool:
        """Whether a state that shows the same modes as the previous one changes nothing except the time."""
        is_settled = self.flight is None or self.flight.unsettled is None
        return is_settled and self._interlock.is_clear and not self._waiting and not self._section.is_held

    def _renew(self, name: str, state: State) -> None:
        """Record the time of a state that shows the same modes as the previous one.

        No thread is in the critical section, because `_needs_only_changes` has just returned True.
        """
        received = state.received
        if received is not None:
            self._interlock.renew(name, received.monotonic)

    def _came(self, packet: State) -> float:
        received = packet.received
        return received.monotonic if received is not None else self.clock()

    def _observe(self, change: Callable[[], LinkError | None]) -> None:
        with self._section.lock:
            closed = change()
        flight = self.flight
        if flight is not None and flight.unsettled is not None:
            flight.settle(self.clock())
        if closed is not None:
            if isinstance(closed, SafetyStop):
                self.overtake(str(closed))
            for hook in tuple(self._hooks):
                hook(closed)
            for callback in list(self._stop_callbacks.values()):
                self._callbacks.call(callback, closed)
        self._wake()

    def _wake(self) -> None:
        for news in tuple(self._waiting):
            news.put(None)

    # -- closing -------------------------------------------------------------------------------------

    def close(self) -> None:
        """Unsubscribe and permit nothing more. Users are not notified, because this is not a stop of the robot."""
        self.is_closed = True
        self.overtake("the robot was closed")
        self._stop_callbacks.clear()
        for name, listening in list(self._listening.items()):
            listening.end()
            self._observe(lambda name=name: self._interlock.lose(name, "closed here"))  # type: ignore[misc]
        self._hooks.clear()  # they belong to parts that refer to this object
        self._silence_hooks.clear()
        self._wake()
