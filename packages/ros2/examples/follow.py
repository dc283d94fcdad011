"""Move an arm that `urlink serve ros2` serves a little, and back.

urlink serve ros2 sim://ur5e
python follow.py
"""

from __future__ import annotations

from typing import Any

import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("follow")
    states: list[Any] = []
    node.create_subscription(JointState, "joint_states", states.append, 1)
    while not states:
        rclpy.spin_once(node)
    here = list(states[-1].position)

    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = states[-1].name
    for seconds, q in ((1, [here[0] + 0.1, *here[1:]]), (2, here)):
        point = JointTrajectoryPoint(positions=q)
        point.time_from_start.sec = seconds
        goal.trajectory.points.append(point)

    client = ActionClient(node, FollowJointTrajectory, "scaled_joint_trajectory_controller/follow_joint_trajectory")
    client.wait_for_server()
    sent = client.send_goal_async(goal, feedback_callback=lambda told: print(told.feedback.actual.positions[0]))
    rclpy.spin_until_future_complete(node, sent)
    over = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, over)
    result = over.result().result
    print("done" if result.error_code == result.SUCCESSFUL else result.error_string)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
