"""The records of a recording, and their bytes in the file (format: `linkcore.recording.file`)."""

from __future__ import annotations

import enum
import json
import os
import struct
import zlib
from typing import Any, NamedTuple

from ..errors import BadRecording
from ..stamp import Stamp

__all__ = ["FRAME", "HEAD", "LARGEST", "MAGIC", "Kind", "Record", "described", "pack"]

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
        BadRecording: it is none, or holds no text under `key`.
    """
    try:
        info = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise BadRecording(f"{path}: channel {channel} is not described in JSON") from error
    if not isinstance(info, dict) or not isinstance(info.get(key), str):
        raise BadRecording(f"{path}: channel {channel} has no {key}")
    return info
