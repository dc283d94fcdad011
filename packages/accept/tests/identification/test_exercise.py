"""The motion to record: its path, speed and stops, and identification of planted parameters from its recording."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue, Cancelled
from packages.accept.tests.identification.planted import planted
from tests.urlink.arm.arms import calibrated
from urlink.arm.arm_file import read_arm_file
from urlink.arm.kinematics import Arm, DhTable
from urlink.arm.models import MODELS
from urlink.cli import main
from urlink.simulator import Controller, Still
from urlink_accept.identification.exercise import BESIDE, SWING, Guard, exercise, input_is_on, plan, plan_from_here

START = np.array([0.2, -1.4, 1.6, -1.7, -1.5, 0.3])
TCP = np.array([0.02, 0.0, 0.15, 0.0, 0.0, 0.0])


@pytest.mark.slow
@pytest.mark.simulated_time
def test_commands_recover_planted_parameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The whole procedure, with the commands, over the real-time interface of a CB3."""
    arm = calibrated("UR5", 4).table
    table = DhTable(*(np.asarray(column).tolist() for column in (arm.dh_theta, arm.dh_a, arm.dh_d, arm.dh_alpha)))
    truth = dataclasses.replace(planted(), model="UR5", calibration=table)
    truth.write(tmp_path / "arm.json")
    address, run, out = f"sim://ur5?like={tmp_path / 'arm.json'}", tmp_path / "run.urlog", tmp_path / "found.json"
    assert main(["exercise", address, "--out", str(run)]) == 0
    shown = capsys.readouterr()
    assert "UR5: 40 movements" in shown.out
    assert " of 40: " in shown.err
    assert main(["identify", str(run), "--out", str(out)]) == 0
    found = read_arm_file(out)
    for name, each in truth.estimates.items():
        for estimate, true in zip(found.estimates[name], each, strict=True):
            # The slow part of the current's error has few independent values in a recording.
            share = 0.1 if name == "current_noise" else 0.05
            assert estimate.value == pytest.approx(true.value, rel=share), (name, estimate)
    assert found.estimates["calibration"][0].value < 1e-7
    assert min(found.torque_r2) > 0.999
    assert min(found.current_r2) > 0.99


@pytest.mark.parametrize("name", list(MODELS))
def test_plan_is_slow_stays_in_box_and_returns_to_start(name: str) -> None:
    arm = Arm(name)
    planned = plan(arm, START, TCP)
    at, speeds, moved = START, [], np.zeros(6)
    for leg in planned.legs:
        way = leg.goal - at
        part = np.random.default_rng(1).uniform(0.0, 1.0, 9)[:, np.newaxis]
        tip = arm.forward(at + part * way, TCP)[:, :3]
        assert (tip > planned.low - 1e-3).all()
        assert (tip < planned.high + 1e-3).all()
        qd = way / np.abs(way).max() * leg.speed
        speeds.append(max(float(np.linalg.norm((arm.jacobian(q, TCP) @ qd)[:3])) for q in at + part * way))
        assert np.abs(leg.goal - START).max() <= SWING + 1e-12
        moved = np.maximum(moved, np.abs(leg.goal - START))
        at = leg.goal
    assert (at == START).all()
    assert moved == pytest.approx([SWING] * 6)
    assert max(speeds) < 0.26
    assert planned.seconds < 180.0


def test_plan_rejects_positions_beyond_joint_limits() -> None:
    start = START.copy()
    start[1] = 6.2
    with pytest.raises(BadValue, match=r"q\[1\] \(shoulder\)"):
        plan(Arm("UR5e"), start, TCP)


@pytest.mark.simulated_time
def test_exercise_requires_planned_position_and_held_switch() -> None:
    with Controller("UR5", "3.15", motion=Still(START.tolist())) as controller:
        with urlink.connect(controller.address) as robot:
            planned = plan_from_here(robot)
            elsewhere = dataclasses.replace(planned, start=planned.start + 0.01)
            with pytest.raises(Cancelled, match="is not at the position"):
                exercise(robot, elsewhere, Guard(robot, SWING + BESIDE))
            with pytest.raises(Cancelled, match="not held"):
                exercise(robot, planned, Guard(robot, SWING + BESIDE, input_is_on(2)))
        assert (np.array(controller.arm.sample.q_target) == START).all()


