"""Protocol of the primary and secondary interface (ports 30001, 30002, 30011, 30012), sans-IO.

It converts bytes to robot states, robot messages and other packages. A controller sends a version message when a client
connects. The version determines the layouts of the later packages; before it, the sizes decide
(docs/protocols/primary.md, section Version message).

A package begins with its size and its type (docs/protocols/primary.md, section Framing). While the frame boundary is
known, a size is accepted unless the sub-packages of a robot state, or the header of the next package, contradict it.
While the boundary is lost, only two kinds of packages are accepted: a robot state whose sub-packages add up to its
size, or a robot message of a known type with another package after it.
"""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Callable

from linkcore.clock import Stamp
from linkcore.deferred import Deferred, Unread
from linkcore.wire.cycles import MissedCycles
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State

from ..firmware import Firmware
from ..headers import PACKAGE_INTERFACE, PACKAGE_SIZES, ROBOT_MESSAGE, ROBOT_STATE, interface_of
from .decoder import KNOWN_TYPES, PackageDecoder
from .robot_message import MESSAGE_HEAD, MESSAGES, VersionMessage
from .robot_state import RobotModeData

_log = logging.getLogger(__name__)

#: Period of robot states, in seconds.
STATE_PERIODS = (0.1,)

_HEAD = struct.Struct(">iB")
_HEAD_AND_TIME = struct.Struct(">iBQ")
#: Type of the sub-package that contains the time, and its size on CB2.
_MODES, _CB2_SIZE = 0, RobotModeData.LAYOUTS.all[0].size

_SIZE = struct.Struct(">i")
_HEAD_AND_FIRST = struct.Struct(">iBi")  # header of a robot state, with the size of its first sub-package

# Largest accepted size while the boundary is lost, and for unknown types. The largest observed package has 1471 bytes.
_LARGEST_BELIEVED = 8192

# Maximum number of sub-packages to add up. 14 types are known, and no observed state contains a type twice. For a state
# with more sub-packages, the next package decides, so that the work for each position in the stream is bounded.
_MOST_PARTS = 16

# Beginning of a robot state or robot message of an accepted size. It uses lookahead, because candidates might overlap.
_CANDIDATE = re.compile(rb"(?=\x00\x00[\x00-\x20].[\x10\x14])", re.DOTALL)
_CANDIDATE_BYTES = 5


