"""Packages of RTDE (port 30004): one class for each, its layouts under protocol 1 and 2, and the frame boundaries.

A request and its reply have the same type byte, so the meaning of a package depends on its sender: `decode_request`
decodes packages of a client, and `decode_reply` decodes packages of a controller. The *version* of these layouts is the
version of the protocol, ``"1.0"`` or ``"2.0"``. A recipe defines the layout of a data package
(`urlink.protocol.rtde.recipes`).

A package begins with its size in two bytes and its type in one byte.

Sources: docs/protocols/rtde.md, section Packages: the vendor's article, public drivers, recorded connections.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal

from linkcore.clock import Stamp
from linkcore.errors import PacketError, altered
from linkcore.wire.fields import Coded, Float64b, Header, Int8ub, Int16ub, Int32ub, OpenInt, Raw, Text
from linkcore.wire.packet import State, packet, wire

from ..headers import interface_of
from .variables import IN_USE, NOT_FOUND

#: Versions of the protocol. Version 1 is used until the client has requested version 2 and the controller accepts it.
Protocol = Literal[1, 2]

#: Header of every package. The size includes these three bytes.
HEADER = Header(size=Int16ub, type=Int8ub)

#: Maximum length of the names in one request, in bytes (vendor's guide).
LONGEST_NAMES = 2048

_BOOL = Coded(Int8ub, bool)
_NAMES_DOC = "names of the variables, separated by commas"
_TYPES_DOC = f"a type for each name, or {NOT_FOUND} or {IN_USE}, separated by commas"


class MessageLevel(OpenInt):
    """Severity of a text message."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


def join_names(names: Sequence[str]) -> str:
    """Join a list of names or types as on the wire."""
    return ",".join(names)


def split_names(text: str) -> tuple[str, ...]:
    """Split a list of names or types, as it is on the wire.

    Real clients put blanks around names, and end the list with a comma. The empty name after it is dropped.

    >>> split_names("timestamp, actual_q,")
    ('timestamp', 'actual_q')
    """
    names = tuple(name.strip() for name in text.split(","))
    return names if names[-1] else names[:-1]


# -- from a client -------------------------------------------------------------------------------


@packet(header=HEADER, type=ord("V"))
class ProtocolRequest(State):
    """Request for a version of the protocol."""

    wanted: int = wire(Int16ub, "", "requested version of the protocol, 1 or 2")


@packet(header=HEADER, type=ord("v"))
class ControllerVersionRequest(State):
    """Request for the software version of the controller."""


@packet(header=HEADER, type=ord("O"))
class OutputsRequest(State):
    """Request for output variables. There is one such recipe; each request replaces the previous one."""

    frequency: float | None = wire(Float64b, "Hz", "requested rate; protocol 1: 125 Hz", since="2.0")
    names: str = wire(Text(), "", _NAMES_DOC, since="1.0")


@packet(header=HEADER, type=ord("I"))
class InputsRequest(State):
    """Claim of input variables, in order to write them. A client can have up to 255 such recipes."""

    names: str = wire(Text(), "", _NAMES_DOC)


@packet(header=HEADER, type=ord("S"))
class StartRequest(State):
    """Request to start sending data packages."""


@packet(header=HEADER, type=ord("P"))
class PauseRequest(State):
    """Request to stop sending data packages."""


# -- from a controller ---------------------------------------------------------------------------


@packet(header=HEADER, type=ord("V"))
class ProtocolReply(State):
    """Reply to a request for a version of the protocol."""

    accepted: bool = wire(_BOOL, "", "whether the requested version is used from now on")


@packet(header=HEADER, type=ord("v"))
class ControllerVersionReply(State):
    """Software version of the controller."""

    major: int = wire(Int32ub, "", "major version")
    minor: int = wire(Int32ub, "", "minor version")
    bugfix: int = wire(Int32ub, "", "bug fix")
    build: int = wire(Int32ub, "", "build")


