"""The gate as a table: every policy, every state, every event; and what each status means."""

from __future__ import annotations

from typing import get_args

import pytest

from linkcore.errors import BadValue
from urlink.commanding.interlock import STALE, Gate, Policy, Status
from urlink.errors import NotEnabled, NotRunning, SafetyStop
from urlink.interfaces.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode

CLEAR = Status(RobotMode.RUNNING, SafetyMode.NORMAL)
STOP = Status(RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP)
EMERGENCY = Status(RobotMode.POWER_OFF, SafetyMode.ROBOT_EMERGENCY_STOP)
OFF = Status(RobotMode.POWER_OFF, SafetyMode.NORMAL)

POLICIES: tuple[Policy, ...] = get_args(Policy)


class Driver:
    """A gate with one source, put into a state by events by name."""

    def __init__(self, policy: Policy) -> None:
        self.gate = Gate(policy)
        self.now = 0.0
        self.gate.expect("primary")

    def do(self, event: str) -> bool:
        """Whether the event has ended the motions."""
        self.now += 0.1
        gate = self.gate
        if event == "enable":
            try:
                gate.enable(self.now)
            except (SafetyStop, NotRunning):
                assert gate.hindrance(self.now) is not None
            return False
        if event == "silence":
            self.now += 2 * STALE
            return gate.look(self.now) is not None
        if event == "lost":
            return gate.lose("primary", "pulled", self.now) is not None
        told = {"clear": CLEAR, "stop": STOP, "emergency": EMERGENCY, "off": OFF}[event]
        return gate.hear("primary", told, self.now) is not None

    @property
    def verdict(self) -> str:
        refusal = self.gate.refusal(self.now)
        return "open" if refusal is None else type(refusal).__name__


#: how each state is reached
STATES = {
    "unheard": (),
    "clear": ("clear",),
    "enabled": ("clear", "enable"),
    "stopped": ("clear", "stop"),
    "stopped after enabled": ("clear", "enable", "stop"),
    "emergency": ("clear", "enable", "emergency"),
    "off": ("clear", "enable", "off"),
    "lost": ("clear", "enable", "lost"),
    "silent": ("clear", "enable", "silence"),
    "stopped at first": ("stop",),
}
EVENTS = ("clear", "stop", "emergency", "off", "lost", "silence", "enable")

_AFTER = {
    "stop": "SafetyStop",
    "emergency": "SafetyStop",
    "off": "NotRunning",
    "lost": "NotRunning",
    "silence": "NotRunning",
}
_STANDING = {
    "unheard": "NotRunning",
    "stopped": "SafetyStop",
    "stopped after enabled": "SafetyStop",
    "emergency": "SafetyStop",
    "off": "NotRunning",
    "lost": "NotRunning",
    "silent": "NotRunning",
    "stopped at first": "SafetyStop",
}
#: (policy, state) -> what "clear" leads to
_CLEARED: dict[tuple[Policy, str], str] = {
    **{("never", state): "open" for state in STATES},
    **{
        ("on_startup", state): "NotEnabled" if state in ("unheard", "clear", "stopped", "stopped at first") else "open"
        for state in STATES
    },
    **{("always", state): "open" if state == "enabled" else "NotEnabled" for state in STATES},
}


def expected(policy: Policy, state: str, event: str) -> str:
    if event == "clear":
        return _CLEARED[policy, state]
    if event == "enable":
        return _STANDING.get(state, "open")
    if event == "silence" and _STANDING.get(state) == "SafetyStop":
        return "SafetyStop"  # a stop that was heard last still holds, for all that is known
    return _AFTER[event]


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("policy", POLICIES)
def test_transition(policy: Policy, state: str, event: str) -> None:
    driver = Driver(policy)
    for each in STATES[state]:
        driver.do(each)
    was_clear = driver.gate.hindrance(driver.now) is None
    ended = driver.do(event)
    assert driver.verdict == expected(policy, state, event)
    # What closes the gate ends the motions, once.
    assert ended == (was_clear and event in _AFTER)


@pytest.mark.parametrize("policy", POLICIES)
def test_a_stop_between_two_looks_is_not_forgotten(policy: Policy) -> None:
    driver = Driver(policy)
    for event in ("clear", "enable", "stop", "clear"):
        driver.do(event)
    assert driver.verdict == ("NotEnabled" if policy == "always" else "open")


def test_a_stop_ends_motions_once() -> None:
    driver = Driver("never")
    driver.do("clear")
    assert [driver.do(event) for event in ("stop", "stop", "emergency", "off", "lost", "clear", "stop")] == [
        *(True, False, False, False, False, False),
        True,
    ]


def test_every_source_has_to_be_clear() -> None:
    gate = Gate()
    gate.expect("primary")
    gate.expect("realtime")
    gate.hear("primary", CLEAR, 1.0)
    assert isinstance(gate.refusal(1.0), NotRunning)
    gate.hear("realtime", CLEAR, 1.0)
    assert gate.refusal(1.0) is None
    assert isinstance(gate.hear("realtime", STOP, 1.1), SafetyStop)
    gate.hear("realtime", CLEAR, 1.2)
    assert gate.refusal(1.2) is None
    assert isinstance(gate.lose("realtime", "pulled", 1.3), NotRunning)
    gate.hear("primary", CLEAR, 1.4)
    assert "realtime" in str(gate.refusal(1.4))
    gate.forget("realtime")
    assert gate.refusal(1.4) is None


