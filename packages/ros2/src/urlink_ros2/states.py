"""States of a robot as ROS 2 messages."""

from __future__ import annotations

import contextlib
from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, String, UInt32

from urlink import LocalError, Robot
from urlink.arm import poses
from urlink.arm.urdf import to_urdf
from urlink.packets import ProgramState, RealtimeState

__all__ = ["LATCHED", "STREAMED", "StatePublishers"]

#: The system default, with which the broadcasters of the vendor's ROS 2 driver publish.
STREAMED = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
#: For values that change seldom: a late subscriber receives the newest value.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class StatePublishers:
    """Published topics of one robot.

    The topics have the names of the vendor's ROS 2 driver if the message types are the same.

    Args:
        node: Node that publishes.
        joints: Names of the joints.
        base: Name of the base frame, in which poses and forces are published.
    """

    def __init__(self, node: Any, joints: list[str], base: str) -> None:
        self._node = node
        self._joints = node.create_publisher(JointState, "joint_states", STREAMED)
        self._pose = node.create_publisher(PoseStamped, "tcp_pose_broadcaster/pose", STREAMED)
        self._wrench = node.create_publisher(WrenchStamped, "force_torque_sensor_broadcaster/wrench", STREAMED)
        self._scaling = node.create_publisher(Float64, "speed_scaling_state_broadcaster/speed_scaling", STREAMED)
        status = "io_and_status_controller"
        self._seldom = {
            name: node.create_publisher(kind, f"{status}/{name}", LATCHED)
            for name, kind in (
                ("robot_mode", String),
                ("safety_mode", String),
                ("robot_program_running", Bool),
                ("digital_inputs", UInt32),
                ("digital_outputs", UInt32),
                ("refusal", String),
            )
        }
        self._description = node.create_publisher(String, "robot_description", LATCHED)
        self._told: dict[str, Any] = {}
        self._joint_state = JointState(name=joints)
        self._pose_stamped = PoseStamped()
        self._pose_stamped.header.frame_id = base
        self._wrench_stamped = WrenchStamped()
        # The controller reports the force along the axes of its base, with moments about the TCP.
        self._wrench_stamped.header.frame_id = base

    def describe(self, robot: Robot) -> None:
        """Publish the arm as URDF with simple shapes; publish nothing if the model is unknown."""
        with contextlib.suppress(LocalError):
            self._description.publish(String(data=to_urdf(robot.kinematics, shapes=True)))

    def publish(self, state: RealtimeState) -> None:
        """Publish joints, tool, force and speed scaling; the stamp is the arrival time of the state."""
        stamp = state.received
        if stamp is None:
            return
        whole = int(stamp.wall)
        nanoseconds = int((stamp.wall - whole) * 1e9)
        for message in (self._joint_state, self._pose_stamped, self._wrench_stamped):
            message.header.stamp.sec, message.header.stamp.nanosec = whole, nanoseconds
        self._joint_state.position = state.q_actual.tolist()
        self._joint_state.velocity = state.qd_actual.tolist()
        # currents, as in the vendor's driver
        self._joint_state.effort = state.I_actual.tolist()
        self._joints.publish(self._joint_state)
        pose, tool = state.tool_vector_actual.tolist(), self._pose_stamped.pose
        tool.position.x, tool.position.y, tool.position.z = pose[:3]
        turned = tool.orientation
        turned.w, turned.x, turned.y, turned.z = poses.rotvec_to_quaternion(pose[3:]).tolist()
        self._pose.publish(self._pose_stamped)
        wrench = state.tcp_force.tolist()
        force, torque = self._wrench_stamped.wrench.force, self._wrench_stamped.wrench.torque
        force.x, force.y, force.z = wrench[:3]
        torque.x, torque.y, torque.z = wrench[3:]
        self._wrench.publish(self._wrench_stamped)
        if state.speed_scaling is not None:
            # in percent, as in the vendor's driver
            self._scaling.publish(Float64(data=100.0 * state.speed_scaling))

    def publish_changes(self, state: RealtimeState | None, refusal: str) -> None:
        """Publish the values that change seldom, if they have changed.

        Args:
            state: Newest state; None if none has arrived, or if it is too old.
            refusal: Reason why a motion would be refused; "" if it would not.
        """
        self._tell("refusal", refusal)
        if state is None:
            self._tell("robot_mode", "DISCONNECTED")
            self._tell("robot_program_running", False)
            return
        if state.robot_mode is not None:
            self._tell("robot_mode", str(state.robot_mode.name))
        if state.safety_mode is not None:
            self._tell("safety_mode", str(state.safety_mode.name))
        if state.program_state is not None:
            self._tell("robot_program_running", state.program_state == ProgramState.PLAYING)
        self._tell("digital_inputs", state.digital_input_bits & 0xFFFFFFFF)
        if state.digital_output_bits is not None:
            self._tell("digital_outputs", state.digital_output_bits & 0xFFFFFFFF)

    def _tell(self, name: str, value: Any) -> None:
        if self._told.get(name) != value:
            self._told[name] = value
            publisher = self._seldom[name]
            publisher.publish(publisher.msg_type(data=value))
