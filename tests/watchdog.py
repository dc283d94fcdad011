"""Plugin for pytest that exits the process of a hanging test, so that no test can hang the run.

pytest-timeout raises in the main thread after `timeout` seconds. Two kinds of tests are not ended by it. In the first
kind, the main thread never runs Python code again, because a C call keeps the interpreter lock. The second kind blocks
again after it has failed: pytest drops its timers with the first failure of a test, so a fixture that then joins a
blocked thread would wait forever.

This plugin arms the timer of faulthandler, a C thread that needs no interpreter lock. It arms the timer again after a
failure. After twice `timeout`, it writes the stacks of all threads to stderr and exits. Under pytest-xdist, only one
worker exits: its current test is reported as failed, and another worker continues with the rest. The same time limit
applies to threads that still run after all tests, because the interpreter joins them before it exits.
"""

from __future__ import annotations

import faulthandler
import os
import time
from collections.abc import Generator

import pytest


class Watchdog:
    """Exits the process unless it is cancelled in time."""

    def __init__(self, config: pytest.Config) -> None:
        self._is_debugged = config.getoption("usepdb")
        # While a test runs, pytest also captures descriptor 2. This copy writes to the real stderr.
        self._stderr = os.dup(2)
        # Keep the real clock, because `time.monotonic` is replaced when a test in simulated time fails.
        self._now = time.monotonic
        self._deadline: float | None = None

    def start(self, seconds: float) -> None:
        """Exit after `seconds`; 0 means never."""
        if seconds and not self._is_debugged:
            self._deadline = self._now() + seconds
            self.rearm()

    def rearm(self) -> None:
        """Arm the timer for the remaining time, because pytest has cancelled it or it was not armed yet."""
        if self._deadline is not None:
            left = max(self._deadline - self._now(), 0.001)
            faulthandler.dump_traceback_later(left, file=self._stderr, exit=True)

    def cancel(self) -> None:
        self._deadline = None
        faulthandler.cancel_dump_traceback_later()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self.start(2 * limit_of(item.config, item))
        try:
            return (yield)
        finally:
            self.cancel()

    @pytest.hookimpl(trylast=True)
    def pytest_exception_interact(self) -> None:
        self.rearm()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_teardown(self) -> None:
        """Arm the timer again, because an alarm of pytest-timeout can interrupt the handling of a failure."""
        self.rearm()

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Start the timer: after an alarm during the report of a failure, pytest tears down fixtures only here."""
        self.start(2 * limit_of(session.config))

    @pytest.hookimpl(trylast=True)
    def pytest_unconfigure(self, config: pytest.Config) -> None:
        self.start(2 * limit_of(config))


def limit_of(config: pytest.Config, item: pytest.Item | None = None) -> float:
    """Return the time limit of pytest-timeout for a test, in seconds; 0 means no limit."""
    mark = item.get_closest_marker("timeout") if item is not None else None
    if mark is not None and mark.args:
        return float(mark.args[0])
    option = config.getoption("timeout")
    return float(config.getini("timeout") or 0 if option is None else option)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Watchdog(config), "watchdog")
