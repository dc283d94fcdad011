"""The process that a connection belongs to: a forked child must not use its copies of the connections."""

from __future__ import annotations

import os

from .errors import LocalError


class HomeProcess:
    """The process that made something.

    Args:
        name: What it made, for the error message.
    """

    __slots__ = ("_name", "_number")

    def __init__(self, name: str) -> None:
        self._name = name
        self._number = os.getpid()

    @property
    def is_here(self) -> bool:
        """Whether this is that process, and not a forked child."""
        return os.getpid() == self._number

    def check(self) -> None:
        """Reject a use by a forked child.

        Raises:
            LocalError: If this is another process.
        """
        if not self.is_here:
            raise LocalError(f"{self._name} was connected to by the parent process; connect again in this one")
