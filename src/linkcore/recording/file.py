"""The file format of recordings, and their records: raw bytes with their stamps, in a file that survives a crash.

The file is append-only, big-endian::

    8 bytes   magic "LINKREC1"
    records   u32 length of what follows the checksum | u32 CRC-32 of it
              u8 kind | u8 channel | i64 monotonic ns | i64 wall ns | payload

    kind 0    channel: JSON object {"name": ..., and what the recorder knows of the source}
    kind 1    bytes as they came
    kind 2    connection event: JSON object {"state": ..., "error": ...}
    kind 3    end: the recording was closed properly

Each record is written by one system call, so a crash of the program loses nothing that was recorded, and
a crash of the machine at most the end of the file. Reading stops before the first record that is
incomplete or damaged, and counts the bytes that are left out.
"""

from __future__ import annotations

import enum
import json
import os
import struct
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

from ..clock import Stamp
from ..errors import BadRecording, BadValue, Closed
from ..names import StrictAttributes
from ..streaming.connection_life import Chunk, ConnectionEvent

MAGIC = b"LINKREC1"
#: Length of what follows the checksum; checksum.
FRAME = struct.Struct(">II")
#: Kind, channel, monotonic and wall time in ns.
HEAD = struct.Struct(">BBqq")
#: No record is larger: a longer length is damage.
LARGEST = 1 << 26


class Kind(enum.IntEnum):
    """What a record holds."""

    CHANNEL = 0
    BYTES = 1
    EVENT = 2
    END = 3


class Record(NamedTuple):
    """One record of a recording."""

    kind: Kind
    channel: int
    stamp: Stamp
    payload: bytes


def pack(kind: Kind, channel: int, stamp: Stamp, payload: bytes) -> bytes:
    """The bytes of one record."""
    body = HEAD.pack(kind, channel, round(stamp.monotonic * 1e9), round(stamp.wall * 1e9)) + payload
    return FRAME.pack(len(body), zlib.crc32(body)) + body


def described(path: str | os.PathLike[str], channel: int, payload: bytes, key: str) -> dict[str, Any]:
    """The JSON object in the payload of a channel (key "name") or of an event (key "state").

    Raises:
        BadRecording: it is not a JSON object, or holds no text under `key`.
    """
    try:
        info = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise BadRecording(f"{path}: channel {channel} is not described in JSON") from error
    if not isinstance(info, dict) or not isinstance(info.get(key), str):
        raise BadRecording(f"{path}: channel {channel} has no {key}")
    return info


#: Called with the part of the work that is done, 0 to 1.
Progress = Callable[[float], object]


def unseen(part: float) -> None:
    """Where nobody wants to know."""


def new_file(path: Path, *, buffering: int = -1) -> IO[bytes]:
    """A file that did not exist, opened to write; `buffering` as for `open`.

    Raises:
        BadRecording: the file exists, or cannot be made.
    """
    try:
        return path.open("xb", buffering=buffering)
    except FileExistsError:
        raise BadRecording(f"{path} exists; a recording never overwrites one") from None
    except (OSError, ValueError) as error:  # ValueError: no operating system has such names
        raise BadRecording(f"cannot write {path}: {_reason(error)}") from error


