from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhdlink.variables import Database
from rhdlink.wire.dissection import Piece, dissect, guess_sender, tables_in
from rhdlink.wire.messages import END, encode_ready
from tests import real_captures
from tests.harm import assert_harmless, strict

from .conftest import Run

SERVERS = ("reader64", "reader32", "reader_orig2014", "writer64naive", "second_writer64", "race_corrupted_reader64")


def database() -> Database:
    made = Database()
    made.read.add("tick")
    made.read.add("encl\x1b", 2)
    made.write.add("speedl")
    made.write.add("arm", 3)
    made.write.set(1, [1, -2, 3])
    return made


def server(width: int = 2) -> bytes:
    made = database()
    greeting = made.encode_handshake("w", width)
    return greeting + made.read.encode(np.array([0, 1]), width) + END


def client(width: int = 2) -> bytes:
    return b"aw" + encode_ready("w") + database().write.encode(np.array([1]), width) + END


def whole(pieces: list[Piece]) -> bytes:
    """Return the bytes of the pieces, and check that each piece begins where the previous one ended."""
    data = b""
    for piece in pieces:
        assert piece.offset == len(data)
        for part in piece.parts:
            assert part.offset == len(data)
            data += part.data
    return data


def test_dissect_reads_hex_text_and_stdin(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, data = tmp_path / "server", server()
    path.write_bytes(data)
    status, expected, _ = run("dissect", str(path))
    assert status == 0
    path.write_text(data.hex(" "))
    assert run("dissect", str(path))[:2] == (0, expected)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(data)))
    assert run("dissect", "-")[:2] == (0, expected)


@pytest.mark.parametrize("width", [2, 4])
def test_both_directions_are_dissected(width: int) -> None:
    tables, found = tables_in(server(width))
    assert found == width
    assert (guess_sender(server(width)), guess_sender(client(width))) == ("server", "client")
    pieces = list(dissect(server(width), "server", width=width))
    assert [(piece.batch, piece.package) for piece in pieces] == [
        *((0, package) for package in ("aw", "tw", "tr", "dw", "dr", "ee")),
        *((1, package) for package in ("dr", "ee")),
    ]
    assert pieces[3].parts[2].content["words"] == [1, -2, 3]
    assert pieces[3].parts[2].content["stamp"][0] > 1_700_000_000
    asked = list(dissect(client(width), "client", tables, width))
    assert [piece.package for piece in asked] == ["aw", "rw", "dw", "ee"]
    assert asked[2].parts[1].content == pieces[3].parts[2].content | {"stamp": asked[2].parts[1].content["stamp"]}
    assert [piece.error for piece in [*pieces, *asked]] == [None] * 12


@pytest.mark.captures("rhd")
@pytest.mark.parametrize("name", SERVERS)
def test_dissect_explains_every_byte_of_recorded_servers(run: Run, name: str) -> None:
    path = real_captures.folder("rhd") / f"{name}.s2c.bin"
    status, out, err = run("dissect", str(path), "--json")
    assert (status, err) == (0, "")
    pieces = [strict(line) for line in out.splitlines()]
    assert {piece["error"] for piece in pieces} == {None}
    assert b"".join(bytes.fromhex(part["hex"]) for piece in pieces for part in piece["parts"]) == path.read_bytes()
    assert pieces[-1]["package"] == "ee"


@pytest.mark.captures("rhd")
@pytest.mark.parametrize("name", ["writer64", "writer64naive", "writer_orig2014"])
def test_recorded_clients_are_dissected_with_their_servers(run: Run, name: str) -> None:
    folder = real_captures.folder("rhd")
    path = str(folder / f"{name}.c2s.bin")
    status, out, _ = run("dissect", path, "--tables", str(folder / f"{name}.s2c.bin"), "--json")
    assert status == 0
    pieces = [strict(line) for line in out.splitlines()]
    assert {piece["error"] for piece in pieces} == {None}
    speeds = [part["words"][0] for piece in pieces for part in piece["parts"] if part.get("name") == "speedl"]
    assert speeds == list(range(10, 60))


def test_dissect_prints_readable_lines(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "server.bin"
    path.write_bytes(server())
    status, out, err = run("dissect", str(path), "--count", "2")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "#1 aw: grants access as master, 2 bytes at 0"
    assert lines[2] == "#2 tw: table of write variables: 2, 80 bytes at 2"
    assert lines[3].split() == [*["2", "74", "77", "00", "00", "00", "02", "table", "of", "write", "variables:", "2"]]
    assert lines[4].endswith("0 speedl, 1 word")
    assert_harmless(run("dissect", str(path))[1])


def test_missing_tables_and_data_are_reported(run: Run, tmp_path: Path) -> None:
    path, other = tmp_path / "client.bin", tmp_path / "other.bin"
    path.write_bytes(client())
    other.write_bytes(b"nothing")
    status, out, _ = run("dissect", str(path))
    assert status == 0
    assert "!! the lengths of the variables are unknown; use --tables" in out
    status, _, err = run("dissect", str(path), "--tables", str(other))
    assert status == 1
    assert "contains no handshake" in err
    assert run("dissect", str(other))[0] == 1
    other.write_bytes(b"")
    status, _, err = run("dissect", str(other))
    assert (status, err) == (1, f"rhdlink: {other} contains no bytes\n")


def test_client_data_without_tables_is_dissected() -> None:
    (*_, data, end, again) = dissect(b"awrwdw\0\0\0\0eerr", "client")
    assert (data.error, data.size, end.package, again.package) == (None, 6, "ee", "rr")
    # Without tables, only the kind of the package is known.
    (piece,) = dissect(b"dw\0\0\0\1", "client")
    assert (piece.package, piece.meaning, piece.size) == ("dw", "values of write variables", 6)
    (piece,) = dissect(b"xx", "client")
    assert (piece.package, piece.meaning, piece.size) == ("", "no package", 2)


def test_server_without_a_grant_is_recognised_by_its_table() -> None:
    assert guess_sender(server()[2:]) == "server"


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (server()[:50], "the package ends within the name of row 1"),
        (server()[:5], "the package ends before its count"),
        (server()[:-3], "the package ends within the data of entry 1"),
        (b"awtw\xff\xff\xff\xff", "the count is -1; expected 0 to 8192"),
        (b"awx", "one byte of a package"),
        (b"awxx", "b'xx' does not begin a package of a server"),
        (b"rr", "b'rr' does not begin a package of a server"),
        (server() + b"dr" + b"\0\0\0\1" + b"\0\0\0\2", "entry 0: the id of the variable is 2; expected 0 to 1"),
        (b"tr\0\0\0\1" + b"\xff" * 4 + bytes(33) + b"dr\0\0\0\1" + bytes(12), "entry 0: the variable has -1 words"),
    ],
)
def test_invalid_package_is_shown_with_the_reason(data: bytes, error: str) -> None:
    pieces = list(dissect(data, "server"))
    assert error in str(pieces[-1].error)
    assert whole(pieces) == data


@pytest.mark.property
@given(st.binary(max_size=60), st.integers(0, len(server())), st.sampled_from([2, 4]), st.booleans())
def test_every_byte_is_shown_exactly_once(noise: bytes, at: int, width: int, from_server: bool) -> None:
    good, sender = (server(width), "server") if from_server else (client(width), "client")
    data = good[:at] + noise + good[at:]
    tables, _ = tables_in(server(width))
    assert whole(list(dissect(data, sender, tables, width))) == data
    tables_in(data)
