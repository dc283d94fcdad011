"""Evidence without a defect is not rejected: each case was a false alarm of a run on a busy computer."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from linkcore.clock import Stamp
from urlink.protocol.firmware import Firmware
from urlink.session.identity import described_identity
from urlink_accept.acceptance.evidence import Came, Evidence, Note, Wire
from urlink_accept.acceptance.report import judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.identification.samples import COLUMNS

_PERIOD = 0.002


def evidence(speeds: np.ndarray, notes: list[Note], arrivals: np.ndarray | None = None) -> Evidence:
    """Return evidence of an e-Series.

    Args:
        speeds: Joint speeds, shape (n, 6), in rad/s, one row every 2 ms.
        notes: Notes of the logbook.
        arrivals: Arrival times in s; None for the times of the states.
    """
    times = _PERIOD * np.arange(1, len(speeds) + 1)
    accelerations = np.diff(speeds, axis=0, prepend=0.0) / _PERIOD
    positions = np.cumsum(0.5 * _PERIOD * (speeds + np.vstack([np.zeros(6), speeds[:-1]])), axis=0)
    states = [
        SimpleNamespace(time=t, q_target=q, q_actual=q, qd_target=qd, qd_actual=qd, qdd_target=qdd)
        for t, q, qd, qdd in zip(times, positions, speeds, accelerations, strict=True)
    ]
    found = Evidence.__new__(Evidence)
    found.identity = described_identity({"name": "notes", "firmware": str(Firmware(5, 11))})
    found.notes, found.wires = notes, []
    found.__dict__["realtime"] = Came(states, list(times if arrivals is None else arrivals), begins=[0])
    return found


def verdict(name: str, of: Evidence) -> tuple[str, str]:
    (each,) = judge(of, {name: requirements()[name]})
    return each.state, each.seen


@pytest.mark.parametrize(("sign", "state"), [(1.0, "held"), (-1.0, "not held")])
def test_velocity_requirement_accepts_start_within_one_cycle(sign: float, state: str) -> None:
    speeds = np.zeros((400, 6))
    speeds[:, 5] = np.repeat(np.tile([0.1, 0.0], 20), 10)
    of = evidence(speeds, [Note(0.0, "stage", {"number": 0})])
    for each in of.realtime.states:
        each.qdd_target = sign * each.qdd_target
    assert verdict("velocities", of)[0] == state


@pytest.mark.parametrize(("gap", "state"), [(0.3, "not tried"), (0.0, "not held")])
def test_stream_end_is_not_judged_when_computer_was_delayed(gap: float, state: str) -> None:
    error = "ConnectionLost: no message reached the program on the robot in time; it brakes on its own"
    arrivals = _PERIOD * np.arange(1, 1001)
    arrivals[500:] += gap
    notes = [Note(0.0, "stage", {"number": 2})]
    for step in ("follow-100", "follow-50", "follow-10"):
        notes += [Note(0.1, step, {"event": "begin"}), Note(2.0, step, {"event": "end", "error": error})]
    found, seen = verdict("follow-scales", evidence(np.zeros((1000, 6)), notes, arrivals))
    assert found == state
    assert error in seen


@pytest.mark.parametrize(("each", "state"), [(2, "not tried"), (1, "not held")])
def test_trajectory_with_few_set_points_is_not_judged(each: int, state: str) -> None:
    """The motion takes three times too long; set-points are sent only during the motion."""
    sent: list[float] = []
    notes, speeds = [Note(0.0, "stage", {"number": 2})], np.zeros((12000, 6))
    for begin, slider in ((0.1, 1.0), (4.1, 0.5), (11.1, 1.0)):
        step = f"follow-{slider * 100:.0f}" if begin < 11.0 else "follow-10"
        took = 3.0 / slider
        speeds[int(begin / _PERIOD) + 50 : int((begin + took) / _PERIOD) + 50, 5] = 0.05
        sent += (begin + 0.1 + _PERIOD * each * np.arange(int(took / _PERIOD / each)) + 1e-4).tolist()
        goal = {"goal": [0.0] * 6, "slider": slider}
        notes += [Note(begin, step, {"event": "begin"}), Note(begin + took + 0.9, step, {"event": "end", **goal})]
    of = evidence(speeds, notes)
    of.wires = [Wire("reverse", False, True, [(Stamp(at, at), b"point") for at in sent])]
    assert verdict("follow-scales", of)[0] == state


@pytest.mark.parametrize(("gap", "state"), [(1.0, "not tried"), (0.0, "not held")])
def test_stream_start_is_not_judged_after_computer_delay(gap: float, state: str) -> None:
    arrivals = _PERIOD * np.arange(1, 301)
    arrivals[150:] += gap
    ended = "NotRunning: nothing arrived on the primary interface for 1.0 s"
    notes = [Note(0.0, "stage", {"number": 2}), Note(0.1, "starved", {"event": "begin"})]
    notes.append(Note(arrivals[-1], "starved", {"event": "end", "error": None, "ended": ended}))
    assert verdict("starved", evidence(np.zeros((300, 6)), notes, arrivals))[0] == state


@pytest.mark.parametrize(("gap", "state"), [(1.0, "not tried"), (0.0, "not held")])
@pytest.mark.parametrize("name", ["move-arrives", "slider-scales"])
def test_move_is_not_judged_if_packets_of_its_end_are_missing(name: str, gap: float, state: str) -> None:
    speeds = np.zeros((300, 6))
    speeds[100:, 5] = 0.01
    arrivals = _PERIOD * np.arange(1, 301)
    arrivals[200:] += gap
    notes = [Note(0.0, "stage", {"number": 2}), Note(0.05, "moving", {"start": [0.0] * 6, "slider": 0.1})]
    notes += [Note(0.1, "move", {"event": "begin"})]
    notes += [Note(arrivals[199] + 0.5 * gap + 1e-4, "move", {"event": "end", "goal": [0.0] * 5 + [0.05]})]
    assert verdict(name, evidence(speeds, notes, arrivals))[0] == state


@pytest.mark.parametrize(
    ("late", "drift", "state"), [(0.2, 0.0, "not tried"), (0.0, 3e-3, "not held"), (0.0, 0.0, "held")]
)
def test_sudden_network_delay_does_not_count_as_clock_drift(late: float, drift: float, state: str) -> None:
    arrivals = (1.0 + drift) * _PERIOD * np.arange(1, 30001)
    arrivals[18000:] += late
    notes = [Note(0.0, "stage", {"number": 0})]
    assert verdict("clock-drift", evidence(np.zeros((30000, 6)), notes, arrivals))[0] == state


@pytest.mark.parametrize("each", [2, 1])
def test_lag_measured_from_half_the_states_is_no_contradiction(each: int) -> None:
    notes = [Note(0.0, "stage", {"number": 2}), Note(0.1, "servo-lag", {"event": "begin"})]
    notes.append(Note(1.9, "servo-lag", {"event": "end", "lag": 0.045, "lookahead": 0.03}))
    of = evidence(np.zeros((1000, 6)), notes)
    sent = _PERIOD * each * np.arange(1000 // each) + 1e-4
    of.wires = [Wire("reverse", False, True, [(Stamp(at, at), b"point") for at in sent.tolist()])]
    (found,) = judge(of, {"servo-lag": requirements()["servo-lag"]})
    assert (found.state, len(found.contradicts)) == (("not tried", 0) if each == 2 else ("held", 1))


@pytest.mark.parametrize(("lag", "count"), [(0.019, 1), (0.029, 0), (0.0367, 0), (0.045, 1)])
def test_lag_contradicts_only_beyond_cycles_and_gain(lag: float, count: int) -> None:
    notes = [Note(0.0, "stage", {"number": 2}), Note(0.1, "servo-lag", {"event": "begin"})]
    notes.append(Note(1.9, "servo-lag", {"event": "end", "lag": lag, "lookahead": 0.03}))
    (found,) = judge(evidence(np.zeros((1000, 6)), notes), {"servo-lag": requirements()["servo-lag"]})
    assert (found.state, len(found.contradicts)) == ("held", count)


@pytest.mark.parametrize(("last", "state"), [(0.5, "not tried"), (0.66, "not held")])
def test_stream_without_set_points_is_not_judged(last: float, state: str) -> None:
    error = "ConnectionLost: no message reached the program on the robot in time; it brakes on its own"
    notes = [Note(0.0, "stage", {"number": 2})]
    for begin, step in ((0.1, "follow-100"), (0.8, "follow-50"), (1.5, "follow-10")):
        notes += [Note(begin, step, {"event": "begin"}), Note(begin + 0.6, step, {"event": "end", "error": error})]
    of = evidence(np.zeros((1100, 6)), notes)
    sent = [
        begin + 0.01 * number for begin in (0.1, 0.8, 1.5) for number in range(1, 60) if 0.01 * number <= last - 0.1
    ]
    of.wires = [Wire("reverse", False, True, [(Stamp(at, at), b"point") for at in sent])]
    assert verdict("follow-scales", of)[0] == state


@pytest.mark.parametrize(("gap", "state"), [(1.0, "not tried"), (0.0, "not held")])
def test_stop_is_not_judged_without_packets(gap: float, state: str) -> None:
    speeds = np.zeros((410, 6))
    speeds[:300, 5] = 0.1
    arrivals = _PERIOD * np.arange(1, 411)
    arrivals[310:] += gap
    end = arrivals[309] + 0.5 * gap + 1e-4
    notes = [Note(0.0, "stage", {"number": 2}), Note(0.1, "cancel", {"event": "begin"})]
    notes += [Note(0.59, "cancel", {"event": "told"}), Note(end, "cancel", {"event": "end", "error": None})]
    found, seen = verdict("cancel", evidence(speeds, notes, arrivals))
    assert found == state, seen


@pytest.mark.parametrize("name", ["box", "other-joints"])
def test_stage_without_packets_is_not_judged(name: str) -> None:
    notes = [Note(0.0, "stage", {"number": 2}), Note(9.0, "moving", {"start": [0.0] * 6, "slider": 0.1})]
    of = evidence(np.zeros((400, 6)), notes)
    assert verdict(name, of) == ("not tried", "no packet of the real-time interface arrived")


@pytest.mark.parametrize("count", [8, 20])
def test_swing_is_not_judged_when_few_packets_arrived(count: int) -> None:
    notes = [Note(0.791, "stage", {"number": 3}), Note(0.791, "swinging", {"start": [0.0] * 6, "slider": 1.0})]
    notes += [Note(0.791, "swing-elbow", {"event": "begin"}), Note(9.0, "swing-elbow", {"event": "end", "error": None})]
    of = evidence(np.zeros((395 + count, 6)), notes)
    of.identity = described_identity({"name": "notes", "firmware": "5.11.0", "model": "UR5e"})
    for state in of.realtime.states:
        for field in COLUMNS.values():
            state.__dict__.setdefault(field, None)
    expected = f"the recording cannot be evaluated: the logbook has {count} rows; expected 30 or more"
    assert verdict("swing-moments", of) == ("not tried", expected)


@pytest.mark.parametrize(
    ("lost", "before", "delays", "state"),
    [
        (0.0, 0.0, 0, "held"),
        (0.5, 0.0, 0, "not held"),
        (0.5, 0.0, 3, "not held"),
        (0.5, 0.0, 30, "not tried"),
        (0.5, 0.5, 0, "not tried"),
        (0.9, 0.5, 0, "not held"),
    ],
)
def test_silent_client_is_not_blamed_for_a_busy_computer(lost: float, before: float, delays: int, state: str) -> None:
    """No delay is as long as 0.1 s, but 30 delays of 15 ms are a fifth of the 2 s of the step."""
    numbers = np.arange(2000)
    is_lost = (numbers % 10 < 10 * lost) & (numbers >= 1000) | (numbers % 10 < 10 * before) & (numbers < 1000)
    of = evidence(np.zeros((2000, 6)), [Note(0.0, "stage", {"number": 1})])
    came = of.realtime
    of.__dict__["realtime"] = Came(
        [each for each, gone in zip(came.states, is_lost, strict=True) if not gone],
        [each for each, gone in zip(came.arrivals, is_lost, strict=True) if not gone],
        begins=[0],
    )
    of.notes += [Note(2.001, "silent-client", {"event": "begin"})]
    of.notes += [Note(2.05 + 0.06 * number, "delayed", {"by": 0.015}) for number in range(delays)]
    of.notes += [Note(4.001, "silent-client", {"event": "end", "error": None, "received": 9, "closed": None})]
    found, seen = verdict("silent-client", of)
    assert found == state, seen


def test_silent_client_requirement_detects_silence() -> None:
    """The packets that arrived before the silence are complete by the controller's clock."""
    arrivals = _PERIOD * np.arange(1, 2001)
    arrivals[1500:] += 1.2
    notes = [Note(0.0, "stage", {"number": 1}), Note(2.001, "silent-client", {"event": "begin"})]
    notes += [Note(4.001, "silent-client", {"event": "end", "error": None, "received": 9, "closed": None})]
    assert verdict("silent-client", evidence(np.zeros((2000, 6)), notes, arrivals))[0] == "not held"


