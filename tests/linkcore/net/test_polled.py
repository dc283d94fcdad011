"""Outgoing connections that never block, to real listeners."""

from __future__ import annotations

import errno
import gc
import os
import socket
import struct
from collections.abc import Iterator

import pytest

from linkcore.net.polled import PolledConnection
from tests import platforms
from tests.waiting import until

pytestmark = pytest.mark.real_time

MOST = 1 << 16


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(10)
        yield listener


def port(listener: socket.socket) -> int:
    return int(listener.getsockname()[1])


def opened(listener: socket.socket) -> tuple[PolledConnection, socket.socket]:
    connection = PolledConnection("127.0.0.1", port(listener), most_waiting=MOST)
    peer, _ = listener.accept()
    peer.settimeout(10)
    until(lambda: connection.state == "open")
    return connection, peer


def descriptors() -> int:
    if not platforms.IS_LINUX:
        pytest.skip(platforms.LINUX)
    gc.collect()
    return len(os.listdir("/proc/self/fd"))


def test_polled_connection_uses_the_source_address(listener: socket.socket) -> None:
    source = "127.0.0.2"
    with socket.socket() as probe:
        try:
            probe.bind((source, 0))
        except OSError:
            pytest.skip(platforms.MACHINE)
    connection = PolledConnection("127.0.0.1", port(listener), source=source)
    peer, address = listener.accept()
    with peer:
        assert address[0] == source
    connection.close()
    assert PolledConnection("127.0.0.1", port(listener), source="192.0.2.1").state == "failed"


def test_polled_connection_sends_and_receives(listener: socket.socket) -> None:
    connection, peer = opened(listener)
    with peer:
        assert connection.send(b"hello")
        assert peer.recv(100) == b"hello"
        assert connection.receive() == b""
        peer.sendall(b"abc")
        until(lambda: connection.receive() == b"abc")
        del connection.received[:2]
        peer.sendall(b"d")
        until(lambda: connection.receive() == b"cd")
        connection.close()
        assert peer.recv(100) == b""
    assert connection.state == "closed"
    assert connection.receive() == b""
    assert not connection.send(b"x")


def test_polled_connection_has_nodelay(listener: socket.socket) -> None:
    connection, peer = opened(listener)
    assert connection._socket is not None
    assert connection._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    connection.close()
    peer.close()


def test_connection_fails_when_no_server_listens(listener: socket.socket) -> None:
    number = port(listener)
    listener.close()
    before = descriptors()
    connection = PolledConnection("127.0.0.1", number)
    until(lambda: connection.state == "failed")
    assert not connection.send(b"x")
    assert connection.receive() == b""
    assert descriptors() == before


@pytest.mark.parametrize(
    ("host", "number"),
    [("example.com", 80), ("", 80), ("2130706433", 80), ("1.2.3", 80), ("::1%nowhere", 80), ("127.0.0.1", 65536)],
)
def test_invalid_address_fails_immediately(host: str, number: int) -> None:
    before = descriptors()
    assert PolledConnection(host, number).state == "failed"
    assert descriptors() == before


def test_data_sent_before_the_close_can_be_read(listener: socket.socket) -> None:
    before = descriptors()
    connection, peer = opened(listener)
    with peer:
        peer.sendall(b"last words")
    until(lambda: connection.receive() == b"last words" and connection.state == "closed")
    assert descriptors() == before
    del connection.received[:5]
    assert connection.receive() == b"words"
    connection.close()
    connection.close()
    assert connection.receive() == b""


def test_reset_closes_the_connection(listener: socket.socket) -> None:
    connection, peer = opened(listener)
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()
    until(lambda: connection.receive() == b"" and connection.state == "closed")


def test_connection_closes_when_the_peer_never_reads(listener: socket.socket) -> None:
    connection, peer = opened(listener)
    with peer:
        sent = 0
        while connection.send(b"x" * 10_000):
            sent += 10_000
            assert sent < 100_000_000
        assert connection.state == "closed"
        # The peer gets whole messages, and the beginning of the last one.
        came = 0
        while data := peer.recv(1 << 20):
            came += len(data)
        assert sent <= came < sent + 10_000


def test_full_receive_buffer_blocks_the_peer(listener: socket.socket) -> None:
    connection, peer = opened(listener)
    with peer:
        peer.setblocking(False)

        def is_full() -> bool:
            try:
                peer.send(b"x" * 65536)
            except BlockingIOError:
                return len(connection.receive()) == MOST
            connection.receive()
            return False

        until(is_full)
        assert len(connection.receive()) == MOST
        connection.close()


@platforms.needs_linux
def test_connection_works_with_high_descriptors(listener: socket.socket) -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 2000:
        pytest.skip(platforms.MACHINE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2000), hard))
    taken: list[int] = []
    try:
        while not taken or taken[-1] < 1100:
            taken.append(os.dup(listener.fileno()))
        connection, peer = opened(listener)
        with peer:
            peer.sendall(b"x")
            until(lambda: connection.receive() == b"x")
        connection.close()
    finally:
        for number in taken:
            os.close(number)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_connection_fails_when_no_descriptor_is_free(listener: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    def none_left(*arguments: object) -> socket.socket:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr("linkcore.net.polled.socket.socket", none_left)
    assert PolledConnection("127.0.0.1", port(listener)).state == "failed"
