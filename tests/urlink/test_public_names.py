"""The public names of urlink. A change here is a change for users, and stands in the changelog."""

from __future__ import annotations

import inspect

import urlink

NAMES = [
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
    "IO",
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


def test_public_names() -> None:
    assert sorted(urlink.__all__) == NAMES
    assert sorted(NAMES) == NAMES
    assert len(set(NAMES)) == len(NAMES)


def test_each_is_there_and_says_what_it_is() -> None:
    for name in NAMES:
        value = getattr(urlink, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), f"{name} has no docstring"


def test_nothing_public_is_forgotten() -> None:
    """What the package imports for users is in `__all__`; modules are no names."""
    there = {name for name, value in vars(urlink).items() if not name.startswith("_") and not inspect.ismodule(value)}
    assert there - {"annotations"} == set(NAMES)
