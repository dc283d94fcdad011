"""Robot messages (package type 20) and the other packages of the primary interface.

Older layouts are recognised by what fits: where the new layout leaves too few bytes for its text, the old one is meant.
Sources: docs/protocols/primary.md, sections Robot messages and Other packages, where each fact has its evidence.
"""

from __future__ import annotations

from typing import Any

from linkcore.wire.fields import Coded, Float64b, Int8sb, Int8ub, Int16ub, Int32sb, Int32ub, Int64ub, Raw, Text
from linkcore.wire.packet import State, Vector, packet, wire

from ..enums import MessageSource, MessageType, PackageType, ReportDataType, ReportLevel, RequestedType, SafetyMode
from ..headers import PACKAGE

_Bool = Coded(Int8ub, bool)

#: Bytes of the common header of robot messages: size, type, timestamp, source, message type.
MESSAGE_HEAD = 15

#: Timestamp of a message that has none, as all those sent on connecting.
NO_TIMESTAMP = 0xFFFFFFFFFFFFFFFF


@packet(header=PACKAGE, type=20)
class RobotMessage(State):
    """The common part of all robot messages; subscribe to it to get them all."""

    IS_EVENT = True

    timestamp: int = wire(Int64ub, "us", "time since start; all ones where there is none")
    source: MessageSource = wire(Coded(Int8sb, MessageSource), "", "who speaks")
    message_type: MessageType = wire(Coded(Int8ub, MessageType), "", "sub-type")


@packet(header=PACKAGE, type=20, message_type=0)
class TextMessage(RobotMessage):
    """Text from a program's `textmsg`."""

    text: str = wire(Text(), "", "text")


@packet(header=PACKAGE, type=20, message_type=1)
class ProgramLabelMessage(RobotMessage):
    """A label that the program has reached."""

    id: int = wire(Int32sb, "", "number of the label")
    text: str = wire(Text(), "", "label")


@packet(header=PACKAGE, type=20, message_type=2)
class PopupMessage(RobotMessage):
    """A popup on the teach pendant."""

    # That CB2 sends the short form is read off python-urx; the release that changed is not known.
    request_id: int | None = wire(Int32ub, "", "number of the request", since="3.0")
    requested_type: RequestedType | None = wire(Coded(Int32ub, RequestedType), "", "value asked for", since="3.0")
    is_warning: bool = wire(_Bool, "", "it warns")
    is_error: bool = wire(_Bool, "", "it tells of an error")
    is_blocking: bool | None = wire(_Bool, "", "the program waits for the operator", since="3.0")
    title: str = wire(Text(Int8ub), "", "title")
    text: str = wire(Text(), "", "text")


@packet(header=PACKAGE, type=20, message_type=3)
class VersionMessage(RobotMessage):
    """The controller's software, sent on connecting."""

    project_name: str = wire(Text(Int8ub), "", "name of the software, URControl")
    major: int = wire(Int8ub, "", "major version")
    minor: int = wire(Int8ub, "", "minor version")
    svn_revision: int | None = wire(Int32sb, "", "revision, in place of bugfix and build", until="3.3")
    bugfix: int | None = wire(Int32sb, "", "bugfix version", since="3.3")
    build: int | None = wire(Int32sb, "", "build number", since="3.3")
    # 20 or 21 characters in every capture: with less the older layout is meant.
    build_date: str = wire(Text(least=20), "", "when it was built", before=("3.3", Text()))


@packet(header=PACKAGE, type=20, message_type=5)
class SafetyModeMessage(RobotMessage):
    """The safety mode has changed."""

    code: int = wire(Int32sb, "", "number of the report")
    argument: int = wire(Int32sb, "", "argument of the report")
    safety_mode: SafetyMode = wire(Coded(Int8ub, SafetyMode), "", "new safety mode")
    data_type: ReportDataType = wire(Coded(Int32ub, ReportDataType), "", "coding of the data")
    data: int = wire(Int32ub, "", "data, as its 32 bits")


