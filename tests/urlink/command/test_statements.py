"""Requests of interpreter mode to a controller, statement by statement; controller and clock are simulated."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, cast

import pytest

from linkcore.errors import (
    BadValue,
    Cancelled,
    ConnectFailed,
    ConnectionLost,
    LinkError,
    LinkTimeout,
    LocalError,
    RemoteError,
)
from linkcore.net.dialogue import Dialogue
from linkcore.net.undo import PendingUndos, Undo
from tests.fakes.line import Programming, slow
from urlink.command import interpreter as module
from urlink.command.interpreter import Interpreter, Interpreters, InterpreterState
from urlink.errors import NotRunning, SafetyStop, StatementDiscarded
from urlink.protocol.enums import SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.primary.robot_message import TextMessage

EXECUTED = "statelastexecuted"


class Peer:
    """Stand-in for a dialogue: acknowledges each statement, and reports that the last one has begun."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.timeouts: list[float] = []
        #: Next replies, instead of the default ones.
        self.answers: deque[str | LinkError] = deque()
        self.last = 0
        #: Number of acknowledged statements that have not begun.
        self.lag = 0
        self.is_closed = False

    def ask(
        self,
        line: str,
        timeout: float,
        gate: Callable[[Callable[[], object]], object] = lambda send: send(),
        given_up: Callable[[], object] | None = None,
    ) -> str:
        gate(lambda: self.asked.append(line))
        self.timeouts.append(timeout)
        if self.answers:
            answer = self.answers.popleft()
            if isinstance(answer, LinkError):
                raise answer
            return answer
        if line == EXECUTED:
            return f"state: {self.last - self.lag}: {line}"
        if line.startswith("state") or line in ("abort", "skipbuffer"):
            return f"state: {len(line)}: {line}"
        self.last += 1
        return f"ack: {self.last}: {line}"

    def close(self) -> None:
        self.is_closed = True


class Mode(Programming):
    """Interpreter mode of a robot without any stop. Time passes only during sleeps."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.peer = Peer()
        self.clock.replace(module, monkeypatch)
        self.life = self.programs.life("interpreter mode")
        dialogue = cast(Dialogue, self.peer)
        self.undos = PendingUndos("robot")

        def client() -> Dialogue:
            raise AssertionError("no command was abandoned")

        undo = Undo(client, lambda client, is_wanted: None)
        self.interpreter = Interpreter(self.life, dialogue, self.channel, self.undos, undo, 42.0)


@pytest.fixture
def mode(monkeypatch: pytest.MonkeyPatch) -> Mode:
    return Mode(monkeypatch)


def waits_of(mode: Mode, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a list that collects the timeouts of all later waits for the end of the program, in seconds."""
    waits: list[float] = []
    monkeypatch.setattr(mode.interpreter, "wait", waits.append)
    return waits


# -- statements --------------------------------------------------------------------------------------------


def test_statement_is_sent_through_the_interlock(mode: Mode) -> None:
    assert [mode.interpreter.execute("a = 1"), mode.interpreter.execute("a = 2")] == [1, 2]
    mode.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    with pytest.raises(SafetyStop):
        mode.interpreter.execute("a = 3")
    # Commands that end a motion do not ask the interlock.
    mode.interpreter.abort()
    mode.interpreter.skip()
    assert mode.peer.asked == ["a = 1", "a = 2", "abort", "skipbuffer"]
    assert set(mode.peer.timeouts) == {5.0}


@pytest.mark.parametrize(
    ("end", "error"),
    [
        (lambda life: life.finish(), "interpreter mode has ended"),
        (lambda life: life.cancel("given up"), "interpreter mode was given up"),
    ],
)
def test_statement_after_the_end_is_not_sent(mode: Mode, end: Callable[[Any], object], error: str) -> None:
    end(mode.life)
    with pytest.raises(Cancelled, match=error):
        mode.interpreter.execute("a = 1")
    assert mode.peer.asked == []
    if mode.life.error is not None:
        with pytest.raises(Cancelled, match=error):
            mode.interpreter.abort()
        assert mode.peer.asked == []


