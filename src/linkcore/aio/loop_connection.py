"""Connection to one peer. An event loop opens and reads it, and opens it again when it is lost.

    transport -> receiver -> fan-out -> queues -> tasks
    [------------------ event loop ------------------]

No thread waits. When bytes arrive at the socket, the loop calls a function, which publishes the packets immediately. A
timer measures silence.

Other threads, such as the threads that command a robot, may also send and wait. For them, the thread of the loop is the
reader. A call that would wait in the thread of the loop is refused, because the thread would wait for itself.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

from .. import clock
from ..errors import Closed, ConnectionLost, LinkTimeout, LocalError, unraised
from ..event_loop import happened, within
from ..net.awaited import AwaitedTransport
from ..net.watching import forget, watch
from ..streaming.connection import Connection
from ..streaming.receiver import Receiver
from ..streaming.scheduling import urgent
from ..threads import ReentrantEvent

#: Time in s for which another thread waits until the loop closes a socket. After that, the thread closes it itself,
#: because abandoned data must not be sent, even if the loop is blocked.
_HANDOVER = 0.05

#: Time in s by which a timer may be early.
_EARLY = 1e-4


class LoopConnection(Connection):
    """Connection that an event loop reads.

    Args:
        name: See `Connection`.
        transport: See `Connection`.
        arguments: Further arguments of `Connection`: `protocol` and `fan_out`.
        loop: Event loop that reads the connection.
        options: Keyword arguments of `Connection`.
    """

    _transport: AwaitedTransport

    def __init__(
        self, name: str, transport: AwaitedTransport, *arguments: Any, loop: asyncio.AbstractEventLoop, **options: Any
    ) -> None:
        super().__init__(name, transport, *arguments, **options)
        self._loop = loop
        self._task: asyncio.Task[None] | None = None  # this object and the task refer to each other until it ends
        self._opening: asyncio.Task[None] | None = None
        self._settled: asyncio.Future[None] = loop.create_future()
        self._closing: asyncio.Future[None] = loop.create_future()
        self._has_ended = ReentrantEvent()
        self._has_ended.set()
        # The following attributes belong to the current connection.
        self._receiver: Receiver | None = None
        self._over: asyncio.Future[Exception | None] | None = None
        self._descriptor = -1  # descriptor that the loop watches
        self._full: set[object] = set()  # queues that have no room
        self._timer: asyncio.TimerHandle | None = None
        self._timer_wait: float | None = None
        self._quiet_since = 0.0
        self._is_taking = False  # whether `_take_waiting` runs; a callback may call it again

    # -- beginning and ending --------------------------------------------------------------------

    @property
    def is_running(self) -> bool:
        """Whether the loop reads the connection, or will begin to read it."""
        return not self._has_ended.is_set()

    def reads_here(self) -> bool:
        """Whether the current thread is the thread of the loop."""
        try:
            return asyncio.get_running_loop() is self._loop
        except RuntimeError:
            return False

    def refuse_to_wait(self, what: str) -> None:
        """Raise if the current thread would wait for itself.

        Raises:
            LocalError: If the current thread is the thread of the loop.
        """
        if self.reads_here():
            raise LocalError(
                f"{what} would wait forever: the thread of the event loop reads {self.name}, so nothing is read while "
                "it waits; await the call instead"
            )

    def start(self, add: Callable[[], object] | None = None) -> None:
        """Connect as `Connection.start` does.

        In the thread of the loop, the connection must already exist.
        """
        if not self._is_settled:
            self.refuse_to_wait("connecting")
        super().start(add)

    async def connected(self, add: Callable[[], object] | None = None) -> None:
        """Connect as `start` does, for tasks of the loop.

        Raises:
            RemoteError: If the connection cannot be made; the next use tries again.
            Closed: If the connection was closed.
        """
        if add is not None:
            add()
        with self._changed:
            self._begin(is_patient=False)
            if self._life.is_closed:
                raise Closed(f"{self.name} was closed")
            attempt, settled = self._life.attempt, self._settled
        if not attempt.is_settled and not await within(self._timeout + 1.0, settled):
            raise self.error or LinkTimeout(f"{self.name}: no connection within {self._timeout:g} s")
        if attempt.failure is not None:
            raise unraised(attempt.failure)

    async def disconnected(self) -> None:
        """Disconnect and end every queue, as `close` does, for tasks of the loop. Idempotent."""
        self._stop()
        self.fan_out.close(all=False)
        task = self._task
        if task is not None and task is not asyncio.current_task():
            await asyncio.wait({task})

    async def joined(self, timeout: float | None) -> bool:
        """Wait until no more packets will arrive; return False after `timeout` seconds.

        It is for tasks of the loop.
        """
        return self._task is None or await within(timeout, self._task)

    def abandon(self) -> None:
        """End everything without waiting."""
        self._stop()
        if self._loop.is_closed():
            self._transport.abort()

    def _launch(self) -> None:
        self._has_ended.clear()
        self._settled = self._loop.create_future()
        try:
            self.call(self._start_reading)
        except LocalError:
            self._has_ended.set()
            raise

    def _start_reading(self) -> None:
        if self._life.is_closed:  # another thread has closed it meanwhile
            self._finish(None)
            self._has_ended.set()
            return
        self._task = self._loop.create_task(self._keep_up(), name=f"{self.name} reader")

    def _join_reader(self, timeout: float) -> bool:
        if self.reads_here():
            return True
        return clock.wait(self._has_ended.wait, timeout)

    def _hang_up(self) -> None:
        """Do nothing: `_stop` has woken the task, and the task disconnects."""

    def _settle(self) -> None:
        super()._settle()
        happened(self._settled)

    def _stop(self) -> None:
        super()._stop()
        with contextlib.suppress(LocalError):  # the loop is closed, so nothing runs any more
            self.call(self._on_closing)

    def _on_closing(self) -> None:
        happened(self._closing)
        happened(self._settled)
        if self._opening is not None:
            self._opening.cancel()
        self._end(None)

    def call(self, function: Callable[[], object]) -> None:
        """Call `function` in the thread of the loop; at once if this is the thread of the loop.

        Raises:
            LocalError: If the loop is closed.
        """
        if self.reads_here():
            function()
            return
        try:
            self._loop.call_soon_threadsafe(function)
        except RuntimeError as error:
            raise LocalError(f"{self.name}: its event loop is closed") from error

    # -- sending ---------------------------------------------------------------------------------

    def abort(self) -> None:
        """Abort the connection, discard the data that the peer has not acknowledged, and reconnect."""
        if self.reads_here():
            self._abort_here()
            return
        # The loop must stop watching the descriptor before the system can give its number to another socket.
        done = ReentrantEvent()

        def abort() -> None:
            self._abort_here()
            done.set()

        with contextlib.suppress(LocalError):
            self.call(abort)
            if clock.wait(done.wait, _HANDOVER):
                return  # the loop might have connected again meanwhile; this thread must not abort that connection
        self._transport.abort()

    def _abort_here(self) -> None:
        self._watch_no_more()
        self._transport.abort()
        self._end(ConnectionLost(f"{self.name} was closed by this program"))

    # -- reading ---------------------------------------------------------------------------------

    async def _keep_up(self) -> None:
        """Do the work of the reader thread of a `Connection`."""
        with urgent():  # for the thread of the loop
            await self._connect_until_closed()

    async def _connect_until_closed(self) -> None:
        try:
            while True:
                try:
                    await self._connect_and_await()
                except Exception as error:
                    wait = self._next_try(error)
                else:
                    wait = self._next_try(None)
                if wait is None:
                    return
                await within(wait, self._closing)
                if self._life.is_closed:
                    self._finish(None)
                    return
        except asyncio.CancelledError:  # the loop ends
            super()._stop()
            self._finish(None)
            raise
        finally:
            self._has_ended.set()

    async def _connect_and_await(self) -> None:
        """Connect, and wait until the connection is lost or closed; raise the error that ended it."""
        self._connecting()
        self._opening = opening = self._loop.create_task(self._transport.connect(self._timeout))
        try:
            await opening
        except asyncio.CancelledError:
            if self._life.is_closed:
                return
            raise
        finally:
            self._opening = None
        if self._life.is_closed:
            return
        self._receiver = self._opened()
        self._over = over = self._loop.create_future()
        self.silence.end(clock.now())
        try:
            self._watch()
            # Take the bytes that arrived during the connection attempt. When later bytes arrive, the loop calls
            # `_take_waiting`.
            while self._take_waiting():
                pass
            self._set_timer()
            error = await over
        finally:
            self._watch_no_more()
            self._over = self._receiver = None
        if error is not None:
            try:
                raise error
            finally:
                del error  # breaks the reference cycle between the error and this frame
        await self._transport.disconnect()

    def _watch(self) -> None:
        """Let the loop watch the descriptor of the connection, and call `_take_waiting` when bytes arrive.

        Raises:
            ConnectionLost: If the connection was closed in the meantime.
            LocalError: If the loop needs a thread to wait for sockets, and the system refuses another thread.
        """
        descriptor = self._transport.fileno()
        if descriptor < 0:
            raise ConnectionLost(f"{self.name} was closed by this program")
        watch(self._loop, descriptor, self._readable)
        self._descriptor = descriptor

    def _watch_no_more(self) -> None:
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            forget(self._loop, descriptor)
        self._call_in(None)

    def _end(self, error: Exception | None) -> None:
        """End this connection with an error, or with None if it was closed on purpose."""
        if self._over is not None and not self._over.done():
            self._watch_no_more()
            self._over.set_result(error)

    def _readable(self) -> None:
        self._take_waiting()
        if self.silence.wait != self._timer_wait:
            self._set_timer()

    def _take_waiting(self) -> bool:
        """Publish the packets in the bytes that have arrived; return False if no bytes have arrived."""
        if self._receiver is None or self._descriptor < 0 or self._is_taking:
            return False
        self._is_taking = True
        try:
            received = self._transport.receive_waiting()
            if received is None:
                return False
            data, stamp = received
            self._quiet_since = stamp[0]
            self._take(self._receiver, data, stamp)
        except Exception as error:
            self._end(error)
            return False
        finally:
            self._is_taking = False
        return True

    def look(self) -> None:
        """Publish bytes that have already arrived, before a caller concludes that nothing has arrived.

        The loop might have been blocked meanwhile.
        """
        while self._take_waiting():
            pass

    # -- back-pressure ---------------------------------------------------------------------------

    def hold(self, queue: object) -> None:
        """Stop reading until `release`, because a queue that drops nothing is full.

        Call it in the loop's thread.
        """
        self._full.add(queue)
        self._watch_no_more()

    def release(self, queue: object) -> None:
        """Continue to read if no other queue is full. The given queue has room again, or was closed."""
        if queue not in self._full:
            return
        self._full.discard(queue)
        if not self._full and self._over is not None and not self._over.done():
            try:
                self._watch()
            except (ConnectionLost, LocalError) as error:
                self._end(error)
            else:
                self._set_timer()

    # -- silence ---------------------------------------------------------------------------------

    def _set_timer(self) -> None:
        """Start a timer that expires if nothing arrives for `silence.wait` seconds from now."""
        self._quiet_since = clock.now()
        self._timer_wait = self.silence.wait
        self._call_in(self._timer_wait)

    def _call_in(self, seconds: float | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if seconds is not None and self._descriptor >= 0:
            self._timer = self._loop.call_later(seconds, self._time_is_up)

    def _time_is_up(self) -> None:
        self._timer = None
        self.look()
        if self._descriptor < 0:
            return
        wait = self._timer_wait
        assert wait is not None
        left = self._quiet_since + wait - clock.now()
        if left > _EARLY:  # the timer is not restarted for each packet, because this would take longer than reading it
            self._call_in(left)
            return
        try:
            self.silence.timed_out()
        except LinkTimeout as error:
            self._end(error)
        else:
            self._set_timer()
