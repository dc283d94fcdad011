"""Programs on a robot are stopped when this process ends without closing the robot object."""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from linkcore import process
from tests import platforms


class Part:
    """Part of a robot object that has started programs."""

    def __init__(self) -> None:
        self.reasons: list[str] = []
        self.is_end = False

    def abandon(self, why: str, is_end: bool) -> None:
        self.reasons.append(why)
        self.is_end = is_end


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """Registered callbacks by event, in a simulated notebook process that does not watch any part yet."""
    found: dict[str, Any] = {}
    shell = SimpleNamespace(events=SimpleNamespace(register=found.__setitem__))
    monkeypatch.setattr(process, "_watched", {})
    monkeypatch.setattr(atexit, "register", lambda call, *of: found.update(exit=lambda: call(*of)))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setattr(os, "register_at_fork", lambda after_in_child: found.update(fork=after_in_child), raising=False)
    before = signal.getsignal(signal.SIGTERM)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    yield found
    signal.signal(signal.SIGTERM, before)


def test_exit_aborts_only_connections_that_are_still_open(events: dict[str, Any]) -> None:
    kept, closed = Part(), Part()
    process.abandon_at_end(kept)
    process.abandon_at_end(closed)
    process.forget(closed)
    events["exit"]()
    assert kept.reasons == ["the interpreter exits"]
    assert kept.is_end
    assert closed.reasons == []


@pytest.mark.real_time
def test_exit_abandons_open_parts_while_a_thread_opens_and_closes_others(events: dict[str, Any]) -> None:
    """At the switch interval of the test, a copy of a WeakSet fails in about one of forty exits."""
    kept, has_ended = Part(), threading.Event()
    process.abandon_at_end(kept)

    def open_and_close() -> None:
        while not has_ended.is_set():
            part = Part()
            process.abandon_at_end(part)
            process.forget(part)

    thread = threading.Thread(target=open_and_close)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread.start()
    try:
        for _ in range(1000):
            events["exit"]()
    finally:
        has_ended.set()
        thread.join()
        sys.setswitchinterval(interval)
    assert len(kept.reasons) == 1000


def test_sigterm_abandons_open_connections_and_ends_the_process(
    events: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    part, sent = Part(), []
    process.abandon_at_end(part)
    handler = signal.getsignal(signal.SIGTERM)
    assert callable(handler)
    monkeypatch.setattr(os, "kill", lambda pid, number: sent.append((pid, number)))
    handler(signal.SIGTERM, None)
    assert part.reasons == ["the process received SIGTERM"]
    assert sent == [(os.getpid(), signal.SIGTERM)]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_own_sigterm_handler_is_kept(events: dict[str, Any]) -> None:
    def own(number: int, frame: object) -> None: ...

    signal.signal(signal.SIGTERM, own)
    process.abandon_at_end(Part())
    assert signal.getsignal(signal.SIGTERM) is own


@pytest.mark.parametrize(("error", "is_abandoned"), [(KeyboardInterrupt(), True), (ValueError(), False), (None, False)])
def test_interrupted_notebook_cell_abandons_its_connections(
    events: dict[str, Any], error: BaseException | None, is_abandoned: bool
) -> None:
    part = Part()
    process.abandon_at_end(part)
    events["post_run_cell"](SimpleNamespace(error_in_exec=error))
    assert part.reasons == (["the notebook cell was interrupted"] if is_abandoned else [])
    assert not part.is_end


@platforms.needs_fork
def test_forked_child_does_not_abandon_parts(events: dict[str, Any]) -> None:
    part = Part()
    process.abandon_at_end(part)
    events["fork"]()
    events["exit"]()
    assert part.reasons == []


_FORKS_WHILE_A_THREAD_HOLDS_A_LOCK = """
import os, threading, warnings
from linkcore.process import free_in_child

warnings.simplefilter("ignore")
lock, is_held, is_over = threading.RLock(), threading.Event(), threading.Event()
free_in_child(lock)

def hold():
    with lock:
        is_held.set()
        is_over.wait(60)

threading.Thread(target=hold).start()
is_held.wait()
child = os.fork()
if child == 0:
    os._exit(0 if lock.acquire(timeout=10) else 1)
_, status = os.waitpid(child, 0)
is_over.set()
print(os.waitstatus_to_exitcode(status), lock.acquire(timeout=60))
"""


@pytest.mark.real_time
@platforms.needs_fork
def test_free_in_child_frees_the_lock_in_a_forked_child_only() -> None:
    command = [sys.executable, "-c", _FORKS_WHILE_A_THREAD_HOLDS_A_LOCK]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.stdout == "0 True\n", done.stderr
