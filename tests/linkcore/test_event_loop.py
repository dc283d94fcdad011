"""Worker threads of one robot for blocking calls, and the errors that awaiting tasks get."""

from __future__ import annotations

import asyncio
import gc
import subprocess
import sys
import threading

import pytest

from linkcore.errors import Closed, LocalError
from linkcore.event_loop import Workers
from linkcore.pending_call import check_wanted
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


def test_queued_call_raises_closed_when_thread_pool_closes() -> None:
    """The error is not CancelledError, because no one cancelled the task."""
    workers = Workers("robot", 1)
    is_over = threading.Event()

    async def main() -> None:
        first = asyncio.create_task(workers.make(lambda: is_over.wait(60.0)))
        second = asyncio.create_task(workers.make(lambda: True))
        await asyncio.sleep(0.1)
        workers.close()
        with pytest.raises(Closed, match="robot was closed"):
            await second
        is_over.set()
        assert await first
        with pytest.raises(Closed, match="robot was closed"):
            await workers.make(lambda: True)

    asyncio.run(main())


def refuse(thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def test_call_is_not_made_later_if_no_thread_could_start(monkeypatch: pytest.MonkeyPatch) -> None:
    workers = Workers("robot", 4)
    is_over, made = threading.Event(), threading.Event()
    waiting = workers.submit(lambda: is_over.wait(60.0))
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", refuse)
        with pytest.raises(LocalError, match="no thread could be started"):
            workers.submit(made.set)
    is_over.set()
    assert waiting.result(60.0)
    assert workers.submit(lambda: True).result(60.0)
    assert not made.is_set()
    workers.close()


def test_stop_does_not_queue_behind_calls_or_other_stops() -> None:
    workers = Workers("robot", 1, stopping=1)
    is_over = threading.Event()
    busy = [workers.submit(lambda: is_over.wait(60.0)), *(workers.stop(lambda: is_over.wait(60.0)) for _ in range(3))]
    assert workers.stop(lambda: True).result(60.0)
    is_over.set()
    assert all(each.result(60.0) for each in busy)
    workers.close()


def test_stop_runs_in_a_reserved_thread_if_none_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    workers = Workers("robot", 1, stopping=1)
    is_over = threading.Event()
    monkeypatch.setattr(threading.Thread, "start", refuse)
    first, second = workers.stop(lambda: is_over.wait(60.0)), workers.stop(lambda: True)
    is_over.set()
    assert first.result(60.0)
    assert second.result(60.0)
    workers.close()


def test_thread_pool_raises_if_its_stop_thread_cannot_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threading.Thread, "start", refuse)
    with pytest.raises(LocalError):
        Workers("robot", 1, stopping=1)


def test_extra_threads_for_stops_end_when_idle() -> None:
    workers = Workers("robot", 1, stopping=1)
    is_over = threading.Event()
    for each in [workers.stop(lambda: is_over.wait(60.0)) for _ in range(5)]:
        is_over.set()
        each.result(60.0)
    until(lambda: sum(thread.name.startswith("robot stop") for thread in threading.enumerate()) == 1)
    workers.close()
    until(lambda: not any(thread.name.startswith("robot stop") for thread in threading.enumerate()))


def test_worker_threads_end_when_the_pool_is_garbage_collected() -> None:
    workers = Workers("dropped", 1, stopping=1)
    assert workers.submit(lambda: True).result(60.0)
    del workers
    gc.collect()
    until(lambda: not any(thread.name.startswith("dropped") for thread in threading.enumerate()))


def test_stop_is_made_although_its_task_is_cancelled() -> None:
    workers = Workers("robot", 1, stopping=1)
    may_go_on, made = threading.Event(), threading.Event()

    def stop() -> None:
        assert may_go_on.wait(60.0)
        check_wanted()
        made.set()

    async def main() -> None:
        task = asyncio.create_task(workers.make_stop(stop))
        await asyncio.sleep(0.1)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        may_go_on.set()

    asyncio.run(main())
    assert made.wait(60.0)
    workers.close()


@pytest.mark.real_time
def test_stops_are_made_before_the_process_exits() -> None:
    program = """
import time
from linkcore.event_loop import Workers

workers = Workers("robot", 1, stopping=1)
workers.submit(lambda: time.sleep(60.0))
workers.stop(lambda: (time.sleep(0.2), print("stopped", flush=True)))
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert ran.stdout == "stopped\n"
