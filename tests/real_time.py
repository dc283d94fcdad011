"""Plugin for pytest: only tests with the mark `real_time` may use the operating system, and they must stay few.

A test that connects or binds a real socket, starts a real thread or a process, or sends a signal depends on the load of
the computer. It should run in simulated time (`simulated_time`), or have the mark `real_time` if it cannot.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
import threading
from collections.abc import Callable, Generator

import pytest

__all__ = ["SHARE"]

#: Largest allowed share of tests with the mark.
SHARE = 0.1
#: Descriptions of events of `sys.addaudithook`.
_EVENTS = {
    "socket.bind": "binds a socket",
    "socket.connect": "connects a socket",
    "subprocess.Popen": "starts a process",
    "os.fork": "starts a process",
    "os.posix_spawn": "starts a process",
    "os.kill": "sends a signal",
    "signal.pthread_kill": "sends a signal",
}


class RealTime:
    """Records the system calls of the running test in its own threads, but not in threads left by earlier tests."""

    def __init__(self) -> None:
        self._noted: set[str] | None = None
        self._others: set[int | None] = set()
        sys.addaudithook(self._note)
        self._start = threading.Thread.start
        threading.Thread.start = self._starting()  # type: ignore[assignment]

    def _note(self, event: str, arguments: object) -> None:
        if self._noted is not None and event in _EVENTS and threading.get_ident() not in self._others:
            self._noted.add(_EVENTS[event])

    def _starting(self) -> Callable[[threading.Thread], None]:
        start = self._start

        def starting(thread: threading.Thread) -> None:
            # Simulated time replaces this function. The thread that draws the progress of a command is allowed,
            # because it ends with its block and no test result depends on it.
            is_progress = thread.name == "progress"
            if not is_progress and self._noted is not None and threading.get_ident() not in self._others:
                self._noted.add("starts a thread")
            start(thread)

        return starting

    def pytest_unconfigure(self) -> None:
        threading.Thread.start = self._start  # type: ignore[method-assign]

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None, None, None]:
        self._others = {thread.ident for thread in threading.enumerate()} - {threading.main_thread().ident}
        is_ours = item.config.rootpath / "tests" in item.path.parents
        self._noted = set() if is_ours and not is_marked(item) else None
        yield

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, None, None]:
        try:
            yield
        finally:
            noted, self._noted = self._noted, None
        if noted:
            text = f"it {' and '.join(sorted(noted))}: mark it simulated_time, or real_time if it cannot be"
            pytest.fail(text, pytrace=False)


def is_marked(item: pytest.Item) -> bool:
    return item.get_closest_marker("real_time") is not None


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(RealTime(), "real_time")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Run the examples of pages in simulated time (on Linux), because they wait for arms and robots."""
    with contextlib.ExitStack() as block:
        if item.path.suffix == ".md" and sys.platform == "linux":
            block.enter_context(importlib.import_module("linkcore.simulated").simulated_time())
        return (yield)
