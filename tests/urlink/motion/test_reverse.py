"""The connection that a program makes back, by itself."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import ClassVar

import pytest

from linkcore.errors import BadAddress, ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.transport import TcpTransport
from tests.waiting import until
from urlink.motion.links.reverse import ReverseLink, ReversePort

pytestmark = pytest.mark.simulated_time

TIMEOUT = 60.0


@pytest.fixture
def link() -> Iterator[ReverseLink]:
    link = ReversePort("127.0.0.1").open()
    yield link
    link.close()
    link.close()


def is_up(link: ReverseLink) -> bool:
    """Whether its program has come; that the controller has begun it does not count, since it says so itself."""
    return link.poll(has_begun=False)


def test_listens_on_the_route_to_the_robot_at_a_free_port(link: ReverseLink) -> None:
    host, port, _ = link.endpoint
    assert host == "127.0.0.1"
    assert port > 1023
    assert not is_up(link)
    assert not link.is_up
    assert link.received() == b""


def token(link: ReverseLink) -> bytes:
    return link.endpoint.token.to_bytes(4, "big")


def test_takes_one_program(link: ReverseLink) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        assert not is_up(link)
        program.sendall(token(link)[:1])
        assert not is_up(link)
        program.sendall(token(link)[1:] + b"0\n")
        until(lambda: is_up(link))
        assert link.is_up
        received = bytearray(link.received())
        program.sendall(b"-1\n")
        until(lambda: received.extend(link.received()) or len(received) == 5)  # type: ignore[func-returns-value]
        assert received == b"0\n-1\n"
        link.send(b"answer")
        assert program.recv(100) == b"answer"
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(link.endpoint[:2], TIMEOUT)


def test_link_aborts_a_connection_that_is_accepted_while_another_thread_closes_it(
    link: ReverseLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    accept = link._listener.accept

    def accept_and_close(timeout: float) -> TcpTransport:
        connection = accept(timeout)
        link.close()
        return connection

    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        monkeypatch.setattr(link._listener, "accept", accept_and_close)
        assert not is_up(link)
        with pytest.raises(ConnectionResetError):
            program.recv(1)


def test_a_program_that_is_gone(link: ReverseLink) -> None:
    with pytest.raises(ConnectionLost):
        link.send(b"before it came")
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        program.sendall(token(link))
        until(lambda: is_up(link))

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
        until(lambda: is_up(link))

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


@pytest.mark.parametrize("options", [{}, {"farewell": False}, {"farewell": True}])
def test_what_is_given_up_is_discarded_but_for_a_farewell(link: ReverseLink, options: dict[str, bool]) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        program.sendall(token(link))
        until(lambda: is_up(link))
        link.send(b"farewell")
        link.close(**options)
        if options.get("farewell"):
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
        until(lambda: is_up(link))
        link.send(b"set-point")
        assert program.recv(100) == b"set-point"


@pytest.mark.real_time
def test_who_comes_from_elsewhere_is_refused(link: ReverseLink, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT, source_address=("127.0.0.77", 0)) as stranger:
        stranger.sendall(token(link))
        until(lambda: is_up(link) or caplog.records)
        assert "127.0.0.77" in caplog.text
        assert "the robot is at 127.0.0.1" in caplog.text
        assert is_refused(stranger)
        serves(link)


@pytest.mark.parametrize("said", [b"\xff\xff\xff\xff", b"0\n", b"GET / HTTP/1.0\r\n\r\n"])
def test_who_says_something_else_is_refused(link: ReverseLink, said: bytes, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as stranger:
        stranger.sendall(said)
        until(lambda: is_up(link) or caplog.records)
        assert "did not send the token of the expected program" in caplog.text
        assert is_refused(stranger)
        serves(link)


def test_those_who_say_nothing_keep_nobody_out(link: ReverseLink) -> None:
    """Eight are waited for; the next one takes the place of the first."""
    strangers: list[socket.socket] = []

    def comes() -> socket.socket:
        strangers.append(socket.create_connection(link.endpoint[:2], TIMEOUT))
        until(lambda: is_up(link) or len(link._candidates) == min(len(strangers), 8))
        return strangers[-1]

    first = comes()
    for _ in range(7):
        comes()
    first.setblocking(False)
    with pytest.raises(BlockingIOError):
        first.recv(1)
    first.settimeout(TIMEOUT)
    comes()
    assert is_refused(first)
    serves(link)
    for stranger in strangers:
        assert is_refused(stranger)
        stranger.close()


@pytest.mark.parametrize("said", [b"", b"nonsense"])
def test_who_comes_and_goes_keeps_nobody_out(link: ReverseLink, said: bytes) -> None:
    """Nor does who was refused: the program that came before them, and is slow to say who it is, is still heard."""
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        until(lambda: not is_up(link) and link._candidates)
        for _ in range(12):
            with socket.create_connection(link.endpoint[:2], TIMEOUT) as stranger:
                stranger.sendall(said)
                stranger.shutdown(socket.SHUT_WR)
                until(lambda: not is_up(link) and is_left_alone(stranger))
        program.sendall(token(link))
        until(lambda: is_up(link))


def is_left_alone(stranger: socket.socket) -> bool:
    """The other side has closed or reset the connection; without waiting for it."""
    stranger.setblocking(False)
    try:
        return stranger.recv(100) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


def test_free_ports_wait_side_by_side() -> None:
    where = ReversePort("127.0.0.1")
    first, second = where.open(), where.open()
    for link in (first, second):
        serves(link)
        link.close()


class Interrupted(ReversePort):
    """Another thread opens a link when the first one has just been kept."""

    others: ClassVar[list[ReverseLink]] = []

    def __setattr__(self, name: str, value: object) -> None:
        super().__setattr__(name, value)
        if name == "_link" and value is not None and not self.others:
            self.others.append(value)  # type: ignore[arg-type] # only once
            self.others[:] = [self.open()]


def test_threads_that_open_at_once_have_a_link_each() -> None:
    """Two programs that shared one would be led by each other's messages."""
    where = Interrupted("127.0.0.1")
    links = [where.open(), *where.others]
    assert len(set(links)) == 2
    for link in links:
        link.close()


