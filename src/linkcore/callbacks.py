"""The thread in which a robot calls its user's callbacks: done callbacks, `on_stop`, `on_text`.

No lock is held meanwhile and no robot is kept waiting, so a callback may command the robot, wait for a motion, close
the robot, be slow or raise. One that is slow keeps those after it waiting, and nothing else.
"""

from __future__ import annotations

import logging
import threading
import weakref
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

from .errors import LocalError
from .threads import started

__all__ = ["CallbackThread"]

_log = logging.getLogger(__name__)

_Call = tuple[Callable[..., object], tuple[Any, ...]]
#: Key of the thread: `dict.setdefault` is atomic, so that only one is started.
_ONE = "one"
# Re-entrant, unlike `queue.Queue`: a signal handler may put while its thread is putting.
_Calls = SimpleQueue[_Call | None]


class CallbackThread:
    """Calls one after the other; the thread is started for the first of them.

    Args:
        name: of the thread.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._calls: _Calls = SimpleQueue()
        self._thread: dict[str, threading.Thread] = {}
        weakref.finalize(self, self._calls.put, None)

    def call(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call `function(*arguments)` soon. Where the system has no thread left, the log says so instead."""
        if _ONE not in self._thread:
            thread = threading.Thread(target=_run, args=(self._calls,), name=self._name, daemon=True)
            if self._thread.setdefault(_ONE, thread) is thread:
                try:
                    started(thread)
                except LocalError:
                    self._thread.pop(_ONE, None)
                    _log.exception("%r is not called", function)
                    return
        self._calls.put((function, arguments))

    def close(self, timeout: float) -> None:
        """Make the calls that wait, and end the thread, within `timeout` seconds. Idempotent."""
        thread = self._thread.pop(_ONE, None)
        if thread is None:
            return
        self._calls.put(None)
        if thread is not threading.current_thread():
            thread.join(max(timeout, 0.0))


def _run(calls: _Calls) -> None:
    while (call := calls.get()) is not None:
        function, arguments = call
        try:
            function(*arguments)
        except BaseException:
            # Also SystemExit and KeyboardInterrupt: they would end this thread, and with it all later callbacks.
            _log.exception("%r raised; the callbacks after it are called all the same", function)
        del call, function, arguments
