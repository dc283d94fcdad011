"""Modbus TCP for the few registers of a gripper, sans-IO: read holding registers, and write them.

A frame has a header of seven bytes (transaction, 0, number of the following bytes, unit), the function and its data.
All numbers are big-endian. Sources: MODBUS Messaging on TCP/IP Implementation Guide V1.0b, and MODBUS Application
Protocol V1.1b3 (functions 3 and 16). The tests compare both directions with pymodbus.

`linkcore.net.dialogue` exchanges texts, so a request is a line such as ``read 258 18`` or ``write 0 200 1100 16``. The
reply to a read is the values, separated by spaces. The reply to a write is ``written``. If the peer rejects a request,
the reply is ``exception`` and its code.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from linkcore.arguments import check_whole
from linkcore.errors import BadValue, LocalError, PacketError, WrongPeer

#: Functions: read holding registers, and write several registers.
READ, WRITE = 3, 16
#: Bit of the function in the reply to a rejected request.
REJECTED = 0x80
#: Maximum number of registers that one request reads or writes.
MOST_READ, MOST_WRITTEN = 125, 123
#: Transaction, protocol (always 0), number of bytes that follow, unit.
HEADER = struct.Struct(">HHHB")
#: Smallest and largest number of bytes that follow in a frame: the unit, the function and its data.
_SHORTEST, _LONGEST = 3, 254
_TWO = struct.Struct(">HH")

#: Codes of exceptions. Source: MODBUS Application Protocol V1.1b3, section 7.
EXCEPTIONS = {
    1: "the function is not supported",
    2: "a register does not exist",
    3: "a value is not allowed",
    4: "the device failed",
    6: "the device is busy",
    10: "the gateway has no path to the device",
    11: "the device behind the gateway does not respond",
}


def read_line(first: int, count: int) -> str:
    """Return the line that reads `count` registers.

    Raises:
        BadValue: If the range of registers is invalid.

    >>> read_line(258, 18)
    'read 258 18'
    """
    check_whole(count, "count", 1, MOST_READ)
    return f"read {check_whole(first, 'first', 0, 0x10000 - count)} {count}"


def write_line(first: int, values: Sequence[int]) -> str:
    """Return the line that writes consecutive registers.

    Raises:
        BadValue: If the range of registers or a value is invalid.

    >>> write_line(0, (200, 1100, 16))
    'write 0 200 1100 16'
    """
    check_whole(len(values), "number of values", 1, MOST_WRITTEN)
    check_whole(first, "first", 0, 0x10000 - len(values))
    words = (check_whole(value, "value of a register", 0, 0xFFFF) for value in values)
    return f"write {first} {' '.join(map(str, words))}"


def values_of(reply: str) -> tuple[int, ...] | None:
    """Return the values in the reply to a read; None if the peer rejected the request.

    >>> values_of("1100 3"), values_of("exception 2")
    ((1100, 3), None)
    """
    return None if reply.startswith("exception") else tuple(map(int, reply.split()))


def rejection(reply: str) -> str:
    """Return the reason for a rejected request; empty if the request was executed.

    >>> rejection("exception 2"), rejection("written")
    ('exception 2: a register does not exist', '')
    """
    if not reply.startswith("exception"):
        return ""
    return f"{reply}: {EXCEPTIONS.get(int(reply.split()[1]), 'unknown reason')}"


def frame(transaction: int, unit: int, data: bytes) -> bytes:
    """Return a frame: the header, and the function with its data."""
    return HEADER.pack(transaction, 0, 1 + len(data), unit) + data


def split_frame(received: bytes) -> tuple[int, int, bytes, bytes] | None:
    """Return transaction, unit, function with data, and the bytes after the first frame; None if it is incomplete.

    Raises:
        WrongPeer: If the bytes are not Modbus TCP.
    """
    if len(received) < HEADER.size:
        return None
    transaction, protocol, size, unit = HEADER.unpack_from(received)
    if protocol != 0 or not _SHORTEST <= size <= _LONGEST:
        raise WrongPeer(f"{received[:16]!r} is not the start of a Modbus TCP frame")
    end = HEADER.size - 1 + size
    if len(received) < end:
        return None
    return transaction, unit, received[HEADER.size : end], received[end:]


class ModbusTcpProtocol:
    """State of one connection. Requests and replies alternate, without a greeting.

    Args:
        unit: Number of the device behind the peer, 0 to 255.

    Attributes:
        is_greeted: Always True.
        settling: Always None, because the header of a reply contains its size.
    """

    is_greeted = True
    settling = None

    def __init__(self, unit: int) -> None:
        self._unit = unit
        self._transaction = 0
        self._rest = b""
        self._request: bytes | None = None

    @property
    def is_in_step(self) -> bool:
        """Whether every request was answered, and no unexpected bytes have arrived."""
        return self._request is None and not self._rest

    def ask(self, text: str) -> bytes:
        """Return the bytes of a request; `text` is the result of `read_line` or `write_line`.

        Raises:
            BadValue: If the text is not a request.
            LocalError: If the reply to the previous request has not arrived.
        """
        if not self.is_in_step:
            raise LocalError(f"{text!r} cannot be sent, because the connection is out of step: use a new connection")
        word, *numbers = text.split()
        first, *values = map(int, numbers)
        if word == "read":
            data = bytes((READ,)) + _TWO.pack(first, *values)
        elif word == "write":
            words = struct.pack(f">{len(values)}H", *values)
            data = bytes((WRITE,)) + _TWO.pack(first, len(values)) + bytes((len(words),)) + words
        else:
            raise BadValue(f"{text!r} is not a request; expected a line of read_line or write_line")
        self._transaction = (self._transaction + 1) & 0xFFFF
        self._request = data
        return frame(self._transaction, self._unit, data)

    def feed(self, data: bytes) -> str | None:
        """Process received bytes, and return the reply when it is complete.

        Raises:
            WrongPeer: If the peer does not send Modbus TCP, or answers another request.
            PacketError: If the size of the reply does not belong to the request.
        """
        self._rest += data
        found = None if self._request is None else split_frame(self._rest)
        if found is None:
            return None
        assert self._request is not None
        request, self._request = self._request, None
        transaction, _, body, self._rest = found
        if transaction != self._transaction or body[0] & ~REJECTED != request[0]:
            raise WrongPeer(
                f"{body[:8]!r} of transaction {transaction} does not answer transaction {self._transaction}"
            )
        if body[0] & REJECTED:
            return f"exception {body[1]}"
        if body[0] == WRITE:
            if body[1:] != request[1:5]:
                raise PacketError(f"{body[:16]!r} does not confirm {request[:5]!r}", packet="reply to a write")
            return "written"
        _, count = _TWO.unpack_from(request, 1)
        if len(body) != 2 + 2 * count or body[1] != 2 * count:
            raise PacketError(f"{body[:16]!r} does not contain {count} registers", packet="reply to a read")
        return " ".join(map(str, struct.unpack_from(f">{count}H", body, 2)))
