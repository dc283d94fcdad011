"""Safety monitor: its subscriptions, its use of each report, its notifications, and its closing."""

from __future__ import annotations

import gc
import threading
import time
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from linkcore.clock import Stamp
from linkcore.errors import ConnectFailed, ConnectionLost, LinkError
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.wire.packet import State
from tests.fakes.line import FIRMWARE, Desk, Subscriber, fast, slow
from tests.fakes.packets import packet
from urlink.command.interlock import Interlock
from urlink.errors import NotRunning, SafetyStop
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.protocol.primary.robot_message import SafetyModeMessage
from urlink.protocol.primary.robot_state import MasterboardData, RobotModeData, RobotState
from urlink.protocol.realtime.packets import RealtimeState

STALE_AFTER = 1.0


class Monitored(Desk):
    """Desk that records the errors that end motions (`closings`) and that users are notified of (`stops`)."""

    def __init__(self) -> None:
        super().__init__(stale_after=STALE_AFTER)
        self.closings: list[LinkError] = []
        self.stops: list[LinkError] = []
        self.silences: list[float] = []
        self.monitor.on_close(self.closings.append)
        self.monitor.on_silence(self.silences.append)
        self.forget = self.monitor.on_stop(self.stops.append)

    def listen(self) -> None:
        self.monitor.listen(closely=True)

    @property
    def listeners(self) -> list[int]:
        """Number of subscribers (packets and events) and of silence watches, for both lines."""
        return [len(each) for line in (self.primary, self.realtime) for each in (line.subscribers, line.watches)]


@pytest.fixture
def desk() -> Monitored:
    return Monitored()


def test_listen_subscribes_once_per_interface(desk: Monitored) -> None:
    desk.monitor.listen()
    assert desk.listeners == [2, 1, 0, 0]
    for _ in range(2):
        desk.listen()
        assert desk.listeners == [2, 1, 2, 1]
    desk.clear()
    desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    assert [str(error) for error in desk.closings] == ["the robot is stopped: protective stop"]
    assert desk.stops == desk.closings
    desk.primary.deliver(slow())
    desk.forget()
    desk.forget()
    desk.realtime.deliver(fast(SafetyMode.FAULT))
    assert (len(desk.closings), len(desk.stops)) == (2, 1)


def test_interface_without_report_refuses_motions(desk: Monitored) -> None:
    desk.monitor.listen()
    desk.primary.deliver(slow())
    assert desk.monitor.refusal_to_begin() is None
    desk.listen()
    assert "nothing was received on the realtime interface yet" in str(desk.monitor.refusal_to_begin())
    assert desk.closings == []  # running motions continue until the wait for the first report has ended


def test_stopping_the_arm_needs_no_enable(desk: Monitored) -> None:
    desk.clear()
    with desk.monitor.decision() as interlock:
        interlock.policy = "always"
    assert (str(desk.monitor.refusal_to_begin()).partition(":")[0], desk.monitor.refusal_to_stop()) == (
        "not enabled",
        None,
    )
    desk.monitor.require(is_stop=True)
    with pytest.raises(SafetyStop, match="not enabled"):
        desk.monitor.require()


@pytest.mark.parametrize(("limit", "seconds"), [(None, 1.0), (0.5, 0.5), (3.0, 1.0)])
def test_silence_is_reported_before_connection_is_lost(desk: Monitored, limit: float | None, seconds: float) -> None:
    desk.primary.silence.limit = limit
    desk.clear()
    desk.primary.be_silent()
    assert desk.silences == [seconds]
    assert f"nothing arrived on the primary interface for {seconds} s" in str(desk.monitor.refusal_to_begin())
    assert len(desk.closings) == 1


def test_report_received_before_subscribing_counts(desk: Monitored) -> None:
    newest: dict[type, State] = {RobotState: slow(SafetyMode.SAFEGUARD_STOP), RealtimeState: fast()}
    for line in (desk.primary, desk.realtime):
        line.fan_out.newest = newest.__getitem__
    desk.listen()
    assert "safeguard stop" in str(desk.monitor.refusal_to_begin())


