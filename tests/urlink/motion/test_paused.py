"""Motions whose program is paused, by a button or a safeguard stop; the arm might be moved meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue
from linkcore.handle import Motion, Phase
from tests.urlink.motion.bench import Bench
from tests.urlink.motion.test_scaled import NEAR, READY, WAYS, Cell, curve, followed, moving
from tests.waiting import until
from urlink.arm.models import model
from urlink.arm.vectors import FloatArray
from urlink.errors import ProgramStopped, SafetyStop, ToleranceExceeded
from urlink.motion.moves.speed_limit import largest_speeds
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.servo.setpoints import Servoing
from urlink.protocol.enums import ProgramState
from urlink.protocol.firmware import Firmware
from urlink.protocol.primary.robot_state import RobotModeData
from urlink.script.links import ReverseSocket
from urlink.script.messages import dated, setpoint

pytestmark = pytest.mark.simulated_time

TIMEOUT = 120.0
REST = 1e-4


@pytest.fixture
def cell() -> Iterator[Callable[[str, str], Cell]]:
    made: list[Cell] = []

    def make(arm: str = "UR5e", firmware: str = "5.11") -> Cell:
        made.append(Cell(arm, firmware))
        return made[-1]

    yield make
    for each in made:
        each.close()


def pressed(cell: Cell, button: Callable[[], bool]) -> None:
    """Press a button of the pendant; it must succeed."""
    results: list[bool] = []
    cell.controller.call(lambda: results.append(button()))
    assert results == [True]


def comes_to_rest(cell: Cell) -> FloatArray:
    time.sleep(0.1)  # the arm might not have started yet
    until(lambda: not cell.controller.arm.is_moving, TIMEOUT)
    time.sleep(0.1)
    return np.array(cell.controller.arm.setpoint.q)


@pytest.mark.slow
@pytest.mark.matrix(3)
@pytest.mark.parametrize("way", WAYS)
def test_motion_resumes_smoothly_after_pause(cell: Callable[[str, str], Cell], way: str) -> None:
    """The arm was at full speed and stopped beyond the last set-point; it does not move back."""
    arm, firmware, options = WAYS[way]
    one = cell(arm, firmware)
    _, told, _ = followed(one, **options)
    usual = max(float(np.abs(each.error).max()) for each in told)
    one.path.clear()
    motion = one.robot.motion.follow(curve(), goal_time=0.5, path_tolerance=3.0 * usual, **options)
    for after in (0.9, 0.4):
        time.sleep(after)
        pressed(one, one.controller.pendant.pause)
        here = comes_to_rest(one)
        time.sleep(5.0)
        count = len(one.path)
        pressed(one, one.controller.pendant.play)
        time.sleep(0.2)
        assert not motion.done
        way_on = np.array(one.path[count:]) - here
        along = way_on @ (way_on[-1] / np.linalg.norm(way_on[-1]))
        assert along.min() > -REST
        assert np.linalg.norm(way_on[-1]) > 0.002
    motion.wait(TIMEOUT)
    assert motion.phase is Phase.DONE
    rate = one.controller.firmware.rate
    assert np.abs(np.diff(moving(one.path), 2, axis=0)).max() * rate**2 < 40.0
    assert one.robot.realtime.wait().q_target == pytest.approx(READY, abs=NEAR)


def moved_after(cell: Cell, act: Callable[[], object], seconds: float = 1.5) -> float:
    """Call `act` and return the largest distance that any joint moves afterwards, in rad."""
    cell.path.clear()
    here = np.array(cell.controller.arm.setpoint.q)
    act()
    time.sleep(seconds)
    return float(np.abs(np.array(cell.path) - here).max())


@pytest.mark.slow
@pytest.mark.matrix(3)
@pytest.mark.parametrize("way", WAYS)
def test_arm_jogged_away_in_pause_is_not_moved_back(cell: Callable[[str, str], Cell], way: str) -> None:
    """The program resumes and set-points from before the pause are queued, but the arm does not move back."""
    arm, firmware, options = WAYS[way]
    one = cell(arm, firmware)
    pendant = one.controller.pendant
    motion = one.robot.motion.follow(curve(), **options)
    time.sleep(1.0)
    pressed(one, pendant.pause)
    here = comes_to_rest(one)
    pressed(one, lambda: pendant.jog([*here[:5], here[5] + 0.3]))
    time.sleep(0.2)
    assert one.controller.modes.program_state is ProgramState.PAUSED
    assert comes_to_rest(one) == pytest.approx([*here[:5], here[5] + 0.3], abs=1e-6)
    assert not motion.done
    assert moved_after(one, lambda: pressed(one, pendant.play)) < REST
    with pytest.raises(ToleranceExceeded, match=r"wrist 3 \(joint 5\) was moved by 0\.3000 rad while .* 0\.05 rad"):
        motion.wait(TIMEOUT)
    until(lambda: not one.controller.is_running_program, TIMEOUT)


@pytest.mark.slow
@pytest.mark.matrix(5)
@pytest.mark.parametrize("firmware", ["3.2", "3.15", "5.11", "10.12"])
@pytest.mark.parametrize("how", ["move_joints", "move_linear", "path"])
def test_controller_motion_ends_if_arm_is_jogged_away(
    cell: Callable[[str, str], Cell], how: str, firmware: str
) -> None:
    """If it resumed, the controller would move the arm back onto its path."""
    one = cell("UR5e" if Firmware.parse(firmware).is_e_series else "UR5", firmware)
    pendant, motions = one.controller.pendant, one.robot.motion
    goal = [*READY[:4], READY[4] + 0.2, 1.0]
    pose = one.robot.kinematics.forward(np.array(goal))
    ways: dict[str, Callable[[], Motion]] = {
        "move_joints": lambda: motions.move_joints(goal, 0.5),
        "move_linear": lambda: motions.move_linear(pose, 0.05),
        "path": lambda: motions.path([urlink.Joint(goal), urlink.Joint(READY)], joint_speed=0.5),
    }
    motion = ways[how]()
    time.sleep(1.0)
    pressed(one, pendant.pause)
    here = comes_to_rest(one)
    assert not motion.done
    pressed(one, lambda: pendant.jog([*here[:5], here[5] - 0.3]))
    with pytest.raises(ToleranceExceeded, match=r"wrist 3 \(joint 5\) was moved by .* at most 0\.05 rad"):
        motion.wait(TIMEOUT)
    until(lambda: not one.controller.is_running_program, TIMEOUT)
    assert moved_after(one, lambda: one.controller.call(pendant.play)) < REST


def test_states_arrive_while_the_stop_cannot_be_sent(
    cell: Callable[[str, str], Cell], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = cell("UR5", "3.15")
    pendant, robot = one.controller.pendant, one.robot
    motion = robot.motion.move_joints([*READY[:5], 1.0], 0.5)
    time.sleep(1.0)
    pressed(one, pendant.pause)
    here = comes_to_rest(one)
    # The transport of the program texts accepts nothing, as if the controller did not read.
    transport = robot.primary._connection
    monkeypatch.setattr(transport, "send_some", lambda data: 0)
    monkeypatch.setattr(transport, "wait_for_room", time.sleep)
    arrivals: list[float] = []
    robot.realtime.subscribe(lambda state: arrivals.append(time.monotonic()), inline=True)
    pressed(one, lambda: pendant.jog([*here[:5], here[5] - 0.3]))
    with pytest.raises(ToleranceExceeded):
        motion.wait(TIMEOUT)
    assert np.diff(arrivals).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("how", ["move_joints", "path"])
def test_controller_motion_resumes_after_pause(cell: Callable[[str, str], Cell], how: str) -> None:
    one = cell("UR5e", "5.11")
    pendant, motions = one.controller.pendant, one.robot.motion
    goal = [*READY[:5], 1.0]
    motion = (
        motions.move_joints(goal, 0.5) if how == "move_joints" else motions.path([urlink.Joint(goal)], joint_speed=0.5)
    )
    time.sleep(1.0)
    pressed(one, pendant.pause)
    comes_to_rest(one)
    pressed(one, pendant.play)
    motion.wait(TIMEOUT)
    assert one.robot.realtime.wait().q_target == pytest.approx(goal, abs=NEAR)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["streamed at 500 Hz", "points at 500 Hz"])
def test_arm_moved_a_little_resumes_from_new_position(cell: Callable[[str, str], Cell], way: str) -> None:
    """Move the arm by hand, in freedrive, within `start_tolerance`."""
    one = cell(*WAYS[way][:2])
    pendant = one.controller.pendant
    motion = one.robot.motion.follow(curve(), start_tolerance=0.2, **WAYS[way][2])
    time.sleep(1.0)
    pressed(one, pendant.pause)
    here = comes_to_rest(one)
    pressed(one, pendant.freedrive)
    one.controller.push([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
    until(lambda: bool(np.abs(np.array(one.controller.arm.setpoint.q) - here).max() > 0.03), TIMEOUT)
    one.controller.push([0.0] * 6)
    time.sleep(1.0)
    pressed(one, lambda: pendant.freedrive(False))
    there = comes_to_rest(one)
    assert 0.03 < np.abs(there - here).max() < 0.2
    one.path.clear()
    pressed(one, pendant.play)
    motion.wait(TIMEOUT)
    way_on = np.array(one.path)
    assert np.abs(way_on[:20] - there).max() < 0.005
    assert np.abs(np.diff(way_on, 2, axis=0)).max() * 500.0**2 < 40.0
    assert one.robot.realtime.wait().q_target == pytest.approx(READY, abs=NEAR)


@pytest.mark.matrix(5)
@pytest.mark.parametrize("way", WAYS)
def test_motion_cancelled_in_pause_does_not_resume(cell: Callable[[str, str], Cell], way: str) -> None:
    """A paused program reads nothing, and would move before it reads that it must end."""
    arm, firmware, options = WAYS[way]
    one = cell(arm, firmware)
    motion = one.robot.motion.follow(curve(), **options)
    time.sleep(1.0)
    pressed(one, one.controller.pendant.pause)
    comes_to_rest(one)
    motion.cancel()
    until(lambda: not one.controller.is_running_program, TIMEOUT)
    assert moved_after(one, lambda: one.controller.call(one.controller.pendant.play)) < REST


def test_loop_left_in_pause_does_not_resume(cell: Callable[[str, str], Cell]) -> None:
    one = cell("UR5e", "5.11")
    with one.robot.motion.servo() as servo:
        for part in np.linspace(0.0, 0.1, 200):
            servo.send(np.array(READY) + part)
            one.robot.realtime.wait(TIMEOUT)
        pressed(one, one.controller.pendant.pause)
        comes_to_rest(one)
    until(lambda: not one.controller.is_running_program, TIMEOUT)
    assert moved_after(one, lambda: one.controller.call(one.controller.pendant.play)) < REST


@pytest.mark.slow
@pytest.mark.matrix(5)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("resumes", [True, False])
def test_safeguard_stop_ends_motion_for_good(cell: Callable[[str, str], Cell], way: str, resumes: bool) -> None:
    """This holds even if the controller resumes the program automatically."""
    arm, firmware, options = WAYS[way]
    one = cell(arm, firmware)
    motion = one.robot.motion.follow(curve(), **options)
    time.sleep(1.0)
    one.controller.faults.safeguard_stop(resumes=resumes)
    with pytest.raises(SafetyStop, match="safeguard stop"):
        motion.wait(TIMEOUT)
    comes_to_rest(one)
    assert moved_after(one, one.controller.faults.clear) < REST
    # The robot stops the rest of the program as early as possible, so there is nothing to play.
    until(lambda: not one.controller.is_running_program, TIMEOUT)
    one.robot.motion.move_joints(READY).wait(TIMEOUT)


def test_close_during_stop_logs_paused_program(
    cell: Callable[[str, str], Cell], caplog: pytest.LogCaptureFixture
) -> None:
    one = cell("UR5e", "5.11")
    motion = one.robot.motion.move_joints(np.array(READY) + 0.3, speed=0.1)
    until(lambda: one.controller.is_running_program, TIMEOUT)
    one.controller.faults.safeguard_stop()
    with pytest.raises(SafetyStop, match="safeguard stop"):
        motion.wait(TIMEOUT)
    one.robot.primary.of(RobotModeData).wait_until(lambda mode: mode.is_program_paused, TIMEOUT)
    one.robot.close()
    one.robot.close()
    assert caplog.text.count("is paused on the controller and might resume later") == 1


@pytest.mark.parametrize("target_filter", [None, pytest.param("jerk_limited", marks=pytest.mark.slow)])
def test_user_loop_restarts_after_pause(cell: Callable[[str, str], Cell], target_filter: Any) -> None:
    one = cell("UR5e", "5.11")
    pendant = one.controller.pendant
    with one.robot.motion.servo(target_filter=target_filter) as servo:
        target = np.array(READY)
        for count, state in enumerate(one.robot.realtime):
            if count == 300:
                pressed(one, pendant.pause)
            if count == 800:
                comes_to_rest(one)
                count_before = len(one.path)
                pressed(one, pendant.play)
            if state.speed_scaling:
                target[5] += 0.001 if count < 800 else 0.0
            elif target_filter is None:
                target = state.q_target.copy()
            servo.send(target)
            if count > 1500:
                break
    way_on = np.array(one.path[count_before:])[:, 5]
    assert way_on.min() > way_on[0] - REST
    assert np.abs(np.diff(np.array(one.path), 2, axis=0)).max() * 500.0**2 < 60.0


@pytest.mark.slow
def test_set_point_advanced_in_pause_is_rejected(cell: Callable[[str, str], Cell]) -> None:
    one = cell("UR5e", "5.11")
    pendant = one.controller.pendant
    with one.robot.motion.servo() as servo:
        for count in range(800):
            if count == 100:
                pressed(one, pendant.pause)
            servo.send([*READY[:5], 0.0005 * count])
            one.robot.realtime.wait()
        comes_to_rest(one)
        one.path.clear()
        pressed(one, pendant.play)
        time.sleep(0.05)
        with pytest.raises(BadValue, match="from the position of the arm"):
            servo.send([*READY[:5], 0.4])
    assert np.ptp(np.array(one.path)[:, 5]) < REST


# -- problems that users of the vendor's driver report ---------------------------------------------------


@pytest.mark.slow
@pytest.mark.matrix(2)
@pytest.mark.parametrize("way", ["streamed at 500 Hz", "registers at 125 Hz", "points at 500 Hz"])
@pytest.mark.parametrize("how", ["jogged", "freedrive"])
def test_arm_moved_after_pendant_stop_is_not_moved_back(cell: Callable[[str, str], Cell], way: str, how: str) -> None:
    """Universal_Robots_ROS2_Driver#515 and #279: after a stop, the next motion leads to an old target.

    There, the program is stopped, the arm is moved, and the next motion moves it back to the old target. Here, the next
    motion starts where the arm is, or is rejected.
    """
    arm, firmware, options = WAYS[way]
    one = cell(arm, firmware)
    pendant = one.controller.pendant
    motion = one.robot.motion.follow(curve(), **options)
    time.sleep(1.0)
    pressed(one, pendant.stop)
    with pytest.raises(ProgramStopped):
        motion.wait(TIMEOUT)
    here = comes_to_rest(one)
    if how == "jogged":
        pressed(one, lambda: pendant.jog([*here[:5], here[5] + 0.3]))
    else:
        pressed(one, pendant.freedrive)
        one.controller.push([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
        time.sleep(0.5)
        one.controller.push([0.0] * 6)
        time.sleep(0.5)
        pressed(one, lambda: pendant.freedrive(False))
    there = comes_to_rest(one)
    assert np.abs(there - here).max() > 0.1
    for refused in (curve(), Trajectory.from_arrays([0.0, 1.0], np.array([here, READY]))):
        with pytest.raises(BadValue, match="too far from the position of the arm"):
            one.robot.motion.follow(refused, **options)
    assert moved_after(one, lambda: None, 0.5) < REST
    one.path.clear()
    goal = there + 0.05
    one.robot.motion.follow(Trajectory.from_arrays([0.0, 1.0], [there, goal]), **options).wait(TIMEOUT)
    away = np.array(one.path) - there
    assert away.min() > -REST
    assert away.max() < 0.05 + NEAR


@pytest.mark.slow
@pytest.mark.parametrize("way", ["streamed at 500 Hz", "points at 500 Hz"])
def test_play_after_protective_stop_does_not_move_arm(cell: Callable[[str, str], Cell], way: str) -> None:
    """Universal_Robots_ROS2_Driver#1084: after an unlocked protective stop, *play* moves the arm to the old target."""
    arm, firmware, options = WAYS[way]
    one = cell(arm, firmware)
    motion = one.robot.motion.follow(curve(), **options)
    time.sleep(1.0)
    one.controller.faults.protective_stop()
    with pytest.raises(SafetyStop, match="protective stop"):
        motion.wait(TIMEOUT)
    there = comes_to_rest(one)
    assert moved_after(one, one.controller.faults.clear) < REST
    assert moved_after(one, lambda: one.controller.call(one.controller.pendant.play)) < REST
    one.robot.motion.follow(Trajectory.from_arrays([0.0, 1.0], [there, there + 0.05]), **options).wait(TIMEOUT)
    assert one.robot.realtime.wait().q_target == pytest.approx(there + 0.05, abs=NEAR)


