"""Listening ports, and the connections that peers open to them."""

from __future__ import annotations

import contextlib
import gc
import socket
import struct
import threading
from collections.abc import Iterator

import pytest

import linkcore.net.listener
from linkcore.errors import BadAddress, ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.listener import TcpListener, local_address
from tests.witnesses import sockets_made

pytestmark = pytest.mark.real_time

TIMEOUT = 10.0


@pytest.fixture(autouse=True)
def leaks_no_socket() -> Iterator[None]:
    """Collect unclosed sockets here, so that their warnings appear in this test rather than in a later one."""
    yield
    gc.collect()


@pytest.fixture
def listener() -> Iterator[TcpListener]:
    with TcpListener("127.0.0.1") as listener:
        yield listener


def test_listener_reports_its_free_port(listener: TcpListener) -> None:
    host, port = listener.address
    assert host == "127.0.0.1"
    assert 0 < port < 65536


def test_accepted_connection_sends_and_receives(listener: TcpListener) -> None:
    with socket.create_connection(listener.address, TIMEOUT) as peer:
        link = listener.accept(TIMEOUT)
        assert link.name == "{}:{}".format(*peer.getsockname())
        peer.sendall(b"request 0")
        assert link.receive()[0] == b"request 0"
        assert link.receive_waiting() is None
        link.send(b"answer", TIMEOUT)
        assert peer.recv(100) == b"answer"
        link.close()
        assert peer.recv(100) == b""


def test_accepted_connection_has_nodelay(listener: TcpListener) -> None:
    with socket.create_connection(listener.address, TIMEOUT), sockets_made() as made:
        link = listener.accept(TIMEOUT)
        assert made[0].getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        link.close()


def test_accept_times_out_without_a_peer(listener: TcpListener) -> None:
    with pytest.raises(LinkTimeout, match="yet"):
        listener.accept(0)
    with pytest.raises(LinkTimeout, match=r"127\.0\.0\.1:\d+ within 0\.01 s"):
        listener.accept(0.01)


def test_receive_of_accepted_connection_times_out(listener: TcpListener, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linkcore.net.listener, "_SILENCE", 0.01)
    with socket.create_connection(listener.address, TIMEOUT):
        link = listener.accept(TIMEOUT)
        with pytest.raises(LinkTimeout):
            link.receive()
        link.close()


def test_next_peer_is_accepted_after_a_peer_was_reset(listener: TcpListener) -> None:
    peer = socket.create_connection(listener.address, TIMEOUT)
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()
    # Systems differ in whether the loss shows in accept or in the first read.
    with pytest.raises(ConnectionLost), contextlib.closing(listener.accept(TIMEOUT)) as link:
        link.receive()
    with socket.create_connection(listener.address, TIMEOUT):
        listener.accept(TIMEOUT).close()


def test_closed_listener_refuses_connections(listener: TcpListener) -> None:
    listener.close()
    listener.close()
    with pytest.raises(ConnectFailed, match="was closed"):
        listener.accept(0)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(listener.address, TIMEOUT)


def test_close_ends_a_waiting_accept(listener: TcpListener) -> None:
    outcome: list[Exception] = []

    def wait() -> None:
        try:
            listener.accept(TIMEOUT)
        except Exception as error:
            outcome.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    listener.close()
    thread.join(TIMEOUT)
    assert not thread.is_alive()
    assert isinstance(outcome[0], ConnectFailed)


def test_accepted_connection_outlives_the_listener(listener: TcpListener) -> None:
    with socket.create_connection(listener.address, TIMEOUT) as peer:
        link = listener.accept(TIMEOUT)
        listener.close()
        link.send(b"still", TIMEOUT)
        assert peer.recv(100) == b"still"
        link.close()


def test_port_can_be_reused_immediately(listener: TcpListener) -> None:
    with socket.create_connection(listener.address, TIMEOUT):
        link = listener.accept(TIMEOUT)
        listener.close()
        with TcpListener(*listener.address) as again:
            assert again.address == listener.address
        link.close()


def test_empty_host_listens_on_all_addresses() -> None:
    with TcpListener("") as listener, socket.create_connection(("127.0.0.1", listener.address[1]), TIMEOUT):
        listener.accept(TIMEOUT).close()


@pytest.mark.parametrize(
    ("host", "port"), [("192.0.2.1", 0), ("no-such-host.invalid", 0), ("127.0.0.1", 70000), ("nul\0", 0)]
)
def test_listener_rejects_invalid_addresses(host: str, port: int) -> None:
    with pytest.raises(BadAddress, match="cannot listen on"):
        TcpListener(host, port)


def test_listener_rejects_a_port_in_use(listener: TcpListener) -> None:
    with pytest.raises(BadAddress, match="cannot listen on 127"):
        TcpListener(*listener.address)


def test_local_address_is_the_loopback_for_local_hosts() -> None:
    assert local_address("127.0.0.1") == "127.0.0.1"
    assert local_address("localhost") in ("127.0.0.1", "::1")


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a..b", "nul\0"])
def test_local_address_rejects_unknown_hosts(host: str) -> None:
    with pytest.raises(ConnectFailed, match="no such host"):
        local_address(host)