def test_connection_that_is_already_down_counts_as_lost(desk: Monitored) -> None:
    desk.realtime.state = ConnectionState.CONNECTING
    desk.monitor.listen()
    desk.primary.deliver(slow())
    was_connected = desk.monitor.is_connected
    desk.listen()
    assert (was_connected, desk.monitor.is_connected) == (True, False)
    assert "is unknown: not connected" in str(desk.monitor.refusal_to_begin())
    desk.realtime.state = ConnectionState.CONNECTED
    desk.realtime.deliver(fast())
    assert desk.monitor.refusal_to_begin() is None


@pytest.mark.parametrize("fails_at", [1, 2])
def test_failed_subscription_leaves_no_subscribers(desk: Monitored, fails_at: int) -> None:
    subscribe, tries = desk.realtime.subscribe_inline, iter(range(1, 100))

    def refuse(kind: type, callback: Callable[[Any], object], **options: object) -> Subscriber:
        if next(tries) < fails_at:
            return subscribe(kind, callback)
        desk.event(desk.realtime, ConnectionState.LOST, ConnectFailed("refused"))
        raise ConnectFailed("refused")

    desk.realtime.subscribe_inline = refuse  # type: ignore[method-assign]
    desk.monitor.listen()
    desk.primary.deliver(slow())
    with pytest.raises(ConnectFailed):
        desk.listen()
    assert desk.listeners == [2, 1, 0, 0]
    assert desk.monitor.refusal_to_begin() is None  # the reports of the primary interface are sufficient
    desk.realtime.subscribe_inline = subscribe  # type: ignore[method-assign]
    desk.clear()


def test_concurrent_listen_subscribes_once(desk: Monitored) -> None:
    """A signal handler can interrupt its own thread while it subscribes."""
    subscribe = desk.primary.subscribe_inline

    def interrupted(kind: type, callback: Callable[[Any], object], **options: object) -> Subscriber:
        desk.primary.subscribe_inline = subscribe  # type: ignore[method-assign]
        desk.monitor.listen()
        return subscribe(kind, callback)

    desk.primary.subscribe_inline = interrupted  # type: ignore[method-assign]
    desk.clear()
    assert desk.listeners == [2, 1, 2, 1]


def test_lost_connection_refuses_motions_until_next_report(desk: Monitored) -> None:
    desk.clear()
    for state in (ConnectionState.CONNECTING, ConnectionState.CONNECTED):
        desk.event(desk.primary, state)
        assert desk.monitor.refusal_to_begin() is None
    desk.event(desk.primary, ConnectionState.LOST, ConnectionLost("pulled"))
    assert "the robot's state is unknown: pulled" in str(desk.monitor.refusal_to_begin())
    assert desk.listeners == [2, 1, 2, 1]  # the subscriptions stay, because the connection is made again
    desk.clear()
    desk.event(desk.primary, ConnectionState.LOST)
    assert "the robot's state is unknown: closed" in str(desk.monitor.refusal_to_begin())


@pytest.mark.parametrize("state", [ConnectionState.IDLE, ConnectionState.CLOSED])
def test_monitor_subscribes_again_after_connection_gave_up(desk: Monitored, state: ConnectionState) -> None:
    desk.clear()
    (callback,) = [each.callback for each in desk.primary.subscribers if each.kind is ConnectionEvent]
    desk.event(desk.primary, state)
    assert desk.listeners == [0, 0, 2, 1]
    assert isinstance(desk.closings[0], NotRunning)
    desk.clear()
    assert desk.listeners == [2, 1, 2, 1]
    callback(ConnectionEvent(ConnectionState.LOST, "line", None, Stamp(desk.clock.now, desk.clock.now)))
    assert desk.monitor.refusal_to_begin() is None  # an event of the previous subscription is ignored


