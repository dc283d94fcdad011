"""Universal Robots arms over Zenoh: many robots on many computers in one name space.

`Server` publishes the states of robots and accepts commands for them. `RemoteRobot` is a client for one robot, and
`Collector` records all robots that are served. Zenoh itself does the distributed part: discovery, routing,
reconnecting, liveliness, and the newest value for late subscribers.
"""

from __future__ import annotations

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .client import RemoteRobot, Sample, Watch, robots
from .collector import Collector
from .server import Server
from .session import open_session

__all__ = ["Collector", "RemoteRobot", "Sample", "Server", "Watch", "open_session", "robots"]
