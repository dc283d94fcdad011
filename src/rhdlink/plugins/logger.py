"""Writes down every variable at each tick: as a table for other programs, or as a recording of the wire."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol, TextIO

import numpy as np

from linkcore.errors import BadRecording, BadValue, LinkTimeout
from linkcore.recording.file import Kind, RecordingWriter
from linkcore.stamp import Stamp
from linkcore.streaming.packet_queue import Inbox
from linkcore.streaming.policy import drop_oldest
from linkcore.streaming.statistics import SubscriptionStatistics
from linkcore.streaming.subscription import Subscription

from ..config import Element
from ..database import Database
from ..entries import Stamps, Words
from ..plugin import Plugin
from ..wire import END, encode_data

__all__ = ["Logger"]

#: Ticks that wait for the disk; at 10 ms, 40 s of them.
_WAITING = 4096


class _Moment:
    """Everything there is to know at one tick."""

    __slots__ = ("stamp", "stamps", "tick", "values")

    def __init__(self, database: Database, tick: int) -> None:
        tables = (database.read, database.write)
        self.tick = tick
        self.stamp = Stamp.now()
        self.values: list[Words] = [table.values.copy() for table in tables]
        self.stamps: list[Stamps] = [table.stamps.copy() for table in tables]


class _Sheet(Protocol):
    """A file that is being written."""

    def begin(self, database: Database) -> None:
        """Say what the entries hold; the variables are all there."""

    def write(self, moment: _Moment) -> None:
        """Add a tick."""

    def close(self) -> None:
        """Finish the file."""


class Logger(Plugin):
    """Logs all variables at each tick to a file that does not exist yet.

    The suffix chooses the format. ``.csv`` is a table: ``tick``, ``time`` (s since 1970), and a column for each word,
    of the read variables and then of the write variables. ``.urlog`` is a recording of linkcore: the bytes that a
    reader would have been sent that is told everything at every tick, so that whatever reads a connection reads it.

    It runs last, and writes in a thread of its own: a slow disk costs entries, which are counted, and never a tick.

    Args:
        path: of the file; in an `rhdconfig.xml`, ``path="..."``.
        every: ticks from one entry to the next; in the file, ``every="..."``.

    Raises:
        BadValue: another suffix, or less than every tick.
    """

    is_critical = False
    safety = 127

    def __init__(self, path: str | os.PathLike[str] | None = None, *, every: int = 1) -> None:
        self._path = None if path is None else _checked(Path(path))
        if every < 1:
            raise BadValue(f"every is {every}; expected at least 1 tick")
        self._every = every
        self._inbox = Inbox(drop_oldest(_WAITING))
        self._subscription: Subscription | None = None

    @property
    def stats(self) -> SubscriptionStatistics | None:
        """What became of the entries; None before the first tick."""
        return None if self._subscription is None else self._subscription.stats

    def init(self, config: Element) -> None:
        """Take what the file says.

        Raises:
            BadValue: no path is given, or one with another suffix.
            BadRecording: the file exists, or cannot be made.
        """
        path = config.get("path")
        if path is not None:
            self._path = _checked(Path(path))
        if self._path is None:
            raise BadValue('a logger needs a path="..."')
        self._every = config.integer("every", self._every, least=1)
        # Now, so that a mistake shows at the start; the variables are known at the first tick only.
        self._sheet: _Sheet = _CsvSheet(self._path) if self._path.suffix == ".csv" else _Tape(self._path)

    def periodic(self, tick: int) -> None:
        """Take down what is there."""
        database = self.host.database
        if self._subscription is None:
            self._sheet.begin(database)
            self._subscription = Subscription(
                self._inbox, self._sheet.write, name=f"rhdlink {self.name}", detach=lambda subscription: None
            )
        if tick % self._every == 0:
            self._inbox.offer([_Moment(database, tick)])

    def terminate(self) -> None:
        """Write what still waits, and close the file.

        Raises:
            LinkTimeout: the disk did not take it in time.
        """
        done = self._subscription is None or self._subscription.finish()
        self._sheet.close()
        if not done:
            raise LinkTimeout(f"{self._path}: the disk did not take all entries in time")


def _checked(path: Path) -> Path:
    if path.suffix not in (".csv", ".urlog"):
        raise BadValue(f"{path}: a log is a .csv or a .urlog")
    return path


class _CsvSheet:
    def __init__(self, path: Path) -> None:
        try:
            self._file: TextIO = open(path, "x", newline="", encoding="utf-8")  # noqa: SIM115
        except FileExistsError:
            raise BadRecording(f"{path} exists; a log never overwrites one") from None
        except OSError as error:
            raise BadRecording(f"cannot write {path}: {error.strerror or error}") from error
        self._writer = csv.writer(self._file)

    def begin(self, database: Database) -> None:
        self._writer.writerow(["tick", "time", *_columns(database)])

    def write(self, moment: _Moment) -> None:
        words = np.concatenate(moment.values).tolist()
        self._writer.writerow([moment.tick, f"{moment.stamp.wall:.6f}", *words])

    def close(self) -> None:
        self._file.close()


def _columns(database: Database) -> Iterator[str]:
    for table in (database.read, database.write):
        for name, length in table:
            yield from [name] if length == 1 else (f"{name}[{index}]" for index in range(length))


class _Tape:
    def __init__(self, path: Path) -> None:
        self._writer = RecordingWriter(path)

    def begin(self, database: Database) -> None:
        self._channel = self._writer.add_channel({"name": "rhd", "interface": "rhd", "width": 2})
        self._writer.write(Kind.BYTES, self._channel, Stamp.now(), database.encode_handshake("r"))
        tables = (database.read, database.write)
        self._all = [(table.direction, table.select(range(len(table)))) for table in tables]

    def write(self, moment: _Moment) -> None:
        read, written = (
            encode_data(direction, entries, values, stamps)
            for (direction, entries), values, stamps in zip(self._all, moment.values, moment.stamps, strict=True)
        )
        self._writer.write(Kind.BYTES, self._channel, moment.stamp, written + read + END)

    def close(self) -> None:
        self._writer.close()
