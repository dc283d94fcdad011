"""The error of commands that a controller refuses."""

from __future__ import annotations

from linkcore.errors import RemoteError

__all__ = ["DashboardRefused"]


class DashboardRefused(RemoteError):
    """The controller did not carry out a command, or its answer is not one that confirms it.

    Attributes:
        command: the line that was sent.
        reply: what the controller answered, in its own words.
    """

    __module__ = "urlink"  # where users import it from, and what a traceback shows

    def __init__(self, command: str, reply: str) -> None:
        super().__init__(command, reply)
        self.command = command
        self.reply = reply

    def __str__(self) -> str:
        return f"{self.command!r}: the controller answered {self.reply!r}"
