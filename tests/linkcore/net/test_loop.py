"""Many clients of one loop, over real sockets. The test sets the clock."""

from __future__ import annotations

import contextlib
import errno
import gc
import logging
import os
import socket
import struct
import threading
import weakref
from collections.abc import Callable, Iterator

import pytest

import linkcore.clock
from linkcore.errors import BadAddress, BadValue, LinkTimeout
from linkcore.net.loop import Connection, Handler, ListeningPort, SelectorLoop
from tests import platforms
from tests.fakes.clock import Clock
from tests.waiting import until

pytestmark = pytest.mark.real_time

TIMEOUT = 10.0


class Recorder(Handler):
    """Handler that records the events of a connection, and passes received bytes to a function of the test."""

    def __init__(self, connection: Connection, on_data: Callable[[Connection, bytes], object] | None = None) -> None:
        self.connection = connection
        self.data = b""
        self.drains = 0
        self.losses: list[tuple[str, bool]] = []
        self.on_data = on_data

    def data_received(self, data: bytes) -> None:
        assert not self.losses
        self.data += data
        if self.on_data is not None:
            self.on_data(self.connection, data)

    def drained(self) -> None:
        assert self.connection.pending == 0
        self.drains += 1

    def connection_lost(self, reason: str, *, by_peer: bool) -> None:
        assert not self.connection.is_open
        self.losses.append((reason, by_peer))


class Bench:
    """Loop with one port, which the thread of the test serves."""

    def __init__(self, **options: int | float | bool) -> None:
        self.clock = Clock()
        self.loop = SelectorLoop(self.clock)
        self.handlers: list[Recorder] = []
        self.on_data: Callable[[Connection, bytes], object] | None = None
        self.port = self.loop.listen("127.0.0.1", 0, self.accept, **options)  # type: ignore[arg-type]
        self._clients = contextlib.ExitStack()

    def accept(self, connection: Connection) -> Handler | None:
        handler = Recorder(connection, self.on_data)
        self.handlers.append(handler)
        return handler

    def connect(self) -> socket.socket:
        link = socket.create_connection(("127.0.0.1", self.port.number), timeout=TIMEOUT)
        return self._clients.enter_context(link)

    def client(self) -> tuple[socket.socket, Recorder]:
        """Connect a client; return its socket and the handler of its connection."""
        count = len(self.handlers)
        link = self.connect()
        self.serve(lambda: len(self.handlers) > count)
        return link, self.handlers[-1]

    def serve(self, condition: Callable[[], object]) -> None:
        """Serve until the condition is true. The clock does not advance meanwhile."""

        def is_so() -> object:
            self.loop.serve_once(self.clock.now)
            return condition()

        until(is_so)

    def close(self) -> None:
        self._clients.close()
        self.loop.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()
    gc.collect()  # so that the warning of an unclosed socket appears in this test, not in a later one


@contextlib.contextmanager
def bench_with(**options: int | float | bool) -> Iterator[Bench]:
    bench = Bench(**options)
    try:
        yield bench
    finally:
        bench.close()


def is_reset(link: socket.socket) -> bool:
    """Read to the end; return whether the end is a reset."""
    try:
        while link.recv(65536):
            pass
    except ConnectionResetError:
        return True
    return platforms.was_reset(link)


# -- bytes -------------------------------------------------------------------------------------------


def test_clients_get_their_own_replies(bench: Bench) -> None:
    bench.on_data = lambda connection, data: connection.write(data.upper())
    first, _ = bench.client()
    second, _ = bench.client()
    first.sendall(b"one")
    second.sendall(b"two")
    bench.serve(lambda: all(handler.data for handler in bench.handlers))
    assert first.recv(100) == b"ONE"
    assert second.recv(100) == b"TWO"
    assert bench.port.accepted == 2
    assert [handler.connection for handler in bench.handlers] == sorted(
        bench.port.connections, key=lambda connection: connection.peer != first.getsockname()
    )


def test_connection_reports_the_address_of_its_peer(bench: Bench) -> None:
    link, handler = bench.client()
    assert handler.connection.peer == link.getsockname()
    assert handler.connection.name == "{}:{}".format(*link.getsockname())


