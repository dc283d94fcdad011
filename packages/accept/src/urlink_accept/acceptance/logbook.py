"""Logbook of an acceptance run, with every received and sent byte, and with notes of all steps.

The logbook is a recording (`linkcore.recording.file`). A channel holds the consecutive connections to one port, in one
direction: "realtime" for received bytes, "realtime sent" for sent bytes, and "primary 2" for connections that were
opened while another one was open. The channel of connections that programs on the robot make is "reverse". Each record
of the channel "notes" is a JSON object.
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

from .delays import DelayMeter

#: Name of the step in notes about delays of this computer.
DELAYED = "delayed"
#: Channel of the notes, interface of the connections that programs make, and suffix of the channels with sent bytes.
NOTES, REVERSE, SENT = "notes", "reverse", " sent"


class Logbook:
    """Writer of a new recording, and context manager that records every connection of this process.

    Args:
        path: Path of a file that does not exist yet.
        ports: Numbers of the ports of the controller. The keys are the names of the ports.
        noted: Function that is called with the step of each note, except at the end of a step.

    Raises:
        BadRecording: If the file exists, or cannot be created.
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
        """Write a note about an action or an answer. The content must be JSON-serialisable; NaN becomes null."""
        self._writer.write(Kind.BYTES, self._notes, Stamp.now(), strict_json({"step": step, **said}).encode())
        if said.get("event") != "end" and step != DELAYED:
            self._noted(step)

    def __enter__(self) -> Logbook:
        self._witness.enter_context(witnessed(self._seen))
        self._witness.enter_context(DelayMeter(lambda late: self.note(DELAYED, by=late)))
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
        # A connection that outlives the block continues, and is closed later without being recorded.
        with contextlib.suppress(Closed):
            self._writer.write(kind, self._channels[channel], Stamp.now(), payload)

    def passed(self, channel: str, data: bytes) -> None:
        """Record received or sent bytes."""
        self._write(Kind.BYTES, channel, data)

    def ended(self, name: str, error: str | None) -> None:
        """Record the end of a connection."""
        self._event(name, "lost", error)
        with self._lock:
            self._busy.discard(name)


class _Seen:
    """Socket that records all received and sent bytes."""

    def __init__(self, book: Logbook, connection: Any, name: str) -> None:
        self._book = book
        self._connection = connection
        self._name = name
        self._end: Iterator[None] = iter((None,))  # consumed once, by the first thread

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
