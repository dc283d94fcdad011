"""The records of a recording, and their bytes in the file (format: `linkcore.recording.file`)."""

from __future__ import annotations

import enum
import struct
import zlib
from typing import NamedTuple

from ..stamp import Stamp

__all__ = ["FRAME", "HEAD", "LARGEST", "MAGIC", "Kind", "Record", "pack"]

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
