"""The connection that a program makes to this computer, on its own."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import ClassVar

import pytest

from linkcore.errors import BadAddress, ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.listener import TcpListener
from linkcore.net.transport import TcpTransport
from tests import platforms
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
    """Whether the program has connected, regardless of the controller's report that it has started."""
    return link.poll(has_begun=False)


def test_link_listens_at_the_interface_that_reaches_the_robot(link: ReverseLink) -> None:
    host, port, _ = link.endpoint
    assert host == "127.0.0.1"
    assert port > 1023
    assert not is_up(link)
    assert not link.is_up
    assert link.received() == b""


def token(link: ReverseLink) -> bytes:
    return link.endpoint.token.to_bytes(4, "big")


def test_link_accepts_one_program(link: ReverseLink) -> None:
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


def test_connection_accepted_during_close_is_aborted(link: ReverseLink, monkeypatch: pytest.MonkeyPatch) -> None:
    accept = TcpListener.accept

    def accept_and_close(listener: TcpListener, timeout: float) -> TcpTransport:
        connection = accept(listener, timeout)
        link.close()
        return connection

    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        monkeypatch.setattr(TcpListener, "accept", accept_and_close)
        assert not is_up(link)
        with pytest.raises(ConnectionResetError):
            program.recv(1)


def test_lost_program_raises_connection_lost(link: ReverseLink) -> None:
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


def test_unread_messages_raise_connection_lost(link: ReverseLink) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        program.sendall(token(link))
        until(lambda: is_up(link))

        def send_on() -> None:
            while True:
                link.send(bytes(1 << 20))

        with pytest.raises(ConnectionLost, match="does not read"):
            send_on()
        # The program would read the next message as the rest of the previous one.
        with pytest.raises(ConnectionLost):
            link.send(b"answer")
        # Therefore, the connection has ended for the program too; it does not continue when the program reads again.
        with pytest.raises(ConnectionResetError):
            read_all(program)


@pytest.mark.parametrize("options", [{}, {"farewell": False}, {"farewell": True}])
def test_close_discards_pending_data_except_the_end_message(link: ReverseLink, options: dict[str, bool]) -> None:
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
    """Check that the expected program can still connect."""
    assert not link.is_up
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        program.sendall(token(link))
        until(lambda: is_up(link))
        link.send(b"set-point")
        assert program.recv(100) == b"set-point"


@pytest.mark.real_time
def test_connection_from_other_address_is_refused(link: ReverseLink, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT, source_address=("127.0.0.77", 0)) as stranger:
        stranger.sendall(token(link))
        until(lambda: is_up(link) or caplog.records)
        assert "127.0.0.77" in caplog.text
        assert "the robot is at 127.0.0.1" in caplog.text
        assert is_refused(stranger)
        serves(link)


@pytest.mark.parametrize("said", [b"\xff\xff\xff\xff", b"0\n", b"GET / HTTP/1.0\r\n\r\n"])
def test_connection_without_token_is_refused(link: ReverseLink, said: bytes, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as stranger:
        stranger.sendall(said)
        until(lambda: is_up(link) or caplog.records)
        assert "did not send the token of the expected program" in caplog.text
        assert is_refused(stranger)
        serves(link)


def test_silent_clients_do_not_keep_program_out(link: ReverseLink) -> None:
    """Up to eight clients may wait; the next client replaces the first one."""
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
def test_short_connections_do_not_keep_program_out(link: ReverseLink, said: bytes) -> None:
    """This holds for refused clients, too: a program that connected earlier and is slow is still accepted."""
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
    """Whether the other side has closed or reset the connection, without waiting for it."""
    stranger.setblocking(False)
    try:
        return stranger.recv(100) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


def test_two_links_can_wait_at_free_ports_at_the_same_time() -> None:
    where = ReversePort("127.0.0.1")
    first, second = where.open(), where.open()
    for link in (first, second):
        serves(link)
        link.close()


class Interrupted(ReversePort):
    """Port whose next link is opened by another thread, right after the first link was stored."""

    others: ClassVar[list[ReverseLink]] = []

    def __setattr__(self, name: str, value: object) -> None:
        super().__setattr__(name, value)
        if name == "_link" and value is not None and not self.others:
            self.others.append(value)  # type: ignore[arg-type] # only once
            self.others[:] = [self.open()]


def test_concurrent_opens_get_separate_links() -> None:
    """Two programs on one link would receive each other's messages."""
    where = Interrupted("127.0.0.1")
    links = [where.open(), *where.others]
    assert len(set(links)) == 2
    for link in links:
        link.close()


class Coming:
    """A connection that was just accepted, without a socket."""

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
def test_program_connecting_during_close_is_aborted(
    link: ReverseLink, monkeypatch: pytest.MonkeyPatch, is_closed_before: bool
) -> None:
    coming = Coming(link, closes=not is_closed_before)
    # An earlier connection is lost before it is read.
    queue = [ConnectionLost("gone"), coming]

    def accept(listener: TcpListener, timeout: float) -> object:
        if not queue:
            raise LinkTimeout("no client")
        if isinstance(each := queue.pop(0), Exception):
            raise each
        if is_closed_before:
            link.close()
        return each

    monkeypatch.setattr(TcpListener, "accept", accept)
    is_up(link)
    assert coming.is_aborted


def test_close_ends_waiting_connections(link: ReverseLink) -> None:
    with socket.create_connection(link.endpoint[:2], TIMEOUT) as program:
        is_up(link)
        link.close()
        assert is_refused(program)
    assert not is_up(link)


@pytest.mark.real_time
def test_peer_option_accepts_another_address() -> None:
    link = ReversePort("127.0.0.1", peer="127.0.0.77").open()
    with socket.create_connection(link.endpoint[:2], TIMEOUT, source_address=("127.0.0.77", 0)) as program:
        program.sendall(token(link))
        until(lambda: is_up(link))
    link.close()


def test_translated_address_listens_on_all_interfaces() -> None:
    # The address belongs to no network card here, so the link listens on all of them.
    link = ReversePort("127.0.0.1", "192.0.2.7").open()
    assert link.endpoint[:2][0] == "192.0.2.7"
    with socket.create_connection(("127.0.0.1", link.endpoint.port), TIMEOUT) as program:
        program.sendall(token(link))
        until(lambda: is_up(link))
    link.close()


@pytest.mark.real_time
@platforms.needs_reusable_ports
def test_fixed_port_accepts_only_the_newest_program(own_port: int) -> None:
    where = ReversePort("127.0.0.1", port=own_port)
    first = where.open()
    second = where.open()
    assert first.endpoint[:2] == second.endpoint[:2] == ("127.0.0.1", own_port)
    # The controller starts the first program late; the second link does not accept it.
    with socket.create_connection(second.endpoint[:2], TIMEOUT) as late:
        late.sendall(token(first))
        assert not is_up(first)
        until(lambda: not is_up(second) and is_refused(late))
    serves(second)
    first.close()
    second.close()


def test_missing_connection_error_suggests_remedies(link: ReverseLink) -> None:
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


def test_unusable_address_raises_error(link: ReverseLink) -> None:
    with pytest.raises(BadAddress):
        ReversePort("127.0.0.1", None, link.endpoint.port).open()
    with pytest.raises(ConnectFailed):
        ReversePort("no-such-host.invalid").open()
