"""Robots over ROS 2: the node of urlink-ros2, and a node of rclpy in another process that reads and commands it."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import urlink
from tests.waiting import until
from urlink.arm.kinematics import Arm
from urlink.simulator import Controller
from urlink_ros2 import JOINT_NAMES
from urlink_ros2 import serve as serve_nodes
from urlink_ros2.goals import Late, has_passed, outcome, read_goal, start_of

#: Marks of the simulated arm of these tests. The limits are long because a busy machine causes silence and delays.
pytestmark = [
    pytest.mark.urlink(
        model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
    ),
    # A driver needs seconds to start, and some tests need eight drivers.
    pytest.mark.timeout(300),
]

DRIVER = Path(__file__).parent / "driver.py"
START = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
FAR = [0.5, *START[1:]]

#: With this watchdog, a delayed set-point does not end a trajectory. The tests of set-points cover that case.
serve = partial(serve_nodes, watchdog=5.0)

Drive = Callable[..., Any]


@pytest.fixture
def robot(urlink_robot: urlink.Robot) -> urlink.Robot:
    urlink_robot.motion.move_joints(START, wait=True)
    return urlink_robot


@pytest.fixture
def drive() -> Iterator[Drive]:
    """Function that runs the driver and returns its last output (its process if not `wait`)."""
    started: list[subprocess.Popen[str]] = []

    def run(*argv: str, wait: bool = True) -> Any:
        process = subprocess.Popen(
            [sys.executable, str(DRIVER), *argv], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
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


def test_node_publishes_states(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        heard = drive("listen", "3")
    names, position, effort = heard["last"]["joints"]
    assert names == list(JOINT_NAMES)
    assert position == pytest.approx(START, abs=1e-2)
    assert len(effort) == 6
    # In Python, a busy machine has not enough time for seven topics at 500 Hz; `benchmark.py` measures it. With a limit
    # of 50 Hz, as below, the rate would be lower.
    assert heard["rate"] > 60.0
    state = robot.realtime.wait()
    assert heard["last"]["pose"] == pytest.approx(state.tool_vector_actual[[0, 2]], abs=1e-2)
    assert 0.0 <= heard["last"]["speed_scaling"] <= 100.0
    # A late subscriber receives the values that change seldom too.
    assert heard["last"]["robot_mode"] == "RUNNING"
    assert heard["last"]["safety_mode"] == "NORMAL"
    assert heard["last"]["refusal"] == ""
    assert heard["counts"]["wrench"] > 100


def test_trajectory_with_reordered_joints_sends_feedback(robot: urlink.Robot, drive: Drive) -> None:
    turned = list(reversed(JOINT_NAMES))
    with serve({"arm": robot}):
        done = drive("follow", goal((0.5, [0.25, *START[1:]][::-1]), (1.0, FAR[::-1]), joints=turned))
    assert (done["status"], done["code"]) == (4, 0)
    assert done["feedback"] > 5
    assert done["names"] == list(JOINT_NAMES)
    assert robot.realtime.wait().q_actual == pytest.approx(FAR, abs=0.01)


def test_cancelled_goal_and_ended_client_stop_the_arm(robot: urlink.Robot, drive: Drive) -> None:
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
        # SIGINT ends the process normally. After a kill, DDS would wait for its lease of 20 s.
        process.send_signal(signal.SIGINT)
        until(lambda: motion.done, 10.0)
        assert isinstance(motion.error, urlink.Cancelled)


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_goal_is_cancelled_when_its_client_but_no_other_dies(
    robot: urlink.Robot, drive: Drive, end: signal.Signals
) -> None:
    with serve({"arm": robot}):
        watching = drive("watch", "120", wait=False)
        assert json.loads(watching.stdout.readline()) == {"ready": True}
        process = drive("follow", goal((0.0, START), (60.0, FAR)), "die", wait=False)
        assert json.loads(process.stdout.readline()) == {"moving": True}
        motion = robot.motion.current
        assert motion is not None
        until(lambda: motion.progress > 0.03, 30.0)  # longer than the allowed silence of a client
        process.send_signal(end)
        until(lambda: motion.done, 10.0)  # shorter than DDS's lease of 20 s
        assert isinstance(motion.error, urlink.Cancelled)
        # A client that is already dead must not affect the next goal.
        here = robot.realtime.wait().q_target.tolist()
        assert drive("follow", goal((0.0, here), (3.0, here)))["code"] == 0


def test_newest_of_several_goals_is_followed(robot: urlink.Robot, drive: Drive) -> None:
    targets = [[0.02 * number, *START[1:]] for number in range(1, 8)]
    with serve({"arm": robot}):
        goals = [json.loads(goal((1.0, target))) for target in targets]
        results = drive("follow", json.dumps({"goals": goals}))["results"]
    assert results == [[6, -103]] * 6 + [[4, 0]]
    assert robot.realtime.wait().q_actual == pytest.approx(targets[-1], abs=0.01)


def test_goal_starts_at_the_time_in_its_stamp(robot: urlink.Robot, drive: Drive) -> None:
    moved: list[float] = []

    def note(state: urlink.packets.RealtimeState) -> None:
        if np.abs(state.qd_actual).max() > 1e-3 and state.received is not None:
            moved.append(state.received.wall)

    with serve({"arm": robot}), robot.realtime.subscribe(note):
        done = drive("follow", goal((0.0, START), (1.0, FAR), stamp=2.0))
        assert (done["status"], done["code"]) == (4, 0)
        # The simulated arm needs a while to reach the first thousandth of a rad/s, so this comparison is reliable.
        assert done["stamp"] < min(moved) < done["stamp"] + 20.0
        assert done["early"] > 5  # feedback arrives before the start too; 20 per second if the machine has time
        moved.clear()
        # A goal that has ended is rejected. A goal in progress is refused if the arm is elsewhere, and followed
        # otherwise.
        assert drive("follow", goal((0.0, FAR), (1.0, START), stamp=-2.0)) == {"accepted": False}
        late = drive("follow", goal((0.0, FAR), (30.0, START), stamp=-15.0))
        assert (late["status"], late["code"]) == (6, -3)
        assert late["text"].startswith("OLD_HEADER_TIMESTAMP: ")
        wrong = drive("follow", goal((0.0, FAR), (1.0, START), stamp=4000.0))
        assert (wrong["status"], wrong["code"]) == (6, -1)
        assert not moved
        rest = drive("follow", goal((0.0, FAR), (30.0, FAR), (31.0, START), stamp=-29.0))
        assert (rest["status"], rest["code"]) == (4, 0)


def test_waiting_goal_preempts_current_and_can_be_cancelled(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        process = drive("follow", goal((0.0, START), (40.0, FAR)), "stay", wait=False)
        assert json.loads(process.stdout.readline()) == {"moving": True}
        motion = robot.motion.current
        assert motion is not None
        # A newer goal replaces this goal immediately, although its start time is in the future.
        done = drive("follow", goal((0.0, START), (1.0, FAR), stamp=600.0), "cancel")
        assert motion.done
        assert done["status"] == 5
        assert done["text"].startswith("CANCELLED: ")
        out, _ = process.communicate(timeout=20)
        told = json.loads(out.splitlines()[-1])
        assert (told["status"], told["code"], told["text"].partition(":")[0]) == (6, -103, "PREEMPTED")
        assert robot.motion.current is None


def suspend(process: subprocess.Popen[str]) -> None:
    """Suspend a process and wait until it has stopped, because the signal takes effect later."""
    process.send_signal(signal.SIGSTOP)
    os.waitpid(process.pid, os.WUNTRACED)


def test_commands_sent_to_suspended_server_are_rejected(
    robot: urlink.Robot, urlink_controller: Controller, drive: Drive
) -> None:
    """A goal and a service call that arrive at a suspended server are rejected later."""
    command = "import sys, urlink.cli; sys.exit(urlink.cli.main())"
    server = subprocess.Popen(
        [sys.executable, "-c", command, "serve", "ros2", f"arm={urlink_controller.address}", "--watchdog", "5"],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert server.stdout is not None
        assert server.stdout.readline() == "serving arm over ros2; Ctrl-C ends it\n"
        client = drive("give_up", goal((0.0, START), (1.0, FAR)), "3.0", wait=False)
        assert json.loads(client.stdout.readline()) == {"ready": True}
        suspend(server)
        client.stdin.write("send\n")
        client.stdin.flush()
        assert json.loads(client.stdout.readline()) == {"answered": False}
        server.send_signal(signal.SIGCONT)
        client.stdin.write("look\n")
        client.stdin.flush()
        late = json.loads(client.stdout.readline())
        assert (late["accepted"], late["called"]) == (False, False)
        assert "interrupted for" in late["text"]
        begun = time.monotonic()
        while time.monotonic() < begun + 6.0:
            assert np.abs(robot.realtime.wait().qd_actual).max() < 1e-3
        assert robot.realtime.wait().q_actual == pytest.approx(START, abs=1e-2)
        # The rejection is not permanent.
        done = drive("follow", goal((0.0, START), (1.0, FAR)))
        assert (done["status"], done["code"]) == (4, 0)
    finally:
        server.send_signal(signal.SIGCONT)
        server.kill()
        server.communicate()


def test_shutdown_cancels_goal_and_sends_its_result(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        process = drive("follow", goal((0.0, START), (40.0, FAR)), "stay", wait=False)
        assert json.loads(process.stdout.readline()) == {"moving": True}
        motion = robot.motion.current
        assert motion is not None
    assert motion.done
    assert isinstance(motion.error, urlink.Cancelled)
    out, _ = process.communicate(timeout=20)
    told = json.loads(out.splitlines()[-1])
    assert (told["status"], told["code"]) == (6, -104)
    assert told["text"].startswith("CANCELLED: Cancelled: ")


def test_invalid_and_failed_goals_report_error_codes(
    robot: urlink.Robot, drive: Drive, urlink_controller: Controller
) -> None:
    with serve({"arm": robot}):
        wrong = drive("follow", goal((0.0, START), (1.0, FAR), joints=["a", "b", "c", "d", "e", "f"]))
        assert (wrong["status"], wrong["code"]) == (6, -2)
        assert "shoulder_pan_joint" in wrong["text"]
        strict = drive("follow", goal((0.0, START), (0.5, [0.2, *START[1:]]), (1.0, FAR), path_tolerance=1e-5))
        assert (strict["status"], strict["code"]) == (6, -4)
        assert "ToleranceExceeded" in strict["text"]
        here = robot.realtime.wait().q_target.tolist()
        process = drive("follow", goal((0.0, here), (40.0, FAR)), "stay", wait=False)
        assert json.loads(process.stdout.readline()) == {"moving": True}
        urlink_controller.faults.protective_stop()
        told = json.loads(process.communicate(timeout=60)[0].splitlines()[-1])
        assert (told["status"], told["code"]) == (6, -101)
        assert told["text"].startswith("STOPPED: SafetyStop: ")
        assert drive("follow", goal((0.0, START), (1.0, FAR))) == {"accepted": False}


def test_services_set_outputs_and_send_dashboard_commands(
    robot: urlink.Robot, drive: Drive, urlink_controller: Controller
) -> None:
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
def test_other_robot_keeps_running_when_one_robot_is_lost(
    robot: urlink.Robot, urlink_controller: Controller, drive: Drive
) -> None:
    with urlink.connect("sim://ur10e?firmware=5.11") as other, serve({"left": robot, "right": other}, rate=50.0):
        assert 10.0 < drive("listen", "2", "right/")["rate"] < 60.0
        urlink_controller.faults.stall(600.0)
        until(lambda: robot.safety.refusal is not None)
        heard = drive("listen", "2", "left/")
        assert heard["last"]["robot_mode"] == "DISCONNECTED"
        assert heard["last"]["refusal"]
        urlink_controller.faults.stall(0.01)  # replaces the other stall
        until(lambda: robot.safety.refusal is None, 40.0)
        heard = drive("listen", "2", "left/")
        assert (heard["last"]["robot_mode"], heard["last"]["refusal"]) == ("RUNNING", "")
        assert heard["count"] > 50


def test_command_line_serves_robot_until_terminated(drive: Drive) -> None:
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


def message(
    points: list[tuple[float, dict[str, Any]]], tolerances: tuple[float, ...] = (), stamp: float = 0.0
) -> SimpleNamespace:
    empty: dict[str, Any] = {"positions": [], "velocities": [], "accelerations": []}
    return SimpleNamespace(
        trajectory=SimpleNamespace(
            header=SimpleNamespace(stamp=duration(stamp)),
            joint_names=list(JOINT_NAMES),
            points=[SimpleNamespace(**empty | parts, time_from_start=duration(at)) for at, parts in points],
        ),
        path_tolerance=[SimpleNamespace(position=value) for value in tolerances],
        goal_tolerance=[SimpleNamespace(position=value) for value in tolerances],
        goal_time_tolerance=duration(0.0),
    )


def test_read_goal_converts_points_and_tolerances() -> None:
    q = {"positions": FAR}
    here = np.array(START)
    read = read_goal(message([(1.0, q)]), JOINT_NAMES, here)
    assert read.trajectory.time.tolist() == [0.0, 1.0]
    assert read.trajectory.q[0].tolist() == START
    assert (read.path_tolerance, read.goal_tolerance, read.goal_time) == (None, 0.01, 1.0)
    # The strictest of several tolerances counts; 0 selects the default, and a negative value means no tolerance.
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


def test_read_goal_omits_points_that_have_passed() -> None:
    q, far = {"positions": START}, {"positions": FAR}
    here = np.array(START)
    stamped = message([(0.0, q), (2.0, q), (3.0, far)], stamp=100.0)
    assert start_of(stamped) == 100.0
    assert start_of(message([(1.0, q)])) is None
    assert [has_passed(stamped, now) for now in (99.0, 102.9, 103.1)] == [False, False, True]
    assert not has_passed(message([(1.0, q)]), 1e9)
    rest = read_goal(stamped, JOINT_NAMES, here, 1.5).trajectory
    assert rest.time.tolist() == [0.0, 0.5, 1.5]
    assert rest.q[:, 0].tolist() == [0.0, 0.0, 0.5]
    with pytest.raises(Late, match=r"2\.50 s ago, and the arm is 0\.25\d? rad from"):
        read_goal(stamped, JOINT_NAMES, here, 2.5)
    # The time of its first point has not passed: the trajectory leads there from the current position.
    ahead = read_goal(message([(2.0, far)], stamp=100.0), JOINT_NAMES, here, 1.0).trajectory
    assert ahead.time.tolist() == [0.0, 1.0]


class _Codes:
    INVALID_GOAL, INVALID_JOINTS, OLD_HEADER_TIMESTAMP, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = range(
        -1, -6, -1
    )


@pytest.mark.parametrize(
    ("error", "code", "prefix"),
    [
        (urlink.SafetyStop("protective stop", "protective stop"), -101, "STOPPED"),
        (urlink.NotRunning("off"), -101, "STOPPED"),
        (urlink.ProgramStopped("by the pendant"), -101, "STOPPED"),
        (urlink.ConnectionLost("gone"), -102, "LINK_LOST"),
        (urlink.LinkTimeout("silent"), -102, "LINK_LOST"),
        (urlink.Cancelled("by its client"), -104, "CANCELLED"),
        (urlink.ToleranceExceeded("far"), -4, "PATH_TOLERANCE_VIOLATED"),
        (urlink.BadValue("joint_names=[]"), -2, "INVALID_JOINTS"),
        (urlink.BadValue("too fast"), -1, "INVALID_GOAL"),
        (urlink.ScriptFailed(0, 0, "no memory"), -105, "FAILED"),
        (Late("ago"), -3, "OLD_HEADER_TIMESTAMP"),
    ],
)
def test_outcome_maps_errors_to_result_codes(error: Exception, code: int, prefix: str) -> None:
    assert outcome(error, _Codes, False, False) == (code, prefix)
    assert outcome(urlink.Cancelled("newer"), _Codes, False, True) == (-103, "PREEMPTED")
    assert outcome(urlink.ToleranceExceeded("far"), _Codes, True, False) == (-5, "GOAL_TOLERANCE_VIOLATED")


def test_velocity_messages_move_arm_until_silence(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        drive("send", "forward_velocity_controller/commands", "[0, 0, 0, 0, 0, 0.4]", "1.5")
        until(lambda: np.abs(robot.realtime.wait().qd_actual).max() < 1e-3)
        until(lambda: robot.motion.current is None)
    assert robot.realtime.wait().q_target[5] > 0.1


def test_position_messages_move_arm_to_target(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        drive("send", "forward_position_controller/commands", json.dumps([0.2, *START[1:]]), "3.0")
        until(lambda: robot.motion.current is None)
    assert robot.realtime.wait().q_target[0] == pytest.approx(0.2, abs=0.02)


def test_stopped_motion_does_not_restart_without_silence(robot: urlink.Robot, drive: Drive) -> None:
    command = ("send", "forward_velocity_controller/commands", "[0, 0, 0, 0, 0, 0.2]")
    with serve({"arm": robot}):
        process = drive(*command, "12.0", wait=False)
        until(lambda: robot.realtime.wait().qd_target[5] > 0.1, 20.0)
        motion = robot.motion.current
        assert motion is not None
        motion.cancel()
        until(lambda: not robot.realtime.wait().qd_target.any())
        there = robot.realtime.wait().q_target[5]
        time.sleep(1.0)  # time for fifty more messages
        assert robot.realtime.wait().q_target[5] == there
        process.kill()
        process.communicate()
        drive(*command, "1.0")  # sent after a silence
        until(lambda: robot.realtime.wait().q_target[5] > there + 0.02)


def test_invalid_messages_do_not_move_arm(robot: urlink.Robot, drive: Drive) -> None:
    before = robot.realtime.wait().q_target
    with serve({"arm": robot}):
        drive("send", "forward_position_controller/commands", "[90, 0, 0, 0, 0, 0]", "0.5")
        drive("send", "forward_velocity_controller/commands", "[1, 2]", "0.5")
        until(lambda: robot.motion.current is None)
    assert np.abs(robot.realtime.wait().q_target - before).max() < 1e-3


def test_freedrive_ends_when_messages_stop(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        process = drive("send", "freedrive_mode_controller/enable_freedrive_mode", "true", "12.0", wait=False)
        until(lambda: robot.motion.current is not None and robot.motion.current.name == "freedrive", 20.0)
        process.kill()
        process.communicate()
        until(lambda: robot.motion.current is None, 10.0)


def test_script_message_is_run(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        drive("send", "urscript_interface/script_command", '"set_standard_digital_out(5, True)"', "0.0")
        until(lambda: robot.io.digital_out(5))


def test_description_is_published_and_force_sensor_is_zeroed(robot: urlink.Robot, drive: Drive) -> None:
    with serve({"arm": robot}):
        said = drive("describe")
        zeroed = drive("call", "io_and_status_controller/zero_ftsensor")
    assert said["robot"]
    assert said["joints"] >= 6
    assert zeroed["success"], zeroed["message"]


#: A box of 5 cm on a table, from urlink-mujoco, whose gripper is the gripper of the controller.
TABLE = Path(__file__).parents[2] / "mujoco" / "tests" / "table.xml"
TCP = (0.0, 0.0, 0.145, 0.0, 0.0, 0.0)

#: Script that moves the gripper of a UR over ROS 2 without a separate node: it communicates with the gripper's URCap.
#: An output reports that the fingers are at rest, and output 0 reports whether they hold an object.
GRIP = """def grip():
  def set(name, value):
    socket_set_var(name, value, "gripper")
    socket_read_byte_list(3, "gripper")    # its "ack"
  end
  socket_open("127.0.0.1", 63352, "gripper")
  set("ACT", 1)
  while socket_get_var("STA", "gripper") != 3:
    sleep(0.1)
  end
  set("GTO", 1)
  set("POS", {position})
  sleep(0.1)
  while socket_get_var("OBJ", "gripper") == 0:
    sleep(0.1)
  end
  set_standard_digital_out(0, socket_get_var("OBJ", "gripper") == 2)
  set_standard_digital_out({done}, True)
