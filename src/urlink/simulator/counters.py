"""What has happened on the ports of a controller."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Counters"]


@dataclass
class Counters:
    """What has happened on the ports of a controller since it started.

    Attributes:
        connections: accepted.
        sent: packets and packages handed to the network, once per connection.
        dropped: connections ended because the client did not read.
        refused_bytes: input thrown away: text to read-only ports, lines and programs too long, or too many that wait.
        late: cycles in which packets went out more than one cycle after they were due.
        skipped: cycles in which no packets went out because they were far too late.
        lost_messages: texts and popups of programs, beyond what one cycle sends.
    """

    connections: int = 0
    sent: int = 0
    dropped: int = 0
    refused_bytes: int = 0
    late: int = 0
    skipped: int = 0
    lost_messages: int = 0
