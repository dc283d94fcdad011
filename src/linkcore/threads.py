"""Threads: starting one where the system may have none left, waiting for a lock, the one that calls a user's callbacks,
and one of its own; what several of them make at first use, and what a block closes at its end.

Callbacks are done callbacks, `on_stop` and `on_text`. No lock is held meanwhile and no robot is kept waiting, so a
callback may command the robot, wait for a motion, close the robot, be slow or raise. One that is slow keeps those after
it waiting, and nothing else. What is `Runnable` runs once: in the thread that calls `run`, or in one of its own, from
`start` to `close`.
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
            f"no thread could be started for {thread.name} ({error}): this process, or its user, has as many as the "
            f"system allows; there are {threading.active_count()} of Python"
        ) from error
    return thread


@contextlib.contextmanager
def acquired(lock: threading.Lock | threading.RLock, timeout: float) -> Iterator[bool]:
    """Acquire a lock for a block, within `timeout` seconds; yields whether that was possible."""
    got: list[bool] = []

    def attempt(seconds: float | None) -> bool:
        # Acquired and noted in one step: Ctrl-C can come between two of them, and would leave the lock locked for ever.
        got.extend(map(lock.acquire, (True,), (-1 if seconds is None else seconds,)))
        return got[-1]

    try:
        clock.wait(attempt, timeout)
        yield True in got
    finally:
        if True in got:  # without a call, after which Ctrl-C could come
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
    """As `held`, for a block that waits for a peer and must not be entered again by a signal handler.

    A handler runs in the thread that it has interrupted. If that thread is in the block, waiting for it is in vain.

    Raises:
        LinkTimeout: See `held`. At once, if the current thread is in the block already.
    """
    if is_mine(lock):
        raise LinkTimeout(f"{otherwise} (the call that this signal handler has interrupted)")
    with held(lock, timeout, otherwise):
        yield


def is_mine(lock: threading.RLock) -> bool:
    """Whether the current thread holds the lock."""
    is_owned: Callable[[], bool] = lock._is_owned  # type: ignore[attr-defined]  # `threading.Condition` relies on it
    return is_owned()


class ReentrantEvent:
    """As `threading.Event`, but a signal handler can use it while its own thread is in one of its methods.

    The lock of `threading.Event` is not re-entrant. A handler that sets an event while the interrupted thread sets it
    too, or begins to wait for it, would wait forever.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._is_set = False

    def is_set(self) -> bool:
        """Whether it was set, and not cleared since."""
        return self._is_set

    def set(self) -> None:
        """Set it, and wake the threads that wait for it."""
        with self._changed:
            self._is_set = True
            self._changed.notify_all()

    def clear(self) -> None:
        """Undo `set`."""
        self._is_set = False

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is set; False if that takes longer than `timeout` seconds."""
        if self._is_set:
            return True
        with self._changed:
            return self._changed.wait_for(self.is_set, timeout)


_log = logging.getLogger(__name__)

T = TypeVar("T")
# Re-entrant, unlike `queue.Queue`: a signal handler may put while its thread is putting.
_Calls = SimpleQueue[tuple[Callable[..., object], tuple[Any, ...]] | None]


class MadeOnce(Generic[T]):
    """Object that is made at its first use, by the first thread that uses it.

    Without a lock, since a signal handler may be the one that uses it, also in the middle of the first use by the
    thread that it interrupts, where a lock would be held for ever. So two may make one at the same time; `keep` tells
    which of them holds, by `dict.setdefault`, which is one step for threads and signal handlers. Making it must do
    nothing that has to be undone; what is kept may be started then.
    """

    def __init__(self) -> None:
        self._made: dict[None, T] = {}

    @property
    def made(self) -> T | None:
        """The object; None before it is made, and after `take`."""
        return self._made.get(None)

    def keep(self, made: T) -> T:
        """Keep `made` unless an object is kept already; return the kept object."""
        return self._made.setdefault(None, made)

    def take(self) -> T | None:
        """Remove and return the object; the next use makes another one."""
        return self._made.pop(None, None)


class CallbackThread:
    """Thread that makes calls one after the other; it is started for the first call.

    Args:
        name: Name of the thread.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._calls: _Calls = SimpleQueue()
        self._is_closed = False
        # With the event of its end: a thread that another one is just starting cannot be joined yet.
        self._thread: MadeOnce[tuple[threading.Thread, ReentrantEvent]] = MadeOnce()
        weakref.finalize(self, self._calls.put, None)

    def start(self) -> None:
        """Start the thread now, if it does not run yet: a later call cannot fail for want of a thread.

        Raises:
            LocalError: If the system has no thread left.
        """
        if not self._has_thread(self.start):
            raise LocalError(f"no thread could be started for {self._name}; nothing was sent")

    def call(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call `function(*arguments)` soon. If the system has no thread left, log an error instead."""
        if self._has_thread(function):
            self._calls.put((function, arguments))
            # A reader that is just ending may call after `close`, which may have taken the thread before this call.
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
                    _log.exception("%r is not called", function)
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
        if (
            thread is not threading.current_thread()
            and clock.wait(has_ended.wait, timeout)
            and thread.ident is not None
        ):
            thread.join()


def _run(calls: _Calls, has_ended: ReentrantEvent) -> None:
    try:
        while (call := calls.get()) is not None:
            function, arguments = call
            try:
                function(*arguments)
            except BaseException:
                # Also SystemExit and KeyboardInterrupt: they would end this thread, and with it all later callbacks.
                _log.exception("%r raised; the callbacks after it are called all the same", function)
            del call, function, arguments
    finally:
        has_ended.set()


class Closing:
    """A context manager that closes itself: a class with this base has a `close`, which is idempotent."""

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
        holds: Name of the object that blocks the end, used in the error if `close` times out.

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
        self._is_used = False
        self._ended = ReentrantEvent()

    # -- what it does ----------------------------------------------------------------------------------

    @abstractmethod
    def _begin(self) -> None:
        """Open everything; if that fails, `_give_up` is called and the error is raised."""

    @abstractmethod
    def _serve(self) -> None:
        """Run until `_is_stopping`; then end in order. Keep an error that ends it on its own in `failure`."""

    @abstractmethod
    def _give_up(self) -> None:
        """Close everything that `_begin` has opened, because it will not be served."""

    @abstractmethod
    def _wake(self) -> None:
        """Make `_serve` check whether it must stop. May be called in a signal handler, so it must take no lock."""

    # -- life ------------------------------------------------------------------------------------------

    def _begin_once(self) -> None:
        if self._is_used:
            raise Closed(f"a {self._kind} runs once; make another")
        # Before anything that may fail: what has begun once may have left devices open, and is not begun again.
        self._is_used = True
        try:
            self._begin()
        except BaseException:
            self._abandon()
            raise

    def _abandon(self) -> None:
        try:
            self._give_up()
        finally:
            self._ended.set()

    def _serve_to_end(self) -> None:
        try:
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
        # The exception that ended it is kept in `failure`. Raised here it would only be printed.
        try:
            self._serve_to_end()
        except BaseException:
            _log.exception("the %s has ended", self._kind)

    def stop(self) -> None:
        """Make it end after this round. Call it in any thread, callback, plugin or signal handler."""
        # A plain flag and a byte into a pipe: a lock could be held by the very code that a signal handler interrupts.
        self._is_stopping = True
        self._wake()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it has ended; return False if it has not ended in time.

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
        """Stop, and wait until all has ended in order; idempotent.

        In a process that was forked from the process that started it, this does nothing: the forked process must not
        stop the robot.

        Raises:
            LinkTimeout: If it does not end.
        """
        if not self._home.is_here:
            return
        self.stop()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(self._close_timeout)
            if thread.is_alive():
                raise LinkTimeout(
                    f"the {self._kind} has not ended within {self._close_timeout:g} s: {self._holds} does not answer"
                )

    def __enter__(self) -> Self:
        return self.start()
