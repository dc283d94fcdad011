"""Robot messages (package type 20), and packages of the primary interface other than robot states.

Older layouts are recognised by their size: if the new layout leaves too few bytes for its text, the old layout is used.
Sources: docs/protocols/primary.md, sections Robot messages and Other packages, with the evidence for each fact.
"""

from __future__ import annotations

from typing import Any

from linkcore.wire.fields import Coded, Float64b, Int8sb, Int8ub, Int16ub, Int32sb, Int32ub, Int64ub, Raw, Text
from linkcore.wire.packet import State, Vector, packet, wire

from ..enums import MessageSource, MessageType, PackageType, ReportDataType, ReportLevel, RequestedType, SafetyMode
from ..headers import PACKAGE

_Bool = Coded(Int8ub, bool)

#: Size of the common header of robot messages in bytes: size, type, timestamp, source, message type.
MESSAGE_HEAD = 15

#: Timestamp of messages without a time, for example of all messages that are sent on connecting.
NO_TIMESTAMP = 0xFFFFFFFFFFFFFFFF


@packet(header=PACKAGE, type=20)
class RobotMessage(State):
    """Common part of all robot messages. Subscribe to it to receive all of them."""

    IS_EVENT = True

    timestamp: int = wire(Int64ub, "us", "time since start; all ones if there is none")
    source: MessageSource = wire(Coded(Int8sb, MessageSource), "", "sender of the message")
    message_type: MessageType = wire(Coded(Int8ub, MessageType), "", "sub-type")


@packet(header=PACKAGE, type=20, message_type=0)
class TextMessage(RobotMessage):
    """Text from a program's `textmsg`."""

    text: str = wire(Text(), "", "text")


@packet(header=PACKAGE, type=20, message_type=1)
class ProgramLabelMessage(RobotMessage):
    """Label that the program has reached."""

    id: int = wire(Int32sb, "", "number of the label")
    text: str = wire(Text(), "", "label")


@packet(header=PACKAGE, type=20, message_type=2)
class PopupMessage(RobotMessage):
    """Popup on the teach pendant."""

    # The short form of CB2 is taken from python-urx. It is unknown which release was the first to send the long form.
    request_id: int | None = wire(Int32ub, "", "number of the request", since="3.0")
    requested_type: RequestedType | None = wire(Coded(Int32ub, RequestedType), "", "requested value", since="3.0")
    is_warning: bool = wire(_Bool, "", "it is a warning")
    is_error: bool = wire(_Bool, "", "it is an error")
    is_blocking: bool | None = wire(_Bool, "", "the program waits for the operator", since="3.0")
    title: str = wire(Text(Int8ub), "", "title")
    text: str = wire(Text(), "", "text")


@packet(header=PACKAGE, type=20, message_type=3)
class VersionMessage(RobotMessage):
    """Software version of the controller, sent on connecting."""

    project_name: str = wire(Text(Int8ub), "", "name of the software, URControl")
    major: int = wire(Int8ub, "", "major version")
    minor: int = wire(Int8ub, "", "minor version")
    svn_revision: int | None = wire(Int32sb, "", "revision, in place of bugfix and build", until="3.3")
    bugfix: int | None = wire(Int32sb, "", "bugfix version", since="3.3")
    build: int | None = wire(Int32sb, "", "build number", since="3.3")
    # The text has 20 or 21 characters in every capture. With fewer characters, the older layout is used.
    build_date: str = wire(Text(least=20), "", "date of the build", before=("3.3", Text()))


@packet(header=PACKAGE, type=20, message_type=5)
class SafetyModeMessage(RobotMessage):
    """Report that the safety mode has changed."""

    code: int = wire(Int32sb, "", "number of the report")
    argument: int = wire(Int32sb, "", "argument of the report")
    safety_mode: SafetyMode = wire(Coded(Int8ub, SafetyMode), "", "new safety mode")
    data_type: ReportDataType = wire(Coded(Int32ub, ReportDataType), "", "encoding of the data")
    data: int = wire(Int32ub, "", "data, as its 32 bits")


