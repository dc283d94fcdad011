"""The interlock as a table of every policy, state and event; and the meaning of each status."""

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
    """Interlock with one source, which is put into a state by named events."""

    def __init__(self, policy: Policy) -> None:
        self.interlock = Interlock(policy)
        self.now = 0.0
        self.interlock.expect("primary")

    def do(self, event: str) -> bool:
        """Apply an event; return whether it ended the motions."""
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


#: Events that lead to each state.
STATES = {
    "no report": (),
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
    "no report": "NotRunning",
    "stopped": "SafetyStop",
    "stopped after enabled": "SafetyStop",
    "emergency": "SafetyStop",
    "off": "NotRunning",
    "lost": "NotRunning",
    "silent": "NotRunning",
    "stopped at first": "SafetyStop",
}
#: (policy, state) -> verdict after the event "clear"
_CLEARED: dict[tuple[Policy, str], str] = {
    **{("never", state): "open" for state in STATES},
    **{
        ("on_startup", state): "NotEnabled"
        if state in ("no report", "clear", "stopped", "stopped at first")
        else "open"
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
        return "SafetyStop"  # the last report was a stop, which might still be active
    return _AFTER[event]


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("policy", POLICIES)
def test_interlock_event_gives_expected_verdict_in_each_state(policy: Policy, state: str, event: str) -> None:
    driver = Driver(policy)
    for each in STATES[state]:
        driver.do(each)
    was_clear = driver.interlock.blocked(driver.now) is None
    ended = driver.do(event)
    assert driver.verdict == expected(policy, state, event)
    # Events that close the interlock end the motions, once.
    assert ended == (was_clear and event in _AFTER)


@pytest.mark.parametrize("policy", POLICIES)
def test_short_stop_requires_enable_only_with_policy_always(policy: Policy) -> None:
    driver = Driver(policy)
    for event in ("clear", "enable", "stop", "clear"):
        driver.do(event)
    assert driver.verdict == ("NotEnabled" if policy == "always" else "open")


def test_interlock_ends_motions_once_per_closing() -> None:
    driver = Driver("never")
    driver.do("clear")
    assert [driver.do(event) for event in ("stop", "stop", "emergency", "off", "lost", "clear", "stop")] == [
        *(True, False, False, False, False, False),
        True,
    ]


def test_interlock_opens_only_when_every_source_is_clear() -> None:
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
    # The interlock was open again, so closing it ends motions that were started meanwhile.
    assert isinstance(interlock.report("primary", STOP, 1.5), SafetyStop)


def test_missing_report_or_mode_means_not_running() -> None:
    interlock = Interlock()
    assert "nothing was received from the robot yet" in str(interlock.refusal_to_begin(0.0))
    interlock.report("primary", Status(safety_mode=SafetyMode.NORMAL), 1.0)
    interlock.expect("realtime")
    assert "nothing was received on the realtime interface yet" in str(interlock.refusal_to_begin(1.0))
    interlock.report("realtime", Status(safety_mode=SafetyMode.NORMAL), 1.0)
    assert "has not reported its mode" in str(interlock.refusal_to_begin(1.0))
    interlock.report("realtime", Status(RobotMode.RUNNING), 1.0)
    assert interlock.refusal_to_begin(1.0) is None


def test_has_reported_is_true_for_a_lost_source() -> None:
    interlock = Interlock()
    interlock.expect("primary")
    assert [interlock.has_reported(name) for name in ("primary", "realtime")] == [False, False]
    interlock.report("primary", CLEAR, 1.0)
    interlock.lose("realtime", "refused")
    assert [interlock.has_reported(name) for name in ("primary", "realtime")] == [True, True]


def test_stale_report_refuses_motions_but_ends_none() -> None:
    """This program might have been delayed: only the reader thread can detect that the robot is silent."""
    interlock = Interlock("always")
    interlock.report("primary", CLEAR, 1.0)
    interlock.enable(1.0)
    assert interlock.refusal_to_begin(2.0) is None
    late = 2.1
    assert "either the robot is silent, or this program was delayed" in str(interlock.refusal_to_begin(late))
    with pytest.raises(NotRunning):
        interlock.enable(late)
    # When the states that arrived meanwhile are read, no new `enable()` is necessary.
    assert interlock.report("primary", CLEAR, late) is None
    assert interlock.refusal_to_begin(late) is None


def test_renewed_report_is_recent() -> None:
    interlock = Interlock(stale_after=0.5)
    interlock.report("primary", Status(RobotMode.RUNNING, SafetyMode.NORMAL), 10.0)
    interlock.renew("primary", 11.0)
    interlock.renew("realtime", 11.0)  # it has not reported yet
    assert interlock.is_clear
    assert interlock.blocked(11.4) is None
    assert isinstance(interlock.blocked(11.6), NotRunning)
    assert not interlock.is_expected("realtime")


def test_silence_reported_by_reader_ends_motions_once() -> None:
    interlock = Interlock("always", stale_after=0.5)
    assert interlock.fall_silent("primary", 0.5) is None  # not subscribed yet
    interlock.report("primary", CLEAR, 1.0)
    interlock.enable(1.0)
    ended = interlock.fall_silent("primary", 0.5)
    assert isinstance(ended, NotRunning)
    assert "nothing arrived on the primary interface for 0.5 s" in str(ended)
    assert interlock.fall_silent("primary", 1.5) is None  # once
    assert "for 0.5 s" in str(interlock.refusal_to_begin(1.2))
    interlock.report("primary", CLEAR, 2.6)
    assert isinstance(interlock.refusal_to_begin(2.6), NotEnabled)


def test_missing_part_of_a_state_keeps_the_previous_value() -> None:
    """A state without the safety part must not clear a stop."""
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


def test_partial_report_has_no_effect_before_a_complete_report() -> None:
    interlock = Interlock()
    interlock.report("realtime", CLEAR, 1.0)
    interlock.report("primary", CLEAR, 1.0)
    interlock.lose("primary", "pulled")
    assert interlock.amend("primary", Status(safety_mode=SafetyMode.NORMAL), 1.1) is None
    assert "pulled" in str(interlock.refusal_to_begin(1.1))
    interlock.report("primary", CLEAR, 1.2)
    assert isinstance(interlock.amend("primary", Status(safety_mode=SafetyMode.FAULT), 1.3), SafetyStop)
    assert interlock.amend("secondary", CLEAR, 1.3) is None


def test_lost_connection_discards_previous_values() -> None:
    interlock = Interlock()
    interlock.report("primary", STOP, 1.0)
    interlock.lose("primary", "pulled")
    interlock.report("primary", Status(RobotMode.RUNNING), 2.0)
    assert interlock.cause is None


@pytest.mark.parametrize("mode", SafetyMode)
def test_only_normal_and_reduced_permit_motion(mode: SafetyMode) -> None:
    interlock = Interlock()
    interlock.report("primary", Status(RobotMode.RUNNING, mode), 1.0)
    refusal = interlock.refusal_to_begin(1.0)
    if mode in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        assert refusal is None
    else:
        assert isinstance(refusal, SafetyStop)
        assert refusal.cause in str(refusal)
        assert refusal.cause == interlock.cause


def test_unknown_safety_mode_is_a_stop() -> None:
    interlock = Interlock()
    interlock.report("primary", Status(RobotMode.RUNNING, SafetyMode(99)), 1.0)
    assert interlock.cause == "safety mode unknown 99"


@pytest.mark.parametrize("mode", RobotMode)
def test_only_robot_mode_running_permits_motion(mode: RobotMode) -> None:
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
def test_robot_modes_of_cb2_permit_or_stop(mode: RobotModeCB2) -> None:
    """CB2 uses different numbers: 0 is running, and 7, which is running on later controllers, is without power."""
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
def test_cause_of_stop_is_derived_from_flags_and_masterboard(status: Status, cause: str | None) -> None:
    assert status.cause == cause


def test_absence_is_none_for_a_running_robot_with_a_stop() -> None:
    interlock = Interlock("always")
    interlock.report("primary", STOP, 1.0)
    assert interlock.absence(1.0) is None
    interlock.report("primary", EMERGENCY, 1.0)
    assert isinstance(interlock.absence(1.0), NotRunning)


@pytest.mark.parametrize("before", POLICIES)
@pytest.mark.parametrize("after", POLICIES)
def test_changed_policy_requires_enable_again(before: Policy, after: Policy) -> None:
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


def test_running_motion_continues_when_new_motions_are_refused() -> None:
    interlock = Interlock("always")
    interlock.report("primary", CLEAR, 1.0)
    assert isinstance(interlock.refusal_to_begin(1.0), NotEnabled)
    assert interlock.refusal_to_continue() is None
    interlock.enable(1.0)
    late = 1.0 + 2.0 * STALE_AFTER
    assert isinstance(interlock.refusal_to_begin(late), NotRunning)  # this process was delayed
    assert interlock.refusal_to_continue() is None
    assert interlock.fall_silent("primary", STALE_AFTER) is not None  # the robot itself is silent
    assert isinstance(interlock.refusal_to_continue(), NotRunning)


def test_interlock_rejects_unknown_policy() -> None:
    with pytest.raises(BadValue, match="sometimes"):
        Interlock("sometimes")  # type: ignore[arg-type]


def test_has_reported_since_is_false_until_every_source_reported() -> None:
    interlock = Interlock()
    running = Status(RobotMode.RUNNING, SafetyMode.NORMAL)
    interlock.report("primary", running, 100.0)
    interlock.report("realtime", running, 100.05)
    assert [interlock.has_reported_since(since) for since in (99.9, 100.0, 100.05)] == [True, False, False]
    interlock.report("primary", running, 100.1)
    assert interlock.has_reported_since(100.0)


def test_statuses_are_sorted_with_the_newest_report_first() -> None:
    interlock = Interlock()
    slow, fast = Status(RobotMode.RUNNING, SafetyMode.NORMAL), Status(RobotMode.RUNNING, SafetyMode.PROTECTIVE_STOP)
    interlock.report("primary", slow, 100.0)
    interlock.report("realtime", fast, 100.05)
    assert interlock.statuses == [fast, slow]
    interlock.report("primary", fast, 100.1)
    interlock.lose("realtime", "pulled")
    assert interlock.statuses == [fast]
