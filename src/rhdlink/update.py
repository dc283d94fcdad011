"""What subscribers are told: the variables that changed with a sync."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from linkcore.stamp import Stamp

from .database import TimeStamp

__all__ = ["Change", "Update"]


@dataclass(frozen=True)
class Change:
    """A variable that came with another time stamp or another value.

    Attributes:
        value: typed as it was declared; a read-only int32 array where it was not.
        stamp: when it was set, by the clock of who set it.
        changed: whether the value differs from the one before.
    """

    value: Any
    stamp: TimeStamp
    changed: bool


@dataclass(frozen=True)
class Update:
    """What changed with one sync.

    Attributes:
        changes: by name; never empty.
        received: when it came, by the clocks of this machine.
    """

    changes: Mapping[str, Change]
    received: Stamp

    def __getitem__(self, name: str) -> Any:
        """The value of a variable that changed; KeyError if it did not."""
        return self.changes[name].value

    def __contains__(self, name: object) -> bool:
        return name in self.changes
