"""The connection that a program makes back, by itself."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from linkcore.errors import BadAddress, ConnectFailed, ConnectionLost
from tests.waiting import until
from urlink.motion.reverse import ReverseLink, ReversePort

TIMEOUT = 10.0


@pytest.fixture
def link() -> Iterator[ReverseLink]:
    link = ReversePort("127.0.0.1").open()
    yield link
    link.close()
    link.close()


def test_listens_on_the_route_to_the_robot_at_a_free_port(link: ReverseLink) -> None:
    host, port, _ = link.endpoint
    assert host == "127.0.0.1"
    assert port > 0
    assert not link.poll()
    assert not link.is_up


def token(link: ReverseLink) -> bytes:
    return link.endpoint.token.to_bytes(4, "big")


def test_takes_one_program(link: ReverseLink) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        assert not link.poll()
        program.sendall(token(link)[:1])
        assert not link.poll()
        program.sendall(token(link)[1:] + b"0\n")
        until(link.poll)
        received = bytearray(link.received())
        program.sendall(b"-1\n")
        until(lambda: received.extend(link.received()) or len(received) == 5)  # type: ignore[func-returns-value]
        assert received == b"0\n-1\n"
        link.send(b"answer")
        assert program.recv(100) == b"answer"
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(link.endpoint[:2], TIMEOUT)


def test_a_program_that_is_gone(link: ReverseLink) -> None:
    with pytest.raises(ConnectionLost):
        link.send(b"before it came")
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        program.sendall(token(link))
        until(link.poll)

    def look() -> bool:
        link.received()
        return False

    with pytest.raises(ConnectionLost):
        until(look)


def read_all(program: socket.socket) -> None:
    while program.recv(1 << 20):
        pass


def test_a_program_that_does_not_read(link: ReverseLink) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        program.sendall(token(link))
        until(link.poll)

        def send_on() -> None:
            while True:
                link.send(bytes(1 << 20))

        with pytest.raises(ConnectionLost, match="does not read"):
            send_on()
        # What comes next would be read as the rest of what went before.
        with pytest.raises(ConnectionLost):
            link.send(b"answer")
        # So the connection has ended for the program too, instead of going on once it reads again.
        with pytest.raises(ConnectionResetError):
            read_all(program)


@pytest.mark.parametrize("is_meant_to_arrive", [True, False])
def test_what_is_given_up_is_discarded(link: ReverseLink, is_meant_to_arrive: bool) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        program.sendall(token(link))
        until(link.poll)
        link.send(b"farewell")
        link.close(farewell=is_meant_to_arrive)
        if is_meant_to_arrive:
            assert program.recv(100) == b"farewell"
            assert program.recv(100) == b""
        else:
            program.settimeout(TIMEOUT)
            assert is_reset(program)


def is_reset(program: socket.socket) -> bool:
    try:
        while program.recv(100):
            pass
    except ConnectionError:
        return True
    return False


def is_refused(stranger: socket.socket) -> bool:
    try:
        return stranger.recv(100) == b""
    except ConnectionError:
        return True


def serves(link: ReverseLink) -> None:
    """The program itself still finds the port."""
    assert not link.is_up
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        program.sendall(token(link))
        until(link.poll)
        link.send(b"set-point")
        assert program.recv(100) == b"set-point"


def test_who_comes_from_elsewhere_is_refused(link: ReverseLink, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT, source_address=("127.0.0.77", 0)) as stranger:
        stranger.sendall(token(link))
        until(lambda: link.poll() or caplog.records)
        assert "127.0.0.77" in caplog.text
        assert "the robot is at 127.0.0.1" in caplog.text
        assert is_refused(stranger)
        serves(link)


@pytest.mark.parametrize("said", [b"\xff\xff\xff\xff", b"0\n", b"GET / HTTP/1.0\r\n\r\n"])
def test_who_says_something_else_is_refused(link: ReverseLink, said: bytes, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as stranger:
        stranger.sendall(said)
        until(lambda: link.poll() or caplog.records)
        assert "not the program that is waited for" in caplog.text
        assert is_refused(stranger)
        serves(link)


def test_those_who_say_nothing_keep_nobody_out(link: ReverseLink) -> None:
    strangers = []
    for _ in range(12):
        strangers.append(socket.create_connection(link.endpoint[:2], TIMEOUT))
        until(lambda: not link.poll())
    assert is_refused(strangers[0])
    serves(link)
    for stranger in strangers:
        assert is_refused(stranger)
        stranger.close()


def test_who_comes_and_goes_keeps_nobody_out(link: ReverseLink) -> None:
    for _ in range(3):
        socket.create_connection(link.endpoint[:2], TIMEOUT).close()
        link.poll()
    serves(link)


def test_closing_ends_those_who_wait(link: ReverseLink) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        link.poll()
        link.close()
        assert is_refused(program)
    assert not link.poll()


def test_another_address_that_programs_come_from() -> None:
    link = ReversePort("127.0.0.1", peer="127.0.0.77").open()
    with socket.create_connection(link.endpoint[:2], TIMEOUT, source_address=("127.0.0.77", 0)) as program:
        program.sendall(token(link))
        until(link.poll)
    link.close()


def test_an_address_that_something_translates() -> None:
    # It belongs to no network card here, so all of them are listened on.
    link = ReversePort("127.0.0.1", "192.0.2.7").open()
    assert link.endpoint[:2][0] == "192.0.2.7"
    with socket.create_connection(("127.0.0.1", link.endpoint.port), TIMEOUT) as program:
        program.sendall(token(link))
        until(link.poll)
    link.close()


def test_a_fixed_port_waits_for_the_newest_program() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    where = ReversePort("127.0.0.1", port=port)
    first = where.open()
    second = where.open()
    assert first.endpoint[:2] == second.endpoint[:2] == ("127.0.0.1", port)
    # The program of the first, which the controller begins late, is not taken for that of the second.
    with socket.create_connection(second.endpoint[:2], TIMEOUT) as late:
        late.sendall(token(first))
        assert not first.poll()
        until(lambda: not second.poll() and is_refused(late))
    serves(second)
    first.close()
    second.close()


def test_says_what_to_try(link: ReverseLink) -> None:
    error = link.absence("refused")
    assert isinstance(error, ConnectFailed)
    for part in (
        f"127.0.0.1:{link.endpoint.port}",
        "refused",
        "reverse_host",
        "reverse_port",
        "reverse_peer",
        "firewall",
    ):
        assert part in str(error)


def test_where_nobody_can_listen(link: ReverseLink) -> None:
    with pytest.raises(BadAddress):
        ReversePort("127.0.0.1", None, link.endpoint.port).open()
    with pytest.raises(ConnectFailed):
        ReversePort("no-such-host.invalid").open()
