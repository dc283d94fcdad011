"""`urlink dissect`: shows every byte of a packet with its meaning, and the bytes between packets."""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from linkcore.cli.dissection import SHOWN, Shown, ascii_text, print_pieces
from linkcore.cli.input_bytes import input_bytes, named, text_hint
from linkcore.cli.options import argument, command
from linkcore.cli.progress import ProgressBar
from linkcore.errors import BadRecording, PacketError, WrongPeer
from linkcore.recording.file import MAGIC, Kind, Progress, RecordingFile
from linkcore.text import printable
from linkcore.wire.fields import version_text
from linkcore.wire.framing import Framer
from linkcore.wire.schema import Row, header_rows
from linkcore.wire.state import State, plain

from ..protocol.decoding import decode
from ..protocol.firmware import Firmware, known_firmware
from ..protocol.headers import PACKAGE
from ..protocol.ports import INTERFACES, Interface
from ..protocol.primary.decoder import PackageDecoder
from ..protocol.primary.protocol import PackageBoundary
from ..protocol.primary.robot_message import VersionMessage
from ..protocol.primary.robot_state import RobotState
from ..protocol.realtime.protocol import RealtimeBoundary
from .packet_fields import as_text

_BOUNDARIES: dict[Interface, Callable[[], PackageBoundary | RealtimeBoundary]] = {
    "primary": PackageBoundary,
    "realtime": RealtimeBoundary,
}


class Stretch(NamedTuple):
    """Part of a stream of bytes: a complete packet, or bytes that do not belong to a complete packet.

    Attributes:
        offset: Offset in the stream.
        data: Bytes of the part.
        is_packet: Whether the part is a complete packet.
        expected: Size that a packet at the beginning of this part should have, if it is cut off; None otherwise.
    """

    offset: int
    data: bytes
    is_packet: bool
    expected: int | None = None


def cut(data: bytes, interface: Interface) -> Iterator[Stretch]:
    """Yield all bytes of `data` as parts, in order: complete packets, and the bytes before, between and after them."""
    boundary = _BOUNDARIES["realtime" if interface == "realtime" else "primary"]()
    framer = Framer(boundary, limit=None)  # no limit: all bytes are shown
    at = 0
    for frame in framer.feed(data) if data else ():
        start = data.index(frame, at)
        if start > at:
            yield Stretch(at, data[at:start], is_packet=False)
        yield Stretch(start, frame, is_packet=True)
        at = start + len(frame)
    rest = len(data) - len(framer.rest)
    if rest > at:
        yield Stretch(at, data[at:rest], is_packet=False)
    if framer.rest:
        size, _ = boundary.declared(framer.rest, 0)
        if 0 < size <= len(framer.rest):
            # The packet is complete, but the framer would wait for the next header to confirm it.
            yield Stretch(rest, framer.rest[:size], is_packet=True)
            rest, size = rest + size, 0
        if rest < len(data):
            yield Stretch(rest, data[rest:], is_packet=False, expected=size or None)


def guess_interface(data: bytes) -> Interface | None:
    """Return the interface with packets that fill most of `data`; None if there is no packet of any interface."""
    found = {interface: _filled(data, interface) for interface in _BOUNDARIES}
    # If both interfaces are possible, prefer the primary interface, because its packets can be recognised by more than
    # their size.
    best = max(found, key=lambda interface: found[interface])
    return best if found[best] else None


def _filled(data: bytes, interface: Interface) -> int:
    """Return the number of bytes in complete packets, and in a packet that is cut off."""
    try:
        Framer(_BOUNDARIES[interface]()).feed(data)
    except WrongPeer:
        return 0
    return sum(len(each.data) for each in cut(data, interface) if each.is_packet or each.expected is not None)


