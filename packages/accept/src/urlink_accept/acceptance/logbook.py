"""What happens while a controller is accepted, written down as it happens: every byte, and notes of what was done.

It is a recording (`linkcore.recording.file`). A channel holds the connections to one port one after the other, in one
direction: "realtime" what came, "realtime sent" what was sent, "primary 2" those that were open beside another. What
programs on the robot connect to is "reverse". The channel "notes" has a JSON object in each record.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from linkcore.clock import Stamp
from urlink import Closed, RecordingWriter
from urlink.tools import Kind, TcpTransport, strict_json, witnessed

#: The channel of the notes, the interface of the connections that programs make, and the end of names of what was sent.
NOTES, REVERSE, SENT = "notes", "reverse", " sent"


class Logbook:
    """Writes a new recording; a context manager, in which every connection of this process is seen.

    Args:
        path: a file that does not exist yet.
        ports: name of each port of the controller -> its number.
        noted: Called with the step of each note, unless the step has ended.

    Raises:
        BadRecording: the file exists, or cannot be made.
    """

    def __init__(
        self, path: Path, ports: Mapping[str, int], noted: Callable[[str], object] = lambda step: None
    ) -> None:
        self._noted = noted
        self._writer = RecordingWriter(path)
        self._names = {number: name for name, number in ports.items()}
        self._channels: dict[str, int] = {}
        self._busy: set[str] = set()
        self._lock = threading.Lock()
        self._witness = contextlib.ExitStack()
        self._notes = self._writer.add_channel({"name": NOTES})

    def note(self, step: str, **said: Any) -> None:
        """Write down that something was done, or answered. JSON can hold what is noted; NaN becomes null."""
        self._writer.write(Kind.BYTES, self._notes, Stamp.now(), strict_json({"step": step, **said}).encode())
        if said.get("event") != "end":
            self._noted(step)

    def __enter__(self) -> Logbook:
        self._witness.enter_context(witnessed(self._seen))
        return self

    def __exit__(self, *exc: object) -> None:
        self._witness.close()
        self._writer.close()

    def _seen(self, transport: TcpTransport, connection: Any) -> _Seen:
        interface = self._names.get(transport.port, REVERSE)
        with self._lock:
            numbered = (interface if number == 1 else f"{interface} {number}" for number in itertools.count(1))
            name = next(each for each in numbered if each not in self._busy)
            self._busy.add(name)
            for each in (name, name + SENT):
                if each not in self._channels:
                    self._channels[each] = self._writer.add_channel({"name": each})
        self._event(name, "connected")
        return _Seen(self, connection, name)

    def _event(self, name: str, state: str, error: str | None = None) -> None:
        payload = json.dumps({"state": state, "error": error}).encode()
        for each in (name, name + SENT):
            self._write(Kind.EVENT, each, payload)

    def _write(self, kind: Kind, channel: str, payload: bytes) -> None:
        # A connection that outlives the block goes on, and is closed, unseen.
        with contextlib.suppress(Closed):
            self._writer.write(kind, self._channels[channel], Stamp.now(), payload)

    def passed(self, channel: str, data: bytes) -> None:
        """Bytes have come, or gone."""
        self._write(Kind.BYTES, channel, data)

    def ended(self, name: str, error: str | None) -> None:
        """A connection is over."""
        self._event(name, "lost", error)
        with self._lock:
            self._busy.discard(name)


class _Seen:
    """A socket that writes down what passes."""

    def __init__(self, book: Logbook, connection: Any, name: str) -> None:
        self._book = book
        self._connection = connection
        self._name = name
        self._end: Iterator[None] = iter((None,))  # taken once, by whichever thread is first

    def recv(self, size: int, flags: int = 0) -> bytes:
        try:
            data: bytes = self._connection.recv(size, flags)
        except BlockingIOError:
            raise
        except OSError as error:
            self._ended(error.strerror or str(error))
            raise
        if data:
            self._book.passed(self._name, data)
        else:
            self._ended("closed by the peer")
        return data

    def send(self, data: bytes | memoryview, flags: int = 0) -> int:
        sent: int = self._connection.send(data, flags)
        self._book.passed(self._name + SENT, bytes(data[:sent]))
        return sent

    def close(self) -> None:
        self._ended(None)
        self._connection.close()

    def _ended(self, error: str | None) -> None:
        for _ in self._end:
            self._book.ended(self._name, error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)
