"""Tables as CSV, Parquet, MATLAB, HDF5 and MCAP files."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BadValue
from ..extras import needs
from ..progress import Progress
from .exporting import FileWriter
from .mcap_file import write_mcap
from .table import Table, flat_columns

__all__ = ["TABLE_WRITERS"]

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


#: suffix -> function that writes such a file
TABLE_WRITERS: Mapping[str, FileWriter] = {
    ".csv": write_csv,
    ".parquet": write_parquet,
    ".mat": write_mat,
    ".h5": write_h5,
    ".hdf5": write_h5,
    ".mcap": write_mcap,
}