@pytest.mark.parametrize(("by", "state"), [(0.015, "not tried"), (0.0, "not held")])
def test_missed_packets_are_not_judged_after_many_delays(by: float, state: str) -> None:
    of = evidence(np.zeros((1500, 6)), [Note(0.0, "stage", {"number": 0}), Note(0.001, "listening", {})])
    del of.realtime.states[500:1000], of.realtime.arrivals[500:1000]
    of.notes += [Note(0.1 + 0.1 * number, "delayed", {"by": by}) for number in range(25)]
    of.notes += [Note(3.0, "woken", {"worst": by})]
    assert verdict("realtime-missed", of)[0] == state


@pytest.mark.parametrize(
    ("wrong", "by", "state"),
    [(1, 0.2, "held"), (1, 0.0, "not held"), (30, 0.2, "not held")],
)
def test_single_different_signal_is_not_judged_when_busy(wrong: int, by: float, state: str) -> None:
    """A busy computer interrupts a simulated controller between the packets of two interfaces."""
    of = evidence(np.zeros((1000, 6)), [Note(0.0, "stage", {"number": 0}), Note(1.1, "delayed", {"by": by})])
    came, noise = of.realtime, np.random.default_rng(1).normal(size=(1000, 6))
    for each, q in zip(came.states, noise, strict=True):
        each.q_actual, each.digital_input_bits = q, 0
    rtde = [
        SimpleNamespace(timestamp=each.time, actual_q=each.q_actual, actual_digital_input_bits=0)
        for each in came.states
    ]
    for each in rtde[500 : 500 + wrong]:
        each.actual_digital_input_bits = 16
    of.__dict__["rtde"] = Came(rtde, list(came.arrivals), begins=[0])
    of.__dict__["primary"] = of.__dict__["secondary"] = Came()
    found, seen = verdict("fields-agree", of)
    assert found == state, seen
