"""File format of recordings: records of raw bytes with their stamps. A crash does not damage earlier records.

The file is append-only, big-endian::

    8 bytes   magic "LINKREC1"
    records   u32 length of the part after the checksum | u32 CRC-32 of this part
              u8 kind | u8 channel | i64 monotonic ns | i64 wall ns | payload

    kind 0    channel: JSON object {"name": ..., and the recorder's description of the source}
    kind 1    received bytes
    kind 2    connection event: JSON object {"state": ..., "error": ...}
    kind 3    end: the recording was closed properly

Each record is written by one system call. So a crash of the program loses no recorded data, and a crash of the machine
loses at most the end of the file. Reading stops before the first incomplete or damaged record, and counts the bytes
that are left out.
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
#: Length of the part after the checksum; checksum.
FRAME = struct.Struct(">II")
#: Kind, channel, monotonic and wall time in ns.
HEAD = struct.Struct(">BBqq")
#: Maximum length in a record. A larger length is considered damage.
LARGEST = 1 << 26


class Kind(enum.IntEnum):
    """Kind of a record."""

    CHANNEL = 0
    BYTES = 1
    EVENT = 2
    END = 3


class Record(NamedTuple):
    """Record of a recording."""

    kind: Kind
    channel: int
    stamp: Stamp
    payload: bytes


def pack(kind: Kind, channel: int, stamp: Stamp, payload: bytes) -> bytes:
    """Return the bytes of one record."""
    body = HEAD.pack(kind, channel, round(stamp.monotonic * 1e9), round(stamp.wall * 1e9)) + payload
    return FRAME.pack(len(body), zlib.crc32(body)) + body


def described(path: str | os.PathLike[str], channel: int, payload: bytes, key: str) -> dict[str, Any]:
    """Return the JSON object in the payload of a channel (key "name") or of an event (key "state").

    Raises:
        BadRecording: If the payload is not a JSON object, or has no text under `key`.
    """
    try:
        info = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise BadRecording(f"{path}: the description of channel {channel} is not valid JSON") from error
    if not isinstance(info, dict) or not isinstance(info.get(key), str):
        raise BadRecording(f"{path}: channel {channel} has no {key}")
    return info


#: Function that is called with the completed part of the work, 0 to 1.
Progress = Callable[[float], object]


def unseen(part: float) -> None:
    """Ignore the progress."""


def new_file(path: Path, *, buffering: int = -1) -> IO[bytes]:
    """Create a file and open it for writing; see `open` for `buffering`.

    Raises:
        BadRecording: If the file exists, or cannot be created.
    """
    try:
        return path.open("xb", buffering=buffering)
    except FileExistsError:
        raise BadRecording(f"{path} exists; a recording never overwrites a file") from None
    except (OSError, ValueError) as error:  # ValueError if the name is invalid on every operating system
        raise BadRecording(f"cannot write {path}: {_reason(error)}") from error


class RecordingWriter(StrictAttributes):
    """Writer that appends records to a new file; several threads may call it.

    Raises:
        BadRecording: If the file exists, or cannot be created.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        # Unbuffered, so that the operating system keeps all written bytes even if this process dies.
        self._file = new_file(self.path, buffering=0)
        self._lock = threading.RLock()  # re-entrant, because a signal handler may close the robot
        self._is_closing = False
        self._channels = 0
        #: Message of the first error of the file, after which nothing is written; None if there was no error.
        self.failure: str | None = None
        try:
            self._append(MAGIC)
        except BadRecording:
            self._file.close()
            raise

    def add_channel(self, info: Mapping[str, Any]) -> int:
        """Declare a channel, and return its number.

        Args:
            info: Description of the channel. It must be representable in JSON, and have at least "name".

        Raises:
            BadValue: If `info` has no name, or has a value that JSON cannot represent, or if there are already 256
                channels.
            BadRecording, Closed: See `write`.
        """
        if not isinstance(info.get("name"), str):
            raise BadValue(f'info={info!r}; expected a mapping with a text under "name"')
        try:
            payload = json.dumps(dict(info)).encode()
        except (TypeError, ValueError, RecursionError) as error:
            raise BadValue(f"info={info!r}; expected values that JSON can represent: {error}") from None
        with self._lock:
            number = self._channels
            if number > 255:
                raise BadValue("a recording can have at most 256 channels")
            self._channels += 1
        self.write(Kind.CHANNEL, number, Stamp.now(), payload)
        return number

    def write(self, kind: Kind, channel: int, stamp: Stamp, payload: bytes) -> None:
        """Append one record.

        Raises:
            BadRecording: If this record or an earlier one could not be written.
            Closed: If the writer was closed.
        """
        data = pack(kind, channel, stamp, payload)
        with self._lock:
            if self._file.closed:
                raise Closed(f"{self.path} is closed")
            self._append(data)

    def add(self, channel: int, item: Chunk | ConnectionEvent) -> None:
        """Append received bytes, or an event of the connection.

        Raises:
            BadRecording, Closed: See `write`.
        """
        if isinstance(item, Chunk):
            self.write(Kind.BYTES, channel, item.received, item.data)
        else:
            error = None if item.error is None else str(item.error)
            event = json.dumps({"state": item.state.value, "error": error}).encode()
            self.write(Kind.EVENT, channel, item.received, event)

    def close(self, *, complete: bool = True) -> None:
        """Close the file; idempotent.

        If `complete`, write an end record, which shows that nothing is missing.

        Raises:
            BadRecording: If the end record cannot be written.
        """
        with self._lock:
            if self._is_closing:  # a signal handler might have interrupted the call that closes it
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
                    # A full disk might accept only a part of a record. Readers stop before this part, so nothing may be
                    # written after it.
                    self.failure = f"{self.path}: only {written} of {len(data)} bytes were written; is the disk full?"
            except ValueError:  # a signal handler has just closed it
                raise Closed(f"{self.path} is closed") from None
            except OSError as error:
                self.failure = f"cannot write {self.path}: {_reason(error)}"
        if self.failure is not None:
            raise BadRecording(self.failure)


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


