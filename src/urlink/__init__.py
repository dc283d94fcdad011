"""Universal Robots arms without a middleware: typed state in, commands out.

    import urlink

    with urlink.connect("192.168.56.101") as robot:     # or "sim://", or "replay:///run.urlog"
        for state in robot.realtime:
            print(state.q_actual)

Importing it starts nothing and touches no network.
"""

from __future__ import annotations

from linkcore.backoff import Backoff
from linkcore.errors import (
    BadAddress,
    BadRecording,
    BadValue,
    BadVersion,
    Closed,
    ConnectFailed,
    ConnectionLost,
    LinkError,
    LinkTimeout,
    LocalError,
    PacketError,
    RemoteError,
    WrongPeer,
)
from linkcore.events import Chunk, ConnectionEvent, ConnectionState, Traffic
from linkcore.feed import Feed
from linkcore.packet import State
from linkcore.policy import Policy, block, drop_oldest, latest
from linkcore.recorder import Recorder
from linkcore.stamp import Stamp
from linkcore.stream import Stream
from linkcore.subscription import Subscription

from .decode import decode
from .firmware import Firmware
from .models import UnknownModel
from .robot import Robot, connect
from .schemas.enums import (
    AnalogDomain,
    ControlMode,
    DigitalBits,
    JointMode,
    MessageSource,
    MessageType,
    PackageType,
    ProgramState,
    ReportLevel,
    RobotMode,
    RobotModeCB2,
    RobotType,
    SafetyMode,
    ToolMode,
)
from .schemas.realtime import RealtimeState
from .schemas.robot_message import (
    KeyMessage,
    OtherPackage,
    PopupMessage,
    ProgramLabelMessage,
    ProgramStateMessage,
    RequestValueMessage,
    RobotCommMessage,
    RobotMessage,
    RuntimeExceptionMessage,
    SafetyComplianceTolerances,
    SafetyModeMessage,
    TextMessage,
    UnknownMessage,
    UnnamedMessage12,
    VersionMessage,
)
from .schemas.robot_state import (
    AdditionalInfo,
    CalibrationData,
    CartesianInfo,
    ConfigurationData,
    ForceModeData,
    JointData,
    KinematicsInfo,
    LaserPointer,
    MasterboardData,
    RobotModeData,
    RobotState,
    SafetyData,
    SingularityInfo,
    SubPackage,
    ToolCommunicationInfo,
    ToolData,
    ToolModeInfo,
    UnknownSubPackage,
)

__all__ = [
    "AdditionalInfo",
    "AnalogDomain",
    "Backoff",
    "BadAddress",
    "BadRecording",
    "BadValue",
    "BadVersion",
    "CalibrationData",
    "CartesianInfo",
    "Chunk",
    "Closed",
    "ConfigurationData",
    "ConnectFailed",
    "ConnectionEvent",
    "ConnectionLost",
    "ConnectionState",
    "ControlMode",
    "DigitalBits",
    "Feed",
    "Firmware",
    "ForceModeData",
    "JointData",
    "JointMode",
    "KeyMessage",
    "KinematicsInfo",
    "LaserPointer",
    "LinkError",
    "LinkTimeout",
    "LocalError",
    "MasterboardData",
    "MessageSource",
    "MessageType",
    "OtherPackage",
    "PackageType",
    "PacketError",
    "Policy",
    "PopupMessage",
    "ProgramLabelMessage",
    "ProgramState",
    "ProgramStateMessage",
    "RealtimeState",
    "Recorder",
    "RemoteError",
    "ReportLevel",
    "RequestValueMessage",
    "Robot",
    "RobotCommMessage",
    "RobotMessage",
    "RobotMode",
    "RobotModeCB2",
    "RobotModeData",
    "RobotState",
    "RobotType",
    "RuntimeExceptionMessage",
    "SafetyComplianceTolerances",
    "SafetyData",
    "SafetyMode",
    "SafetyModeMessage",
    "SingularityInfo",
    "Stamp",
    "State",
    "Stream",
    "SubPackage",
    "Subscription",
    "TextMessage",
    "ToolCommunicationInfo",
    "ToolData",
    "ToolMode",
    "ToolModeInfo",
    "Traffic",
    "UnknownMessage",
    "UnknownModel",
    "UnknownSubPackage",
    "UnnamedMessage12",
    "VersionMessage",
    "WrongPeer",
    "block",
    "connect",
    "decode",
    "drop_oldest",
    "latest",
]
