"""The command channel on a clock that the test holds: how long it waits, what it decides anew, what it gives up."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import cast

import pytest

from linkcore.callbacks import CallbackThread
from linkcore.errors import Cancelled, ConnectionLost, LinkTimeout
from linkcore.streaming.connection import Connection
from tests.urlink.line import Line
from urlink.commanding.channel import CommandChannel
from urlink.commanding.interlock import Interlock
from urlink.commanding.monitor import SafetyMonitor
from urlink.commanding.section import Section
from urlink.errors import NotRunning, SafetyStop
from urlink.interfaces.enums import RobotMode, SafetyMode
from urlink.interfaces.primary.robot_state import MasterboardData, RobotModeData, RobotState
from urlink.interfaces.realtime.packets import RealtimeState

FIRMWARE = (5, 11)
TEXT = "movej(q)"


class Desk:
    """A channel to a robot with which all is well. Waiting for room takes `pace` seconds each time, and `meanwhile` is
    called then."""

    def __init__(self) -> None:
        self.now = 100.0
        self.pace = 0.2
        self.waits: list[float] = []
        self.meanwhile: Callable[[], object] = lambda: None
        self.line, fast = Line(self.wait), Line()
        primary, realtime = cast(Connection, self.line), cast(Connection, fast)
        section = Section(primary.reads_here)
        interlock = Interlock(stale_after=math.inf)
        self.monitor = SafetyMonitor(primary, realtime, interlock, section, CallbackThread("none"), lambda: self.now)
        self.channel = CommandChannel(primary, self.monitor, section, lambda: self.now)
        self.monitor.listen(closely=True)
        self.state()
        fast.tell(RealtimeState(FIRMWARE, robot_mode=RobotMode.RUNNING, safety_mode=SafetyMode.NORMAL))

    def state(self, safety: SafetyMode = SafetyMode.NORMAL, mode: RobotMode = RobotMode.RUNNING) -> None:
        modes = RobotModeData(FIRMWARE, robot_mode=mode)
        self.line.tell(RobotState(modes, MasterboardData(FIRMWARE, safety_mode=safety)))

    def wait(self, seconds: float) -> None:
        self.waits.append(seconds)
        self.now += self.pace
        self.meanwhile()


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_a_controller_has_half_a_second_to_take_a_text(desk: Desk) -> None:
    for room, aborts in ((0, 0), (3, 1)):  # what has left in part must not be seen
        desk.waits.clear()
        desk.line.room = room
        with pytest.raises(LinkTimeout, match=r"has not taken a text of 9 bytes within 0\.5 s; it was not sent"):
            desk.channel.motion(TEXT)
        assert desk.waits == pytest.approx([0.5, 0.3, 0.1])
        assert desk.line.aborts == aborts
    desk.line.room = None
    desk.channel.motion("stopj(2)")
    assert desk.line.sent == ["mov", "stopj(2)\n"]


@pytest.mark.parametrize("line", ["stopj(2)", "stopj(2)\n", "stopj(2)\n\n"])
def test_a_text_ends_in_one_newline(desk: Desk, line: str) -> None:
    desk.channel.motion(line)
    assert desk.line.sent == ["stopj(2)\n"]


def test_who_cannot_wait_sends_now_or_not_at_all(desk: Desk) -> None:
    desk.line.room = 0
    with pytest.raises(LinkTimeout, match="within 0 s"):
        desk.channel.motion(TEXT, wait=False)
    assert (desk.waits, desk.line.aborts) == ([], 0)
    desk.line.room = 3
    with pytest.raises(LinkTimeout, match="within 0 s"):
        desk.channel.motion(TEXT, wait=False)
    assert (desk.waits, desk.line.aborts) == ([], 1)


@pytest.mark.parametrize("room", [0, 3])
def test_it_is_decided_anew_after_each_wait(desk: Desk, room: int) -> None:
    """A text of which nothing has left is only kept back; of one that has begun nobody may see the rest."""
    desk.line.room = room

    def stop() -> None:
        desk.state(SafetyMode.PROTECTIVE_STOP)
        desk.line.room = None

    desk.meanwhile = stop
    with pytest.raises(SafetyStop):
        desk.channel.motion(TEXT)
    assert "".join(desk.line.sent) == TEXT[:room]
    assert desk.line.aborts == (room > 0)
    desk.state()
    desk.channel.motion("stopj(2)")
    assert desk.line.sent[-1] == "stopj(2)\n"


@pytest.mark.parametrize("room", [0, 3])
def test_what_has_begun_does_not_go_on_over_another_connection(desk: Desk, room: int) -> None:
    desk.line.room = room

    def reconnect() -> None:
        desk.line.counters.connections += 1
        desk.line.room = None

    desk.meanwhile = reconnect
    if room:
        with pytest.raises(ConnectionLost, match="connected anew while a text was sent"):
            desk.channel.motion(TEXT)
        assert desk.line.sent == ["mov"]
    else:
        desk.channel.motion(TEXT)
        assert desk.line.sent == [TEXT + "\n"]


def test_in_parts_over_the_same_connection(desk: Desk) -> None:
    desk.line.room = 3

    def make_room() -> None:
        desk.line.room = 4

    desk.meanwhile = make_room
    desk.channel.motion(TEXT)
    assert (desk.line.sent, desk.line.aborts) == (["mov", "ej(q", ")\n"], 0)
    desk.line.room = None
    desk.channel.command("set_tool_voltage(0)")
    assert desk.line.sent[3:] == ["set_tool_voltage(0)\n"]


def test_a_signal_handler_that_gave_the_text_up_is_believed(desk: Desk) -> None:
    """It interrupts the thread that waits for room for its text, and sends a stop; nothing of the text follows."""
    desk.line.room = 3
    raised: list[Exception] = []

    def interrupt() -> None:
        desk.meanwhile = lambda: None
        for _ in range(2):
            try:
                desk.channel.motion("stopj(2)", is_stop=True)
            except ConnectionLost as error:
                raised.append(error)
                desk.line.room = None

    desk.meanwhile = interrupt
    with pytest.raises(ConnectionLost, match="connected anew"):
        desk.channel.motion(TEXT)
    assert len(raised) == 1
    assert "only a part of the text before this one" in str(raised[0])
    # Aborted once: not also the connection that the stop has left by.
    assert (desk.line.sent, desk.line.aborts) == (["mov", "stopj(2)\n"], 1)


def test_who_waits_for_another_threads_text_leaves_the_processor_alone(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.line.room = 3
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
        desk.line.room = None
        go_on.set()
        first.join(10)

    monkeypatch.setattr("urlink.commanding.channel.time.sleep", pause)
    desk.channel.motion("stopj(2)")
    assert pauses == [0.001]
    assert desk.line.sent == ["mov", "ej(q)\n", "stopj(2)\n"]


#: What sends or asks, the state in its way, and whether news that lifts a stop is waited for, or that it runs.
NEWS: dict[str, tuple[Callable[[CommandChannel], object], dict[str, SafetyMode | RobotMode], bool]] = {
    "check": (lambda channel: channel.check(), {"safety": SafetyMode.PROTECTIVE_STOP}, True),
    "motion": (lambda channel: channel.motion(TEXT), {"safety": SafetyMode.PROTECTIVE_STOP}, True),
    "setpoint": (lambda channel: channel.setpoint(lambda: None), {"safety": SafetyMode.PROTECTIVE_STOP}, True),
    "command": (lambda channel: channel.command(TEXT), {"mode": RobotMode.IDLE}, False),
    "check_running": (lambda channel: channel.check_running(), {"mode": RobotMode.IDLE}, False),
}


@pytest.mark.parametrize("name", NEWS)
def test_what_is_in_the_way_may_be_over_already(desk: Desk, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The word that says so is waited for."""
    act, in_the_way, moves = NEWS[name]
    asked: list[bool] = []

    def await_news(moves: bool) -> None:
        asked.append(moves)
        desk.state()

    monkeypatch.setattr(desk.monitor, "await_news", await_news)
    desk.state(**in_the_way)  # type: ignore[arg-type]
    act(desk.channel)
    assert asked == [moves]
    if name == "motion":
        desk.state(**in_the_way)  # type: ignore[arg-type]
        with pytest.raises(SafetyStop):
            desk.channel.motion(TEXT, wait=False)
        assert asked == [moves]


