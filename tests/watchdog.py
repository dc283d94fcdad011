"""Ends the process of a test that nothing else can end, so that no test can hang the run.

pytest-timeout raises in the main thread after `timeout` seconds. Two tests get past it: one whose main thread never
runs Python code again (a C call that keeps the interpreter lock), and one that blocks again after it has failed. pytest
drops its timers with the first failure of a test, so a fixture that then joins a blocked thread would wait for ever.

This plugin arms faulthandler's timer, a C thread that needs no interpreter lock, and arms it again after a failure.
After twice `timeout` it writes the stacks of all threads to stderr and exits. Under pytest-xdist that is one worker:
the test that it ran is reported as failed, and another worker goes on with the rest. The same time is left to threads
that are still running when all tests are over, because the interpreter joins them before it exits.
"""

from __future__ import annotations

import faulthandler
import os
import time
from collections.abc import Generator

import pytest

#: For threads that are still running when all tests are over, which the interpreter waits for before it exits.
EXIT_SECONDS = 5.0


class Watchdog:
    """Exits the process unless it is cancelled in time."""

    def __init__(self, config: pytest.Config) -> None:
        self._is_debugged = config.getoption("usepdb")
        # While a test runs, its output is captured from descriptor 2 as well. This one leads out of the capture.
        self._stderr = os.dup(2)
        # That of a test in simulated time, by which pytest reports a failure, is another one.
        self._now = time.monotonic
        self._deadline: float | None = None

    def start(self, seconds: float) -> None:
        """Exit after that many seconds; 0 is never."""
        if seconds and not self._is_debugged:
            self._deadline = self._now() + seconds
            self.rearm()

    def rearm(self) -> None:
        """Arm the timer for what is left; pytest has cancelled it, or there is none yet."""
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
        """Once more: an alarm of pytest-timeout that comes while a failure is handled ends what is called there."""
        self.rearm()

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Where an alarm comes while a failure is reported, the run breaks off, and fixtures are torn down here."""
        self.start(2 * limit_of(session.config))

    @pytest.hookimpl(trylast=True)
    def pytest_unconfigure(self, config: pytest.Config) -> None:
        self.start(2 * limit_of(config))


def limit_of(config: pytest.Config, item: pytest.Item | None = None) -> float:
    """The seconds that pytest-timeout gives a test; 0 for no limit."""
    mark = item.get_closest_marker("timeout") if item is not None else None
    if mark is not None and mark.args:
        return float(mark.args[0])
    option = config.getoption("timeout")
    return float(config.getini("timeout") or 0 if option is None else option)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Watchdog(config), "watchdog")
