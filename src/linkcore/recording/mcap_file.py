"""MCAP files, which Foxglove, `ros2 bag` and PlotJuggler open: messages of ROS 2 by topic."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import IO

import numpy as np

from ..extras import needs
from ..progress import Progress
from .table import Table
from .topics import Topic, table_topic

__all__ = ["McapFile", "write_mcap", "write_stretches"]

#: Seconds of a recording whose messages are made together: all of them might not fit into memory.
_STRETCH = 10.0


class McapFile:
    """Writes messages into an open file. A file that was not finished can be read up to its last complete chunk.

    Args:
        file: open for writing bytes.
        chunk: bytes of messages that are compressed together, and that a killed program can lose.

    Raises:
        LocalError: the extra ``mcap`` is not installed.
    """

    def __init__(self, file: IO[bytes], chunk: int = 1 << 20) -> None:
        with needs("mcap", "an .mcap file"):
            from mcap.writer import CompressionType, Writer
        self._writer = Writer(file, chunk_size=chunk, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="urlink")
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[tuple[str, int], int] = {}

    def describe(self, about: Mapping[str, str]) -> None:
        """Write what the file says of itself, as the metadata record `recording`."""
        self._writer.add_metadata("recording", dict(about))

    def write(self, topics: Iterable[Topic]) -> None:
        """Append messages, in the order of their stamps."""
        topics = list(topics)
        channels = [self._channel(topic) for topic in topics]
        stamps = [topic.wall.astype("M8[ns]").astype(np.int64) for topic in topics]
        of_topic = np.repeat(np.arange(len(topics)), [len(each) for each in stamps])
        number = np.concatenate([np.arange(len(each)) for each in stamps]) if stamps else np.empty(0, int)
        every = np.concatenate(stamps) if stamps else np.empty(0, np.int64)
        order = np.argsort(every, kind="stable")
        add = self._writer.add_message
        rows = zip(of_topic[order].tolist(), number[order].tolist(), every[order].tolist(), strict=True)
        for topic, message, stamp in rows:
            add(channels[topic], stamp, topics[topic].messages[message], stamp)

    def _channel(self, topic: Topic) -> int:
        definition = (topic.type, topic.definition)
        if definition not in self._schemas:
            self._schemas[definition] = self._writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
        key = (topic.name, self._schemas[definition])
        if key not in self._channels:
            # rosbag2 reads the quality of service from here; an empty text is the default.
            about = {"offered_qos_profiles": ""}
            self._channels[key] = self._writer.register_channel(topic.name, "cdr", key[1], about)
        return self._channels[key]

    def finish(self) -> None:
        """Write the index; nothing can be added after it."""
        self._writer.finish()


def write_mcap(path: Path, tables: Mapping[str, Table], about: Mapping[str, str], progress: Progress) -> None:
    """A topic for each table, with a message for each row, of a type made of the fields of the table."""

    def topics(start: float, stop: float) -> list[Topic]:
        return [table_topic(name, table.between(start, stop), "recorded_msgs") for name, table in tables.items()]

    write_stretches(path, tables, topics, about, progress)


def write_stretches(
    path: Path,
    tables: Mapping[str, Table],
    topics: Callable[[float, float], Iterable[Topic]],
    about: Mapping[str, str],
    progress: Progress,
    begin: Iterable[Topic] = (),
) -> None:
    """Write a file of the messages of tables, one stretch of time after the other.

    Args:
        topics: makes the messages from one time to another, s since the recording began.
        about: the metadata record `recording`.
        begin: messages that are written once, before all others.
    """
    filled = [table for table in tables.values() if len(table)]
    first = min((table.time[0] for table in filled), default=0.0)
    last = max((table.time[-1] for table in filled), default=0.0)
    with path.open("xb") as file:
        mcap = McapFile(file)
        mcap.describe(about)
        mcap.write(begin)
        for start in np.arange(first, last + _STRETCH, _STRETCH).tolist():
            mcap.write(topics(start, start + _STRETCH))
            progress(min((start - first) / max(last - first, _STRETCH), 1.0))
        mcap.finish()
