"""Packets and messages that robots send, with their parts and the enums of their fields.

    from urlink.packets import RealtimeState, RobotModeData

    robot.primary.subscribe(on_mode, RobotModeData)

The module also contains classes for raw bytes of a connection, and for replies of the dashboard, the gripper and
interpreter mode.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import lazy_names

if TYPE_CHECKING:
    from linkcore.clock import Stamp as Stamp
    from linkcore.streaming.connection_life import Chunk as Chunk, Traffic as Traffic
    from linkcore.wire.state import State as State
    from urlink.command.interpreter import InterpreterState as InterpreterState
    from urlink.command.io import Analog as Analog
    from urlink.protocol.dashboard.protocol import ProgramStatus as ProgramStatus, SavedProgram as SavedProgram
    from urlink.protocol.dashboard.stored_programs import StoredProgram as StoredProgram
    from urlink.protocol.gripper.client import GripperStatus as GripperStatus, ObjectStatus as ObjectStatus
    from urlink.protocol.gripper.onrobot import RGStatus as RGStatus
    from urlink.protocol.gripper.vacuum import SuctionStatus as SuctionStatus, VacuumStatus as VacuumStatus
    from urlink.protocol.enums import (
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
    from urlink.protocol.primary.robot_message import (
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
    from urlink.protocol.primary.robot_state import (
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
    from urlink.protocol.realtime.packets import RealtimeState as RealtimeState

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "linkcore.clock": "Stamp",
            "linkcore.streaming.connection_life": "Chunk Traffic",
            "linkcore.wire.state": "State",
            "urlink.command.interpreter": "InterpreterState",
            "urlink.command.io": "Analog",
            "urlink.protocol.dashboard.protocol": "ProgramStatus SavedProgram",
            "urlink.protocol.dashboard.stored_programs": "StoredProgram",
            "urlink.protocol.gripper.client": "GripperStatus ObjectStatus",
            "urlink.protocol.gripper.onrobot": "RGStatus",
            "urlink.protocol.gripper.vacuum": "SuctionStatus VacuumStatus",
            "urlink.protocol.enums": """
                AnalogDomain ControlMode DigitalBits JointMode MessageSource MessageType PackageType ProgramState
                ReportLevel RobotMode RobotModeCB2 RobotType SafetyMode ToolMode
            """,
            "urlink.protocol.primary.robot_message": """
                KeyMessage OtherPackage PopupMessage ProgramLabelMessage ProgramStateMessage RequestValueMessage
                RobotCommMessage RobotMessage RuntimeExceptionMessage SafetyComplianceTolerances SafetyModeMessage
                TextMessage UnknownMessage UnnamedMessage12 VersionMessage
            """,
            "urlink.protocol.primary.robot_state": """
                AdditionalInfo CalibrationData CartesianInfo ConfigurationData ForceModeData JointData KinematicsInfo
                LaserPointer MasterboardData RobotModeData RobotState SafetyData SingularityInfo SubPackage
                ToolCommunicationInfo ToolData ToolModeInfo UnknownSubPackage
            """,
            "urlink.protocol.realtime.packets": "RealtimeState",
        },
    )