@packet(header=PACKAGE, type=20, message_type=6)
class RobotCommMessage(RobotMessage):
    """A report with an error code, as in the vendor's list C<code>A<argument>."""

    code: int = wire(Int32sb, "", "number of the report")
    argument: int = wire(Int32sb, "", "argument of the report")
    # That CB2 sends the short form is read off python-urx; the release that changed is not known.
    report_level: ReportLevel | None = wire(Coded(Int32sb, ReportLevel), "", "how grave it is", since="3.0")
    data_type: ReportDataType | None = wire(Coded(Int32ub, ReportDataType), "", "coding of the data", since="3.0")
    data: int | None = wire(Int32ub, "", "data, as its 32 bits", since="3.0")
    text: str = wire(Text(), "", "text")


@packet(header=PACKAGE, type=20, message_type=7)
class KeyMessage(RobotMessage):
    """Something by name, such as PROGRAM_XXX_STARTED with the program's name as text."""

    code: int = wire(Int32sb, "", "number of the report")
    argument: int = wire(Int32sb, "", "argument of the report")
    title: str = wire(Text(Int8ub), "", "title")
    text: str = wire(Text(), "", "text")


@packet(header=PACKAGE, type=20, message_type=9)
class RequestValueMessage(RobotMessage):
    """The program asks the operator for a value."""

    request_id: int = wire(Int32ub, "", "number of the request")
    requested_type: RequestedType = wire(Coded(Int32ub, RequestedType), "", "value asked for")
    text: str = wire(Text(), "", "question")


@packet(header=PACKAGE, type=20, message_type=10)
class RuntimeExceptionMessage(RobotMessage):
    """A program that does not compile, or failed while running."""

    line: int = wire(Int32sb, "", "line in the script")
    column: int = wire(Int32sb, "", "column in the line")
    text: str = wire(Text(), "", "what is wrong")


@packet(header=PACKAGE, type=20, message_type=12)
class UnnamedMessage12(RobotMessage):
    """Follows the version message on every capture since 3.3; its meaning is not documented."""

    first: int = wire(Int32sb, "", "489 on 3.3, 510 on 3.10, 0 on simulators")
    second: int = wire(Int32sb, "", "239 on 3.3, 259 on 3.10, 0 on simulators")
    third: int = wire(Int8ub, "", "1 in every capture")


@packet(header=PACKAGE, type=20)
class UnknownMessage(RobotMessage):
    """A robot message that this library has no layout for, kept as it came."""

    payload: bytes = wire(Raw(), "", "what follows the common fields")


@packet(header=PACKAGE, type=24)
class SafetyComplianceTolerances(State):
    """Package 24, sent on connecting to the primary interface; 22 doubles without public names."""

    tolerances: Vector = wire(Float64b[22], "", "unnamed tolerances", since="3.10/5.4")


@packet(header=PACKAGE, type=25)
class ProgramStateMessage(State):
    """Package 25: names or values of the global variables. Their coding differs and is opaque."""

    IS_EVENT = True

    timestamp: int = wire(Int64ub, "us", "time since start")
    message_type: int = wire(Int8ub, "", "0 names, 1 values")
    start_index: int = wire(Int16ub, "", "number of the first variable")
    payload: bytes = wire(Raw(), "", "names separated by newlines, or values")


@packet(header=PACKAGE)
class OtherPackage(State):
    """A package that this library has no layout for (5, 22, 23, ...), kept as it came."""

    payload: bytes = wire(Raw(), "", "what follows the header")

    @property
    def type(self) -> PackageType:
        """The type byte."""
        code = self._data[4]
        return PackageType(code if code < 255 else -1)

    def to_dict(self) -> dict[str, Any]:
        """The type and the payload."""
        return {"type": self.type.name, **State.to_dict(self)}

    def __str__(self) -> str:
        return f"OtherPackage(type={self.type.name}, payload={self._data[5:]!r})"

    __repr__ = __str__


#: sub-type byte of a robot message -> class
MESSAGES: dict[int, type[RobotMessage]] = {
    0: TextMessage,
    1: ProgramLabelMessage,
    2: PopupMessage,
    3: VersionMessage,
    5: SafetyModeMessage,
    6: RobotCommMessage,
    7: KeyMessage,
    9: RequestValueMessage,
    10: RuntimeExceptionMessage,
    12: UnnamedMessage12,
}

#: type byte -> class, of the packages that are neither robot state nor robot message
PACKAGES: dict[int, type[State]] = {24: SafetyComplianceTolerances, 25: ProgramStateMessage}
