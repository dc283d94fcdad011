"""Robotiq grippers over the port of their URCap (63352), sans-IO: lines of ASCII in and out.

`SET NAME VALUE [NAME VALUE ...]` is answered by `ack`, `GET NAME` by `NAME VALUE`. Source: public clients
(docs/protocols/gripper.md, Lines). Some versions end their replies with a newline and some do not, and `ack` comes
without one: a value is whole at its newline, or once nothing more has come for `SETTLING`. What is not known: what is
answered to an unknown name; public clients meet `?` where the gripper is not connected to the controller.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from linkcore.errors import BadValue, LocalError, PacketError, WrongPeer

#: Variables that can be set: name -> largest value.
WRITABLE: Mapping[str, int] = {
    "ACT": 1,  # activate, or reset
    "GTO": 1,  # go to the request
    "ATR": 1,  # automatic release
    "ADR": 1,  # its direction
    "FOR": 255,  # force
    "SPE": 255,  # speed
    "POS": 255,  # requested position: 0 open, 255 closed
}
#: Variables that can be read; newer URCaps have more.
READABLE = (*WRITABLE, "STA", "PRE", "OBJ", "FLT", "COU")
#: Seconds without another byte after which a value without a newline counts as whole: the bytes of one reply leave the
#: URCap together.
SETTLING = 0.02
#: Bytes of a reply.
LONGEST = 256

_ACK = b"ack"
_VALUE = re.compile(r"([A-Z]{3}) (-?[0-9]{1,6})")


def set_line(values: Mapping[str, int]) -> str:
    """The line that sets these.

    Raises:
        BadValue: no such name, or a value out of range; nothing to set.

    >>> set_line({"POS": 255, "GTO": 1})
    'SET POS 255 GTO 1'
    """
    if not values:
        raise BadValue("nothing to set on the gripper")
    for name, value in values.items():
        if name not in WRITABLE:
            raise BadValue(f"a gripper has no {name!r} to be set; there are {', '.join(WRITABLE)}")
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= WRITABLE[name]:
            raise BadValue(f"{name} is {value!r}; expected a whole number from 0 to {WRITABLE[name]}")
    return "SET " + " ".join(f"{name} {value}" for name, value in values.items())


def get_line(name: str) -> str:
    """The line that asks for a value.

    Raises:
        BadValue: that cannot be a name.
    """
    if not isinstance(name, str) or not re.fullmatch(r"[A-Z]{3}", name):
        raise BadValue(f"{name!r} is no name of a gripper's value; expected three capital letters, such as 'POS'")
    return f"GET {name}"


def value_of(name: str, reply: str) -> int | None:
    """The value in the reply to ``GET name``; None where the gripper is not connected.

    Raises:
        PacketError: it says something else.

    >>> value_of("POS", "POS 255"), value_of("POS", "?")
    (255, None)
    """
    if reply in ("?", f"{name} ?"):
        return None
    found = _VALUE.fullmatch(reply)
    if found is None or found[1] != name:
        raise PacketError(f"{reply[:80]!r} is no value of {name}", packet=f"reply to 'GET {name}'")
    return int(found[2])


class GripperProtocol:
    """One connection: question and answer in turn. It has no greeting.

    Attributes:
        is_greeted: always.
    """

    is_greeted = True

    def __init__(self) -> None:
        self._rest = b""
        self._is_set: bool | None = None

    @property
    def is_in_step(self) -> bool:
        """Nothing was asked that was not answered, and nothing came that was not asked for."""
        return self._is_set is None and not self._rest.strip()

    @property
    def settling(self) -> float | None:
        """Seconds without more after which what has come is the reply; None while nothing that could be has come."""
        return None if self._is_set is None or not self._rest.strip() else SETTLING

    def ask(self, text: str) -> bytes:
        """The bytes of a line.

        Raises:
            LocalError: the reply to the line before this one has not come.
        """
        if not self.is_in_step:
            raise LocalError(f"{text!r} cannot be asked on a connection that is out of step")
        self._is_set = text.startswith("SET ")
        # A newline that came after the reply before this one.
        self._rest = b""
        return text.encode("ascii") + b"\n"

    def feed(self, data: bytes) -> str | None:
        """The reply, once it is whole; no bytes say that nothing more has come for `settling`.

        Raises:
            WrongPeer: this is not a gripper.
        """
        self._rest = (self._rest + data).lstrip()
        if len(self._rest) > LONGEST:
            raise WrongPeer(f"a gripper says short lines, but here is one that begins with {self._rest[:32]!r}")
        if self._is_set is None:
            return None
        line, end, rest = self._rest.partition(b"\n")
        if not end and self._is_set and line[: len(_ACK)].lower() == _ACK:
            line, rest = line[: len(_ACK)], line[len(_ACK) :]
        elif not end and (data or not line):
            return None
        self._rest, self._is_set = rest, None
        return line.decode("ascii", "backslashreplace").strip()
