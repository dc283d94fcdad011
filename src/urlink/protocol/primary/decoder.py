"""Decoder of whole packages of the primary and secondary interface to typed states.

The layouts of sub-packages and messages depend on the firmware, if it is known, and on the sizes. Sizes grew from
release to release, and the first builds of a release might still send the size of the previous release
(docs/protocols/primary.md, sections Robot state and Robot messages).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from linkcore.clock import Stamp
from linkcore.errors import PacketError, altered
from linkcore.wire.fields import Version
from linkcore.wire.packet import State

from ..enums import PackageType
from ..headers import ROBOT_MESSAGE, ROBOT_STATE
from .robot_message import MESSAGE_HEAD, MESSAGES, PACKAGES, OtherPackage, UnknownMessage, VersionMessage
from .robot_state import SUB_PACKAGES, RobotState, SubPackage, UnknownSubPackage

_HEAD = struct.Struct(">iB")
#: Type bytes of packages.
KNOWN_TYPES = frozenset(kind & 0xFF for kind in map(int, PackageType))

# Maximum numbers of kept plans and notices. Both depend on bytes from the wire, so they must be bounded.
_MOST_PLANS = 64
_MOST_NOTICES = 64


class _Plan(NamedTuple):
    """Plan to cut a robot state into sub-packages. States of one size usually have the same sub-packages.

    Attributes:
        heads: Struct that unpacks the headers of the sub-packages.
        expected: Expected headers.
        parts: Struct that unpacks the bytes of each sub-package.
        decoders: Decoder of each sub-package.
        unknown: Number of sub-packages without a known layout.
        tails: Number of sub-packages with a fixed layout that end in bytes which the layout does not explain.
        ambiguous: Indices of the sub-packages whose content selects the layout.
    """

    heads: struct.Struct
    expected: tuple[bytes, ...]
    parts: struct.Struct
    decoders: list[Callable[..., SubPackage]]
    unknown: int
    tails: int
    ambiguous: list[int]


class PackageDecoder:
    """Decoder of whole packages to typed states.

    Args:
        version: Firmware of the controller. Smaller layouts than the layouts of this firmware are not used. If None,
            only the sizes decide.
        notice: Function that is called once for each kind of unknown package or part of a package.

    Attributes:
        unknown: Number of packages, messages and sub-packages so far whose type has no known layout.
        tails: Number of packages, messages and sub-packages so far that end in bytes which no known layout explains.
    """

    def __init__(self, version: Version | None = None, notice: Callable[[str], object] = str) -> None:
        self._version = version
        self._notice = notice
        self._noticed: set[str] = set()
        self._plans: dict[int, _Plan] = {}
        self.unknown = 0
        self.tails = 0

    def use(self, version: Version) -> None:
        """Use the layouts of this firmware, or larger ones, for all later packages."""
        self._version = version
        self._plans = {}  # the plans were made for another version

    def explains(self, size: int) -> bool:
        """Whether a robot state of this size was decoded, in which every byte has a known meaning."""
        plan = self._plans.get(size)
        return plan is not None and not (plan.unknown or plan.tails or plan.ambiguous)

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> State:
        """Return the typed state of one whole package.

        Raises:
            PacketError: If the package, or one of its sub-packages, is too short for its layout.
        """
        kind = frame[4]
        if kind == ROBOT_STATE:
            return self._robot_state(frame, stamp)
        if kind == ROBOT_MESSAGE:
            return self._robot_message(frame, stamp)
        state = self._package(PACKAGES.get(kind, OtherPackage), frame, None, stamp)
        if kind not in KNOWN_TYPES:
            self._count_unknown(f"package type {kind}")
        return state

    def _package(self, cls: type[State], frame: bytes, version: Version | None, stamp: Stamp | None) -> State:
        state: State = cls.LAYOUTS.decode(frame, version, stamp)
        self._count_tail(state)
        return state

    def _robot_message(self, frame: bytes, stamp: Stamp | None) -> State:
        if len(frame) < MESSAGE_HEAD:
            raise PacketError(
                "the packet is too short",
                packet="RobotMessage",
                expected=MESSAGE_HEAD,
                actual=len(frame),
                offset=len(frame),
            )
        kind = frame[MESSAGE_HEAD - 1]
        cls: Any = MESSAGES.get(kind, UnknownMessage)
        # Only the size can decide the layout of the version message, because the version is unknown before it.
        version = None if cls is VersionMessage else self._version_for(cls)
        state = self._package(cls, frame, version, stamp)
        if cls is UnknownMessage:
            self._count_unknown(f"message type {kind}")
        return state

    # -- robot states --------------------------------------------------------------------------

    def _robot_state(self, frame: bytes, stamp: Stamp | None) -> RobotState:
        plan = self._plans.get(len(frame))
        if plan is None or plan.heads.unpack(frame) != plan.expected:
            plan = self._make_plan(frame)
        parts = plan.parts.unpack(frame)
        try:
            packages = tuple([decode(part, stamp) for decode, part in zip(plan.decoders, parts, strict=True)])
        except PacketError:
            raise self._located(plan.decoders, parts) from None
        self.unknown += plan.unknown
        self.tails += plan.tails
        for number in plan.ambiguous:
            self._count_tail(packages[number])
        return RobotState.of(frame, packages, stamp)

    def _make_plan(self, frame: bytes) -> _Plan:
        """Find the sub-packages of a robot state, and return the plan for states of this kind."""
        at, end = _HEAD.size, len(frame)
        sizes: list[int] = []
        expected: list[bytes] = []
        decoders: list[Callable[..., SubPackage]] = []
        ambiguous: list[int] = []
        unknown = tails = 0
        while at < end:
            size, kind = self._sub_package(frame, at)
            cls = _class_of(kind, size)
            version = self._version_for(cls)
            if cls is UnknownSubPackage:
                unknown += 1
                self._tell(f"sub-package type {kind} of {size} bytes is unknown; its bytes are kept")
            try:
                decode = cls.LAYOUTS.decoder(size, version)
            except PacketError:
                decode = None  # the decoder raises the error again, with the bytes
            if decode is None:
                ambiguous.append(len(decoders))
                decode = _by_content(cls, version)
            else:
                tails += self._tell_tail(decode(frame[at : at + size]))
            sizes.append(size)
            expected.append(frame[at : at + _HEAD.size])
            decoders.append(decode)
            at += size
        heads = struct.Struct(f"{_HEAD.size}x" + "".join(f"{_HEAD.size}s{size - _HEAD.size}x" for size in sizes))
        parts = struct.Struct(f"{_HEAD.size}x" + "".join(f"{size}s" for size in sizes))
        plan = _Plan(heads, tuple(expected), parts, decoders, unknown, tails, ambiguous)
        if len(self._plans) < _MOST_PLANS:
            self._plans[end] = plan
        return plan

    def _sub_package(self, frame: bytes, at: int) -> tuple[int, int]:
        """Return the size and the type of the sub-package that begins at `at`."""
        left = len(frame) - at
        wrong = partial(PacketError, packet="RobotState", offset=at)
        if left < _HEAD.size:
            raise wrong("the header of a sub-package is cut off", expected=_HEAD.size, actual=left)
        size, kind = _HEAD.unpack_from(frame, at)
        if size < _HEAD.size:
            raise wrong(f"sub-package {kind} is smaller than its header", expected=_HEAD.size, actual=size)
        if size > left:
            raise wrong(f"sub-package {kind} does not fit into the robot state", expected=size, actual=left)
        return size, kind

    def _located(self, decoders: Sequence[Callable[..., SubPackage]], parts: Sequence[bytes]) -> PacketError:
        """Return the error of the first sub-package that cannot be decoded, with its offset in the robot state."""
        at = _HEAD.size
        for decode, part in zip(decoders, parts, strict=True):
            try:
                decode(part, None)
            except PacketError as error:
                return altered(error, reason=f"in a robot state, {error.reason}", offset=at)
            at += len(part)
        raise AssertionError("one of the sub-packages raised an error before")

    def _version_for(self, cls: type[State]) -> Version | None:
        """Return the version; None if this version is not known to send the class, so that the size decides."""
        if self._version is None:
            return None
        try:
            cls.LAYOUTS.of(self._version)
        except PacketError:
            return None
        return self._version

    # -- unknown bytes -------------------------------------------------------------------------

    def _count_unknown(self, kind: str) -> None:
        self.unknown += 1
        self._tell(f"{kind} is unknown; its bytes are kept")

    def _count_tail(self, state: State) -> None:
        self.tails += self._tell_tail(state)

    def _tell_tail(self, state: State) -> bool:
        tail = state.tail
        if tail:
            self._tell(f"the last {len(tail)} bytes of {type(state).__name__} are unknown; they are kept")
        return bool(tail)

    def _tell(self, text: str) -> None:
        if text not in self._noticed and len(self._noticed) < _MOST_NOTICES:  # report each text once
            self._noticed.add(text)
            self._notice(text)


def _class_of(kind: int, size: int) -> type[SubPackage]:
    """Return the class of a sub-package. If a number has two meanings, use the first class that the size allows."""
    classes = SUB_PACKAGES.get(kind, ())
    for cls in classes:
        if size >= min(layout.size for layout in cls.LAYOUTS.all):
            return cls
    # Users report a 9-byte kinematics package that is sent if nothing has changed. Its content is unknown.
    return classes[0] if classes and (kind, size) != (5, 9) else UnknownSubPackage


def _by_content(cls: type[SubPackage], version: Version | None) -> Callable[..., SubPackage]:
    def decode(data: bytes, stamp: Stamp | None) -> SubPackage:
        return cls.LAYOUTS.decode(data, version, stamp)  # type: ignore[no-any-return]

    return decode
