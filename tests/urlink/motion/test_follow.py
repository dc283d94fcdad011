"""Trajectories as set-points and as waypoints; the test plays the robot."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable
from queue import SimpleQueue
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkcore.errors import BadAddress, BadValue, Cancelled, ConnectFailed, ConnectionLost, LinkTimeout, LocalError
from linkcore.handle import Motion, Phase
from linkcore.pending_call import PendingCall
from linkcore.streaming.subscription import Subscription
from tests import platforms
from tests.fakes.rehearsal import FOLLOW, STOP, TIMEOUT, WAIT, Rehearsal, turned
from tests.waiting import until
from urlink.errors import NotEnabled, NotRunning, ProgramStopped, SafetyStop, ToleranceExceeded
from urlink.motion import TrajectoryFeedback
from urlink.motion.motions import _reporter
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.servo.following import Following
from urlink.protocol.enums import SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState

pytestmark = pytest.mark.real_time

#: A tenth of a radian forth and back.
PATH = Trajectory.from_arrays([0.0, 0.2, 0.4], [turned(0), turned(0.1), turned(0)])


def begun(robot: Rehearsal, **options: object) -> Motion:
    """Start a motion; return it when its program has connected and received the first set-point."""
    motion = robot.motion.follow(PATH, **options)  # type: ignore[arg-type]
    robot.connect()
    while not (message := robot.obey()) or message[1] != FOLLOW:
        assert message is not None
    until(lambda: motion.phase is not Phase.SENT)
    return motion


def half_way(robot: Rehearsal, motion: Motion) -> None:
    while motion.progress < 0.5:
        assert robot.obey() is not None


def test_cancelled_call_sends_only_a_stop(rehearsal: Callable[..., Rehearsal]) -> None:
    """A state arrives before the thread runs that stops the arm for the cancelled task."""
    robot = rehearsal(link="rtde")
    call, stops = PendingCall(), SimpleQueue[Callable[[], object]]()
    motion = call.make(lambda: robot.motion.follow(PATH))
    robot.connect()
    assert robot.obey() is not None
    call.give_up(stops.put)
    for _ in range(5):
        robot.show()
    assert robot.inputs.written.empty()
    stops.get(timeout=TIMEOUT)()
    assert robot.inputs.written.get(timeout=TIMEOUT)["input_int_register_46"] == STOP
    assert motion.phase is Phase.CANCELLED


# -- to the end ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("firmware", "arm"), [("1.8", "UR5"), ("3.4", "UR5"), ("5.11", "UR5e")])
def test_set_points_match_trajectory_at_each_cycle(
    rehearsal: Callable[..., Rehearsal], firmware: str, arm: str
) -> None:
    robot = rehearsal(firmware, arm)
    motion = robot.motion.follow(PATH)
    robot.connect()
    messages = []
    while not motion.done:
        message = robot.obey()
        if message is None or message[1] == STOP:
            break
        messages.append((robot.time, *message))
    robot.finish()
    motion.wait(TIMEOUT)
    assert motion.phase is Phase.DONE
    assert motion.progress == 1.0
    t0 = messages[0][0]
    for time, q, what in messages:
        assert what == FOLLOW
        expected = PATH.at(time + 2 * robot.cycle - t0)[0]
        assert np.allclose(q, expected, rtol=0, atol=1e-6)
    assert messages[-1][1] == pytest.approx(PATH.q[-1], abs=1e-6)
    assert robot.message() is None
    assert len(robot.sent) == 1


def test_unknown_link_is_rejected(robot: Rehearsal) -> None:
    with pytest.raises(BadValue, match="link='nonsense'; expected 'reverse' or 'rtde'"):
        robot.motion.follow(PATH, link="nonsense")  # type: ignore[arg-type]
    assert robot.sent == []


def test_state_with_earlier_time_counts_as_one_cycle(robot: Rehearsal) -> None:
    motion = robot.motion.follow(PATH)
    robot.connect()
    way: list[float] = []
    while len(way) < 60:
        if len(way) == 50:
            robot.time -= 0.25
        message = robot.obey()
        assert message is not None
        if message[1] == FOLLOW:
            way.append(message[0][5])
    steps = np.diff(way)
    assert steps[45:] / steps[44] == pytest.approx(1.0, abs=0.08)
    motion.cancel()


def test_follow_waits_until_arm_is_at_rest(led: Rehearsal) -> None:
    led.qd = [0.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    motion = led.motion.follow(PATH)
    led.connect()
    assert [led.obey() for _ in range(3)] == [([0.0] * 6, WAIT)] * 3
    led.qd = [0.0] * 6
    led.tick()
    until(lambda: led.message()[1] == FOLLOW)  # type: ignore[index]
    motion.cancel()


def test_arm_not_coming_to_rest_raises_link_timeout(led: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.motion.servo.following._REST_TIMEOUT", 0.05)
    led.qd = [0.5] * 6
    motion = led.motion.follow(PATH)
    led.connect()
    led.until(lambda: motion.done)
    with pytest.raises(LinkTimeout, match="did not come to rest"):
        motion.wait(0)


def test_initial_offset_is_faded_out(led: Rehearsal) -> None:
    led.q = turned(0.03)
    led.show()
    motion = led.motion.follow(PATH)
    led.connect()
    path = []
    while not motion.done and (message := led.obey()) is not None and message[1] == FOLLOW:
        path.append(message[0][5])
    assert path[0] == pytest.approx(0.03, abs=2e-3)
    assert path[-1] == pytest.approx(0.0, abs=1e-6)
    steps = np.abs(np.diff(path)) / led.cycle
    assert steps.max() < 0.25 + np.abs(PATH.at(np.linspace(0, 0.4, 100))[1]).max() + 0.01
    led.finish()
    motion.wait(TIMEOUT)


def test_feedback_may_be_slow_and_may_raise(led: Rehearsal) -> None:
    reported: list[TrajectoryFeedback] = []
    release = threading.Event()

    def feedback(each: TrajectoryFeedback) -> None:
        reported.append(each)
        release.wait(TIMEOUT)
        raise ValueError("raised by the user")

    motion = begun(led, feedback=feedback)
    led.until(lambda: reported)
    while not motion.done and (message := led.obey()) is not None and message[1] == FOLLOW:
        pass
    led.finish()
    motion.wait(TIMEOUT)
    release.set()
    assert len(reported) == 1
    assert reported[0].q_desired - reported[0].q_actual == pytest.approx(reported[0].error)
    assert reported[0].time >= 0
    assert reported[0].qd_actual.shape == reported[0].qd_desired.shape == (6,)


def test_end_of_motion_does_not_wait_for_feedback(led: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that ends the motion might be the feedback thread."""
    waits: list[float] = []
    close = Subscription.close

    def watched(subscription: Subscription, timeout: float) -> None:
        waits.append(timeout)
        close(subscription, timeout)

    motion = begun(led, feedback=lambda each: None)
    monkeypatch.setattr(Subscription, "close", watched)
    motion.cancel()
    assert waits == [0, 0]  # the subscription to its states, and the feedback


