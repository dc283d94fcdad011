"""MCAP files with ROS 2 messages by topic, which Foxglove, `ros2 bag` and PlotJuggler can open.

A topic consists of the definition of its messages, and of one message in CDR for each row of a table. Most messages
differ only in a few numbers. The names of joints and frames, and the lengths, are always the same. Such messages have
the same size, and each number has a fixed offset, so many messages are made as one array.

The coding is CDR (OMG, Common Data Representation, version 1, little-endian):

- The encapsulation is 4 bytes ``00 01 00 00``.
- Numbers are at multiples of their size, counted from the end of the encapsulation.
- A text is a uint32 with its length, the final NUL included, followed by the bytes and the NUL.
- A sequence is a uint32 with its length, followed by the elements.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..names import needs
from .file import Progress
from .table import Table

_ENCAPSULATION = b"\x00\x01\x00\x00"


class Message:
    """Builder of `count` messages of one type.

    The parts are added in the order of the definition.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._size = len(_ENCAPSULATION)
        self._constants: list[tuple[int, bytes]] = [(0, _ENCAPSULATION)]
        self._columns: list[tuple[int, NDArray[Any]]] = []

    def _align(self, size: int) -> None:
        self._size += -(self._size - len(_ENCAPSULATION)) % size

    def length(self, length: int) -> Message:
        """Add the length of a sequence."""
        self._align(4)
        self._constants.append((self._size, length.to_bytes(4, "little")))
        self._size += 4
        return self

    def text(self, text: str) -> Message:
        """Add a text that is the same in all messages."""
        data = text.encode() + b"\0"
        self.length(len(data))
        self._constants.append((self._size, data))
        self._size += len(data)
        return self

    def texts(self, texts: Sequence[str]) -> Message:
        """Add a sequence of texts."""
        self.length(len(texts))
        for text in texts:
            self.text(text)
        return self

    def numbers(self, values: NDArray[Any]) -> Message:
        """Add one number per message, shape (n,), or several, shape (n, k), with the number type of the array."""
        values = np.asarray(values)
        self._align(values.dtype.itemsize)
        self._columns.append((self._size, values))
        self._size += values.dtype.itemsize * (1 if values.ndim == 1 else values.shape[1])
        return self

    def sequence(self, values: NDArray[Any]) -> Message:
        """Add a sequence of numbers, shape (n, k), to each message."""
        self.length(values.shape[1])
        return self.numbers(values) if values.shape[1] else self

    def stamp(self, wall: NDArray[np.datetime64]) -> Message:
        """Add a time, as seconds and nanoseconds since 1970."""
        nanoseconds = wall.astype("M8[ns]").astype(np.int64)
        self.numbers((nanoseconds // 10**9).astype("<i4"))
        return self.numbers((nanoseconds % 10**9).astype("<u4"))

    def header(self, wall: NDArray[np.datetime64], frame: str) -> Message:
        """Add a `std_msgs/Header`, which has a stamp and a frame."""
        return self.stamp(wall).text(frame)

    def encoded(self) -> list[bytes]:
        """Return the messages."""
        every = np.zeros((self._count, self._size), np.uint8)
        for offset, data in self._constants:
            every[:, offset : offset + len(data)] = np.frombuffer(data, np.uint8)
        for offset, values in self._columns:
            little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
            size = little.nbytes // max(self._count, 1)
            every[:, offset : offset + size] = little.view(np.uint8).reshape(self._count, size)
        data = every.tobytes()
        return [data[begin : begin + self._size] for begin in range(0, len(data), self._size)]


TIME = "builtin_interfaces/Time", "int32 sec\nuint32 nanosec"
HEADER = "std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"

_NAMES = {"f8": "float64", "i8": "int64", "u8": "uint64", "i4": "int32", "u4": "uint32", "i2": "int16", "u2": "uint16"}
_NAMES |= {"f4": "float32", "i1": "int8", "u1": "uint8", "b1": "bool"}


def definition(text: str, *others: tuple[str, str]) -> str:
    """Return the definition of a message followed by the definitions of its types, in the format of ROS."""
    return "\n".join([text, *(f"{'=' * 80}\nMSG: {name}\n{each}" for name, each in others)])


class Topic(NamedTuple):
    """Topic with its messages.

    Attributes:
        name: Name of the topic.
        type: Type of the messages.
        definition: Definition of the type.
        wall: Stamp of each message, shape (n,), datetime64[ns].
        messages: Messages in CDR.
    """

    name: str
    type: str
    definition: str
    wall: NDArray[np.datetime64]
    messages: list[bytes]


def table_topic(name: str, table: Table, package: str) -> Topic:
    """Return a topic with a message for each row, which has all fields except text.

    Names are in lower case, as ROS requires.

    Args:
        name: Name of the topic; with a capital letter, it is the name of the type.
        table: Table.
        package: Package of the type.
    """
    message = Message(len(table)).header(table.wall, "")
    lines = ["std_msgs/Header header"]
    for field, array in table.arrays().items():
        if array.dtype == object:
            continue
        count = "" if array.ndim == 1 else f"[{array.shape[1]}]"
        lines.append(f"{_NAMES[array.dtype.str[1:]]}{count} {re.sub('[^a-z0-9]+', '_', field.lower())}")
        message.numbers(array)
    text = definition("\n".join(lines), HEADER, TIME)
    return Topic(f"/{name}", f"{package}/msg/{name.capitalize()}", text, table.wall, message.encoded())


#: Length in s of the sections of a recording. The messages of one section are made together, because all messages might
#: not fit into memory.
_STRETCH = 10.0


class McapFile:
    """Writer of messages into an open file.

    An unfinished file can be read up to its last complete chunk.

    Args:
        file: File that is open for writing bytes.
        chunk: Number of bytes of messages that are compressed together. A killed program can lose them.

    Raises:
        LocalError: If the extra ``mcap`` is not installed.
    """

    def __init__(self, file: IO[bytes], chunk: int = 1 << 20) -> None:
        with needs("mcap", "an .mcap file"):
            from mcap.writer import CompressionType, Writer
        self._writer = Writer(file, chunk_size=chunk, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="urlink")
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[tuple[str, int], int] = {}

    def describe(self, about: Mapping[str, str]) -> None:
        """Write the description of the file, as the metadata record `recording`."""
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
            # rosbag2 reads the quality of service from this entry; an empty text is the default.
            about = {"offered_qos_profiles": ""}
            self._channels[key] = self._writer.register_channel(topic.name, "cdr", key[1], about)
        return self._channels[key]

    def finish(self) -> None:
        """Write the index. Nothing can be added afterwards."""
        self._writer.finish()


def write_mcap(path: Path, tables: Mapping[str, Table], about: Mapping[str, str], progress: Progress) -> None:
    """Write a topic for each table, with a message for each row.

    The type of the messages has the fields of the table.
    """

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
    """Write the messages of tables to a file, one section of time after the other.

    Args:
        path: Path of the file.
        tables: Tables by name.
        topics: Function that returns the messages between two times, in s since the start of the recording.
        about: Content of the metadata record `recording`.
        progress: Function that is called with the completed fraction, 0 to 1.
        begin: Messages that are written once, before all others.
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