def test_statement_with_compile_error_raises_immediately(mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    waits = waits_of(mode, monkeypatch)
    mode.peer.answers.append("discard: 7: nobody(1)")
    with pytest.raises(StatementDiscarded) as caught:
        mode.interpreter.execute("nobody(1)")
    assert (caught.value.statement, waits) == ("nobody(1)", [])
    # Without a number, no program accepts statements; the reason is reported a little later.
    mode.peer.answers += ["discard: 0: a = 1"] * 2
    with pytest.raises(StatementDiscarded):
        mode.interpreter.execute("a = 1")
    assert waits == [1.5]

    def hear(timeout: float) -> None:
        mode.life.fail(NotRunning("no power"))

    monkeypatch.setattr(mode.interpreter, "wait", hear)
    with pytest.raises(NotRunning, match="no power"):
        mode.interpreter.execute("a = 1")


def test_interpreter_clears_statements_after_every_500(mode: Mode) -> None:
    clears = []
    for _ in range(1001):
        before = len(mode.peer.asked)
        mode.interpreter.execute("n = n + 1")
        if len(mode.peer.asked) > before + 1:
            clears.append(before)
            # They are cleared only after they have ended; otherwise they would be lost.
            assert mode.peer.asked[before:] == ["sync()", EXECUTED, "clear_interpreter()", "n = n + 1"]
    assert clears == [500, 1003]  # the first clearing needed three additional requests


# -- waiting -------------------------------------------------------------------------------------------------


def test_wait_executed_polls_until_its_barrier_has_begun(mode: Mode) -> None:
    mode.interpreter.execute("movej(q)")
    mode.peer.lag = 1

    def go_on() -> None:
        mode.peer.lag = len(mode.clock.sleeps) < 3

    mode.clock.meanwhile = go_on
    mode.interpreter.wait_executed(1.0)
    assert mode.clock.sleeps == [0.02] * 3
    assert mode.peer.asked == ["movej(q)", "sync()", *[EXECUTED] * 4]


@pytest.mark.parametrize(("seconds", "sleeps"), [(0.0, []), (0.02, [0.02]), (0.05, [0.02, 0.02, 0.01])])
def test_wait_executed_raises_timeout(mode: Mode, seconds: float, sleeps: list[float]) -> None:
    mode.clock.now, mode.peer.lag = 0.0, 1
    state = r"InterpreterState\(last_interpreted=20, last_executed=0, last_cleared=16, unexecuted=15\)"
    with pytest.raises(LinkTimeout, match=rf"did not end within {seconds:g} s: {state}; they continue"):
        mode.interpreter.wait_executed(seconds)
    assert mode.clock.sleeps == pytest.approx(sleeps)


@pytest.mark.parametrize(
    ("act", "seconds"),
    [
        (lambda i: i.wait_executed(), 60),
        (lambda i: i.execute("a = 1", wait=True), 60),
        (lambda i: i.execute("a = 1", wait=7.0), 7),
    ],
)
def test_interpreter_waits_raise_after_their_default_timeout(
    mode: Mode, act: Callable[[Interpreter], object], seconds: int
) -> None:
    mode.peer.lag = 1
    mode.clock.meanwhile = lambda: setattr(mode.clock, "now", mode.clock.now + 100.0)
    with pytest.raises(LinkTimeout, match=f"within {seconds} s"):
        act(mode.interpreter)


@pytest.mark.parametrize(
    "act",
    [
        lambda i: i.wait_executed(float("inf")),
        lambda i: i.end(float("inf")),
        lambda i: i.execute("a = 1", wait=float("inf")),
    ],
)
def test_infinite_timeout_is_rejected(mode: Mode, act: Callable[[Interpreter], object]) -> None:
    with pytest.raises(BadValue):
        act(mode.interpreter)
    assert mode.peer.asked == []


def test_clear_returns_statement_number(mode: Mode) -> None:
    assert (mode.interpreter.execute("a = 1"), mode.interpreter.clear()) == (1, 2)


def test_interpreter_state_asks_for_the_furthest_number_last(mode: Mode) -> None:
    mode.peer.answers += [f"state: {number}: x" for number in (3, 5, 7, 9)]
    assert mode.interpreter.state == InterpreterState(9, 7, 5, 3)
    # Statements are executed between the queries, so a later reply shows more progress.
    assert mode.peer.asked == ["stateunexecuted", "statelastcleared", EXECUTED, "statelastinterpreted"]


# -- ending --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("timeout", "seconds"), [(None, 42.0), (0.0, 0.0), (3.0, 3.0)])
def test_end_sends_a_statement_and_waits(
    mode: Mode, timeout: float | None, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits = waits_of(mode, monkeypatch)
    mode.interpreter.end(timeout)
    assert (mode.peer.asked, waits, mode.peer.is_closed) == (["end_interpreter()"], [seconds], True)
    assert mode.interpreter.done
    mode.interpreter.end()
    assert mode.peer.asked == ["end_interpreter()"]


def leave_by(mode: Mode, error: BaseException | None) -> None:
    with mode.interpreter:
        if error is not None:
            raise error


def test_exception_in_block_brakes_and_closes(mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    waits_of(mode, monkeypatch)
    brakes: list[int] = []
    mode.life.brake = lambda: brakes.append(1)
    with pytest.raises(KeyboardInterrupt):
        leave_by(mode, KeyboardInterrupt())
    assert (mode.peer.asked, brakes, mode.peer.is_closed) == ([], [1], True)


def test_interpreter_mode_ends_when_the_block_ends_normally(mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    waits = waits_of(mode, monkeypatch)
    leave_by(mode, None)
    assert (mode.peer.asked, waits, mode.peer.is_closed) == (["end_interpreter()"], [42.0], True)


@pytest.mark.parametrize(
    ("error", "is_told"),
    [
        (SafetyStop("stopped", "protective stop"), True),
        (NotRunning("silent"), True),
        (ConnectionLost("pulled"), True),
        (RemoteError("failed"), False),
    ],
)
def test_interpreter_end_aborts_a_paused_program(mode: Mode, error: LinkError, is_told: bool) -> None:
    """A stop only pauses the program."""
    mode.life.fail(error)
    with pytest.raises(type(error)):
        mode.interpreter.end()
    assert mode.peer.asked == (["skipbuffer", "abort", "end_interpreter()"] if is_told else [])
    assert set(mode.peer.timeouts) <= {0.5}  # no caller waits for these replies
    assert mode.peer.is_closed


def test_end_logs_when_controller_does_not_reply(mode: Mode, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    mode.life.fail(NotRunning("silent"))
    mode.peer.answers.append(LinkTimeout("no reply"))
    with pytest.raises(NotRunning):
        mode.interpreter.end()
    assert "its program might still be waiting for statements: no reply" in caplog.text
    assert mode.peer.is_closed


# -- beginning -------------------------------------------------------------------------------------------------


class Beginning(Mode):
    """Start of interpreter mode; `peers` lists the created dialogues."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(monkeypatch)
        self.peers: list[Peer] = []
        monkeypatch.setattr(module, "Dialogue", self._dialogue)

    def _dialogue(self, transport: object, protocol: object, name: str, timeout: float) -> Peer:
        assert name.startswith("interpreter mode at ")
        assert timeout == 3.0
        self.peers.append(self.peer)
        peer, self.peer = self.peer, Peer()
        return peer

    def interpreters(self, firmware: str = "5.10", port: int | None = 30020) -> Interpreters:
        asked = Firmware.parse(firmware)
        return Interpreters("robot", port, self.programs, self.channel, self.callbacks, lambda: asked, self.undos, 3.0)


@pytest.fixture
def beginning(monkeypatch: pytest.MonkeyPatch) -> Beginning:
    return Beginning(monkeypatch)


def test_mode_begins_when_controller_accepts_a_statement(beginning: Beginning) -> None:
    beginning.peer.answers += [f"state: 0: {EXECUTED}", *["discard: 0: sync()"] * 2, "ack: 1: sync()"]
    texts: list[str] = []
    interpreter = beginning.interpreters().begin(10.0, 60.0, texts.append)
    (peer,) = beginning.peers
    assert peer.asked == [EXECUTED, "sync()", "sync()", "sync()"]
    assert beginning.clock.sleeps == [0.02, 0.02]
    assert "interpreter_mode()" in beginning.sent[0]
    name = beginning.sent[0].split()[1].removesuffix("():")
    beginning.key("PROGRAM_XXX_STARTED", name)
    beginning.primary.deliver(TextMessage((5, 11), text="hello"))
    assert interpreter.texts == ("hello",)
    assert texts == ["hello"]
    interpreter.cancel()
    assert beginning.stops == 1


def test_nothing_is_sent_when_service_is_off(beginning: Beginning) -> None:
    beginning.peer.answers.append(ConnectFailed("refused"))
    with pytest.raises(ConnectFailed):
        beginning.interpreters().begin(10.0, 60.0, None)
    assert (beginning.sent, beginning.peers[0].is_closed) == ([], True)


@pytest.mark.parametrize(("seconds", "sleeps"), [(0.02, [0.02]), (0.05, [0.02, 0.02, 0.01])])
def test_interpreter_mode_that_does_not_begin_times_out(
    beginning: Beginning, seconds: float, sleeps: list[float]
) -> None:
    beginning.clock.now = 0.0
    beginning.peer.answers += [f"state: 0: {EXECUTED}", *["discard: 0: sync()"] * 9]
    with pytest.raises(LinkTimeout, match=f"did not begin within {seconds:g} s"):
        beginning.interpreters().begin(seconds, 60.0, None)
    assert beginning.clock.sleeps == pytest.approx(sleeps)
    assert beginning.peers[0].is_closed
    assert beginning.stops == 1  # the program may be in the mode by now


def test_program_that_ended_before_the_mode_began_raises(beginning: Beginning, monkeypatch: pytest.MonkeyPatch) -> None:
    lives, life_of = [], beginning.programs.life

    def life(name: str, kind: str | None = None) -> Any:
        lives.append(life_of(name))
        return lives[-1]

    monkeypatch.setattr(beginning.programs, "life", life)
    ends: list[tuple[Callable[[Any], object], type[LinkError], str]] = [
        (lambda life: life.finish(), RemoteError, "interpreter mode ended before it accepted a statement"),
        (lambda life: life.fail(NotRunning("no power")), NotRunning, "no power"),
    ]
    for end, error, words in ends:
        beginning.peer.answers += [f"state: 0: {EXECUTED}", "discard: 0: sync()"]
        beginning.clock.meanwhile = lambda end=end: end(lives[-1])  # type: ignore[misc]
        with pytest.raises(error, match=words):
            beginning.interpreters().begin(10.0, 60.0, None)


@pytest.mark.parametrize(
    "arguments",
    [(0.0, 60.0, None), (float("inf"), 60.0, None), (10.0, float("inf"), None), (10.0, -1, None), (1, 1, 3)],
)
def test_begin_rejects_invalid_arguments_and_old_firmware(
    beginning: Beginning, arguments: tuple[Any, Any, Any]
) -> None:
    with pytest.raises(BadValue):
        beginning.interpreters().begin(*arguments)
    with pytest.raises(LocalError, match=r"5\.9 has no interpreter mode; 5\.10 or later is required"):
        beginning.interpreters("5.9").begin(10.0, 60.0, None)
    with pytest.raises(LocalError, match="does not serve interpreter mode"):
        beginning.interpreters(port=None).begin(10.0, 60.0, None)
    assert beginning.peers == []


def test_close_disconnects_open_interpreters(beginning: Beginning) -> None:
    interpreters = beginning.interpreters()
    first = interpreters.begin(10.0, 60.0, None)
    interpreters.begin(10.0, 60.0, None)
    first._close()
    interpreters.begin(10.0, 60.0, None)
    assert [peer.is_closed for peer in beginning.peers] == [True, False, False]
    assert len(interpreters._open) == 2  # ended interpreters are forgotten
    interpreters.close()
    assert all(peer.is_closed for peer in beginning.peers)