class RecordingFile:
    """Recording that is opened for reading. The whole file is read once to find its channels.

    Args:
        path: Path of the file.
        progress: Function that is called with the fraction that has been read, 0 to 1.

    Attributes:
        path: Path of the file.
        channels: Number of each channel -> its description by the recorder.
        is_complete: Whether the recording was closed properly.
        left_out: Number of unfinished or damaged bytes at the end of the file.

    Raises:
        BadRecording: If there is no such file, or it is not a recording.
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
                # Checked here, so that a replay does not fail halfway.
                described(self.path, record.channel, record.payload, "state")
            elif record.kind is Kind.END:
                self.is_complete = True

    def __iter__(self) -> Iterator[Record]:
        """Iterate over the records; see `records`."""
        return self.records()

    def records(self, progress: Progress | None = None) -> Iterator[Record]:
        """Yield the records up to the end, or up to the first incomplete or damaged record.

        Afterwards, `left_out` is the number of the remaining bytes.

        Args:
            progress: Function that is called with the fraction that has been read, 0 to 1.

        Raises:
            BadRecording: If there is no such file, or it is not a recording.
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
                    continue  # a record of a later version of the format
                yield Record(Kind(kind), channel, Stamp(monotonic / 1e9, wall / 1e9), body[HEAD.size :])
            # The file might have grown meanwhile, because it can be read during the recording.
            self.left_out = max(size - at, 0)

    def channel(self, name: str) -> int:
        """Return the number of the channel `name`.

        Raises:
            BadRecording: If there is no such channel. The message lists the channels.
        """
        for number, info in self.channels.items():
            if info["name"] == name:
                return number
        there = ", ".join(info["name"] for info in self.channels.values()) or "nothing"
        raise BadRecording(f"{self.path} has no channel {name!r}; its channels are {there}")
