"""Sockets of an event loop that cannot wait for sockets itself, such as the default loop of Windows."""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import pytest

from linkcore.errors import ConnectFailed, ConnectionLost, LocalError
from linkcore.net.awaited import AwaitedTcp
from linkcore.net.watching import forget, watch
from tests.waiting import threads_named, until

# Real time, because the default loop of Windows waits in the kernel, which does not know simulated sockets.
pytestmark = pytest.mark.real_time

TIMEOUT = 30.0

if sys.platform == "win32":
    Loop: Any = asyncio.ProactorEventLoop
else:

    class Loop(asyncio.SelectorEventLoop):
        """Event loop without the methods that the default loop of Windows does not have."""

    def _missing(*arguments: Any) -> Any:
        raise NotImplementedError

    for _name in ("add_reader", "remove_reader", "add_writer", "remove_writer"):
        setattr(Loop, _name, _missing)


@pytest.fixture
def run() -> Iterator[Callable[[Coroutine[Any, Any, object]], object]]:
    """Return a function that runs a coroutine in such a loop."""
    loop = Loop()

    def run(coroutine: Coroutine[Any, Any, object]) -> object:
        return loop.run_until_complete(asyncio.wait_for(coroutine, TIMEOUT))

    yield run
    loop.close()
    until(lambda: not threads_named("asyncio sockets"))


def test_transport_connects_and_receives(run: Callable[..., object]) -> None:
    async def talk(server: socket.socket) -> bytes:
        transport = AwaitedTcp("127.0.0.1", server.getsockname()[1], silence=TIMEOUT)
        await transport.connect(TIMEOUT)
        peer, _ = server.accept()
        with peer:
            transport.send(b"hello", TIMEOUT)
            peer.sendall(peer.recv(10).upper())
            received, _ = await transport.receive_awaited(TIMEOUT)
        with pytest.raises(ConnectionLost, match="closed the connection"):
            await transport.receive_awaited(TIMEOUT)
        transport.abort()
        return received

    with socket.create_server(("127.0.0.1", 0)) as server:
        assert run(talk(server)) == b"HELLO"


def test_refused_connection_raises(run: Callable[..., object]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(ConnectFailed):
        run(AwaitedTcp("127.0.0.1", port, silence=1.0).connect(TIMEOUT))


def test_callback_is_called_until_the_bytes_are_read(run: Callable[..., object]) -> None:
    async def read(ours: socket.socket, theirs: socket.socket) -> bytes:
        read: list[bytes] = []
        whole = asyncio.Event()

        def readable() -> None:
            read.append(ours.recv(1))
            if len(read) == 5:
                whole.set()

        watch(asyncio.get_running_loop(), ours.fileno(), readable)
        theirs.sendall(b"abc")
        await asyncio.sleep(0)
        theirs.sendall(b"de")
        await whole.wait()
        forget(asyncio.get_running_loop(), ours.fileno())
        return b"".join(read)

    ours, theirs = socket.socketpair()
    with ours, theirs:
        assert run(read(ours, theirs)) == b"abcde"


def test_forgotten_callback_is_not_called(run: Callable[..., object]) -> None:
    async def forgotten(ours: socket.socket, theirs: socket.socket) -> list[str]:
        loop, called = asyncio.get_running_loop(), asyncio.Event()
        calls: list[str] = []

        def first() -> None:
            calls.append("first")
            forget(loop, theirs.fileno())
            loop.call_later(0.05, called.set)

        watch(loop, ours.fileno(), first)
        watch(loop, theirs.fileno(), lambda: calls.append("second"))
        forget(loop, theirs.fileno())
        theirs.sendall(b"a")
        ours.sendall(b"b")
        await called.wait()
        forget(loop, ours.fileno())
        return calls

    ours, theirs = socket.socketpair()
    with ours, theirs:
        calls = run(forgotten(ours, theirs))
    assert isinstance(calls, list)
    assert set(calls) == {"first"}


def test_callback_is_not_called_if_forgotten_after_its_report(
    run: Callable[..., object], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def forgotten(ours: socket.socket, theirs: socket.socket) -> list[str]:
        loop, called = asyncio.get_running_loop(), asyncio.Event()
        calls: list[str] = []
        reported = threading.Semaphore(0)
        call_soon = loop.call_soon_threadsafe

        def report(*arguments: Any) -> object:
            handle = call_soon(*arguments)
            reported.release()
            return handle

        def first() -> None:
            calls.append("first")
            ours.recv(1)
            forget(loop, theirs.fileno())
            loop.call_soon(called.set)  # runs after the call for the other socket

        with monkeypatch.context() as patch:
            patch.setattr(loop, "call_soon_threadsafe", report)
            theirs.sendall(b"a")
            ours.sendall(b"b")
            watch(loop, ours.fileno(), first)
            watch(loop, theirs.fileno(), lambda: calls.append("second"))
            # The loop is blocked until both sockets are reported.
            assert reported.acquire(timeout=TIMEOUT)
            assert reported.acquire(timeout=TIMEOUT)
        await called.wait()
        forget(loop, ours.fileno())
        return calls

    ours, theirs = socket.socketpair()
    with ours, theirs:
        assert run(forgotten(ours, theirs)) == ["first"]


def test_watch_raises_and_recovers_when_no_thread_can_be_started(
    run: Callable[..., object], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    async def watch_twice(ours: socket.socket, theirs: socket.socket) -> None:
        loop, readable = asyncio.get_running_loop(), asyncio.Event()
        with monkeypatch.context() as patch:
            patch.setattr(threading.Thread, "start", refuse)
            with pytest.raises(LocalError, match="no thread could be started for asyncio sockets"):
                watch(loop, ours.fileno(), readable.set)
        watch(loop, ours.fileno(), readable.set)
        theirs.sendall(b"a")
        await readable.wait()
        forget(loop, ours.fileno())

    ours, theirs = socket.socketpair()
    with ours, theirs:
        run(watch_twice(ours, theirs))
