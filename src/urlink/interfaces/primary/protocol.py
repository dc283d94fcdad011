"""The primary and secondary interface (30001, 30002, 30011, 30012), sans-IO.

Bytes to robot states, robot messages and the other packages. The version message that a controller
sends on connecting tells the layouts of what follows; until then the sizes do.
Source: docs/protocols/primary.md.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from linkcore.errors import PacketError
from linkcore.stamp import Stamp
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State
from linkcore.wire.version import Version

from ...firmware import Firmware
from ..enums import PackageType
from .framing import MESSAGE_HEAD, PackageBoundary
from .robot_message import MESSAGES, PACKAGES, OtherPackage, UnknownMessage, VersionMessage
from .robot_state import SUB_PACKAGES, RobotState, SubPackage, UnknownSubPackage

__all__ = ["PackageDecoder", "PrimaryProtocol"]

_log = logging.getLogger(__name__)

_HEAD = struct.Struct(">iB")
_ROBOT_STATE, _ROBOT_MESSAGE = int(PackageType.ROBOT_STATE), int(PackageType.ROBOT_MESSAGE)
_KNOWN_TYPES = frozenset(kind & 0xFF for kind in map(int, PackageType))


def _class_of(kind: int, size: int) -> type[SubPackage]:
    """The class of a sub-package; where a number has two meanings, the first that its size allows."""
    classes = SUB_PACKAGES.get(kind, ())
    for cls in classes:
        if size >= min(layout.size for layout in cls.LAYOUTS.all):
            return cls
    # A 9-byte kinematics package is reported when nothing has changed; its content is not known.
    return classes[0] if classes and (kind, size) != (5, 9) else UnknownSubPackage


class _Plan(NamedTuple):
    """The parts of a robot state: states of one length have, as a rule, the same parts.

    Where the headers stand, what they are, and for each the decoder and the place of its bytes.
    """

    where: struct.Struct
    heads: tuple[bytes, ...]
    parts: list[tuple[Callable[..., SubPackage], slice]]
    #: how many of them no layout is known for, and how many end in bytes that none explains
    unknown: int
    tails: int


class PackageDecoder:
    """Whole packages to typed states.

    Args:
        version: the firmware whose layouts are the least that will do; None goes by sizes alone.
        notice: told once of each kind of unknown package or part of one.

    Attributes:
        unknown: packages, messages and sub-packages of a type that no layout is known for, so far.
        tails: those that end in bytes which no known layout explains, so far.
    """

    def __init__(self, version: Version | None = None, notice: Callable[[str], object] = str) -> None:
        self._version = version
        self._notice = notice
        self._told: set[str] = set()
        self.unknown = 0
        self.tails = 0
        self._plans: dict[int, _Plan] = {}

    @property
    def version(self) -> Version | None:
        """The firmware whose layouts are the least that will do; None goes by sizes alone."""
        return self._version

    @version.setter
    def version(self, version: Version | None) -> None:
        self._version = version
        self._plans = {}  # they were made for another

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> State:
        """The typed state of one whole package.

        Raises:
            PacketError: a layout that the package, or one of its sub-packages, cannot hold.
        """
        kind = frame[4]
        if kind == _ROBOT_STATE:
            return self._robot_state(frame, stamp)
        if kind == _ROBOT_MESSAGE:
            return self._robot_message(frame, stamp)
        return self._counted(PACKAGES.get(kind, OtherPackage), frame, None, stamp)

    def _counted(self, cls: type[State], frame: bytes, version: Version | None, stamp: Stamp | None) -> State:
        state: State = cls.LAYOUTS.decode(frame, version, stamp)
        if cls is UnknownMessage or (cls is OtherPackage and frame[4] not in _KNOWN_TYPES):
            self.unknown += 1
            kind = f"message type {frame[MESSAGE_HEAD - 1]}" if cls is UnknownMessage else f"package type {frame[4]}"
            self._tell(f"{kind} is unknown, and kept")
        if state.tail:
            self.tails += 1
            self._tell(f"the last {len(state.tail)} bytes of {cls.__name__} are unknown, and kept")
        return state

    def _tell(self, text: str) -> None:
        if text not in self._told and len(self._told) < 64:  # once, and no more kinds than can be read
            self._told.add(text)
            self._notice(text)

    def _robot_state(self, frame: bytes, stamp: Stamp | None) -> RobotState:
        plan = self._plans.get(len(frame))
        if plan is None or plan.where.unpack(frame) != plan.heads:
            plan = self._plan(frame)
        try:
            packages = tuple([decode(frame[part], stamp) for decode, part in plan.parts])
        except PacketError:
            self._blame(plan, frame)
            raise
        self.unknown += plan.unknown
        self.tails += plan.tails
        return RobotState.of(frame, packages, stamp)

    def _plan(self, frame: bytes) -> _Plan:
        """Find the sub-packages of a robot state."""
        heads, parts, where = [], [], [">5x"]
        at, end = 5, len(frame)
        while at < end:
            decode, size = self._look_up(frame, at)
            if size > end - at:
                raise PacketError(
                    f"sub-package {frame[at + 4]} does not fit",
                    packet="RobotState",
                    expected=size,
                    actual=end - at,
                    offset=at,
                )
            heads.append(frame[at : at + 5])
            parts.append((decode, slice(at, at + size)))
            where.append(f"5s{size - 5}x")
            at += size
        plan = self._judged(_Plan(struct.Struct("".join(where)), tuple(heads), parts, 0, 0), frame)
        if len(self._plans) < 64:  # lengths come from the wire: keep no more than a few
            self._plans[end] = plan
        return plan

    def _judged(self, plan: _Plan, frame: bytes) -> _Plan:
        """The plan with the counts of what is unknown, after decoding once."""
        try:
            packages = [decode(frame[part], None) for decode, part in plan.parts]
        except PacketError:
            return plan  # the decoding itself will say why
        unknown = [package for package in packages if isinstance(package, UnknownSubPackage)]
        tails = [package for package in packages if package.tail]
        for package in unknown:
            self._tell(f"sub-package type {package.type} of {len(bytes(package))} bytes is unknown, and kept")
        for part in tails:
            self._tell(f"the last {len(part.tail)} bytes of {type(part).__name__} are unknown, and kept")
        return plan._replace(unknown=len(unknown), tails=len(tails))

    def _blame(self, plan: _Plan, frame: bytes) -> None:
        """Say which sub-package it was, and where."""
        for decode, part in plan.parts:
            try:
                decode(frame[part], None)
            except PacketError as error:
                raise PacketError(
                    f"in a robot state, {error.reason}",
                    packet=error.packet,
                    version=error.version,
                    expected=error.expected,
                    actual=error.actual,
                    offset=part.start,
                ) from None

    def _look_up(self, frame: bytes, at: int) -> tuple[Callable[..., SubPackage], int]:
        """The decoder and the size of the sub-package that begins at `at`."""
        head = frame[at : at + 5]
        if len(head) < 5:
            raise PacketError(
                "sub-package header cut off", packet="RobotState", expected=5, actual=len(head), offset=at
            )
        size, kind = _HEAD.unpack(head)
        if size < 5:
            raise PacketError(
                f"sub-package {kind} is smaller than its header",
                packet="RobotState",
                expected=5,
                actual=size,
                offset=at,
            )
        layouts = _class_of(kind, size).LAYOUTS
        version = self._version_for(layouts.cls)

        def by_content(data: bytes, stamp: Stamp | None) -> SubPackage:
            return layouts.decode(data, version, stamp)  # type: ignore[no-any-return]

        try:
            decode = layouts.decoder(size, version) or by_content
        except PacketError:
            decode = by_content  # which says so with the bytes at hand
        return decode, size

    def _version_for(self, cls: type[State]) -> Version | None:
        """The version, unless that one is not known to send this class: then the size decides."""
        if self.version is None:
            return None
        try:
            cls.LAYOUTS.of(self.version)
        except PacketError:
            return None
        return self.version

    def _robot_message(self, frame: bytes, stamp: Stamp | None) -> State:
        if len(frame) < MESSAGE_HEAD:
            raise PacketError(
                "packet too short",
                packet="RobotMessage",
                expected=MESSAGE_HEAD,
                actual=len(frame),
                offset=len(frame),
            )
        cls: Any = MESSAGES.get(frame[MESSAGE_HEAD - 1], UnknownMessage)
        if cls is VersionMessage:
            # It is what tells the version, so only its own bytes can tell its layout.
            return self._counted(cls, frame, None, stamp)
        return self._counted(cls, frame, self._version_for(cls), stamp)


class PrimaryProtocol:
    """Bytes in, typed states out; a new one for each connection.

    Attributes:
        firmware: what the controller said of itself on this connection, or None so far.
    """

    def __init__(self) -> None:
        self.framer = Framer(PackageBoundary())
        self._decoder = PackageDecoder(notice=_log.warning)
        self.firmware: Firmware | None = None

    @property
    def unknown(self) -> int:
        """Packages, messages and sub-packages of a type that no layout is known for, so far."""
        return self._decoder.unknown

    @property
    def tails(self) -> int:
        """Those that end in bytes which no known layout explains, so far."""
        return self._decoder.tails

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> State:
        """The typed state of one whole package.

        Raises:
            PacketError: a layout that the package, or one of its sub-packages, cannot hold.
        """
        state = self._decoder.decode(frame, stamp)
        if isinstance(state, VersionMessage):
            self.firmware = Firmware(state.major, state.minor, state.bugfix or 0, state.build or 0)
            self._decoder.version = self.firmware
        return state

    def decode_all(self, frames: Sequence[bytes], stamp: Stamp | None = None) -> tuple[list[State], list[PacketError]]:
        """The typed states of many packages, in order, and an error for each that its layout cannot hold."""
        states: list[State] = []
        failures: list[PacketError] = []
        for frame in frames:
            try:
                states.append(self.decode(frame, stamp))
            except PacketError as error:
                failures.append(error)
        return states, failures
