"""Mobile robots that run the Robot Hardware Daemon (RHD): their variable database as typed Python.

    import rhdlink
    from rhdlink import Int32, Read, Variables, Write

    class Smr(Variables):
        encl = Read(Int32, unit="ticks")
        speedl = Write(Int32, unit="cm/s")

    with rhdlink.connect("localhost:24902", Smr, access="w") as robot:
        robot.speedl = 20
        robot.sync()
        print(robot.encl)

Importing it starts nothing and touches no network.
"""

from __future__ import annotations

from linkcore.errors import (
    BadAddress,
    BadRecording,
    BadValue,
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
from linkcore.stamp import Stamp
from linkcore.streaming.backoff import Backoff
from linkcore.streaming.events import ConnectionEvent, ConnectionState
from linkcore.streaming.policy import Policy, block, drop_oldest, latest
from linkcore.streaming.subscription import Subscription

from .background import Background
from .client import Variables, connect
from .config import BadConfiguration, Configuration, read_config
from .database import Database, TimeStamp
from .errors import AccessDenied, NotThere, WrongVariables
from .host import Host, HostStatistics, PluginFailed
from .kinds import Bool, Float32, Float64, Int32, Int64, Kind, Millionths, Scaled, Structure, Text, UInt32
from .limits import Limits
from .plugin import Plugin
from .robots import Ackerman, Gps, Smr, VelocityOmega
from .snapshot import Variable
from .update import Change, Update
from .variables import Read, Write

__all__ = [
    "AccessDenied",
    "Ackerman",
    "Background",
    "Backoff",
    "BadAddress",
    "BadConfiguration",
    "BadRecording",
    "BadValue",
    "Bool",
    "Change",
    "Closed",
    "Configuration",
    "ConnectFailed",
    "ConnectionEvent",
    "ConnectionLost",
    "ConnectionState",
    "Database",
    "Float32",
    "Float64",
    "Gps",
    "Host",
    "HostStatistics",
    "Int32",
    "Int64",
    "Kind",
    "Limits",
    "LinkError",
    "LinkTimeout",
    "LocalError",
    "Millionths",
    "NotThere",
    "PacketError",
    "Plugin",
    "PluginFailed",
    "Policy",
    "Read",
    "RemoteError",
    "Scaled",
    "Smr",
    "Stamp",
    "Structure",
    "Subscription",
    "Text",
    "TimeStamp",
    "UInt32",
    "Update",
    "Variable",
    "Variables",
    "VelocityOmega",
    "Write",
    "WrongPeer",
    "WrongVariables",
    "block",
    "connect",
    "drop_oldest",
    "latest",
    "read_config",
]
