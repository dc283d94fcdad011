"""Tasks that are cancelled at a turn of the event loop of one's choice, and what is left of them."""

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
from tests.waiting import until

__all__ = ["Sent", "Trial", "Turns", "run_cancelled", "turns"]

T = TypeVar("T")

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


class Turns:
    """Counts the turns of a loop, and cancels a task at one of them."""

    def __init__(self) -> None:
        self._task: asyncio.Task[Any] | None = None
        self._left = 0

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """As `asyncio.run`, in a loop whose turns are counted."""
        loop = _Loop(self._turn)
        try:
            asyncio.set_event_loop(loop)
            return loop.run_until_complete(main)
        finally:
            asyncio.set_event_loop(None)
            loop.close()

    async def cancel(self, use: Callable[[], Awaitable[object]], number: int) -> asyncio.Task[None]:
        """A task that awaits `use()`, after its end; it is cancelled at this turn, from 1 on, if it still runs."""

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
    return was_cancelled


async def _nothing_left() -> None:
    end = time.monotonic() + _SOON
    while (tasks := asyncio.all_tasks() - {asyncio.current_task()}) and time.monotonic() < end:
        await asyncio.sleep(0.001)
    assert not tasks, [each.get_stack() for each in tasks]


@contextlib.contextmanager
def _collecting(made: list[weakref.ref[socket.socket]], others: set[threading.Thread]) -> Iterator[None]:
    """Collect the sockets that are made, but not by other threads: a controller, or what an earlier test has left."""
    init = socket.socket.__init__

    def keeping(self: socket.socket, *args: Any, **named: Any) -> None:
        init(self, *args, **named)
        if threading.current_thread() not in others:
            made.append(weakref.ref(self))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "__init__", keeping)
        yield


def _files() -> set[tuple[str, str]]:
    """Number and name of the files that are open, as far as the system shows them. Sockets are left out."""
    found = set()
    for number in os.listdir("/proc/self/fd") if os.path.isdir("/proc/self/fd") else ():
        with contextlib.suppress(OSError):  # that of the folder itself is closed again
            found.add((number, os.readlink(f"/proc/self/fd/{number}")))
    return {each for each in found if not each[1].startswith("socket:")}


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
