"""urx's calls over the library."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tests.waiting import until
from urlink import poses
from urlink.compat import urx
from urlink.simulator import HOME, Controller, Still

pytestmark = pytest.mark.simulated_time

NEAR = [0.1, -1.5, 1.5, -1.5, -1.5, 0.1]


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5", "3.4", motion=Still()) as controller:
        yield controller


def near(values: object, wanted: object, within: float = 1e-3) -> bool:
    return bool(np.allclose(values, wanted, rtol=0, atol=within))  # type: ignore[arg-type]


def test_the_calls(controller: Controller) -> None:
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
def test_moves_along_the_axes_of_the_tool(controller: Controller) -> None:
    turned = [0.3, -1.3, 1.2, -1.1, -1.4, 0.4]  # the tool points down, but for half a radian
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
def test_one_movep_after_the_other_without_waiting(controller: Controller) -> None:
    """As the example of urx goes round a square: each one replaces the one before, on its way."""
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
