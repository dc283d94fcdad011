"""What a subscription does when it falls behind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..arguments import check_seconds
from ..errors import BadValue

__all__ = ["Policy", "block", "check_lifespan", "check_policy", "drop_oldest", "latest"]


@dataclass(frozen=True)
class Policy:
    """How many packets wait for a subscriber, and what happens to one too many.

    Attributes:
        limit: packets that wait at most.
        evicts: True drops the oldest and counts it; False makes the reader wait.

    Raises:
        BadValue: a limit below 1.
    """

    limit: int
    evicts: bool

    def __post_init__(self) -> None:
        if self.limit < 1:
            raise BadValue(f"{self}: at least one packet has to fit")


#: Keep the newest packet only: for control loops and displays. A callback that is quick enough still gets every one.
latest = Policy(1, evicts=True)

#: Lose nothing: the reader waits, and with it every subscriber of the stream; in the end TCP makes the robot's
#: controller wait, which may then drop the connection. For replay and tests.
block = Policy(1024, evicts=False)


def drop_oldest(limit: int) -> Policy:
    """Let up to `limit` packets wait, then drop the oldest.

    Raises:
        BadValue: less than 1.
    """
    return Policy(limit, evicts=True)


def check_policy(value: Any) -> Policy:
    """`value`, if it is a policy.

    Raises:
        BadValue: it is not; says what is.
    """
    if not isinstance(value, Policy):
        raise BadValue(f"policy={value!r}; expected latest, drop_oldest(n) or block, the objects and not their names")
    return value


def check_lifespan(value: Any) -> float | None:
    """Seconds after its arrival for which a packet is worth having; None for ever.

    Raises:
        BadValue: it is no positive number of seconds.
    """
    return None if value is None else check_seconds(value, "lifespan", positive=True)
