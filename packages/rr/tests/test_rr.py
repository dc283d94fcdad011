"""Robots over Robot Raconteur: each test has a server node and a client node, connected over TCP."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import RobotRaconteur as RR

import rhdlink
import urlink
from rhdlink.host.plugins.turtle import Turtle
from tests.waiting import until
from urlink.arm import poses
from urlink.arm.urdf import JOINTS as JOINT_NAMES
from urlink.simulator import Controller
from urlink_rr import open_node, register, register_rhd, serve
from urlink_rr.description import HOME

#: Marks of the simulated arm of these tests. The limits are long because a busy machine causes silence and delays.
pytestmark = pytest.mark.urlink(
    model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
)

START = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
ROBOT = "com.robotraconteur.robotics.robot"


@contextlib.contextmanager
def client_node() -> Iterator[Any]:
    node = RR.RobotRaconteurNode()
    node.Init()
    node.RegisterTransport(RR.TcpTransport(node))
    try:
        yield node
    finally:
        node.Shutdown()


@pytest.fixture
def robot(urlink_robot: urlink.Robot) -> urlink.Robot:
    urlink_robot.motion.move_joints(START, wait=True)
    return urlink_robot


@pytest.fixture
def port(robot: urlink.Robot) -> Iterator[int]:
    # With this watchdog, a delayed set-point does not end a trajectory. The tests of set-points cover that case.
    with serve({"arm": robot}, port=0, announce=False, watchdog=5.0) as port:
        yield port


@pytest.fixture
def node() -> Iterator[Any]:
    with client_node() as node:
        yield node


@pytest.fixture
def arm(port: int, node: Any) -> Any:
    """Client object of the robot."""
    return node.ConnectService(f"rr+tcp://localhost:{port}?service=arm")


def modes(node: Any, arm: Any) -> dict[str, int]:
    return dict(node.GetConstants(ROBOT, arm)["RobotCommandMode"])


def newest(arm: Any) -> Any:
    return arm.robot_state.PeekInValue()[0]


def test_client_reads_robot(arm: Any, node: Any, robot: urlink.Robot) -> None:
    info = arm.robot_info
    assert info.device_info.model.name == "UR5e"
    assert [joint.joint_identifier.name for joint in info.joint_info] == list(JOINT_NAMES)
    assert info.joint_info[2].joint_limits.upper == robot.kinematics.position_limits[2, 1]
    flags = node.GetConstants(ROBOT, arm)["RobotStateFlags"]
    states, advanced = arm.robot_state.Connect(), arm.advanced_robot_state.Connect()
    pipe = arm.robot_state_sensor_data.Connect(-1)
    clock = arm.device_clock_now.Connect()
    until(lambda: states.InValueValid and advanced.InValueValid and clock.InValueValid and pipe.Available > 10)
    state = states.InValue
    now = robot.realtime.wait()
    assert state.joint_position == pytest.approx(now.q_actual, abs=1e-3)
    tool = state.kin_chain_tcp[0]
    assert [float(tool["position"][axis]) for axis in "xyz"] == pytest.approx(now.tool_vector_actual[:3], abs=1e-3)
    turned = poses.quaternion_to_rotvec([float(tool["orientation"][axis]) for axis in "xyzw"])
    assert turned == pytest.approx(now.tool_vector_actual[3:], abs=1e-2)
    assert state.robot_state_flags & flags["ready"]
    assert state.robot_state_flags & flags["enabled"]
    assert not state.robot_state_flags & flags["communication_failure"]
    assert arm.current_errors == []
    numbers = [pipe.ReceivePacket().robot_state.seqno for _ in range(10)]
    assert numbers == list(range(numbers[0], numbers[0] + 10))
    assert arm.isoch_info.update_rate == 125.0


def test_chain_matches_kinematics_of_arm(arm: Any, robot: urlink.Robot) -> None:
    """The product of exponentials of H and P gives the same flange pose as the kinematics."""
    chain = arm.robot_info.chains[0]
    axes = np.array([list(axis) for axis in chain.H.tolist()]).reshape(6, 3)
    ways = np.array([list(way) for way in chain.P.tolist()]).reshape(7, 3)
    q = np.array([0.3, -1.2, 1.4, -0.6, 0.8, -0.2])
    rotation, place = np.eye(3), ways[0].copy()
    for axis, way, angle in zip(axes, ways[1:], q, strict=True):
        rotation = rotation @ poses.rotvec_to_matrix(axis * angle)
        place = place + rotation @ way
    expected = robot.kinematics.forward(q)
    assert place == pytest.approx(expected[:3], abs=1e-9)
    flange = [float(chain.flange_pose["orientation"].flat[0][axis]) for axis in "xyzw"]
    whole = rotation @ poses.rotvec_to_matrix(poses.quaternion_to_rotvec(flange))
    assert whole == pytest.approx(poses.rotvec_to_matrix(expected[3:]), abs=1e-9)


def test_downsampling_reduces_states_of_client(arm: Any) -> None:
    arm.isoch_downsample = 9
    assert arm.isoch_downsample == 9
    pipe = arm.robot_state_sensor_data.Connect(-1)
    until(lambda: pipe.Available > 12)
    numbers = [pipe.ReceivePacket().robot_state.seqno for _ in range(12)]
    assert np.diff(numbers[2:]).tolist() == [10] * 9


def test_client_jogs_robot(arm: Any, node: Any, robot: urlink.Robot) -> None:
    goal = np.array(START) + np.array([0.2, 0, 0, 0, 0, 0.1])
    with pytest.raises(RR.InvalidOperationException, match="command mode is halt"):
        arm.jog_freespace(goal, np.full(6, 0.5), True)
    arm.command_mode = modes(node, arm)["jog"]
    arm.jog_freespace(goal, np.full(6, 0.5), True)
    assert newest(arm).joint_position == pytest.approx(goal, abs=1e-3)
    arm.jog_joint(np.array([0.2, 0, 0, 0, 0, 0]), 0.5, True)
    assert newest(arm).joint_position[0] > goal[0] + 0.05
    before = robot.realtime.wait().tool_vector_actual[2]
    speed = np.zeros((1,), node.GetNamedArrayDType("com.robotraconteur.geometry.SpatialVelocity", arm))
    speed[0]["linear"]["z"] = 0.05
    arm.jog_cartesian({0: speed}, 0.5, True)
    assert robot.realtime.wait().tool_vector_actual[2] > before + 0.01
    with pytest.raises(RR.InvalidArgumentException, match="six positions"):
        arm.jog_freespace(np.zeros(5), np.ones(5), True)


def trajectory(node: Any, arm: Any, points: list[tuple[float, list[float]]], tolerance: float = 0.0) -> Any:
    kind = "com.robotraconteur.robotics.trajectory"
    found = node.NewStructure(f"{kind}.JointTrajectory", arm)
    found.joint_names = list(JOINT_NAMES)
    waypoints = []
    for at, q in points:
        point = node.NewStructure(f"{kind}.JointTrajectoryWaypoint", arm)
        point.joint_position = np.array(q)
        point.position_tolerance = np.full(6, tolerance) if tolerance else np.zeros(0)
        point.time_from_start = at
        waypoints.append(point)
    found.waypoints = waypoints
    return found


def rest_of(generator: Any) -> list[Any]:
    """Return all values of a generator."""
    found = []
    with contextlib.suppress(RR.StopIterationException):
        while True:
            found.append(generator.Next())
    return found


def test_trajectory_reports_progress_until_complete(arm: Any, node: Any, robot: urlink.Robot) -> None:
    far = [0.5, *START[1:]]
    arm.command_mode = modes(node, arm)["trajectory"]
    running = arm.execute_trajectory(trajectory(node, arm, [(0.0, START), (0.5, [0.25, *START[1:]]), (1.0, far)]))
    codes = node.GetConstants("com.robotraconteur.action", arm)["ActionStatusCode"]
    told = rest_of(running)
    assert [each.action_status for each in told] == [codes["running"]] * (len(told) - 1) + [codes["complete"]]
    assert len(told) > 5
    times = [each.trajectory_time for each in told]
    assert times == sorted(times)
    assert robot.realtime.wait().q_actual == pytest.approx(far, abs=0.01)


def test_trajectory_ends_when_cancelled_invalid_or_off_its_path(
    arm: Any, node: Any, robot: urlink.Robot, urlink_controller: Controller
) -> None:
    far = [1.0, *START[1:]]
    arm.command_mode = modes(node, arm)["trajectory"]
    running = arm.execute_trajectory(trajectory(node, arm, [(0.0, START), (4.0, far)]))
    running.Next()
    until(lambda: newest(arm).trajectory_running and robot.realtime.wait().q_actual[0] > 0.05)
    running.Close()
    until(lambda: np.abs(robot.realtime.wait().qd_actual).max() < 1e-3)
    assert robot.realtime.wait().q_actual[0] < 0.9
    here = robot.realtime.wait().q_target.tolist()
    strict = arm.execute_trajectory(
        trajectory(
            node, arm, [(0.0, here), (0.25, [here[0] + 0.1, *here[1:]]), (0.5, [here[0] + 0.2, *here[1:]])], 1e-5
        )
    )
    with pytest.raises(RR.OperationFailedException, match="ToleranceExceeded"):
        rest_of(strict)
    wrong = trajectory(node, arm, [(0.0, START), (1.0, far)])
    wrong.joint_names = ["a"] * 6
    with pytest.raises(RR.InvalidArgumentException, match="joint_names"):
        arm.execute_trajectory(wrong)


def test_position_commands_by_wire_move_arm(arm: Any, node: Any, robot: urlink.Robot) -> None:
    arm.command_mode = modes(node, arm)["position_command"]
    flags = node.GetConstants(ROBOT, arm)["RobotStateFlags"]
    wire = arm.position_command.Connect()
    here = np.array(robot.realtime.wait().q_target)
    seen = 0
    for number in range(150):
        command = node.NewStructure(f"{ROBOT}.RobotJointCommand", arm)
        command.seqno = number + 1
        command.command = here + np.array([0.002 * number, 0, 0, 0, 0, 0])
        wire.OutValue = command
        seen |= newest(arm).robot_state_flags
        time.sleep(0.01)
    until(lambda: robot.realtime.wait().q_actual[0] > here[0] + 0.2, 2.0)
    assert seen & flags["valid_position_command"]
    # Without further commands, the arm stops.
    until(lambda: robot.motion.current is None)
    wire.Close()


def test_velocity_commands_by_wire_move_arm(arm: Any, node: Any, robot: urlink.Robot) -> None:
    arm.command_mode = modes(node, arm)["velocity_command"]
    wire = arm.velocity_command.Connect()
    before = robot.realtime.wait().q_actual[0]
    fastest = 0.0
    for number in range(60):
        command = node.NewStructure(f"{ROBOT}.RobotJointCommand", arm)
        command.seqno = number + 1
        command.command = np.array([0.2, 0, 0, 0, 0, 0])
        wire.OutValue = command
        fastest = max(fastest, robot.realtime.wait().qd_actual[0])
        time.sleep(0.02)
    assert fastest == pytest.approx(0.2, abs=0.02)
    until(lambda: abs(robot.realtime.wait().qd_actual[0]) < 1e-3)
    assert robot.realtime.wait().q_actual[0] > before + 0.1


def test_client_homes_arm_and_sets_signals_speed_and_payload(arm: Any, node: Any, robot: urlink.Robot) -> None:
    arm.command_mode = modes(node, arm)["homing"]
    rest_of(arm.home())
    assert robot.realtime.wait().q_actual == pytest.approx(HOME, abs=1e-3)
    arm.setf_signal("digital_out_2", np.array([1.0]))
    assert arm.getf_signal("digital_out_2").tolist() == [1.0]
    assert robot.io.digital_out(2)
    with pytest.raises(RR.InvalidArgumentException, match="unknown signal"):
        arm.getf_signal("steam_whistle")
    arm.speed_ratio = 0.5
    until(lambda: arm.speed_ratio == pytest.approx(0.5, abs=0.01))
    arm.speed_ratio = 1.0
    payload = node.NewStructure("com.robotraconteur.robotics.payload.PayloadInfo", arm)
    payload.device_info = arm.device_info
    payload.inertia = np.zeros((1,), node.GetNamedArrayDType("com.robotraconteur.geometry.SpatialInertia", arm))
    payload.inertia[0]["m"] = 1.5
    payload.inertia[0]["com"]["x"] = 0.02
    pose = np.zeros((1,), node.GetNamedArrayDType("com.robotraconteur.geometry.Pose", arm))
    # a quarter turn about z
    pose[0]["orientation"]["w"] = pose[0]["orientation"]["z"] = math.sqrt(0.5)
    pose[0]["position"]["z"] = 0.1
    changed: list[tuple[int, str]] = []
    arm.payload_changed += lambda chain, name: changed.append((chain, name))
    arm.payload_attached(0, payload, pose)
    state = robot.realtime.wait_until(lambda state: state.payload_mass == pytest.approx(1.5))
    assert state.payload_cog is not None
    assert state.payload_cog.tolist() == pytest.approx([0.0, 0.02, 0.1])
    until(lambda: changed == [(0, "arm")])


def test_client_enables_disables_and_resets_the_arm(
    arm: Any, node: Any, robot: urlink.Robot, urlink_controller: Controller
) -> None:
    states = node.GetConstants(ROBOT, arm)["RobotControllerState"]
    urlink_controller.faults.protective_stop()
    until(lambda: arm.controller_state == states["guard_stop"])
    assert "protective stop" in arm.current_errors[0].message
    with pytest.raises(RR.OperationFailedException, match="SafetyStop"):
        arm.command_mode = modes(node, arm)["jog"]
    until(lambda: _works(arm.reset_errors), 15.0)  # the controller refuses within five seconds of the stop
    until(lambda: arm.controller_state == states["motor_on"])
    arm.disable()
    until(lambda: arm.controller_state == states["motor_off"], 15.0)
    arm.enable()
    until(lambda: arm.controller_state == states["motor_on"], 15.0)
    arm.command_mode = modes(node, arm)["jog"]
    arm.jog_freespace(np.array(START), np.full(6, 0.5), True)


def _works(call: Any) -> bool:
    try:
        call()
    except RR.OperationFailedException:
        return False
    return True


def test_lost_client_ends_motion_and_subscription_reconnects(
    robot: urlink.Robot, urlink_controller: Controller
) -> None:
    found: list[Any] = []
    lost: list[Any] = []
    with client_node() as watching:
        with open_node("test.arm", 0, announce=False) as (server, port):
            url = f"rr+tcp://localhost:{port}?service=arm"
            service = register(server, "arm", robot)
            subscription = watching.SubscribeService(url)
            subscription.ClientConnected += lambda _, key, client: found.append(client)
            subscription.ClientDisconnected += lambda _, key, client: lost.append(client)
            wire = subscription.SubscribeWire("robot_state")
            until(lambda: wire.TryGetInValue()[0])
            with client_node() as moving:
                arm = moving.ConnectService(url)
                other = watching.ConnectService(url)
                arm.command_mode = modes(moving, arm)["jog"]
                arm.jog_freespace(np.array([1.5, *START[1:]]), np.full(6, 0.1), False)
                with pytest.raises(RR.InvalidOperationException, match="another client"):
                    other.jog_joint(np.full(6, 0.1), 0.5, False)
                until(lambda: np.abs(robot.realtime.wait().qd_actual).max() > 0.05)
            until(lambda: np.abs(robot.realtime.wait().qd_actual).max() < 1e-3)
            assert robot.realtime.wait().q_actual[0] < 1.4
            assert other.command_mode == modes(watching, other)["halt"]
            # The robot disappears and comes back, while the client stays connected.
            flag = watching.GetConstants(ROBOT, other)["RobotStateFlags"]["communication_failure"]
            urlink_controller.faults.stall(600.0)
            until(lambda: newest(other).robot_state_flags & flag, 10.0)
            urlink_controller.faults.stall(0.01)  # replaces the other stall
            until(lambda: not newest(other).robot_state_flags & flag, 30.0)
            service.close()
            server.CloseService("arm")
            until(lambda: lost, 20.0)
            seen = len(found)
            service = register(server, "arm", robot)
            until(lambda: len(found) > seen, 20.0)
            until(lambda: wire.TryGetInValue()[0])
            service.close()
        subscription.Close()


def suspend(process: subprocess.Popen[str]) -> None:
    """Suspend a process and wait until it has stopped, because the signal takes effect later."""
    process.send_signal(signal.SIGSTOP)
    os.waitpid(process.pid, os.WUNTRACED)


@contextlib.contextmanager
def running(address: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run a server in a separate process, and yield the process and its URL."""
    options = (f"arm={address}", "--port", "0", "--no-announce")
    process = subprocess.Popen(
        [sys.executable, "-c", "import sys, urlink.cli; sys.exit(urlink.cli.main())", "serve", "rr", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "serving arm over rr; Ctrl-C ends it\n"
        yield process, process.stderr.readline().split()[-1]
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.communicate()


@pytest.mark.parametrize("what", ["jog", "mode and jog", "trajectory", "velocity_command", "position_command"])
def test_commands_sent_to_suspended_server_do_not_move_arm(
    robot: urlink.Robot, urlink_controller: Controller, node: Any, what: str
) -> None:
    far = np.array([0.5, *START[1:]])
    with running(urlink_controller.address) as (server, url):
        arm = node.ConnectService(url)
        known = modes(node, arm)
        if what != "mode and jog":
            arm.command_mode = known[what]
        wire = getattr(arm, what).Connect() if what.endswith("_command") else None
        goal = None if what != "trajectory" else trajectory(node, arm, [(0.0, START), (1.0, far.tolist())])
        generator = None if goal is None else arm.execute_trajectory(goal)
        node.RequestTimeout = 1
        suspend(server)
        suspended = time.monotonic()
        try:
            if wire is not None:
                for number in range(20):
                    command = node.NewStructure(f"{ROBOT}.RobotJointCommand", arm)
                    command.seqno = number + 1
                    command.command = far if what == "position_command" else np.array([0.2, 0, 0, 0, 0, 0])
                    wire.OutValue = command
            else:
                if what == "mode and jog":
                    with pytest.raises(RR.RequestTimeoutException):
                        arm.command_mode = known["jog"]
                with pytest.raises(RR.RequestTimeoutException):
                    arm.jog_freespace(far, np.full(6, 0.5), False) if generator is None else generator.Next()
            until(lambda: time.monotonic() > suspended + 3.0)
        finally:
            server.send_signal(signal.SIGCONT)
            node.RequestTimeout = 15
        begun = time.monotonic()
        while time.monotonic() < begun + 3.0:
            assert np.abs(robot.realtime.wait().qd_actual).max() < 1e-3
        assert robot.realtime.wait().q_actual == pytest.approx(START, abs=1e-2)
        assert arm.command_mode == known["halt"]
        # The halt is not permanent.
        arm.command_mode = known["jog"]
        arm.jog_freespace(far, np.full(6, 0.5), True)
        assert robot.realtime.wait().q_actual == pytest.approx(far, abs=1e-2)


def test_wire_command_with_old_state_number_is_ignored(arm: Any, node: Any, robot: urlink.Robot) -> None:
    arm.command_mode = modes(node, arm)["velocity_command"]
    wire = arm.velocity_command.Connect()
    until(lambda: newest(arm).seqno > 200)
    for number in range(40):
        command = node.NewStructure(f"{ROBOT}.RobotJointCommand", arm)
        command.seqno = number + 1
        command.state_seqno = newest(arm).seqno - 180
        command.command = np.array([0.2, 0, 0, 0, 0, 0])
        wire.OutValue = command
        assert np.abs(robot.realtime.wait().qd_actual).max() < 1e-3
        time.sleep(0.01)
    until(lambda: _moves(arm, node, robot, wire))


def _moves(arm: Any, node: Any, robot: urlink.Robot, wire: Any) -> bool:
    command = node.NewStructure(f"{ROBOT}.RobotJointCommand", arm)
    state = newest(arm)
    command.seqno = state.seqno
    command.state_seqno = state.seqno
    command.command = np.array([0.2, 0, 0, 0, 0, 0])
    wire.OutValue = command
    return bool(robot.realtime.wait().qd_actual[0] > 0.05)


def test_invalid_wire_command_does_not_end_wire_mode(arm: Any, node: Any, robot: urlink.Robot) -> None:
    arm.command_mode = modes(node, arm)["velocity_command"]
    wire = arm.velocity_command.Connect()
    command = node.NewStructure(f"{ROBOT}.RobotJointCommand", arm)
    command.seqno = 1
    command.command = np.zeros(5)
    wire.OutValue = command
    until(lambda: arm.velocity_command is not None and robot.motion.current is None)
    began = newest(arm).seqno
    until(lambda: newest(arm).seqno > began + 60)
    until(lambda: _moves(arm, node, robot, wire))


def test_read_only_robot_accepts_no_commands(urlink_controller: Controller, node: Any) -> None:
    with (
        urlink.connect(urlink_controller.address, read_only=True) as robot,
        serve({"arm": robot}, port=0, announce=False) as port,
    ):
        arm = node.ConnectService(f"rr+tcp://localhost:{port}?service=arm")
        until(lambda: newest(arm).seqno > 10)
        assert arm.robot_info.robot_capabilities == 0
        with pytest.raises(RR.InvalidOperationException, match="cannot be commanded"):
            arm.command_mode = modes(node, arm)["jog"]
        with pytest.raises(RR.InvalidOperationException, match="cannot be commanded"):
            arm.setf_signal("digital_out_0", np.array([1.0]))


def test_rhd_variables_are_served_as_wires(node: Any) -> None:
    with (
        rhdlink.Host([Turtle()], port=0) as host,
        rhdlink.connect(f"127.0.0.1:{host.port}", access="w") as robot,
        robot.background(),
        open_node("test.rhd", 0, announce=False) as (server, port),
    ):
        service = register_rhd(server, "turtle", robot)
        url = f"rr+tcp://localhost:{port}?service=turtle"
        turtle = node.ConnectService(url)
        way = turtle.transpos.Connect()
        with client_node() as moving:
            driver = moving.ConnectService(url)
            speed = driver.command_cmdtransvel.Connect()
            speed.OutValue = np.array([30000], np.int32)
            until(lambda: way.InValueValid and way.InValue[0] > 500)
            assert turtle.connected.PeekInValue()[0] == 1
        # The client that set the speed is lost.
        until(lambda: robot["cmdtransvel"] == 0)
        service.close()


_RHD = """
import sys, rhdlink
from urlink_rr import open_node, register_rhd
with (
    rhdlink.connect(sys.argv[1], access="w") as robot,
    robot.background(),
    open_node("test.rhd", 0, announce=False) as (node, port),
):
    service = register_rhd(node, "turtle", robot)
    print(port, flush=True)
    sys.stdin.read()
"""


def test_rhd_value_sent_to_suspended_server_is_not_written(node: Any) -> None:
    with rhdlink.Host([Turtle()], port=0) as host:
        process = subprocess.Popen(
            [sys.executable, "-c", _RHD, f"127.0.0.1:{host.port}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout is not None
            url = f"rr+tcp://localhost:{process.stdout.readline().strip()}?service=turtle"
            turtle = node.ConnectService(url)
            way, speed = turtle.transpos.Connect(), turtle.command_cmdtransvel.Connect()
            until(lambda: way.InValueValid)
            suspend(process)
            suspended = time.monotonic()
            speed.OutValue = np.array([30000], np.int32)
            until(lambda: time.monotonic() > suspended + 3.0)
            process.send_signal(signal.SIGCONT)
            until(lambda: turtle.connected.PeekInValue()[0] == 1, 20.0)
            begun = time.monotonic()
            while time.monotonic() < begun + 3.0:
                assert way.InValue[0] == 0
                time.sleep(0.01)
            # The rejection is not permanent.
            speed.OutValue = np.array([30000], np.int32)
            until(lambda: way.InValue[0] > 500)
        finally:
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.communicate()


def test_command_line_serves_robot_until_terminated(node: Any) -> None:
    options = ("arm=sim://ur5e", "--port", "0", "--no-announce")
    process = subprocess.Popen(
        [sys.executable, "-c", "import sys, urlink.cli; sys.exit(urlink.cli.main())", "serve", "rr", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "serving arm over rr; Ctrl-C ends it\n"
        url = process.stderr.readline().split()[-1]
        assert node.ConnectService(url).robot_info.device_info.model.name == "UR5e"
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 128 + signal.SIGTERM
    finally:
        process.kill()
        process.communicate()
