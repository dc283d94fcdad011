"""`robot.safety` and the command channel over streams: which reports are received, and which callbacks are called."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from linkcore.errors import BadValue, Closed, ConnectFailed, ConnectionLost, LinkError, LinkTimeout, LocalError
from linkcore.streaming.connection_life import Backoff, ConnectionState
from tests.fakes.controller import ScriptedController
from tests.fakes.link import ScriptedTransport
from tests.fakes.packets import packet
from tests.waiting import threads_named, until
from urlink.command import safety_monitor as monitor
from urlink.errors import NotEnabled, NotRunning, SafetyStop
from urlink.protocol.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode
from urlink.protocol.primary.robot_state import RobotModeData, RobotState

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def robot() -> Iterator[ScriptedController]:
    with ScriptedController() as robot:
        yield robot


def test_interfaces_connect_at_first_use(robot: ScriptedController) -> None:
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


@pytest.mark.parametrize(
    "ask",
    [
        lambda robot: robot.safety.cause,
        lambda robot: robot.safety.wait_for_stop(5).cause,
        lambda robot: robot.safety.refusal.cause,
    ],
    ids=["cause", "wait_for_stop", "refusal"],
)
def test_first_query_subscribes_and_gets_state(
    robot: ScriptedController, ask: Callable[[ScriptedController], str]
) -> None:
    robot.state(safety=SafetyMode.PROTECTIVE_STOP, fast=False)
    assert ask(robot) == "protective stop"


def test_two_threads_can_wait_for_first_report(robot: ScriptedController) -> None:
    failures: list[LinkError] = []

    def command() -> None:
        try:
            robot.channel.command("set_tool_voltage(0)")
        except LinkError as error:
            failures.append(error)

    threads = [threading.Thread(target=command) for _ in range(2)]
    for thread in threads:
        thread.start()
        time.sleep(0.1)  # simulated time passes only when all threads wait
    robot.state(fast=False)
    for thread in threads:
        thread.join(10)
    assert failures == []
    assert robot.sent == ["set_tool_voltage(0)\n"] * 2


def test_second_query_also_waits_for_first_report(robot: ScriptedController) -> None:
    modes: list[SafetyMode | None] = []
    threads = [threading.Thread(target=lambda: modes.append(robot.safety.mode)) for _ in range(2)]
    for thread in threads:
        thread.start()
        time.sleep(0.1)  # simulated time passes only when all threads wait
    robot.state(fast=False)
    for thread in threads:
        thread.join(10)
    assert modes == [SafetyMode.NORMAL] * 2


def test_wait_for_stop_returns_stop_that_already_ended(robot: ScriptedController) -> None:
    robot.state(fast=False)
    robot.monitor.listen()
    waits = robot.monitor.wait_for

    def over(*arguments: Any) -> bool:
        robot.state(safety=SafetyMode.PROTECTIVE_STOP, fast=False)
        came = waits(*arguments)
        robot.state(fast=False)
        until(lambda: robot.safety.cause is None)
        return came

    robot.monitor.wait_for = over  # type: ignore[method-assign,assignment]
    stop = robot.safety.wait_for_stop(5)
    assert stop is not None
    assert "protective stop" in str(stop)


def test_check_before_motion_connects_both_interfaces(robot: ScriptedController) -> None:
    """The real-time interface reports a stop up to 0.1 s before the primary interface."""
    robot.state()
    robot.channel.check()
    assert (robot.slow.opened, robot.fast.opened) == (1, 1)


def test_enable_waits_for_a_stop_that_is_just_ending() -> None:
    """A program that has unlocked the arm over the dashboard need not wait itself."""
    with ScriptedController(policy="always") as robot:
        robot.state(safety=SafetyMode.PROTECTIVE_STOP)
        robot.monitor.listen(closely=True)
        until(lambda: robot.safety.cause == "protective stop")
        waits = robot.monitor.wait_for

        def unlocked(*arguments: Any) -> bool:
            robot.state()
            return waits(*arguments)

        robot.monitor.wait_for = unlocked  # type: ignore[method-assign,assignment]
        robot.safety.enable()
        assert robot.safety.is_enabled


def test_connection_lost_earlier_means_not_running() -> None:
    with ScriptedController(backoff=Backoff(first=60.0, most=60.0)) as robot:
        robot.state(fast=False)
        robot.primary.wait(5)
        robot.slow.put(ConnectionLost("pulled"))
        until(lambda: robot.primary.connection is not ConnectionState.CONNECTED)
        refusal = robot.safety.refusal
        assert isinstance(refusal, NotRunning)
        assert "is unknown: not connected" in str(refusal)


def test_stop_notifies_and_refuses_motions(robot: ScriptedController) -> None:
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


def test_realtime_stream_alone_reports_a_stop(robot: ScriptedController) -> None:
    robot.clear()
    heard: list[LinkError] = []
    robot.safety.on_stop(heard.append)
    robot.state(safety=SafetyMode.SAFEGUARD_STOP)
    # The state on the primary interface arrives up to 100 ms later.
    robot.slow.put(ConnectionLost("pulled"))
    until(lambda: heard)
    assert isinstance(heard[0], (SafetyStop, NotRunning))
    assert len(heard) == 1


def test_safety_message_closes_interlock_before_next_state(robot: ScriptedController) -> None:
    robot.clear()
    robot.safety_message(SafetyMode.VIOLATION)
    until(lambda: robot.safety.cause == "violation")
    assert robot.safety.mode is SafetyMode.VIOLATION


def test_callback_that_raises_does_not_stop_others(robot: ScriptedController, caplog: pytest.LogCaptureFixture) -> None:
    robot.clear()
    heard: list[LinkError] = []

    def fail(error: LinkError) -> None:
        raise RuntimeError("on purpose")

    robot.safety.on_stop(fail)
    robot.safety.on_stop(heard.append)
    robot.state(emergency=True)
    until(lambda: heard)
    assert "later callbacks are still called" in caplog.text


def test_callback_that_exits_does_not_end_the_thread(
    robot: ScriptedController, caplog: pytest.LogCaptureFixture
) -> None:
    robot.clear()
    heard: list[LinkError] = []

    def leave(error: LinkError) -> None:
        sys.exit("on purpose")

    robot.safety.on_stop(leave)
    robot.safety.on_stop(heard.append)
    for count in (1, 2):
        robot.state(emergency=True)
        until(lambda count=count: len(heard) == count)  # type: ignore[misc]
        robot.state()
        robot.safety.wait_enabled(5)
    assert caplog.text.count("SystemExit: on purpose") == 2


def test_stop_callback_can_send_commands_and_wait(robot: ScriptedController) -> None:
    robot.clear()
    done = threading.Event()

    def recover(error: LinkError) -> None:
        robot.safety.wait_enabled(5)
        robot.channel.motion("stopj(2.0)")
        done.set()

    robot.safety.on_stop(recover)
    # Only on one interface: the other might report the same stop after the clear state, which would be a second stop.
    robot.state(safety=SafetyMode.PROTECTIVE_STOP, fast=False)
    until(lambda: robot.safety.cause)
    robot.state(fast=False)
    assert done.wait(5)
    assert robot.sent == ["stopj(2.0)\n"]


@pytest.mark.parametrize("is_fast", [False, True])
def test_lost_connection_means_not_running(robot: ScriptedController, is_fast: bool) -> None:
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


def test_silence_means_not_running() -> None:
    with ScriptedController(stale_after=0.1) as robot:
        heard: list[LinkError] = []
        robot.safety.on_stop(heard.append)
        robot.clear()
        until(lambda: heard)
        assert isinstance(heard[0], NotRunning)
        assert "nothing arrived on the" in str(heard[0])
        with pytest.raises(NotRunning, match="nothing arrived on the"):
            robot.channel.motion("movej(q)")
        assert robot.sent == []
        robot.state()
        robot.safety.wait_enabled(5)


def test_text_sent_before_silence_is_discarded() -> None:
    """The text may still be in the network, and the robot would execute it after the silence."""
    with ScriptedController(stale_after=0.1) as robot:
        robot.clear()
        robot.channel.command("set_tool_voltage(0)")
        until(lambda: robot.slow.opened == 2)  # the connection was aborted and made again
        robot.state()
        robot.safety.wait_until_clear(5)
        until(lambda: "nothing arrived" in str(robot.safety.refusal))
        # Nothing was sent since then, so there is nothing to discard.
        assert robot.slow.opened == 2


def test_silence_without_sent_text_keeps_connection(caplog: pytest.LogCaptureFixture) -> None:
    with ScriptedController(stale_after=0.1) as robot:
        robot.clear()
        until(lambda: "nothing arrived" in str(robot.safety.refusal))
        robot.state()
        robot.safety.wait_until_clear(5)
        assert robot.slow.opened == 1
    assert "raised" not in caplog.text


def test_stale_report_of_delayed_program_ends_no_motion() -> None:
    """An inline callback blocks the reader thread, which then cannot detect whether the robot is silent."""
    with ScriptedController(stale_after=1.0) as robot:
        robot.clear()
        heard: list[LinkError] = []
        robot.safety.on_stop(heard.append)
        inside, go_on = threading.Event(), threading.Event()

        def keep(state: object) -> None:
            inside.set()
            go_on.wait(10)

        with robot.realtime.subscribe(keep, inline=True):
            robot.state()
            assert inside.wait(10)

            def is_refused() -> bool:
                robot.state(fast=False)
                return not robot.safety.is_enabled

            until(is_refused)
            assert "this program was delayed" in str(robot.safety.refusal)
            assert heard == []  # so running motions continue
            go_on.set()
        robot.state()
        robot.safety.wait_enabled(5)
        assert heard == []


def test_command_without_any_report_raises_not_running(
    robot: ScriptedController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(monitor, "_FIRST_REPORT", 0.05)
    with pytest.raises(NotRunning, match="yet; nothing was sent"):
        robot.channel.command("set_tool_voltage(0)")
    assert robot.safety.mode is None
    assert robot.safety.robot_mode is None


def test_unreachable_realtime_interface_refuses_only_motions() -> None:
    with ScriptedController(fast=ScriptedTransport(ConnectFailed("refused"))) as robot:
        robot.state()
        with pytest.raises(ConnectFailed, match="refused"):
            robot.channel.motion("movej(q)")
        robot.state()
        robot.channel.command("set_tool_voltage(0)")  # the primary interface is sufficient for this command
        robot.state()
        robot.channel.motion("movej(q)")  # the interface is reachable now


def test_policy_always_requires_enable_after_each_stop() -> None:
    with ScriptedController(policy="always") as robot:
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
        assert robot.safety.policy == "always"
        robot.safety.policy = "never"
        assert robot.safety.policy == "never"
        robot.safety.wait_enabled(0)
        with pytest.raises(BadValue):
            robot.safety.policy = "no"  # type: ignore[assignment]


def test_first_motion_keeps_robot_enabled() -> None:
    """The first motion subscribes to the real-time interface. The robot stays enabled until its first report."""
    with ScriptedController(policy="always") as robot:
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


def test_wait_timeout_names_the_cause(robot: ScriptedController) -> None:
    robot.state(RobotMode.IDLE)
    with pytest.raises(LinkTimeout, match="IDLE"):
        robot.safety.wait_until_clear(0.01)
    assert "IDLE" in repr(robot.safety)


@pytest.mark.parametrize("timeout", [None, -1.0, float("inf"), "soon"])
def test_wait_rejects_invalid_timeout(robot: ScriptedController, timeout: Any) -> None:
    for wait in (robot.safety.wait_enabled, robot.safety.wait_until_clear, robot.safety.wait_for_stop):
        with pytest.raises(BadValue, match="timeout"):
            wait(timeout)
    with pytest.raises(BadValue, match="callback="):
        robot.safety.on_stop(timeout)


def test_wait_for_stop_returns_active_stop_immediately(robot: ScriptedController) -> None:
    robot.clear()
    robot.state(safety=SafetyMode.PROTECTIVE_STOP, fast=False)
    until(lambda: robot.safety.cause is not None)
    began = time.monotonic()
    assert isinstance(robot.safety.wait_for_stop(60.0), SafetyStop)
    assert time.monotonic() - began < 1.0


def test_wait_for_stop_with_zero_timeout_returns_none(robot: ScriptedController) -> None:
    robot.clear()
    assert robot.safety.wait_for_stop(0.0) is None


def test_cb2_modes_permit_or_refuse_motion() -> None:
    with ScriptedController("1.8") as robot:
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


def test_stop_is_reported_after_the_set_point_being_sent(robot: ScriptedController) -> None:
    """Check and send are one step: a permitted set-point has been sent before the stop is reported."""
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


def test_callbacks_are_called_without_a_lock(robot: ScriptedController) -> None:
    """Otherwise a thread that holds a lock and asks the interlock could deadlock with a callback that needs it."""
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


def test_script_runs_after_stream_gave_up() -> None:
    with ScriptedController(backoff=Backoff(tries=0)) as robot:
        robot.clear()
        program = robot.script.run("movej(q)")
        robot.slow.put(ConnectionLost("pulled"))
        with pytest.raises(ConnectionLost):
            program.wait(5)
        until(lambda: threads_named(f"{robot.primary.name} reader") == [])
        robot.clear()
        again = robot.script.run("movej(q)")
        robot.begins(again)
        robot.comes_to_its_end(again)
        again.wait(5)


def test_motion_raises_closed_after_primary_close(robot: ScriptedController) -> None:
    robot.clear()
    robot.primary.close()
    with pytest.raises(Closed):
        robot.channel.motion("movej(q)")


def test_monitor_close_refuses_motions_without_stop(robot: ScriptedController) -> None:
    robot.clear()
    heard: list[LinkError] = []
    robot.safety.on_stop(heard.append)
    robot.monitor.close()
    with pytest.raises(NotRunning, match="closed here"):
        robot.channel.motion("movej(q)")
    assert robot.sent == []
    robot.callbacks.close(5)
    assert heard == []  # the robot has not stopped


def test_monitor_close_ends_wait_enabled(robot: ScriptedController) -> None:
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: robot.safety.cause)
    closing = threading.Timer(0.05, robot.monitor.close)
    closing.start()
    with pytest.raises(Closed, match="the robot was closed"):
        robot.safety.wait_enabled(60.0)
    closing.join(10)


def test_state_without_safety_part_keeps_stop(robot: ScriptedController) -> None:
    robot.state(safety=SafetyMode.PROTECTIVE_STOP, fast=False)
    until(lambda: robot.safety.cause)
    modes = packet(RobotModeData, robot.firmware, robot_mode=RobotMode.RUNNING)
    before = robot.primary.stats.decoded
    robot.slow.put(bytes(RobotState(modes)))
    until(lambda: robot.primary.stats.decoded > before)
    assert robot.safety.cause == "protective stop"


# -- inline callbacks ------------------------------------------------------------------------------------


def test_wait_in_an_inline_callback_raises(robot: ScriptedController) -> None:
    robot.clear()
    raised: list[LinkError] = []

    def wait(state: object) -> None:
        for call in (robot.safety.wait_enabled, robot.safety.wait_until_clear, robot.safety.wait_for_stop):
            try:
                call(10.0)
            except LocalError as error:
                raised.append(error)

    with robot.primary.subscribe(wait, inline=True):
        robot.safety.policy = "always"
        robot.state()
        until(lambda: len(raised) >= 2)
    assert "inline=True" in str(raised[0])


def test_inline_callback_can_send_a_command(robot: ScriptedController) -> None:
    robot.clear()

    def command(state: object) -> None:
        robot.channel.motion("movej(q)")
        robot.channel.command("set_tool_voltage(0)")

    with robot.primary.subscribe(command, RobotState, inline=True):
        robot.state(fast=False)
        until(lambda: len(robot.sent) == 2)


def test_inline_callback_can_send_first_command(robot: ScriptedController) -> None:
    """The callback cannot wait for the first report; the state that the stream has already received is sufficient."""
    raised: list[LinkError] = []

    def command(state: object) -> None:
        try:
            robot.channel.command("set_tool_voltage(0)")
        except LinkError as error:
            raised.append(error)

    with robot.primary.subscribe(command, RobotState, inline=True):
        robot.state(fast=False)
        until(lambda: robot.sent or raised)
    assert raised == []


# -- texts larger than the free buffer -------------------------------------------------------------------


def send(robot: ScriptedController, text: str, **options: Any) -> tuple[threading.Thread, list[LinkError]]:
    """Send in a new thread; return the thread and the list of its errors."""
    raised: list[LinkError] = []

    def run() -> None:
        try:
            robot.channel.motion(text, **options)
        except LinkError as error:
            raised.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, raised


def test_large_text_is_sent_in_parts(robot: ScriptedController) -> None:
    robot.clear()
    robot.slow.make_room(3)
    first, raised = send(robot, "movej(q)")
    until(lambda: robot.sent == ["mov"])
    second, also = send(robot, "stopj(2)")
    robot.slow.make_room(4)
    until(lambda: robot.sent == ["mov", "ej(q"])
    robot.slow.make_room(None)
    first.join(10)
    second.join(10)
    assert raised == also == []
    assert "".join(robot.sent) == "movej(q)\nstopj(2)\n"


def test_rest_of_text_is_not_sent_after_stop(robot: ScriptedController) -> None:
    robot.clear()
    robot.slow.make_room(3)
    sender, raised = send(robot, "movej(q)")
    until(lambda: robot.sent == ["mov"])
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: robot.safety.cause)
    robot.slow.make_room(None)
    sender.join(10)
    assert isinstance(raised[0], SafetyStop)
    assert robot.sent == ["mov"]
    until(lambda: robot.slow.opened == 2)  # the controller cannot take later texts for the rest


def test_text_that_the_controller_does_not_read_times_out(
    robot: ScriptedController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("urlink.command.channel.SEND_TIMEOUT", 0.05)
    robot.clear()
    for room, opened in ((0, 1), (3, 2)):
        robot.slow.make_room(room)
        with pytest.raises(LinkTimeout, match=r"did not accept a text of 9 bytes within 0\.05 s"):
            robot.channel.motion("movej(q)")
        until(lambda opened=opened: robot.slow.opened == opened)  # type: ignore[misc]
        robot.clear()


def test_partly_sent_text_is_not_continued_on_next_connection(robot: ScriptedController) -> None:
    robot.clear()
    robot.slow.make_room(3)
    sender, raised = send(robot, "movej(q)")
    until(lambda: robot.sent == ["mov"])
    robot.slow.put(ConnectionLost("pulled"))
    sender.join(10)
    assert isinstance(raised[0], (ConnectionLost, NotRunning))
    robot.clear()
    robot.slow.make_room(None)
    robot.channel.motion("stopj(2)")
    assert robot.sent == ["mov", "stopj(2)\n"]


# -- signal handlers -------------------------------------------------------------------------------------


def in_the_section(robot: ScriptedController, handler: Callable[[], object]) -> None:
    """Call `handler` in this thread inside the critical section, as can happen to a signal handler."""
    robot.channel.setpoint(handler)


def test_signal_handler_can_send_a_stop_while_the_lock_is_held(robot: ScriptedController) -> None:
    robot.clear()
    in_the_section(robot, lambda: robot.channel.motion("stopj(2)", is_stop=True))
    assert robot.sent == ["stopj(2)\n"]


def test_signal_handler_can_wait_while_the_lock_is_held(robot: ScriptedController) -> None:
    """The awaited stop is received by a thread that needs the section."""
    robot.clear()

    def handler() -> None:
        robot.state(safety=SafetyMode.PROTECTIVE_STOP)
        assert isinstance(robot.safety.wait_for_stop(10), SafetyStop)

    in_the_section(robot, handler)
    # The interrupted code still held the section afterwards, and has released it exactly once.
    with pytest.raises(RuntimeError):
        robot.section.lock.release()


def test_signal_handler_cannot_send_during_partly_sent_text(robot: ScriptedController) -> None:
    robot.clear()
    robot.slow.make_room(3)
    raised: list[LinkError] = []
    waited = robot.slow.wait_for_room

    def interrupted(timeout: float) -> bool:
        robot.slow.wait_for_room = waited  # type: ignore[method-assign]
        try:
            robot.channel.motion("stopj(2)", is_stop=True)
        except LinkError as error:
            raised.append(error)
        return waited(timeout)

    robot.slow.wait_for_room = interrupted  # type: ignore[method-assign]
    with pytest.raises((ConnectionLost, NotRunning)):
        robot.channel.motion("movej(q)")
    assert isinstance(raised[0], ConnectionLost)
    assert "only a part of the previous text" in str(raised[0])
    assert robot.sent == ["mov"]
