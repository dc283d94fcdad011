"""Tables as CSV, Parquet, MATLAB, HDF5 and MCAP files.

The suffix says the format, and a file appears complete or not at all.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arguments import check_fields
from ..errors import BadRecording, BadValue
from ..names import needs
from .file import Progress, unseen
from .mcap_file import write_mcap
from .table import Table, flat_columns

#: Writes tables, by name, to a path, with a description of where they come from.
FileWriter = Callable[[Path, Mapping[str, Table], Mapping[str, str], Progress], None]


def export(
    path: str | os.PathLike[str],
    tables: Mapping[str, Table],
    progress: Progress | None = None,
    about: Mapping[str, str] | None = None,
    writers: Mapping[str, FileWriter] | None = None,
) -> Path:
    """Write tables to a file, which replaces one of the same name once it is complete.

    It is written under another name in the same directory, then renamed.

    Args:
        about: what the file says of itself where its format has a place for that: robot, beginning, clocks.
        writers: suffix -> function that writes such a file instead of `TableFormat.write`.

    Raises:
        BadValue: unknown suffix, or the format cannot hold these tables.
        BadRecording: the file cannot be written.
        LocalError: the package that writes the format is not installed.
    """
    path = Path(path)
    kind = format_of(path)
    if kind is None:
        raise BadValue(f"{path}: no format has the suffix {path.suffix!r}; expected one of {', '.join(TABLE_FORMATS)}")
    write = (writers or {}).get(path.suffix.lower(), kind.write)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        write(unfinished, tables, about or {}, progress or unseen)
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
        fields: Names, or one name as a string; ``q_actual_3`` is one element of a field. A field that several tables
            have is taken from the first; ``rtde.actual_q`` is taken from the table ``rtde``. None for all fields of all
            tables.
        rate: rows per second to resample to; None for the rows as they came.

    Raises:
        BadValue: no table has such a field, or `rate` is not a positive number.
    """
    names = [fields] if isinstance(fields, str) else list(fields or ())
    check_fields(names)
    found: dict[str, list[str]] = {}
    for field in names:
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
    kept = {name: tables[name] for name in tables if name in found} if names else dict(tables)
    if rate is not None:
        # Whole fields are resampled: one element of a rotation vector cannot be interpolated alone.
        whole = {
            name: table.with_fields(*table._fields_of(found[name])) if names else table for name, table in kept.items()
        }
        kept = {name: table.resampled(rate) for name, table in whole.items() if len(table)}
    return {name: table.with_fields(*found[name]) if names else table for name, table in kept.items()}


#: Rows that are written at once.
_ROWS = 10_000


def _only(path: Path, tables: Mapping[str, Table], suffix: str) -> Table:
    """The table, for a format that holds one."""
    if len(tables) != 1:
        there = ", ".join(tables) or "none"
        raise BadValue(
            f"a {suffix} file holds one table, and these are {there}; name fields of one, or use .h5 or .mat"
        )
    return next(iter(tables.values()))


def write_csv(path: Path, tables: Mapping[str, Table], about: Mapping[str, str], progress: Progress) -> None:
    """A line for each row; numbers with all their digits, `wall` as in ISO 8601. It has no place for `about`."""
    table = _only(path, tables, ".csv")
    columns = flat_columns(table)
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for begin in range(0, len(table), _ROWS):
            lists = []
            for name, column in columns.items():
                part = column[begin : begin + _ROWS]
                lists.append(np.datetime_as_string(part, timezone="UTC").tolist() if name == "wall" else part.tolist())
            writer.writerows(zip(*lists, strict=True))
            progress(min(begin + _ROWS, len(table)) / len(table))


