"""Protocol of Robotiq grippers over the port of their URCap (63352), sans-IO: lines of ASCII.

The reply to `SET NAME VALUE [NAME VALUE ...]` is `ack`, and the reply to `GET NAME` is `NAME VALUE`. Source: public
clients (docs/protocols/gripper.md, Lines). Some versions end their replies with a newline, others do not, and `ack` has
no newline. Therefore a value is complete at its newline, or after `SETTLING` seconds without more bytes. The reply to
an unknown name is not documented. Public clients receive `?` if the gripper is not connected to the controller.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from linkcore.errors import BadValue, LocalError, PacketError, WrongPeer

#: Variables that can be set: name -> maximum value.
WRITABLE: Mapping[str, int] = {
    "ACT": 1,  # activate, or reset
    "GTO": 1,  # move to the requested position
    "ATR": 1,  # automatic release
    "ADR": 1,  # direction of the automatic release
    "FOR": 255,  # force
    "SPE": 255,  # speed
    "POS": 255,  # requested position: 0 open, 255 closed
}
#: Variables that can be read; newer URCaps have more.
READABLE = (*WRITABLE, "STA", "PRE", "OBJ", "FLT", "COU")
#: Time in seconds without another byte after which a value without a newline is complete. The URCap sends the bytes of
#: one reply together.
SETTLING = 0.02
#: Maximum length of a reply, in bytes.
LONGEST = 256

_ACK = b"ack"
_VALUE = re.compile(r"([A-Z]{3}) (-?[0-9]{1,6})")


def set_line(values: Mapping[str, int], writable: Mapping[str, int] = WRITABLE) -> str:
    """Return the line that sets these variables.

    Args:
        values: Name -> value.
        writable: Names that can be set, and their maximum values.

    Raises:
        BadValue: If a name is unknown, a value is out of range, or no value is given.

    >>> set_line({"POS": 255, "GTO": 1})
    'SET POS 255 GTO 1'
    """
    if not values:
        raise BadValue("no variable to set on the gripper; pass at least one NAME=VALUE")
    for name, value in values.items():
        if name not in writable:
            raise BadValue(f"{name!r} cannot be set on a gripper; expected one of {', '.join(writable)}")
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= writable[name]:
            raise BadValue(f"{name} is {value!r}; expected a whole number from 0 to {writable[name]}")
    return "SET " + " ".join(f"{name} {value}" for name, value in values.items())


def get_line(name: str) -> str:
    """Return the line that queries a value.

    Raises:
        BadValue: If `name` cannot be a name.
    """
    if not isinstance(name, str) or not re.fullmatch(r"[A-Z]{3}", name):
        raise BadValue(f"{name!r} is not a gripper variable; expected three capital letters, such as 'POS'")
    return f"GET {name}"


def value_of(name: str, reply: str) -> int | None:
    """Parse the value in the reply to ``GET name``; None if the gripper is not connected.

    Raises:
        PacketError: If the reply has another form.

    >>> value_of("POS", "POS 255"), value_of("POS", "?")
    (255, None)
    """
    if reply in ("?", f"{name} ?"):
        return None
    found = _VALUE.fullmatch(reply)
    if found is None or found[1] != name:
        raise PacketError(
            f"{reply[:80]!r} is not a value of {name}; expected a number", packet=f"reply to 'GET {name}'"
        )
    return int(found[2])


class GripperProtocol:
    """State of one connection. Lines and replies alternate, without a greeting.

    Attributes:
        is_greeted: Always True.
    """

    is_greeted = True

    def __init__(self) -> None:
        self._rest = b""
        self._is_set: bool | None = None

    @property
    def is_in_step(self) -> bool:
        """Whether every line was answered, and no unexpected bytes have arrived."""
        return self._is_set is None and not self._rest.strip()

    @property
    def settling(self) -> float | None:
        """Time in seconds without more bytes after which the reply is complete; None if no reply has begun."""
        return None if self._is_set is None or not self._rest.strip() else SETTLING

    def ask(self, text: str) -> bytes:
        """Return the bytes of a line to send.

        Raises:
            LocalError: If the reply to the previous line has not arrived.
        """
        if not self.is_in_step:
            raise LocalError(f"{text!r} cannot be sent, because the connection is out of step: use a new connection")
        self._is_set = text.startswith("SET ")
        # Drop a newline that arrived after the previous reply.
        self._rest = b""
        return text.encode("ascii") + b"\n"

    def feed(self, data: bytes) -> str | None:
        """Process received bytes, and return the reply when it is complete.

        No bytes mean that nothing has arrived for `settling` seconds.

        Raises:
            WrongPeer: If the peer is not a gripper.
        """
        self._rest = (self._rest + data).lstrip()
        if len(self._rest) > LONGEST:
            raise WrongPeer(f"the line that starts with {self._rest[:32]!r} is too long for a reply of a gripper")
        if self._is_set is None:
            return None
        line, end, rest = self._rest.partition(b"\n")
        if not end and self._is_set and line[: len(_ACK)].lower() == _ACK:
            line, rest = line[: len(_ACK)], line[len(_ACK) :]
        elif not end and (data or not line):
            return None
        self._rest, self._is_set = rest, None
        return line.decode("ascii", "backslashreplace").strip()
