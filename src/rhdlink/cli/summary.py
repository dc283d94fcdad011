"""What is in a recording of a robot, in a few lines."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from linkcore.cli.terminal import safe
from linkcore.recording.file import Recording

from ..playback import play

__all__ = ["Summary", "summarise"]


@dataclass
class Summary:
    """What is in a recording.

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

    def as_text(self) -> str:
        """For people."""
        state = "complete" if self.is_complete else "not closed in order"
        left_out = f", {self.left_out} bytes at its end unreadable" if self.left_out else ""
        rate = f", {self.batches / self.seconds:.1f}/s" if self.seconds else ""
        plural = "" if self.connections == 1 else "s"
        lines = [
            f"{safe(self.file)}: {self.seconds:.1f} s, {self.size} bytes, {state}{left_out}",
            f"{self.batches} batches{rate}, {self.connections} connection{plural}, time stamps of {self.width} words",
        ]
        width = max(map(len, map(safe, self.variables)), default=0)
        lines += [f"  {safe(name):{width}}  set {count} times" for name, count in self.variables.items()]
        return "\n".join(lines)


def summarise(recording: Recording) -> Summary:
    """Read it through.

    Raises:
        BadRecording: it holds no robot that runs RHD.
        PacketError: it holds bytes that are no batch.
    """
    summary = Summary(str(recording.path), recording.path.stat().st_size, recording.is_complete, recording.left_out)
    first: float | None = None
    for moment in play(recording):
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