class Coming:
    """A connection that has just been accepted, from elsewhere than a socket."""

    name, host = "127.0.0.1:9", "127.0.0.1"

    def __init__(self, link: ReverseLink, closes: bool) -> None:
        self.link = link
        self.closes = closes
        self.is_aborted = False

    def receive_waiting(self) -> tuple[bytes, None]:
        if self.closes:
            self.link.close()  # as another thread does at this moment
        return token(self.link), None

    def abort(self) -> None:
        self.is_aborted = True


@pytest.mark.parametrize("is_closed_before", [True, False])
def test_a_program_that_comes_while_its_link_is_closed(
    link: ReverseLink, monkeypatch: pytest.MonkeyPatch, is_closed_before: bool
) -> None:
    coming = Coming(link, closes=not is_closed_before)
    # Before it comes another, that is gone when it is looked at.
    queue = [ConnectionLost("gone"), coming]

    def accept(timeout: float) -> object:
        if not queue:
            raise LinkTimeout("nobody")
        if isinstance(each := queue.pop(0), Exception):
            raise each
        if is_closed_before:
            link.close()
        return each

    monkeypatch.setattr(link._listener, "accept", accept)
    is_up(link)
    assert coming.is_aborted


def test_closing_ends_those_who_wait(link: ReverseLink) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        is_up(link)
        link.close()
        assert is_refused(program)
    assert not is_up(link)


@pytest.mark.real_time
def test_another_address_that_programs_come_from() -> None:
    link = ReversePort("127.0.0.1", peer="127.0.0.77").open()
    with socket.create_connection(link.endpoint[:2], TIMEOUT, source_address=("127.0.0.77", 0)) as program:
        program.sendall(token(link))
        until(lambda: is_up(link))
    link.close()


def test_an_address_that_something_translates() -> None:
    # It belongs to no network card here, so all of them are listened on.
    link = ReversePort("127.0.0.1", "192.0.2.7").open()
    assert link.endpoint[:2][0] == "192.0.2.7"
    with socket.create_connection(("127.0.0.1", link.endpoint.port), TIMEOUT) as program:
        program.sendall(token(link))
        until(lambda: is_up(link))
    link.close()


@pytest.mark.real_time
def test_a_fixed_port_waits_for_the_newest_program(own_port: int) -> None:
    where = ReversePort("127.0.0.1", port=own_port)
    first = where.open()
    second = where.open()
    assert first.endpoint[:2] == second.endpoint[:2] == ("127.0.0.1", own_port)
    # The program of the first, which the controller begins late, is not taken for that of the second.
    with socket.create_connection(second.endpoint[:2], TIMEOUT) as late:
        late.sendall(token(first))
        assert not is_up(first)
        until(lambda: not is_up(second) and is_refused(late))
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