def _firmware(text: str) -> Firmware:
    try:
        return known_firmware(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


@command(
    "dissect",
    "show the bytes of packets, field by field",
    argument("file", metavar="FILE", help="file with raw bytes or hex text, or a recording; - for stdin"),
    argument("--interface", choices=INTERFACES, help="interface that sent the bytes (default: detected)"),
    argument("--firmware", type=_firmware, metavar="X.Y", help="firmware that sent the bytes (default: detected)"),
    *SHOWN,
)
def run(args: argparse.Namespace) -> int:
    """Show every packet in a file, field by field: offset, bytes in hex, name, value, unit, meaning.

    FILE contains raw bytes, for example from a network capture, or hex digits, or is a recording. With -, the bytes or
    hex digits are read from stdin. Robot states are shown by sub-package. Bytes that no known layout describes are
    shown as `tail`. Packets that cannot be decoded are shown with the reason. Bytes outside packets, and packets that
    are cut off, are shown too: nothing is hidden.

    Offsets count from the beginning of the bytes in the file; in a recording, from the first byte of the connection.
    The size of a packet determines its layout, unless --firmware is given.

    examples:
      urlink dissect packet.bin
      urlink dissect run.urlog --interface primary --count 1
      urlink dissect packet.bin --interface realtime --firmware 3.4 --json
      echo '00 00 00 05 10' | urlink dissect - --interface primary
    """
    # On a terminal, the progress bar is shown only until the first packet is printed.
    with ProgressBar(f"dissecting {args.file}", args.quiet) as progress:
        pieces = itertools.starmap(_shown, enumerate(_pieces(args, progress), 1))
        return print_pieces(pieces, args, f" of {args.interface}" if args.interface else "")


def _shown(number: int, piece: PacketPiece) -> Shown:
    return Shown(bool(piece.rows), {"number": number, **piece.as_json()}, "\n".join([*piece.lines(number), ""]))


def _pieces(args: argparse.Namespace, progress: Progress) -> Iterator[PacketPiece]:
    sources = list(_sources(args.file, args.interface))
    size = sum(len(data) for _, data in sources)
    done = 0
    for interface, data in sources:
        for piece in dissect(data, interface, args.firmware):
            progress((done + piece.offset) / size)
            yield piece
        done += len(data)


def _sources(name: str, wanted: Interface | None) -> Iterator[tuple[Interface, bytes]]:
    """Yield the interface and the bytes of each connection in a file or on stdin."""
    data = input_bytes(name)
    if data.startswith(MAGIC):
        yield from _recorded(RecordingFile(Path(name)), wanted)
        return
    interface = wanted or guess_interface(data)
    if interface is None and data:
        raise BadRecording(
            f"{named(name)} contains no packet of any interface; use --interface to show its bytes anyway"
            + text_hint(data)
        )
    if interface is not None and data:
        yield interface, data


def _recorded(recording: RecordingFile, wanted: Interface | None) -> Iterator[tuple[Interface, bytes]]:
    if wanted is not None:
        recording.channel(wanted)  # raises an error with the recorded names if `wanted` is none of them
    for number, info in recording.channels.items():
        name = info["name"]
        if name not in INTERFACES or wanted not in (None, name):
            continue
        data = bytearray()
        for record in recording:
            if record.channel != number:
                continue
            if record.kind is Kind.BYTES:
                data += record.payload
            elif record.kind is Kind.EVENT and json.loads(record.payload).get("state") == "lost" and data:
                yield name, bytes(data)
                data.clear()
        if data:
            yield name, bytes(data)


@dataclass
class PacketPiece:
    """Piece of the output: a packet, a sub-package, or other bytes.

    Attributes:
        offset: Offset of the first byte.
        data: Bytes of the piece.
        title: Class of the packet, or description of the bytes.
        layout: First firmware that sends this layout; None if there is no layout.
        rows: Fields, with offsets from the beginning of the piece.
        parts: Sub-packages.
        error: Reason why the piece could not be decoded completely; None if there was no error.
    """

    offset: int
    data: bytes
    title: str
    layout: str | None = None
    rows: list[Row] = field(default_factory=list)
    parts: list[PacketPiece] = field(default_factory=list)
    error: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the piece as values for JSON."""
        answer: dict[str, Any] = {
            "offset": self.offset,
            "size": len(self.data),
            "type": self.title,
            "layout_since": self.layout,
            "error": self.error,
        }
        if self.rows:
            answer["fields"] = [
                {
                    "offset": self.offset + row.offset,
                    "hex": row.data.hex(),
                    "name": row.name,
                    "value": plain(row.value),
                    "unit": row.unit,
                    "meaning": row.doc,
                }
                for row in self.rows
            ]
        if self.parts:
            answer["packages"] = [part.as_json() for part in self.parts]
        if not self.rows and not self.parts:
            answer["hex"] = self.data.hex()
        return answer

    def lines(self, number: int | None = None) -> Iterator[str]:
        """Yield the piece as lines of text."""
        layout = f", layout of firmware {self.layout} and later" if self.layout is not None else ""
        count = "" if number is None else f"#{number} "
        yield f"{count}{self.title}: {len(self.data)} bytes at {self.offset}{layout}"
        if self.error is not None:
            yield f"  !! {printable(self.error)}"
        for row in self.rows:
            yield from _row_lines(row, self.offset)
        for part in self.parts:
            yield from (f"  {line}" for line in part.lines())
        if not self.rows and not self.parts:
            yield from _dump(self.data, self.offset)


def dissect(data: bytes, interface: Interface, firmware: Firmware | None) -> Iterator[PacketPiece]:
    """Yield all bytes of `data` as pieces, in order."""
    said = firmware
    for stretch in cut(data, interface):
        if not stretch.is_packet:
            yield _stray(stretch, interface, said)
        elif interface == "realtime":
            yield _realtime(stretch, firmware)
        else:
            piece, state = _package(stretch.data, stretch.offset, said)
            if isinstance(state, VersionMessage) and firmware is None:
                # Decode later packets with the layouts of the firmware that the controller has reported.
                said = Firmware(state.major, state.minor, state.bugfix or 0, state.build or 0)
            yield piece


def _stray(stretch: Stretch, interface: Interface, firmware: Firmware | None) -> PacketPiece:
    """Return a piece with bytes that are not a complete packet."""
    if stretch.expected is None:
        return PacketPiece(stretch.offset, stretch.data, "no packet", error="these bytes belong to no packet")
    cut_off = f"cut off: expected {stretch.expected} bytes, got {len(stretch.data)}"
    if interface != "realtime" and stretch.data[4] == 16:
        piece = _robot_state(stretch.data, stretch.offset, firmware)
        piece.error = cut_off
        return piece
    return PacketPiece(stretch.offset, stretch.data, "beginning of a packet", error=cut_off)


def _realtime(stretch: Stretch, firmware: Firmware | None) -> PacketPiece:
    try:
        (state,) = decode(stretch.data, "realtime", firmware)
    except PacketError as error:
        return PacketPiece(stretch.offset, stretch.data, "RealtimeState", error=str(error))
    return _decoded(state, stretch.data, stretch.offset)


def _package(data: bytes, offset: int, firmware: Firmware | None) -> tuple[PacketPiece, State | None]:
    if data[4] == 16:
        return _robot_state(data, offset, firmware), None
    try:
        state = PackageDecoder(firmware).decode(data)
    except PacketError as error:
        return PacketPiece(offset, data, f"package of type {data[4]}", error=str(error)), None
    return _decoded(state, data, offset), state


def _robot_state(data: bytes, offset: int, firmware: Firmware | None) -> PacketPiece:
    """Decode a robot state one sub-package at a time, so that an invalid one does not hide the others."""
    piece = PacketPiece(offset, data, RobotState.__name__)
    decoder = PackageDecoder(firmware)
    piece.rows = list(header_rows(PACKAGE, data))
    at = 5
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        if len(data) - at < 5 or not 5 <= size <= len(data) - at:
            cut_off = f"no whole sub-package: expected {size} bytes, got {len(data) - at}"
            piece.parts.append(PacketPiece(offset + at, data[at:], "rest", error=cut_off))
            break
        part = data[at : at + size]
        try:
            # Decode the sub-package as if it were the only one of a robot state.
            state = decoder.decode(PACKAGE.pack(size=5 + size, type=16) + part)
        except PacketError as error:
            piece.parts.append(PacketPiece(offset + at, part, f"sub-package of type {part[4]}", error=str(error)))
        else:
            assert isinstance(state, RobotState)
            piece.parts.append(_decoded(state.packages[0], part, offset + at))
        at += size
    broken = sum(part.error is not None for part in piece.parts)
    if broken:
        piece.error = f"{broken} of {len(piece.parts)} sub-packages could not be decoded"
    return piece


def _decoded(state: State, data: bytes, offset: int) -> PacketPiece:
    layout = state._layout
    first = None if layout.first == (0, 0) else version_text(layout.first)
    return PacketPiece(offset, data, type(state).__name__, first, list(state.dissect()))


def _row_lines(row: Row, start: int) -> Iterator[str]:
    values = _elements(row)
    if values is None:
        text = "" if row.value is None else f"{row.value:#x}" if row.unit == "bits" else as_text(row.value)
        yield from _field_lines(start + row.offset, row.data, row.name, text, row.unit, row.doc)
        return
    width = len(row.data) // len(values)
    for number, value in enumerate(values):
        at = number * width
        name, part = f"{row.name}[{number}]", row.data[at : at + width]
        # The meaning of a vector is printed only with its first element.
        yield from _field_lines(
            start + row.offset + at, part, name, as_text(value), row.unit, "" if number else row.doc
        )


def _elements(row: Row) -> Sequence[Any] | None:
    if isinstance(row.value, (np.ndarray, tuple, list)) and len(row.value) and len(row.data) % len(row.value) == 0:
        return list(row.value)
    return None


def _field_lines(offset: int, data: bytes, name: str, value: str, unit: str, doc: str) -> Iterator[str]:
    chunks = [data[at : at + 8].hex(" ") for at in range(0, len(data), 8)] or [""]
    quantity = value if unit in ("", "1", "bits") else f"{value} {unit}"
    line = f"  {offset:6}  {chunks[0]:23}  {name:26}  {quantity:28}"
    yield f"{line}  {doc}".rstrip()
    for number, chunk in enumerate(chunks[1:], 1):
        yield f"  {offset + 8 * number:6}  {chunk}"


def _dump(data: bytes, start: int) -> Iterator[str]:
    for at in range(0, len(data), 16):
        part = data[at : at + 16]
        yield f"  {start + at:6}  {part.hex(' '):47}  {ascii_text(part)}"
