"""ROS 2 node in a separate process, like the program of a user; it prints received data on stdout.

python driver.py listen SECONDS [NAMESPACE/ | joints]   print received values and their delay; or joint states only
python driver.py follow GOAL ...     send one or several goals, and print feedback and result as JSON lines
python driver.py give_up GOAL S      send a goal, and wait S seconds for its acceptance
python driver.py watch SECONDS       be a client of the action that sends nothing
python driver.py call SERVICE [on]   call a service
python driver.py send TOPIC JSON S   send a message 50 times per second for S seconds, after a subscriber exists
python driver.py describe            print a summary of robot_description
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rclpy
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, String, UInt32
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectoryPoint


def report(**what: Any) -> None:
    print(json.dumps(what), flush=True)


def seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def listen(node: Any, duration: str, namespace: str = "") -> None:
    """Print the last value of each topic, and the delay of joint states.

    The delay is measured with the clock that both processes share.
    """
    late: list[float] = []
    stamps: list[float] = []
    last: dict[str, Any] = {}
    counts: dict[str, int] = {}
    only_joints = namespace == "joints"
    namespace = "" if only_joints else namespace

    def joints(message: Any) -> None:
        stamp = seconds(message.header.stamp)
        late.append(time.time() - stamp)
        stamps.append(stamp)
        last["joints"] = [list(message.name), list(message.position), list(message.effort)]

    def other(name: str, value: Any) -> Any:
        def receive(message: Any) -> None:
            counts[name] = counts.get(name, 0) + 1
            last[name] = value(message)

        return receive

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(JointState, f"{namespace}joint_states", joints, 10)
    for kind, topic, value, qos in (
        (PoseStamped, "tcp_pose_broadcaster/pose", lambda m: [m.pose.position.x, m.pose.position.z], 10),
        (WrenchStamped, "force_torque_sensor_broadcaster/wrench", lambda m: m.wrench.force.z, 10),
        (Float64, "speed_scaling_state_broadcaster/speed_scaling", lambda m: m.data, 10),
        (String, "io_and_status_controller/robot_mode", lambda m: m.data, latched),
        (String, "io_and_status_controller/safety_mode", lambda m: m.data, latched),
        (String, "io_and_status_controller/refusal", lambda m: m.data, latched),
        (Bool, "io_and_status_controller/robot_program_running", lambda m: m.data, latched),
        (UInt32, "io_and_status_controller/digital_outputs", lambda m: m.data, latched),
    ):
        if only_joints:
            break
        node.create_subscription(kind, f"{namespace}{topic}", other(topic.partition("/")[2], value), qos)
    found = time.monotonic() + 20.0  # maximum time for discovery
    while not stamps and not last and time.monotonic() < found:
        rclpy.spin_once(node, timeout_sec=0.1)
    end = time.monotonic() + float(duration)
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    late.sort()
    span = max(stamps) - min(stamps) if len(stamps) > 1 else 0.0
    report(
        count=len(stamps),
        first=min(stamps, default=None),
        newest=max(stamps, default=None),
        rate=(len(stamps) - 1) / span if span else 0.0,
        late_p50=late[len(late) // 2] if late else None,
        late_p99=late[int(len(late) * 0.99)] if late else None,
        last=last,
        counts=counts,
    )


def goal_of(node: Any, wanted: dict[str, Any]) -> Any:
    """Convert a goal from JSON to a message; `stamp` is the stamp of its header, in s from now."""
    message = FollowJointTrajectory.Goal()
    message.trajectory.joint_names = wanted["joints"]
    for at, q in wanted["points"]:
        point = JointTrajectoryPoint(positions=q)
        point.time_from_start.sec, point.time_from_start.nanosec = int(at), int(at % 1.0 * 1e9)
        message.trajectory.points.append(point)
    if "path_tolerance" in wanted:
        message.path_tolerance = [
            JointTolerance(name=name, position=wanted["path_tolerance"]) for name in wanted["joints"]
        ]
    if "stamp" in wanted:
        message.trajectory.header.stamp = (node.get_clock().now() + Duration(seconds=wanted["stamp"])).to_msg()
    return message


def several(node: Any, client: Any, wanted: dict[str, Any]) -> None:
    """Send several goals without waiting in between, and print the result of each."""
    sent = [client.send_goal_async(goal_of(node, each)) for each in wanted["goals"]]
    results = []
    for future in sent:
        rclpy.spin_until_future_complete(node, future, timeout_sec=20.0)
        results.append(future.result().get_result_async())
    for future in results:
        rclpy.spin_until_future_complete(node, future, timeout_sec=60.0)
    report(results=[[each.result().status, each.result().result.error_code] for each in results])


def give_up(node: Any, goal: str, patience: str) -> None:
    """Send a goal when a line arrives on stdin, and wait `patience` seconds for its acceptance.

    Then stay connected without its result.
    """
    name = "scaled_joint_trajectory_controller/follow_joint_trajectory"
    client = ActionClient(node, FollowJointTrajectory, name)
    assert client.wait_for_server(30.0)
    power = node.create_client(Trigger, "dashboard_client/brake_release")
    assert power.wait_for_service(30.0)
    report(ready=True)
    sys.stdin.readline()
    sent = client.send_goal_async(goal_of(node, json.loads(goal)))
    called = power.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, sent, timeout_sec=float(patience))
    report(answered=sent.done())
    sys.stdin.readline()
    rclpy.spin_until_future_complete(node, sent, timeout_sec=30.0)
    rclpy.spin_until_future_complete(node, called, timeout_sec=30.0)
    report(accepted=sent.result().accepted, called=called.result().success, text=called.result().message)


def watch(node: Any, duration: str) -> None:
    """Be a client of the action that sends nothing, like MoveIt."""
    client = ActionClient(node, FollowJointTrajectory, "scaled_joint_trajectory_controller/follow_joint_trajectory")
    assert client.wait_for_server(30.0)
    report(ready=True)
    end = time.monotonic() + float(duration)
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)


def follow(node: Any, goal: str, when: str = "", namespace: str = "") -> None:
    """Follow a goal in JSON; `when` is "cancel", "die" or "stay" after its first feedback."""
    told: list[Any] = []
    client = ActionClient(
        node, FollowJointTrajectory, f"{namespace}scaled_joint_trajectory_controller/follow_joint_trajectory"
    )
    assert client.wait_for_server(10.0)
    wanted = json.loads(goal)
    if "goals" in wanted:
        several(node, client, wanted)
        return
    message = goal_of(node, wanted)
    sent = client.send_goal_async(message, feedback_callback=lambda f: told.append(f.feedback))
    rclpy.spin_until_future_complete(node, sent, timeout_sec=10.0)
    handle = sent.result()
    if not handle.accepted:
        report(accepted=False)
        return
    result = handle.get_result_async()
    if when:
        while not told:
            rclpy.spin_once(node, timeout_sec=0.1)
        report(moving=True)
    if when == "die":
        time.sleep(60.0)
    if when == "cancel":
        rclpy.spin_until_future_complete(node, handle.cancel_goal_async(), timeout_sec=10.0)
    rclpy.spin_until_future_complete(node, result, timeout_sec=30.0)
    found = result.result()
    report(
        accepted=True,
        status=found.status,
        code=found.result.error_code,
        text=found.result.error_string,
        feedback=len(told),
        early=sum(seconds(each.desired.time_from_start) == 0.0 for each in told),
        stamp=seconds(message.trajectory.header.stamp),
        names=list(told[-1].joint_names) if told else None,
        actual=list(told[-1].actual.positions) if told else None,
    )


def call(node: Any, service: str, on: str = "") -> None:
    """Call a service: `SetBool` if `on` is given, otherwise `Trigger`."""
    kind = SetBool if on else Trigger
    client = node.create_client(kind, service)
    assert client.wait_for_service(10.0)
    request = kind.Request(data=on == "on") if on else kind.Request()
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=30.0)
    report(success=future.result().success, message=future.result().message)


def send(node: Any, topic: str, value: str, duration: str) -> None:
    """Send numbers, a Boolean or a text."""
    data = json.loads(value)
    kind = Bool if isinstance(data, bool) else String if isinstance(data, str) else Float64MultiArray
    publisher = node.create_publisher(kind, topic, 10)
    found = time.monotonic() + 20.0
    while not publisher.get_subscription_count() and time.monotonic() < found:
        rclpy.spin_once(node, timeout_sec=0.05)
    end = time.monotonic() + float(duration)
    sent = 0
    while sent == 0 or time.monotonic() < end:
        publisher.publish(kind(data=data))
        sent += 1
        time.sleep(0.02)
    publisher.wait_for_all_acked(Duration(seconds=5.0))
    report(sent=sent)


def describe(node: Any) -> None:
    """Print a summary of the URDF: its number of joints, and whether it has a robot."""
    said: list[str] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(String, "robot_description", lambda message: said.append(message.data), latched)
    found = time.monotonic() + 20.0
    while not said and time.monotonic() < found:
        rclpy.spin_once(node, timeout_sec=0.1)
    report(joints=said[0].count("<joint "), robot="<robot " in said[0])


if __name__ == "__main__":
    rclpy.init()
    try:
        task: Any = {
            "listen": listen,
            "follow": follow,
            "call": call,
            "give_up": give_up,
            "watch": watch,
            "send": send,
            "describe": describe,
        }[sys.argv[1]]
        task(rclpy.create_node("driver"), *sys.argv[2:])
    finally:
        rclpy.shutdown()
