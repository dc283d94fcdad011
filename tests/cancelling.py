"""Cancel tasks at a chosen step of the event loop, and check that they leave no tasks, threads, sockets or files."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import math
import os
import socket
import threading
import time
import weakref
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from typing import Any, NamedTuple, TypeVar

import pytest

from linkcore.net.transport import TcpTransport
from tests.matrix import IS_WHOLE
from tests.waiting import until

__all__ = ["Sent", "Trial", "Turns", "run_cancelled", "turns"]

T = TypeVar("T")

#: Time limit for everything that must end, in seconds.
_SOON = 20.0


class Sent(NamedTuple):
    """Bytes that were passed to the kernel, and the time at which the call started."""

    at: float
    data: bytes


class Trial:
    """Block to cancel: ``with trial:`` in the task. The steps of the loop are counted within this block.

    Attributes:
        left: Number of steps of the loop until the task is cancelled.
        task: Task that runs the block.
        over: Time at which the block was left.
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
        """Count one step of the loop, and cancel the task at the chosen one."""
        if self._is_within and self.left > 0:
            self.left -= 1
            if self.left == 0:
                assert self.task is not None
                self.task.cancel()


class Turns:
    """Event loop that counts its steps, and cancels a task at one of them."""

    def __init__(self) -> None:
        self._task: asyncio.Task[Any] | None = None
        self._left = 0

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine as `asyncio.run` does, in a loop whose steps are counted."""
        loop = _Loop(self._turn)
        try:
            asyncio.set_event_loop(loop)
            return loop.run_until_complete(main)
        finally:
            asyncio.set_event_loop(None)
            loop.close()

    async def cancel(self, use: Callable[[], Awaitable[object]], number: int) -> asyncio.Task[None]:
        """Await `use()` in a task, and cancel it at step `number` (from 1) if it still runs; return the task."""

        async def work() -> None:
            await use()

        self._left = number
        self._task = task = asyncio.create_task(work())
        await asyncio.wait({task})
        self._task = None
        return task

    def _turn(self) -> None:
        if self._task is not None:
            self._left -= 1
            if self._left == 0:
                self._task.cancel()


class _Loop(asyncio.SelectorEventLoop):
    """Event loop that calls a function after each step."""

    def __init__(self, told: Callable[[], None]) -> None:
        super().__init__()
        self._told = told

    def _run_once(self) -> None:
        super()._run_once()  # type: ignore[misc]
        self._told()


def run_cancelled(
    number: int, work: Callable[[Trial], Coroutine[Any, Any, None]], sent: list[Sent]
) -> tuple[bool, list[bytes]]:
    """Run `work` in its own loop and cancel it at one step; check that it ends as cancelled and leaves nothing.

    Args:
        number: Number of the step, from 1, within the block of the trial that is passed to `work`.
        sent: Data sent by this process; see the fixture `sends`.

    Returns:
        Whether it was cancelled before it ended on its own, and the data sent after the block was left.
    """
    threads, files = set(threading.enumerate()), _files()
    made: list[weakref.ref[socket.socket]] = []
    trial = Trial(number)
    with _collecting(made, threads - {threading.current_thread()}):
        was_cancelled = _run(work, threads, trial)
    gc.collect()
    left = [each for each in (ref() for ref in made) if each is not None and each.fileno() >= 0]
    assert not left, f"sockets are left: {left}"
    assert _files() <= files, f"files are left: {_files() - files}"
    return was_cancelled, [each.data for each in tuple(sent) if each.at > trial.over]


def _run(work: Callable[[Trial], Coroutine[Any, Any, None]], threads: set[threading.Thread], trial: Trial) -> bool:
    loop = _Loop(trial.turn)
    try:
        trial.task = task = loop.create_task(work(trial))
        loop.run_until_complete(asyncio.wait({task}, timeout=_SOON))
        assert task.done(), "the task is still running"
        was_cancelled = trial.left == 0
        assert task.cancelled() == was_cancelled, "a cancelled task has ended on its own"
        if not was_cancelled:
            task.result()
        loop.run_until_complete(_nothing_left())
        assert len(loop._selector.get_map()) == 1, "the loop watches more than its own socket"  # type: ignore[attr-defined]
        loop.run_until_complete(loop.shutdown_default_executor())
    finally:
        loop.close()
    until(lambda: set(threading.enumerate()) <= threads, _SOON)
    trial.task = None
    return was_cancelled


async def _nothing_left() -> None:
    end = time.monotonic() + _SOON
    while (tasks := asyncio.all_tasks() - {asyncio.current_task()}) and time.monotonic() < end:
        await asyncio.sleep(0.001)
    assert not tasks, [each.get_stack() for each in tasks]


@contextlib.contextmanager
def _collecting(made: list[weakref.ref[socket.socket]], others: set[threading.Thread]) -> Iterator[None]:
    """Collect new sockets, except those of `others`: threads of a controller, or threads left by an earlier test."""
    init = socket.socket.__init__

    def keeping(self: socket.socket, *args: Any, **named: Any) -> None:
        init(self, *args, **named)
        if threading.current_thread() not in others:
            made.append(weakref.ref(self))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "__init__", keeping)
        yield


def _files() -> set[tuple[str, str]]:
    """Return the number and name of each open file, without sockets. Empty if the system does not list them."""
    found = set()
    for number in os.listdir("/proc/self/fd") if os.path.isdir("/proc/self/fd") else ():
        with contextlib.suppress(OSError):  # the descriptor of the folder itself is closed again
            found.add((number, os.readlink(f"/proc/self/fd/{number}")))
    return {each for each in found if not each[1].startswith("socket:")}


def turns(row: int) -> Iterator[int]:
    """Yield the steps at which to cancel this row of a table: all steps in the profile `fuzz`, otherwise two."""
    if IS_WHOLE:
        yield from range(1, 5000)
    else:
        yield from (1 + row % 7, 8 + 3 * (row % 9))


@pytest.fixture
def sends(monkeypatch: pytest.MonkeyPatch) -> list[Sent]:
    """List of the data sent over TCP from now on, with the start time of each call."""
    sent: list[Sent] = []
    send_some = TcpTransport.send_some

    def keeping(transport: TcpTransport, data: bytes | memoryview) -> int:
        began = time.monotonic()
        number = send_some(transport, data)
        sent.append(Sent(began, bytes(data[:number])))
        return number

    monkeypatch.setattr(TcpTransport, "send_some", keeping)
    return sent
