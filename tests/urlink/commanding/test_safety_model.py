"""The gate before the outlet, held against a model over random orders of events.

No thread and no clock: the streams are stand-ins whose subscribers the test calls, so each run is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast, get_args
from unittest import mock

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from linkcore.errors import ConnectionLost, LinkError
from linkcore.stamp import Stamp
from linkcore.streaming.events import ConnectionEvent, ConnectionState
from linkcore.streaming.stream import Stream
from urlink.commanding.channel import Outlet
from urlink.commanding.interlock import STALE, Policy
from urlink.commanding.safety import Safety
from urlink.errors import NotRunning, SafetyStop
from urlink.interfaces.enums import RobotMode, SafetyMode
from urlink.interfaces.primary.robot_message import SafetyModeMessage
from urlink.interfaces.primary.robot_state import MasterboardData, RobotModeData, RobotState
from urlink.interfaces.realtime.packets import RealtimeState

FIRMWARE = (5, 11)
SAFE = (SafetyMode.NORMAL, SafetyMode.REDUCED)

policies = st.sampled_from(get_args(Policy))
# Half of them clear, so that something happens in between.
safety_modes = st.one_of(st.sampled_from(SAFE), st.sampled_from(SafetyMode))
robot_modes = st.one_of(st.just(RobotMode.RUNNING), st.sampled_from(RobotMode))
sources = st.sampled_from(["primary", "realtime"])


class Line:
    """In place of a stream: keeps its subscribers, and what is sent."""

    connection = ConnectionState.CONNECTED

    def __init__(self) -> None:
        self.subscribers: dict[type, Callable[[Any], object]] = {}
        self.on_silence: Callable[[float], object] | None = None
        self.sent: list[str] = []

    def subscribe(self, callback: Callable[[Any], object], kind: type, **options: Any) -> mock.Mock:
        self.subscribers[kind] = callback
        self.on_silence = options.get("on_deadline", self.on_silence)
        return mock.Mock()

    def tell(self, packet: Any) -> None:
        for kind, callback in self.subscribers.items():
            if isinstance(packet, kind):
                callback(packet)

    def send(self, data: bytes, timeout: float) -> None:
        self.sent.append(data.decode())


class GateBeforeTheOutlet(RuleBasedStateMachine):
    @initialize(policy=policies)
    def begin(self, policy: Policy) -> None:
        self.now = 100.0
        self.patches: list[Any] = [
            mock.patch("urlink.commanding.safety.time", SimpleNamespace(monotonic=self.clock)),
            mock.patch("urlink.commanding.safety._FIRST_WORD", 0.0),
            mock.patch("urlink.commanding.safety._NEXT_WORD", 0.0),
        ]
        for patch in self.patches:
            patch.start()
        self.lines = {"primary": Line(), "realtime": Line()}
        primary, realtime = (cast(Stream[Any], self.lines[name]) for name in ("primary", "realtime"))
        self.safety = Safety(lambda: primary, lambda: realtime, policy)
        self.outlet = Outlet(lambda: primary, self.safety)
        self.safety.on_stop(self.stopped)
        self.safety.attend(closely=True)
        # the model
        self.policy = policy
        self.said: dict[str, tuple[RobotMode, SafetyMode] | None] = {"primary": None, "realtime": None}
        self.heard = dict.fromkeys(self.said, 0.0)
        self.started = self.armed = False
        self.motions = 0
        self.stops: list[LinkError] = []

    def teardown(self) -> None:
        for patch in getattr(self, "patches", []):
            patch.stop()

    # -- the model -----------------------------------------------------------------------------------

    @property
    def hindrance(self) -> str | None:
        if any(said is not None and said[1] not in SAFE for said in self.said.values()):
            return "stop"
        for name, said in self.said.items():
            if said is None or self.now - self.heard[name] > STALE or said[0] is not RobotMode.RUNNING:
                return "absence"
        return None

    @property
    def is_open(self) -> bool:
        enabled = {"never": True, "on_startup": self.started, "always": self.armed}[self.policy]
        return self.hindrance is None and enabled

    def stopped(self, error: LinkError) -> None:
        """What a motion does: it ends, and tries once more."""
        self.stops.append(error)
        self.motions = 0
        self.try_motion(expected=False)

    def try_motion(self, expected: bool) -> None:
        before = list(self.lines["primary"].sent)
        try:
            self.outlet.motion("movej(q)")
        except (SafetyStop, NotRunning):
            assert not expected
            assert self.lines["primary"].sent == before
        else:
            assert expected
            assert self.lines["primary"].sent == [*before, "movej(q)\n"]
            self.motions += 1

    def event(self, happen: Callable[[], object], change: Callable[[], object]) -> None:
        was_clear = self.hindrance is None
        stops = len(self.stops)
        change()
        hindrance = self.hindrance
        if hindrance is not None:
            self.armed = False
        happen()
        ended = len(self.stops) - stops
        assert ended == (was_clear and hindrance is not None)
        if ended:
            assert isinstance(self.stops[-1], SafetyStop if hindrance == "stop" else NotRunning)

    # -- what happens --------------------------------------------------------------------------------

    @rule(mode=robot_modes, safety=safety_modes)
    def primary(self, mode: RobotMode, safety: SafetyMode) -> None:
        self.tick()
        state = RobotState(RobotModeData(FIRMWARE, robot_mode=mode), MasterboardData(FIRMWARE, safety_mode=safety))
        self.event(lambda: self.lines["primary"].tell(state), lambda: self.say("primary", (mode, safety)))

    @rule(mode=robot_modes, safety=safety_modes)
    def realtime(self, mode: RobotMode, safety: SafetyMode) -> None:
        self.tick()
        state = RealtimeState(FIRMWARE, robot_mode=mode, safety_mode=safety)
        self.event(lambda: self.lines["realtime"].tell(state), lambda: self.say("realtime", (mode, safety)))

    @rule()
    def all_is_well(self) -> None:
        self.primary(RobotMode.RUNNING, SafetyMode.NORMAL)
        self.realtime(RobotMode.RUNNING, SafetyMode.NORMAL)

    @rule(source=sources)
    def a_stop_comes_and_goes(self, source: str) -> None:
        self.all_is_well()
        getattr(self, source)(RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP)
        self.all_is_well()

    @rule(safety=safety_modes)
    def message(self, safety: SafetyMode) -> None:
        self.tick()
        said = self.said["primary"]
        message = SafetyModeMessage(FIRMWARE, safety_mode=safety)
        self.event(
            lambda: self.lines["primary"].tell(message),
            lambda: self.say("primary", (said[0], safety)) if said is not None else None,
        )

    @rule(source=sources)
    def lost(self, source: str) -> None:
        self.tick()
        event = ConnectionEvent(ConnectionState.LOST, source, ConnectionLost("pulled"), Stamp(self.now, self.now))
        self.event(lambda: self.lines[source].tell(event), lambda: self.said.update({source: None}))

    @rule(source=sources)
    def silence(self, source: str) -> None:
        def tell() -> None:
            on_silence = self.lines[source].on_silence
            assert on_silence is not None
            on_silence(STALE)

        self.event(tell, lambda: setattr(self, "now", self.now + 1.5 * STALE))

    @rule()
    def enable(self) -> None:
        if self.hindrance is None:
            self.safety.enable()
            self.started = self.armed = True
        else:
            with pytest.raises((SafetyStop, NotRunning)):
                self.safety.enable()

    # Seldom: what a policy does shows over several events.
    @precondition(lambda self: self.now % 0.07 < 0.01)
    @rule(policy=policies)
    def change_policy(self, policy: Policy) -> None:
        self.safety.policy = self.policy = policy

    @rule()
    def move(self) -> None:
        self.try_motion(expected=self.is_open)

    @rule()
    def brake(self) -> None:
        """What can only bring the arm to rest needs nobody to enable it; a stop refuses it all the same."""
        try:
            self.outlet.motion("stopj(2.0)", is_stop=True)
        except (SafetyStop, NotRunning):
            assert self.hindrance is not None
        else:
            assert self.hindrance is None
            assert self.lines["primary"].sent.pop() == "stopj(2.0)\n"

    @rule()
    def setpoint(self) -> None:
        sent: list[int] = []
        try:
            self.outlet.setpoint(lambda: sent.append(1))
        except (SafetyStop, NotRunning):
            assert not self.is_open
            assert sent == []
        else:
            assert self.is_open
            assert sent == [1]

    @precondition(lambda self: self.hindrance != "absence")
    @rule()
    def command(self) -> None:
        runs = all(said is not None and said[0] is RobotMode.RUNNING for said in self.said.values())
        fresh = all(self.now - heard <= STALE for heard in self.heard.values())
        if runs and fresh:
            self.outlet.command("set_tool_voltage(0)")
            self.lines["primary"].sent.pop()
        else:
            with pytest.raises(NotRunning):
                self.outlet.command("set_tool_voltage(0)")

    @invariant()
    def no_motion_goes_on_under_a_stop(self) -> None:
        if hasattr(self, "safety") and self.hindrance is not None:
            assert self.motions == 0

    @invariant()
    def it_says_what_it_does(self) -> None:
        if hasattr(self, "safety"):
            assert self.safety.is_enabled == self.is_open

    # -- small change --------------------------------------------------------------------------------

    def clock(self) -> float:
        return self.now

    def tick(self) -> None:
        self.now += 0.01

    def say(self, source: str, said: tuple[RobotMode, SafetyMode]) -> None:
        self.said[source] = said
        self.heard[source] = self.now


TestGateBeforeTheOutlet = pytest.mark.property(GateBeforeTheOutlet.TestCase)
TestGateBeforeTheOutlet.settings = settings(deadline=None, stateful_step_count=40)
