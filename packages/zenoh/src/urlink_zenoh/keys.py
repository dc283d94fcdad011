"""Keys and encodings of the name space, and attachments of packets; `keys.json` has a schema for each payload.

==================================  ===================================================================
key, below ``urlink/v1/NAME``       content
==================================  ===================================================================
``alive``                           liveliness token of the server
``info``                            JSON: model and firmware of the robot, and the layout of its packets
``realtime``, ``primary``           packets as the robot sent them, with their firmware in the encoding
``status``                          JSON, several times per second: joints, tool, modes, interlock, motion
``connection``                      JSON: changes of the connection between server and robot
``motion``                          JSON: start and end of each motion
``clock``                           queries, answered in JSON with the time of the server
``command/COMMAND``                 queries with arguments in JSON, answered in JSON
``client/ID``                       liveliness tokens of the clients that move the robot
==================================  ===================================================================

Clients can subscribe to all keys except the tokens, ``clock`` and ``command``, and can query them for the newest value.
"""

from __future__ import annotations

import re
import struct

import zenoh

from urlink import BadValue
from urlink.packets import Stamp

__all__ = ["JSON", "PREFIX", "VERSION", "attachment", "check_name", "firmware_of", "key_of", "packets_of", "stamped"]

#: Default for the first part of all keys.
PREFIX = "urlink"
#: Version of keys and payloads, a part of every key. It changes only if older clients would misread the new format.
VERSION = 1
JSON = zenoh.Encoding.APPLICATION_JSON

_BYTES = zenoh.Encoding.APPLICATION_OCTET_STREAM
#: Number of the packet since its server started; monotonic and wall time of its arrival there, in ns.
_ATTACHMENT = struct.Struct("<Qqq")
_SCHEMA = re.compile(r".*;urlink\.(\w+)/([\d.]+)")


def check_name(name: str) -> str:
    """Return the name of a robot if it can be one part of a key.

    Raises:
        BadValue: If it contains other characters, such as the separator or a wildcard of keys.
    """
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        raise BadValue(f"{name!r} cannot be part of a key; expected letters, digits, '_', '.' and '-'")
    return name


def key_of(prefix: str, name: str) -> str:
    """Return the first part of the keys of a robot; of all robots if the name is ``*``."""
    return f"{prefix}/v{VERSION}/{name}"


def packets_of(interface: str, firmware: object) -> zenoh.Encoding:
    """Return the encoding of packets, which names the layout for reading them."""
    return _BYTES.with_schema(f"urlink.{interface}/{firmware}")


def firmware_of(encoding: zenoh.Encoding) -> tuple[str, str] | None:
    """Return interface and firmware of an encoding of packets; None for other encodings."""
    match = _SCHEMA.fullmatch(str(encoding))
    return None if match is None else (match[1], match[2])


def attachment(sequence: int, received: Stamp) -> bytes:
    """Return the attachment of a packet."""
    return _ATTACHMENT.pack(sequence, round(received.monotonic * 1e9), round(received.wall * 1e9))


def stamped(data: bytes) -> tuple[int, Stamp]:
    """Return number and stamp of a packet from its attachment.

    Raises:
        BadValue: If the attachment has the wrong size.
    """
    if len(data) != _ATTACHMENT.size:
        raise BadValue(f"the attachment has {len(data)} bytes; expected {_ATTACHMENT.size}")
    sequence, monotonic, wall = _ATTACHMENT.unpack(data)
    return sequence, Stamp(monotonic / 1e9, wall / 1e9)