end
"""


@pytest.mark.skipif(find_spec("urlink_mujoco") is None, reason="urlink-mujoco is not installed")
@pytest.mark.urlink(scene=TABLE)
def test_script_and_goals_move_box(
    urlink_robot: urlink.Robot, urlink_controller: Controller, drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    # MuJoCo, the arm, the node and its client share one machine here, so a late client is not lost.
    monkeypatch.setattr("urlink_ros2.following._SILENT", 20.0)
    q = urlink_robot.realtime.wait().q_target
    scene: Any = urlink_controller.world.scene

    def go(*places: tuple[float, float, float]) -> None:
        nonlocal q
        points: list[tuple[float, list[float]]] = []
        for place in places:
            q = Arm("UR5e").inverse([*place, math.pi, 0.0, 0.0], tcp=TCP, near=q)
            points.append((2.0 + 0.5 * len(points), q.tolist()))
        done = drive("follow", goal(*points))
        assert (done["status"], done["code"]) == (4, 0), done["text"]

    def grip(position: int, done: int) -> bool:
        """Move the fingers; return whether they hold an object when they are at rest."""
        drive("send", "urscript_interface/script_command", json.dumps(GRIP.format(position=position, done=done)), "0")
        outputs = 0

        def rests() -> bool:
            nonlocal outputs
            outputs = drive("listen", "0.5")["last"]["digital_outputs"]
            return bool(outputs & 1 << done)

        until(rests)
        return bool(outputs & 1)

    with serve({"arm": urlink_robot}, rate=50.0):
        assert not grip(0, 1)
        go((-0.45, 0.2, 0.15), (-0.45, 0.2, 0.085), (-0.45, 0.2, 0.025))
        assert grip(255, 2)
        go((-0.45, 0.2, 0.15), (-0.5, 0.0, 0.15), (-0.55, -0.2, 0.15))
        assert scene.world.pose("box")[:3] == pytest.approx((-0.55, -0.2, 0.15), abs=0.01)
        go((-0.55, -0.2, 0.085), (-0.55, -0.2, 0.026))
        assert not grip(0, 3)
        go((-0.55, -0.2, 0.15))
    assert scene.world.pose("box")[:3] == pytest.approx((-0.55, -0.2, 0.025), abs=0.005)
