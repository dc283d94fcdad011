"""Class `Logger`, a plugin that writes every variable at each tick to a table or to a recording."""

from __future__ import annotations

import csv
import itertools
import logging
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np

from linkcore.arguments import check_whole
from linkcore.clock import Stamp
from linkcore.errors import BadRecording, BadValue, LinkTimeout
from linkcore.recording.file import Kind, RecordingWriter
from linkcore.streaming.packet_queue import PacketQueue, drop_oldest
from linkcore.streaming.statistics import SubscriptionStatistics
from linkcore.streaming.subscription import ThreadedDelivery

from ...recording import CHANNEL
from ...variables.database import Database
from ...variables.declarations import Declaration
from ...variables.value_types import Order
from ...wire.data import Stamps, Words
from ...wire.messages import END, encode_data
from ..config import Element
from ..plugin import Plugin

_log = logging.getLogger(__name__)

#: Maximum number of ticks that wait for the disk: 40 s at 10 ms.
_WAITING = 4096
#: Maximum number of names with a number that are tried to find a free one.
_MOST_FILES = 10_000

#: (direction, name) of a variable -> declaration of the variable by a plugin, and the order of its words.
_Declared = Mapping[tuple[str, str], tuple[Declaration[Any, Any], Order]]


class _Moment:
    """Values and time stamps of all variables at one tick."""

    __slots__ = ("stamp", "stamps", "values")

    def __init__(self, database: Database) -> None:
        tables = (database.read, database.write)
        self.stamp = Stamp.now()
        self.values: list[Words] = [table.values.copy() for table in tables]
        self.stamps: list[Stamps] = [table.stamps.copy() for table in tables]


class Logger(Plugin):
    """Plugin that logs all variables at each tick to a new file.

    The suffix of the file selects the format. ``.csv`` is a table with a column ``time`` (s since 1970), and a column
    for each value of each variable, read variables first. Values have the types that the plugins declare: a double is
    one number, a `Scaled` is in its unit, text is text, and a structure has a column for each field. Variables that no
    plugin declares are written as words. ``.urlog`` is a recording of linkcore. It contains the bytes that a client
    would receive if the host sent all variables at every tick. Therefore every program that can read a connection can
    read the recording.

    No file is ever overwritten. If ``run.csv`` exists, the log is written to ``run-1.csv``, then to ``run-2.csv``. A
    robot that is started with the same configuration each day therefore keeps the log of each day; `path` is the path
    of the current file.

    The logger runs last, and writes in its own thread. A slow disk loses entries, which are counted, but never delays a
    tick.

    Args:
        path: Path of the file; in an `rhdconfig.xml`, ``path="..."``.
        every: Number of ticks from one entry to the next; in the file, ``every="..."``.

    Raises:
        BadValue: If the suffix is different, or `every` is less than 1.
    """

    is_critical = False
    safety = 127

    _sheet: _CsvSheet | _RecordingSheet

    def __init__(self, path: str | os.PathLike[str] | None = None, *, every: int = 1) -> None:
        self._path = None if path is None else _checked(path)
        check_whole(every, "every", 1, 2**31 - 1)
        self._every = every
        self._queue = PacketQueue(drop_oldest(_WAITING))
        self._delivery: ThreadedDelivery | None = None

    @property
    def path(self) -> Path | None:
        """Path of the file, which `init` completes with a number if necessary. None if no path was given."""
        return self._path

    @property
    def stats(self) -> SubscriptionStatistics | None:
        """Counters of written and dropped entries; None before the first tick."""
        return None if self._delivery is None else self._delivery.statistics

    def init(self, config: Element) -> None:
        """Read the settings in the file, and create the log file.

        Raises:
            BadValue: If no path is given, or its suffix is different.
            BadRecording: If the log file cannot be created.
        """
        path = config.get("path")
        if path is not None:
            self._path = _checked(path)
        if self._path is None:
            raise BadValue('a logger needs a path; add path="..."')
        self._every = config.integer("every", self._every, least=1)
        self._path = _free(self._path)
        # Create the file now, so that an error is raised at the start. The variables are known only at the first tick.
        self._sheet = _CsvSheet(self._path) if self._path.suffix == ".csv" else _RecordingSheet(self._path)
        _log.info("logging into %s", self._path)

    def periodic(self, tick: int) -> None:
        """Store the values of all variables."""
        database = self.host.database
        if self._delivery is None:
            self._sheet.begin(database, self._by_name())
            self._delivery = ThreadedDelivery(self._queue, self._sheet.write, name=f"rhdlink {self.name}")
        if tick % self._every == 0:
            self._queue.offer([_Moment(database)])

    def terminate(self) -> None:
        """Write pending entries, and close the file.

        Raises:
            LinkTimeout: If the disk did not accept the entries in time.
        """
        done = self._delivery is None or self._delivery.finish()
        self._sheet.close()
        if not done:
            raise LinkTimeout(f"{self._path}: the disk did not accept all entries in time")

    def _by_name(self) -> _Declared:
        declared: dict[tuple[str, str], tuple[Declaration[Any, Any], Order]] = {}
        for plugin in self.host.plugins:
            for declaration in plugin.declared().values():
                key = (declaration.direction, declaration.name)
                declared.setdefault(key, (declaration, declaration.order or plugin._word_order))
        return declared