def test_what_waited_in_a_queue_is_not_news() -> None:
    gate = Gate()
    gate.hear("primary", CLEAR, 1.0)
    gate.lose("primary", "pulled", 2.0)
    gate.hear("primary", CLEAR, 1.9)  # of the connection that was lost
    assert "pulled" in str(gate.refusal(2.0))
    gate.hear("primary", CLEAR, 2.1)
    assert gate.refusal(2.1) is None


def test_a_loss_that_is_told_late_is_a_loss() -> None:
    gate = Gate("always")
    gate.hear("primary", CLEAR, 1.0)
    gate.enable(1.0)
    gate.hear("primary", CLEAR, 2.1)  # already the next connection
    assert isinstance(gate.lose("primary", "pulled", 2.0), NotRunning)
    assert isinstance(gate.refusal(2.1), NotEnabled)
    gate.enable(2.1)
    assert gate.refusal(2.1) is None


@pytest.mark.parametrize("mode", SafetyMode)
def test_safety_modes(mode: SafetyMode) -> None:
    gate = Gate()
    gate.hear("primary", Status(RobotMode.RUNNING, mode), 1.0)
    refusal = gate.refusal(1.0)
    if mode in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        assert refusal is None
    else:
        assert isinstance(refusal, SafetyStop)
        assert refusal.cause in str(refusal)
        assert refusal.cause == gate.cause


def test_a_safety_mode_without_a_name_stops() -> None:
    gate = Gate()
    gate.hear("primary", Status(RobotMode.RUNNING, SafetyMode(99)), 1.0)
    assert gate.cause == "safety mode unknown 99"


@pytest.mark.parametrize("mode", RobotMode)
def test_robot_modes(mode: RobotMode) -> None:
    gate = Gate()
    gate.hear("primary", Status(mode, SafetyMode.NORMAL), 1.0)
    if mode is RobotMode.RUNNING:
        assert gate.refusal(1.0) is None
    else:
        assert mode.name in str(gate.refusal(1.0))
        assert isinstance(gate.refusal(1.0), NotRunning)


_CB2 = {
    RobotModeCB2.RUNNING: None,
    RobotModeCB2.SECURITY_STOPPED: "protective stop",
    RobotModeCB2.EMERGENCY_STOPPED: "emergency stop",
    RobotModeCB2.FATAL_ERROR: "fatal error",
    RobotModeCB2.SAFEGUARD_STOP: "safeguard stop",
}


@pytest.mark.parametrize("mode", RobotModeCB2)
def test_robot_modes_of_cb2(mode: RobotModeCB2) -> None:
    """Their numbers are others: 0 runs, and 7, which runs on later ones, has no power."""
    gate = Gate()
    gate.hear("primary", Status(mode), 1.0)
    assert gate.cause == _CB2.get(mode)
    if mode in _CB2:
        assert (gate.refusal(1.0) is None) == (_CB2[mode] is None)
    else:
        assert isinstance(gate.refusal(1.0), NotRunning)


@pytest.mark.parametrize(
    ("status", "cause"),
    [
        (Status(RobotMode.RUNNING, None, is_emergency_stopped=True), "emergency stop"),
        (Status(RobotMode.RUNNING, None, is_protective_stopped=True), "protective stop"),
        (Status(RobotModeCB2.RUNNING, master_safety_state=MasterSafetyState.SAFEGUARD_STOP), "safeguard stop"),
        (
            Status(RobotModeCB2.RUNNING, master_safety_state=MasterSafetyState.EXTERNAL_EMERGENCY_STOP),
            "external emergency stop",
        ),
        (Status(RobotModeCB2.RUNNING, master_safety_state=MasterSafetyState.OK), None),
        (Status(RobotModeCB2.RUNNING, master_safety_state=MasterSafetyState.UNDEFINED), None),
    ],
)
def test_flags_and_boards(status: Status, cause: str | None) -> None:
    assert status.cause == cause


def test_commands_need_no_more_than_a_running_robot() -> None:
    gate = Gate("always")
    gate.hear("primary", STOP, 1.0)
    assert gate.absence(1.0) is None
    gate.hear("primary", EMERGENCY, 1.0)
    assert isinstance(gate.absence(1.0), NotRunning)


def test_policies_can_change() -> None:
    gate = Gate("never")
    gate.hear("primary", CLEAR, 1.0)
    gate.policy = "on_startup"
    assert isinstance(gate.refusal(1.0), NotEnabled)
    gate.enable(1.0)
    gate.policy = "always"
    assert gate.refusal(1.0) is None
    with pytest.raises(BadValue, match="sometimes"):
        gate.policy = "sometimes"  # type: ignore[assignment]


def test_the_newest_word_comes_first() -> None:
    gate = Gate()
    slow, fast = Status(RobotMode.RUNNING, SafetyMode.NORMAL), Status(RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP)
    gate.hear("primary", slow, 100.0)
    gate.hear("realtime", fast, 100.05)
    assert gate.statuses == [fast, slow]
    gate.hear("primary", fast, 100.1)
    gate.lose("realtime", "pulled", 100.2)
    assert gate.statuses == [fast]
