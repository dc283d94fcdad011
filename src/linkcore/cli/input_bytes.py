"""Input bytes of a command: from a file, as hex text, or from stdin."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from ..errors import BadRecording
from ..recording.file import MAGIC

#: Content of a file that is not binary, and separators of hex digits.
_TEXT = re.compile(rb"[\t\n\f\r\x20-\x7e]*")
_SEPARATOR = re.compile(rb"0[xX]|\\x|[\s:,;-]")
_HEX = re.compile(rb"[0-9a-fA-F]*")
#: Offset at the beginning of a line in a hex dump. The offset is not part of the data.
_OFFSET = re.compile(rb"^\s*(0x)?[0-9a-fA-F]{4,}:", re.MULTILINE)


def input_bytes(name: str) -> bytes:
    """Read a file, or stdin for "-"; hex text is converted into the bytes that it describes.

    Hex digits may be separated by white space, colons, commas, semicolons and hyphens, and bytes may have the prefix
    ``0x`` or ``\\x``.

    Raises:
        BadRecording: If the input cannot be read, is a recording on stdin, or has an odd number of hex digits.
    """
    try:
        data = sys.stdin.buffer.read() if name == "-" else Path(name).read_bytes()
    except (OSError, ValueError) as error:
        hint = ""
        if isinstance(error, FileNotFoundError) and re.fullmatch("[0-9a-fA-F]{8,}", name):
            hint = "; put hex digits into a file, or pipe them into stdin and use -"
        reason = getattr(error, "strerror", None) or error
        raise BadRecording(f"cannot read {name}: {reason}{hint}") from error
    if name == "-" and data.startswith(MAGIC):
        raise BadRecording("stdin is a recording; give the path of its file instead")
    return data if data.startswith(MAGIC) else from_hex(data, named(name))


def named(name: str) -> str:
    """Return the name of an input for messages."""
    return "stdin" if name == "-" else name


def from_hex(data: bytes, where: str) -> bytes:
    """Convert hex text into bytes; other data is returned unchanged.

    Args:
        data: Data of the input.
        where: Name of the input, used in error messages.

    Raises:
        BadRecording: If the number of hex digits is odd.
    """
    digits = _SEPARATOR.sub(b"", data) if _TEXT.fullmatch(data) else b""
    if not digits or not _HEX.fullmatch(digits) or _OFFSET.search(data):
        return data
    if len(digits) % 2:
        raise BadRecording(f"{where} has {len(digits)} hex digits; expected two for each byte")
    return bytes.fromhex(digits.decode("ascii"))


def text_hint(data: bytes) -> str:
    """Return the end of an error message about data without a packet: advice if the data is text, or else ""."""
    if not _TEXT.fullmatch(data):
        return ""
    start = data[:20].decode("ascii")
    return f"; it is text that begins with {start!r}; expected hex digits such as '00 00 00 37' (from a dump: `xxd -r`)"
