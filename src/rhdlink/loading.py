"""Function `load`, which reads a recording of a robot as columns, one for each variable."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkcore.errors import BadRecording, PacketError
from linkcore.recording.columns import ArrayColumns, Column
from linkcore.recording.file import Progress, RecordingFile
from linkcore.recording.table import Table
from linkcore.recording.table_files import chosen, export

from .recording import CHANNEL, play
from .variables.database import Database, VariableTable
from .variables.declarations import Declaration, Declarations


class RobotTable(Table):
    """Recorded values of a robot, with a row for each batch that the robot sent, and a column for each variable."""

    def export(
        self,
        path: str | os.PathLike[str],
        fields: Sequence[str] | None = None,
        rate: float | None = None,
        *,
        progress: Progress | None = None,
    ) -> Path:
        """Write the table to a file in another format.

        The complete file replaces an existing file with the same name.

        Args:
            path: Path of the file. Its suffix selects the format; `rhdlink export --help` lists the formats.
            fields: Names of variables; None for all.
            rate: Rate in rows per second at which to resample; None for one row per batch.
            progress: Function that is called with the finished part, 0 to 1.

        Returns:
            The path.

        Raises:
            BadValue: If the format or a variable does not exist.
            BadRecording: If the file cannot be written.
            LocalError: If the package that writes the format is not installed. The message explains how to install it.
        """
        return export(path, chosen({CHANNEL: self}, fields, rate), progress)


def load(
    path: str | os.PathLike[str], variables: type[Declarations] | None = None, *, progress: Progress | None = None
) -> RobotTable:
    """Load a recording as columns: ``load("drive.urlog")["encl"]``.

    The table has a row for each batch that the robot sent.

    A variable keeps its value until the robot sends a new one. If a read and a write variable have the same name, the
    table has the read variable. Damaged or unfinished parts are skipped, and `Table.missing` lists them.

    Args:
        path: Path of the recording.
        variables: Class that declares variables, such as `rhdlink.robots.Smr`. Their columns have the declared types
            and the names of the class's attributes. Other variables are 32-bit words, int32, of shape (n,) or (n,
            words).
        progress: Function that is called with the finished part, 0 to 1.

    Raises:
        BadRecording: If the file does not exist, contains no RHD robot, or contains a robot with other variables after
            a reconnect.
    """
    variables = variables or Declarations  # the base class declares no variables
    recording = RecordingFile(path, progress)
    rows: list[bytes] = []
    wall: list[float] = []
    time: list[float] = []
    begins: list[int] = []
    missing: list[str] = []
    database: Database | None = None
    try:
        for moment in play(recording, progress):
            tables = (moment.database.write, moment.database.read)
            if moment.is_handshake and database is not None:
                begins.append(len(rows))
                if [list(table) for table in tables] != [list(table) for table in (database.write, database.read)]:
                    raise BadRecording(
                        f"{path}: the robot has other variables in connection {moment.connection} than before"
                    )
            database = moment.database
            rows.append(b"".join(bytes(table.memory) for table in tables))
            time.append(moment.received.monotonic)
            wall.append(moment.received.wall)
    except PacketError as error:
        missing.append(f"data after {len(rows)} batches could not be read: {error}")
    if recording.left_out:
        missing.append(f"{recording.left_out} bytes at the end are damaged or unfinished")
    if begins:
        missing.append(f"reconnected {len(begins)} times")
    known: dict[str, Column] = {}
    arrays: dict[str, NDArray[Any]] = {}
    if database is not None:
        words = np.frombuffer(b"".join(rows), np.int32).reshape(len(rows), -1)
        of_write = len(database.write.values)
        _add_words(database.write, words[:, :of_write], known, arrays)
        _add_words(database.read, words[:, of_write:], known, arrays)
        for attribute, declaration in variables.declared().items():
            if declaration.name in arrays:
                array = _typed(declaration, arrays.pop(declaration.name), declaration.order or variables._word_order)
                known.pop(declaration.name)
                width = array.shape[1] if array.ndim == 2 else None
                known[attribute] = Column(attribute, declaration.unit, declaration.doc, width, array.dtype)
                arrays[attribute] = array
    seconds = np.array(time) - (time[0] if time else 0.0)
    stamps = np.round(np.array(wall) * 1e9).astype(np.int64).astype("M8[ns]")
    return RobotTable(str(path), ArrayColumns(known, arrays), seconds, stamps, begins, missing)


def _add_words(
    table: VariableTable, words: NDArray[np.int32], known: dict[str, Column], arrays: dict[str, NDArray[Any]]
) -> None:
    """Add a column for each variable of a table.

    `words` contains the values of the table, shape (n, words of the table).
    """
    for identity, row in enumerate(table):
        if table.find(row.name) != identity:
            continue  # of several variables with the same name, only the first gets a column
        start = table.start(identity)
        mine = words[:, start] if row.length == 1 else words[:, start : start + row.length]
        width = None if row.length == 1 else row.length
        known[row.name] = Column(row.name, width=width, dtype=np.dtype(np.int32))
        arrays[row.name] = mine


def _typed(declaration: Declaration[Any, Any], words: NDArray[np.int32], order: Any) -> NDArray[Any]:
    """Return the values of a variable in each row, in its declared type."""
    count = len(words)
    words = words.reshape(count, -1)
    if declaration.length != words.shape[1]:
        raise BadRecording(
            f"{declaration.name} has {words.shape[1]} words in the recording, declared as {declaration.length}"
        )
    values = declaration.type.unpack_many(np.ascontiguousarray(words).ravel(), declaration.count * count, order)
    if isinstance(values, np.ndarray) and values.dtype.names is None:
        return values if declaration.count == 1 else values.reshape(count, declaration.count)
    # Text and structures become one object per row.
    found = np.empty(count, object)
    found[:] = [declaration.unpack(row, order) for row in words]
    return found
