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

from typing import TYPE_CHECKING

from linkcore.lazy import lazy_names

if TYPE_CHECKING:
    from linkcore.errors import (
        BadAddress as BadAddress,
        BadRecording as BadRecording,
        BadValue as BadValue,
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
    from linkcore.recording.table import Table as Table
    from linkcore.simulated.takeover import Simulation as Simulation, simulated_time as simulated_time
    from linkcore.stamp import Stamp as Stamp
    from linkcore.streaming.backoff import Backoff as Backoff
    from linkcore.streaming.events import ConnectionEvent as ConnectionEvent, ConnectionState as ConnectionState
    from linkcore.streaming.policy import Policy as Policy, block as block, drop_oldest as drop_oldest, latest as latest
    from linkcore.streaming.subscription import Subscription as Subscription
    from .aio import AsyncRobot as AsyncRobot, connect_async as connect_async
    from .client import Variables as Variables, connect as connect
    from .drive import Drive as Drive
    from .errors import AccessDenied as AccessDenied, NotThere as NotThere, WrongVariables as WrongVariables
    from .host.config import (
        BadConfiguration as BadConfiguration,
        Configuration as Configuration,
        Element as Element,
        read_config as read_config,
    )
    from .host.host import (
        Host as Host,
        HostFailed as HostFailed,
        HostStatistics as HostStatistics,
        PluginFailed as PluginFailed,
    )
    from .host.plugin import Plugin as Plugin
    from .recording.loading import load as load
    from .robots import Ackerman as Ackerman, Gps as Gps, Smr as Smr, VelocityOmega as VelocityOmega
    from .smrcl.errors import (
        BadMission as BadMission,
        MissionFailed as MissionFailed,
        MissionLimit as MissionLimit,
        Mistake as Mistake,
    )
    from .smrcl.mission import Debugger as Debugger, Mission as Mission, MissionRun as MissionRun
    from .smrcl.server import MissionServer as MissionServer
    from .sync_thread import SyncThread as SyncThread
    from .variables.database import Database as Database, TimeStamp as TimeStamp
    from .variables.declarations import Read as Read, Write as Write
    from .variables.snapshot import Change as Change, Update as Update, Variable as Variable
    from .variables.value_types import (
        Bool as Bool,
        Float32 as Float32,
        Float64 as Float64,
        Int32 as Int32,
        Int64 as Int64,
        Millionths as Millionths,
        Scaled as Scaled,
        Structure as Structure,
        Text as Text,
        UInt32 as UInt32,
        ValueType as ValueType,
    )
    from .wire.decoder import Limits as Limits
    from .wire.schema import schema as schema

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "linkcore.errors": """
                BadAddress BadRecording BadValue Cancelled Closed ConnectFailed ConnectionLost LinkError LinkTimeout
                LocalError PacketError RemoteError WrongPeer
            """,
            "linkcore.handle": "Handle Motion Phase",
            "linkcore.recording.table": "Table",
            "linkcore.simulated.takeover": "Simulation simulated_time",
            "linkcore.stamp": "Stamp",
            "linkcore.streaming.backoff": "Backoff",
            "linkcore.streaming.events": "ConnectionEvent ConnectionState",
            "linkcore.streaming.policy": "Policy block drop_oldest latest",
            "linkcore.streaming.subscription": "Subscription",
            ".aio": "AsyncRobot connect_async",
            ".client": "Variables connect",
            ".drive": "Drive",
            ".errors": "AccessDenied NotThere WrongVariables",
            ".host.config": "BadConfiguration Configuration Element read_config",
            ".host.host": "Host HostFailed HostStatistics PluginFailed",
            ".host.plugin": "Plugin",
            ".recording.loading": "load",
            ".robots": "Ackerman Gps Smr VelocityOmega",
            ".smrcl.errors": "BadMission MissionFailed MissionLimit Mistake",
            ".smrcl.mission": "Debugger Mission MissionRun",
            ".smrcl.server": "MissionServer",
            ".sync_thread": "SyncThread",
            ".variables.database": "Database TimeStamp",
            ".variables.declarations": "Read Write",
            ".variables.snapshot": "Change Update Variable",
            ".variables.value_types": """
                Bool Float32 Float64 Int32 Int64 Millionths Scaled Structure Text UInt32 ValueType
            """,
            ".wire.decoder": "Limits",
            ".wire.schema": "schema",
        },
    )
