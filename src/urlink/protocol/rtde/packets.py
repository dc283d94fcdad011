"""The packages of RTDE (TCP 30004): one class for each, in its layouts under protocol 1 and 2, and where they end.

A request and its reply have the same type byte, so what a package is depends on who sent it: `decode_request` reads
what a client sends, `decode_reply` what a controller sends. The *version* of these layouts is that of the protocol,
``"1.0"`` or ``"2.0"``. The values of a data package are laid out by a recipe (`urlink.protocol.rtde.recipes`).

A package begins with its size in two bytes and its type in one.

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

#: The versions of the protocol. 1 holds until 2 has been asked for and accepted.
Protocol = Literal[1, 2]

#: The header of every package. The size counts these three bytes too.
HEADER = Header(size=Int16ub, type=Int8ub)

#: Bytes of names in one request (vendor's guide).
LONGEST_NAMES = 2048

_BOOL = Coded(Int8ub, bool)
_NAMES_DOC = "names of the variables, with commas between them"
_TYPES_DOC = f"a type for each name, or {NOT_FOUND} or {IN_USE}, with commas between them"


class MessageLevel(OpenInt):
    """How grave a text message is."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


def join_names(names: Sequence[str]) -> str:
    """A list of names, or of types, as it lies on the wire."""
    return ",".join(names)


def split_names(text: str) -> tuple[str, ...]:
    """The names, or types, in such a list.

    Real clients put blanks around names, and end the list with a comma: what follows it is not a name.

    >>> split_names("timestamp, actual_q,")
    ('timestamp', 'actual_q')
    """
    names = tuple(name.strip() for name in text.split(","))
    return names if names[-1] else names[:-1]


# -- from a client -------------------------------------------------------------------------------


@packet(header=HEADER, type=ord("V"))
class ProtocolRequest(State):
    """Asks for a version of the protocol."""

    wanted: int = wire(Int16ub, "", "version of the protocol, 1 or 2")


@packet(header=HEADER, type=ord("v"))
class ControllerVersionRequest(State):
    """Asks for the version of the controller's software."""


@packet(header=HEADER, type=ord("O"))
class OutputsRequest(State):
    """Asks for variables. There is one such recipe; it replaces the one before."""

    frequency: float | None = wire(Float64b, "Hz", "how often they are to be sent; protocol 1: 125 Hz", since="2.0")
    names: str = wire(Text(), "", _NAMES_DOC, since="1.0")


@packet(header=HEADER, type=ord("I"))
class InputsRequest(State):
    """Claims variables in order to write them. There may be 255 such recipes."""

    names: str = wire(Text(), "", _NAMES_DOC)


@packet(header=HEADER, type=ord("S"))
class StartRequest(State):
    """Asks for data packages."""


@packet(header=HEADER, type=ord("P"))
class PauseRequest(State):
    """Asks for no more data packages."""


# -- from a controller ---------------------------------------------------------------------------


@packet(header=HEADER, type=ord("V"))
class ProtocolReply(State):
    """Whether the version of the protocol holds from now on."""

    accepted: bool = wire(_BOOL, "", "whether the version holds from now on")


@packet(header=HEADER, type=ord("v"))
class ControllerVersionReply(State):
    """The version of the controller's software."""

    major: int = wire(Int32ub, "", "major version")
    minor: int = wire(Int32ub, "", "minor version")
    bugfix: int = wire(Int32ub, "", "bug fix")
    build: int = wire(Int32ub, "", "build")


@packet(header=HEADER, type=ord("O"))
class OutputsReply(State):
    """The types of the outputs that were asked for. Under protocol 1 a refusal shows in the types alone."""

    recipe: int | None = wire(Int8ub, "", "number of the recipe; 0: refused", since="2.0")
    types: str = wire(Text(), "", _TYPES_DOC, since="1.0")


@packet(header=HEADER, type=ord("I"))
class InputsReply(State):
    """The types of the inputs that were claimed."""

    recipe: int = wire(Int8ub, "", "number of the recipe; 0: refused")
    types: str = wire(Text(), "", _TYPES_DOC)


@packet(header=HEADER, type=ord("S"))
class StartReply(State):
    """Whether data packages will come."""

    accepted: bool = wire(_BOOL, "", "whether data packages will come")