def write_parquet(path: Path, tables: Mapping[str, Table], about: Mapping[str, str], progress: Progress) -> None:
    """A column for each number of a row; units and meanings are metadata of the columns, `about` of the file."""
    table = _only(path, tables, ".parquet")
    with needs("parquet", "a .parquet file"):
        import pyarrow
        import pyarrow.parquet
    columns = flat_columns(table)
    described = {
        f"{name}_{number}": column for name, column in table.fields.items() for number in range(column.width or 0)
    }
    described.update({name: column for name, column in table.fields.items() if column.width is None})
    schema = []
    for name, array in columns.items():
        kind = pyarrow.timestamp("ns", tz="UTC") if name == "wall" else None
        kind = kind or (pyarrow.string() if array.dtype == object else pyarrow.from_numpy_dtype(array.dtype))
        column = described.get(name)
        metadata = {"unit": column.unit, "doc": column.doc} if column else {"unit": "s"} if name == "t" else None
        schema.append(pyarrow.field(name, kind, metadata=metadata))
    described_schema = pyarrow.schema(schema, metadata=dict(about))
    with pyarrow.parquet.ParquetWriter(path, described_schema) as writer:
        for begin in range(0, max(len(table), 1), 10 * _ROWS):
            part = {name: array[begin : begin + 10 * _ROWS] for name, array in columns.items()}
            arrays = [
                pyarrow.array(part[field.name].astype("i8") if field.name == "wall" else part[field.name], field.type)
                for field in schema
            ]
            writer.write_table(pyarrow.table(arrays, schema=described_schema))
            progress(min((begin + 10 * _ROWS) / max(len(table), 1), 1.0))


def write_mat(path: Path, tables: Mapping[str, Table], about: Mapping[str, str], progress: Progress) -> None:
    """A structure for each table: ``realtime.q_actual`` is n by 6. `wall` is seconds since 1970, UTC.

    `about` is a structure too.
    """
    with needs("mat", "a .mat file"):
        import scipy.io
    content: dict[str, dict[str, Any]] = {}
    for name, table in tables.items():
        arrays = {field.replace(".", "_"): array for field, array in table.arrays().items()}
        content[name] = {"t": table.time, "wall": table.wall.astype(np.int64) / 1e9, **arrays}
    content["about"] = dict(about)
    with path.open("xb") as file:
        scipy.io.savemat(file, content, long_field_names=True, oned_as="column", do_compression=True)
    progress(1.0)


def write_h5(path: Path, tables: Mapping[str, Table], about: Mapping[str, str], progress: Progress) -> None:
    """A group for each table, a data set for each field with its unit and meaning. `wall` is ns since 1970, UTC.

    `about` are attributes of the file.
    """
    with needs("h5", "an .h5 file"):
        import h5py
    with h5py.File(path, "x") as file:
        file.attrs.update(about)
        for done, (name, table) in enumerate(tables.items()):
            group = file.create_group(name)
            group.create_dataset("t", data=table.time).attrs["unit"] = "s"
            group.create_dataset("wall", data=table.wall.astype(np.int64)).attrs["unit"] = "ns since 1970, UTC"
            for field, array in table.arrays().items():
                if array.dtype == object:
                    data = group.create_dataset(field, data=array, dtype=h5py.string_dtype())
                else:
                    data = group.create_dataset(field, data=array, compression="gzip", compression_opts=1)
                column = table.fields[field]
                data.attrs["unit"], data.attrs["doc"] = column.unit, column.doc
            progress((done + 1) / len(tables))


class TableFormat(NamedTuple):
    """A format of files that tables can be written to.

    Attributes:
        write: Writes such a file.
        programs: Programs that read it, for help texts.
        holds_one: Whether a file holds one table only.
        is_live: Whether a file can also be written while the packets arrive.
    """

    write: FileWriter
    programs: str
    holds_one: bool = False
    is_live: bool = False


_HDF5 = TableFormat(write_h5, "HDF5")
#: suffix -> format
TABLE_FORMATS: Mapping[str, TableFormat] = {
    ".csv": TableFormat(write_csv, "spreadsheets", holds_one=True),
    ".parquet": TableFormat(write_parquet, "pandas, Polars, DuckDB", holds_one=True),
    ".mat": TableFormat(write_mat, "MATLAB"),
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".mcap": TableFormat(write_mcap, "Foxglove, ros2 bag", is_live=True),
}


def format_of(path: str | os.PathLike[str]) -> TableFormat | None:
    """The format that the suffix of a path names; None for any other suffix, such as that of a recording."""
    return TABLE_FORMATS.get(Path(path).suffix.lower())


def format_list() -> str:
    """The formats for a help text, one on a line."""
    return "\n".join(
        f"  {suffix:9} {each.programs}{', one table' if each.holds_one else ''}"
        for suffix, each in TABLE_FORMATS.items()
    )
