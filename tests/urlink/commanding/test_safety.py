"""`robot.safety` and the outlet over streams: what is heard when, and who is told."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from linkcore.errors import BadValue, Closed, ConnectFailed, ConnectionLost, LinkError, LinkTimeout
from linkcore.streaming.backoff import Backoff
from tests.linkcore.script import ScriptedTransport
from tests.urlink.stand_in import StandIn
from tests.waiting import until
from urlink.commanding import interlock as gate
from urlink.commanding import safety
from urlink.errors import NotEnabled, NotRunning, SafetyStop
from urlink.interfaces.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode


@pytest.fixture
def robot() -> Iterator[StandIn]:
    with StandIn() as robot:
        yield robot


def test_nothing_connects_before_it_is_used(robot: StandIn) -> None:
    assert robot.slow.opened == robot.fast.opened == 0
    robot.state(fast=False)
    assert robot.safety.mode is SafetyMode.NORMAL
    assert robot.safety.robot_mode is RobotMode.RUNNING
    assert (robot.slow.opened, robot.fast.opened) == (1, 0)
    robot.channel.command("set_tool_voltage(0)")
    assert robot.fast.opened == 0
    robot.state()
    robot.channel.motion("movej(q)")
    assert robot.fast.opened == 1
    assert robot.sent == ["set_tool_voltage(0)\n", "movej(q)\n"]


def test_a_stop_ends_motions_at_once_and_refuses_new_ones(robot: StandIn) -> None:
    robot.clear()
    heard: list[LinkError] = []
    remove = robot.safety.on_stop(heard.append)
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: heard)
    assert isinstance(heard[0], SafetyStop)
    assert heard[0].cause == robot.safety.cause == "protective stop"
    with pytest.raises(SafetyStop, match="protective stop"):
        robot.channel.motion("movej(q)")
    with pytest.raises(SafetyStop, match="protective stop"):
        robot.channel.setpoint(heard.clear)
    robot.channel.command("set_tool_voltage(0)")
    assert robot.sent == ["set_tool_voltage(0)\n"]
    robot.state()
    robot.safety.wait_enabled(5)
    robot.channel.motion("movej(q)")
    remove()
    robot.state(safety=SafetyMode.FAULT)
    until(lambda: not robot.safety.is_enabled)
    assert len(heard) == 1


def test_the_fast_stream_alone_tells_of_a_stop(robot: StandIn) -> None:
    robot.clear()
    heard: list[LinkError] = []
    robot.safety.on_stop(heard.append)
    robot.state(safety=SafetyMode.SAFEGUARD_STOP)
    # The state on the primary interface comes up to 100 ms later.
    robot.slow.put(ConnectionLost("pulled"))
    until(lambda: heard)
    assert isinstance(heard[0], (SafetyStop, NotRunning))
    assert len(heard) == 1


def test_a_message_is_quicker_than_the_state(robot: StandIn) -> None:
    robot.clear()
    robot.safety_message(SafetyMode.VIOLATION)
    until(lambda: robot.safety.cause == "violation")
    assert robot.safety.mode is SafetyMode.VIOLATION


def test_one_callback_that_raises_harms_no_other(robot: StandIn, caplog: pytest.LogCaptureFixture) -> None:
    robot.clear()
    heard: list[LinkError] = []

    def fail(error: LinkError) -> None:
        raise RuntimeError("on purpose")

    robot.safety.on_stop(fail)
    robot.safety.on_stop(heard.append)
    robot.state(emergency=True)
    until(lambda: heard)
    assert "on_stop raised" in caplog.text


@pytest.mark.parametrize("is_fast", [False, True])
def test_a_lost_connection_is_no_knowledge(robot: StandIn, is_fast: bool) -> None:
    robot.clear()
    heard: list[LinkError] = []
    robot.safety.on_stop(heard.append)
    (robot.fast if is_fast else robot.slow).put(ConnectionLost("pulled"))
    until(lambda: heard)
    assert isinstance(heard[0], NotRunning)
    assert "is lost" in str(heard[0])
    with pytest.raises(NotRunning, match="pulled"):
        robot.channel.motion("movej(q)")
    robot.state()
    robot.safety.wait_enabled(5)


def test_silence_is_no_knowledge(robot: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "STALE", 0.05)
    monkeypatch.setattr(safety, "STALE", 0.05)
    heard: list[LinkError] = []
    robot.safety.on_stop(heard.append)
    robot.clear()
    until(lambda: heard)
    assert isinstance(heard[0], NotRunning)
    with pytest.raises(NotRunning, match="nothing has been heard"):
        robot.channel.motion("movej(q)")
    assert robot.sent == []


def test_nothing_heard_at_all(robot: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(safety, "_FIRST_WORD", 0.05)
    with pytest.raises(NotRunning, match="yet; nothing was sent"):
        robot.channel.command("set_tool_voltage(0)")
    assert robot.safety.mode is None
    assert robot.safety.robot_mode is None


def test_nobody_there(robot: StandIn) -> None:
    robot.fast = ScriptedTransport(ConnectFailed("refused"))
    robot.realtime._connection._transport = robot.fast
    robot.state()
    with pytest.raises(ConnectFailed, match="refused"):
        robot.channel.motion("movej(q)")
    robot.state()
    robot.channel.command("set_tool_voltage(0)")  # for which the primary interface is enough
    robot.state()
    robot.channel.motion("movej(q)")  # by now somebody is


def test_policies_over_the_streams() -> None:
    with StandIn(policy="always") as robot:
        robot.clear()
        with pytest.raises(NotEnabled, match="enable"):
            robot.channel.motion("movej(q)")
        robot.safety.wait_until_clear(5)
        with pytest.raises(LinkTimeout, match="not enabled"):
            robot.safety.wait_enabled(0.01)
        waiting = threading.Thread(target=robot.safety.wait_enabled, args=(10,))
        waiting.start()
        robot.clear()
        robot.safety.enable()
        waiting.join(10)
        robot.safety.wait_enabled(0)
        robot.state(safety=SafetyMode.PROTECTIVE_STOP)
        until(lambda: robot.safety.cause)
        with pytest.raises(SafetyStop) as caught:
            robot.safety.enable()
        assert not isinstance(caught.value, NotEnabled)
        robot.state()
        robot.safety.wait_until_clear(5)
        assert not robot.safety.is_enabled
        robot.safety.policy = "never"
        robot.safety.wait_enabled(0)
        with pytest.raises(BadValue):
            robot.safety.policy = "no"  # type: ignore[assignment]


def test_listening_more_closely_closes_nothing() -> None:
    """The first motion asks the real-time interface too; until that speaks, what was enabled stays so."""
    with StandIn(policy="always") as robot:
        robot.state(fast=False)
        robot.safety.enable()
        heard: list[LinkError] = []
        robot.safety.on_stop(heard.append)
        mover = threading.Thread(target=robot.channel.motion, args=("movej(q)",))
        mover.start()
        until(lambda: robot.fast.opened == 1)
        before = robot.primary.stats.decoded
        robot.state(fast=False)
        until(lambda: robot.primary.stats.decoded > before)
        assert robot.sent == []
        robot.state()
        mover.join(10)
        assert robot.sent == ["movej(q)\n"]
        assert heard == []


def test_waiting_says_what_hinders(robot: StandIn) -> None:
    robot.state(RobotMode.IDLE)
    with pytest.raises(LinkTimeout, match="IDLE"):
        robot.safety.wait_until_clear(0.01)
    assert "IDLE" in repr(robot.safety)


@pytest.mark.parametrize("timeout", [None, -1.0, float("inf"), "soon"])
def test_waiting_for_no_number_of_seconds(robot: StandIn, timeout: Any) -> None:
    for wait in (robot.safety.wait_enabled, robot.safety.wait_until_clear, robot.safety.wait_for_stop):
        with pytest.raises(BadValue, match="timeout"):
            wait(timeout)
    with pytest.raises(BadValue, match="called"):
        robot.safety.on_stop(timeout)


def test_cb2() -> None:
    with StandIn("1.8") as robot:
        robot.clear()
        assert robot.safety.mode is None
        robot.channel.motion("movej(q)")
        robot.state(RobotModeCB2.SECURITY_STOPPED, protective=True)
        until(lambda: robot.safety.cause == "protective stop")
        robot.state(RobotModeCB2.NO_POWER)
        until(lambda: robot.safety.cause is None)
        with pytest.raises(NotRunning, match="NO_POWER"):
            robot.channel.motion("movej(q)")
        robot.state(master=MasterSafetyState.SAFEGUARD_STOP)
        until(lambda: robot.safety.cause == "safeguard stop")
    assert robot.sent == ["movej(q)\n"]


def test_a_stop_waits_for_what_is_being_sent(robot: StandIn) -> None:
    """Check and send are one: what was admitted is out before the stop is told to anybody."""
    robot.clear()
    order: list[str] = []
    robot.safety.on_stop(lambda error: order.append("stop"))
    inside, go_on = threading.Event(), threading.Event()

    def send() -> None:
        inside.set()
        assert go_on.wait(10)
        order.append("sent")

    sender = threading.Thread(target=robot.channel.setpoint, args=(send,))
    sender.start()
    assert inside.wait(10)
    before = robot.primary.stats.received
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: robot.primary.stats.received > before)
    assert order == []
    go_on.set()
    sender.join(10)
    until(lambda: len(order) == 2)
    assert order == ["sent", "stop"]


def test_callbacks_are_called_without_the_lock(robot: StandIn) -> None:
    """Else a motion that holds its own lock and asks the gate, and a stop that wants that lock, would wait for ever."""
    robot.clear()
    own, stopped = threading.Lock(), threading.Event()

    def stop(error: LinkError) -> None:
        with own:
            stopped.set()

    robot.safety.on_stop(stop)
    with own:
        robot.state(safety=SafetyMode.PROTECTIVE_STOP)
        until(lambda: robot.safety.cause)
        with pytest.raises(SafetyStop):
            robot.channel.setpoint(lambda: None)
    assert stopped.wait(10)


def test_a_stream_that_gave_up_is_listened_to_anew() -> None:
    with StandIn(backoff=Backoff(tries=0)) as robot:
        robot.clear()
        program = robot.script.run("movej(q)")
        robot.slow.put(ConnectionLost("pulled"))
        with pytest.raises(ConnectionLost):
            program.wait(5)
        until(lambda: "primary" not in robot.safety._subscriptions and not robot.script._subscriptions)
        robot.clear()
        again = robot.script.run("movej(q)")
        robot.begins(again)
        robot.comes_to_its_end(again)
        again.wait(5)


def test_closed(robot: StandIn) -> None:
    robot.clear()
    robot.primary.close()
    with pytest.raises(Closed):
        robot.channel.motion("movej(q)")


def test_closing_shuts_the_gate(robot: StandIn) -> None:
    robot.clear()
    heard: list[LinkError] = []
    robot.safety.on_stop(heard.append)
    robot.safety.close()
    assert isinstance(heard[0], NotRunning)
    with pytest.raises(NotRunning, match="closed here"):
        robot.channel.motion("movej(q)")
    assert robot.sent == []
