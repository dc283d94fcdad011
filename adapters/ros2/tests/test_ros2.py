"""Robots over ROS 2: the node of the adapter here, and a node of rclpy in another process that reads and drives it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import urlink
from tests.waiting import until
from urlink.simulator import Controller
from urlink_ros2 import JOINT_NAMES, serve
from urlink_ros2.goals import read_goal

#: The simulated arm of these tests. What is silent or late here is so because the machine is busy.
pytestmark = [
    pytest.mark.urlink(
        model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
    ),
    # A driver takes seconds until it can be heard, and some tests need eight.
    pytest.mark.timeout(300),
]

DRIVER = Path(__file__).parent / "driver.py"
START = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
FAR = [0.5, *START[1:]]

Drive = Callable[..., Any]


@pytest.fixture
def robot(urlink_robot: urlink.Robot) -> urlink.Robot:
    urlink_robot.motion.move_joints(START, wait=True)
    # Nor does a trajectory end because set-points stay away; that is tested where they are made.
    motion = urlink_robot.motion
    motion.follow = partial(motion.follow, watchdog=5.0)  # type: ignore[method-assign]
    return urlink_robot


@pytest.fixture
def drive() -> Iterator[Drive]:
    """Runs the driver, and gives what it says last, or with ``wait=False`` its process."""
    started: list[subprocess.Popen[str]] = []

    def run(*argv: str, wait: bool = True) -> Any:
        process = subprocess.Popen([sys.executable, str(DRIVER), *argv], stdout=subprocess.PIPE, text=True)
        started.append(process)
        if not wait:
            return process
        out, _ = process.communicate(timeout=90)
        assert process.returncode == 0
        return json.loads(out.splitlines()[-1])

    yield run
    for process in started:
        process.kill()
        process.communicate()


def goal(*points: tuple[float, list[float]], joints: list[str] | None = None, **more: Any) -> str:
    return json.dumps({"joints": joints or list(JOINT_NAMES), "points": points, **more})


def test_a_node_reads_a_robot(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        heard = drive("listen", "3")
    names, position, effort = heard["last"]["joints"]
    assert names == list(JOINT_NAMES)
    assert position == pytest.approx(START, abs=1e-2)
    assert len(effort) == 6
    # In Python, seven topics at 500 Hz are more than a busy machine has time for; `benchmark.py` has figures.
    assert heard["rate"] > 100.0
    state = robot.realtime.wait()
    assert heard["last"]["pose"] == pytest.approx(state.tool_vector_actual[[0, 2]], abs=1e-2)
    assert 0.0 <= heard["last"]["speed_scaling"] <= 100.0
    # Who comes late hears what changes seldom, too.
    assert heard["last"]["robot_mode"] == "RUNNING"
    assert heard["last"]["safety_mode"] == "NORMAL"
    assert heard["last"]["refusal"] == ""
    assert heard["counts"]["wrench"] > 100


def test_a_trajectory_with_feedback_in_another_order_of_joints(robot: urlink.Robot, drive: Drive) -> None:
    turned = list(reversed(JOINT_NAMES))
    with serve({"arm": robot}):
        done = drive("follow", goal((0.5, [0.25, *START[1:]][::-1]), (1.0, FAR[::-1]), joints=turned))
    assert (done["status"], done["code"]) == (4, 0)
    assert done["feedback"] > 5
    assert done["names"] == list(JOINT_NAMES)
    assert robot.realtime.wait().q_actual == pytest.approx(FAR, abs=0.01)


def test_a_trajectory_is_cancelled_by_its_client_and_by_its_death(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        done = drive("follow", goal((0.0, START), (8.0, FAR)), "cancel")
        assert done["status"] == 5
        until(lambda: np.abs(robot.realtime.wait().qd_actual).max() < 1e-3)
        here = robot.realtime.wait().q_target.tolist()
        assert here[0] < 0.45
        process = drive("follow", goal((0.0, here), (40.0, [here[0] + 1.0, *here[1:]])), "die", wait=False)
        assert json.loads(process.stdout.readline()) == {"moving": True}
        motion = robot.motion.current
        assert motion is not None
        # In order: where a process is killed, DDS waits for its lease of 20 s.
        process.send_signal(signal.SIGINT)
        until(lambda: motion.done, 10.0)
        assert isinstance(motion.error, urlink.Cancelled)


def test_what_moves_ends_with_the_serving_and_its_client_is_told(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        process = drive("follow", goal((0.0, START), (40.0, FAR)), "stay", wait=False)
        assert json.loads(process.stdout.readline()) == {"moving": True}
        motion = robot.motion.current
        assert motion is not None
    assert motion.done
    assert isinstance(motion.error, urlink.Cancelled)
    out, _ = process.communicate(timeout=20)
    told = json.loads(out.splitlines()[-1])
    assert (told["status"], told["code"]) == (6, -1)
    assert "Cancelled" in told["text"]


def test_goals_that_are_refused_or_fail(robot: urlink.Robot, drive: Drive, urlink_controller: Controller) -> None:
    with serve({"arm": robot}):
        wrong = drive("follow", goal((0.0, START), (1.0, FAR), joints=["a", "b", "c", "d", "e", "f"]))
        assert (wrong["status"], wrong["code"]) == (6, -2)
        assert "shoulder_pan_joint" in wrong["text"]
        strict = drive("follow", goal((0.0, START), (0.5, [0.2, *START[1:]]), (1.0, FAR), path_tolerance=1e-5))
        assert (strict["status"], strict["code"]) == (6, -4)
        assert "ToleranceExceeded" in strict["text"]
        urlink_controller.faults.protective_stop()
        until(lambda: robot.safety.refusal is not None)
        assert drive("follow", goal((0.0, START), (1.0, FAR))) == {"accepted": False}


def test_services(robot: urlink.Robot, drive: Drive, urlink_controller: Controller) -> None:
    with serve({"arm": robot}):
        assert drive("call", "io_and_status_controller/set_digital_out_4", "on")["success"]
        assert robot.io.digital_out(4)
        assert drive("call", "dashboard_client/power_off")["success"]
        until(lambda: robot.safety.refusal is not None)
        failed = drive("call", "enable")
        assert not failed["success"]
        assert "NotRunning" in failed["message"]
        assert drive("call", "dashboard_client/power_on")["success"]
        until(lambda: drive("call", "dashboard_client/brake_release")["success"], 90.0)
        until(lambda: robot.safety.refusal is None)
        robot.motion.move_joints(FAR, 0.1)
        assert drive("call", "halt")["success"]
        until(lambda: robot.motion.current is None)


@pytest.mark.urlink(connect={})
def test_several_robots_in_namespaces_one_of_which_is_lost_and_comes_back(
    robot: urlink.Robot, urlink_controller: Controller, drive: Drive
) -> None:
    with urlink.connect("sim://ur10e?firmware=5.11") as other, serve({"left": robot, "right": other}, rate=50.0):
        assert 10.0 < drive("listen", "2", "right/")["rate"] < 60.0
        urlink_controller.faults.stall(600.0)
        until(lambda: robot.safety.refusal is not None)
        heard = drive("listen", "2", "left/")
        assert heard["last"]["robot_mode"] == "DISCONNECTED"
        assert heard["last"]["refusal"]
        urlink_controller.faults.stall(0.01)  # in place of the other
        until(lambda: robot.safety.refusal is None, 40.0)
        heard = drive("listen", "2", "left/")
        assert (heard["last"]["robot_mode"], heard["last"]["refusal"]) == ("RUNNING", "")
        assert heard["count"] > 50


def test_serve_from_the_command_line(drive: Drive) -> None:
    options = ("arm=sim://ur5e", "--namespaced", "--prefixed", "--rate", "100")
    process = subprocess.Popen(
        [sys.executable, "-c", "import sys, urlink.cli; sys.exit(urlink.cli.main())", "serve", "ros2", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "serving arm over ros2; Ctrl-C ends it\n"
        assert drive("listen", "2", "arm/")["last"]["joints"][0][0] == "arm_shoulder_pan_joint"
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 128 + signal.SIGTERM
    finally:
        process.kill()
        process.communicate()


def duration(seconds: float) -> SimpleNamespace:
    return SimpleNamespace(sec=int(seconds), nanosec=int(seconds % 1.0 * 1e9))


def message(points: list[tuple[float, dict[str, Any]]], tolerances: tuple[float, ...] = ()) -> SimpleNamespace:
    empty: dict[str, Any] = {"positions": [], "velocities": [], "accelerations": []}
    return SimpleNamespace(
        trajectory=SimpleNamespace(
            joint_names=list(JOINT_NAMES),
            points=[SimpleNamespace(**empty | parts, time_from_start=duration(at)) for at, parts in points],
        ),
        path_tolerance=[SimpleNamespace(position=value) for value in tolerances],
        goal_tolerance=[SimpleNamespace(position=value) for value in tolerances],
        goal_time_tolerance=duration(0.0),
    )


def test_a_goal_is_read() -> None:
    q = {"positions": FAR}
    here = np.array(START)
    read = read_goal(message([(1.0, q)]), JOINT_NAMES, here)
    assert read.trajectory.time.tolist() == [0.0, 1.0]
    assert read.trajectory.q[0].tolist() == START
    assert (read.path_tolerance, read.goal_tolerance, read.goal_time) == (None, 0.01, 1.0)
    # Of several the strictest; 0 is the default, and a negative one is none.
    assert read_goal(message([(1.0, q)], (0.2, 0.1, 0.0)), JOINT_NAMES, here).path_tolerance == 0.1
    assert read_goal(message([(1.0, q)], (-1.0,)), JOINT_NAMES, here).goal_tolerance == 100.0
    velocity = q | {"velocities": [0.0] * 6}
    assert read_goal(message([(1.0, velocity)]), JOINT_NAMES, here).trajectory.has_velocities
    refused: list[list[tuple[float, dict[str, Any]]]] = [
        [(0.0, q), (1.0, {"positions": [0.0]})],
        [(0.0, velocity), (1.0, q)],
        [],
        [(1.0, {})],
    ]
    for bad in refused:
        with pytest.raises(urlink.BadValue):
            read_goal(message(bad), JOINT_NAMES, here)