def test_state_without_robot_mode_does_not_clear_a_violation(desk: Monitored) -> None:
    desk.clear()
    desk.primary.deliver(SafetyModeMessage(FIRMWARE, safety_mode=SafetyMode.VIOLATION))
    assert "violation" in str(desk.monitor.refusal_to_begin())
    desk.primary.deliver(RobotState(packet(MasterboardData, FIRMWARE, safety_mode=SafetyMode.NORMAL)))
    assert "violation" in str(desk.monitor.refusal_to_begin())  # a state without robot mode is ignored
    desk.primary.deliver(slow())
    assert desk.monitor.refusal_to_begin() is None
    for fields in ({"is_emergency_stopped": True}, {"is_protective_stopped": True}):
        desk.primary.deliver(RobotState(packet(RobotModeData, FIRMWARE, robot_mode=RobotMode.RUNNING, **fields)))
        assert isinstance(desk.monitor.refusal_to_begin(), SafetyStop)


def test_age_of_report_counts_from_reception_of_its_bytes(desk: Monitored) -> None:
    """The time of reading does not matter: after a delay, a program finds old states in its buffer."""
    desk.clear()

    def stamped(packet: Any, at: float) -> Any:
        return type(packet).LAYOUTS.decode(bytes(packet), FIRMWARE, Stamp(at, at))

    for age in (STALE_AFTER - 0.1, STALE_AFTER + 0.1):
        desk.clock.now += 10.0
        desk.primary.deliver(slow())
        desk.realtime.deliver(stamped(fast(), desk.clock.now - age))
        refusal = desk.monitor.refusal_to_begin()
        assert (refusal is not None) == (age > STALE_AFTER)
    assert "nothing was read from the realtime interface for 1.1 s" in str(refusal)


def test_close_unsubscribes_and_refuses_motions(desk: Monitored) -> None:
    desk.clear()
    desk.monitor.close()
    assert desk.listeners == [0, 0, 0, 0]
    assert "closed here" in str(desk.monitor.refusal_to_begin())
    assert len(desk.closings) == 1
    assert desk.stops == []  # closing is not a stop of the robot


def test_close_drops_references_to_hooks(desk: Monitored) -> None:
    """Hooks belong to parts that refer to the monitor. The cycle would live until the garbage collector runs."""

    class Part:
        def on_close(self, error: LinkError) -> None: ...

        def on_silence(self, seconds: float) -> None: ...

    parts = [Part(), Part()]
    desk.monitor.on_close(parts[0].on_close)
    desk.monitor.on_silence(parts[1].on_silence)
    kept = list(map(weakref.ref, parts))
    desk.monitor.close()
    parts.clear()
    assert [each() for each in kept] == [None, None]


@pytest.mark.parametrize(
    "ask",
    [
        lambda desk: desk.monitor.require(),
        lambda desk: desk.monitor.require_running(),
        lambda desk: desk.interlock.enable(desk.clock()),
    ],
)
def test_refusal_leaves_no_reference_cycle_after_being_caught(
    desk: Monitored, ask: Callable[[Monitored], None]
) -> None:
    """The traceback contains the frame that raised the error, so that frame must not refer to the error."""
    caught: list[weakref.ref[LinkError]] = []
    gc.disable()
    try:
        try:
            ask(desk)
        except NotRunning as error:
            caught.append(weakref.ref(error))
        assert [each() for each in caught] == [None]
    finally:
        gc.enable()


# -- waiting -------------------------------------------------------------------------------------------


@pytest.mark.simulated_time
def test_wait_for_checks_again_at_timeout() -> None:
    desk = Desk(may_wait=True)
    answers = iter([False, True, False, False])
    assert desk.monitor.wait_for(lambda interlock: next(answers), 0.01)
    assert desk.monitor.wait_for(lambda interlock: next(answers), 0.01) is False
    assert not desk.monitor._waiting


