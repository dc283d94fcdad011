"""The interlock as a table: every policy, every state, every event; and what each status means."""

from __future__ import annotations

from typing import get_args

import pytest

from linkcore.errors import BadValue
from urlink.command.interlock import Interlock, Status
from urlink.errors import NotEnabled, NotRunning, SafetyStop
from urlink.protocol.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode
from urlink.session.connect_options import STALE_AFTER, Policy

CLEAR = Status(RobotMode.RUNNING, SafetyMode.NORMAL)
STOP = Status(RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP)
EMERGENCY = Status(RobotMode.POWER_OFF, SafetyMode.ROBOT_EMERGENCY_STOP)
OFF = Status(RobotMode.POWER_OFF, SafetyMode.NORMAL)

POLICIES: tuple[Policy, ...] = get_args(Policy)


class Driver:
    """A interlock with one source, put into a state by events by name."""

    def __init__(self, policy: Policy) -> None:
        self.interlock = Interlock(policy)
        self.now = 0.0
        self.interlock.expect("primary")

    def do(self, event: str) -> bool:
        """Whether the event has ended the motions."""
        self.now += 0.1
        interlock = self.interlock
        if event == "enable":
            try:
                interlock.enable(self.now)
            except (SafetyStop, NotRunning):
                assert interlock.blocked(self.now) is not None
            return False
        if event == "silence":
            return interlock.fall_silent("primary", STALE_AFTER) is not None
        if event == "lost":
            return interlock.lose("primary", "pulled") is not None
        told = {"clear": CLEAR, "stop": STOP, "emergency": EMERGENCY, "off": OFF}[event]
        return interlock.report("primary", told, self.now) is not None

    @property
    def verdict(self) -> str:
        refusal = self.interlock.refusal_to_begin(self.now)
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
    was_clear = driver.interlock.blocked(driver.now) is None
    ended = driver.do(event)
    assert driver.verdict == expected(policy, state, event)
    # What closes the interlock ends the motions, once.
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
    interlock = Interlock()
    interlock.expect("primary")
    interlock.expect("realtime")
    interlock.report("primary", CLEAR, 1.0)
    assert isinstance(interlock.refusal_to_begin(1.0), NotRunning)
    interlock.report("realtime", CLEAR, 1.0)
    assert interlock.refusal_to_begin(1.0) is None
    assert isinstance(interlock.report("realtime", STOP, 1.1), SafetyStop)
    interlock.report("realtime", CLEAR, 1.2)
    assert interlock.refusal_to_begin(1.2) is None
    assert isinstance(interlock.lose("realtime", "pulled"), NotRunning)
    interlock.report("primary", CLEAR, 1.4)
    assert "realtime" in str(interlock.refusal_to_begin(1.4))
    interlock.forget("realtime")
    assert interlock.refusal_to_begin(1.4) is None
    # Since it is open again, what closes it ends what has been begun meanwhile.
    assert isinstance(interlock.report("primary", STOP, 1.5), SafetyStop)


def test_what_has_said_nothing_is_no_running_robot() -> None:
    interlock = Interlock()
    assert "nothing was received from the robot yet" in str(interlock.refusal_to_begin(0.0))
    interlock.report("primary", Status(safety_mode=SafetyMode.NORMAL), 1.0)
    interlock.expect("realtime")
    assert "nothing was received on the realtime interface yet" in str(interlock.refusal_to_begin(1.0))
    interlock.report("realtime", Status(safety_mode=SafetyMode.NORMAL), 1.0)
    assert "has not reported its mode" in str(interlock.refusal_to_begin(1.0))
    interlock.report("realtime", Status(RobotMode.RUNNING), 1.0)
    assert interlock.refusal_to_begin(1.0) is None


def test_which_sources_have_spoken() -> None:
    interlock = Interlock()
    interlock.expect("primary")
    assert [interlock.has_reported(name) for name in ("primary", "realtime")] == [False, False]
    interlock.report("primary", CLEAR, 1.0)
    interlock.lose("realtime", "refused")
    assert [interlock.has_reported(name) for name in ("primary", "realtime")] == [True, True]