@pytest.mark.slow
def test_buffered_output_is_sent_later_in_order() -> None:
    with bench_with(output_limit=100_000_000) as bench:
        link, handler = bench.client()
        sent = b"".join(number.to_bytes(4, "big") for number in range(2_000_000))
        for at in range(0, len(sent), 1_000_000):
            handler.connection.write(sent[at : at + 1_000_000])
        assert handler.connection.pending > 0
        assert handler.drains == 0
        received = bytearray()

        def read() -> bool:
            received.extend(link.recv(1 << 20))
            return len(received) == len(sent)

        bench.serve(read)
        bench.serve(lambda: handler.drains)
        assert received == sent
        assert handler.drains == 1
        assert not handler.losses


def test_only_the_client_that_does_not_read_is_reset() -> None:
    with bench_with(output_limit=100_000) as bench:
        sleeper, lost = bench.client()
        reader, kept = bench.client()
        count = 0
        while not lost.losses:
            lost.connection.write(b"x" * 10_000)
            kept.connection.write(b"y" * 10_000)
            assert lost.connection.pending <= 100_000
            count += 10_000
            assert count < 100_000_000
            received = 0
            while received < 10_000:
                received += len(reader.recv(10_000 - received))
            bench.loop.serve_once(bench.clock.now)
        assert [by_peer for _, by_peer in lost.losses] == [False]
        assert "did not read" in lost.losses[0][0]
        assert bench.port.overflowed == 1
        assert is_reset(sleeper)
        assert kept.connection.is_open
        assert not kept.losses
        # Writing to a connection that has ended has no effect.
        lost.connection.write(b"x" * 200_000)
        assert bench.port.overflowed == 1


def test_loop_reads_at_most_one_chunk_at_a_time() -> None:
    with bench_with(chunk=100) as bench:
        sizes: list[int] = []
        bench.on_data = lambda connection, data: sizes.append(len(data))
        link, handler = bench.client()
        link.sendall(b"x" * 250)
        bench.serve(lambda: len(handler.data) == 250)
        assert max(sizes) <= 100


def test_pause_reading_defers_data_until_resume_reading(bench: Bench) -> None:
    link, handler = bench.client()
    handler.connection.pause_reading()
    link.sendall(b"later")
    other, witness = bench.client()
    other.sendall(b"now")
    bench.serve(lambda: witness.data == b"now")
    assert handler.data == b""
    handler.connection.resume_reading()
    bench.serve(lambda: handler.data == b"later")


def test_closed_connection_gets_no_data_of_the_same_poll(bench: Bench) -> None:
    """An event of a poll may belong to a connection that an earlier event of the same poll has closed."""
    links = [bench.client() for _ in range(4)]
    closed: list[Connection] = []

    def close_the_others(connection: Connection, data: bytes) -> None:
        for _, handler in links:
            if handler.connection is not connection:
                handler.connection.close()
                closed.append(handler.connection)

    for link, handler in links:
        handler.on_data = close_the_others
        link.sendall(b"x")
    bench.serve(lambda: sum(len(handler.data) for _, handler in links))
    assert len(closed) == 3
    assert sum(len(handler.data) for _, handler in links) == 1


# -- ends --------------------------------------------------------------------------------------------


def test_connection_lost_reports_close_and_reset_by_the_peer(bench: Bench) -> None:
    closing, closed = bench.client()
    resetting, reset = bench.client()
    resetting.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    closing.close()
    resetting.close()
    bench.serve(lambda: closed.losses and reset.losses)
    assert closed.losses == [("closed by the peer", True)]
    assert [by_peer for _, by_peer in reset.losses] == [True]
    assert not bench.port.connections


def test_closed_client_leaves_no_reference_cycle(bench: Bench) -> None:
    """This allows a host to switch off the garbage collector (docs/real-time.md)."""
    bench.client()[0].close()
    bench.serve(lambda: bench.handlers.pop().losses)
    gc.collect()
    gc.disable()
    try:
        bench.client()[0].close()
        held = weakref.ref(bench.handlers[0])
        bench.serve(lambda: bench.handlers[0].losses)
        bench.handlers.clear()
        assert held() is None
    finally:
        gc.enable()