def test_wait_for_wakes_at_every_change() -> None:
    desk = Desk(may_wait=True)
    desk.monitor.wait_for = lambda *_: True  # type: ignore[method-assign]
    desk.clear()
    del desk.monitor.wait_for

    def change_policy() -> None:
        with desk.monitor.decision() as interlock:
            interlock.policy = "always"

    changes: list[Callable[[], object]] = [
        lambda: desk.primary.deliver(slow()),
        lambda: desk.realtime.be_silent(),
        lambda: desk.event(desk.primary, ConnectionState.LOST),
        change_policy,
    ]
    for change in changes:
        looks: list[int] = []

        def look(interlock: Interlock, change: Callable[[], object] = change, looks: list[int] = looks) -> bool:
            looks.append(1)
            if len(looks) == 1:
                change()
            return len(looks) > 1

        # Without a wake-up it would check again only after the timeout, which is too late for the test.
        assert desk.monitor.wait_for(look, 3600.0)


def test_monitor_waits_longer_for_first_than_for_next_report() -> None:
    """Two seconds for a first report; if something blocks motion, half a second for every source's next report."""
    desk = Desk(may_wait=True)
    asked: list[tuple[Callable[[Interlock], object], float]] = []

    def wait_for(condition: Callable[[Interlock], object], timeout: float) -> bool:
        asked.append((condition, timeout))
        return True

    desk.monitor.wait_for = wait_for  # type: ignore[method-assign]
    desk.monitor.listen(closely=True)
    (has_reported, seconds), (also, _) = asked
    assert seconds == 2.0
    assert not has_reported(desk.interlock)
    desk.primary.deliver(slow())
    assert has_reported(desk.interlock)
    assert not also(desk.interlock)
    desk.realtime.deliver(fast())
    for moves in (True, False):
        asked.clear()
        desk.monitor.await_news(moves=moves)
        ((is_settled, seconds),) = asked
        assert seconds == 0.5
        assert is_settled(desk.interlock)
        desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
        # The stop blocks only motions, until both interfaces have reported again.
        assert bool(is_settled(desk.interlock)) is not moves
        desk.clock.now += 0.1
        desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
        assert bool(is_settled(desk.interlock)) is not moves
        desk.realtime.deliver(fast())
        assert is_settled(desk.interlock)
        desk.primary.deliver(slow())
    asked.clear()
    reading = Desk()
    reading.clear()
    reading.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    reading.monitor.wait_for = wait_for  # type: ignore[method-assign]
    reading.monitor.await_news(moves=True)
    assert asked == []  # the reader thread does not wait, because it would have to receive the report


def test_reader_thread_reads_pending_data_before_refusing(desk: Monitored) -> None:
    """The thread reads the data that arrived meanwhile on its own lines, before the motion is refused."""
    desk.clear()
    looks: list[str] = []
    for name, line in (("primary", desk.primary), ("realtime", desk.realtime)):
        line.look = partial(looks.append, name)  # type: ignore[method-assign]
    desk.monitor.await_news(moves=True)
    assert looks == []
    desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    desk.monitor.await_news(moves=False)
    assert looks == []
    desk.monitor.await_news(moves=True)
    assert looks == ["primary", "realtime"]
    desk.primary.reads_here = lambda: False  # type: ignore[method-assign]
    desk.monitor.await_news(moves=True)
    assert looks == ["primary", "realtime", "realtime"]


@pytest.mark.simulated_time
def test_close_ends_wait_for() -> None:
    """This holds even if nothing was subscribed yet."""
    desk = Desk(may_wait=True)
    closing = threading.Timer(0.1, desk.monitor.close)
    closing.start()
    begin = time.monotonic()
    assert not desk.monitor.wait_for(lambda interlock: False, 3600.0)
    assert time.monotonic() - begin < 1.0
    closing.join(1.0)
