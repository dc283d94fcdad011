"""Tables of text that other programs have written: one line of names, and rows of cells below it."""

from __future__ import annotations

import csv
import gzip
import os
import zlib
from pathlib import Path

from ..errors import BadRecording


def read_text_table(path: str | os.PathLike[str]) -> tuple[list[str], list[list[str]]]:
    """Return the names and the rows of a table. The table may be compressed (.gz).

    The cells are separated by commas, semicolons, tabs or spaces. Cells between semicolons may have decimal commas,
    which are replaced by points. A row can have more or fewer cells than there are names.

    Raises:
        BadRecording: If the file cannot be read, is not text, or is empty.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
        text = (gzip.decompress(data) if path.suffix.lower() == ".gz" else data).decode("utf-8-sig")
    except OSError as error:
        raise BadRecording(f"cannot read {path}: {error.strerror or error}") from error
    except (EOFError, zlib.error, UnicodeDecodeError) as error:
        raise BadRecording(f"{path} is not a table of numbers below one line of names: {error}") from error
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines:
        raise BadRecording(f"{path} is empty; expected one line of names and rows of numbers")
    separator = next((each for each in ",;\t" if each in lines[0]), None)
    if separator is None:
        head, *rows = [line.split() for line in lines]
    else:
        head, *rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    if separator == ";":
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    return [name.lstrip("#").strip() for name in head], rows