@packet(header=PACKAGE, type=20, message_type=6)
class RobotCommMessage(RobotMessage):
    """Report with an error code, as in the vendor's list C<code>A<argument>."""

    code: int = wire(Int32sb, "", "number of the report")
    argument: int = wire(Int32sb, "", "argument of the report")
    # The short form of CB2 is taken from python-urx. It is unknown which release was the first to send the long form.
    report_level: ReportLevel | None = wire(Coded(Int32sb, ReportLevel), "", "severity of the report", since="3.0")
    data_type: ReportDataType | None = wire(Coded(Int32ub, ReportDataType), "", "encoding of the data", since="3.0")
    data: int | None = wire(Int32ub, "", "data, as its 32 bits", since="3.0")
    text: str = wire(Text(), "", "text")


@packet(header=PACKAGE, type=20, message_type=7)
class KeyMessage(RobotMessage):
    """Report with a name, such as PROGRAM_XXX_STARTED with the name of the program as text."""

    code: int = wire(Int32sb, "", "number of the report")
    argument: int = wire(Int32sb, "", "argument of the report")
    title: str = wire(Text(Int8ub), "", "title")
    text: str = wire(Text(), "", "text")


@packet(header=PACKAGE, type=20, message_type=9)
class RequestValueMessage(RobotMessage):
    """Request of the program for a value from the operator."""

    request_id: int = wire(Int32ub, "", "number of the request")
    requested_type: RequestedType = wire(Coded(Int32ub, RequestedType), "", "requested value")
    text: str = wire(Text(), "", "question")


@packet(header=PACKAGE, type=20, message_type=10)
class RuntimeExceptionMessage(RobotMessage):
    """Report that a program does not compile, or failed while it was running."""

    line: int = wire(Int32sb, "", "line in the script")
    column: int = wire(Int32sb, "", "column in the line")
    text: str = wire(Text(), "", "description of the error")


@packet(header=PACKAGE, type=20, message_type=12)
class UnnamedMessage12(RobotMessage):
    """Message that follows the version message in every capture since 3.3; its meaning is not documented."""

    first: int = wire(Int32sb, "", "489 on 3.3, 510 on 3.10, 0 on simulators")
    second: int = wire(Int32sb, "", "239 on 3.3, 259 on 3.10, 0 on simulators")
    third: int = wire(Int8ub, "", "1 in every capture")


@packet(header=PACKAGE, type=20)
class UnknownMessage(RobotMessage):
    """Robot message without a layout in this library. Its bytes are kept unchanged."""

    payload: bytes = wire(Raw(), "", "bytes after the common fields")


@packet(header=PACKAGE, type=24)
class SafetyComplianceTolerances(State):
    """Package 24, sent on connecting to the primary interface; 22 doubles without public names."""

    tolerances: Vector = wire(Float64b[22], "", "unnamed tolerances", since="3.10/5.4")


@packet(header=PACKAGE, type=25)
class ProgramStateMessage(State):
    """Package 25: names or values of the global variables. Their encoding differs and is opaque."""

    IS_EVENT = True

    timestamp: int = wire(Int64ub, "us", "time since start")
    message_type: int = wire(Int8ub, "", "0 names, 1 values")
    start_index: int = wire(Int16ub, "", "number of the first variable")
    payload: bytes = wire(Raw(), "", "names separated by newlines, or values")


@packet(header=PACKAGE)
class OtherPackage(State):
    """Package without a layout in this library (5, 22, 23, ...). Its bytes are kept unchanged."""

    payload: bytes = wire(Raw(), "", "bytes after the header")

    @property
    def type(self) -> PackageType:
        """Type byte of the package."""
        code = self._data[4]
        return PackageType(code if code < 255 else -1)

    def to_dict(self) -> dict[str, Any]:
        """Return the type and the payload."""
        return {"type": self.type.name, **State.to_dict(self)}

    def __str__(self) -> str:
        return f"OtherPackage(type={self.type.name}, payload={self._data[5:]!r})"

    __repr__ = __str__


#: Sub-type byte of a robot message -> class.
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

#: Type byte -> class, for packages other than robot states and robot messages.
PACKAGES: dict[int, type[State]] = {24: SafetyComplianceTolerances, 25: ProgramStateMessage}
