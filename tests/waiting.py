"""Waits for an effect of another thread, with a deadline."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable

import pytest


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"the condition did not become true within {seconds:g} s"
        time.sleep(0.002)


def threads_named(part: str) -> list[str]:
    """Return the names of the threads that contain `part`, except the timer of pytest-timeout, named after the test."""
    names = [thread.name for thread in threading.enumerate()]
    return [name for name in names if part in name and not name.startswith("pytest_timeout")]


def interrupted(call: Callable[[], object], when: Callable[[], object] = lambda: True) -> None:
    """Make a call that Ctrl-C must interrupt, 50 ms after the call has started to wait and `when` is true."""
    main = threading.main_thread().ident or 0
    begun: list[bool] = []
    ended = threading.Event()

    def begin() -> None:
        begun.append(True)
        call()

    def waits() -> bool:
        return bool(begun) and sys._current_frames()[main].f_globals["__name__"] == "threading"

    def send() -> None:
        if sys.platform == "win32":
            # Windows delivers Ctrl-C in a new thread, whose handler sets a flag and an event for the main thread.
            signal.raise_signal(signal.SIGINT)
        else:
            signal.pthread_kill(main, signal.SIGINT)

    def interrupt() -> None:
        until(lambda: waits() and when())
        time.sleep(0.05)
        send()
        while not ended.wait(5.0):  # repeat: a signal that arrives just before a system call does not end the call
            send()

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            begin()
    finally:
        ended.set()
        thread.join(10)