@packet(header=HEADER, type=ord("O"))
class OutputsReply(State):
    """Types of the requested outputs. Under protocol 1, only the types show a refusal."""

    recipe: int | None = wire(Int8ub, "", "number of the recipe; 0: refused", since="2.0")
    types: str = wire(Text(), "", _TYPES_DOC, since="1.0")


@packet(header=HEADER, type=ord("I"))
class InputsReply(State):
    """Types of the claimed inputs."""

    recipe: int = wire(Int8ub, "", "number of the recipe; 0: refused")
    types: str = wire(Text(), "", _TYPES_DOC)


@packet(header=HEADER, type=ord("S"))
class StartReply(State):
    """Reply to a request to start."""

    accepted: bool = wire(_BOOL, "", "whether data packages will follow")


@packet(header=HEADER, type=ord("P"))
class PauseReply(State):
    """Reply to a request to stop. According to the vendor's guide, the controller always accepts it."""

    accepted: bool = wire(_BOOL, "", "whether no more data packages will follow")


# -- from both -----------------------------------------------------------------------------------


@packet(header=HEADER, type=ord("M"), reorder=("2.0", ["level", "message", "source"]))
class RtdeMessage(State):
    """Text message, which can arrive at any time and has no reply. Clients always send it in the form of protocol 2."""

    IS_EVENT = True

    message: str = wire(Text(Int8ub), "", "text, under protocol 2 of at most 255 bytes", before=("2.0", Text()))
    source: str | None = wire(Text(Int8ub), "", "sender of the message", since="2.0")
    level: MessageLevel = wire(Coded(Int8ub, MessageLevel), "", "severity of the message")


@packet(header=HEADER, type=ord("U"))
class DataPackage(State):
    """Encoded values of a recipe. Packages from a controller under protocol 1 do not contain the recipe number."""

    recipe: int | None = wire(Int8ub, "", "number of the recipe", since="2.0")
    payload: bytes = wire(Raw(), "", "encoded values", since="1.0")


# -- by type byte --------------------------------------------------------------------------------

#: Type byte -> class of the package from a client.
REQUESTS: Mapping[int, type[State]] = MappingProxyType(
    {
        ord("V"): ProtocolRequest,
        ord("v"): ControllerVersionRequest,
        ord("O"): OutputsRequest,
        ord("I"): InputsRequest,
        ord("S"): StartRequest,
        ord("P"): PauseRequest,
        ord("M"): RtdeMessage,
        ord("U"): DataPackage,
    }
)

#: Type byte -> class of the package from a controller.
REPLIES: Mapping[int, type[State]] = MappingProxyType(
    {
        ord("V"): ProtocolReply,
        ord("v"): ControllerVersionReply,
        ord("O"): OutputsReply,
        ord("I"): InputsReply,
        ord("S"): StartReply,
        ord("P"): PauseReply,
        ord("M"): RtdeMessage,
        ord("U"): DataPackage,
    }
)

# Types of client packages that have the same form in both versions of the protocol.
_ALWAYS_V2 = frozenset(b"MU")


def decode_request(frame: bytes, protocol: Protocol) -> State:
    """Decode one whole package from a client, under the given version of the protocol.

    Raises:
        PacketError: If the type is unknown, or the package is too short for its type.
    """
    return _decode(frame, REQUESTS, 2 if _ALWAYS_V2.issuperset(frame[2:3]) else protocol, None)


def decode_reply(frame: bytes, protocol: Protocol, stamp: Stamp | None = None) -> State:
    """Decode one whole package from a controller, under the given version of the protocol.

    Raises:
        PacketError: If the type is unknown, or the package is too short for its type.
    """
    return _decode(frame, REPLIES, protocol, stamp)


