"""Functions and base classes for threads and locks.

- `started` starts a thread, with a clear error if the system has no thread left.
- `acquired`, `held` and `alone` hold a lock in a block, with a timeout.
- `CallbackThread` calls the callbacks of a user: done callbacks, `on_stop` and `on_text`. During such a call, no lock
  is held, and the robot does not wait. So a callback may command the robot, wait for a motion, close the robot, be slow
  or raise. A slow callback delays only the callbacks after it.
- `MadeOnce` holds an object that several threads may make at its first use.
- `Newest` holds the newest values of one thread, and any thread can copy them.
- `Closing` is a base class of context managers that close themselves at the end of their block.
- `Runnable` is a server that runs once, either in the thread that calls `run`, or in a dedicated thread from `start` to
  `close`.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from . import clock
from .arguments import check_seconds
from .errors import Closed, LinkTimeout, LocalError
from .process import HomeProcess

if TYPE_CHECKING:
    from typing_extensions import Self


def started(thread: threading.Thread) -> threading.Thread:
    """Start a thread, and return it.

    Raises:
        LocalError: If the system refuses another thread.
    """
    try:
        thread.start()
    except RuntimeError as error:  # "can't start new thread", from pthread_create and its like
        raise LocalError(
            f"no thread could be started for {thread.name} ({error}): this process or its user has reached the "
            f"system's limit; this process has {threading.active_count()} Python threads"
        ) from error
    return thread


@contextlib.contextmanager
def acquired(lock: threading.Lock | threading.RLock, timeout: float) -> Iterator[bool]:
    """Acquire a lock for a block, within `timeout` seconds; yield whether it was acquired."""
    got: list[bool] = []

    def attempt(seconds: float | None) -> bool:
        # Acquire the lock and record this in one step. Ctrl-C between two steps would leave the lock locked forever.
        got.extend(map(lock.acquire, (True,), (-1 if seconds is None else seconds,)))
        return got[-1]

    try:
        clock.wait(attempt, timeout)
        yield True in got
    finally:
        if True in got:  # no function is called here, because Ctrl-C could interrupt after it
            lock.release()


@contextlib.contextmanager
def held(lock: threading.Lock | threading.RLock, timeout: float, otherwise: str) -> Iterator[None]:
    """Hold a lock within a block; wait up to `timeout` seconds for it.

    Raises:
        LinkTimeout: If other threads hold the lock for longer; `otherwise` is the message.
    """
    with acquired(lock, timeout) as is_held:
        if not is_held:
            raise LinkTimeout(otherwise)
        yield


@contextlib.contextmanager
def alone(lock: threading.RLock, timeout: float, otherwise: str) -> Iterator[None]:
    """Hold a lock like `held`, but raise at once if the current thread already holds the lock.

    Use it for a block that waits for a peer. A signal handler runs in the thread that it has interrupted. If that
    thread is already in the block, the handler would wait forever.

    Raises:
        LinkTimeout: If other threads hold the lock for longer, or at once if the current thread holds it.
    """
    if is_mine(lock):
        raise LinkTimeout(f"{otherwise} (this signal handler has interrupted the other call, so it cannot wait for it)")
    with held(lock, timeout, otherwise):
        yield


def is_mine(lock: threading.RLock) -> bool:
    """Whether the current thread holds the lock."""
    is_owned: Callable[[], bool] = lock._is_owned  # type: ignore[attr-defined]  # `threading.Condition` relies on it
    return is_owned()


class ReentrantEvent:
    """An event like `threading.Event` that a signal handler can use even if it has interrupted one of its methods.

    The lock of `threading.Event` is not re-entrant. If the interrupted thread sets the event or starts to wait for it,
    a handler that sets the event too would wait forever.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._is_set = False

    def is_set(self) -> bool:
        """Whether the event was set, and has not been cleared since."""
        return self._is_set

    def set(self) -> None:
        """Set the event, and wake the threads that are waiting for it."""
        with self._changed:
            self._is_set = True
            self._changed.notify_all()

    def clear(self) -> None:
        """Undo `set`."""
        self._is_set = False

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the event is set; return False if it is not set within `timeout` seconds."""
        if self._is_set:
            return True
        with self._changed:
            return self._changed.wait_for(self.is_set, timeout)


_log = logging.getLogger(__name__)

T = TypeVar("T")
# Re-entrant, unlike `queue.Queue`: a signal handler may call `put` while the interrupted thread is in `put`.
_Calls = SimpleQueue[tuple[Callable[..., object], tuple[Any, ...]] | None]


class MadeOnce(Generic[T]):
    """Holder of an object that is made at its first use, by the first thread that uses it.

    The holder has no lock: a signal handler might interrupt the first use and use the object itself, and would then
    wait for a lock forever. Without a lock, two threads might make an object at the same time. `keep` decides which
    object is kept, with `dict.setdefault`, which neither a thread nor a signal handler can interrupt. Making the object
    must not have effects that need to be undone. The kept object may be started afterwards.
    """

    def __init__(self) -> None:
        self._made: dict[None, T] = {}

    @property
    def made(self) -> T | None:
        """Kept object; None before it is made, and after `take`."""
        return self._made.get(None)

    def keep(self, made: T) -> T:
        """Keep `made` unless an object is kept already; return the kept object."""
        return self._made.setdefault(None, made)

    def take(self) -> T | None:
        """Remove and return the object; the next use makes another one."""
        return self._made.pop(None, None)


class Newest(Generic[T]):
    """The newest values of a series. One thread adds values, and any thread can copy them.

    Unlike a `deque`, a list can be copied while another thread adds to it, even without the global interpreter lock.

    Args:
        count: Largest number of values that are copied.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._values: list[T] = []

    def add(self, value: T) -> None:
        """Add a value at the end."""
        self._values.append(value)
        # Not with every value, because the remaining values are moved each time.
        if len(self._values) >= 2 * self._count:
            del self._values[: -self._count]

    def copy(self) -> list[T]:
        """Return the newest values, the newest last."""
        return self._values[-self._count :]


