"""The process that reads a connection for another one, which may hold its interpreter's lock for long.

It reads at once, stamps the bytes, keeps the newest packet in shared memory, and hands all bytes over as records in a
pipe. Of what the other does not take, it keeps 16 MiB; then it reads no more, so that nothing is lost.

It ends when the other does: its standard input is a pipe that is never written, and ends with the other process. Where
a third process has inherited that pipe, it sees that it has another parent.

There is no lock between processes. A checksum says whether a packet in memory is whole; a reader that came between two
writes looks again. So it holds also on processors that reorder writes.
"""

from __future__ import annotations

import contextlib
import importlib
import mmap
import os
import select
import signal
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from ..clock import Stamp
from ..errors import RemoteError
from ..wire.framing import FrameBoundary, Framer
from .transport import TcpTransport

#: Bytes that wait for the other process: 25 s of real-time packets at 500 Hz.
_MOST_WAITING = 1 << 24
#: Bytes handed to the pipe at once: what it holds on Linux.
_PIPE = 1 << 16
#: Seconds after which it looks whether the parent is still the same, where nothing else happens.
_LOOK = 0.5

CONNECTED = b"C"  # the connection was made, with the s of its handshake
DATA = b"D"  # bytes, as they came
LOST = b"L"  # it could not be made, or was lost: the class of the error and its text, with a space between

_HEADER = struct.Struct("<cIdd")


class HandedOver(NamedTuple):
    """One of them."""

    kind: bytes
    payload: bytes
    stamp: Stamp

    def __bytes__(self) -> bytes:
        return _HEADER.pack(self.kind, len(self.payload), *self.stamp) + self.payload


class Records:
    """Cuts them out of a stream of bytes."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> Iterator[HandedOver]:
        """The records that are whole now."""
        self._rest += data
        while len(self._rest) >= _HEADER.size:
            kind, length, monotonic, wall = _HEADER.unpack_from(self._rest)
            end = _HEADER.size + length
            if len(self._rest) < end:
                return
            payload = bytes(self._rest[_HEADER.size : end])
            del self._rest[:end]
            yield HandedOver(kind, payload, Stamp(monotonic, wall))


#: Number of the packet, its length, checksum of all but itself, monotonic and wall time.
_SLOT = struct.Struct("<QIIdd")
#: Bytes for one packet; longer ones are not kept.
_ROOM = 1 << 16
#: How often a reader looks again. Writing takes a microsecond or two, and one packet follows another after 2 ms.
_LOOKS = 20


class Slot:
    """Room for one packet.

    Args:
        descriptor: of the file that is shared; None makes one without a name, which is gone with the last process that
            has it.

    Attributes:
        descriptor: the same.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        if descriptor is None:
            with tempfile.TemporaryFile() as file:
                file.truncate(_SLOT.size + _ROOM)
                descriptor = os.dup(file.fileno())
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _SLOT.size + _ROOM)
        self._number = 0

    def put(self, packet: bytes, stamp: Stamp) -> None:
        """Replace the packet."""
        if len(packet) <= _ROOM:
            self._number += 1
            checksum = _checksum(self._number, packet, *stamp)
            head = _SLOT.pack(self._number, len(packet), checksum, *stamp)
            self._memory[: _SLOT.size + len(packet)] = head + packet

    def clear(self) -> None:
        """There is none any more."""
        self._memory[: _SLOT.size] = bytes(_SLOT.size)

    def get(self) -> tuple[int, bytes, Stamp] | None:
        """The number of the packet, the packet, and when its bytes came; None if there is none."""
        for _ in range(_LOOKS):
            number, length, checksum, monotonic, wall = _SLOT.unpack_from(self._memory)
            if not number:
                return None
            if length <= _ROOM:
                packet = self._memory[_SLOT.size : _SLOT.size + length]
                if _checksum(number, packet, monotonic, wall) == checksum:
                    return number, packet, Stamp(monotonic, wall)
        return None

    def close(self) -> None:
        """Give it back. Idempotent."""
        if not self._memory.closed:
            self._memory.close()
            os.close(self.descriptor)


def _checksum(number: int, packet: bytes, monotonic: float, wall: float) -> int:
    return zlib.crc32(packet, zlib.crc32(_SLOT.pack(number, len(packet), 0, monotonic, wall)))


class _Pipe:
    """The pipe to the other process, which is never waited for."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        os.set_blocking(descriptor, False)
        self._waiting = bytearray()

    @property
    def waiting(self) -> int:
        return len(self._waiting)

    def put(self, record: HandedOver) -> None:
        self._waiting += bytes(record)
        self.flush()

    def flush(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._waiting:
                del self._waiting[: os.write(self.descriptor, memoryview(self._waiting)[:_PIPE].tobytes())]


def read_for(parent: int, host: str, port: int, silence: float, timeout: float, slot: int, boundary: str) -> None:
    """Read a connection until it is lost or the other process ends.

    Args:
        parent: number of the other process.
        host, port, silence: of the connection, as for `TcpTransport`.
        timeout: seconds for it to be made.
        slot: descriptor of the shared memory.
        boundary: what packets look like: "module:class" of a `FrameBoundary`.
    """
    # Ctrl-C is for the other process, which ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    module, _, name = boundary.partition(":")
    make: Callable[[], FrameBoundary] = getattr(importlib.import_module(module), name)
    pipe = _Pipe(1)
    newest = Slot(slot)
    transport = TcpTransport(host, port, silence=silence)
    try:
        transport.open(timeout)
        pipe.put(HandedOver(CONNECTED, repr(transport.round_trip).encode(), Stamp.now()))
        _relay(transport, pipe, newest, Framer(make()), parent)
    except RemoteError as error:
        newest.clear()
        pipe.put(HandedOver(LOST, f"{type(error).__name__} {error}".encode(), Stamp.now()))
        # The other process may be busy; what it has not taken yet comes before this.
        while pipe.waiting and _is_wanted(parent, [], [pipe.descriptor])[0]:
            pipe.flush()
    except BrokenPipeError:
        pass  # it is gone
    finally:
        transport.abort()


def _relay(transport: TcpTransport, pipe: _Pipe, newest: Slot, framer: Framer, parent: int) -> None:
    """Read and hand over until the other process is gone.

    Raises:
        RemoteError: the connection was lost.
        BrokenPipeError: the other process is gone.
    """
    connection = transport.fileno()
    while True:
        reads = [connection] if pipe.waiting < _MOST_WAITING else []
        is_wanted, ready = _is_wanted(parent, reads, [pipe.descriptor] if pipe.waiting else [])
        if not is_wanted:
            return
        if connection in ready:
            received = transport.receive_waiting()
            if received is not None:
                data, stamp = received
                frames = framer.feed(data)
                if frames:
                    newest.put(bytes(frames[-1]), stamp)
                pipe.put(HandedOver(DATA, data, stamp))
        pipe.flush()


def _is_wanted(parent: int, reads: list[int], writes: list[int]) -> tuple[bool, list[Any]]:
    """Wait for something to do; whether the other process is still there, and what can be read."""
    ready, _, _ = select.select([*reads, 0], writes, [], _LOOK)
    if (0 in ready and not os.read(0, 1)) or os.getppid() != parent:
        return False, []
    return True, ready
