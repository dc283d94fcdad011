"""What a subscription does when it falls behind."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import BadValue

__all__ = ["Policy", "block", "drop_oldest", "latest"]


@dataclass(frozen=True)
class Policy:
    """How many packets wait for a subscriber, and what happens to one too many.

    Attributes:
        limit: packets that wait at most.
        evicts: True drops the oldest and counts it; False makes the reader wait.
    """

    limit: int
    evicts: bool


#: Keep the newest packet only: for control loops and displays. Who keeps up still gets every one.
latest = Policy(1, evicts=True)

#: Lose nothing: the reader waits, and with it every subscriber of the stream; in the end TCP makes
#: the robot's controller wait, which may then drop the connection. For replay and tests.
block = Policy(1024, evicts=False)


def drop_oldest(limit: int) -> Policy:
    """Let up to `limit` packets wait, then drop the oldest.

    Raises:
        BadValue: less than 1.
    """
    if limit < 1:
        raise BadValue(f"drop_oldest({limit}): at least one packet has to fit")
    return Policy(limit, evicts=True)
