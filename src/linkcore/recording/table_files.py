"""Export of tables to CSV, Parquet, MATLAB, HDF5 and MCAP files.

The suffix of the file determines the format. An export either writes the complete file, or leaves no file.
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

#: Function that writes tables, by name, to a path, with a description of their origin.
FileWriter = Callable[[Path, Mapping[str, Table], Mapping[str, str], Progress], None]


def export(
    path: str | os.PathLike[str],
    tables: Mapping[str, Table],
    progress: Progress | None = None,
    about: Mapping[str, str] | None = None,
    writers: Mapping[str, FileWriter] | None = None,
) -> Path:
    """Write tables to a file.

    The complete file replaces an existing file with the same name. The file is first written under another name in the
    same directory, and then renamed.

    Args:
        path: Path of the file.
        tables: Tables by name.
        progress: Function that is called with the completed fraction, 0 to 1.
        about: Description for the metadata of the file, if its format has metadata: robot, start, clocks.
        writers: Suffix -> function that writes such a file instead of `TableFormat.write`.

    Raises:
        BadValue: If the suffix is unknown, or the format cannot hold these tables.
        BadRecording: If the file cannot be written.
        LocalError: If the package that writes the format is not installed.
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
    """Return the tables that have the given fields, without other columns.

    Args:
        tables: Tables by name.
        fields: Names, or one name as a string; ``q_actual_3`` is one element of a field. If several tables have a
            field, it is taken from the first table; ``rtde.actual_q`` is taken from the table ``rtde``. None for all
            fields of all tables.
        rate: Number of rows per second after resampling; None for the recorded rows.

    Raises:
        BadValue: If no table has such a field, or `rate` is not a positive number.
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
                raise BadValue(f"there is no field {field!r}, because nothing was recorded")
            first_table.arrays(field)  # raises; the message suggests similar names
        else:
            found.setdefault(table, []).append(field)
    kept = {name: tables[name] for name in tables if name in found} if names else dict(tables)
    if rate is not None:
        # Whole fields are resampled, because a single element of a rotation vector cannot be interpolated.
        whole = {
            name: table.with_fields(*table._fields_of(found[name])) if names else table for name, table in kept.items()
        }
        kept = {name: table.resampled(rate) for name, table in whole.items() if len(table)}
    return {name: table.with_fields(*found[name]) if names else table for name, table in kept.items()}


#: Number of rows that are written at once.
_ROWS = 10_000


def _only(path: Path, tables: Mapping[str, Table], suffix: str) -> Table:
    """Return the single table, for a format that can hold only one."""
    if len(tables) != 1:
        there = ", ".join(tables) or "none"
        raise BadValue(
            f"a {suffix} file can hold only one table, but there are {there}; select fields of one table, or use .h5 "
            "or .mat"
        )
    return next(iter(tables.values()))


def write_csv(path: Path, tables: Mapping[str, Table], about: Mapping[str, str], progress: Progress) -> None:
    """Write a line for each row.

    Numbers have all digits, `wall` is in ISO 8601, and `about` is omitted.
    """
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
    """Write a column for each number of a row.

    Units and meanings are column metadata, `about` is file metadata.
    """
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
    """Write a structure for each table: ``realtime.q_actual`` is n by 6.

    `wall` is in seconds since 1970, UTC. `about` becomes a structure too.
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
    """Write a group for each table, and in it a data set for each field with its unit and meaning.

    `wall` is in ns since 1970, UTC. The entries of `about` become attributes of the file.
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
    """Format of files for tables.

    Attributes:
        write: Function that writes such a file.
        programs: Programs that can read such a file, for help texts.
        holds_one: Whether a file can hold only one table.
        is_live: Whether a file can also be written while the packets arrive.
    """

    write: FileWriter
    programs: str
    holds_one: bool = False
    is_live: bool = False


_HDF5 = TableFormat(write_h5, "HDF5")
#: Suffix -> format.
TABLE_FORMATS: Mapping[str, TableFormat] = {
    ".csv": TableFormat(write_csv, "spreadsheets", holds_one=True),
    ".parquet": TableFormat(write_parquet, "pandas, Polars, DuckDB", holds_one=True),
    ".mat": TableFormat(write_mat, "MATLAB"),
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".mcap": TableFormat(write_mcap, "Foxglove, ros2 bag", is_live=True),
}


def format_of(path: str | os.PathLike[str]) -> TableFormat | None:
    """Return the format for the suffix of a path.

    Return None for any other suffix, such as the suffix of a recording.
    """
    return TABLE_FORMATS.get(Path(path).suffix.lower())


def format_list() -> str:
    """Return the formats for a help text, one per line."""
    return "\n".join(
        f"  {suffix:9} {each.programs}{', one table' if each.holds_one else ''}"
        for suffix, each in TABLE_FORMATS.items()
    )