class CallbackThread:
    """Thread that makes calls one after the other. It is started at the first call.

    Args:
        name: Name of the thread.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._calls: _Calls = SimpleQueue()
        self._is_closed = False
        # Each thread has an event for its end, because a thread that is just being started cannot be joined yet.
        self._thread: MadeOnce[tuple[threading.Thread, ReentrantEvent]] = MadeOnce()
        weakref.finalize(self, self._calls.put, None)

    def start(self) -> None:
        """Start the thread now if it does not run yet, so that a later call cannot fail for lack of a thread.

        Raises:
            LocalError: If the system has no thread left.
        """
        if not self._has_thread(self.start):
            raise LocalError(f"no thread could be started for {self._name}; nothing was sent")

    def call(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call `function(*arguments)` soon. If the system has no thread left, log an error instead."""
        if self._has_thread(function):
            self._calls.put((function, arguments))
            # A reader that is just ending may call this after `close` has removed the thread.
            if self._is_closed and self._has_thread(function):
                self.close(0.0)

    def _has_thread(self, function: Callable[..., object]) -> bool:
        if self._thread.made is None:
            has_ended = ReentrantEvent()
            made = threading.Thread(target=_run, args=(self._calls, has_ended), name=self._name, daemon=True), has_ended
            if self._thread.keep(made) is made:
                try:
                    started(made[0])
                except LocalError:
                    self._thread.take()
                    has_ended.set()
                    _log.exception("%r is not called: the system has no thread left", function)
                    return False
        return True

    def close(self, timeout: float) -> None:
        """Make the pending calls, and end the thread, within `timeout` seconds. Idempotent."""
        self._is_closed = True
        made = self._thread.take()
        if made is None:
            return
        thread, has_ended = made
        self._calls.put(None)
        if thread is not threading.current_thread() and clock.wait(has_ended.wait, timeout):
            clock.join(thread)


def _run(calls: _Calls, has_ended: ReentrantEvent) -> None:
    try:
        while (call := calls.get()) is not None:
            function, arguments = call
            try:
                function(*arguments)
            except BaseException:
                # SystemExit and KeyboardInterrupt are caught too: they would end this thread, so that later callbacks
                # would never be called.
                _log.exception("callback %r raised; later callbacks are still called", function)
            del call, function, arguments
    finally:
        has_ended.set()


