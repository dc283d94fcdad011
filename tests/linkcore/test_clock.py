"""The clock of the library, which includes time in suspend, and the waits that use this clock."""

from __future__ import annotations

import queue
import sys
import threading
import time
from concurrent.futures import Future
from types import SimpleNamespace

import pytest

from linkcore import clock
from linkcore.clock import Stamp
from linkcore.streaming.packet_queue import is_older
from tests import platforms
from tests.fakes.clock import Suspend

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def suspend(monkeypatch: pytest.MonkeyPatch) -> Suspend:
    return Suspend(monkeypatch)


@pytest.mark.real_time
def test_now_reads_a_clock_that_includes_a_suspend() -> None:
    def read() -> float:
        if sys.platform == "win32":
            return time.perf_counter()
        return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))

    before = read()
    assert before <= clock.now() <= read()


def test_now_reads_simulated_clock_when_used_as_default_argument() -> None:
    def read(now: object = clock.now) -> float:
        assert callable(now)
        return float(now())

    begun = read(), time.monotonic()
    time.sleep(7200.0)
    assert read() - begun[0] == pytest.approx(7200.0, abs=1e-3)
    assert read() - begun[0] == pytest.approx(time.monotonic() - begun[1], abs=1e-3)


@platforms.needs_posix_clocks
def test_clock_gettime_is_simulated() -> None:
    begun = [time.clock_gettime(which) for which in (time.CLOCK_MONOTONIC, time.CLOCK_REALTIME)]
    busy = time.clock_gettime(time.CLOCK_PROCESS_CPUTIME_ID)
    time.sleep(100.0)
    after = [time.clock_gettime(which) for which in (time.CLOCK_MONOTONIC, time.CLOCK_REALTIME)]
    assert after == pytest.approx([each + 100.0 for each in begun], abs=1e-3)
    assert time.clock_gettime(time.CLOCK_REALTIME) == pytest.approx(time.time(), abs=1e-3)
    assert time.clock_gettime(time.CLOCK_PROCESS_CPUTIME_ID) - busy < 100.0


def test_remaining_time_is_never_negative_after_the_deadline() -> None:
    assert clock.left(clock.now() + 10.0) == pytest.approx(10.0, abs=1e-3)
    assert clock.left(clock.now() - 10.0) == 0.0


@pytest.mark.parametrize("timeout", [None, float("inf"), 0.0, -1.0, 0.5, 3.5])
def test_wait_returns_whether_the_event_happened(timeout: float | None) -> None:
    event = threading.Event()
    if timeout is not None and timeout < 100.0:
        begun = clock.now()
        assert not clock.wait(event.wait, timeout)
        assert clock.now() - begun == pytest.approx(max(timeout, 0.0), abs=1e-3)
    threading.Timer(0.3, event.set).start()
    assert clock.wait(event.wait, timeout) == (timeout is None or timeout > 0.3)
    assert clock.wait(event.wait, 10.0)


def test_wait_ends_when_a_suspend_passes_its_deadline(suspend: Suspend) -> None:
    waited: list[float | None] = []

    def attempt(seconds: float | None) -> None:
        waited.append(seconds)
        suspend(100.0)

    begun = time.monotonic()
    assert not clock.wait(attempt, 60.0)
    assert waited == [clock._SLICE]
    assert time.monotonic() - begun < 1.0


def test_sleep_ends_when_a_suspend_passes_its_end(suspend: Suspend) -> None:
    begun = time.monotonic()
    threading.Timer(2.5, suspend, [100.0]).start()
    clock.sleep(60.0)
    # It ends with the system call during which the suspend happened.
    assert 2.5 <= time.monotonic() - begun <= 2.5 + max(clock._SLICE, 0.5) + 0.01


@pytest.mark.parametrize("seconds", [-1.0, 0.0, 0.25, 7.25])
def test_sleep_lasts_for_the_requested_time(seconds: float) -> None:
    begun = clock.now()
    clock.sleep(seconds)
    assert clock.now() - begun == pytest.approx(max(seconds, 0.0), abs=1e-3)


def test_wait_without_timeout_is_divided_into_short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "ENDLESS", 0.1)
    monkeypatch.setattr(clock, "_SLICE", 0.1)
    waited: list[float | None] = []

    def attempt(seconds: float | None) -> bool:
        waited.append(seconds)
        return len(waited) == 3

    assert clock.wait(attempt)
    assert waited == [0.1, 0.1, 0.1]


def test_get_raises_empty_when_time_is_up() -> None:
    items: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    with pytest.raises(queue.Empty):
        clock.get(items, 3.5)
    items.put(None)
    assert clock.get(items, 3.5) is None
    threading.Timer(2.5, items.put, ["x"]).start()
    assert clock.get(items) == "x"


def test_is_done_returns_bool_for_failed_and_cancelled_futures() -> None:
    failed, cancelled, pending = Future[None](), Future[None](), Future[None]()
    failed.set_exception(TimeoutError("of its own"))
    cancelled.cancel()
    assert clock.is_done(failed, 3.5)
    assert clock.is_done(cancelled, 3.5)
    assert not clock.is_done(pending, 3.5)
    threading.Timer(2.5, pending.set_result, [None]).start()
    assert clock.is_done(pending)


def test_join_returns_whether_the_thread_has_ended() -> None:
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    assert not clock.join(thread, 3.5)
    over.set()
    assert clock.join(thread)


def test_join_counts_a_thread_that_never_began_as_ended() -> None:
    assert clock.join(threading.Thread(target=lambda: None), 5.0)


def test_join_waits_for_a_thread_that_is_about_to_begin() -> None:
    release = threading.Event()
    thread = threading.Thread(target=release.wait)
    threading.Timer(0.02, thread.start).start()
    assert not clock.join(thread, 0.5)
    release.set()
    assert clock.join(thread, 5.0)


def test_join_rejects_the_current_thread() -> None:
    with pytest.raises(RuntimeError, match="current thread"):
        clock.join(threading.current_thread(), 0.1)


def test_age_of_a_stamp_includes_a_suspend(suspend: Suspend) -> None:
    stamp = Stamp.now()
    assert not is_older(SimpleNamespace(received=stamp), 60.0)
    suspend(100.0)
    assert stamp.age >= 100.0
    assert is_older(SimpleNamespace(received=stamp), 60.0)
