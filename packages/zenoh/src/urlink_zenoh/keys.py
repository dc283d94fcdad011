"""The name space: keys, encodings, and what stands beside a payload; `keys.json` has a schema for each payload.

==================================  ===================================================================
key, below ``urlink/v1/NAME``       what it is
==================================  ===================================================================
``alive``                           liveliness token of whoever serves the robot
``info``                            JSON: who the robot is, and the layout of its packets
``realtime``, ``primary``           packets as the robot sent them, with their firmware in the encoding
``status``                          JSON, some times a second: joints, tool, modes, interlock, motion
``connection``                      JSON: the connection between server and robot was made, lost, ...
``motion``                          JSON: a motion has begun, or is over
``clock``                           queries, answered in JSON by the clock of the server
``command/COMMAND``                 queries with arguments in JSON, answered in JSON
``client/ID``                       liveliness tokens of the clients that move the robot
==================================  ===================================================================

All but the tokens, ``clock`` and ``command`` can be subscribed to, and queried for the newest value.
"""

from __future__ import annotations

import re
import struct

import zenoh

from urlink import BadValue
from urlink.packets import Stamp

__all__ = ["JSON", "PREFIX", "VERSION", "attachment", "check_name", "firmware_of", "key_of", "packets_of", "stamped"]

#: What all keys begin with, where nothing else is chosen.
PREFIX = "urlink"
#: Of keys and payloads, a part of every key: it changes where a client of those before would read them wrongly.
VERSION = 1
JSON = zenoh.Encoding.APPLICATION_JSON

_BYTES = zenoh.Encoding.APPLICATION_OCTET_STREAM
#: Number of the sample since its server began; monotonic and wall time at which the packet arrived there, ns.
_ATTACHMENT = struct.Struct("<Qqq")
_SCHEMA = re.compile(r".*;urlink\.(\w+)/([\d.]+)")


def check_name(name: str) -> str:
    """The name of a robot, which is one part of a key.

    Raises:
        BadValue: it holds what separates parts, or stands for several.
    """
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        raise BadValue(f"{name!r} cannot be part of a key; expected letters, digits, '_', '.' and '-'")
    return name


def key_of(prefix: str, name: str) -> str:
    """What the keys of a robot begin with; of all robots with ``*`` as their name."""
    return f"{prefix}/v{VERSION}/{name}"


def packets_of(interface: str, firmware: object) -> zenoh.Encoding:
    """The encoding of packets: it says by which layout they are to be read."""
    return _BYTES.with_schema(f"urlink.{interface}/{firmware}")


def firmware_of(encoding: zenoh.Encoding) -> tuple[str, str] | None:
    """Interface and firmware of such an encoding; None for another."""
    match = _SCHEMA.fullmatch(str(encoding))
    return None if match is None else (match[1], match[2])


def attachment(sequence: int, received: Stamp) -> bytes:
    """What goes beside a packet."""
    return _ATTACHMENT.pack(sequence, round(received.monotonic * 1e9), round(received.wall * 1e9))


def stamped(data: bytes) -> tuple[int, Stamp]:
    """Number and stamp of a packet, out of what stands beside it.

    Raises:
        BadValue: it is none of ours.
    """
    if len(data) != _ATTACHMENT.size:
        raise BadValue(f"an attachment of {len(data)} bytes; expected {_ATTACHMENT.size}")
    sequence, monotonic, wall = _ATTACHMENT.unpack(data)
    return sequence, Stamp(monotonic / 1e9, wall / 1e9)