@packet(header=HEADER, type=ord("P"))
class PauseReply(State):
    """Whether the pause was accepted, after which no data packages come; by the vendor's guide it always is."""

    accepted: bool = wire(_BOOL, "", "whether data packages will come no more")


# -- from both -----------------------------------------------------------------------------------


@packet(header=HEADER, type=ord("M"), reorder=("2.0", ["level", "message", "source"]))
class RtdeMessage(State):
    """A text, which may come at any time; it is not answered. Clients always send it in the form of protocol 2."""

    IS_EVENT = True

    message: str = wire(Text(Int8ub), "", "the text, under protocol 2 of at most 255 bytes", before=("2.0", Text()))
    source: str | None = wire(Text(Int8ub), "", "who says it", since="2.0")
    level: MessageLevel = wire(Coded(Int8ub, MessageLevel), "", "how grave it is")


@packet(header=HEADER, type=ord("U"))
class DataPackage(State):
    """The values of a recipe, not looked into. Those of a controller under protocol 1 do not say the recipe."""

    recipe: int | None = wire(Int8ub, "", "number of the recipe", since="2.0")
    payload: bytes = wire(Raw(), "", "the values", since="1.0")


# -- by type byte --------------------------------------------------------------------------------

#: Type byte -> the class of a client's package.
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

#: Type byte -> the class of a controller's package.
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

# Of these a client's package has one form in both versions of the protocol.
_ALWAYS_V2 = frozenset(b"MU")


def decode_request(frame: bytes, protocol: Protocol) -> State:
    """What a client sent in one whole package, while `protocol` holds.

    Raises:
        PacketError: of a type that nobody knows, or too short for it.
    """
    return _decode(frame, REQUESTS, 2 if _ALWAYS_V2.issuperset(frame[2:3]) else protocol, None)


def decode_reply(frame: bytes, protocol: Protocol, stamp: Stamp | None = None) -> State:
    """What a controller sent in one whole package, while `protocol` holds.

    Raises:
        PacketError: of a type that nobody knows, or too short for it.
    """
    return _decode(frame, REPLIES, protocol, stamp)


def _decode(frame: bytes, kinds: Mapping[int, type[State]], protocol: Protocol, stamp: Stamp | None) -> State:
    if len(frame) < HEADER.width:
        raise PacketError("too short", packet="RTDE package", expected=HEADER.width, actual=len(frame))
    kind = kinds.get(frame[2])
    if kind is None:
        raise PacketError(f"of the unknown type {frame[2]}", packet="RTDE package", offset=2)
    try:
        return kind.LAYOUTS.of((protocol, 0)).decode(frame, stamp)  # type: ignore[no-any-return]
    except PacketError as error:  # without the version, which is that of the protocol and not of a firmware
        raise altered(error, version=None) from None


# -- frame boundaries ------------------------------------------------------------------------------

# Larger packages are not believed. All 406 variables have 2.9 kB, and their names some 10 kB, in several requests;
# 1024 unknown names of one letter would be answered by 10 kB of NOT_FOUND.
_LARGEST = 1 << 14

_HEAD = struct.Struct(">HB")

# Bytes by which another interface is recognised.
_PEER = 5


def _sizes(kind: type[State]) -> range:
    """The sizes that a package can have, header included."""
    least = min(layout.size for layout in kind.LAYOUTS.all)
    return range(least, _LARGEST if kind.LAYOUTS.all[0].has_text else least + 1)


#: Type byte -> possible sizes of a controller's packages, header included.
REPLY_SIZES: Mapping[int, range] = MappingProxyType({type: _sizes(kind) for type, kind in REPLIES.items()})


class RtdeBoundary:
    """Frame boundaries of what a controller sends.

    In step, the size is believed where the type can have it. Out of step, a package is believed if another one stands
    where it ends. Packages of unknown types are taken once a known one has come, where another package follows them.

    Attributes:
        sizes: type byte -> sizes that a package of it can have.
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
        """One package that fills the buffer: the common case."""
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
        # At the beginning the peer may be another service, which takes some bytes more to recognise.
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
        """As `check`: a package is believed if one of a known type and of its size stands where it ends."""
        need = size + _HEAD.size
        if len(buffer) - at < need:
            return size, need
        next_size, next_kind = _HEAD.unpack_from(buffer, at + size)
        if next_size not in self.sizes.get(next_kind, ()):
            return 0, 0
        self._is_begun = True
        return size, need