@pytest.mark.real_time
@pytest.mark.parametrize("version", ["1.8", "3.15", "5.11"])
def test_program_ignores_old_set_points_after_displacement(version: str) -> None:
    """The program is not notified of the pause. Queued set-points and coasting do not move the arm back."""
    firmware = Firmware.parse(version)
    speeds = largest_speeds(model("UR5e" if firmware.is_e_series else "UR5"))
    how = Servoing(firmware, speeds, 0.1, 0.03, 300.0)
    bench = Bench(how.body(ReverseSocket("10.0.0.1", 50001, 7)), firmware, READY)
    bench.run(2)
    for _ in range(round(0.5 * firmware.rate)):
        bench.deliver(setpoint([*READY[:5], 0.5 * bench.cycle * bench.period], [0.0] * 5 + [0.5]))
        bench.run()
    stale = setpoint([*READY[:5], 0.25], [0.0] * 5 + [0.5])
    there = [*READY[:5], 0.6]
    bench.motion.start(there)
    for _ in range(5):
        bench.sockets.waiting += dated(stale, bench.cycle)
    bench.run(8)
    assert bench.path[-1] == pytest.approx(there, abs=REST)
    for n in range(round(0.2 * firmware.rate)):
        bench.sockets.waiting += dated(setpoint([*READY[:5], 0.6 + 0.0001 * n], [0.0] * 6), bench.cycle, pauses=1)
        bench.run()
    rows = np.array(bench.path)[-n - 5 :, 5]
    assert rows.min() > 0.6 - REST
    assert rows[-1] > 0.6 + 0.00005 * n
    assert bench.said == []
