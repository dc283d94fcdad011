"""The connection that a program makes back, by itself."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from linkcore.errors import BadAddress, ConnectFailed, ConnectionLost
from tests.waiting import until
from urlink.motion.reverse import ReverseLink

PATIENCE = 10.0


@pytest.fixture
def link() -> Iterator[ReverseLink]:
    link = ReverseLink("127.0.0.1")
    yield link
    link.close()
    link.close()


def test_listens_on_the_route_to_the_robot_at_a_free_port(link: ReverseLink) -> None:
    host, port = link.address
    assert host == "127.0.0.1"
    assert port > 0
    assert not link.poll()
    assert not link.is_up


def test_takes_one_program(link: ReverseLink) -> None:
    with socket.create_connection(link.address, PATIENCE) as program:
        until(link.poll)
        assert link.received() == b""
        program.sendall(b"0\n")
        program.sendall(b"-1\n")
        received = bytearray()
        until(lambda: received.extend(link.received()) or len(received) == 5)  # type: ignore[func-returns-value]
        link.send(b"answer")
        assert program.recv(100) == b"answer"
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(link.address, PATIENCE)


def test_a_program_that_is_gone(link: ReverseLink) -> None:
    with pytest.raises(ConnectionLost):
        link.send(b"before it came")
    with socket.create_connection(link.address, PATIENCE):
        until(link.poll)

    def look() -> bool:
        link.received()
        return False

    with pytest.raises(ConnectionLost):
        until(look)


def test_a_program_that_does_not_read(link: ReverseLink) -> None:
    with socket.create_connection(link.address, PATIENCE):
        until(link.poll)

        def send_on() -> None:
            while True:
                link.send(bytes(1 << 20))

        with pytest.raises(ConnectionLost, match="does not read"):
            send_on()


def test_an_address_that_something_translates() -> None:
    # It belongs to no network card here, so all of them are listened on.
    link = ReverseLink("127.0.0.1", "192.0.2.7")
    assert link.address[0] == "192.0.2.7"
    with socket.create_connection(("127.0.0.1", link.address[1]), PATIENCE):
        until(link.poll)
    link.close()


def test_says_what_to_try(link: ReverseLink) -> None:
    error = link.absence("refused")
    assert isinstance(error, ConnectFailed)
    for part in (f"127.0.0.1:{link.address[1]}", "refused", "reverse_host", "reverse_port", "firewall"):
        assert part in str(error)


def test_where_nobody_can_listen(link: ReverseLink) -> None:
    with pytest.raises(BadAddress):
        ReverseLink("127.0.0.1", None, link.address[1])
    with pytest.raises(ConnectFailed):
        ReverseLink("no-such-host.invalid")


def test_a_stranger_is_refused_and_the_robot_still_served(link: ReverseLink, caplog: pytest.LogCaptureFixture) -> None:
    stranger = socket.create_connection(link.address, PATIENCE, source_address=("127.0.0.77", 0))
    with stranger:
        until(lambda: link.poll() or caplog.records)
        assert not link.is_up
        assert "127.0.0.77" in caplog.text
        assert stranger.recv(100) == b""
        with socket.create_connection(link.address, PATIENCE) as program:
            until(link.poll)
            link.send(b"set-point")
            assert program.recv(100) == b"set-point"