def test_what_is_old_is_not_believed_but_ends_nothing() -> None:
    """Perhaps this program was held up: only who reads can tell that the robot is silent."""
    interlock = Interlock("always")
    interlock.report("primary", CLEAR, 1.0)
    interlock.enable(1.0)
    assert interlock.refusal_to_begin(2.0) is None
    late = 2.1
    assert "either the robot is silent, or this program was delayed" in str(interlock.refusal_to_begin(late))
    with pytest.raises(NotRunning):
        interlock.enable(late)
    # What has come meanwhile is read, and nobody has to enable it anew.
    assert interlock.report("primary", CLEAR, late) is None
    assert interlock.refusal_to_begin(late) is None


def test_silence_that_the_reader_tells_of_ends_motions() -> None:
    interlock = Interlock("always", stale_after=0.5)
    assert interlock.fall_silent("primary", 0.5) is None  # which is not listened to
    interlock.report("primary", CLEAR, 1.0)
    interlock.enable(1.0)
    ended = interlock.fall_silent("primary", 0.5)
    assert isinstance(ended, NotRunning)
    assert "nothing arrived on the primary interface for 0.5 s" in str(ended)
    assert interlock.fall_silent("primary", 1.5) is None  # once
    assert "for 0.5 s" in str(interlock.refusal_to_begin(1.2))
    interlock.report("primary", CLEAR, 2.6)
    assert isinstance(interlock.refusal_to_begin(2.6), NotEnabled)


def test_what_is_left_out_is_as_it_was() -> None:
    """A state without the part that tells of safety must not lift a stop."""
    interlock = Interlock()
    interlock.report("primary", STOP, 1.0)
    interlock.report("primary", Status(RobotMode.RUNNING), 1.1)
    assert interlock.cause == "protective stop"
    interlock.report("primary", Status(safety_mode=SafetyMode.NORMAL), 1.2)
    assert interlock.refusal_to_begin(1.2) is None
    interlock.report("primary", Status(is_protective_stopped=True), 1.3)
    interlock.report("primary", CLEAR, 1.4)
    assert interlock.cause == "protective stop"
    interlock.report("primary", Status(is_protective_stopped=False), 1.5)
    assert interlock.cause is None


def test_a_part_alone_opens_nothing() -> None:
    interlock = Interlock()
    interlock.report("realtime", CLEAR, 1.0)
    interlock.report("primary", CLEAR, 1.0)
    interlock.lose("primary", "pulled")
    assert interlock.amend("primary", Status(safety_mode=SafetyMode.NORMAL), 1.1) is None
    assert "pulled" in str(interlock.refusal_to_begin(1.1))
    interlock.report("primary", CLEAR, 1.2)
    assert isinstance(interlock.amend("primary", Status(safety_mode=SafetyMode.FAULT), 1.3), SafetyStop)
    assert interlock.amend("secondary", CLEAR, 1.3) is None


def test_but_not_over_a_lost_connection() -> None:
    interlock = Interlock()
    interlock.report("primary", STOP, 1.0)
    interlock.lose("primary", "pulled")
    interlock.report("primary", Status(RobotMode.RUNNING), 2.0)
    assert interlock.cause is None


@pytest.mark.parametrize("mode", SafetyMode)
def test_safety_modes(mode: SafetyMode) -> None:
    interlock = Interlock()
    interlock.report("primary", Status(RobotMode.RUNNING, mode), 1.0)
    refusal = interlock.refusal_to_begin(1.0)
    if mode in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        assert refusal is None
    else:
        assert isinstance(refusal, SafetyStop)
        assert refusal.cause in str(refusal)
        assert refusal.cause == interlock.cause