class PackageBoundary:
    """Frame boundaries of the stream of packages.

    Packages of unknown types are accepted after the first known package, if another package follows them.
    """

    largest = PACKAGE_SIZES.stop - 1 + _HEAD.size
    pace = 256
    size, head = 0, b""
    last: bytes | bytearray = b""

    def __init__(self) -> None:
        self._is_begun = False

    def __str__(self) -> str:
        return PACKAGE_INTERFACE

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        """Return an empty list, because a size alone does not prove a package."""
        return []

    def declared(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """Check the header as `check` does, without the bytes after it."""
        there = len(buffer) - at
        if there < _HEAD.size:
            return 0, _HEAD.size
        size, kind = _HEAD.unpack_from(buffer, at)
        is_believed = kind in KNOWN_TYPES or (self._is_begun and size <= _LARGEST_BELIEVED)
        if size not in PACKAGE_SIZES or not is_believed:
            return 0, 0
        if kind == ROBOT_STATE and size > _HEAD.size:
            if there < _HEAD.size + _SIZE.size:
                return 0, _HEAD.size + _SIZE.size
            (first,) = _SIZE.unpack_from(buffer, at + _HEAD.size)
            if not _HEAD.size <= first <= size - _HEAD.size:
                return 0, 0  # even the first sub-package does not fit into the state
        self._is_begun = True
        return size, size

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """See `FrameBoundary.check`."""
        size, need = self.declared(buffer, at)
        there = len(buffer) - at
        if not size or there < need:
            return size, need
        kind = buffer[at + 4]
        if kind not in KNOWN_TYPES:
            # The next package might also have an unknown type, but its size is a small number. Other bytes of a stream
            # seldom form such a small number.
            if there < size + _HEAD.size:
                return size, size + _HEAD.size
            (next_size,) = _SIZE.unpack_from(buffer, at + size)
            if not _HEAD.size <= next_size <= _LARGEST_BELIEVED:
                return 0, 0
        elif kind == ROBOT_STATE and not _add_up(buffer, at, size)[0]:
            # If a package follows at the end of this one, the size is correct and the content is damaged.
            if there < size + _HEAD.size:
                return size, size + _HEAD.size
            if not _is_header(buffer, at + size):
                return 0, 0
        elif kind == ROBOT_MESSAGE and size < MESSAGE_HEAD:
            return 0, 0
        return size, size

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        """See `FrameBoundary.search`."""
        end = len(buffer)
        for match in _CANDIDATE.finditer(buffer, start):
            at = match.start()
            there = end - at
            if there < _HEAD.size + _SIZE.size:
                return at, 0, _HEAD.size + _SIZE.size
            size, kind, first = _HEAD_AND_FIRST.unpack_from(buffer, at)
            if size > _LARGEST_BELIEVED:
                continue
            if kind == ROBOT_STATE:
                if not _HEAD.size <= first <= size - _HEAD.size:
                    continue
                is_whole, need = _add_up(buffer, at, size)
            else:
                if size < MESSAGE_HEAD:
                    continue
                if there >= MESSAGE_HEAD and buffer[at + MESSAGE_HEAD - 1] not in MESSAGES:
                    continue
                is_whole, need = False, size + _HEAD.size
            if need > there:
                return at, size, need
            if is_whole or (need and _is_header(buffer, at + size)):
                self._is_begun = True
                return at, size, need
        # The last bytes might be the beginning of a candidate.
        return max(start, end - _CANDIDATE_BYTES + 1), 0, _CANDIDATE_BYTES

    def peer(self, buffer: bytes | bytearray) -> str | None:
        """See `FrameBoundary.peer`."""
        other = interface_of(buffer)
        return None if other == PACKAGE_INTERFACE else other


def _is_header(buffer: bytes | bytearray, at: int) -> bool:
    size, kind = _HEAD.unpack_from(buffer, at)
    return size in PACKAGE_SIZES and kind in KNOWN_TYPES


def _add_up(buffer: bytes | bytearray, at: int, size: int) -> tuple[bool, int]:
    """Check whether the sub-packages of a robot state add up to its size.

    Returns:
        ``(is_sum, need)``. The result is final if the buffer has `need` bytes from `at`; with fewer bytes it is
        undecided. If there are too many sub-packages to decide, `need` reaches beyond the state, so that the next
        header decides. If `need` is 0, the sub-packages do not add up.
    """
    part, stop = at + _HEAD.size, at + size
    last = len(buffer) - _SIZE.size
    for _ in range(_MOST_PARTS):
        if part == stop:
            return True, size
        if part > stop - _HEAD.size:
            return False, 0
        if part > last:
            return False, part + _SIZE.size - at
        (sub,) = _SIZE.unpack_from(buffer, part)
        if sub < _HEAD.size:
            return False, 0
        part += sub
    return part == stop, size if part == stop else size + _HEAD.size


class PrimaryProtocol:
    """Decoder of the bytes of one connection to typed states. Each connection needs a new object.

    Attributes:
        firmware: Firmware from the version message of this connection; None before the message.
    """

    def __init__(self) -> None:
        self.framer = Framer(PackageBoundary())
        self.cycles: MissedCycles | None = MissedCycles(_moment, STATE_PERIODS)
        self._decoder = PackageDecoder(notice=_log.warning)
        self.firmware: Firmware | None = None

    @property
    def unknown(self) -> int:
        """Number of packages, messages and sub-packages so far whose type has no known layout."""
        return self._decoder.unknown

    @property
    def tails(self) -> int:
        """Number of packages, messages and sub-packages so far that end in bytes which no known layout explains."""
        return self._decoder.tails

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> State:
        """Return the typed state of one whole package.

        Raises:
            PacketError: If the package, or one of its sub-packages, is too short for its layout.
        """
        state = self._decoder.decode(frame, stamp)
        if isinstance(state, VersionMessage):
            self.firmware = Firmware(state.major, state.minor, state.bugfix or 0, state.build or 0)
            self._decoder.use(self.firmware)
        return state

    def take_steady(self, package: Deferred, stamp: Stamp) -> DeferredRobotState | None:
        """Return the state in a package whose bytes are not made yet; None if its bytes must be decoded now.

        They must be decoded until a package of this size was decoded, and while the frame boundary is lost.
        """
        if not (self.framer.is_between_packets and self._decoder.explains(len(package))):
            return None
        return DeferredRobotState(package, stamp, self._decoder.decode)


class DeferredRobotState(Unread):
    """Robot state of a simulated controller, whose bytes are made and decoded if somebody asks for it.

    Args:
        package: Package of the state.
        stamp: Arrival of the package.
        decode: Decoder of the bytes.

    Attributes:
        received: Arrival of the package.
    """

    def __init__(self, package: Deferred, stamp: Stamp, decode: Callable[[bytes, Stamp], State]) -> None:
        self.received = stamp
        self._package, self._decode = package, decode

    def read(self) -> State:
        """Return the state."""
        return self._decode(bytes(self._package), self.received)


def _moment(frame: bytes) -> float | None:
    """Return the time of a robot state; None for other packages, and on CB2, where its meaning is unknown."""
    at = _HEAD.size if frame[4] == ROBOT_STATE else len(frame)
    while at + _HEAD_AND_TIME.size <= len(frame):
        size, kind, time = _HEAD_AND_TIME.unpack_from(frame, at)
        if kind == _MODES:
            return time / 1e6 if size > _CB2_SIZE else None
        at += max(size, _HEAD.size)
    return None
