"""Programs on a PolyScope X controller, as its Robot API lists and stores them (`/programs/v1/`, 10.12 or later).

Source: the vendor's own client library. A file is sent as the only part, "file", of a form (RFC 7578). A program file
(.urpx) is JSON and contains the name of the program. Its other content is unknown and is not changed.
"""

from __future__ import annotations

import json
import re
from typing import Any, NamedTuple

from linkcore.errors import BadValue, PacketError

#: Path below `urlink.protocol.dashboard.robot_api.BASE`.
PROGRAMS = "/programs/v1/"

_PACKET = "answer about programs"
_FILE_NAME = re.compile(r'[^"\\/\x00-\x1f\x7f]{1,200}')
_BOUNDARY = re.compile(r'multipart/form-data; *boundary="?([0-9A-Za-z\'()+_,./:=?-]{1,70})"?')
_PART = re.compile(rb'(?i)content-disposition: *form-data; *name="file"; *filename="([^"\r\n]*)"')


class StoredProgram(NamedTuple):
    """Program on the controller.

    Attributes:
        name: Name of the program, used to load it.
        description: Description by the author, or an empty string. This and every later field is None if the controller
            sends null.
        created: Time of creation, as the controller reports it: a whole number of unknown unit.
        last_modified: Time of the last change, in the same unit.
        last_saved: Time when it was last saved, in the same unit.
        state: State of the program, as the controller reports it.
    """

    name: str
    description: str | None = None
    created: int | None = None
    last_modified: int | None = None
    last_saved: int | None = None
    state: str | None = None


def parse_programs(text: str) -> tuple[StoredProgram, ...]:
    """Parse the list of programs.

    Raises:
        PacketError: If the text is not such a list.
    """
    listed = _object(text).get("programs")
    if not isinstance(listed, list):
        raise PacketError(f"'programs' is {str(listed)[:80]!r}; expected a list", packet=_PACKET)
    return tuple(map(_program, listed))


def parse_uploaded(text: str) -> str | None:
    """Parse the name that the controller gave a program; None if the answer does not contain it.

    Raises:
        PacketError: If the text is not such an answer.
    """
    name = _object(text).get("programName") if text else None
    return name if isinstance(name, str) else None


def program_name(content: bytes) -> str:
    """Return the name of a program from its file: `program.programInformation.name`.

    Raises:
        PacketError: If the file is not JSON with a name at this position.
    """
    said: Any = _object(content.decode("utf-8", "backslashreplace"))
    for key in ("program", "programInformation", "name"):
        said = said.get(key) if isinstance(said, dict) else None
    if not isinstance(said, str) or not said:
        raise PacketError("program.programInformation.name is missing or not a string", packet="file of a program")
    return said


def _object(text: str) -> dict[str, Any]:
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        said = None
    if not isinstance(said, dict):
        raise PacketError(f"{text[:80]!r} is not a JSON object", packet=_PACKET)
    return said


def _program(entry: Any) -> StoredProgram:
    if not isinstance(entry, dict) or not isinstance(entry.get("name"), str):
        raise PacketError(f"{str(entry)[:80]!r} is not a program with a name", packet=_PACKET)
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
        raise PacketError(f"{key!r} is {value!r}; expected type {kind.__name__}", packet=_PACKET)
    return value


def encode_form(file_name: str, content: bytes) -> tuple[str, bytes]:
    """Return the content type and the body of a form with one file.

    Raises:
        BadValue: If the name is not allowed in a form.
    """
    if not _FILE_NAME.fullmatch(file_name):
        raise BadValue(f"invalid file name {file_name!r}; expected up to 200 characters without quotes or slashes")
    boundary = "urlink"
    while boundary.encode() in content:
        boundary += "-"
    head = f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="{file_name}"\r\n'
    kind = "Content-Type: text/plain\r\n\r\n"
    return f"multipart/form-data; boundary={boundary}", b"".join(
        [(head + kind).encode(), content, f"\r\n--{boundary}--\r\n".encode()]
    )


def parse_form(content_type: str, body: bytes) -> tuple[str, bytes]:
    """Return the name and the content of the only file of a form.

    Raises:
        PacketError: If the body is not such a form.
    """
    found = _BOUNDARY.fullmatch(content_type)
    if found is None:
        raise PacketError(f"{content_type[:80]!r} is not a form with a boundary", packet="form")
    border = b"\r\n--" + found[1].encode()
    parts = (b"\r\n" + body).split(border)
    head, blank, content = parts[1].partition(b"\r\n\r\n") if len(parts) == 3 else (b"", b"", b"")
    name = _PART.search(head)
    if not blank or name is None or not parts[-1].startswith(b"--"):
        raise PacketError("the form must consist of a single part with the name 'file'", packet="form")
    return name[1].decode("utf-8", "backslashreplace"), content
