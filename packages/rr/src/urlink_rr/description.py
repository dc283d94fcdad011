"""Description of a robot in the structures of Robot Raconteur."""

from __future__ import annotations

import uuid
from typing import Any

import numpy as np

from urlink import Robot
from urlink.arm import poses
from urlink.arm.kinematics import Arm
from urlink.arm.urdf import JOINTS as JOINT_NAMES

__all__ = ["CAPABILITIES", "HOME", "pose_array", "robot_info"]

#: Target of `home`, in rad: the upright posture on the vendor's pendant.
HOME = (0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0)

#: Names of `RobotCapabilities` that the service supports.
CAPABILITIES = (
    "jog_command",
    "trajectory_command",
    "position_command",
    "velocity_command",
    "homing_command",
    "software_reset_errors",
    "software_enable",
    "interpolated_trajectory",
    "speed_ratio",
)

_ROBOT = "com.robotraconteur.robotics.robot"
_JOINTS = "com.robotraconteur.robotics.joints"
_GEOMETRY = "com.robotraconteur.geometry"


def pose_array(node: Any, pose: Any) -> Any:
    """Convert a pose of six numbers (m and rotation vector) to the structure `Pose`."""
    found = np.zeros((1,), node.GetNamedArrayDType(f"{_GEOMETRY}.Pose"))
    vector = np.asarray(pose, dtype=np.float64)
    found[0]["position"] = tuple(vector[:3])
    # By name: in the structure, w is the first component; in `urlink.poses`, it is the last.
    for axis, value in zip("xyzw", poses.rotvec_to_quaternion(vector[3:]).tolist(), strict=True):
        found[0]["orientation"][axis] = value
    return found


def robot_info(node: Any, name: str, robot: Robot, is_commanded: bool) -> Any:
    """Return the structure `RobotInfo`: joints with limits, and the kinematics of this arm."""
    arm = robot.kinematics
    constants = node.GetConstants(_ROBOT)
    info = node.NewStructure(f"{_ROBOT}.RobotInfo")
    info.device_info = _device_info(node, name, robot)
    info.robot_type = constants["RobotTypeCode"]["serial"]
    info.joint_info = [_joint_info(node, arm, index) for index in range(6)]
    info.chains = [_chain(node, name, arm)]
    known = constants["RobotCapabilities"]
    info.robot_capabilities = sum(known[each] for each in CAPABILITIES) if is_commanded else 0
    modes = node.GetConstants("com.robotraconteur.robotics.trajectory")["InterpolationMode"]
    info.trajectory_interpolation_modes = [modes["default"], modes["joint"], modes["joint_cubic_spline"]]
    info.signal_info = []
    info.parameter_info = []
    return info


def identifier(node: Any, name: str, unique: uuid.UUID | None = None) -> Any:
    """Return the structure `Identifier`."""
    found = node.NewStructure("com.robotraconteur.identifier.Identifier")
    found.name = name
    found.uuid = np.zeros((1,), node.GetPodDType("com.robotraconteur.uuid.UUID"))
    if unique is not None:
        found.uuid[0]["uuid_bytes"] = np.frombuffer(unique.bytes, np.uint8)
    return found


def _device_info(node: Any, name: str, robot: Robot) -> Any:
    info = node.NewStructure("com.robotraconteur.device.DeviceInfo")
    # The same robot is the same device on every server.
    info.device = identifier(node, name, uuid.uuid5(uuid.NAMESPACE_URL, f"urlink:{name}:{robot.address}"))
    info.manufacturer = identifier(node, "Universal Robots")
    info.model = identifier(node, robot.model or "")
    info.options = []
    info.capabilities = []
    info.device_classes = []
    info.serial_number = ""
    info.user_description = f"{robot.model}, firmware {robot.firmware}, at {robot.address}"
    info.implemented_types = [f"{_ROBOT}.Robot"]
    return info


def _joint_info(node: Any, arm: Arm, index: int) -> Any:
    constants = node.GetConstants(_JOINTS)
    info = node.NewStructure(f"{_JOINTS}.JointInfo")
    info.joint_identifier = identifier(node, JOINT_NAMES[index])
    low, high = arm.position_limits[index].tolist()
    info.joint_type = constants["JointType"]["revolute" if np.isfinite(low + high) else "continuous"]
    limits = node.NewStructure(f"{_JOINTS}.JointLimits")
    limits.lower, limits.upper, limits.home = low, high, HOME[index]
    limits.velocity = limits.reduced_velocity = float(arm.model.max_speed[index])
    limits.acceleration = limits.reduced_acceleration = float(arm.model.max_acceleration[index])
    limits.effort = limits.reduced_effort = float(arm.model.max_torque[index])
    info.joint_limits = limits
    info.default_units = constants["JointPositionUnits"]["radian"]
    info.default_effort_units = constants["JointEffortUnits"]["ampere"]
    info.passive = False
    return info


def _chain(node: Any, name: str, arm: Arm) -> Any:
    """Return axes and offsets of the joints in the base frame, with all joints at zero."""
    frames = arm.frames(np.zeros(6))
    chain = node.NewStructure(f"{_ROBOT}.RobotKinChainInfo")
    chain.kin_chain_identifier = identifier(node, name)
    vector = node.GetNamedArrayDType(f"{_GEOMETRY}.Vector3")
    chain.H = _rows(frames[:6, :3, 2], vector)
    chain.P = _rows(np.diff(frames[:, :3, 3], axis=0, prepend=np.zeros((1, 3))), vector)
    chain.link_inertias = np.zeros((0,), node.GetNamedArrayDType(f"{_GEOMETRY}.SpatialInertia"))
    chain.link_identifiers = [identifier(node, f"{joint}_link") for joint in JOINT_NAMES]
    chain.link_fiducials = []
    chain.joint_numbers = np.arange(6, dtype=np.uint32)
    chain.flange_identifier = identifier(node, "flange")
    # With all joints at zero, H and P define the origin of the flange, and this pose defines its orientation.
    chain.flange_pose = pose_array(node, [0.0, 0.0, 0.0, *poses.matrix_to_rotvec(frames[6, :3, :3])])
    for limit in ("velocity", "acceleration"):
        dtype = node.GetNamedArrayDType(f"{_GEOMETRY}.Spatial{limit.capitalize()}")
        setattr(chain, f"tcp_max_{limit}", np.zeros((1,), dtype))
        setattr(chain, f"tcp_reduced_max_{limit}", np.zeros((1,), dtype))
    chain.description = arm.model.name
    return chain


def _rows(values: Any, dtype: Any) -> Any:
    found = np.zeros((len(values),), dtype)
    for row, value in zip(found, values, strict=True):
        row["x"], row["y"], row["z"] = value
    return found
