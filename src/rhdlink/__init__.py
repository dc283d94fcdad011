"""Client and host for mobile robots with the Robot Hardware Daemon (RHD), and client for mobile robots with MQTT.

    import rhdlink
    from rhdlink import Int32, Read, Variables, Write

    class Smr(Variables):
        encl = Read(Int32, unit="ticks")
        speedl = Write(Int32, unit="cm/s")

    with rhdlink.connect("localhost:24902", Smr, access="w") as robot:
        robot.speedl = 20
        robot.sync()
        print(robot.encl)

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
    from linkcore.handle import Phase as Phase
    from linkcore.simulated.takeover import simulated_time as simulated_time
    from linkcore.streaming.connection_life import Backoff as Backoff
    from linkcore.streaming.connection_life import ConnectionState as ConnectionState
    from linkcore.streaming.packet_queue import block as block, drop_oldest as drop_oldest, latest as latest
    from . import host as host, mqtt as mqtt, robots as robots, smrcl as smrcl, variables as variables
    from .aio import connect_async as connect_async
    from .client import Variables as Variables, connect as connect
    from .drive import Drive as Drive
    from .errors import (
        AccessDenied as AccessDenied,
        BadMission as BadMission,
        MissionFailed as MissionFailed,
        MissionLimit as MissionLimit,
        NotThere as NotThere,
        WrongVariables as WrongVariables,
    )
    from .host.config import BadConfiguration as BadConfiguration
    from .host.host import Host as Host, HostFailed as HostFailed, PluginFailed as PluginFailed
    from .host.plugin import Plugin as Plugin
    from .loading import load as load
    from .smrcl.mission import Mission as Mission
    from .variables.declarations import Read as Read, Write as Write
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
    )
    from .wire.schema import schema as schema

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "linkcore.errors": """
                BadAddress BadRecording BadValue Cancelled Closed ConnectFailed ConnectionLost LinkError LinkTimeout
                LocalError PacketError RemoteError WrongPeer
            """,
            "linkcore.handle": "Phase",
            "linkcore.simulated.takeover": "simulated_time",
            "linkcore.streaming.connection_life": "Backoff ConnectionState",
            "linkcore.streaming.packet_queue": "block drop_oldest latest",
            ".aio": "connect_async",
            ".client": "Variables connect",
            ".drive": "Drive",
            ".errors": "AccessDenied BadMission MissionFailed MissionLimit NotThere WrongVariables",
            ".host.config": "BadConfiguration",
            ".host.host": "Host HostFailed PluginFailed",
            ".host.plugin": "Plugin",
            ".loading": "load",
            ".smrcl.mission": "Mission",
            ".variables.declarations": "Read Write",
            ".variables.value_types": """
                Bool Float32 Float64 Int32 Int64 Millionths Scaled Structure Text UInt32
            """,
            ".wire.schema": "schema",
        },
        modules="host mqtt robots smrcl variables",
    )