def test_a_set_point_follows_news_only_of_an_arm_that_may_move(desk: Desk) -> None:
    sent: list[int] = []
    desk.monitor.await_news = lambda moves: desk.state()  # type: ignore[method-assign]
    for mode, safety in ((RobotMode.RUNNING, SafetyMode.FAULT), (RobotMode.IDLE, SafetyMode.NORMAL)):
        desk.state(safety, mode)
        desk.channel.setpoint(lambda: sent.append(1))
    assert sent == [1, 1]


def test_a_claim_that_raises_keeps_the_text(desk: Desk) -> None:
    def claim() -> None:
        raise Cancelled("given up")

    with pytest.raises(Cancelled):
        desk.channel.motion(TEXT, claim=claim)
    assert desk.line.sent == []


def test_only_what_was_sent_just_now_is_discarded(desk: Desk) -> None:
    desk.channel.discard(1000.0)
    assert desk.line.aborts == 0  # nothing was ever sent
    desk.channel.motion(TEXT)
    desk.now += 2.5
    desk.channel.discard(2.0)
    assert desk.line.aborts == 0
    desk.channel.discard(2.5)
    assert desk.line.aborts == 1
    desk.channel.discard(1000.0)
    assert desk.line.aborts == 1  # it is gone


def test_over_another_connection(desk: Desk) -> None:
    """Set-points need an arm that may be moved; what moves nothing needs a robot that runs."""
    sent: list[str] = []
    desk.state(SafetyMode.PROTECTIVE_STOP)
    desk.channel.check_running()
    desk.channel.beside(lambda: sent.append("setting"))
    for is_stop in (False, True):
        with pytest.raises(SafetyStop):
            desk.channel.setpoint(lambda: sent.append("set-point"), is_stop=is_stop)
    with pytest.raises(SafetyStop):
        desk.channel.check()
    desk.state(mode=RobotMode.POWER_OFF)
    with pytest.raises(NotRunning):
        desk.channel.check_running()
    with pytest.raises(NotRunning):
        desk.channel.beside(lambda: sent.append("setting"))
    assert sent == ["setting"]
    desk.state()
    desk.monitor._interlock.policy = "always"
    with pytest.raises(SafetyStop, match="not enabled"):
        desk.channel.setpoint(lambda: sent.append("set-point"))
    desk.channel.setpoint(lambda: sent.append("stop"), is_stop=True)
    with pytest.raises(SafetyStop, match="not enabled"):
        desk.channel.motion(TEXT)
    desk.channel.motion("stopj(2)", is_stop=True)
    assert (sent, desk.line.sent) == (["setting", "stop"], ["stopj(2)\n"])
