"""Universal Robots arms over Zenoh: many robots on many computers in one name space.

`Server` publishes what robots say and takes commands for them, `RemoteRobot` is a robot as a client has it, and
`Collector` records all robots that there are. Everything that is distributed is Zenoh's own: discovery, routing,
reconnecting, liveliness, the newest value for those who come late.
"""

from __future__ import annotations

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

from .client import RemoteRobot, Sample, Watch, robots
from .collector import Collector
from .server import Server
from .session import open_session

__all__ = ["Collector", "RemoteRobot", "Sample", "Server", "Watch", "open_session", "robots"]
