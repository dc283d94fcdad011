"""Bytes that a person enters: files, hex text and stdin."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.cli.input_bytes import from_hex, input_bytes, text_hint
from linkcore.errors import BadRecording
from linkcore.recording.file import MAGIC

FORMS = ("{:02x}", "{:02X} ", "{:02x}:", "0x{:02x}, ", "\\x{:02x}", "{:02x}\n")


@pytest.mark.property
@given(st.binary(min_size=1), st.sampled_from(FORMS))
def test_from_hex_returns_the_written_bytes(data: bytes, form: str) -> None:
    assert from_hex("".join(map(form.format, data)).encode(), "stdin") == data


@pytest.mark.property
@given(st.binary())
def test_from_hex_keeps_binary_data(data: bytes) -> None:
    assert from_hex(b"\x00" + data, "stdin") == b"\x00" + data


def test_input_bytes_reads_stdin_for_a_hyphen(monkeypatch: pytest.MonkeyPatch) -> None:
    for data, expected in ((b"\x00\x01", b"\x00\x01"), (b"00 01\n", b"\x00\x01"), (b"", b"")):
        monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(data)))
        assert input_bytes("-") == expected


def test_text_without_hex_digits_is_kept_and_explained() -> None:
    # A dump without its text column consists of hex digits only, so its offsets would be read as data.
    for dump in (b"00000000: 0000 0037", b"\t0x0000:  4500 0034", b"00000000: 0000 0037  ...7"):
        assert from_hex(dump, "stdin") == dump
    assert "it is text that begins with '00000000: 0000 0037 '; expected hex digits" in text_hint(dump)
    assert text_hint(b"\x00" + dump) == ""


def test_input_bytes_errors_explain_the_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(MAGIC)))
    with pytest.raises(BadRecording, match="stdin is a recording; give the path"):
        input_bytes("-")
    (tmp_path / "dump").write_text("00 0")
    with pytest.raises(BadRecording, match="has 3 hex digits; expected two for each byte"):
        input_bytes(str(tmp_path / "dump"))
    with pytest.raises(BadRecording, match=r"cannot read 0000003714: .*pipe them into stdin"):
        input_bytes("0000003714")
