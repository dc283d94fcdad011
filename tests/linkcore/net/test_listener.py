"""Peers that connect to this side."""

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

pytestmark = pytest.mark.real_time

TIMEOUT = 10.0


@pytest.fixture(autouse=True)
def leaks_no_socket() -> Iterator[None]:
    """A socket that nobody closed warns when it is collected: here, rather than in some later test."""
    yield
    gc.collect()


@pytest.fixture
def listener() -> Iterator[TcpListener]:
    with TcpListener("127.0.0.1") as listener:
        yield listener


def test_a_free_port_is_found_and_named(listener: TcpListener) -> None:
    host, port = listener.address
    assert host == "127.0.0.1"
    assert 0 < port < 65536


def test_talks_both_ways_with_whoever_connects(listener: TcpListener) -> None:
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


def test_the_connection_does_not_delay_small_packets(listener: TcpListener) -> None:
    with socket.create_connection(listener.address, TIMEOUT):
        link = listener.accept(TIMEOUT)
        assert link._socket is not None
        assert link._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        link.close()


def test_nobody_comes(listener: TcpListener) -> None:
    with pytest.raises(LinkTimeout, match="yet"):
        listener.accept(0)
    with pytest.raises(LinkTimeout, match=r"127\.0\.0\.1:\d+ within 0\.01 s"):
        listener.accept(0.01)


def test_silence_of_an_accepted_connection(listener: TcpListener, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linkcore.net.listener, "_SILENCE", 0.01)
    with socket.create_connection(listener.address, TIMEOUT):
        link = listener.accept(TIMEOUT)
        with pytest.raises(LinkTimeout):
            link.receive()
        link.close()


def test_who_resets_at_once_is_lost_and_the_next_is_taken(listener: TcpListener) -> None:
    peer = socket.create_connection(listener.address, TIMEOUT)
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()
    # Systems differ in whether the loss shows in accept or in the first read.
    with pytest.raises(ConnectionLost), contextlib.closing(listener.accept(TIMEOUT)) as link:
        link.receive()
    with socket.create_connection(listener.address, TIMEOUT):
        listener.accept(TIMEOUT).close()


def test_a_closed_listener_refuses(listener: TcpListener) -> None:
    listener.close()
    listener.close()
    with pytest.raises(ConnectFailed, match="was closed"):
        listener.accept(0)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(listener.address, TIMEOUT)


def test_closing_wakes_who_waits(listener: TcpListener) -> None:
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


def test_what_was_accepted_outlives_the_listener(listener: TcpListener) -> None:
    with socket.create_connection(listener.address, TIMEOUT) as peer:
        link = listener.accept(TIMEOUT)
        listener.close()
        link.send(b"still", TIMEOUT)
        assert peer.recv(100) == b"still"
        link.close()


def test_the_same_port_again_at_once(listener: TcpListener) -> None:
    with socket.create_connection(listener.address, TIMEOUT):
        link = listener.accept(TIMEOUT)
        listener.close()
        with TcpListener(*listener.address) as again:
            assert again.address == listener.address
        link.close()


def test_all_addresses_of_this_computer() -> None:
    with TcpListener("") as listener, socket.create_connection(("127.0.0.1", listener.address[1]), TIMEOUT):
        listener.accept(TIMEOUT).close()


@pytest.mark.parametrize(
    ("host", "port"), [("192.0.2.1", 0), ("no-such-host.invalid", 0), ("127.0.0.1", 70000), ("nul\0", 0)]
)
def test_where_nobody_can_listen(host: str, port: int) -> None:
    with pytest.raises(BadAddress, match="cannot listen on"):
        TcpListener(host, port)


def test_a_port_that_is_taken(listener: TcpListener) -> None:
    with pytest.raises(BadAddress, match="cannot listen on 127"):
        TcpListener(*listener.address)


def test_local_address() -> None:
    assert local_address("127.0.0.1") == "127.0.0.1"
    assert local_address("localhost") in ("127.0.0.1", "::1")


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a..b", "nul\0"])
def test_no_route(host: str) -> None:
    with pytest.raises(ConnectFailed, match="no such host"):
        local_address(host)
