"""Command channel with a simulated clock: how long it waits, when it decides again, and when it aborts."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from linkcore.errors import Cancelled, ConnectionLost, LinkTimeout
from linkcore.pending_call import PendingCall, check_wanted
from tests.fakes.line import Desk, give_up, slow
from urlink.command.channel import CommandChannel
from urlink.errors import NotRunning, SafetyStop
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.protocol.primary.robot_state import RobotState

pytestmark = pytest.mark.simulated_time

TEXT = "movej(q)"


@pytest.fixture
def desk() -> Desk:
    desk = Desk()
    desk.clear()
    return desk


def test_motion_times_out_if_send_buffer_is_full_for_0_5_s(desk: Desk) -> None:
    # If only a part was sent, the connection is aborted, so that the controller does not receive the rest.
    for room, aborts in ((0, 0), (3, 1)):
        desk.waits.clear()
        desk.primary.room = room
        with pytest.raises(LinkTimeout, match=r"did not accept a text of 9 bytes within 0\.5 s; it was not sent"):
            desk.channel.motion(TEXT)
        assert desk.waits == pytest.approx([0.5, 0.3, 0.1])
        assert desk.primary.aborts == aborts
    desk.primary.room = None
    desk.channel.motion("stopj(2)")
    assert desk.sent == ["mov", "stopj(2)\n"]


@pytest.mark.parametrize("line", ["stopj(2)", "stopj(2)\n", "stopj(2)\n\n"])
def test_motion_sends_text_with_exactly_one_final_newline(desk: Desk, line: str) -> None:
    desk.channel.motion(line)
    assert desk.sent == ["stopj(2)\n"]


def test_motion_without_wait_sends_or_raises_immediately(desk: Desk) -> None:
    desk.primary.room = 0
    with pytest.raises(LinkTimeout, match="within 0 s"):
        desk.channel.motion(TEXT, wait=False)
    assert (desk.waits, desk.primary.aborts) == ([], 0)
    desk.primary.room = 3
    with pytest.raises(LinkTimeout, match="within 0 s"):
        desk.channel.motion(TEXT, wait=False)
    assert (desk.waits, desk.primary.aborts) == ([], 1)


@pytest.mark.parametrize("room", [0, 3])
def test_motion_checks_interlock_again_after_each_wait(desk: Desk, room: int) -> None:
    """An unsent text is held back; after a partly sent text, the connection is aborted."""
    desk.primary.room = room

    def stop() -> None:
        desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
        desk.primary.room = None

    desk.meanwhile = stop
    with pytest.raises(SafetyStop):
        desk.channel.motion(TEXT)
    assert "".join(desk.sent) == TEXT[:room]
    assert desk.primary.aborts == (room > 0)
    desk.primary.deliver(slow())
    desk.channel.motion("stopj(2)")
    assert desk.sent[-1] == "stopj(2)\n"


@pytest.mark.parametrize("room", [0, 3])
def test_partly_sent_script_is_not_continued_on_a_new_connection(desk: Desk, room: int) -> None:
    desk.primary.room = room

    def reconnect() -> None:
        desk.primary.counters.connections += 1
        desk.primary.room = None

    desk.meanwhile = reconnect
    if room:
        with pytest.raises(ConnectionLost, match="was reconnected while a text was sent"):
            desk.channel.motion(TEXT)
        assert desk.sent == ["mov"]
    else:
        desk.channel.motion(TEXT)
        assert desk.sent == [TEXT + "\n"]


@pytest.mark.parametrize("error", [ConnectionLost("pulled"), KeyboardInterrupt()])
@pytest.mark.parametrize("is_new", [False, True])
def test_error_while_waiting_for_room_does_not_block_next_text(desk: Desk, error: BaseException, is_new: bool) -> None:
    """The connection is lost in the middle of the text, or Ctrl-C is pressed. A connection made meanwhile stays."""
    desk.primary.room = 3

    def end() -> None:
        desk.meanwhile = lambda: None
        desk.primary.counters.connections += is_new
        desk.primary.room = None
        raise error

    desk.meanwhile = end
    with pytest.raises(type(error)):
        desk.channel.motion(TEXT)
    desk.channel.motion("stopj(2)", is_stop=True)
    assert (desk.sent, desk.primary.aborts) == (["mov", "stopj(2)\n"], not is_new)


def test_text_is_sent_in_parts_over_the_same_connection(desk: Desk) -> None:
    desk.primary.room = 3

    def make_room() -> None:
        desk.primary.room = 4

    desk.meanwhile = make_room
    desk.channel.motion(TEXT)
    assert (desk.sent, desk.primary.aborts) == (["mov", "ej(q", ")\n"], 0)
    desk.primary.room = None
    desk.channel.command("set_tool_voltage(0)")
    assert desk.sent[3:] == ["set_tool_voltage(0)\n"]


def test_interrupted_text_is_not_continued_after_signal_handler(desk: Desk) -> None:
    """The handler interrupts a thread that waits for room, and sends a stop. The rest of the text is not sent."""
    desk.primary.room = 3
    raised: list[Exception] = []

    def interrupt() -> None:
        desk.meanwhile = lambda: None
        for _ in range(2):
            try:
                desk.channel.motion("stopj(2)", is_stop=True)
            except ConnectionLost as error:
                raised.append(error)
                desk.primary.room = None

    desk.meanwhile = interrupt
    with pytest.raises(ConnectionLost, match="was reconnected"):
        desk.channel.motion(TEXT)
    assert len(raised) == 1
    assert "only a part of the previous text" in str(raised[0])
    # Aborted only once: the new connection, which has sent the stop, is kept.
    assert (desk.sent, desk.primary.aborts) == (["mov", "stopj(2)\n"], 1)


def test_thread_sleeps_while_another_thread_sends_its_script(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.primary.room = 3
    begun, go_on = threading.Event(), threading.Event()

    def hold() -> None:
        begun.set()
        assert go_on.wait(10)

    desk.meanwhile = hold
    first = threading.Thread(target=desk.channel.motion, args=(TEXT,))
    first.start()
    assert begun.wait(10)
    pauses: list[float] = []

    def pause(seconds: float) -> None:
        pauses.append(seconds)
        desk.primary.room = None
        go_on.set()
        first.join(10)

    monkeypatch.setattr("urlink.command.channel.clock.sleep", pause)
    desk.channel.motion("stopj(2)")
    assert pauses == [0.001]
    assert desk.sent == ["mov", "ej(q)\n", "stopj(2)\n"]


#: For each case: the call, the state that blocks it, and whether stops block it (otherwise only a robot that is off).
NEWS: dict[str, tuple[Callable[[CommandChannel], object], RobotState, bool]] = {
    "check": (lambda channel: channel.check(), slow(SafetyMode.PROTECTIVE_STOP), True),
    "motion": (lambda channel: channel.motion(TEXT), slow(SafetyMode.PROTECTIVE_STOP), True),
    "setpoint": (lambda channel: channel.setpoint(lambda: None), slow(SafetyMode.PROTECTIVE_STOP), True),
    "command": (lambda channel: channel.command(TEXT), slow(mode=RobotMode.IDLE), False),
    "check_running": (lambda channel: channel.check_running(), slow(mode=RobotMode.IDLE), False),
}


@pytest.mark.parametrize("name", NEWS)
def test_call_waits_for_next_state_if_last_one_forbids_motion(
    desk: Desk, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The blocking state may be outdated, so the call waits for the next report."""
    act, in_the_way, moves = NEWS[name]
    asked: list[bool] = []

    def await_news(moves: bool) -> None:
        asked.append(moves)
        desk.primary.deliver(slow())

    monkeypatch.setattr(desk.monitor, "await_news", await_news)
    desk.primary.deliver(in_the_way)
    act(desk.channel)
    assert asked == [moves]
    if name == "motion":
        desk.primary.deliver(in_the_way)
        with pytest.raises(SafetyStop):
            desk.channel.motion(TEXT, wait=False)
        assert asked == [moves]


