"""Files of a Universal Robots controller over SSH: programs, installations, logs and flight reports.

import asyncio
import urlink_files

async def backup() -> None:
    async with urlink_files.connect("192.168.56.101", password="...") as files:
        for path in await files.get("programs/*.urp", "backup"):
            print(path)

asyncio.run(backup())
"""

from .controller_files import (
    AccessDenied,
    ControllerFiles,
    FileRefused,
    RemoteFile,
    UnknownHostKey,
    connect,
)
from .places import PLACES

__all__ = [
    "PLACES",
    "AccessDenied",
    "ControllerFiles",
    "FileRefused",
    "RemoteFile",
    "UnknownHostKey",
    "connect",
]
