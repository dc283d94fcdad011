"""Pushing, pressing and touching: physically correct forces, no chatter, and the reactions of the controller."""

from __future__ import annotations

from pathlib import Path

import pytest

from packages.mujoco.tests.placing import arm_at, forces, settled
from urlink.protocol.enums import SafetyMode
from urlink.simulator import Controller
from urlink_mujoco import MujocoWorld

FRICTION = 0.3 * 2.0 * 9.81


def test_pushed_box_shows_friction_without_chatter(push: Path) -> None:
    controller = arm_at((-0.45, 0.13, 0.05))
    world = MujocoWorld(push, {"left": controller})
    controller.take("def go():\n  movel(p[-0.45,0.23,0.05,3.14159265,0,0],a=1,v=0.03)\nend\n")
    felt = forces(controller, 1500)[900:]
    assert felt[:, 1].mean() == pytest.approx(-FRICTION, rel=0.1)
    assert abs(felt[:, :3].mean(0)[[0, 2]]).max() < 0.1
    assert felt[:, :3].std(0).max() < 0.05
    assert world.pose("box")[1] > 0.25


@pytest.mark.parametrize("wanted", [8.0, 12.0])
def test_force_mode_pushes_box_without_chatter(push: Path, wanted: float) -> None:
    controller = arm_at((-0.45, 0.135, 0.06))
    MujocoWorld(push, {"left": controller})
    controller.take(
        f"def go():\n  force_mode(p[0,0,0,0,0,0],[0,1,0,0,0,0],[0,{wanted},0,0,0,0],2,[.1,.03,.1,.2,.2,.2])\n"
        "  sleep(10)\nend\n"
    )
    felt = forces(controller, 1500)[1100:]
    assert felt[:, 1].mean() == pytest.approx(-FRICTION, rel=0.1)
    assert felt[:, :3].std(0).max() < 0.2


def test_force_mode_presses_on_table_with_wanted_force(push: Path) -> None:
    controller = arm_at((-0.45, -0.2, 0.022))
    MujocoWorld(push, {"left": controller})
    controller.take(
        "def go():\n  force_mode(p[0,0,0,0,0,0],[0,0,1,0,0,0],[0,0,-30,0,0,0],2,[.1,.1,.05,.2,.2,.2])\n"
        "  sleep(10)\nend\n"
    )
    felt = forces(controller, 1000)[600:]
    assert felt[:, 2].mean() == pytest.approx(30.0, rel=0.02)
    assert felt[:, 2].std() < 0.2


def test_tool_driven_into_table_causes_protective_stop(push: Path) -> None:
    controller = arm_at((-0.45, -0.2, 0.03))
    MujocoWorld(push, {"left": controller})
    controller.take("def go():\n  movel(p[-0.45,-0.2,-0.05,3.14159265,0,0],a=1,v=0.1)\nend\n")
    controller.step(500)
    assert controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert controller.arm.setpoint.qd == [0.0] * 6


def test_link_driven_into_post_causes_protective_stop(tmp_path: Path) -> None:
    scene = tmp_path / "post.xml"
    # Next to the forearm, below the elbow, and out of reach of the tool.
    scene.write_text(
        '<mujoco><worldbody><geom type="cylinder" pos="-.15 .1 .3" size=".05 .5" euler="0 0 0"/></worldbody></mujoco>'
    )
    controller = arm_at((-0.47, -0.13, 0.3))
    world = MujocoWorld(scene, controller)
    q = list(controller.arm.setpoint.q)
    q[0] -= 1.2
    controller.take(f"def go():\n  movej({q},a=1,v=0.5)\nend\n")
    touched = 0.0
    for _ in range(1500):
        controller.step()
        touched = max(touched, *map(abs, controller.arm.pushed_joints))
    assert touched > 10.0
    assert controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert max(map(abs, controller.arm.sample.force[:3])) < 1.0
    assert world.arms["arm"].controller is controller


FREEDRIVE = "def go():\n  freedrive_mode()\n  sleep(10)\nend\n"
TORQUE = "def go():\n  while True:\n    direct_torque([0,0,0,0,0,0])\n  end\nend\n"


# Under direct torque, the joints keep the part of their friction that the controller does not compensate.
@pytest.mark.parametrize(("program", "firmware", "way"), [(FREEDRIVE, "5.11", 5e-3), (TORQUE, "5.23", 3e-4)])
def test_free_arm_yields_to_falling_ball(push: Path, program: str, firmware: str, way: float) -> None:
    def after(text: str) -> float:
        controller = arm_at((-0.45, -0.2, 0.3), firmware=firmware)
        world = MujocoWorld(push, {"left": controller})
        controller.take(text)
        controller.step(20)
        world.place("ball", (-0.45, -0.2, 0.62, 0.0, 0.0, 0.0))
        height = controller.arm.sample.pose_target[2]
        controller.step(200)
        return height - controller.arm.sample.pose_target[2]

    assert after(program) > way
    assert after("def go():\n  sleep(10)\nend\n") == 0.0


def test_two_arms_exert_forces_on_each_other_through_a_box(push: Path) -> None:
    left, right = arm_at((-0.45, 0.13, 0.05)), arm_at((-0.45, -0.18, 0.05))
    world = MujocoWorld(push, {"left": left, "right": right})
    settled(world)
    left.take("def go():\n  movel(p[-0.45,0.151,0.05,3.14159265,0,0],a=1,v=0.02)\nend\n")
    for _ in range(900):
        left.step()
        right.step()
    # Each force is in its own base frame; the arms face each other. The table takes at most its friction.
    assert left.arm.sample.force[1] < -FRICTION - 5.0
    assert right.arm.sample.force[1] == pytest.approx(left.arm.sample.force[1], abs=FRICTION + 0.3)


def run(scene: Path) -> tuple[bytes, list[float], Controller]:
    controller = arm_at((-0.45, 0.13, 0.05))
    world = MujocoWorld(scene, {"left": controller})
    controller.take("def go():\n  movel(p[-0.42,0.2,0.05,3.14159265,0,0],a=1,v=0.2)\nend\n")
    controller.step(300)
    return world.state().tobytes(), controller.arm.sample.force, controller


def test_same_calls_give_identical_states(push: Path) -> None:
    assert run(push)[:2] == run(push)[:2]
