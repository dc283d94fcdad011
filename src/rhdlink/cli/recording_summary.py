"""Summary of a recording of an RHD robot: batches, connections, and how often each variable was set."""

from __future__ import annotations

from dataclasses import dataclass, field

from linkcore.cli.progress import ProgressBar
from linkcore.recording.file import RecordingFile
from linkcore.text import printable

from ..recording import play


@dataclass
class RecordingSummary:
    """Contents of a recording.

    Attributes:
        file: Name of the file.
        size: Size in bytes.
        is_complete: Whether the file was closed properly.
        left_out: Number of unfinished or damaged bytes at the end of the file.
        seconds: Time from the first batch to the last, in s.
        batches: Number of batches, including handshakes.
        connections: Number of connections.
        width: Number of 32-bit words of a time stamp.
        variables: Number of batches that set each variable, by name.
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

    def as_text(self) -> str:
        """Format the summary as text for a person."""
        state = "complete" if self.is_complete else "not closed properly"
        left_out = f", {self.left_out} bytes at its end unreadable" if self.left_out else ""
        rate = f", {self.batches / self.seconds:.1f}/s" if self.seconds else ""
        connections = f"{self.connections} connection{'' if self.connections == 1 else 's'}"
        lines = [
            f"{printable(self.file)}: {self.seconds:.1f} s, {self.size} bytes, {state}{left_out}",
            f"{self.batches} batches{rate}, {connections}, time stamps of {self.width} words",
        ]
        width = max(map(len, map(printable, self.variables)), default=0)
        lines += [f"  {printable(name):{width}}  set {count} times" for name, count in self.variables.items()]
        return "\n".join(lines)


def read_summary(path: str, quiet: bool) -> RecordingSummary:
    """Read a whole recording.

    Raises:
        BadRecording: If the recording contains no RHD robot.
        PacketError: If the recording contains bytes that are not a batch.
    """
    with ProgressBar(f"reading {path}", quiet) as progress:
        recording = RecordingFile(path, progress)
        size = recording.path.stat().st_size
        summary = RecordingSummary(str(recording.path), size, recording.is_complete, recording.left_out)
        first: float | None = None
        for moment in play(recording, progress):
            first = moment.received.monotonic if first is None else first
            summary.seconds = moment.received.monotonic - first
            summary.batches += 1
            summary.connections, summary.width = moment.connection, moment.width
            if moment.is_handshake:
                for row in (*moment.database.read, *moment.database.write):
                    summary.variables.setdefault(row.name, 0)
            else:
                for name in moment.update().changes:
                    summary.variables[name] += 1
    return summary
