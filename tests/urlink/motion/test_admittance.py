"""Admittance: the uploaded program of an arm that yields to measured forces, and `motion.impedance`."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

import urlink
from tests.urlink.motion.test_force_control_programs import LINK
from tests.urlink.motion.test_impedance import READY
from tests.urlink.motion.test_tool_impedance import STIFFNESS, SoftTool, place
from urlink.arm import poses
from urlink.script.springs import ToolSprings, admittance
from urlink.script.wrapping import program
from urlink.simulator import Controller, Plane, Still


class Admittance(SoftTool):
    """Arm without direct torque, with a springy tool."""

    def __init__(
        self, firmware: str = "5.11", *, in_tool: bool = False, stiffness: tuple[float, ...] = STIFFNESS
    ) -> None:
        self.controller = Controller("UR5e", firmware, motion=Still(READY), noise=False)
        self.controller.step()
        self.firmware, self.arm = self.controller.firmware, self.controller.arm
        self.start = self.pose
        self._count = self._number = 0
        self._target = [0.0] * 6
        body = admittance(
            self.firmware,
            LINK,
            stiffness=stiffness,
            damping=[1.0] * 6,
            error=(0.1,) * 3 + (0.5,) * 3,
            tool=ToolSprings(in_tool, (0.25,) * 3 + (0.8,) * 3, (50.0,) * 3 + (5.0,) * 3, (0.0,) * 6),
            watchdog=0.5,
        )
        self.controller.take(program("tried", body, None).text)
        self.go(0.1)


@pytest.mark.slow
@pytest.mark.matrix(3)
@pytest.mark.parametrize(("axis", "in_tool"), [(axis, bool(axis % 2)) for axis in range(6)])
def test_displacement_of_tool_is_force_divided_by_stiffness(axis: int, in_tool: bool) -> None:
    soft = Admittance(in_tool=in_tool)
    start = soft.pose
    axes = poses.rotvec_to_matrix(start[3:]) if in_tool else np.eye(3)
    wrench = np.zeros(6)
    wrench[axis] = 8.0 if axis < 3 else 1.0
    soft.controller.push([*(axes @ wrench[:3]), *(axes @ wrench[3:])])
    soft.go(3.0)
    moved = -soft.off(start)
    moved = np.concatenate((axes.T @ moved[:3], axes.T @ moved[3:]))
    expected = wrench / STIFFNESS
    assert np.abs(moved - expected).max() < 0.05 * expected[axis]


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["5.10", "10.7"])
def test_tool_reaches_target_and_rests_after_end(firmware: str) -> None:
    soft = Admittance(firmware)
    goal = place(soft.pose, 0.1, -0.05, 0.05, 0.0, 0.2, 0.5)
    soft.lead(goal)
    fastest = np.zeros(6)
    for _ in range(1500):
        soft.go()
        fastest = np.maximum(fastest, np.abs(soft.jacobian @ soft.qd))
    assert np.abs(soft.off(goal)).max() < 5e-3
    assert fastest.max() < 0.8
    soft.end(0.5)
    assert not soft.is_running
    rests = soft.q
    soft.controller.push([0, 0, 30.0, 0, 0, 0])
    soft.silent(0.2)
    assert soft.q.tolist() == rests.tolist()


@pytest.mark.parametrize("stiffness", [2e4, *(pytest.param(each, marks=pytest.mark.slow) for each in (5e3, 1e5))])
def test_tool_rests_on_surface_and_ends_without_jump(stiffness: float) -> None:
    soft = Admittance(stiffness=(1000.0,) * 3 + (50.0,) * 3)
    x, y, z = soft.pose[:3]
    soft.controller.world.add(Plane((x, y, z), stiffness=stiffness))
    goal = soft.pose
    goal[2] -= 0.02
    soft.lead(goal, 2.0)
    forces = []
    for _ in range(100):
        soft.go()
        forces.append(soft.arm.wrench[2])
    expected = 20.0 / (1.0 + 1000.0 / stiffness)
    assert np.mean(forces) == pytest.approx(expected, rel=0.1)
    assert np.ptp(forces) < 0.05 * expected
    height = soft.pose[2]
    soft.end(0.002)
    for _ in range(300):
        soft.silent(0.002)
        forces.append(soft.arm.wrench[2])
    assert not soft.is_running
    assert max(forces) < 1.1 * expected
    assert soft.pose[2] - height < expected / stiffness + 0.001
    assert not soft.is_stopped


@pytest.mark.slow
def test_program_ends_without_messages() -> None:
    soft = Admittance()
    soft.lead(place(soft.pose, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 0.2)
    soft.silent(0.4)
    running = [soft.is_running]
    soft.silent(1.0)
    running.append(soft.is_running)
    assert running == [True, False]
    assert not soft.qd.any()


@pytest.mark.simulated_time
@pytest.mark.parametrize(("firmware", "frame"), [("5.25", "base"), ("5.25", "tool"), ("5.11", "base")])
def test_impedance_works_with_and_without_direct_torque(firmware: str, frame: Literal["base", "tool"]) -> None:
    with Controller("UR5e", firmware, motion=Still(READY)) as controller, urlink.connect(controller.address) as robot:
        robot.zero_force_sensor()
        pose = robot.realtime.wait().tool_vector_actual.tolist()
        goal = place(pose, 0.02, 0.0, 0.03, 0.0, 0.0, 0.2)
        with robot.motion.impedance(frame, stiffness=[800, 800, 800, 40, 40, 40]) as soft:
            before = soft.target
            soft.send(goal)
            assert before is None
            assert soft.target is not None
            np.testing.assert_allclose(soft.target, goal)
            if firmware == "5.25":
                assert soft.posture is not None
                there = robot.identity.kinematics.inverse(goal, READY)
                np.testing.assert_allclose(soft.posture, there, atol=1e-6)
                soft.send(goal, posture=READY)
                assert soft.posture.tolist() == list(READY)
            else:
                with pytest.raises(urlink.BadValue, match="posture"):
                    soft.send(goal, posture=READY)
            with pytest.raises(urlink.Unreachable):
                soft.send([2.0, 0, 0, 0, 0, 0])
            np.testing.assert_allclose(soft.target, goal)
            assert soft.stiffness.tolist() == [800, 800, 800, 40, 40, 40]
            damping = soft.damping.tolist()
            soft.set_gains(stiffness=[900, 900, 900, 50, 50, 50])
            assert soft.stiffness.tolist() == [900, 900, 900, 50, 50, 50]
            assert soft.damping.tolist() == damping
            soft.set_gains(damping=0.5)
            assert soft.damping.tolist() == [0.5] * 6
            robot.realtime.wait_until(
                lambda state: np.linalg.norm(np.subtract(state.tool_vector_actual[:3], goal[:3])) < 0.004, timeout=20.0
            )
            assert soft.error is None
        assert soft.done


@pytest.mark.simulated_time
def test_posture_of_pose_respects_tcp() -> None:
    tcp = np.array([0.0, 0.05, 0.1, 0.0, 0.0, 0.3])
    with Controller("UR5e", "5.25", motion=Still(READY)) as controller, urlink.connect(controller.address) as robot:
        robot.set_tcp(tcp.tolist())
        robot.realtime.wait_until(lambda state: abs(state.tool_vector_actual[2] - 0.1) > 1e-6, timeout=5.0)
        pose = robot.realtime.wait().tool_vector_actual.tolist()
        with robot.motion.impedance("base") as soft:
            assert soft.stiffness.tolist() == [500] * 3 + [30] * 3
            soft.send(pose)
            assert soft.posture is not None
            np.testing.assert_allclose(soft.posture, READY, atol=1e-4)


@pytest.mark.simulated_time
def test_unknown_arm_has_no_default_stiffness(monkeypatch: pytest.MonkeyPatch) -> None:
    with Controller("UR20", "5.25") as controller, urlink.connect(controller.address) as robot:
        with pytest.raises(urlink.BadValue, match="stiffness has no default for a UR20"):
            robot.motion.impedance()
        monkeypatch.setattr(type(robot.identity), "arm", property(lambda self: None))
        with pytest.raises(urlink.LocalError, match="does not report the model of the arm"):
            robot.motion.impedance()


@pytest.mark.simulated_time
def test_impedance_rejects_unsupported_options() -> None:
    for firmware, frame, what in (
        ("5.11", "joints", "springs of the joints"),
        ("5.9", "base", "5.10 or later"),
        ("3.15", "tool", "5.10 or later"),
    ):
        name = "UR5" if firmware == "3.15" else "UR5e"
        with (
            Controller(name, firmware) as controller,
            urlink.connect(controller.address) as robot,
            pytest.raises(urlink.LocalError, match=what),
        ):
            robot.motion.impedance(frame)  # type: ignore[arg-type]
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        for given in ({"torque": 10.0}, {"posture_stiffness": 1.0}):
            with pytest.raises(urlink.BadValue, match="no effect"):
                robot.motion.impedance("base", **given)  # type: ignore[arg-type]
    with Controller("UR5e", "5.25") as controller, urlink.connect(controller.address) as robot:
        for given in ({"force": 10.0}, {"posture_stiffness": 1.0}):
            with pytest.raises(urlink.BadValue, match="springs of the tool"):
                robot.motion.impedance(**given)  # type: ignore[arg-type]
