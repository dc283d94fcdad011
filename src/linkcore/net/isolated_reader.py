"""Separate process that reads a connection for its parent process, even while the parent cannot run Python code.

This process reads the bytes and stamps them immediately, keeps the newest packet in shared memory, and passes all bytes
as records through a pipe. If the parent does not read, up to 16 MiB are buffered. Then this process stops reading, so
that nothing is lost.

The process ends when its parent ends. Nothing is ever written to its standard input, which is a pipe that is closed
when the parent ends. If a third process has inherited this pipe, the process detects that its parent process has
changed.

There is no lock between the processes. A checksum shows whether a packet in shared memory is complete. If the checksum
is wrong, because the packet was being written, the reader reads again. So this method is correct even on processors
that reorder writes.
"""

from __future__ import annotations

import contextlib
import importlib
import mmap
import os
import select
import signal
import struct
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from ..clock import Stamp
from ..errors import RemoteError
from ..wire.framing import FrameBoundary, Framer
from .transport import TcpTransport

#: Maximum number of bytes that are buffered for the parent: 25 s of real-time packets at 500 Hz.
_MOST_WAITING = 1 << 24
#: Maximum number of bytes written to the pipe at once, which is the size of a pipe on Linux.
_PIPE = 1 << 16
#: Interval in s at which to check whether the parent is still the same, if nothing else happens.
_LOOK = 0.5

CONNECTED = b"C"  # the connection was made; the payload is the duration of its handshake in s
DATA = b"D"  # the payload is the received bytes
# The connection could not be made, or was lost; the payload is the class of the error, a space, and the message.
LOST = b"L"

_HEADER = struct.Struct("<cIdd")


class HandedOver(NamedTuple):
    """Record that was passed through the pipe."""

    kind: bytes
    payload: bytes
    stamp: Stamp

    def __bytes__(self) -> bytes:
        return _HEADER.pack(self.kind, len(self.payload), *self.stamp) + self.payload


class Records:
    """Parser that extracts records from a stream of bytes."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> Iterator[HandedOver]:
        """Yield the records that `data` completes."""
        self._rest += data
        while len(self._rest) >= _HEADER.size:
            kind, length, monotonic, wall = _HEADER.unpack_from(self._rest)
            end = _HEADER.size + length
            if len(self._rest) < end:
                return
            payload = bytes(self._rest[_HEADER.size : end])
            del self._rest[:end]
            yield HandedOver(kind, payload, Stamp(monotonic, wall))


#: Header in the shared memory: number of the packet, length, checksum of all other data, monotonic time and wall time.
_SLOT = struct.Struct("<QIIdd")
#: Maximum size of a packet in bytes; longer packets are not kept.
_ROOM = 1 << 16
#: Maximum number of attempts to read a packet. Writing a packet takes one or two microseconds, and a packet is written
#: every 2 ms.
_LOOKS = 20


class Slot:
    """Shared memory for one packet.

    Args:
        descriptor: Descriptor of the shared file. If None, a file without a name is made, which is removed with the
            last process that has it open.

    Attributes:
        descriptor: Descriptor of the shared file.
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
        """Remove the packet."""
        self._memory[: _SLOT.size] = bytes(_SLOT.size)

    def get(self) -> tuple[int, bytes, Stamp] | None:
        """Return the number of the packet, the packet, and the arrival time of its bytes.

        Return None if there is no packet.
        """
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
        """Release the memory. Idempotent."""
        if not self._memory.closed:
            self._memory.close()
            os.close(self.descriptor)


def _checksum(number: int, packet: bytes, monotonic: float, wall: float) -> int:
    return zlib.crc32(packet, zlib.crc32(_SLOT.pack(number, len(packet), 0, monotonic, wall)))


class _Pipe:
    """Pipe to the parent process. Writing to it never waits."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        if sys.platform != "win32":  # see IsolatedTransport
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
    """Read a connection until it is lost, or until the parent process ends.

    Args:
        parent: Number of the parent process.
        host: See `TcpTransport`.
        port: See `TcpTransport`.
        silence: See `TcpTransport`.
        timeout: Maximum time for connecting, in s.
        slot: Descriptor of the shared memory.
        boundary: Boundary of the packets, as "module:class" of a `FrameBoundary`.
    """
    # The parent handles Ctrl-C, and then ends this process.
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
        # The parent might be busy, and it must first read the records before this one.
        while pipe.waiting and _is_wanted(parent, [], [pipe.descriptor])[0]:
            pipe.flush()
    except BrokenPipeError:
        pass  # the parent has ended
    finally:
        transport.abort()


def _relay(transport: TcpTransport, pipe: _Pipe, newest: Slot, framer: Framer, parent: int) -> None:
    """Read the connection and write to the pipe until the parent process has ended.

    Raises:
        RemoteError: If the connection is lost.
        BrokenPipeError: If the parent process has ended.
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
    """Wait for an event.

    Return whether the parent process is still running, and the readable descriptors.
    """
    ready, _, _ = select.select([*reads, 0], writes, [], _LOOK)
    if (0 in ready and not os.read(0, 1)) or os.getppid() != parent:
        return False, []
    return True, ready