def test_setpoint_is_sent_when_next_report_permits_motion(desk: Desk) -> None:
    sent: list[int] = []
    desk.monitor.await_news = lambda moves: desk.primary.deliver(slow())  # type: ignore[method-assign]
    for mode, safety in ((RobotMode.RUNNING, SafetyMode.FAULT), (RobotMode.IDLE, SafetyMode.NORMAL)):
        desk.primary.deliver(slow(safety, mode))
        desk.channel.setpoint(lambda: sent.append(1))
    assert sent == [1, 1]


def test_motion_sends_nothing_when_claim_raises(desk: Desk) -> None:
    def claim() -> None:
        raise Cancelled("given up")

    with pytest.raises(Cancelled):
        desk.channel.motion(TEXT, claim=claim)
    assert desk.sent == []


def test_claimed_text_is_sent_when_its_task_is_cancelled(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next text stops the last claimed program, so the claimed program must have been sent."""
    call, send = PendingCall(), desk.primary.send_some

    def as_a_transport(data: memoryview) -> int:
        check_wanted()
        return send(data)

    monkeypatch.setattr(desk.primary, "send_some", as_a_transport)
    call.make(lambda: desk.channel.motion(TEXT, claim=lambda: call.give_up(lambda cancel: cancel())))
    assert desk.sent == [f"{TEXT}\n"]
    with pytest.raises(Cancelled, match="nothing more is sent"):
        call.make(lambda: desk.channel.motion(TEXT, claim=lambda: pytest.fail("the text was claimed")))
    assert desk.sent == [f"{TEXT}\n"]


def test_discard_aborts_only_if_a_script_was_sent_recently(desk: Desk) -> None:
    desk.channel.discard(1000.0)
    assert desk.primary.aborts == 0  # nothing was ever sent
    desk.channel.motion(TEXT)
    desk.clock.now += 2.5
    desk.channel.discard(2.0)
    assert desk.primary.aborts == 0
    desk.channel.discard(2.5)
    assert desk.primary.aborts == 1
    desk.channel.discard(1000.0)
    assert desk.primary.aborts == 1  # nothing was sent since the last abort


def test_setting_and_set_point_check_safety_and_robot_mode(desk: Desk) -> None:
    """Set-points need an arm that may be moved; settings that move nothing need only a running robot."""
    sent: list[str] = []
    desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    desk.channel.check_running()
    desk.channel.beside(lambda: sent.append("setting"))
    for is_stop in (False, True):
        with pytest.raises(SafetyStop):
            desk.channel.setpoint(lambda: sent.append("set-point"), is_stop=is_stop)
    with pytest.raises(SafetyStop):
        desk.channel.check()
    desk.primary.deliver(slow(mode=RobotMode.POWER_OFF))
    with pytest.raises(NotRunning):
        desk.channel.check_running()
    with pytest.raises(NotRunning):
        desk.channel.beside(lambda: sent.append("setting"))
    assert sent == ["setting"]
    desk.primary.deliver(slow())
    desk.interlock.policy = "always"
    with pytest.raises(SafetyStop, match="not enabled"):
        desk.channel.setpoint(lambda: sent.append("set-point"))
    desk.channel.setpoint(lambda: sent.append("stop"), is_stop=True)
    with pytest.raises(SafetyStop, match="not enabled"):
        desk.channel.motion(TEXT)
    desk.channel.motion("stopj(2)", is_stop=True)
    assert (sent, desk.sent) == (["setting", "stop"], ["stopj(2)\n"])


@pytest.mark.parametrize(
    ("options", "may_wait", "order", "pending"),
    [
        ({}, True, ["undone", "sent"], ()),
        ({"is_stop": True}, True, ["sent"], ("play",)),
        ({"wait": False}, True, ["sent"], ("play",)),
        ({}, False, ["sent"], ("play",)),
        ({"is_stop": True, "replaces": True}, True, ["sent"], ()),
    ],
)
def test_motion_undoes_abandoned_command_first(
    options: dict[str, bool], may_wait: bool, order: list[str], pending: tuple[str, ...]
) -> None:
    """Pending undos wait for a call that can wait and is not a stop. A replacing program drops them."""
    desk, seen = Desk(may_wait=may_wait), list[str]()
    desk.clear()
    undos = desk.undos

    def undo(client: object, is_wanted: Callable[[], bool]) -> None:
        time.sleep(0.3)
        if is_wanted():
            seen.append("undone")

    give_up(undos, "play", undo)
    desk.channel.motion(TEXT, claim=lambda: seen.append("sent"), **options)
    assert (seen, undos.pending) == (order, pending)
    undos.close()


def test_motion_waits_one_second_for_failing_undo() -> None:
    desk = Desk(may_wait=True)
    desk.clear()
    undos = desk.undos

    def undo(client: object, is_wanted: Callable[[], bool]) -> None:
        raise ConnectionLost("it is away")

    give_up(undos, "play", undo)
    begin = time.monotonic()
    desk.channel.motion(TEXT)
    assert time.monotonic() - begin == pytest.approx(1.0, abs=0.05)
    assert (desk.sent, undos.pending) == ([TEXT + "\n"], ("play",))
    undos.close()
