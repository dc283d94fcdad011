"""Robot messages, and the packages at the beginning of a connection.

For layouts and codes, see docs/protocols/primary.md, Robot messages. Two facts are known from captured bytes of
firmware 5.4. The first is that a runtime exception has no time stamp if a program does not compile. The second is that
key messages, text messages and runtime exceptions have the source -3. The source of the other messages, their levels,
and everything about older firmware are assumed.
"""

from __future__ import annotations

from typing import Any

from linkcore.wire.fields import Since
from urlink.protocol.enums import MessageSource, ReportDataType, ReportLevel, RequestedType, SafetyMode
from urlink.protocol.primary.robot_message import (
    NO_TIMESTAMP,
    KeyMessage,
    PopupMessage,
    RobotCommMessage,
    RobotMessage,
    RuntimeExceptionMessage,
    SafetyComplianceTolerances,
    SafetyModeMessage,
    TextMessage,
    UnnamedMessage12,
    VersionMessage,
)

from .state import ControllerState, StopCause
from .urscript import ProgramError

#: Maximum number of bytes of a text in one message. The vendor gives no limit.
_LONGEST_TEXT = 4096

_HAS_MESSAGE_12 = Since("3.3")
_HAS_TOLERANCES = Since("3.10/5.4")


def greeting(state: ControllerState, kind: str) -> list[bytes]:
    """Return the packages at the beginning of a primary or secondary connection.

    They are the version message, message 12 (firmware 3.3 or later), and package 24 on the primary interface (3.10 or
    later on CB3, 5.4 or later on e-Series). These packages were captured on 3.3, 3.10 and 5.4, and on the secondary
    interface of 5.12. A capture of 5.11, reportedly of the primary interface, contains no package 24. There is no
    capture of firmware older than 3.3. Such firmware is assumed to send only the version message.
    """
    firmware = state.firmware
    on_connect = {"timestamp": NO_TIMESTAMP, "source": MessageSource.ROBOT_INTERFACE}
    version = {
        **firmware._asdict(),
        "project_name": "URControl",
        "svn_revision": firmware.bugfix,
        # Captures contain these two date formats.
        "build_date": "01-01-2024, 00:00:00" if firmware >= (3, 4) else "Jan 01 2016, 00:00:00",
    }
    packages = [_message(state, VersionMessage, **on_connect, **version)]
    if firmware in _HAS_MESSAGE_12:
        # Captured simulated controllers send 0, 0, 1.
        packages.append(_message(state, UnnamedMessage12, **on_connect, first=0, second=0, third=1))
    if kind == "primary" and firmware in _HAS_TOLERANCES:
        # The fourth number is 3 on 3.10 and 2 on 5.4.
        fourth = 2.0 if firmware.is_e_series else 3.0
        tolerances = [0.15, 25.0, 0.0, fourth, *[0.2] * 6, *[0.05235987755982989] * 6]
        tolerances += [0.0, 0.0, 0.0, 0.017453292519943295, 0.001, 0.01]
        packages.append(SafetyComplianceTolerances.LAYOUTS.of(firmware).encode({"tolerances": tolerances}))
    return packages


def safety_messages(state: ControllerState, cause: StopCause) -> list[bytes]:
    """Return the messages that the primary interface sends after a change of the safety mode.

    The first message is a report with a code, and with the reason if one is known. The second is the safety mode
    message (firmware 3.0 or later). The code of a protective stop, C153A0 "position deviates from path", is documented.
    A program's `protective_stop()` is reported as C209A0 at warning level; this is what the tests of UR Client Library
    expect. The vendor's list of codes, which UR Client Library contains, defines the meaning of the other codes. Which
    of them a real controller sends for a certain violation, the levels, the order and the sources are assumed.
    """
    mode = state.modes.safety_mode
    messages = []
    report = _BY_PROGRAM if cause.by_program else _REPORTS.get(mode)
    if report is not None:
        number, level, text = report
        if cause.reason:
            text = f"{text.partition(':')[0]}: {cause.reason}"
        code, argument = cause.code or (number, 0)
        if code == _VIOLATION and not state.firmware.is_e_series:
            argument = _JOINT_SPEED  # assumption: CB3 and older controllers do not name the joint
        fields = {"code": code, "report_level": level, "text": text, **_NO_DATA, "argument": argument}
        messages.append(_message(state, RobotCommMessage, source=MessageSource.CONTROLLER, **fields))
    if not state.firmware.is_cb2:
        messages.append(_message(state, SafetyModeMessage, code=0, safety_mode=mode, **_NO_DATA))
    return messages


#: Data of a report in addition to the code and the text. It is assumed that reports have no such data.
_NO_DATA = {"argument": 0, "data_type": ReportDataType.NONE, "data": 0}
_REPORTS = {
    SafetyMode.PROTECTIVE_STOP: (153, ReportLevel.VIOLATION, "Protective stop: position deviates from path"),
    SafetyMode.ROBOT_EMERGENCY_STOP: (0, ReportLevel.WARNING, "Emergency stop"),
}
#: Code of a violation of a safety limit; its argument if a joint was too fast, without the joint.
_VIOLATION, _JOINT_SPEED = 191, 2
_BY_PROGRAM = (209, ReportLevel.WARNING, "Protective stop")

# -- of programs ---------------------------------------------------------------------------------


def program_started(state: ControllerState, name: str) -> bytes:
    """Return the message that reports the start of a program."""
    return _message(state, KeyMessage, code=0, argument=0, title="PROGRAM_XXX_STARTED", text=name)


def program_stopped(state: ControllerState, name: str) -> bytes:
    """Return the message that reports the end of a program, whatever the reason for the end."""
    return _message(state, KeyMessage, code=0, argument=0, title="PROGRAM_XXX_STOPPED", text=name)


def text_message(state: ControllerState, text: str) -> bytes:
    """Return the message for a call of `textmsg` in a program."""
    return _message(state, TextMessage, text=text)


def runtime_exception(state: ControllerState, error: ProgramError, is_running: bool) -> bytes:
    """Return the message that reports a program that does not compile, or that failed while running."""
    stamp = {} if is_running else {"timestamp": NO_TIMESTAMP}
    return _message(state, RuntimeExceptionMessage, **stamp, line=error.line, column=error.column, text=error.text)


def popup_message(
    state: ControllerState, text: str, title: str, is_warning: bool, is_error: bool, is_blocking: bool
) -> bytes:
    """Return the message for a popup that a program opens."""
    return _message(
        state,
        PopupMessage,
        request_id=0,
        requested_type=RequestedType.NONE,
        is_warning=is_warning,
        is_error=is_error,
        is_blocking=is_blocking,
        # The length field of the title is one byte.
        title=title.encode("utf-8", "backslashreplace")[:255].decode("utf-8", "ignore"),
        text=text,
    )


def _message(state: ControllerState, kind: type[RobotMessage], **fields: Any) -> bytes:
    common = {"timestamp": round(state.time * 1e6), "source": MessageSource.REALTIME_MACHINE}
    if "text" in fields:
        fields["text"] = fields["text"][:_LONGEST_TEXT]
    layout = kind.LAYOUTS.of(state.firmware)
    layout.check_complete({**common, **fields})
    return layout.encode({**common, **fields})
