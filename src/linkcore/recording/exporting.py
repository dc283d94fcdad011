"""Tables as files of other programs: the suffix says the format, and the file appears complete or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..errors import BadRecording, BadValue
from ..progress import Progress, unseen
from .table import Table

__all__ = ["FileWriter", "chosen", "export"]

#: Writes tables, by name, to a path, with a description of where they come from.
FileWriter = Callable[[Path, Mapping[str, Table], Mapping[str, str], Progress], None]


def export(
    path: str | os.PathLike[str],
    tables: Mapping[str, Table],
    writers: Mapping[str, FileWriter],
    progress: Progress | None = None,
    about: Mapping[str, str] | None = None,
) -> Path:
    """Write tables to a file, which replaces one of the same name once it is complete.

    It is written under another name in the same directory, then renamed.

    Args:
        writers: suffix -> function that writes such a file.
        about: what the file says of itself where its format has a place for that: robot, beginning, clocks.

    Raises:
        BadValue: unknown suffix, or the format cannot hold these tables.
        BadRecording: the file cannot be written.
        LocalError: the package that writes the format is not installed.
    """
    path = Path(path)
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise BadValue(f"{path}: no format has the suffix {path.suffix!r}; expected one of {', '.join(writers)}")
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        writer(unfinished, tables, about or {}, progress or unseen)
        os.replace(unfinished, path)
    except OSError as error:
        raise BadRecording(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        unfinished.unlink(missing_ok=True)
    return path


def chosen(
    tables: Mapping[str, Table], fields: Sequence[str] | None = None, rate: float | None = None
) -> dict[str, Table]:
    """The tables that have the fields, with no other columns.

    Args:
        tables: by name.
        fields: names. A field that several tables have is taken from the first; ``rtde.actual_q`` is taken from the
            table ``rtde``. None for all fields of all tables.
        rate: rows per second to resample to; None for the rows as they came.

    Raises:
        BadValue: no table has such a field, or `rate` is not a positive number.
    """
    found: dict[str, list[str]] = {}
    for field in fields or ():
        first, _, rest = field.partition(".")
        if first in tables and rest in tables[first]:
            found.setdefault(first, []).append(rest)
            continue
        table = next((name for name, table in tables.items() if field in table), None)
        if table is None:
            first_table = next(iter(tables.values()), None)
            if first_table is None:
                raise BadValue(f"there is no field {field!r}: nothing was recorded")
            first_table.arrays(field)  # raises; the message suggests similar names
        else:
            found.setdefault(table, []).append(field)
    kept = {name: table.with_fields(*found[name]) for name, table in tables.items() if name in found}
    kept = kept if fields else dict(tables)
    if rate is not None:
        kept = {name: table.resampled(rate) for name, table in kept.items() if len(table)}
    return kept