def test_feedback_runs_from_start_to_end_of_trajectory() -> None:
    reported: list[TrajectoryFeedback] = []
    following = SimpleNamespace(times=lambda time: None, is_over=False, desired=lambda t: ([t] * 6, [2.0] * 6))
    report = _reporter(cast(Following, following), reported.append)

    def seen(time: float) -> RealtimeState:
        return RealtimeState(Firmware(5, 11), time=time, q_actual=[0.125] * 6, qd_actual=[1.0] * 6)

    report(seen(50.0))
    following.times = lambda time: (time - 50.0, 0.5 * (time - 50.0))
    report(seen(49.5))
    assert reported == []
    report(seen(50.0))
    report(seen(50.5))
    following.is_over = True
    report(seen(51.0))
    assert [each.time for each in reported] == [0.0, 0.5]
    assert [each.trajectory_time for each in reported] == [0.0, 0.25]
    last = reported[-1]
    for values, value in (
        (last.q_desired, 0.25),
        (last.qd_desired, 2.0),
        (last.q_actual, 0.125),
        (last.qd_actual, 1.0),
        (last.error, 0.125),
    ):
        assert values.tolist() == [value] * 6


def test_feedback_thread_ends_with_motion(led: Rehearsal) -> None:
    before = set(threading.enumerate())
    motion = led.motion.follow(PATH, feedback=lambda each: None)
    assert len(threading.enumerate()) > len(before) + 1  # the thread of the motion, and the thread of the feedback
    motion.cancel()
    until(lambda: set(threading.enumerate()) <= before)


# -- rejected before anything is sent ------------------------------------------------------------------