def _decode(frame: bytes, kinds: Mapping[int, type[State]], protocol: Protocol, stamp: Stamp | None) -> State:
    if len(frame) < HEADER.width:
        raise PacketError("the package is too short", packet="RTDE package", expected=HEADER.width, actual=len(frame))
    kind = kinds.get(frame[2])
    if kind is None:
        raise PacketError(f"it has the unknown type {frame[2]}", packet="RTDE package", offset=2)
    try:
        return kind.LAYOUTS.of((protocol, 0)).decode(frame, stamp)  # type: ignore[no-any-return]
    except PacketError as error:  # drop the version: it is a version of the protocol rather than of a firmware
        raise altered(error, version=None) from None


# -- frame boundaries ------------------------------------------------------------------------------

# Larger packages are not accepted. The values of all 406 variables have 2.9 kB, and their names about 10 kB, in several
# requests. The reply to 1024 unknown names of one letter would be 10 kB of NOT_FOUND.
_LARGEST = 1 << 14

_HEAD = struct.Struct(">HB")

# Number of bytes that are needed to recognise another interface.
_PEER = 5


def _sizes(kind: type[State]) -> range:
    """Return the possible sizes of a package, including the header."""
    least = min(layout.size for layout in kind.LAYOUTS.all)
    return range(least, _LARGEST if kind.LAYOUTS.all[0].has_text else least + 1)


#: Type byte -> possible sizes of packages from a controller, including the header.
REPLY_SIZES: Mapping[int, range] = MappingProxyType({type: _sizes(kind) for type, kind in REPLIES.items()})


class RtdeBoundary:
    """Frame boundaries of the packages from a controller.

    While the boundary is known, a package is accepted if its type can have its size. While the boundary is lost, a
    package is accepted if another package follows it. Packages of unknown types are accepted after the first known
    package, if another package follows them.

    Attributes:
        sizes: Type byte -> possible sizes of a package of this type.
    """

    sizes: Mapping[int, range] = REPLY_SIZES

    largest = _LARGEST + _HEAD.size
    pace = 64
    size, head = 0, b""
    last: bytes | bytearray = b""

    def __init__(self) -> None:
        self._is_begun = False

    def __str__(self) -> str:
        return "RTDE (port 30004)"

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        """Return the package if exactly one fills the buffer, which is the common case."""
        there = len(buffer)
        if there < _HEAD.size:
            return []
        size, kind = _HEAD.unpack_from(buffer)
        if size != there or size not in self.sizes.get(kind, ()):
            return []
        self._is_begun = True
        return [bytes(buffer)]

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """See `FrameBoundary.check`."""
        there = len(buffer) - at
        if there < _HEAD.size:
            return 0, _HEAD.size
        size, kind = _HEAD.unpack_from(buffer, at)
        sizes = self.sizes.get(kind)
        if sizes is not None and size in sizes:
            self._is_begun = True
            return size, size
        if sizes is None and self._is_begun and _HEAD.size <= size < _LARGEST:
            return self._followed(buffer, at, size)
        # At the beginning, the peer might be another service. A few more bytes are needed to recognise it.
        return 0, 0 if self._is_begun else _PEER

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        """See `FrameBoundary.search`."""
        sizes = self.sizes
        last = len(buffer) - _HEAD.size
        for at in range(start, last + 1):
            kind = buffer[at + 2]
            if kind not in sizes:
                continue
            size = (buffer[at] << 8) | buffer[at + 1]
            if size not in sizes[kind]:
                continue
            found, need = self._followed(buffer, at, size)
            if found or need > len(buffer) - at:
                return at, found, need
        return max(start, last + 1), 0, _HEAD.size

    def peer(self, buffer: bytes | bytearray) -> str | None:
        """See `FrameBoundary.peer`."""
        return interface_of(buffer) if len(buffer) >= _PEER else None

    def _followed(self, buffer: bytes | bytearray, at: int, size: int) -> tuple[int, int]:
        """Check as `check` does: a package is accepted if one of a known type and a valid size follows it."""
        need = size + _HEAD.size
        if len(buffer) - at < need:
            return size, need
        next_size, next_kind = _HEAD.unpack_from(buffer, at + size)
        if next_size not in self.sizes.get(next_kind, ()):
            return 0, 0
        self._is_begun = True
        return size, need
