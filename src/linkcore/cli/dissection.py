"""Output of the command `dissect` of every package: the bytes of a file or of stdin, piece by piece.

A piece is a packet, or bytes that belong to no packet. Each Python package cuts the bytes of its protocols into pieces,
and describes their meaning.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any, NamedTuple

from ..errors import BadRecording
from ..text import strict_json
from .input_bytes import named
from .options import argument, positive_int

#: Options of every `dissect`.
SHOWN = (
    argument("--count", type=positive_int, metavar="N", help="print only the first N packets or sections of bytes"),
    argument("--json", action="store_true", help="print a JSON object per line for each packet or section"),
)


class Shown(NamedTuple):
    """Piece in the forms in which it can be printed.

    Attributes:
        is_read: Whether any part of the piece was decoded.
        json: The piece as values for JSON.
        text: The piece as lines of text.
    """

    is_read: bool
    json: dict[str, Any]
    text: str


def print_pieces(pieces: Iterable[Shown], args: argparse.Namespace, of: str = "") -> int:
    """Print at most as many pieces as `args` requests, and return the exit status: 1 if nothing was decoded.

    Args:
        pieces: The pieces of the file that `args` names.
        args: The arguments of a command that takes `SHOWN`.
        of: Expected source of the bytes, used at the end of the error message.

    Raises:
        BadRecording: If there is no piece.
    """
    shown = read = 0
    for piece in pieces:
        shown += 1
        read += piece.is_read
        print(strict_json(piece.json) if args.json else piece.text)
        if shown == args.count:
            break
    if not shown:
        raise BadRecording(f"{named(args.file)} contains no bytes{of}")
    return 0 if read else 1


def ascii_text(data: bytes) -> str:
    """Return the bytes as ASCII, with a dot for each byte that is not printable."""
    return "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in data)
