"""Interlock of the command channel, compared with a model over random sequences of events.

There are no threads, and time is simulated. The connections are stand-ins whose subscribers are called by the test.
Therefore each run is deterministic.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast, get_args

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from linkcore.clock import Stamp
from linkcore.errors import ConnectionLost, LinkError
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.threads import CallbackThread
from tests.fakes.clock import Clock
from tests.fakes.line import Line
from tests.fakes.packets import packet
from urlink.command.channel import CommandChannel
from urlink.command.interlock import Interlock
from urlink.command.safety import Safety
from urlink.command.safety_monitor import SafetyMonitor
from urlink.command.section import Section
from urlink.errors import NotRunning, SafetyStop
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.protocol.primary.robot_message import SafetyModeMessage
from urlink.protocol.primary.robot_state import MasterboardData, RobotModeData, RobotState
from urlink.protocol.realtime.packets import RealtimeState
from urlink.session.connect_options import STALE_AFTER, Policy

FIRMWARE = (5, 11)
SAFE = (SafetyMode.NORMAL, SafetyMode.REDUCED)

policies = st.sampled_from(get_args(Policy))
# About half of the modes are safe, so that motions happen between the stops.
safety_modes = st.one_of(st.sampled_from(SAFE), st.sampled_from(SafetyMode))
robot_modes = st.one_of(st.just(RobotMode.RUNNING), st.sampled_from(RobotMode))
sources = st.sampled_from(["primary", "realtime"])


class InterlockBeforeTheChannel(RuleBasedStateMachine):
    @initialize(policy=policies)
    def begin(self, policy: Policy) -> None:
        self.clock = Clock()
        self.lines = {"primary": Line(), "realtime": Line()}
        primary, realtime = (cast(Connection, self.lines[name]) for name in ("primary", "realtime"))
        section = Section(primary.reads_here)
        interlock = Interlock(policy)
        self.monitor = SafetyMonitor(primary, realtime, interlock, section, CallbackThread("none"), self.clock)
        self.safety = Safety(self.monitor)
        self.channel = CommandChannel(primary, self.monitor, section, self.clock)
        self.monitor.on_close(self.closed)
        self.monitor.on_silence(self.channel.discard)
        self.monitor.listen(closely=True)
        # the model
        self.policy = policy
        self.said: dict[str, tuple[RobotMode, SafetyMode] | None] = {"primary": None, "realtime": None}
        self.is_silent = dict.fromkeys(self.said, False)
        self.heard = dict.fromkeys(self.said, 0.0)
        self.started = self.armed = False
        self.motions = 0
        self.closings: list[LinkError] = []

    # -- the model -----------------------------------------------------------------------------------

    @property
    def closing_cause(self) -> str | None:
        """Cause that closes the interlock: a stop, silence, a lost connection, or a robot that is not running."""
        if any(said is not None and said[1] not in SAFE for said in self.said.values()):
            return "stop"
        for name, said in self.said.items():
            if said is None or self.is_silent[name] or said[0] is not RobotMode.RUNNING:
                return "absence"
        return None

    @property
    def blocked(self) -> str | None:
        return self.closing_cause or (
            "stale" if any(self.clock.now - at > STALE_AFTER for at in self.heard.values()) else None
        )

    @property
    def is_open(self) -> bool:
        enabled = {"never": True, "on_startup": self.started, "always": self.armed}[self.policy]
        return self.blocked is None and enabled

    def closed(self, error: LinkError) -> None:
        """Do what a motion does: end, and try again."""
        self.closings.append(error)
        self.motions = 0
        self.try_motion(expected=False)

    def try_motion(self, expected: bool) -> None:
        before = list(self.lines["primary"].sent)
        try:
            self.channel.motion("movej(q)")
        except (SafetyStop, NotRunning):
            assert not expected
            assert self.lines["primary"].sent == before
        else:
            assert expected
            assert self.lines["primary"].sent.pop() == "movej(q)\n"
            self.motions += 1

    def event(self, tell: Callable[[], object], change: Callable[[], object]) -> None:
        """Apply an event to the robot and to the model."""
        was_clear, count = self.closing_cause is None, len(self.closings)
        change()
        if self.closing_cause is not None:
            self.armed = False
        tell()
        assert len(self.closings) == count + (was_clear and self.closing_cause is not None)

    # -- events --------------------------------------------------------------------------------------

    @rule(mode=robot_modes, safety=safety_modes)
    def primary(self, mode: RobotMode, safety: SafetyMode) -> None:
        self.tick()
        modes = packet(RobotModeData, FIRMWARE, robot_mode=mode)
        state = RobotState(modes, packet(MasterboardData, FIRMWARE, safety_mode=safety))
        self.event(lambda: self.lines["primary"].deliver(state), lambda: self.report("primary", (mode, safety)))

    @rule(mode=robot_modes)
    def primary_without_its_board(self, mode: RobotMode) -> None:
        """Send a state without masterboard data; the missing values stay as they were."""
        self.tick()
        said = self.said["primary"]
        state = RobotState(packet(RobotModeData, FIRMWARE, robot_mode=mode))
        safety = SafetyMode.NORMAL if said is None else said[1]
        self.event(lambda: self.lines["primary"].deliver(state), lambda: self.report("primary", (mode, safety)))

    @rule(mode=robot_modes, safety=safety_modes)
    def realtime(self, mode: RobotMode, safety: SafetyMode) -> None:
        self.tick()
        state = packet(RealtimeState, FIRMWARE, robot_mode=mode, safety_mode=safety)
        self.event(lambda: self.lines["realtime"].deliver(state), lambda: self.report("realtime", (mode, safety)))

    @rule()
    def all_is_clear(self) -> None:
        self.primary(RobotMode.RUNNING, SafetyMode.NORMAL)
        self.realtime(RobotMode.RUNNING, SafetyMode.NORMAL)

    @rule(source=sources)
    def a_stop_comes_and_goes(self, source: str) -> None:
        self.all_is_clear()
        getattr(self, source)(RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP)
        self.all_is_clear()

    @rule(safety=safety_modes)
    def message(self, safety: SafetyMode) -> None:
        self.tick()
        said = self.said["primary"]
        message = SafetyModeMessage(FIRMWARE, safety_mode=safety)
        self.event(
            lambda: self.lines["primary"].deliver(message),
            lambda: self.report("primary", (said[0], safety)) if said is not None else None,
        )

    @rule(source=sources)
    def lost(self, source: str) -> None:
        self.tick()
        event = ConnectionEvent(
            ConnectionState.LOST, source, ConnectionLost("pulled"), Stamp(self.clock.now, self.clock.now)
        )

        def change() -> None:
            self.said[source], self.is_silent[source] = None, False

        self.event(lambda: self.lines[source].deliver(event), change)

    @rule(source=sources)
    def silence(self, source: str) -> None:
        def change() -> None:
            self.clock.now += STALE_AFTER
            self.is_silent[source] = True

        self.event(lambda: self.lines[source].be_silent(), change)

    @rule()
    def held_up(self) -> None:
        """Let time pass without reading, as in a delayed program; the robot is not the cause."""
        self.clock.now += 1.5 * STALE_AFTER
        motions = self.motions
        self.try_motion(expected=False)
        assert self.motions == motions

    @rule()
    def enable(self) -> None:
        if self.blocked is None:
            self.safety.enable()
            self.started = self.armed = True
        else:
            with pytest.raises((SafetyStop, NotRunning)):
                self.safety.enable()

    # Rarely, because the effect of a policy shows only over several events.
    @precondition(lambda self: self.clock.now % 0.07 < 0.01)
    @rule(policy=policies)
    def change_policy(self, policy: Policy) -> None:
        if policy != self.policy:
            self.started = self.armed = False
        self.safety.policy = self.policy = policy

    @rule()
    def move(self) -> None:
        self.try_motion(expected=self.is_open)

    @rule()
    def stop(self) -> None:
        """Send a text that can only bring the arm to rest. It needs no `enable()`, but a stop still refuses it."""
        try:
            self.channel.motion("stopj(2.0)", is_stop=True)
        except (SafetyStop, NotRunning):
            assert self.blocked is not None
        else:
            assert self.blocked is None
            assert self.lines["primary"].sent.pop() == "stopj(2.0)\n"

    @rule()
    def setpoint(self) -> None:
        sent: list[int] = []
        try:
            self.channel.setpoint(lambda: sent.append(1))
        except (SafetyStop, NotRunning):
            assert not self.is_open
            assert sent == []
        else:
            assert self.is_open
            assert sent == [1]

    @rule()
    def command(self) -> None:
        runs = all(said is not None and said[0] is RobotMode.RUNNING for said in self.said.values())
        fresh = all(self.clock.now - heard <= STALE_AFTER for heard in self.heard.values()) and not any(
            self.is_silent.values()
        )
        if runs and fresh:
            self.channel.command("set_tool_voltage(0)")
            self.lines["primary"].sent.pop()
        else:
            with pytest.raises(NotRunning):
                self.channel.command("set_tool_voltage(0)")

    @invariant()
    def no_motion_continues_under_a_stop(self) -> None:
        if hasattr(self, "safety") and self.closing_cause is not None:
            assert self.motions == 0

    @invariant()
    def is_enabled_equals_the_model(self) -> None:
        if hasattr(self, "safety"):
            assert self.safety.is_enabled == self.is_open

    # -- helpers -------------------------------------------------------------------------------------

    def tick(self) -> None:
        self.clock.now += 0.01

    def report(self, source: str, said: tuple[RobotMode, SafetyMode]) -> None:
        self.said[source] = said
        self.heard[source] = self.clock.now
        self.is_silent[source] = False


TestInterlockBeforeTheChannel = pytest.mark.property(InterlockBeforeTheChannel.TestCase)
TestInterlockBeforeTheChannel.settings = settings(deadline=None, stateful_step_count=40)
