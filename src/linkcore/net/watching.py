"""Callbacks of an event loop: the loop calls a function when bytes arrive at a socket, or when bytes can be sent.

The event loop of asyncio on Windows, `ProactorEventLoop`, has no `add_reader`. For such a loop, a separate thread waits
for the sockets with `select`, and lets the loop call the functions. The thread ends when no socket is watched any more.
"""

from __future__ import annotations

import asyncio
import contextlib
import select
import socket
import threading
import weakref
from collections.abc import Callable
from typing import NamedTuple

from ..errors import LocalError
from ..threads import started


def watch(
    loop: asyncio.AbstractEventLoop, descriptor: int, callback: Callable[[], object], *, for_room: bool = False
) -> None:
    """Let the loop call `callback` when bytes have arrived, or with `for_room`, when bytes can be sent.

    Call it in the thread of the loop.

    Raises:
        LocalError: If the loop needs a thread for this, and the system refuses another thread.
    """
    try:
        (loop.add_writer if for_room else loop.add_reader)(descriptor, callback)
    except NotImplementedError:
        _watcher(loop).watch(_Watched(descriptor, for_room), callback)


def forget(loop: asyncio.AbstractEventLoop, descriptor: int, *, for_room: bool = False) -> None:
    """Undo `watch`. Call it in the thread of the loop, before the descriptor is closed."""
    try:
        (loop.remove_writer if for_room else loop.remove_reader)(descriptor)
    except NotImplementedError:
        _watcher(loop).forget(_Watched(descriptor, for_room))


#: Interval in s at which the thread checks whether its loop was closed or deleted.
_LOOK = 1.0


class _Watched(NamedTuple):
    descriptor: int
    for_room: bool


class _Watcher:
    """Thread that waits for the sockets of one event loop.

    The thread of the loop adds and removes callbacks. The waiting thread removes callbacks only if the loop is closed.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = weakref.ref(loop)  # the loop is a key of `_watchers`, so its value must not keep it
        self._lock = threading.RLock()  # a signal handler may watch a socket too
        self._callbacks: dict[_Watched, Callable[[], object]] = {}
        self._reported: set[_Watched] = set()  # their callbacks have not been called yet, so they are not waited for
        self._waker: socket.socket | None = None  # None if no thread is running

    def watch(self, watched: _Watched, callback: Callable[[], object]) -> None:
        with self._lock:
            self._callbacks[watched] = callback
            self._reported.discard(watched)
            if self._waker is None:
                woken, waker = socket.socketpair()
                # A daemon, because a program may end without closing its loop.
                thread = threading.Thread(target=self._run, args=(woken, waker), name="asyncio sockets", daemon=True)
                try:
                    started(thread)
                except LocalError:
                    del self._callbacks[watched]
                    woken.close()
                    waker.close()
                    raise
                self._waker = waker
            else:
                self._wake()

    def forget(self, watched: _Watched) -> None:
        with self._lock:
            if self._callbacks.pop(watched, None) is not None:
                self._reported.discard(watched)
                self._wake()

    def _wake(self) -> None:
        if self._waker is not None:
            with contextlib.suppress(OSError):  # a full buffer wakes the thread as well
                self._waker.send(b"\0")

    def _run(self, woken: socket.socket, waker: socket.socket) -> None:
        with woken, waker:
            waker.setblocking(False)
            while True:
                with self._lock:
                    waiting = [each for each in self._callbacks if each not in self._reported]
                    if not self._callbacks:
                        self._waker = None
                        return
                if not self._report(self._ready(waiting, woken)):
                    with self._lock:
                        self._callbacks.clear()

    def _ready(self, waiting: list[_Watched], woken: socket.socket) -> list[_Watched]:
        """Wait until at least one socket is ready, or the thread is woken."""
        readers = [woken.fileno(), *(each.descriptor for each in waiting if not each.for_room)]
        writers = [each.descriptor for each in waiting if each.for_room]
        try:
            # On Windows, a refused connection is an exceptional condition, and does not give room to send.
            found = select.select(readers, writers, writers, _LOOK)
        except (OSError, ValueError):  # a socket was closed by another thread; its callback finds out which one
            return waiting
        if woken.fileno() in found[0]:
            woken.recv(4096)
        return [each for each in waiting if each.descriptor in (found[1] + found[2] if each.for_room else found[0])]

    def _report(self, ready: list[_Watched]) -> bool:
        """Let the loop call the callbacks of these sockets; return False if the loop is closed."""
        loop = self._loop()
        if loop is None or loop.is_closed():
            return False
        with self._lock:
            calls = [(each, self._callbacks.get(each)) for each in ready]
            self._reported.update(each for each, callback in calls if callback is not None)
        try:
            for watched, callback in calls:
                if callback is not None:
                    loop.call_soon_threadsafe(self._call, watched, callback)
        except RuntimeError:  # closed meanwhile
            return False
        return True

    def _call(self, watched: _Watched, callback: Callable[[], object]) -> None:
        """Call a callback in the thread of the loop, and watch its socket again."""
        if self._callbacks.get(watched) is not callback:  # forgotten meanwhile
            return
        try:
            callback()
        finally:
            with self._lock:
                if watched in self._reported:
                    self._reported.discard(watched)
                    self._wake()


_watchers: weakref.WeakKeyDictionary[asyncio.AbstractEventLoop, _Watcher] = weakref.WeakKeyDictionary()


def _watcher(loop: asyncio.AbstractEventLoop) -> _Watcher:
    watcher = _watchers.get(loop)
    if watcher is None:
        watcher = _watchers[loop] = _Watcher(loop)
    return watcher
