"""Exchanges of a call whose task is cancelled: the wait ends at once, and a sent command is undone."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from linkcore import clock
from linkcore.errors import Cancelled
from linkcore.net.dialogue import Dialogue
from linkcore.net.http_client import HttpClient
from linkcore.net.transport import TcpTransport
from linkcore.net.undo import PendingUndos, Undo
from linkcore.pending_call import PendingCall
from linkcore.wire.http import HttpRequest
from tests import platforms
from tests.waiting import until

pytestmark = pytest.mark.simulated_time

TIMEOUT = 60.0


class Server:
    """Server that accepts connections, and answers if `answer` is set."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self.listener.getsockname()[1]
        self.received: list[bytes] = []
        self.answer: bytes | None = None
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        try:
            while True:
                connection, _ = self.listener.accept()
                threading.Thread(target=self._talk, args=(connection,), daemon=True).start()
        except OSError:
            return

    def _talk(self, connection: socket.socket) -> None:
        with connection:
            try:
                while data := connection.recv(1000):
                    self.received.append(data)
                    if self.answer is not None:
                        connection.sendall(self.answer)
            except OSError:
                return


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.listener.close()


class Lines:
    """Protocol of lines without a greeting, which calls a function before it returns an answer."""

    settling = None
    is_greeted = True
    is_in_step = True

    def __init__(self, before_answer: Callable[[], object]) -> None:
        self._before_answer = before_answer

    def ask(self, text: str) -> bytes:
        return text.encode() + b"\n"

    def feed(self, data: bytes) -> str | None:
        self._before_answer()
        return data.decode()


class Made:
    """Call that runs in one thread, and is abandoned by another thread."""

    def __init__(self, function: Callable[[], object], call: PendingCall | None = None) -> None:
        self.call = call or PendingCall()
        self.error: BaseException | None = None
        self._function = function
        self._thread = threading.Thread(target=self._make, daemon=True)
        self._thread.start()

    def _make(self) -> None:
        try:
            self.call.make(self._function)
        except BaseException as error:
            self.error = error

    def ends_as_cancelled(self) -> bool:
        began = clock.now()
        self._thread.join(TIMEOUT)
        return isinstance(self.error, Cancelled) and clock.now() - began < 1.0


def dialogue(server: Server, before_answer: Callable[[], object] = lambda: None) -> Dialogue:
    transport = TcpTransport("127.0.0.1", server.port, silence=TIMEOUT)
    return Dialogue(transport, lambda: Lines(before_answer), "server", TIMEOUT)


def test_abandoned_dialogue_ends_without_an_answer(server: Server) -> None:
    given_up = threading.Event()
    asking = dialogue(server)
    made = Made(lambda: asking.ask("play", TIMEOUT, given_up=given_up.set))
    until(lambda: bool(server.received))
    made.call.give_up()
    assert made.ends_as_cancelled()
    assert given_up.is_set()
    server.answer = b"ok"
    assert asking.ask("stop", TIMEOUT) == "ok"


def test_dialogue_undoes_a_command_answered_during_abandonment(server: Server) -> None:
    given_up, call = threading.Event(), PendingCall()
    asking = dialogue(server, before_answer=call.give_up)
    server.answer = b"ok"
    made = Made(lambda: asking.ask("play", TIMEOUT, given_up=given_up.set), call)
    assert made.ends_as_cancelled()
    assert given_up.is_set()


def test_abandoned_dialogue_ends_while_another_thread_asks(server: Server) -> None:
    asking = dialogue(server)
    first = Made(lambda: asking.ask("first", TIMEOUT))
    until(lambda: bool(server.received))
    second = Made(lambda: asking.ask("second", TIMEOUT))
    second.call.give_up()
    assert second.ends_as_cancelled()
    first.call.give_up()
    assert first.ends_as_cancelled()
    assert server.received == [b"first\n"]


def test_abandoned_http_request_ends_without_an_answer(server: Server) -> None:
    given_up = threading.Event()
    client = HttpClient("127.0.0.1", server.port)
    made = Made(lambda: client.ask(HttpRequest("PUT", "/play", {}, b""), TIMEOUT, given_up.set))
    until(lambda: bool(server.received))
    made.call.give_up()
    assert made.ends_as_cancelled()
    assert given_up.is_set()


@pytest.mark.real_time
@platforms.needs_linux
def test_abandoned_connect_ends() -> None:
    """The kernel does not answer, because the queue of the listener is full."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as listener:
        port = listener.getsockname()[1]
        waiting = [socket.socket() for _ in range(4)]
        for each in waiting:
            each.setblocking(False)
            each.connect_ex(("127.0.0.1", port))
        transport = TcpTransport("127.0.0.1", port, silence=TIMEOUT)
        made = Made(lambda: transport.open(TIMEOUT))
        until(lambda: bool(made.call._wakes))
        made.call.give_up()
        assert made.ends_as_cancelled()
        for each in waiting:
            each.close()


class Closeable:
    def close(self) -> None:
        pass


def test_answered_command_is_undone_when_its_call_is_abandoned() -> None:
    undos, undone, call = PendingUndos("robot"), threading.Event(), PendingCall()
    undo = Undo(Closeable, lambda client, is_wanted: undone.set())

    def play() -> None:
        with undos.command("play", TIMEOUT, undo):
            pass

    call.make(play)
    assert undos.pending == ()
    call.give_up()
    assert undone.wait(TIMEOUT)
    undos.close()


def test_answered_command_is_undone_without_a_new_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    undos, undone, call = PendingUndos("robot"), threading.Event(), PendingCall()
    undo = Undo(Closeable, lambda client, is_wanted: undone.set())

    def play() -> None:
        with undos.command("play", TIMEOUT, undo):
            pass

    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    call.make(play)
    monkeypatch.setattr(threading.Thread, "start", refuse)
    call.give_up()
    assert undone.is_set()
    assert undos.pending == ()
    undos.close()


def test_dropped_command_is_not_undone_when_its_call_is_aborted() -> None:
    undos, call = PendingUndos("robot"), PendingCall()
    undo = Undo(Closeable, lambda client, is_wanted: None)

    def play() -> None:
        with undos.command("play", TIMEOUT, undo):
            pass

    call.make(play)
    undos.drop()
    call.give_up()
    assert undos.pending == ()
    undos.close()