def _checked(path: str | os.PathLike[str]) -> Path:
    if not isinstance(path, (str, os.PathLike)):
        raise BadValue(f"path={path!r}; expected the path of a .csv or .urlog file")
    path = Path(path)
    if path.suffix not in (".csv", ".urlog"):
        raise BadValue(f"unknown suffix of {path}; expected .csv or .urlog")
    return path


def _free(path: Path) -> Path:
    """Return the path, with a number before its suffix if such a file exists already."""
    names = itertools.chain([path], (path.with_stem(f"{path.stem}-{n}") for n in range(1, _MOST_FILES)))
    free = next((name for name in names if not name.exists()), None)
    if free is None:
        raise BadRecording(f"{path} and {_MOST_FILES - 1} files with a number after its name exist already")
    return free


class _CsvSheet:
    """CSV table that is being written."""

    def __init__(self, path: Path) -> None:
        try:
            self._file: TextIO = open(path, "x", newline="", encoding="utf-8")  # noqa: SIM115
        except OSError as error:
            raise BadRecording(f"cannot write {path}: {error.strerror or error}") from error
        self._writer = csv.writer(self._file)

    def begin(self, database: Database, declared: _Declared) -> None:
        """Write the header; all variables exist by now."""
        self._cells = [list(_cells(database, direction, declared)) for direction in "rw"]
        names = ["time"]
        for direction, cells in zip("rw", self._cells, strict=True):
            for name in itertools.chain.from_iterable(each.names for each in cells):
                # A read and a write variable may have the same name, and a variable may be called "time".
                names.append(f"{name} ({'read' if direction == 'r' else 'write'})" if name in names else name)
        self._writer.writerow(names)

    def write(self, moment: _Moment) -> None:
        """Write the row of a tick."""
        row: list[object] = [f"{moment.stamp.wall:.6f}"]
        for cells, values in zip(self._cells, moment.values, strict=True):
            for each in cells:
                row += each.read(values[each.words])
        self._writer.writerow(row)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class _Cells(NamedTuple):
    """Neighbouring columns: their names, the range of words from which they are made, and the conversion."""

    names: list[str]
    words: slice
    read: Callable[[Words], list[Any]]


def _cells(database: Database, direction: str, declared: _Declared) -> Iterator[_Cells]:
    table = database.table(direction)
    for identity, (name, length) in enumerate(table):
        start = table.start(identity)
        words = slice(start, start + length)
        found = declared.get((direction, name))
        if found is None or found[0].length != length:
            names = [name] if length == 1 else [f"{name}[{index}]" for index in range(length)]
            yield _Cells(names, words, np.ndarray.tolist)
        else:
            declaration, order = found
            names = [column for column, _ in _columns(name, declaration.unpack(table.value(identity), order))]
            yield _Cells(names, words, _typed(declaration, order))


def _typed(declaration: Declaration[Any, Any], order: Order) -> Callable[[Words], list[Any]]:
    return lambda words: [value for _, value in _columns("", declaration.unpack(words, order))]


def _columns(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the columns of a value, ``a``, ``a[0]``, ``a.field``, ``a[0].field``, each with its content."""
    if isinstance(value, np.void):
        for field in value.dtype.names or ():
            yield from _columns(f"{name}.{field}", value[field])
    elif isinstance(value, (np.ndarray, tuple)):
        for index, each in enumerate(value):
            yield from _columns(f"{name}[{index}]", each)
    else:
        yield name, value.item() if isinstance(value, np.generic) else value


class _RecordingSheet:
    """Recording that is being written. For its methods, see `_CsvSheet`."""

    def __init__(self, path: Path) -> None:
        self._writer = RecordingWriter(path)

    def begin(self, database: Database, declared: _Declared) -> None:
        self._channel = self._writer.add_channel({"name": CHANNEL, "interface": "rhd", "width": 2})
        self._writer.write(Kind.BYTES, self._channel, Stamp.now(), database.encode_handshake("r"))
        tables = (database.read, database.write)
        self._all = [(table.direction, table.select(range(len(table)))) for table in tables]

    def write(self, moment: _Moment) -> None:
        read, written = (
            encode_data(direction, selection, values, stamps)
            for (direction, selection), values, stamps in zip(self._all, moment.values, moment.stamps, strict=True)
        )
        self._writer.write(Kind.BYTES, self._channel, moment.stamp, written + read + END)

    def close(self) -> None:
        self._writer.close()
