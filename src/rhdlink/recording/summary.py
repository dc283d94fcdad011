"""The contents of a recording of a robot, in figures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from linkcore.progress import Progress
from linkcore.recording.file import Recording

from .playback import play

__all__ = ["Summary", "summarise"]


@dataclass
class Summary:
    """The contents of a recording.

    Attributes:
        file: its name.
        size: bytes.
        is_complete: whether it was closed in good order.
        left_out: bytes at its end that are unfinished or damaged.
        seconds: from the first batch to the last.
        batches: how many, those of handshakes among them.
        connections: how many.
        width: words of a time stamp.
        variables: name -> how many batches set it.
    """

    file: str
    size: int
    is_complete: bool
    left_out: int
    seconds: float = 0.0
    batches: int = 0
    connections: int = 0
    width: int = 0
    variables: dict[str, int] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {**vars(self)}


def summarise(recording: Recording, progress: Progress | None = None) -> Summary:
    """Read it through.

    Args:
        progress: called with the part that is read, 0 to 1.

    Raises:
        BadRecording: it holds no robot that runs RHD.
        PacketError: it holds bytes that are no batch.
    """
    summary = Summary(str(recording.path), recording.path.stat().st_size, recording.is_complete, recording.left_out)
    first: float | None = None
    for moment in play(recording, progress):
        first = moment.received.monotonic if first is None else first
        summary.seconds = moment.received.monotonic - first
        summary.batches += 1
        summary.connections, summary.width = moment.connection, moment.width
        counts = summary.variables
        if moment.is_handshake:
            for table in (moment.database.read, moment.database.write):
                for row in table:
                    counts.setdefault(row.name, 0)
        else:
            for name in moment.update().changes:
                counts[name] += 1
    return summary
