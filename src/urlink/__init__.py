"""Universal Robots arms without a middleware: typed state in, commands out.

    import urlink

    with urlink.connect("192.168.56.101") as robot:     # or "sim://", or "replay:///run.urlog"
        print(robot.realtime.wait().q_actual)
        robot.motion.move_joints([0, -1.57, 1.57, -1.57, -1.57, 0]).wait()

Importing it starts nothing and touches no network.
"""

from __future__ import annotations

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
from linkcore.recording.recorder import Recorder
from linkcore.stamp import Stamp
from linkcore.streaming.backoff import Backoff
from linkcore.streaming.events import Chunk, ConnectionEvent, ConnectionState, Traffic
from linkcore.streaming.feed import Feed
from linkcore.streaming.policy import Policy, block, drop_oldest, latest
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import Subscription
from linkcore.wire.packet import State

from .commanding.handle import Program, ProgramPhase
from .commanding.io import IO, Analog
from .commanding.programs import Scripts
from .commanding.safety import Safety
from .decoding import decode
from .errors import (
    CompileError,
    MotionCancelled,
    NotEnabled,
    NotRunning,
    ProgramStopped,
    SafetyStop,
    ScriptError,
    ScriptFailed,
    ToleranceExceeded,
)
from .firmware import Firmware
from .interfaces.dashboard.client import Dashboard, DashboardRefused
from .interfaces.dashboard.protocol import ProgramStatus, SavedProgram
from .interfaces.enums import (
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
from .interfaces.primary.robot_message import (
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
from .interfaces.primary.robot_state import (
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
from .interfaces.realtime.packets import RealtimeState
from .models import UnknownModel
from .motion import Motion, MotionPhase, Motions, Servo, ServoStatistics, TrajectoryFeedback
from .motion.trajectory import Trajectory, TrajectoryPoint
from .robot import Robot, connect

__all__ = [
    "IO",
    "AdditionalInfo",
    "Analog",
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
    "CompileError",
    "ConfigurationData",
    "ConnectFailed",
    "ConnectionEvent",
    "ConnectionLost",
    "ConnectionState",
    "ControlMode",
    "Dashboard",
    "DashboardRefused",
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
    "Motion",
    "MotionCancelled",
    "MotionPhase",
    "Motions",
    "NotEnabled",
    "NotRunning",
    "OtherPackage",
    "PackageType",
    "PacketError",
    "Policy",
    "PopupMessage",
    "Program",
    "ProgramLabelMessage",
    "ProgramPhase",
    "ProgramState",
    "ProgramStateMessage",
    "ProgramStatus",
    "ProgramStopped",
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
    "Safety",
    "SafetyComplianceTolerances",
    "SafetyData",
    "SafetyMode",
    "SafetyModeMessage",
    "SafetyStop",
    "SavedProgram",
    "ScriptError",
    "ScriptFailed",
    "Scripts",
    "Servo",
    "ServoStatistics",
    "SingularityInfo",
    "Stamp",
    "State",
    "Stream",
    "SubPackage",
    "Subscription",
    "TextMessage",
    "ToleranceExceeded",
    "ToolCommunicationInfo",
    "ToolData",
    "ToolMode",
    "ToolModeInfo",
    "Traffic",
    "Trajectory",
    "TrajectoryFeedback",
    "TrajectoryPoint",
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
