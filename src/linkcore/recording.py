"""Recordings: raw bytes with their stamps in a file that survives a crash.

The file is append-only, big-endian::

    8 bytes   magic "LINKREC1"
    records   u32 length of what follows the checksum | u32 CRC-32 of it
              u8 kind | u8 channel | i64 monotonic ns | i64 wall ns | payload

    kind 0    channel: JSON object {"name": ..., and whatever the writer knows of the source}
    kind 1    bytes as they came
    kind 2    connection event: JSON object {"state": ..., "error": ...}
    kind 3    end: the recording was closed in good order

Each record goes to the operating system in one write, so a crash of the program loses nothing that
was recorded, and one of the machine at worst the tail. Reading stops before the first record that is
incomplete or damaged, and says how much it left out.
"""

from __future__ import annotations

import enum
import json
import os
import struct
import threading
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from .errors import BadRecording, BadValue
from .stamp import Stamp

__all__ = ["Kind", "Record", "Recording", "RecordingWriter"]

_MAGIC = b"LINKREC1"
_FRAME = struct.Struct(">II")
_HEAD = struct.Struct(">BBqq")
#: No record is larger: a longer length is damage.
_LARGEST = 1 << 26


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


class RecordingWriter:
    """Appends records to a new file; may be called from several threads.

    Raises:
        BadRecording: the file exists, or cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            # Unbuffered: what write() returned from is the operating system's to keep.
            self._file = open(self.path, "xb", buffering=0)  # noqa: SIM115
        except FileExistsError:
            raise BadRecording(f"{self.path} exists; a recording never overwrites one") from None
        except OSError as error:
            raise BadRecording(f"cannot write {self.path}: {error.strerror}") from error
        self._lock = threading.Lock()
        self._channels = 0
        self._file.write(_MAGIC)

    def add_channel(self, info: Mapping[str, Any]) -> int:
        """Declare a channel; `info` is JSON-ready and has at least "name". Returns its number."""
        with self._lock:
            number = self._channels
            self._channels += 1
        if number > 255:
            raise BadValue("a recording holds at most 256 channels")
        self.write(Kind.CHANNEL, number, Stamp.now(), json.dumps(dict(info)).encode())
        return number

    def write(self, kind: Kind, channel: int, stamp: Stamp, payload: bytes) -> None:
        """Append one record."""
        body = _HEAD.pack(kind, channel, round(stamp.monotonic * 1e9), round(stamp.wall * 1e9)) + payload
        data = _FRAME.pack(len(body), zlib.crc32(body)) + body
        with self._lock:
            if self._file.closed:
                raise BadRecording(f"{self.path} is closed")
            written = self._file.write(data)
            if written != len(data):
                # A full disk takes half a record: readers stop before it, and so do we.
                raise BadRecording(f"{self.path}: only {written} of {len(data)} bytes were taken")

    def close(self) -> None:
        """Write the end record and close; idempotent."""
        if not self._file.closed:
            self.write(Kind.END, 0, Stamp.now(), b"")
            with self._lock:
                self._file.close()


class Recording:
    """A recording to read.

    Attributes:
        path: the file.
        channels: number of each channel -> what the writer said of it.

    Raises:
        BadRecording: no such file, or not a recording.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.channels: dict[int, dict[str, Any]] = {}
        self.is_complete = False
        self.left_out = 0
        try:
            with open(self.path, "rb") as file:
                magic = file.read(len(_MAGIC))
        except OSError as error:
            raise BadRecording(f"cannot read {self.path}: {error.strerror}") from error
        if magic != _MAGIC:
            raise BadRecording(f"{self.path} is not a recording: it begins with {magic!r}, not {_MAGIC!r}")
        for record in self:
            if record.kind is Kind.CHANNEL:
                self.channels[record.channel] = self._info(record)
            elif record.kind is Kind.END:
                self.is_complete = True

    def _info(self, record: Record) -> dict[str, Any]:
        try:
            info = json.loads(record.payload)
        except ValueError as error:
            raise BadRecording(f"{self.path}: channel {record.channel} is not described in JSON") from error
        if not isinstance(info, dict) or not isinstance(info.get("name"), str):
            raise BadRecording(f"{self.path}: channel {record.channel} has no name")
        return info

    def __iter__(self) -> Iterator[Record]:
        """The records up to the end, or to the first that is incomplete or damaged.

        `left_out` then says how many bytes follow.
        """
        with open(self.path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            at = len(file.read(len(_MAGIC)))
            while True:
                frame = file.read(_FRAME.size)
                if len(frame) < _FRAME.size:
                    break
                length, checksum = _FRAME.unpack(frame)
                if not _HEAD.size <= length <= _LARGEST:
                    break
                body = file.read(length)
                if len(body) < length or zlib.crc32(body) != checksum:
                    break
                at += _FRAME.size + length
                kind, channel, monotonic, wall = _HEAD.unpack_from(body)
                if kind > Kind.END:
                    continue  # of a later version of the format
                yield Record(Kind(kind), channel, Stamp(monotonic / 1e9, wall / 1e9), body[_HEAD.size :])
            self.left_out = size - at

    def channel(self, name: str) -> int:
        """Number of the channel called `name`.

        Raises:
            BadRecording: there is none; says which there are.
        """
        for number, info in self.channels.items():
            if info["name"] == name:
                return number
        there = ", ".join(info["name"] for info in self.channels.values()) or "nothing"
        raise BadRecording(f"{self.path} holds no {name}; it holds {there}")
