"""The programs that a PolyScope X holds, as its Robot API lists and takes them (`/programs/v1/`, from 10.12 on).

Source: the vendor's own client library. A file goes as the one part "file" of a form (RFC 7578). A file of a program
(.urpx) is JSON that holds the program's name; what else it holds is not known here, and it goes as it is.
"""

from __future__ import annotations

import json
import re
from typing import Any, NamedTuple

from linkcore.errors import BadValue, PacketError

#: Below `urlink.protocol.dashboard.robot_api.BASE`.
PROGRAMS = "/programs/v1/"

_PACKET = "answer about programs"
_FILE_NAME = re.compile(r'[^"\\/\x00-\x1f\x7f]{1,200}')
_BOUNDARY = re.compile(r'multipart/form-data; *boundary="?([0-9A-Za-z\'()+_,./:=?-]{1,70})"?')
_PART = re.compile(rb'(?i)content-disposition: *form-data; *name="file"; *filename="([^"\r\n]*)"')


class StoredProgram(NamedTuple):
    """A program on the controller.

    Attributes:
        name: by which it is loaded.
        description: of who wrote it, or empty; None where the controller sends null, as for all that follow.
        created, last_modified, last_saved: as the controller says it, a whole number; of which unit is not known here.
        state: as the controller says it.
    """

    name: str
    description: str | None = None
    created: int | None = None
    last_modified: int | None = None
    last_saved: int | None = None
    state: str | None = None


def parse_programs(text: str) -> tuple[StoredProgram, ...]:
    """What the list of programs says.

    Raises:
        PacketError: it is not such a list.
    """
    listed = _object(text).get("programs")
    if not isinstance(listed, list):
        raise PacketError(f"'programs' is no list, but {str(listed)[:80]!r}", packet=_PACKET)
    return tuple(map(_program, listed))


def parse_uploaded(text: str) -> str | None:
    """The name that a program was given; None where the answer does not say it.

    Raises:
        PacketError: it is not such an answer.
    """
    name = _object(text).get("programName") if text else None
    return name if isinstance(name, str) else None


def program_name(content: bytes) -> str:
    """The name of a program, which stands in its file: `program.programInformation.name`.

    Raises:
        PacketError: the file is not JSON with a name there.
    """
    said: Any = _object(content.decode("utf-8", "backslashreplace"))
    for key in ("program", "programInformation", "name"):
        said = said.get(key) if isinstance(said, dict) else None
    if not isinstance(said, str) or not said:
        raise PacketError("no text at program.programInformation.name", packet="file of a program")
    return said


def _object(text: str) -> dict[str, Any]:
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        said = None
    if not isinstance(said, dict):
        raise PacketError(f"{text[:80]!r} is no object", packet=_PACKET)
    return said


def _program(entry: Any) -> StoredProgram:
    if not isinstance(entry, dict) or not isinstance(entry.get("name"), str):
        raise PacketError(f"{str(entry)[:80]!r} is no program with a name", packet=_PACKET)
    return StoredProgram(
        entry["name"],
        _of(entry, "description", str),
        _of(entry, "createdDate", int),
        _of(entry, "lastModifiedDate", int),
        _of(entry, "lastSavedDate", int),
        _of(entry, "programState", str),
    )


def _of(entry: dict[str, Any], key: str, kind: type) -> Any:
    value = entry.get(key)
    if value is not None and (not isinstance(value, kind) or isinstance(value, bool)):
        raise PacketError(f"{key!r} is {value!r}", packet=_PACKET)
    return value


def encode_form(file_name: str, content: bytes) -> tuple[str, bytes]:
    """The type and the body of a form with one file.

    Raises:
        BadValue: the name cannot stand there.
    """
    if not _FILE_NAME.fullmatch(file_name):
        raise BadValue(f"{file_name!r} is no name of a file that can be sent")
    boundary = "urlink"
    while boundary.encode() in content:
        boundary += "-"
    head = f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="{file_name}"\r\n'
    kind = "Content-Type: text/plain\r\n\r\n"
    return f"multipart/form-data; boundary={boundary}", b"".join(
        [(head + kind).encode(), content, f"\r\n--{boundary}--\r\n".encode()]
    )


def parse_form(content_type: str, body: bytes) -> tuple[str, bytes]:
    """The name and the content of the one file of a form.

    Raises:
        PacketError: it is not such a form.
    """
    found = _BOUNDARY.fullmatch(content_type)
    if found is None:
        raise PacketError(f"{content_type[:80]!r} is no form with a boundary", packet="form")
    border = b"\r\n--" + found[1].encode()
    parts = (b"\r\n" + body).split(border)
    head, blank, content = parts[1].partition(b"\r\n\r\n") if len(parts) == 3 else (b"", b"", b"")
    name = _PART.search(head)
    if not blank or name is None or not parts[-1].startswith(b"--"):
        raise PacketError("it holds other than one part 'file'", packet="form")
    return name[1].decode("utf-8", "backslashreplace"), content