class RecordingWriter(StrictAttributes):
    """Appends records to a new file; may be called from several threads.

    Raises:
        BadRecording: the file exists, or cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        # Unbuffered: bytes that write() has taken are kept by the operating system, also when this process dies.
        self._file = new_file(self.path, buffering=0)
        self._lock = threading.RLock()  # re-entrant: a signal handler may close the robot
        self._is_closing = False
        self._channels = 0
        #: The first error of the file, in words; nothing is written after it.
        self.failure: str | None = None
        try:
            self._append(MAGIC)
        except BadRecording:
            self._file.close()
            raise

    def add_channel(self, info: Mapping[str, Any]) -> int:
        """Declare a channel; `info` can be written as JSON and has at least "name". Returns its number.

        Raises:
            BadValue: `info` has no name, or a value that JSON cannot hold; or there are 256 channels already.
            BadRecording, Closed: as for `write`.
        """
        if not isinstance(info.get("name"), str):
            raise BadValue(f'info={info!r}; expected a mapping with a text under "name"')
        try:
            payload = json.dumps(dict(info)).encode()
        except (TypeError, ValueError, RecursionError) as error:
            raise BadValue(f"info={info!r}; expected what JSON can hold: {error}") from None
        with self._lock:
            number = self._channels
            if number > 255:
                raise BadValue("a recording holds at most 256 channels")
            self._channels += 1
        self.write(Kind.CHANNEL, number, Stamp.now(), payload)
        return number

    def write(self, kind: Kind, channel: int, stamp: Stamp, payload: bytes) -> None:
        """Append one record.

        Raises:
            BadRecording: this record, or an earlier one, could not be written.
            Closed: after `close`.
        """
        data = pack(kind, channel, stamp, payload)
        with self._lock:
            if self._file.closed:
                raise Closed(f"{self.path} is closed")
            self._append(data)

    def add(self, channel: int, item: Chunk | ConnectionEvent) -> None:
        """Append bytes as they were received, or an event of the connection.

        Raises:
            BadRecording, Closed: as for `write`.
        """
        if isinstance(item, Chunk):
            self.write(Kind.BYTES, channel, item.received, item.data)
        else:
            error = None if item.error is None else str(item.error)
            event = json.dumps({"state": item.state.value, "error": error}).encode()
            self.write(Kind.EVENT, channel, item.received, event)

    def close(self, *, complete: bool = True) -> None:
        """Close; idempotent. If `complete`, an end record is written, which says that nothing is missing.

        Raises:
            BadRecording: the end record could not be written.
        """
        with self._lock:
            if self._is_closing:  # also by the call that a signal handler has interrupted
                return
            self._is_closing = True
            try:
                if complete and self.failure is None:
                    self._append(pack(Kind.END, 0, Stamp.now(), b""))
            finally:
                self._file.close()

    def _append(self, data: bytes) -> None:
        if self.failure is None:
            try:
                written = self._file.write(data)
                if written != len(data):
                    # A full disk may take half a record. Readers stop before it, so nothing may be written after it.
                    self.failure = f"{self.path}: only {written} of {len(data)} bytes were taken; is the disk full?"
            except ValueError:  # closed by a signal handler just now
                raise Closed(f"{self.path} is closed") from None
            except OSError as error:
                self.failure = f"cannot write {self.path}: {_reason(error)}"
        if self.failure is not None:
            raise BadRecording(self.failure)


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


class RecordingFile:
    """A recording to read. To find its channels the file is read once from beginning to end.

    Args:
        path: of the file.
        progress: called with the fraction that has been read, 0 to 1.

    Attributes:
        path: the file.
        channels: number of each channel -> what the recorder wrote about it.
        is_complete: whether the recording was closed properly.
        left_out: bytes at its end that are unfinished or damaged.

    Raises:
        BadRecording: no such file, or not a recording.
    """

    def __init__(self, path: str | os.PathLike[str], progress: Progress | None = None) -> None:
        self.path = Path(path)
        self.channels: dict[int, dict[str, Any]] = {}
        self.is_complete = False
        self.left_out = 0
        for record in self.records(progress):
            if record.kind is Kind.CHANNEL:
                self.channels[record.channel] = described(self.path, record.channel, record.payload, "name")
            elif record.kind is Kind.EVENT:
                # Checked here, so that a replay does not fail half-way.
                described(self.path, record.channel, record.payload, "state")
            elif record.kind is Kind.END:
                self.is_complete = True

    def __iter__(self) -> Iterator[Record]:
        """As `records`."""
        return self.records()

    def records(self, progress: Progress | None = None) -> Iterator[Record]:
        """The records up to the end, or to the first that is incomplete or damaged.

        `left_out` then says how many bytes follow.

        Args:
            progress: called with the fraction that has been read, 0 to 1.

        Raises:
            BadRecording: no such file, or not a recording.
        """
        try:
            file = open(self.path, "rb")  # noqa: SIM115
        except (OSError, ValueError) as error:
            raise BadRecording(f"cannot read {self.path}: {_reason(error)}") from error
        with file:
            magic = file.read(len(MAGIC))
            if magic != MAGIC:
                raise BadRecording(f"{self.path} is not a recording: it begins with {magic!r}, not {MAGIC!r}")
            size = os.fstat(file.fileno()).st_size
            at = len(MAGIC)
            while True:
                frame = file.read(FRAME.size)
                if len(frame) < FRAME.size:
                    break
                length, checksum = FRAME.unpack(frame)
                if not HEAD.size <= length <= LARGEST:
                    break
                body = file.read(length)
                if len(body) < length or zlib.crc32(body) != checksum:
                    break
                at += FRAME.size + length
                if progress is not None:
                    progress(at / max(size, at))
                kind, channel, monotonic, wall = HEAD.unpack_from(body)
                if kind > Kind.END:
                    continue  # of a later version of the format
                yield Record(Kind(kind), channel, Stamp(monotonic / 1e9, wall / 1e9), body[HEAD.size :])
            # The file may have grown meanwhile: it can be read while it is being recorded.
            self.left_out = max(size - at, 0)

    def channel(self, name: str) -> int:
        """Number of the channel called `name`.

        Raises:
            BadRecording: there is no such channel; the message lists those that there are.
        """
        for number, info in self.channels.items():
            if info["name"] == name:
                return number
        there = ", ".join(info["name"] for info in self.channels.values()) or "nothing"
        raise BadRecording(f"{self.path} holds no {name}; it holds {there}")