@pytest.mark.simulated_time
def test_releasing_switch_stops_exercise() -> None:
    with Controller("UR5", "3.15", motion=Still(START.tolist())) as controller:
        controller.signals.digital_inputs = 1 << 2
        with urlink.connect(controller.address) as robot:
            planned = plan_from_here(robot)
            guard = Guard(robot, SWING + BESIDE, input_is_on(2))

            def let_go(number: int) -> None:
                if number == 1:
                    controller.signals.digital_inputs = 0

            with pytest.raises(Cancelled):
                exercise(robot, planned, guard, let_go)
            robot.realtime.wait_until(lambda state: not state.qd_target.any(), 2.0)
            assert guard.tripped == "the dead-man switch was released"
            assert controller.arm.sample.q_target[0] > START[0]


@pytest.mark.simulated_time
def test_joint_outside_box_stops_exercise() -> None:
    controller = Controller("UR5", "3.15", motion=Still(START.tolist()))
    with controller, urlink.connect(controller.address) as robot:
        guard = Guard(robot, 0.1)
        with pytest.raises(Cancelled):
            exercise(robot, plan_from_here(robot), guard)
        robot.realtime.wait_until(lambda state: not state.qd_target.any(), 2.0)
        assert "degrees away from its start" in guard.tripped
        assert controller.arm.sample.q_target[0] < START[0] + 0.2


@pytest.mark.simulated_time
def test_exercise_command_needs_confirmation_of_free_box(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Controller("UR5", "3.15", motion=Still(START.tolist())) as controller:
        # Not os.devnull, which is a terminal on Windows.
        (tmp_path / "nothing").touch()
        with (tmp_path / "nothing").open() as nothing:
            monkeypatch.setattr(sys, "stdin", nothing)
            assert main(["exercise", controller.address, "--out", str(tmp_path / "run.urlog")]) == 1
        assert "confirm it with --yes" in capsys.readouterr().err
        assert (np.array(controller.arm.sample.q_target) == START).all()
    assert not (tmp_path / "run.urlog").exists()


def test_exercise_command_rejects_large_swing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["exercise", "sim://", "--swing", "90"]) == 2
    assert "expected 6 to 45" in capsys.readouterr().err


@pytest.mark.simulated_time
def test_motion_started_during_stop_is_stopped() -> None:
    with Controller("UR5", "3.15", motion=Still(START.tolist())) as controller:
        controller.signals.digital_inputs = 1 << 2
        with urlink.connect(controller.address) as robot:
            guard = Guard(robot, SWING + BESIDE, input_is_on(2))
            with robot.realtime.subscribe(guard):
                controller.signals.digital_inputs = 0
                robot.realtime.wait_until(lambda _: bool(guard.tripped), 2.0)
                with pytest.raises(Cancelled):
                    robot.motion.move_joints(START + SWING, speed=0.1).wait(10.0)
            robot.realtime.wait_until(lambda state: not state.qd_target.any(), 2.0)
            assert np.abs(controller.arm.sample.q_target - START).max() < 0.1 * SWING


@pytest.mark.simulated_time
@pytest.mark.parametrize("slider", [1.0, 0.0], ids=["moving", "at rest at slider 0"])
def test_guard_refuses_while_other_program_runs(slider: float) -> None:
    controller = Controller("UR5", "3.15", motion=Still(START.tolist()))
    with controller, urlink.connect(controller.address) as other, urlink.connect(controller.address) as robot:
        motion = other.motion.move_joints(START + SWING, speed=0.02)
        robot.realtime.wait_until(lambda state: bool(state.qd_target.any()), 2.0)
        controller.speed_fraction = slider
        with pytest.raises(Cancelled, match="a program is running or paused"):
            Guard(robot, SWING + BESIDE)
        controller.speed_fraction = 1.0
        motion.wait(60.0)
        assert Guard(robot, SWING + BESIDE).start == pytest.approx(START + SWING)
