"""Conversion of recorded packets to ROS 2 messages, with the definitions of the message types.

Joint states, poses, twists, wrenches and logs have the standard types, which every viewer supports. In addition, each
complete packet becomes a message. The fields of its stream define the type of this message.

`JointState.effort` contains the joint currents in A, as in the vendor's ROS driver. Poses, twists and wrenches are not
converted: the controller reports them in the base frame, and wrenches about the TCP.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from linkcore.recording.mcap_file import HEADER, TIME, Message, Topic, definition, table_topic
from linkcore.recording.table import Table
from linkcore.wire.packet import State

from ..arm.kinematics import Arm
from ..arm.poses import rotvec_to_quaternion
from ..arm.urdf import JOINTS, link_poses, to_urdf
from ..protocol.enums import ReportLevel
from ..protocol.primary.robot_message import KeyMessage, PopupMessage, RobotCommMessage, RuntimeExceptionMessage

_FRAME = "base_link"

_VECTOR = "geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z"
_POINT = "geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z"
_QUATERNION = "geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"
_POSE = "geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"
_TWIST = "geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular"
_WRENCH = "geometry_msgs/Wrench", "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque"


_STAMPED = "std_msgs/Header header\n"
_DEFINITIONS = {
    "sensor_msgs/msg/JointState": definition(
        f"{_STAMPED}string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort", HEADER, TIME
    ),
    "geometry_msgs/msg/PoseStamped": definition(
        f"{_STAMPED}geometry_msgs/Pose pose", HEADER, TIME, _POSE, _POINT, _QUATERNION
    ),
    "geometry_msgs/msg/TwistStamped": definition(f"{_STAMPED}geometry_msgs/Twist twist", HEADER, TIME, _TWIST, _VECTOR),
    "geometry_msgs/msg/WrenchStamped": definition(
        f"{_STAMPED}geometry_msgs/Wrench wrench", HEADER, TIME, _WRENCH, _VECTOR
    ),
    "rcl_interfaces/msg/Log": definition(
        "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\nbuiltin_interfaces/Time stamp\n"
        "uint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line",
        TIME,
    ),
    "std_msgs/msg/String": "string data",
    "tf2_msgs/msg/TFMessage": definition(
        "geometry_msgs/TransformStamped[] transforms",
        ("geometry_msgs/TransformStamped", f"{_STAMPED}string child_frame_id\ngeometry_msgs/Transform transform"),
        HEADER,
        TIME,
        ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"),
        _VECTOR,
        _QUATERNION,
    ),
}

#: Names of the same quantity in the real-time interface and in RTDE.
_POSITION, _VELOCITY, _CURRENT = ("q_actual", "actual_q"), ("qd_actual", "actual_qd"), ("I_actual", "actual_current")
_TCP_POSE, _TCP_SPEED = ("tool_vector_actual", "actual_TCP_pose"), ("tcp_speed_actual", "actual_TCP_speed")
_TCP_FORCE = ("tcp_force", "actual_TCP_force")

_INFO, _WARN, _ERROR, _FATAL = 20, 30, 40, 50
_LEVELS = {
    ReportLevel.WARNING: _WARN,
    ReportLevel.VIOLATION: _ERROR,
    ReportLevel.FAULT: _FATAL,
    ReportLevel.CRITICAL: _FATAL,
}


def topics_of(name: str, table: Table, arm: Arm | None) -> Iterator[Topic]:
    """Yield the topics of the stream `name`. Topics without their fields in the table, and text fields, are skipped.

    If `arm` is given, the topic `/tf` contains the frames of its links.
    """
    wall = table.wall

    def column(names: Sequence[str]) -> NDArray[np.float64] | None:
        found = next((each for each in names if each in table), None)
        return None if found is None else table[found]

    nothing = np.empty((len(table), 0))
    position, velocity, current = column(_POSITION), column(_VELOCITY), column(_CURRENT)
    if position is not None:
        message = Message(len(table)).header(wall, "").texts(JOINTS).sequence(position)
        message.sequence(nothing if velocity is None else velocity)
        message.sequence(nothing if current is None else current)
        yield _topic("/joint_states", "sensor_msgs/msg/JointState", wall, message.encoded())
    if position is not None and arm is not None:
        frames = list(link_poses(arm, position))
        message = Message(len(table)).length(len(frames))
        for parent, child, poses in frames:
            message.header(wall, parent).text(child).numbers(poses[:, :3]).numbers(_orientation(poses))
        yield _topic("/tf", "tf2_msgs/msg/TFMessage", wall, message.encoded())
    if (pose := column(_TCP_POSE)) is not None:
        message = Message(len(table)).header(wall, _FRAME).numbers(pose[:, :3]).numbers(_orientation(pose))
        yield _topic("/tcp_pose", "geometry_msgs/msg/PoseStamped", wall, message.encoded())
    for path, kind, names in (
        ("/tcp_speed", "geometry_msgs/msg/TwistStamped", _TCP_SPEED),
        ("/wrench", "geometry_msgs/msg/WrenchStamped", _TCP_FORCE),
    ):
        if (six := column(names)) is not None:
            yield _topic(path, kind, wall, Message(len(table)).header(wall, _FRAME).numbers(six).encoded())
    if table.fields:
        yield table_topic(name, table, "urlink_msgs")


def _orientation(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternions of poses; NaN for a NaN pose.

    Resampled rows contain NaN poses for the time in which the connection was lost.
    """
    quaternions = rotvec_to_quaternion(np.nan_to_num(poses[:, 3:]))
    quaternions[np.isnan(poses[:, 3:]).any(axis=1)] = np.nan
    return quaternions


def log_topic(messages: Sequence[State], wall: NDArray[np.datetime64]) -> Topic:
    """Return a log topic with the messages of the controller."""
    encoded = []
    for message, stamp in zip(messages, wall, strict=True):
        one = Message(1).stamp(np.array([stamp])).numbers(np.array([_level(message)], np.uint8))
        source = getattr(getattr(message, "source", None), "name", "")
        one.text(str(source)).text(_words(message)).text("").text("").numbers(np.zeros(1, np.uint32))
        encoded += one.encoded()
    return _topic("/log", "rcl_interfaces/msg/Log", wall, encoded)


def _level(message: State) -> int:
    """Return the level of a message, as a number of `rcl_interfaces/msg/Log`."""
    if isinstance(message, RobotCommMessage):
        return _INFO if message.report_level is None else _LEVELS.get(message.report_level, _INFO)
    if isinstance(message, PopupMessage):
        return _ERROR if message.is_error else _WARN if message.is_warning else _INFO
    return _ERROR if isinstance(message, RuntimeExceptionMessage) else _INFO


def _words(message: State) -> str:
    if isinstance(message, RobotCommMessage):
        return f"C{message.code}A{message.argument}: {message.text}"
    if isinstance(message, (KeyMessage, PopupMessage)):
        return f"{message.title}: {message.text}"
    text = getattr(message, "text", None)
    # A reader written in C would interpret a NUL as the end of the text.
    return (text if isinstance(text, str) else str(message)).replace("\0", "")


def description_topic(arm: Arm, wall: np.datetime64) -> Topic:
    """Return a topic with one message, which contains the arm as URDF for viewers."""
    message = Message(1).text(to_urdf(arm, shapes=True))
    return _topic("/robot_description", "std_msgs/msg/String", np.array([wall]), message.encoded())


def _topic(path: str, kind: str, wall: NDArray[np.datetime64], messages: list[bytes]) -> Topic:
    return Topic(path, kind, _DEFINITIONS[kind], wall, messages)
