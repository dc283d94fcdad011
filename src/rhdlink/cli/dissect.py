"""`rhdlink dissect`: show every byte of a connection with its meaning."""

from __future__ import annotations

import argparse
import itertools
import operator
from collections.abc import Iterator
from typing import Any

from linkcore.cli.dissection import SHOWN, Shown, ascii_text, print_pieces
from linkcore.cli.input_bytes import input_bytes, text_hint
from linkcore.cli.options import argument, command
from linkcore.cli.progress import ProgressBar
from linkcore.errors import BadRecording
from linkcore.recording.file import MAGIC, RecordingFile
from linkcore.text import printable

from ..recording import received
from ..wire.dissection import PackagePart, Piece, dissect, guess_sender, tables_in


@command(
    "dissect",
    "show the bytes of a connection",
    argument("file", metavar="FILE", help="raw bytes or hex text of one direction, or a recording; - for stdin"),
    argument("--from", dest="sender", choices=("server", "client"), help="sender of the bytes (default: detected)"),
    argument(
        "--tables", metavar="FILE", help="raw bytes or hex text of the server, to dissect the bytes of its client"
    ),
    argument("--width", type=int, choices=(2, 4), help="32-bit words of a time stamp (default: detected, or 2)"),
    *SHOWN,
)
def run(args: argparse.Namespace) -> int:
    """Show every package in the bytes of one direction of a connection: offset, bytes in hex, meaning. FILE contains
    raw bytes, such as the payload of a network capture, or hex digits, or is a recording. With -, the bytes or hex
    digits are read from stdin.

    The bytes of a client do not show the lengths of its variables. --tables names a file with the bytes of the server
    from the same connection. The number of words of a time stamp, 2 or 4, is detected from the server's handshake,
    unless --width is given. Bytes that belong to no package are shown too.

    examples:
      rhdlink dissect server.bin
      rhdlink dissect client.bin --tables server.bin --count 3
      rhdlink dissect drive.urlog --json
    """
    # On a terminal, the bar is shown only while no package is printed.
    with ProgressBar(f"dissecting {args.file}", args.quiet) as progress:
        return print_pieces(_shown(args, progress), args)


def _shown(args: argparse.Namespace, progress: ProgressBar) -> Iterator[Shown]:
    for number, piece in enumerate(_pieces(args), 1):
        progress(text=f"dissecting {args.file}, {number} packages")
        yield Shown(piece.error is None, _as_json(piece), "\n".join(lines(number, piece)))


def _pieces(args: argparse.Namespace) -> Iterator[Piece]:
    tables, told = tables_in(input_bytes(args.tables)) if args.tables is not None else ({}, None)
    if args.tables is not None and not tables:
        raise BadRecording(f"{args.tables} contains no handshake of a server{text_hint(input_bytes(args.tables))}")
    for data in _connections(args.file):
        own, found = tables_in(data)
        sender = args.sender or ("server" if own else guess_sender(data))
        yield from dissect(data, sender, tables, args.width or found or told or 2)


def _connections(name: str) -> Iterator[bytes]:
    """Yield the bytes of a file or of stdin; for a recording, yield the bytes of each connection."""
    data = input_bytes(name)
    if not data.startswith(MAGIC):
        yield data
        return
    for _, records in itertools.groupby(received(RecordingFile(name)), key=operator.itemgetter(0)):
        yield b"".join(record.payload for _, record in records)


def _as_json(piece: Piece) -> dict[str, Any]:
    return {
        "offset": piece.offset,
        "size": piece.size,
        "batch": piece.batch,
        "package": piece.package,
        "meaning": piece.meaning,
        "error": piece.error,
        "parts": [{"offset": part.offset, "hex": part.data.hex(), **part.content} for part in piece.parts],
    }


def lines(number: int, piece: Piece) -> Iterator[str]:
    """Format a piece as lines of text."""
    yield f"#{number} {printable(piece.package) or '??'}: {piece.meaning}, {piece.size} bytes at {piece.offset}"
    if piece.error is not None:
        yield f"  !! {printable(piece.error)}"
    for part in piece.parts:
        yield from _part_lines(part)


def _part_lines(part: PackagePart) -> Iterator[str]:
    width = 12 if part.meaning else 16
    for at in range(0, len(part.data), width):
        chunk = part.data[at : at + width]
        beside = printable(part.meaning) if part.meaning and not at else ascii_text(chunk) if not part.meaning else ""
        yield f"  {part.offset + at:6}  {chunk.hex(' '):{3 * width - 1}}  {beside}".rstrip()
