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

from .client import Variables, connect
from .errors import AccessDenied, NotThere, WrongVariables
from .host.config import BadConfiguration, Configuration, Element, read_config
from .host.host import Host, HostFailed, HostStatistics, PluginFailed
from .host.plugin import Plugin
from .robots import Ackerman, Gps, Smr, VelocityOmega
from .sync_thread import SyncThread
from .variables.database import Database, TimeStamp
from .variables.declarations import Read, Write
from .variables.snapshot import Change, Update, Variable
from .variables.value_types import (
    Bool,
    Float32,
    Float64,
    Int32,
    Int64,
    Millionths,
    Scaled,
    Structure,
    Text,
    UInt32,
    ValueType,
)
from .wire.decoder import Limits

__all__ = [
    "AccessDenied",
    "Ackerman",
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
    "Element",
    "Float32",
    "Float64",
    "Gps",
    "Host",
    "HostFailed",
    "HostStatistics",
    "Int32",
    "Int64",
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
    "SyncThread",
    "Text",
    "TimeStamp",
    "UInt32",
    "Update",
    "ValueType",
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
