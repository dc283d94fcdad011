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
    from linkcore.clock import Expiry as Expiry
    from linkcore.handle import Handle as Handle, Motion as Motion, Phase as Phase
    from linkcore.pending_call import PendingCall as PendingCall
    from linkcore.recording.file import RecordingWriter as RecordingWriter
    from linkcore.realtime import RealtimeReport as RealtimeReport, realtime_options as realtime_options
    from linkcore.recording.recorder import Recorder as Recorder
    from linkcore.recording.table import Table as Table
    from linkcore.simulated.takeover import Simulation as Simulation, simulated_time as simulated_time
    from linkcore.streaming.connection_life import Backoff as Backoff
    from linkcore.streaming.connection_life import (
        ConnectionEvent as ConnectionEvent,
        ConnectionState as ConnectionState,
    )
    from linkcore.streaming.feed import Feed as Feed
    from linkcore.streaming.history import History as History
    from linkcore.streaming.packet_queue import (
        Policy as Policy,
        block as block,
        drop_oldest as drop_oldest,
        latest as latest,
    )
    from linkcore.streaming.stream import Stream as Stream
    from linkcore.streaming.subscription import Subscription as Subscription
    from . import (
        dynamics as dynamics,
        kinematics as kinematics,
        models as models,
        motion as motion,
        packets as packets,
        poses as poses,
        rtde as rtde,
        urdf as urdf,
    )
    from .aio.async_robot import AsyncRobot as AsyncRobot, connect_async as connect_async
    from .commanding.interpreter import Interpreter as Interpreter
    from .commanding.io import IO as IO
    from .commanding.safety import Safety as Safety
    from .commanding.scripts import Program as Program, Scripts as Scripts
    from .data.recording import Recording as Recording, load as load
    from .compat.interface import NotOffered as NotOffered
    from .decoding import decode as decode, schema as schema
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
    from .firmware import Firmware as Firmware
    from .group import Group as Group
    from .interfaces.dashboard.client import Dashboard as Dashboard
    from .interfaces.dashboard.commands import DashboardRefused as DashboardRefused
    from .interfaces.gripper.client import Gripper as Gripper, GripperFault as GripperFault
    from .interfaces.rtde.protocol import (
        InputInUse as InputInUse,
        NoSuchVariable as NoSuchVariable,
        RtdeRefused as RtdeRefused,
    )
    from .kinematics.arm import Unreachable as Unreachable
    from .models import UnknownModel as UnknownModel
    from .motion.path import Circular as Circular, Joint as Joint, Linear as Linear
    from .motion.teaching import Taught as Taught
    from .motion.trajectory import Trajectory as Trajectory, TrajectoryPoint as TrajectoryPoint
    from .packets import RealtimeState as RealtimeState, RobotModeData as RobotModeData
    from .robot import Robot as Robot, connect as connect

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "linkcore.errors": """
                BadAddress BadRecording BadValue BadVersion Cancelled Closed ConnectFailed ConnectionLost LinkError
                LinkTimeout LocalError PacketError RemoteError WrongPeer
            """,
            "linkcore.clock": "Expiry",
            "linkcore.handle": "Handle Motion Phase",
            "linkcore.pending_call": "PendingCall",
            "linkcore.recording.file": "RecordingWriter",
            "linkcore.realtime": "RealtimeReport realtime_options",
            "linkcore.recording.recorder": "Recorder",
            "linkcore.recording.table": "Table",
            "linkcore.simulated.takeover": "Simulation simulated_time",
            "linkcore.streaming.connection_life": "Backoff ConnectionEvent ConnectionState",
            "linkcore.streaming.feed": "Feed",
            "linkcore.streaming.history": "History",
            "linkcore.streaming.packet_queue": "Policy block drop_oldest latest",
            "linkcore.streaming.stream": "Stream",
            "linkcore.streaming.subscription": "Subscription",
            ".aio.async_robot": "AsyncRobot connect_async",
            ".commanding.interpreter": "Interpreter",
            ".commanding.io": "IO",
            ".commanding.safety": "Safety",
            ".commanding.scripts": "Program Scripts",
            ".data.recording": "Recording load",
            ".compat.interface": "NotOffered",
            ".decoding": "decode schema",
            ".errors": """
                CompileError NoContact NotConfirmed NotEnabled NotRunning ProgramStopped SafetyStop ScriptError
                ScriptFailed StatementDiscarded ToleranceExceeded
            """,
            ".firmware": "Firmware",
            ".group": "Group",
            ".interfaces.dashboard.client": "Dashboard",
            ".interfaces.dashboard.commands": "DashboardRefused",
            ".interfaces.gripper.client": "Gripper GripperFault",
            ".interfaces.rtde.protocol": "InputInUse NoSuchVariable RtdeRefused",
            ".kinematics.arm": "Unreachable",
            ".models": "UnknownModel",
            ".motion.path": "Circular Joint Linear",
            ".motion.teaching": "Taught",
            ".motion.trajectory": "Trajectory TrajectoryPoint",
            ".packets": "RealtimeState RobotModeData",
            ".robot": "Robot connect",
        },
        modules="dynamics kinematics models motion packets poses rtde urdf",
        moved={
            "urlink.packets": """
                AnalogDomain ControlMode DigitalBits JointMode MessageSource MessageType PackageType ProgramState
                ReportLevel RobotMode RobotModeCB2 RobotType SafetyMode ToolMode KeyMessage OtherPackage PopupMessage
                ProgramLabelMessage ProgramStateMessage RequestValueMessage RobotCommMessage RobotMessage
                RuntimeExceptionMessage SafetyComplianceTolerances SafetyModeMessage TextMessage UnknownMessage
                UnnamedMessage12 VersionMessage AdditionalInfo CalibrationData CartesianInfo ConfigurationData
                ForceModeData JointData KinematicsInfo LaserPointer MasterboardData RobotState
                SafetyData SingularityInfo SubPackage ToolCommunicationInfo ToolData ToolModeInfo UnknownSubPackage
                State Stamp Chunk Traffic Analog ObjectStatus GripperStatus InterpreterState
                ProgramStatus SavedProgram StoredProgram
            """,
            "urlink.motion": """
                Contact ContactMotion ForceMode Freedrive Impedance Jog Motions PathMotion PointStream PosePoint Servo
                ServoStatistics TaughtPoint Teaching Torque TrajectoryFeedback
            """,
            "urlink.aio.parts": "AsyncFeed AsyncStream",
        },
        foreign=".foreign_names",
    )
