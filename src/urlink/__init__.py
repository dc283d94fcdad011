"""Universal Robots arms without a middleware: typed state in, commands out.

    import urlink

    with urlink.connect("192.168.56.101") as robot:     # or "sim://", or "replay:///run.urlog"
        print(robot.realtime.wait().q_actual)
        robot.motion.move_joints([0, -1.57, 1.57, -1.57, -1.57, 0]).wait()

Importing it starts nothing and touches no network.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.lazy import lazy_names

if TYPE_CHECKING:
    from linkcore.aio.async_stream import AsyncFeed as AsyncFeed, AsyncStream as AsyncStream
    from linkcore.errors import (
        BadAddress as BadAddress,
        BadRecording as BadRecording,
        BadValue as BadValue,
        BadVersion as BadVersion,
        Cancelled as Cancelled,
        Closed as Closed,
        ConnectFailed as ConnectFailed,
        ConnectionLost as ConnectionLost,
        LinkError as LinkError,
        LinkTimeout as LinkTimeout,
        LocalError as LocalError,
        PacketError as PacketError,
        RemoteError as RemoteError,
        WrongPeer as WrongPeer,
    )
    from linkcore.handle import Handle as Handle, Motion as Motion, Phase as Phase
    from linkcore.recording.file import RecordingWriter as RecordingWriter
    from linkcore.realtime import RealtimeReport as RealtimeReport, realtime_options as realtime_options
    from linkcore.recording.recorder import Recorder as Recorder
    from linkcore.recording.table import Table as Table
    from linkcore.simulated.takeover import Simulation as Simulation, simulated_time as simulated_time
    from linkcore.stamp import Stamp as Stamp
    from linkcore.streaming.backoff import Backoff as Backoff
    from linkcore.streaming.events import (
        Chunk as Chunk,
        ConnectionEvent as ConnectionEvent,
        ConnectionState as ConnectionState,
        Traffic as Traffic,
    )
    from linkcore.streaming.feed import Feed as Feed
    from linkcore.streaming.history import History as History
    from linkcore.streaming.policy import Policy as Policy, block as block, drop_oldest as drop_oldest, latest as latest
    from linkcore.streaming.stream import Stream as Stream
    from linkcore.streaming.subscription import Subscription as Subscription
    from linkcore.wire.packet import State as State
    from . import (
        dynamics as dynamics,
        kinematics as kinematics,
        models as models,
        poses as poses,
        rtde as rtde,
        urdf as urdf,
    )
    from .aio.async_robot import AsyncRobot as AsyncRobot, connect_async as connect_async
    from .commanding.interpreter import Interpreter as Interpreter, InterpreterState as InterpreterState
    from .commanding.io import IO as IO, Analog as Analog
    from .commanding.safety import Safety as Safety
    from .commanding.scripts import Program as Program, Scripts as Scripts
    from .data.recording import Recording as Recording, load as load
    from .decoding import decode as decode
    from .errors import (
        CompileError as CompileError,
        NoContact as NoContact,
        NotConfirmed as NotConfirmed,
        NotEnabled as NotEnabled,
        NotRunning as NotRunning,
        ProgramStopped as ProgramStopped,
        SafetyStop as SafetyStop,
        ScriptError as ScriptError,
        ScriptFailed as ScriptFailed,
        StatementDiscarded as StatementDiscarded,
        ToleranceExceeded as ToleranceExceeded,
    )
    from .compat.interface import NotOffered as NotOffered
    from .firmware import Firmware as Firmware
    from .interfaces.dashboard.client import Dashboard as Dashboard, DashboardRefused as DashboardRefused
    from .interfaces.dashboard.protocol import ProgramStatus as ProgramStatus, SavedProgram as SavedProgram
    from .interfaces.dashboard.stored_programs import StoredProgram as StoredProgram
    from .interfaces.gripper.client import (
        Gripper as Gripper,
        GripperFault as GripperFault,
        GripperStatus as GripperStatus,
        ObjectStatus as ObjectStatus,
    )
    from .interfaces.enums import (
        AnalogDomain as AnalogDomain,
        ControlMode as ControlMode,
        DigitalBits as DigitalBits,
        JointMode as JointMode,
        MessageSource as MessageSource,
        MessageType as MessageType,
        PackageType as PackageType,
        ProgramState as ProgramState,
        ReportLevel as ReportLevel,
        RobotMode as RobotMode,
        RobotModeCB2 as RobotModeCB2,
        RobotType as RobotType,
        SafetyMode as SafetyMode,
        ToolMode as ToolMode,
    )
    from .interfaces.primary.robot_message import (
        KeyMessage as KeyMessage,
        OtherPackage as OtherPackage,
        PopupMessage as PopupMessage,
        ProgramLabelMessage as ProgramLabelMessage,
        ProgramStateMessage as ProgramStateMessage,
        RequestValueMessage as RequestValueMessage,
        RobotCommMessage as RobotCommMessage,
        RobotMessage as RobotMessage,
        RuntimeExceptionMessage as RuntimeExceptionMessage,
        SafetyComplianceTolerances as SafetyComplianceTolerances,
        SafetyModeMessage as SafetyModeMessage,
        TextMessage as TextMessage,
        UnknownMessage as UnknownMessage,
        UnnamedMessage12 as UnnamedMessage12,
        VersionMessage as VersionMessage,
    )
    from .interfaces.primary.robot_state import (
        AdditionalInfo as AdditionalInfo,
        CalibrationData as CalibrationData,
        CartesianInfo as CartesianInfo,
        ConfigurationData as ConfigurationData,
        ForceModeData as ForceModeData,
        JointData as JointData,
        KinematicsInfo as KinematicsInfo,
        LaserPointer as LaserPointer,
        MasterboardData as MasterboardData,
        RobotModeData as RobotModeData,
        RobotState as RobotState,
        SafetyData as SafetyData,
        SingularityInfo as SingularityInfo,
        SubPackage as SubPackage,
        ToolCommunicationInfo as ToolCommunicationInfo,
        ToolData as ToolData,
        ToolModeInfo as ToolModeInfo,
        UnknownSubPackage as UnknownSubPackage,
    )
    from .interfaces.realtime.packets import RealtimeState as RealtimeState
    from .interfaces.rtde.protocol import (
        InputInUse as InputInUse,
        NoSuchVariable as NoSuchVariable,
        RtdeRefused as RtdeRefused,
    )
    from .kinematics.arm import Unreachable as Unreachable
    from .models import UnknownModel as UnknownModel
    from .motion import (
        Circular as Circular,
        Contact as Contact,
        ContactMotion as ContactMotion,
        ForceMode as ForceMode,
        Freedrive as Freedrive,
        Jog as Jog,
        Joint as Joint,
        Linear as Linear,
        Motions as Motions,
        PathMotion as PathMotion,
        Servo as Servo,
        ServoStatistics as ServoStatistics,
        Taught as Taught,
        TaughtPoint as TaughtPoint,
        Teaching as Teaching,
        Torque as Torque,
        TrajectoryFeedback as TrajectoryFeedback,
    )
    from .motion.trajectory import Trajectory as Trajectory, TrajectoryPoint as TrajectoryPoint
    from .robot import Robot as Robot, connect as connect
    from .schemas import schema as schema

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "linkcore.aio.async_stream": "AsyncFeed AsyncStream",
            "linkcore.errors": """
                BadAddress BadRecording BadValue BadVersion Cancelled Closed ConnectFailed ConnectionLost LinkError
                LinkTimeout LocalError PacketError RemoteError WrongPeer
            """,
            "linkcore.handle": "Handle Motion Phase",
            "linkcore.recording.file": "RecordingWriter",
            "linkcore.realtime": "RealtimeReport realtime_options",
            "linkcore.recording.recorder": "Recorder",
            "linkcore.recording.table": "Table",
            "linkcore.simulated.takeover": "Simulation simulated_time",
            "linkcore.stamp": "Stamp",
            "linkcore.streaming.backoff": "Backoff",
            "linkcore.streaming.events": "Chunk ConnectionEvent ConnectionState Traffic",
            "linkcore.streaming.feed": "Feed",
            "linkcore.streaming.history": "History",
            "linkcore.streaming.policy": "Policy block drop_oldest latest",
            "linkcore.streaming.stream": "Stream",
            "linkcore.streaming.subscription": "Subscription",
            "linkcore.wire.packet": "State",
            ".aio.async_robot": "AsyncRobot connect_async",
            ".commanding.interpreter": "Interpreter InterpreterState",
            ".commanding.io": "IO Analog",
            ".commanding.safety": "Safety",
            ".commanding.scripts": "Program Scripts",
            ".data.recording": "Recording load",
            ".compat.interface": "NotOffered",
            ".decoding": "decode",
            ".errors": """
                CompileError NoContact NotConfirmed NotEnabled NotRunning ProgramStopped SafetyStop
                ScriptError ScriptFailed StatementDiscarded ToleranceExceeded
            """,
            ".firmware": "Firmware",
            ".interfaces.dashboard.client": "Dashboard DashboardRefused",
            ".interfaces.dashboard.protocol": "ProgramStatus SavedProgram",
            ".interfaces.dashboard.stored_programs": "StoredProgram",
            ".interfaces.gripper.client": "Gripper GripperFault GripperStatus ObjectStatus",
            ".interfaces.enums": """
                AnalogDomain ControlMode DigitalBits JointMode MessageSource MessageType PackageType ProgramState
                ReportLevel RobotMode RobotModeCB2 RobotType SafetyMode ToolMode
            """,
            ".interfaces.primary.robot_message": """
                KeyMessage OtherPackage PopupMessage ProgramLabelMessage ProgramStateMessage RequestValueMessage
                RobotCommMessage RobotMessage RuntimeExceptionMessage SafetyComplianceTolerances SafetyModeMessage
                TextMessage UnknownMessage UnnamedMessage12 VersionMessage
            """,
            ".interfaces.primary.robot_state": """
                AdditionalInfo CalibrationData CartesianInfo ConfigurationData ForceModeData JointData
                KinematicsInfo LaserPointer MasterboardData RobotModeData RobotState SafetyData SingularityInfo
                SubPackage ToolCommunicationInfo ToolData ToolModeInfo UnknownSubPackage
            """,
            ".interfaces.realtime.packets": "RealtimeState",
            ".interfaces.rtde.protocol": "InputInUse NoSuchVariable RtdeRefused",
            ".kinematics.arm": "Unreachable",
            ".models": "UnknownModel",
            ".motion": """
                Circular Contact ContactMotion ForceMode Freedrive Jog Joint Linear Motions PathMotion Servo
                ServoStatistics Taught TaughtPoint Teaching Torque TrajectoryFeedback
            """,
            ".motion.trajectory": "Trajectory TrajectoryPoint",
            ".robot": "Robot connect",
            ".schemas": "schema",
        },
        modules="dynamics kinematics models poses rtde urdf",
    )