def test_data_sent_before_a_reset_is_received(bench: Bench) -> None:
    """A client sends a command and closes with unread data; so the next write to it fails before the next read."""
    link, handler = bench.client()
    handler.connection.write(b"never read")
    link.sendall(b"command")
    link.close()

    def fails() -> bool:
        handler.connection.write(b"more")
        return handler.connection._is_deaf

    until(fails)
    assert not handler.losses
    bench.serve(lambda: handler.losses)
    assert handler.data == b"command"
    assert [by_peer for _, by_peer in handler.losses] == [True]


@pytest.mark.parametrize("reset", [False, True])
def test_close_reports_its_reason_after_it_has_returned(bench: Bench, reset: bool) -> None:
    link, handler = bench.client()
    handler.connection.close(reset=reset, reason="enough")
    handler.connection.close()
    assert not handler.connection.is_open
    assert handler.losses == []  # reported later, not within the call of close()
    bench.serve(lambda: handler.losses)
    assert handler.losses == [("enough", False)]
    assert is_reset(link) == reset


def test_finish_delivers_the_last_reply(bench: Bench) -> None:
    def answer(connection: Connection, data: bytes) -> None:
        connection.write(b"bye " * 100_000)
        connection.finish(within=5.0)
        connection.write(b"too late")

    bench.on_data = answer
    link, handler = bench.client()
    link.sendall(b"quit")
    bench.serve(lambda: handler.data)
    assert not handler.connection.is_open
    # Unread input at the time of a plain close would reset the connection.
    link.sendall(b"more" * 1000)
    received = bytearray()

    def read() -> bool:
        data = link.recv(65536)
        received.extend(data)
        return not data

    bench.serve(read)
    assert received == b"bye " * 100_000
    assert handler.data == b"quit"
    assert handler.losses == []
    link.close()
    bench.serve(lambda: handler.losses)
    assert handler.losses == [("closed by the peer", True)]


def test_finish_stops_waiting_after_its_timeout(bench: Bench) -> None:
    with socket.socket() as link:
        # The kernel of this side accepts all of the written data, and keeps most of it.
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.settimeout(TIMEOUT)
        link.connect(("127.0.0.1", bench.port.number))
        bench.serve(lambda: bench.handlers)
        (handler,) = bench.handlers
        handler.connection.write(b"x" * 100_000)
        assert handler.connection.pending == 0
        finish_and_wait_too_long(bench, handler)
        received = bytearray()
        while data := link.recv(65536):
            received.extend(data)
    assert len(received) == 100_000


def finish_and_wait_too_long(bench: Bench, handler: Recorder) -> None:
    handler.connection.finish(within=5.0)
    bench.clock.now += 4.9
    bench.loop.serve_once(bench.clock.now)
    assert handler.losses == []
    bench.clock.now += 0.2
    bench.serve(lambda: handler.losses)
    assert handler.losses == [("closed by this side", False)]


def test_deadline_resets_connection_unless_postponed_or_cleared(bench: Bench) -> None:
    link, late = bench.client()
    _, moved = bench.client()
    _, cleared = bench.client()
    for handler in (late, moved, cleared):
        handler.connection.set_deadline(bench.clock.now + 1.0, "sent half a request and no more")
    moved.connection.set_deadline(bench.clock.now + 3.0, "moved")
    cleared.connection.clear_deadline()
    bench.clock.now += 0.999
    bench.loop.serve_once(bench.clock.now)
    assert not late.losses
    bench.clock.now += 0.001
    bench.loop.serve_once(bench.clock.now)
    assert late.losses == [("sent half a request and no more", False)]
    assert is_reset(link)
    bench.clock.now += 1.999
    bench.loop.serve_once(bench.clock.now)
    assert not moved.losses
    bench.clock.now += 0.001
    bench.loop.serve_once(bench.clock.now)
    assert moved.losses == [("moved", False)]
    bench.clock.now += 100.0
    bench.loop.serve_once(bench.clock.now)
    assert not cleared.losses


def test_deadline_ends_a_wait_without_timeout() -> None:
    loop = SelectorLoop()
    handlers: list[Recorder] = []

    def accept(connection: Connection) -> Handler:
        connection.set_deadline(loop.time() + 0.02, "silent")
        handlers.append(Recorder(connection))
        return handlers[-1]

    port = loop.listen("127.0.0.1", 0, accept)
    with contextlib.closing(loop), socket.create_connection(("127.0.0.1", port.number)):
        until(lambda: (loop.serve_once(None), handlers and handlers[0].losses)[1])
    assert handlers[0].losses == [("silent", False)]


