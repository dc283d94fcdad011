"""Tables of text that other programs have written."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from linkcore.errors import BadRecording
from linkcore.recording.text_table import read_text_table

NUMBERS = st.floats(allow_nan=False, allow_infinity=False).map(repr)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from([",", ";", "\t", " "]), st.lists(st.tuples(NUMBERS, NUMBERS), max_size=5), st.booleans())
def test_table_with_any_separator_is_read_back(
    tmp_path: Path, separator: str, rows: list[tuple[str, str]], is_packed: bool
) -> None:
    text = "\n".join(separator.join(cells) for cells in [("#time", "actual_q_0"), *rows])
    if separator == ";":
        text = text.replace(".", ",")
    path = tmp_path / ("log.csv.gz" if is_packed else "log.csv")
    path.write_bytes(gzip.compress(text.encode()) if is_packed else text.encode())
    assert read_text_table(path) == (["time", "actual_q_0"], [list(cells) for cells in rows])


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("log.csv", b"", "is empty"),
        ("log.csv", b"\xff\xfe\x00", "is not a table"),
        ("log.csv.gz", gzip.compress(b"a,b\n1,2\n", mtime=0)[:-9], "is not a table"),
        ("log.csv.gz", gzip.compress(b"a,b\n1,2\n", mtime=0)[:10] + b"\xff" * 20, "is not a table"),
        ("log.csv.gz", b"a,b\n1,2\n", "cannot read"),
    ],
    ids=["empty", "not text", "cut off", "damaged", "not compressed"],
)
def test_damaged_table_is_rejected(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(BadRecording, match=message):
        read_text_table(tmp_path / name)


def test_missing_table_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(BadRecording, match=r"cannot read .*log\.csv"):
        read_text_table(tmp_path / "log.csv")
