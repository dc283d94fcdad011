"""Calls of urx, implemented with urlink."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest

from linkcore.errors import BadValue, LocalError
from tests.waiting import until
from urlink.arm import poses
from urlink.simulator import HOME, Controller, Still
from urlink_compat import urx

pytestmark = pytest.mark.simulated_time

NEAR = [0.1, -1.5, 1.5, -1.5, -1.5, 0.1]


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5", "3.4", motion=Still()) as controller:
        yield controller


def near(values: object, wanted: object, within: float = 1e-3) -> bool:
    return bool(np.allclose(values, wanted, rtol=0, atol=within))  # type: ignore[arg-type]


def test_urx_calls_control_robot(controller: Controller) -> None:
    with urx.Robot(controller.address) as robot:
        assert robot.is_running()
        assert near(robot.movej(NEAR, acc=6.0, vel=2.0), NEAR)
        assert near(robot.getj(), NEAR)
        pose = robot.getl()
        assert near(robot.movel((0.0, 0.02, 0.0, 0.0, 0.0, 0.0), acc=2.0, vel=0.5, relative=True)[1], pose[1] + 0.02)  # type: ignore[index]
        robot.down(0.02, acc=2.0, vel=0.5)
        assert near(robot.getl(wait=True)[2], pose[2] - 0.02)
        assert near(robot.movejs([NEAR, list(HOME)], acc=6.0, vel=2.0, radius=0.005), robot.getl())
        assert near(robot.getj(wait=True), HOME)
        assert robot.movej(NEAR, acc=1.0, vel=0.2, wait=False) is None
        until(lambda: controller.arm.is_moving and robot.is_program_running())
        robot.stopj(6.0)
        assert not controller.arm.is_moving
        robot.speedj([0, 0, 0, 0, 0, 0.2], 4.0, 5.0)
        until(lambda: near(controller.arm.setpoint.qd[5], 0.2))
        robot.stopl(2.0)
        assert not controller.arm.is_moving
        robot.set_digital_out(2, True)
        robot.set_digital_out(9, True)
        assert robot.get_digital_out_bits() == 1 << 2 | 1 << 17
        assert robot.get_digital_out(2)
        controller.signals.set_digital_input(4, True)
        until(lambda: robot.get_digital_in(4))
        robot.set_analog_out(0, 0.5)
        robot.set_tcp((0, 0, 0.1, 0, 0, 0))
        robot.set_payload(1.0)
        until(lambda: controller.arm.payload == 1.0)
        assert len(robot.get_analog_inputs()) == 2
        assert len(robot.get_tcp_force()) == 6
        robot.send_message("hello")
        until(lambda: controller.pendant.popup == "hello")


@pytest.mark.slow
def test_moves_along_tool_axes(controller: Controller) -> None:
    turned = [0.3, -1.3, 1.2, -1.1, -1.4, 0.4]  # the tool points down, except for half a radian
    with urx.Robot(controller.address) as robot:
        robot.movej(turned, acc=6.0, vel=2.0)
        begin = robot.getl(wait=True)
        matrix = poses.to_matrix(begin)
        assert robot.translate_tool((0.01, 0.0, -0.05), acc=2.0, vel=0.5) is not None
        there = matrix[:3, 3] + matrix[:3, :3] @ [0.01, 0.0, -0.05]
        assert near(robot.getl(wait=True), [*there, *begin[3:]])
        robot.translate_tool((-0.01, 0.0, 0.05), acc=2.0, vel=0.5)
        assert near(robot.getl(wait=True), begin)
        robot.back(0.02, acc=2.0, vel=0.5)
        assert near(robot.getl(wait=True)[:3], matrix[:3, 3] - 0.02 * matrix[:3, 2])
        robot.movel_tool([0, 0, 0.02, 0, 0, 0.3], acc=2.0, vel=0.5)
        assert near(poses.compose(begin, [0, 0, 0, 0, 0, 0.3]), robot.getl(wait=True))
        robot.speedl_tool([0.0, 0.0, -0.05, 0.0, 0.0, 0.0], 2.0, 0.4)
        until(lambda: near(controller.arm.sample.speed_target[:3], -0.05 * matrix[:3, 2], 5e-3))
        robot.stopl(2.0)
        assert robot.get_force() == pytest.approx(np.linalg.norm(robot.get_tcp_force(wait=False)), abs=3.0)


@pytest.mark.slow
def test_consecutive_movep_calls_replace_the_running_motion(controller: Controller) -> None:
    """Like urx's example of a square: each motion replaces the previous one before its end."""
    with urx.Robot(controller.address) as robot:
        robot.movej(NEAR, acc=6.0, vel=2.0)
        begin = robot.getl(wait=True)
        pose = list(begin)
        for axis, side in ((2, 0.1), (1, 0.1), (2, -0.1)):
            pose[axis] += side
            assert robot.movep(pose, acc=2.0, vel=0.2, radius=0.05, wait=False) is None
            until(lambda axis=axis: abs(robot.getl(wait=True)[axis] - pose[axis]) < 0.05)  # type: ignore[misc]
        pose[1] -= 0.1
        assert near(robot.movep(pose, acc=2.0, vel=0.2, radius=0, wait=True), begin)


def test_tool_coordinates_can_be_read_and_changed_as_attributes(controller: Controller) -> None:
    with urx.Robot(controller.address, use_rt=True, urFirm=3.4) as robot:
        robot.movej(NEAR, acc=6.0, vel=2.0)
        begin = robot.getl(wait=True)
        assert near([robot.x, robot.y, robot.z], begin[:3])
        robot.z += 0.02
        robot.x -= 0.03
        robot.y += 0.01
        assert near(robot.getl(wait=True), [begin[0] - 0.03, begin[1] + 0.01, begin[2] + 0.02, *begin[3:]])


def test_joint_and_supply_measurements_equal_the_state(controller: Controller) -> None:
    with urx.Robot(controller.address) as robot:
        state = robot._robot.realtime.wait()
        assert near(robot.get_joint_temperature(), state.motor_temperatures, 1.0)
        assert near(robot.get_joint_voltage(wait=True), state.V_actual, 1.0)
        assert near(robot.get_joint_current(), state.I_actual, 1.0)
        assert near(
            [robot.get_main_voltage(), robot.get_robot_voltage(), robot.get_robot_current()],
            [state.V_main, state.V_robot, state.I_robot],
            1.0,
        )


class Transform:
    """The used part of `math3d.Transform`."""

    def __init__(self, pose: list[float]) -> None:
        self.pose_vector = np.array(pose)


def test_poses_are_math3d_transforms(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = ModuleType("math3d")
    fake.Transform = Transform  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "math3d", fake)
    with urx.Robot(controller.address) as robot:
        robot.movej(NEAR, acc=6.0, vel=2.0)
        pose = robot.get_pose(wait=True)
        assert near(pose.pose_vector, robot.getl())
        pose.pose_vector[1] += 0.01
        there = robot.set_pose(pose, acc=2.0, vel=0.5)
        assert near(there.pose_vector, pose.pose_vector)
        pose.pose_vector[1] -= 0.01
        assert robot.set_pose(pose, acc=2.0, vel=0.5, wait=False, command="movep") is None
        until(lambda: near(robot.getl(wait=True), pose.pose_vector))
        with pytest.raises(BadValue, match="command is 'movej'; expected 'movel' or 'movep'"):
            robot.set_pose(pose, command="movej")


def test_error_of_get_pose_says_that_math3d_is_missing(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "math3d", None)
    with urx.Robot(controller.address) as robot, pytest.raises(LocalError, match="math3d is not installed"):
        robot.get_pose()
