"""TCP connections with deadlines: all failures of a peer, and the errors that they raise."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import select
import socket
import struct
import threading
import time
import weakref
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

import linkcore.clock
import linkcore.net.transport
from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout, RemoteError
from linkcore.net.awaited import AwaitedTcp
from linkcore.net.transport import TcpTransport
from tests import platforms
from tests.witnesses import sockets_made

pytestmark = pytest.mark.real_time

#: Time limit for events that must happen at once, in seconds.
TIMEOUT = 10.0


class Peer:
    """Peer that listens: its socket, and the accepted connections."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(TIMEOUT)
        self.port: int = self.listener.getsockname()[1]
        self.connections: list[socket.socket] = []

    def accept(self) -> socket.socket:
        connection, _ = self.listener.accept()
        connection.settimeout(TIMEOUT)
        self.connections.append(connection)
        return connection

    def reset(self) -> None:
        connection = self.connections.pop()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.close()

    def close(self) -> None:
        for each in (self.listener, *self.connections):
            each.close()


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def transport(peer: Peer) -> Iterator[TcpTransport]:
    """Transport that is connected to the peer."""
    transport = TcpTransport("127.0.0.1", peer.port, silence=TIMEOUT)
    transport.open(TIMEOUT)
    peer.accept()
    yield transport
    transport.close()


@pytest.fixture(autouse=True)
def leaks_no_socket() -> Iterator[None]:
    """Collect unclosed sockets here, so that their warnings appear in this test rather than in a later one."""
    yield
    gc.collect()


def is_ended(connection: socket.socket) -> bool:
    """Whether the other side has closed or reset the connection, and no more data arrives."""
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


def has_come(transport: TcpTransport) -> bool:
    """Wait until data can be received; return whether it can."""
    return bool(select.select([transport], [], [], TIMEOUT)[0])


def unused_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


class Background:
    """Call of a function in a thread, with its result, error and duration."""

    def __init__(self, call: Callable[[], object]) -> None:
        self.result: object = None
        self.error: Exception | None = None
        self.seconds = 0.0
        self._call = call
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        began = linkcore.clock.now()
        try:
            self.result = self._call()
        except Exception as error:
            self.error = error
        self.seconds = linkcore.clock.now() - began

    def join(self) -> None:
        self._thread.join(TIMEOUT)
        assert not self._thread.is_alive()


# -- connecting ---------------------------------------------------------------------------------------


def test_receive_returns_data_and_arrival_time(transport: TcpTransport, peer: Peer) -> None:
    before = linkcore.clock.now(), time.time()
    peer.connections[0].sendall(b"state")
    data, stamp = transport.receive()
    assert data == b"state"
    assert before[0] <= stamp.monotonic <= linkcore.clock.now()
    assert before[1] <= stamp.wall <= time.time()


def test_open_raises_connect_failed_when_refused() -> None:
    transport = TcpTransport("127.0.0.1", unused_port(), silence=1)
    with pytest.raises(ConnectFailed, match=r"127\.0\.0\.1:\d+: connection refused; is the controller on"):
        transport.open(TIMEOUT)
    with pytest.raises(ConnectionError):
        transport.open(TIMEOUT)


@pytest.mark.parametrize("host", ["no-such-host.invalid", "x" * 300, "a..b", "nul\0", "\udc80", "ü" * 70])
def test_open_raises_connect_failed_for_unknown_hosts(host: str) -> None:
    with pytest.raises(ConnectFailed, match="no such host"):
        TcpTransport(host, 30003, silence=1).open(TIMEOUT)


@pytest.fixture
def silent(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], list[float]]]:
    """Function that makes a host with `count` silent addresses; its result lists the timeout of each attempt."""
    with contextlib.ExitStack() as stack:
        # The queue holds one connection and is full, so the kernel makes all further ones wait.
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        place = listener.getsockname()
        for _ in range(4):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(place)

        def make(count: int) -> list[float]:
            tried: list[float] = []

            class Timed(socket.socket):
                def settimeout(self, value: float | None) -> None:
                    if value is not None:
                        tried.append(value)
                    super().settimeout(value)

            answer = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", place)] * count
            monkeypatch.setattr(socket, "getaddrinfo", lambda *args, **kwargs: answer)
            monkeypatch.setattr(socket, "socket", Timed)
            return tried

        yield make