@pytest.mark.parametrize("method", ["data_received", "drained", "connection_lost"])
def test_failing_handler_closes_only_its_connection(
    bench: Bench, method: str, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, bad = bench.client()
    other, good = bench.client()

    def fail(*args: object, **kwargs: object) -> None:
        raise BadValue("a mistake in the handler")

    monkeypatch.setattr(bad, method, fail)
    if method == "drained":
        while not bad.connection.pending:
            bad.connection.write(b"x" * 100_000)
        link.settimeout(0.001)
        with contextlib.suppress(TimeoutError):
            bench.serve(lambda: bench.loop.failures or not link.recv(1 << 20))
    elif method == "connection_lost":
        link.close()
    else:
        link.sendall(b"x")
    with caplog.at_level(logging.ERROR):
        bench.serve(lambda: bench.loop.failures)
    assert bench.loop.failures == 1
    assert any(record.exc_info for record in caplog.records) or method == "drained"
    assert not bad.connection.is_open
    if method != "connection_lost":
        assert bad.losses == [("BadValue in its handler", False)]
    other.sendall(b"still here")
    bench.serve(lambda: good.data == b"still here")


def test_loop_close_ends_connections_and_ports() -> None:
    before = descriptors()
    bench = Bench()
    links = [bench.client() for _ in range(3)]
    bench.close()
    bench.loop.close()
    assert all(handler.losses == [("the server was closed", False)] for _, handler in links)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", bench.port.number), timeout=TIMEOUT)
    assert descriptors() == before


def test_loop_close_with_timeout_sends_buffered_output() -> None:
    loop = SelectorLoop()
    handlers: list[Recorder] = []

    def accept(connection: Connection) -> Handler:
        handlers.append(Recorder(connection))
        return handlers[-1]

    port = loop.listen("127.0.0.1", 0, accept, output_limit=1 << 30)
    received = bytearray()
    with socket.create_connection(("127.0.0.1", port.number), timeout=TIMEOUT) as link:
        until(lambda: (loop.serve_once(loop.time()), handlers)[1])
        handlers[0].connection.write(b"z" * 20_000_000)
        assert handlers[0].connection.pending

        def read() -> None:
            while data := link.recv(1 << 20):
                received.extend(data)
            link.close()

        thread = threading.Thread(target=read)
        thread.start()
        loop.close(within=TIMEOUT)
        thread.join(TIMEOUT)
    assert len(received) == 20_000_000
    assert handlers[0].losses == [("closed by the peer", True)]


def test_loop_close_stops_waiting_after_its_timeout() -> None:
    loop = SelectorLoop()
    port = loop.listen("127.0.0.1", 0, Recorder, output_limit=1 << 30)
    with socket.create_connection(("127.0.0.1", port.number), timeout=TIMEOUT):
        until(lambda: (loop.serve_once(loop.time()), port.connections)[1])
        (connection,) = port.connections
        connection.write(b"z" * 20_000_000)
        begun = linkcore.clock.now()
        loop.close(within=0.1)
        assert 0.05 < linkcore.clock.now() - begun < TIMEOUT
    assert not connection.is_open


# -- accepting clients -------------------------------------------------------------------------------


def test_idle_client_is_evicted_when_its_slot_is_needed() -> None:
    with bench_with(limit=2, idle=10.0) as bench:
        active, first = bench.client()
        bench.clock.now += 1.0
        _, second = bench.client()
        bench.clock.now += 8.0
        with bench.connect() as third:
            bench.serve(lambda: bench.port.refused)
            assert third.recv(10) == b""
        assert bench.port.refused == 1
        # A byte in either direction counts as activity.
        active.sendall(b"x")
        bench.serve(lambda: first.data)
        bench.clock.now += 2.0
        bench.client()
        bench.loop.serve_once(bench.clock.now)
        assert second.losses == [("idle for 10 s, and its slot is needed", False)]
        assert not first.losses
        assert (bench.port.accepted, bench.port.evicted) == (3, 1)
        bench.clock.now += 7.0
        first.connection.write(b"y")
        assert active.recv(10) == b"y"
        bench.clock.now += 3.0
        bench.client()
        assert not first.losses
        assert len(bench.handlers[2].losses) == 1
        assert len(bench.port.connections) == 2


def test_serve_once_accepts_several_clients(bench: Bench) -> None:
    for _ in range(5):
        bench.connect()
    # The clients are connected already, because the kernel has them in its queue.
    bench.loop.serve_once(bench.clock.now)
    assert bench.port.accepted == 5


def test_refused_client_is_closed_immediately(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    before = descriptors()

    def refuse(connection: Connection) -> None:
        connection.write(b"go away")

    monkeypatch.setattr(bench.port, "_accept", refuse)
    link = bench.connect()
    bench.serve(lambda: bench.port.refused)
    assert link.recv(100) == b"go away"
    assert link.recv(100) == b""
    link.close()
    assert not bench.port.connections
    assert descriptors() == before


def test_error_in_accept_closes_only_the_new_client(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    _, kept = bench.client()

    def fail(connection: Connection) -> None:
        connection.write(b"x")
        raise BadValue("a mistake")

    with monkeypatch.context() as patch:
        patch.setattr(bench.port, "_accept", fail)
        link = bench.connect()
        bench.serve(lambda: bench.loop.failures)
    assert is_reset(link) is False
    assert any(record.exc_info for record in caplog.records)
    assert kept.connection.is_open
    bench.client()


def test_client_reset_before_accept_is_ignored(bench: Bench) -> None:
    gone = bench.connect()
    gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    gone.close()
    bench.client()


def test_failed_greeting_closes_the_connection(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    handlers: list[Recorder] = []

    def greet(connection: Connection) -> Handler:
        connection.write(b"x" * (1 << 24))
        handlers.append(Recorder(connection))
        return handlers[-1]

    monkeypatch.setattr(bench.port, "_accept", greet)
    bench.connect()
    bench.serve(lambda: handlers and handlers[0].losses)
    assert not bench.port.connections


def test_loop_delays_accept_when_descriptors_are_exhausted(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    attempts: list[float] = []
    real = bench.port._socket

    class Exhausted:
        def accept(self) -> tuple[socket.socket, object]:
            attempts.append(bench.clock.now)
            raise OSError(errno.EMFILE, "Too many open files")

        def fileno(self) -> int:
            return real.fileno()

        def close(self) -> None:
            real.close()

    with monkeypatch.context() as patch:
        patch.setattr(bench.port, "_socket", Exhausted())
        link = bench.connect()
        bench.serve(lambda: attempts)
        for _ in range(10):
            bench.loop.serve_once(bench.clock.now)
        assert len(attempts) == 1  # although each poll reports the waiting connection
    bench.clock.now += 1.0
    bench.serve(lambda: bench.handlers)
    link.sendall(b"x")
    bench.serve(lambda: bench.handlers[0].data)


def test_port_can_stop_listening_and_listen_again(bench: Bench) -> None:
    _, kept = bench.client()
    number = bench.port.number
    bench.port.refuse()
    bench.port.refuse()
    assert not bench.port.is_listening
    with pytest.raises(ConnectionRefusedError):
        bench.connect()
    bench.port.listen()
    bench.port.listen()
    assert bench.port.number == number
    bench.client()
    assert kept.connection.is_open


def test_paused_port_accepts_no_client_until_resumed(bench: Bench) -> None:
    bench.port.pause()
    waiting = bench.connect()
    waiting.sendall(b"x")
    for _ in range(5):
        bench.loop.serve_once(bench.clock.now)
    assert not bench.handlers
    bench.port.resume()
    bench.serve(lambda: bench.handlers and bench.handlers[0].data == b"x")


@pytest.mark.parametrize(
    ("host", "reached"),
    [("127.0.0.1", "127.0.0.1"), ("localhost", "127.0.0.1"), ("", "127.0.0.1"), ("", "127.1.2.3"), ("::1", "::1")],
)
def test_listen_accepts_clients_on_each_host(host: str, reached: str) -> None:
    if ":" in host and not has_ipv6():
        pytest.skip(platforms.MACHINE)
    loop = SelectorLoop()
    with contextlib.closing(loop):
        port = loop.listen(host, 0, Recorder)
        with socket.create_connection((reached, port.number), timeout=TIMEOUT) as link:
            until(lambda: (loop.serve_once(loop.time()), port.connections)[1])
            (connection,) = port.connections
            assert connection.peer == link.getsockname()[:2]
            assert connection.name.startswith("[::1]:" if ":" in host else f"{connection.peer[0]}:")


def test_listen_on_ipv6_any_accepts_both_families() -> None:
    if not has_ipv6():
        pytest.skip(platforms.MACHINE)
    loop = SelectorLoop()
    with contextlib.closing(loop):
        port = loop.listen("::", 0, Recorder)
        for host in ("127.0.0.1", "::1"):
            with socket.create_connection((host, port.number), timeout=TIMEOUT):
                until(lambda: (loop.serve_once(loop.time()), port.connections)[1])
                (connection,) = port.connections
                assert connection.peer[0] == host
            until(lambda: (loop.serve_once(loop.time()), not port.connections)[1])


def has_ipv6() -> bool:
    try:
        with socket.create_server(("::1", 0), family=socket.AF_INET6):
            return True
    except OSError:
        return False


@pytest.mark.parametrize(
    ("host", "number"), [("192.0.2.1", 0), ("no-such-host.invalid", 0), ("127.0.0.1", 70000), ("nul\0", 0)]
)
def test_listen_rejects_invalid_addresses(host: str, number: int) -> None:
    before = descriptors()
    loop = SelectorLoop()
    with contextlib.closing(loop), pytest.raises(BadAddress, match=f"cannot listen on .*:{number} for tests"):
        loop.listen(host, number, Recorder, purpose="tests")
    assert descriptors() == before


def test_listen_rejects_a_port_in_use(bench: Bench) -> None:
    with pytest.raises(BadAddress, match=f":{bench.port.number}: "):
        bench.loop.listen("127.0.0.1", bench.port.number, Recorder)


def test_port_can_be_reused_immediately() -> None:
    """The port is free at once, although the kernel still remembers connections of the previous loop."""
    for _ in range(2):
        with bench_with() as bench:
            _, handler = bench.client()
            handler.connection.close()
            number = bench.port.number
    loop = SelectorLoop()
    with contextlib.closing(loop):
        assert loop.listen("127.0.0.1", number, Recorder).number == number


# -- time and threads --------------------------------------------------------------------------------


def test_serve_once_does_not_return_before_its_deadline() -> None:
    loop = SelectorLoop()
    with contextlib.closing(loop):
        for seconds in (0.0, 0.0004, 0.002, 0.0153):
            begun = loop.time()
            assert not loop.serve_once(begun + seconds)
            assert loop.time() >= begun + seconds - 1e-6


def test_loop_keeps_deadlines_with_many_descriptors(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process with more than a thousand descriptors uses another selector, which waits whole milliseconds."""
    bench = Bench()
    monkeypatch.setattr(bench.loop, "_select_from", None)
    bench.loop.time = linkcore.clock.now
    with contextlib.closing(bench):
        for seconds in (0.0004, 0.0153):
            end = linkcore.clock.now() + seconds
            until(lambda end=end: (bench.loop.serve_once(end), linkcore.clock.now() >= end)[1])  # type: ignore[misc]
        link = bench.connect()
        link.sendall(b"x")
        until(
            lambda: (bench.loop.serve_once(linkcore.clock.now() + 0.01), bench.handlers and bench.handlers[0].data)[1]
        )


def test_pending_data_is_served_when_deadline_has_passed(bench: Bench) -> None:
    """Even after the deadline, all pending events are served if they take no longer than a millisecond."""
    links = [bench.client() for _ in range(20)]
    for link, _ in links:
        link.sendall(b"x")
    until(lambda: all(readable(handler.connection) for _, handler in links))
    bench.loop.serve_once(bench.clock.now - 10.0)
    assert all(handler.data for _, handler in links)


def test_serve_once_returns_at_deadline_despite_slow_clients(bench: Bench) -> None:
    links = [bench.client() for _ in range(20)]

    def take_long(connection: Connection, data: bytes) -> None:
        bench.clock.now += 0.1

    for link, handler in links:
        handler.on_data = take_long
        link.sendall(b"x")
    until(lambda: all(readable(handler.connection) for _, handler in links))
    bench.loop.serve_once(bench.clock.now + 0.25)
    assert sum(len(handler.data) for _, handler in links) == 3
    bench.serve(lambda: all(handler.data for _, handler in links))


def readable(connection: Connection) -> bool:
    try:
        return bool(connection._socket.recv(1, socket.MSG_PEEK))
    except BlockingIOError:
        return False


class Served:
    """Loop that is served by a dedicated thread."""

    def __init__(self) -> None:
        self.loop = SelectorLoop()
        self._is_over = False
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        while not self._is_over:
            self.loop.serve_once(None)
        self.loop.close()

    def close(self) -> None:
        self._is_over = True
        self.loop.wake()
        self.thread.join(TIMEOUT)
        assert not self.thread.is_alive()


@pytest.fixture
def served() -> Iterator[Served]:
    served = Served()
    yield served
    served.close()


def test_calls_run_in_the_loop_thread(served: Served) -> None:
    seen: list[threading.Thread] = []

    def note() -> None:
        seen.append(threading.current_thread())
        served.loop.call(lambda: seen.append(threading.current_thread()), TIMEOUT)

    served.loop.call(note, TIMEOUT)
    assert seen == [served.thread, served.thread]


@pytest.mark.parametrize("kind", [BadValue, SystemExit, TimeoutError])
def test_call_reraises_errors_in_the_caller(served: Served, kind: type[BaseException]) -> None:
    def fail() -> None:
        raise kind("no")

    with pytest.raises(kind, match="no"):
        served.loop.call(fail, TIMEOUT)
    served.loop.call(lambda: None, TIMEOUT)


def test_call_that_times_out_is_not_executed() -> None:
    loop = SelectorLoop()
    done: list[int] = []
    with contextlib.closing(loop):
        with pytest.raises(LinkTimeout, match=r"within 0\.01 s"):
            loop.call(lambda: done.append(1), 0.01)
        loop.serve_once(loop.time())
        # The caller got LinkTimeout, so the call must not be executed later.
        assert done == []


def test_call_runs_in_the_caller_when_the_loop_is_closed(served: Served) -> None:
    served.close()
    done: list[int] = []
    served.loop.call(lambda: done.append(1), TIMEOUT)
    assert done == [1]


def test_loop_close_executes_waiting_calls() -> None:
    loop = SelectorLoop()
    done: list[int] = []
    caller = threading.Thread(target=lambda: loop.call(lambda: done.append(1), TIMEOUT))
    caller.start()
    until(lambda: loop._calls)
    loop.close()
    caller.join(TIMEOUT)
    assert done == [1]


def test_every_call_runs_once_when_the_loop_closes(served: Served) -> None:
    """Each call runs once, either in the thread of the loop or in the thread of the caller."""
    done: list[int] = []

    def call(first: int) -> None:
        for number in range(first, first + 50):
            served.loop.call(lambda number=number: done.append(number), TIMEOUT)  # type: ignore[misc]

    callers = [threading.Thread(target=call, args=(first,)) for first in range(0, 400, 50)]
    for caller in callers:
        caller.start()
    until(lambda: len(done) > 20)
    served.close()
    for caller in callers:
        caller.join(TIMEOUT)
    assert sorted(done) == list(range(400))


def test_wake_raises_nothing_before_and_after_close(served: Served) -> None:
    served.loop.wake()
    served.loop.call(lambda: None, TIMEOUT)
    served.close()
    served.loop.wake()


def descriptors() -> int:
    if not platforms.IS_LINUX:
        pytest.skip(platforms.LINUX)
    gc.collect()
    return len(os.listdir("/proc/self/fd"))


def test_connections_and_counters_belong_to_their_port(bench: Bench) -> None:
    other: ListeningPort = bench.loop.listen("127.0.0.1", 0, bench.accept)
    with socket.create_connection(("127.0.0.1", other.number)):
        bench.serve(lambda: bench.handlers)
    assert bench.handlers[0].connection.port is other
    assert (bench.port.accepted, other.accepted) == (0, 1)
