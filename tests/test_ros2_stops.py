"""The ROS 2 adapter with mocks of ROS 2: `halt` stops every motion of the arm, and states name the right frames."""

from __future__ import annotations

import importlib
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

import urlink
from urlink.packets import ProgramState

pytestmark = pytest.mark.simulated_time

_MODULES = """rclpy rclpy.action rclpy.callback_groups rclpy.duration rclpy.executors rclpy.qos rclpy.signals
    control_msgs control_msgs.action geometry_msgs geometry_msgs.msg sensor_msgs sensor_msgs.msg
    std_msgs std_msgs.msg std_srvs std_srvs.srv"""
_SOURCE = Path(__file__).parents[1] / "packages" / "ros2" / "src" / "urlink_ros2"
#: Distance from the current position to the goal, in rad.
_WAY = np.array([0.5, 0, 0, 0, 0, 0])


class _ActionServer:
    def __init__(self, *arguments: Any, **options: Any) -> None: ...


@pytest.fixture
def adapter(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Modules of the adapter, by name."""
    for name in _MODULES.split():
        monkeypatch.setitem(sys.modules, name, MagicMock())
    # The base class of a class of the adapter must be a class, not a mock.
    monkeypatch.setattr(sys.modules["rclpy.action"], "ActionServer", _ActionServer)
    package = ModuleType("urlink_ros2")
    package.__path__ = [str(_SOURCE)]
    monkeypatch.setitem(sys.modules, "urlink_ros2", package)
    names = ("goals", "following", "services", "states", "streams", "node")
    modules = {name: importlib.import_module(f"urlink_ros2.{name}") for name in names}
    yield SimpleNamespace(**modules)
    for name in names:
        sys.modules.pop(f"urlink_ros2.{name}", None)


@pytest.fixture
def robot() -> Iterator[urlink.Robot]:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.motion.stop(wait=True)
        yield robot


def halt(adapter: Any, robot: urlink.Robot) -> None:
    adapter.node.RobotNode._halt(SimpleNamespace(_robot=robot))


def ticking() -> urlink.Expiry:
    expiry = urlink.Expiry(4.0)
    expiry.tick()
    return expiry


def test_wrench_is_published_in_the_base_frame(adapter: Any, robot: urlink.Robot) -> None:
    state = robot.realtime.wait()
    adapter.states.StatePublishers(MagicMock(), ["elbow_joint"], "left_base").publish(state)
    message = adapter.states.WrenchStamped.return_value
    assert message.header.frame_id == "left_base"
    assert [message.wrench.force.x, message.wrench.force.y, message.wrench.force.z] == state.tcp_force[:3].tolist()


def test_halt_stops_a_script(adapter: Any, robot: urlink.Robot) -> None:
    goal = robot.realtime.wait().q_target + _WAY
    topics = adapter.streams.CommandTopics(MagicMock(), robot, ticking())
    topics._run(SimpleNamespace(data=f"movej({goal.tolist()}, a=1, v=0.2)"))
    robot.realtime.wait_until(lambda state: abs(state.qd_target).max() > 0.05)
    halt(adapter, robot)
    robot.realtime.wait_until(lambda state: state.program_state != ProgramState.PLAYING, timeout=5.0)
    assert abs(robot.realtime.wait().q_target - goal).max() > 0.1


@pytest.mark.parametrize("stop", ["halt", "protective stop"])
def test_goal_waiting_for_its_start_time_is_cancelled_by_stop(adapter: Any, robot: urlink.Robot, stop: str) -> None:
    monotonic = time.monotonic
    clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=int(monotonic() * 1e9), to_msg=lambda: None))
    node = MagicMock(get_clock=lambda: clock)
    node.get_subscriptions_info_by_topic.return_value = [SimpleNamespace(endpoint_gid=b"1")]
    joints = [f"joint_{number}" for number in range(6)]
    action = adapter.following.TrajectoryAction(node, "follow", robot, joints, 0.1, ticking())
    action._server = SimpleNamespace(number_of=lambda handle: 1)
    here = robot.realtime.wait().q_target
    ends: list[str] = []
    start = monotonic() + 4.0
    point = [
        SimpleNamespace(
            positions=q.tolist(), velocities=[], accelerations=[], time_from_start=SimpleNamespace(sec=at, nanosec=0)
        )
        for at, q in ((0, here), (2, here + _WAY))
    ]
    stamp = SimpleNamespace(sec=int(start), nanosec=int(start % 1 * 1e9))
    trajectory = SimpleNamespace(joint_names=joints, header=SimpleNamespace(stamp=stamp), points=point)
    no_time = SimpleNamespace(sec=0, nanosec=0)
    request = SimpleNamespace(trajectory=trajectory, path_tolerance=[], goal_tolerance=[], goal_time_tolerance=no_time)
    handle = SimpleNamespace(
        request=request,
        goal_id=SimpleNamespace(uuid=b"goal"),
        is_cancel_requested=False,
        succeed=lambda: ends.append("succeeded"),
        abort=lambda: ends.append("aborted"),
        canceled=lambda: ends.append("cancelled"),
    )
    thread = threading.Thread(target=action._execute, args=(handle,))
    thread.start()
    time.sleep(1.0)
    if stop == "halt":
        halt(adapter, robot)
    else:
        robot.controller.faults.protective_stop()
        robot.safety.wait_for_stop(5.0)
    thread.join(1.0)
    assert ends == ["aborted"]
    assert abs(robot.realtime.wait().q_target - here).max() < 0.01