@pytest.mark.parametrize("addresses", [1, 3])
def test_open_times_out_when_the_host_does_not_answer(silent: Callable[[int], list[float]], addresses: int) -> None:
    tried = silent(addresses)
    began = linkcore.clock.now()
    with pytest.raises(LinkTimeout, match=r"cannot connect to robot:30003: no answer within 0\.3 s"):
        TcpTransport("robot", 30003, silence=1).open(0.3)
    assert 0.25 < linkcore.clock.now() - began < 2
    assert len(tried) == addresses
    assert tried[0] == pytest.approx(0.3 / addresses, abs=0.05)


def test_open_tries_the_second_address_when_the_first_refuses(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port)) for port in (unused_port(), peer.port)]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *args, **kwargs: answer)
    transport = TcpTransport("robot", 30003, silence=1)
    transport.open(TIMEOUT)
    peer.accept().sendall(b"hello")
    assert transport.receive()[0] == b"hello"
    transport.close()


@pytest.mark.parametrize("kind", [TcpTransport, AwaitedTcp])
def test_open_tries_the_second_address_without_ipv6(
    peer: Peer, monkeypatch: pytest.MonkeyPatch, kind: type[TcpTransport | AwaitedTcp]
) -> None:
    class WithoutIpv6(socket.socket):
        def __init__(self, family: int = -1, *args: int, **named: int) -> None:
            if family == socket.AF_INET6:
                raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")
            super().__init__(family, *args, **named)

    answer = [
        (socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::1", peer.port, 0, 0)),
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", peer.port)),
    ]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *args, **kwargs: answer)
    transport = kind("robot", 30003, silence=1)

    async def connect() -> None:
        with monkeypatch.context() as patch:
            patch.setattr(socket, "socket", WithoutIpv6)
            if isinstance(transport, AwaitedTcp):
                await transport.connect(TIMEOUT)
            else:
                transport.open(TIMEOUT)

    asyncio.run(connect())
    peer.accept().sendall(b"hello")
    assert transport.receive()[0] == b"hello"
    transport.close()


@pytest.mark.parametrize("kind", [TcpTransport, AwaitedTcp])
def test_open_leaves_no_reference_cycle_if_first_address_refuses(
    peer: Peer, monkeypatch: pytest.MonkeyPatch, kind: type[TcpTransport | AwaitedTcp]
) -> None:
    """A cycle would keep the error of the first address alive, with the frames and variables of all callers."""
    answer = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port)) for port in (unused_port(), peer.port)]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *args, **kwargs: answer)
    held: list[weakref.ref[object]] = []

    async def connect() -> None:
        of_the_caller = threading.Event()
        held.append(weakref.ref(of_the_caller))
        transport = kind("robot", 30003, silence=1)
        if isinstance(transport, AwaitedTcp):
            await transport.connect(TIMEOUT)
        else:
            transport.open(TIMEOUT)
        transport.close()

    gc.disable()
    try:
        asyncio.run(connect())
        assert held[0]() is None
    finally:
        gc.enable()


def test_open_raises_when_the_host_has_no_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", lambda *args, **kwargs: [])
    with pytest.raises(ConnectFailed, match="robot has no address"):
        TcpTransport("robot", 30003, silence=1).open(TIMEOUT)


def test_open_closes_the_socket_when_its_setup_fails(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(connection: socket.socket, seconds: float) -> None:
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(linkcore.net.transport, "_set_receive_timeout", fail)
    with pytest.raises(ConnectFailed, match="Invalid argument"):
        TcpTransport("127.0.0.1", peer.port, silence=1).open(TIMEOUT)
    if platforms.IS_WINE:  # it cannot accept a connection that was reset meanwhile
        with pytest.raises(OSError, match="10057"):
            peer.accept()
    else:
        assert is_ended(peer.accept())


def test_sockets_have_nodelay_and_keepalive(transport: TcpTransport) -> None:
    with sockets_made() as made:
        transport.open(TIMEOUT)
    (connection,) = made
    assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)


