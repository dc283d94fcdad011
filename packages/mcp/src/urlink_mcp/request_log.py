"""Log of the requests of clients: who asked, for what, what a person answered, and how it ended."""

from __future__ import annotations

import dataclasses
import logging
import os
import threading
import time
from typing import Any

from urlink import BadValue, LocalError
from urlink.tools import printable, strict_json

__all__ = ["Client", "RequestLog"]

_log = logging.getLogger("urlink.mcp")

#: Largest number of characters of a name that a client gives itself.
_LONGEST = 60


@dataclasses.dataclass(frozen=True)
class Client:
    """Client that sent a request.

    Attributes:
        name, version: Name and version that the client gives itself. Nothing proves them.
        session: Connection of the client: "stdio", or the address and the session over HTTP.
    """

    name: str
    version: str
    session: str

    def __str__(self) -> str:
        named = f"{self.name} {self.version}".strip() or "a client without a name"
        return f"{printable(named)[:_LONGEST]} ({self.session})"


class RequestLog:
    """Log of requests, on the logger `urlink.mcp`, and as JSON lines in a file.

    Args:
        path: File to append to; None for no file.

    Raises:
        BadValue: If the file cannot be opened.
    """

    def __init__(self, path: str | os.PathLike[str] | None = None) -> None:
        self._lock = threading.Lock()
        self._failure: str | None = None
        try:
            # Without a buffer, so that a full disk is noticed at once, and not again when the file is closed.
            self._file = None if path is None else open(path, "ab", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise BadValue(f"cannot write the log {os.fspath(path or '')}: {error.strerror or error}") from None

    def note(self, client: Client, robot: str, tool: str, event: str, *, acts: bool, **details: Any) -> None:
        """Write one event of a request.

        It never raises, because a stop must not fail for want of a log. See `check`.

        Args:
            client: Client that sent the request.
            robot: Name of the robot.
            tool: Name of the tool.
            event: What happened, such as "asked", "consented" or "done".
            acts: Whether the tool changes something. Such events are logged as warnings, which are shown by default.
            details: Values that JSON can represent.
        """
        told = "".join(f"; {name}: {printable(value)}" for name, value in details.items() if value is not None)
        _log.log(logging.WARNING if acts else logging.INFO, "%s: %s of %s: %s%s", robot, tool, client, event, told)
        row = {
            "time": time.time(),
            "client": client.name,
            "version": client.version,
            "session": client.session,
            "robot": robot,
            "tool": tool,
            "event": event,
            **details,
        }
        with self._lock:
            if self._file is None:
                return
            try:
                line = strict_json(row).encode() + b"\n"
                if self._file.write(line) != len(line):
                    raise OSError("the disk is full")
                self._failure = None
            except (OSError, ValueError) as error:
                self._failure = str(error)
                _log.error("cannot write the log of requests: %s", error)

    def check(self) -> None:
        """Refuse a request that could not be logged.

        Raises:
            LocalError: If the last event could not be written to the file.
        """
        if self._failure is not None:
            raise LocalError(f"the request cannot be logged ({self._failure}); free space, or use another --log file")

    def close(self) -> None:
        """Close the file; idempotent."""
        with self._lock:
            if self._file is not None:
                self._file.close()
                self._file = None
