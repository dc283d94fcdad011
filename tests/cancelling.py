"""Tasks that are cancelled at a turn of the event loop of one's choice, and what is left of them."""

from __future__ import annotations

import asyncio
import gc
import math
import os
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, NamedTuple

import pytest

from linkcore.net.transport import TcpTransport
from tests.waiting import until

__all__ = ["Sent", "Trial", "run_cancelled", "turns"]

#: Seconds for anything that has to come to an end.
_SOON = 20.0


class Sent(NamedTuple):
    """Bytes that were handed to the kernel."""

    at: float
    data: bytes


class Trial:
    """What is to be cancelled: within ``with trial:`` in the task. The turns count from there on.

    Attributes:
        left: turns of the loop until the task is cancelled.
        task: the task.
        over: when the block was left.
    """

    def __init__(self, number: int) -> None:
        self.left = number
        self.task: asyncio.Task[None] | None = None
        self.over = math.inf
        self._is_within = False

    def __enter__(self) -> None:
        self._is_within = True

    def __exit__(self, *exc: object) -> None:
        self._is_within = False
        self.over = time.monotonic()

    def turn(self) -> None:
        """The loop has made one."""
        if self._is_within and self.left > 0:
            self.left -= 1
            if self.left == 0:
                assert self.task is not None
                self.task.cancel()


class _Loop(asyncio.SelectorEventLoop):
    """Tells of its turns."""

    def __init__(self, told: Callable[[], None]) -> None:
        super().__init__()
        self._told = told

    def _run_once(self) -> None:
        super()._run_once()  # type: ignore[misc]
        self._told()


def run_cancelled(
    number: int, work: Callable[[Trial], Coroutine[Any, Any, None]], sent: list[Sent]
) -> tuple[bool, list[bytes]]:
    """Run `work` in a loop of its own, and cancel it at a turn. It ends as cancelled then, and nothing of it is left.

    Args:
        number: of the turn, from 1 on, in the block of the trial that `work` gets.
        sent: everything that this process has sent; see the fixture `sends`.

    Returns:
        Whether it was cancelled before it came to its own end, and what was sent after the block was left.
    """
    threads, descriptors = set(threading.enumerate()), _descriptors()
    trial = Trial(number)
    loop = _Loop(trial.turn)
    try:
        trial.task = task = loop.create_task(work(trial))
        loop.run_until_complete(asyncio.wait({task}, timeout=_SOON))
        assert task.done(), "it goes on"
        was_cancelled = trial.left == 0
        assert task.cancelled() == was_cancelled, "a task that was cancelled has come to its own end"
        if not was_cancelled:
            task.result()
        loop.run_until_complete(_nothing_left())
        assert len(loop._selector.get_map()) == 1, "the loop watches more than its own socket"  # type: ignore[attr-defined]
        loop.run_until_complete(loop.shutdown_default_executor())
    finally:
        loop.close()
    until(lambda: set(threading.enumerate()) <= threads, _SOON)
    trial.task = None
    del loop, task
    gc.collect()
    until(lambda: _descriptors() <= descriptors, _SOON)
    return was_cancelled, [each.data for each in tuple(sent) if each.at > trial.over]


async def _nothing_left() -> None:
    end = time.monotonic() + _SOON
    while (tasks := asyncio.all_tasks() - {asyncio.current_task()}) and time.monotonic() < end:
        await asyncio.sleep(0.001)
    assert not tasks


def _descriptors() -> set[str]:
    return set(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else set()


def turns(row: int) -> Iterator[int]:
    """The turns at which to cancel what stands in this row of a table: all of them where tables are tried whole."""
    if os.environ.get("HYPOTHESIS_PROFILE") == "fuzz":
        yield from range(1, 5000)
    else:
        yield from (1 + row % 7, 8 + 3 * (row % 9))


@pytest.fixture
def sends(monkeypatch: pytest.MonkeyPatch) -> list[Sent]:
    """What is sent from now on over TCP; with the moment at which that was begun."""
    sent: list[Sent] = []
    send_some = TcpTransport.send_some

    def keeping(transport: TcpTransport, data: bytes | memoryview) -> int:
        began = time.monotonic()
        number = send_some(transport, data)
        sent.append(Sent(began, bytes(data[:number])))
        return number

    monkeypatch.setattr(TcpTransport, "send_some", keeping)
    return sent
