"""Waiting for what another thread brings about, with a deadline and never for luck."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable

import pytest


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.002)


def interrupted(call: Callable[[], object], when: Callable[[], object] = lambda: True) -> None:
    """Make a call that Ctrl-C has to interrupt; it comes 50 ms after the call has begun and `when` has become true."""

    def interrupt() -> None:
        time.sleep(0.05)
        until(when)
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        call()
    thread.join(10)