def test_second_open_closes_the_first_connection(transport: TcpTransport, peer: Peer) -> None:
    transport.open(TIMEOUT)
    peer.accept().sendall(b"new")
    assert is_ended(peer.connections[0])
    assert transport.receive()[0] == b"new"


# -- receiving ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("silence", [0.05, 0.000001])
def test_receive_times_out_after_silence(peer: Peer, silence: float) -> None:
    transport = TcpTransport("127.0.0.1", peer.port, silence=silence)
    transport.open(TIMEOUT)
    began = linkcore.clock.now()
    with pytest.raises(LinkTimeout, match="nothing received within") as caught:
        transport.receive()
    assert isinstance(caught.value, TimeoutError)
    assert silence * 0.9 <= linkcore.clock.now() - began < 2
    # The transport is still connected and receives later data.
    peer.accept().sendall(b"late")
    while True:
        with contextlib.suppress(LinkTimeout):
            assert transport.receive()[0] == b"late"
            break
    transport.close()


def test_receive_timeout_argument_overrides_the_default(transport: TcpTransport, peer: Peer) -> None:
    for timeout in (0.05, 0.05, 0.0, -1.0):
        began = linkcore.clock.now()
        with pytest.raises(LinkTimeout, match=f"nothing received within {max(timeout, 0):g} s"):
            transport.receive(timeout)
        assert max(timeout, 0) * 0.9 <= linkcore.clock.now() - began < 2
    peer.connections[-1].sendall(b"late")
    assert transport.receive(TIMEOUT)[0] == b"late"
    peer.connections[-1].sendall(b"later")
    assert transport.receive()[0] == b"later"  # uses the timeout of the transport


def test_receive_waiting_returns_none_without_data(transport: TcpTransport, peer: Peer) -> None:
    assert transport.receive_waiting() is None
    peer.connections[-1].sendall(b"there")
    assert has_come(transport)
    arrived = transport.receive_waiting()
    assert arrived is not None
    data, stamp = arrived
    assert data == b"there"
    assert stamp.age < TIMEOUT
    assert transport.receive_waiting() is None
    peer.connections.pop().close()
    assert has_come(transport)
    with pytest.raises(ConnectionLost, match="closed the connection"):
        transport.receive_waiting()
    transport.close()
    with pytest.raises(ConnectionLost, match="is not connected"):
        transport.receive_waiting()


def test_receive_raises_when_the_peer_closes(transport: TcpTransport, peer: Peer) -> None:
    peer.connections[0].sendall(b"last")
    peer.connections[0].close()
    assert transport.receive()[0] == b"last"
    with pytest.raises(ConnectionLost, match="closed the connection"):
        transport.receive()


def test_receive_raises_connection_lost_on_reset(transport: TcpTransport, peer: Peer) -> None:
    peer.reset()
    # Under Wine, `recv` reports a reset as an orderly end.
    how = "closed" if platforms.IS_WINE else "reset"
    with pytest.raises(ConnectionLost, match=rf"127\.0\.0\.1.*{how}"):
        transport.receive()


def test_close_ends_a_receive_of_another_thread(transport: TcpTransport) -> None:
    entered = threading.Event()

    def receive() -> object:
        entered.set()
        return transport.receive()

    waiting = Background(receive)
    assert entered.wait(TIMEOUT)
    transport.close()
    waiting.join()
    assert isinstance(waiting.error, ConnectionLost)
    assert "closed by this program" in str(waiting.error) or "not connected" in str(waiting.error)
    assert waiting.seconds < TIMEOUT / 2


def test_close_ends_receive_at_any_moment(peer: Peer) -> None:
    """Whatever the other thread is doing, it ends at once with a `ConnectionLost`."""
    transport = TcpTransport("127.0.0.1", peer.port, silence=TIMEOUT)
    for _ in range(100):
        transport.open(TIMEOUT)
        waiting = Background(transport.receive)
        transport.close()
        waiting.join()
        assert isinstance(waiting.error, ConnectionLost)
        peer.accept()


