"""Universal Robots arms without a middleware: typed state in, commands out.

    import urlink

    with urlink.connect("192.168.56.101") as robot:     # or "sim://", or "replay:///run.urlog"
        print(robot.realtime.wait().q_actual)
        robot.motion.move_joints([0, -1.57, 1.57, -1.57, -1.57, 0]).wait()

Importing the package starts no thread and opens no connection.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import lazy_names

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
    from linkcore.streaming.scheduling import RealtimeReport as RealtimeReport, realtime_options as realtime_options
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
    from .arm import dynamics as dynamics, kinematics as kinematics, models as models, poses as poses, urdf as urdf
    from . import motion as motion, packets as packets, rtde as rtde
    from .aio.async_robot import AsyncRobot as AsyncRobot, connect_async as connect_async
    from .command.interpreter import Interpreter as Interpreter
    from .command.io import IO as IO
    from .command.safety import Safety as Safety
    from .command.scripts import Program as Program, Scripts as Scripts
    from .recording.recording import Recording as Recording, load as load
    from .protocol.decoding import decode as decode, schema as schema
    from .errors import (
        CompileError as CompileError,
        LimitExceeded as LimitExceeded,
        NoContact as NoContact,
        NotConfirmed as NotConfirmed,
        NotEnabled as NotEnabled,
        NotOffered as NotOffered,
        NotRunning as NotRunning,
        ProgramStopped as ProgramStopped,
        SafetyStop as SafetyStop,
        ScriptError as ScriptError,
        ScriptFailed as ScriptFailed,
        StatementDiscarded as StatementDiscarded,
        ToleranceExceeded as ToleranceExceeded,
    )
    from .errors.stop_explanation import (
        StopCause as StopCause,
        StopCurves as StopCurves,
        StopExplanation as StopExplanation,
    )
    from .protocol.firmware import Firmware as Firmware
    from .group import Group as Group
    from .protocol.dashboard.client import Dashboard as Dashboard
    from .protocol.dashboard.commands import DashboardRefused as DashboardRefused
    from .protocol.gripper.client import Gripper as Gripper
    from .protocol.gripper.robotiq import GripperFault as GripperFault
    from .protocol.gripper.onrobot import RGGripper as RGGripper
    from .protocol.gripper.vacuum import VacuumGripper as VacuumGripper
    from .protocol.rtde.protocol import (
        InputInUse as InputInUse,
        NoSuchVariable as NoSuchVariable,
        RtdeRefused as RtdeRefused,
    )
    from .arm.kinematics.arm import Unreachable as Unreachable
    from .arm.models import UnknownModel as UnknownModel
    from .motion.moves.path import Circular as Circular, Joint as Joint, Linear as Linear
    from .motion.points.point import Point as Point
    from .motion.points.point_file import NoSuchPoint as NoSuchPoint
    from .motion.teaching import Taught as Taught
    from .motion.moves.trajectory import Trajectory as Trajectory, TrajectoryPoint as TrajectoryPoint
    from .packets import RealtimeState as RealtimeState, RobotModeData as RobotModeData
    from .robot import Robot as Robot, connect as connect
    from .session.session_limits import SessionLimits as SessionLimits

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
            "linkcore.streaming.scheduling": "RealtimeReport realtime_options",
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
            ".command.interpreter": "Interpreter",
            ".command.io": "IO",
            ".command.safety": "Safety",
            ".command.scripts": "Program Scripts",
            ".recording.recording": "Recording load",
            ".protocol.decoding": "decode schema",
            ".errors": """
                CompileError LimitExceeded NoContact NotConfirmed NotEnabled NotOffered NotRunning ProgramStopped
                SafetyStop ScriptError ScriptFailed StatementDiscarded ToleranceExceeded
            """,
            ".protocol.firmware": "Firmware",
            ".group": "Group",
            ".protocol.dashboard.client": "Dashboard",
            ".protocol.dashboard.commands": "DashboardRefused",
            ".protocol.gripper.client": "Gripper",
            ".protocol.gripper.robotiq": "GripperFault",
            ".protocol.gripper.onrobot": "RGGripper",
            ".protocol.gripper.vacuum": "VacuumGripper",
            ".protocol.rtde.protocol": "InputInUse NoSuchVariable RtdeRefused",
            ".arm.kinematics.arm": "Unreachable",
            ".arm.models": "UnknownModel",
            ".motion.moves.path": "Circular Joint Linear",
            ".motion.points.point": "Point",
            ".motion.points.point_file": "NoSuchPoint",
            ".motion.teaching": "Taught",
            ".motion.moves.trajectory": "Trajectory TrajectoryPoint",
            ".packets": "RealtimeState RobotModeData",
            ".robot": "Robot connect",
            ".session.session_limits": "SessionLimits",
            ".errors.stop_explanation": "StopCause StopCurves StopExplanation",
        },
        modules="arm.dynamics arm.kinematics arm.models motion packets arm.poses rtde arm.urdf",
        foreign=".errors.foreign_names",
        packages={"compat": "urlink-compat"},
    )