class Closing:
    """Base class of context managers that call their own `close`, which must be idempotent, at the end of the block."""

    close: Callable[..., object]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class Runnable(Closing, ABC):
    """Server of one robot that runs once. As a context manager, it starts and closes itself.

    Args:
        kind: Kind of server, used in errors and as the name of its thread.
        close_timeout: Maximum wait of `close` for the thread, in s.
        holds: Name of the object that might prevent the end, used in the error if `close` times out.

    Attributes:
        failure: Error that ended it on its own; None while it runs, and after `stop`.
    """

    failure: Exception | None

    def __init__(self, kind: str, close_timeout: float, holds: str) -> None:
        self.failure = None
        self._kind = kind
        self._close_timeout = close_timeout
        self._holds = holds
        self._thread: threading.Thread | None = None
        self._home = HomeProcess(kind)
        self._is_stopping = False
        self._used: MadeOnce[object] = MadeOnce()  # kept by the call that begins
        self._ended = ReentrantEvent()

    # -- methods of a subclass -------------------------------------------------------------------------

    @abstractmethod
    def _begin(self) -> None:
        """Open everything. If this raises, `_give_up` is called, and the error is raised again."""

    @abstractmethod
    def _serve(self) -> None:
        """Run until `_is_stopping` is set; then shut down in order.

        Keep an error that ends it early in `failure`.
        """

    @abstractmethod
    def _give_up(self) -> None:
        """Close everything that `_begin` has opened, because it will not be served."""

    @abstractmethod
    def _wake(self) -> None:
        """Make `_serve` check whether it must stop.

        May be called in a signal handler, so it must take no lock.
        """

    # -- life ------------------------------------------------------------------------------------------

    def _begin_once(self) -> None:
        # Keep the mark before anything that might fail. A failed attempt cannot be repeated, because it might have left
        # devices open.
        mark = object()
        if self._used.keep(mark) is not mark:
            raise Closed(f"this {self._kind} has already run; create a new one")
        try:
            self._begin()
        except BaseException:
            self._abandon()
            raise

    @property
    def _is_used(self) -> bool:
        return self._used.made is not None

    def _abandon(self) -> None:
        try:
            self._give_up()
        finally:
            self._ended.set()

    def _serve_to_end(self) -> None:
        try:
            with clock.fine_timer():
                self._serve()
        finally:
            self._ended.set()

    def run(self) -> None:
        """Run in this thread until `stop`; then end in order.

        An exception from a signal handler, such as KeyboardInterrupt, also ends it in order, and is raised again.

        Raises:
            Closed: If it has already run.
            LinkError: If it cannot begin, or ends on its own. See the class.
        """
        self._begin_once()
        self._serve_to_end()
        if self.failure is not None:
            raise self.failure

    def start(self) -> Self:
        """Run in a thread; its port is open when this returns.

        Raises:
            See `run`, for errors until the port is open; later errors are kept in `failure`.
        """
        self._begin_once()
        self._thread = threading.Thread(target=self._in_thread, name=self._kind, daemon=True)
        try:
            started(self._thread)
        except LocalError:
            self._thread = None
            self._abandon()
            raise
        return self

    def _in_thread(self) -> None:
        # The exception that ended it is kept in `failure`. If it were raised here, it would only be printed.
        try:
            self._serve_to_end()
        except BaseException:
            _log.exception("the %s has ended", self._kind)

    def stop(self) -> None:
        """Make the server end after its current round.

        Any thread, callback, plugin or signal handler may call this method.
        """
        # A flag and a byte into a pipe need no lock. The code that a signal handler interrupts might hold a lock.
        self._is_stopping = True
        self._wake()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the server has ended; return False if it has not ended in time.

        Args:
            timeout: Maximum wait in seconds; None or infinity for no limit.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
            LinkError: If it ended on its own. See the class.
        """
        if timeout is not None:
            timeout = check_seconds(timeout, "timeout")
        if not clock.wait(self._ended.wait, timeout):
            return False
        if self.failure is not None:
            raise self.failure
        return True

    def close(self) -> None:
        """Stop, and wait until everything has ended in order; idempotent.

        In a process that was forked from the process that started it, this does nothing: the forked process must not
        stop the robot.

        Raises:
            LinkTimeout: If it does not end in time.
        """
        if not self._home.is_here:
            return
        self.stop()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(self._close_timeout)
            if thread.is_alive():
                raise LinkTimeout(
                    f"the {self._kind} has not ended within {self._close_timeout:g} s: {self._holds} does not respond"
                )

    def __enter__(self) -> Self:
        return self.start()