def test_transport_raises_when_not_connected(transport: TcpTransport) -> None:
    for each in (TcpTransport("127.0.0.1", 1, silence=1), transport):
        each.close()
        each.close()
        with pytest.raises(ConnectionLost, match="not connected"):
            each.receive()
        with pytest.raises(ConnectionLost, match="not connected"):
            each.send(b"x", 1)


# -- sending ------------------------------------------------------------------------------------------


def test_send_delivers_long_data_completely(transport: TcpTransport, peer: Peer) -> None:
    text = bytes(range(256)) * 40_000  # more than all buffers along the connection can hold
    sending = Background(lambda: transport.send(text, TIMEOUT))
    got = b""
    while len(got) < len(text):
        got += peer.connections[0].recv(1 << 20)
    sending.join()
    assert sending.error is None
    assert got == text


def test_send_times_out_when_the_peer_does_not_read(transport: TcpTransport) -> None:
    began = linkcore.clock.now()
    with pytest.raises(LinkTimeout, match=r"sending to .* did not accept the data within 0\.2 s"):
        transport.send(b"x" * 50_000_000, 0.2)
    assert 0.19 < linkcore.clock.now() - began < 2


def test_send_raises_when_the_connection_was_reset(transport: TcpTransport, peer: Peer) -> None:
    peer.reset()
    with pytest.raises(ConnectionLost, match="sending to"):
        transport.send(b"x" * 50_000_000, TIMEOUT)


def test_send_raises_when_reset_halfway(transport: TcpTransport, peer: Peer) -> None:
    sending = Background(lambda: transport.send(b"x" * 50_000_000, TIMEOUT))
    assert peer.connections[0].recv(1000)
    peer.reset()
    sending.join()
    assert isinstance(sending.error, ConnectionLost)


def test_close_ends_a_waiting_send(transport: TcpTransport, peer: Peer) -> None:
    sending = Background(lambda: transport.send(b"x" * 50_000_000, TIMEOUT))
    assert peer.connections[0].recv(1000)
    transport.close()
    sending.join()
    assert isinstance(sending.error, ConnectionLost)
    assert sending.seconds < TIMEOUT / 2


def test_concurrent_sends_are_both_delivered(transport: TcpTransport, peer: Peer) -> None:
    sending = [Background(lambda: transport.send(b"x" * 3_000_000, TIMEOUT)) for _ in range(2)]
    got = 0
    while got < 6_000_000:
        got += len(peer.connections[0].recv(1 << 20))
    for each in sending:
        each.join()
        assert each.error is None


@platforms.needs_linux
def test_transport_works_with_high_descriptors(transport: TcpTransport, peer: Peer) -> None:
    """`select` supports descriptors below 1024 only, and a program with many robots has higher ones."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 1200:
        pytest.skip(platforms.MACHINE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 1200), hard))
    with contextlib.ExitStack() as stack:
        for _ in range(550):
            for each in socket.socketpair():
                stack.callback(each.close)
        high = TcpTransport("127.0.0.1", peer.port, silence=TIMEOUT)
        stack.callback(high.close)
        high.open(TIMEOUT)
        assert high.fileno() >= 1024
        high.send(b"hello", TIMEOUT)
        assert peer.accept().recv(10) == b"hello"
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.property
@given(st.lists(st.binary(min_size=1, max_size=100_000), min_size=1, max_size=5))
def test_received_bytes_do_not_depend_on_chunking(chunks: list[bytes]) -> None:
    peer = Peer()
    transport = TcpTransport("127.0.0.1", peer.port, silence=TIMEOUT)
    try:
        transport.open(TIMEOUT)
        there = peer.accept()

        def send() -> None:
            for chunk in chunks:
                there.sendall(chunk)
            there.close()

        sending = Background(send)
        got = b""
        with contextlib.suppress(ConnectionLost):
            while True:
                got += transport.receive()[0]
        sending.join()
        assert got == b"".join(chunks)
    finally:
        transport.close()
        peer.close()


def test_errors_are_remote_errors_and_os_errors() -> None:
    for error in (ConnectFailed, ConnectionLost, LinkTimeout):
        assert issubclass(error, RemoteError)
        assert issubclass(error, OSError), "code that uses sockets catches OSError"
