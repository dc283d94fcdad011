"""Public interface of the world: state, poses, images, and error messages."""

from __future__ import annotations

import gc
import sys
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import urlink
from packages.mujoco.tests.placing import arm_at
from urlink.simulator import Controller
from urlink_mujoco import MujocoWorld, mount


def test_reset_restores_bodies(table: Path) -> None:
    controller = arm_at((-0.45, 0.0, 0.2))
    world = MujocoWorld(table, controller)
    first = world.pose("box")
    world.place("box", (-0.3, -0.2, 0.3, 0.0, 0.0, 1.0))
    controller.step(25)
    kept, there = world.state(), world.pose("box")
    controller.step(25)
    assert world.pose("box")[2] < there[2] - 0.005
    fallen = world.pose("box")
    world.reset(kept)
    assert world.pose("box").tolist() == there.tolist()
    controller.step(25)
    assert world.pose("box") == pytest.approx(fallen, abs=1e-6)
    world.reset()
    assert world.pose("box") == pytest.approx(first, abs=1e-9)


def test_mounting_sets_payload_and_tcp_of_gripper(table: Path) -> None:
    controller = Controller("UR5e", noise=False)
    MujocoWorld(table, controller)
    controller.step(5)
    assert controller.arm.payload == 0.925
    assert controller.arm.tcp[2] == 0.145
    assert controller.arm.sample.force == [0.0] * 6
    controller.arm.payload = 0.0
    controller.step()
    assert controller.arm.sample.force[2] == pytest.approx(-0.925 * 9.82, rel=0.01)


def test_tcp_is_flange_without_gripper(table: Path) -> None:
    controller = Controller("UR5e", noise=False, gripper=False)
    world = MujocoWorld(table, controller)
    controller.step(5)
    assert controller.arm.tcp == [0.0] * 6
    assert not any("finger" in world.model.body(i).name for i in range(world.model.nbody))


def test_world_advances_by_8_ms_per_cycle_of_a_cb3(table: Path) -> None:
    controller = Controller("UR3", "3.15", noise=False)
    world = MujocoWorld(table, controller)
    controller.step(10)
    assert world.arms["arm"].time == pytest.approx(0.08)
    assert controller.arm.sample.force == [0.0] * 6


def test_arm_follows_set_points_of_controller(table: Path) -> None:
    controller = arm_at((-0.45, 0.0, 0.3))
    world = MujocoWorld(table, controller)
    q = list(controller.arm.setpoint.q)
    q[0], q[3] = q[0] + 0.8, q[3] - 0.5
    controller.take(f"def go():\n  movej({q},a=3,v=2)\nend\n")
    off = 0.0
    for _ in range(700):
        controller.step()
        there = world.data.qpos[[world.model.joint(f"arm/{name}").qposadr[0] for name in JOINTS]]
        off = max(off, float(np.abs(there - controller.arm.setpoint.q).max()))
    assert controller.arm.setpoint.q == pytest.approx(q, abs=1e-3)
    assert off < 2e-3


JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


@pytest.fixture
def drawing(table: Path) -> MujocoWorld:
    return _drawn(table)


def _drawn(table: Path) -> MujocoWorld:
    world = MujocoWorld(table, Controller("UR5e", noise=False))
    try:
        world.picture("front", width=32, height=24)
    except urlink.LocalError as error:
        pytest.skip(f"no OpenGL: {error}")
    return world


def test_camera_images_show_moved_body(drawing: MujocoWorld) -> None:
    before = drawing.picture("front", width=160, height=120)
    assert before.shape == (120, 160, 3)
    assert before.dtype == np.uint8
    assert (before == drawing.picture("front", width=160, height=120)).all()
    drawing.place("box", (-0.6, -0.3, 0.3, 0.0, 0.0, 0.0))
    assert (before != drawing.picture("front", width=160, height=120)).any()
    depth = drawing.picture("front", width=160, height=120, depth=True)
    assert depth.shape == (120, 160)
    assert 0.3 < depth.min() < 2.0


def test_images_are_equal_from_several_threads(drawing: MujocoWorld) -> None:
    with ThreadPoolExecutor(2) as threads:
        pictures = list(threads.map(lambda _: drawing.picture("front", width=32, height=24), range(4)))
    assert all((each == pictures[0]).all() for each in pictures)


def test_renderer_is_freed_when_collected_in_another_thread(table: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failed: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", failed.append)
    before = set(threading.enumerate())
    gone = weakref.finalize(world := _drawn(table), str)
    drawing = set(threading.enumerate()) - before
    assert len(drawing) == 1
    del world
    collecting = threading.Thread(target=gc.collect)
    collecting.start()
    collecting.join(30.0)
    assert not gone.alive
    for thread in drawing:
        thread.join(30.0)
        assert not thread.is_alive()
    assert not failed


def test_invalid_arguments_raise_clear_errors(table: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><geom type='lump'/></worldbody></mujoco>")
    with pytest.raises(urlink.LocalError, match=r"broken\.xml: .*lump"):
        Controller("UR5e", scene=broken) if _is_installed() else mount(broken, Controller("UR5e"))
    controller = Controller("UR5e", noise=False)
    with pytest.raises(urlink.BadValue, match="identifier such as 'left'"):
        MujocoWorld(table, {"an arm": controller})
    world = MujocoWorld(table, controller)
    with pytest.raises(urlink.BadValue, match=r"unknown body 'cup'; expected one of .*box"):
        world.pose("cup")
    with pytest.raises(urlink.BadValue, match="has no free joint"):
        world.place("arm/wrist_1_link", (0.0,) * 6)
    with pytest.raises(urlink.BadValue, match="six finite numbers"):
        world.place("box", (0.0,) * 5)
    with pytest.raises(urlink.BadValue, match="unknown camera 'back'; expected one of front"):
        world.picture("back")
    with pytest.raises(urlink.BadValue, match="a state of this world"):
        world.reset(np.zeros(3))


def _is_installed() -> bool:
    from importlib.metadata import entry_points

    return any(entry.name == "xml" for entry in entry_points(group="urlink.scenes"))


@pytest.mark.skipif(not _is_installed(), reason="the package is not installed, so its entry point is missing")
def test_address_with_scene_mounts_arm(table: Path) -> None:
    with urlink.simulated_time(1), urlink.connect(f"sim://ur5e?scene={table}") as robot:
        assert robot.controller is not None
        scene = robot.controller.world.scene
        assert type(scene).__name__ == "MountedArm"
        assert robot.realtime.wait(timeout=5.0) is not None