def test_impossible_trajectories_are_rejected(led: Rehearsal) -> None:
    far = Trajectory.from_arrays([0, 1], [turned(1), turned(1)])
    wild = Trajectory.from_arrays([0, 0.1], [turned(0), turned(1)])
    for trajectory, message in ((far, "too far from the position of the arm"), (wild, "limit of a UR5e")):
        with pytest.raises(BadValue, match=message):
            led.motion.follow(trajectory)
    for options in ({"goal_tolerance": -1}, {"path_tolerance": 0}, {"watchdog": 0}, {"gain": 1}, {"lookahead_time": 1}):
        with pytest.raises(BadValue):
            led.motion.follow(PATH, **options)  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="is not a Trajectory"):
        led.motion.follow([turned(0)])  # type: ignore[arg-type]
    assert led.sent == []
    assert led.motion.current is None


def test_follow_checks_start_position_when_the_arm_is_at_rest(led: Rehearsal) -> None:
    """The previous motion has ended, but the newest state was sent a little before its end."""
    led.q, led.qd = turned(-0.2), [0.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    led.show()
    motion = led.motion.follow(PATH)
    led.connect()
    message = led.obey()
    assert message is not None
    assert message[1] == WAIT
    led.q, led.qd = turned(0), [0.0] * 6
    while (message := led.obey()) is None or message[1] != FOLLOW:
        assert not motion.done
    motion.cancel()


def test_cb2_does_not_support_low_bandwidth(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal("1.8", "UR5")
    with pytest.raises(LocalError, match=r"firmware 1\.8"):
        robot.motion.follow(PATH, low_bandwidth=True)
    assert robot.sent == []


def test_low_bandwidth_requires_reverse_link(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal(link="rtde")
    with pytest.raises(LocalError, match="needs link='reverse'"):
        robot.motion.follow(PATH, low_bandwidth=True, link="rtde")
    assert robot.sent == []


def test_unknown_arm_model_can_follow(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal(model="UR9000")
    begun(robot).cancel()


# -- ended early ---------------------------------------------------------------------------------------


def test_cancel_half_way_sends_one_stop(led: Rehearsal) -> None:
    motion = begun(led)
    half_way(led, motion)
    motion.cancel()
    motion.cancel()
    assert led.message() == ([0.0] * 6, STOP)
    assert led.message() is None
    for _ in range(5):
        led.tick()
    with pytest.raises(Cancelled):
        motion.wait(TIMEOUT)
    assert motion.phase is Phase.CANCELLED
    assert 0.4 < motion.progress < 0.6
    assert len(led.sent) == 1


def test_leaving_block_cancels_motion(led: Rehearsal) -> None:
    with begun(led) as motion:
        assert not motion.done
    assert motion.phase is Phase.CANCELLED


@pytest.mark.parametrize("low_bandwidth", [False, True])
def test_safety_stop_ends_motion_without_message(robot: Rehearsal, low_bandwidth: bool) -> None:
    motion = robot.motion.follow(PATH, low_bandwidth=low_bandwidth)
    robot.connect()
    if low_bandwidth:
        robot.ask(0)
    else:
        robot.obey()
    robot.state(safety=SafetyMode.ROBOT_EMERGENCY_STOP)
    with pytest.raises(SafetyStop, match="emergency stop"):
        motion.wait(TIMEOUT)
    while (message := robot.message()) is not None:
        assert message[1] != STOP
    assert len(robot.sent) == 1
    with pytest.raises(SafetyStop):
        robot.motion.stop()
    assert len(robot.sent) == 1


def test_motion_can_start_after_safety_stop(led: Rehearsal) -> None:
    motion = begun(led)
    led.state(safety=SafetyMode.PROTECTIVE_STOP)
    with pytest.raises(SafetyStop):
        motion.wait(TIMEOUT)
    led.q = turned(0)
    led.until(lambda: led.safety.is_enabled)
    led.show()
    begun(led).cancel()


def test_cut_link_without_reason_raises_connection_lost(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.motion.servo.linked_program._GRACE", 0.05)
    motion = begun(robot)
    assert robot.link is not None
    robot.link.close()
    robot.until(lambda: motion.done)
    with pytest.raises(ConnectionLost, match="brakes on its own"):
        motion.wait(0)


@pytest.mark.parametrize("message", ["urlink: the link ended", "urlink: nothing to go to"])
def test_end_of_link_reported_by_program_raises_connection_lost(led: Rehearsal, message: str) -> None:
    motion = begun(led)
    led.text(message)
    with pytest.raises(ConnectionLost, match="brakes on its own"):
        motion.wait(TIMEOUT)


def test_stop_at_pendant_raises_program_stopped(led: Rehearsal) -> None:
    motion = begun(led)
    led.vanish()
    led.until(lambda: motion.done)
    with pytest.raises(ProgramStopped):
        motion.wait(TIMEOUT)


def test_early_program_end_raises_program_stopped(led: Rehearsal) -> None:
    motion = begun(led)
    led.finish()
    with pytest.raises(ProgramStopped, match="the program of follow ended unexpectedly"):
        motion.wait(TIMEOUT)


def test_lost_states_raise_not_running(led: Rehearsal) -> None:
    motion = begun(led)
    led.fast.put(ConnectionLost("pulled"))
    with pytest.raises(NotRunning, match=r"pulled; its program on the robot brakes on its own"):
        motion.wait(TIMEOUT)
    assert led.message() is None


def test_leaving_path_raises_tolerance_exceeded(led: Rehearsal) -> None:
    motion = begun(led, path_tolerance=0.05)
    led.tick(away=0.07)
    with pytest.raises(ToleranceExceeded, match=r"wrist 3 \(joint 5\) is 0\.0[67]\d+ rad .* tolerance is 0\.05 rad"):
        motion.wait(TIMEOUT)
    while (message := led.message()) is not None:
        last = message
    assert last[1] == STOP


def test_arm_that_misses_the_goal_raises_tolerance_exceeded(led: Rehearsal) -> None:
    motion = begun(led, goal_time=0.1)
    while not motion.done:
        led.tick(away=0.02)
        if (message := led.message()) is None:
            break
        if message[1] == FOLLOW:
            led.q = message[0]
    with pytest.raises(ToleranceExceeded, match=r"0\.1 s after the end of its path; the tolerance is 0\.01"):
        motion.wait(TIMEOUT)


# -- the program does not connect ------------------------------------------------------------------------


def test_failed_connection_of_program_raises_connect_failed(robot: Rehearsal) -> None:
    motion = robot.motion.follow(PATH)
    robot.begin()
    robot.text("urlink: cannot connect")
    with pytest.raises(ConnectFailed, match=rf"127\.0\.0\.1:{robot.port}.*reverse_host.*firewall.*reverse_port"):
        motion.wait(TIMEOUT)


def test_missing_connection_raises_connect_failed(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.motion.servo.linked_program.CONNECT_TIMEOUT", 0.05)
    motion = robot.motion.follow(PATH)
    port = robot.port
    robot.until(lambda: motion.done)
    with pytest.raises(ConnectFailed, match=rf"127\.0\.0\.1:{port}: it did not connect within 0\.05 s"):
        motion.wait(0)
    until(lambda: len(robot.sent) == 2)  # the stop follows the end
    assert "stopj" in robot.sent[1]


def test_occupied_port_raises_bad_address(rehearsal: Callable[..., Rehearsal], robot: Rehearsal) -> None:
    robot.motion.follow(PATH)
    other = rehearsal(port=robot.port)
    with pytest.raises(BadAddress, match=str(robot.port)):
        other.motion.follow(PATH)
    assert other.sent == []
    assert other.motion.current is None


@platforms.needs_reusable_ports
def test_fixed_port_serves_consecutive_motions(rehearsal: Callable[..., Rehearsal], own_port: int) -> None:
    fixed = rehearsal(port=own_port)
    waiting = fixed.motion.follow(PATH)
    connected = begun(fixed)
    with pytest.raises(Cancelled, match="preempted by follow"):
        waiting.wait(TIMEOUT)
    fixed.show()  # a motion starts from a state that arrived after the previous motion ended
    after = begun(fixed)
    assert fixed.port == own_port
    with pytest.raises(Cancelled, match="preempted by follow"):
        connected.wait(TIMEOUT)
    after.cancel()


@platforms.needs_reusable_ports
def test_refused_motion_keeps_port_of_current_motion(rehearsal: Callable[..., Rehearsal], own_port: int) -> None:
    fixed = rehearsal(port=own_port)
    waiting = fixed.motion.follow(PATH)
    fixed.safety.policy = "always"
    with pytest.raises(NotEnabled):
        fixed.motion.follow(PATH)
    fixed.safety.enable()
    fixed.connect()
    while not (message := fixed.obey()) or message[1] != FOLLOW:
        assert message is not None
    until(lambda: waiting.phase is Phase.RUNNING)  # its event arrives on another connection than the set-points
    waiting.cancel()


def test_late_program_cannot_connect_after_failure(robot: Rehearsal) -> None:
    motion = robot.motion.follow(PATH)
    port = robot.port
    robot.fast.put(ConnectionLost("pulled"))
    with pytest.raises(NotRunning, match="it moves nothing if it begins later"):
        motion.wait(TIMEOUT)
    robot.begin()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), TIMEOUT)


def test_other_client_does_not_receive_set_points(robot: Rehearsal) -> None:
    motion = robot.motion.follow(PATH)
    with socket.create_connection(("127.0.0.1", robot.port), TIMEOUT) as stranger:
        stranger.sendall(b"0\n\n\n")
        robot.connect()
        while not (message := robot.obey()) or message[1] != FOLLOW:
            assert message is not None
        until(lambda: motion.phase is Phase.RUNNING)
        stranger.settimeout(TIMEOUT)
        with contextlib.suppress(ConnectionError):
            assert stranger.recv(100) == b""
    motion.cancel()


# -- low bandwidth: point by point -----------------------------------------------------------------------


@pytest.mark.parametrize("is_quintic", [False, True])
@pytest.mark.parametrize("firmware", ["3.4", "5.11"])
def test_low_bandwidth_sends_every_point(rehearsal: Callable[..., Rehearsal], firmware: str, is_quintic: bool) -> None:
    robot = rehearsal(firmware, "UR5e" if firmware[0] == "5" else "UR5")
    path = PATH
    if is_quintic:
        path = Trajectory.from_arrays(PATH.time, PATH.q, PATH.qd, np.arange(18).reshape(3, 6) / 100)
    motion = robot.motion.follow(path, low_bandwidth=True)
    robot.connect()
    assert robot.ask(-1) == [1.0]
    for n in range(3):
        answer = robot.ask(n)
        assert len(answer) == (20 if is_quintic else 14)
        assert answer[0] == n
        assert answer[1:7] == pytest.approx(path.q[n], abs=1e-9)
        assert answer[7:13] == pytest.approx(path.qd[n], abs=1e-9)
        if path.qdd is not None:
            assert answer[13:19] == pytest.approx(path.qdd[n], abs=1e-9)
        assert answer[-1] == pytest.approx(0.2 if n else 0.0)
    assert robot.ask(3)[0] == -1
    assert robot.link is not None
    robot.link.sendall(b"-2\n")
    robot.until(lambda: motion.progress >= 1.0)
    robot.finish()
    robot.until(lambda: motion.done)
    motion.wait(0)


def test_low_bandwidth_starts_at_position_of_arm(robot: Rehearsal) -> None:
    robot.q = turned(0.02)
    robot.show()
    motion = robot.motion.follow(PATH, low_bandwidth=True)
    robot.connect()
    assert robot.ask(0)[6] == pytest.approx(0.02)
    motion.cancel()
    until(lambda: len(robot.sent) == 2)
    assert "stopj" in robot.sent[-1]


def test_follow_raises_program_stopped_after_an_invalid_request(robot: Rehearsal) -> None:
    motion = robot.motion.follow(PATH, low_bandwidth=True)
    robot.connect()
    assert robot.link is not None
    robot.link.sendall(b"hello\n")
    robot.until(lambda: motion.done)
    with pytest.raises(ProgramStopped, match="expected a number"):
        motion.wait(0)


def test_silent_program_raises_connection_lost(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.motion.servo.waypoints._SILENCE", 0.05)
    monkeypatch.setattr("urlink.motion.servo.linked_program._GRACE", 0.05)
    motion = robot.motion.follow(PATH, low_bandwidth=True)
    robot.connect()
    for n in range(3):
        robot.ask(n)
    robot.until(lambda: motion.done)
    with pytest.raises(ConnectionLost, match="sent nothing"):
        motion.wait(0)


def test_far_first_point_raises_tolerance_exceeded(robot: Rehearsal) -> None:
    motion = robot.motion.follow(PATH, low_bandwidth=True)
    robot.begin()
    robot.text("urlink: the first point is too far away")
    with pytest.raises(ToleranceExceeded):
        motion.wait(TIMEOUT)


@pytest.mark.slow
@pytest.mark.property
@settings(max_examples=25)
@given(st.binary(max_size=60))
def test_random_bytes_end_motion_with_library_error(said: bytes) -> None:
    """Send any input over the link: the motion must not hang or raise an error from outside the library."""
    with Rehearsal() as robot:
        motion = robot.motion.follow(PATH, low_bandwidth=True)
        robot.connect()
        assert robot.link is not None
        robot.link.sendall(said)
        robot.link.shutdown(socket.SHUT_WR)
        robot.text("urlink: the link ended")
        robot.until(lambda: motion.done)
        assert isinstance(motion.error, (ConnectionLost, ProgramStopped))