def test_a_safety_mode_without_a_name_stops() -> None:
    interlock = Interlock()
    interlock.report("primary", Status(RobotMode.RUNNING, SafetyMode(99)), 1.0)
    assert interlock.cause == "safety mode unknown 99"


@pytest.mark.parametrize("mode", RobotMode)
def test_robot_modes(mode: RobotMode) -> None:
    interlock = Interlock()
    interlock.report("primary", Status(mode, SafetyMode.NORMAL), 1.0)
    if mode is RobotMode.RUNNING:
        assert interlock.refusal_to_begin(1.0) is None
    else:
        assert mode.name in str(interlock.refusal_to_begin(1.0))
        assert isinstance(interlock.refusal_to_begin(1.0), NotRunning)


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
    interlock = Interlock()
    interlock.report("primary", Status(mode), 1.0)
    assert interlock.cause == _CB2.get(mode)
    if mode in _CB2:
        assert (interlock.refusal_to_begin(1.0) is None) == (_CB2[mode] is None)
    else:
        assert isinstance(interlock.refusal_to_begin(1.0), NotRunning)


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
    interlock = Interlock("always")
    interlock.report("primary", STOP, 1.0)
    assert interlock.absence(1.0) is None
    interlock.report("primary", EMERGENCY, 1.0)
    assert isinstance(interlock.absence(1.0), NotRunning)


@pytest.mark.parametrize("before", POLICIES)
@pytest.mark.parametrize("after", POLICIES)
def test_a_change_of_policy_asks_anew(before: Policy, after: Policy) -> None:
    interlock = Interlock(before)
    interlock.report("primary", CLEAR, 1.0)
    interlock.enable(1.0)
    interlock.policy = before  # no change
    assert interlock.refusal_to_begin(1.0) is None
    interlock.policy = after
    refusal = interlock.refusal_to_begin(1.0)
    assert isinstance(refusal, NotEnabled) == (after != before and after != "never")
    if refusal is not None:
        when = {"on_startup": "once", "always": "at first and after every stop"}[after]
        assert str(refusal).endswith(f"call robot.safety.enable() {when}")
    interlock.enable(1.0)
    assert interlock.refusal_to_begin(1.0) is None


def test_a_running_motion_continues_when_no_new_one_may_begin() -> None:
    interlock = Interlock("always")
    interlock.report("primary", CLEAR, 1.0)
    assert isinstance(interlock.refusal_to_begin(1.0), NotEnabled)
    assert interlock.refusal_to_continue() is None
    interlock.enable(1.0)
    late = 1.0 + 2.0 * STALE_AFTER
    assert isinstance(interlock.refusal_to_begin(late), NotRunning)  # this process was held up
    assert interlock.refusal_to_continue() is None
    assert interlock.fall_silent("primary", STALE_AFTER) is not None  # the robot itself is silent
    assert isinstance(interlock.refusal_to_continue(), NotRunning)


def test_no_such_policy() -> None:
    with pytest.raises(BadValue, match="sometimes"):
        Interlock("sometimes")  # type: ignore[arg-type]


def test_every_source_has_to_say_something_anew() -> None:
    interlock = Interlock()
    running = Status(RobotMode.RUNNING, SafetyMode.NORMAL)
    interlock.report("primary", running, 100.0)
    interlock.report("realtime", running, 100.05)
    assert [interlock.has_reported_since(since) for since in (99.9, 100.0, 100.05)] == [True, False, False]
    interlock.report("primary", running, 100.1)
    assert interlock.has_reported_since(100.0)


def test_the_newest_word_comes_first() -> None:
    interlock = Interlock()
    slow, fast = Status(RobotMode.RUNNING, SafetyMode.NORMAL), Status(RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP)
    interlock.report("primary", slow, 100.0)
    interlock.report("realtime", fast, 100.05)
    assert interlock.statuses == [fast, slow]
    interlock.report("primary", fast, 100.1)
    interlock.lose("realtime", "pulled")
    assert interlock.statuses == [fast]
