"""The commands record and replay."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import pytest

import rhdlink
from linkcore.clock import Stamp
from linkcore.recording.file import Kind, RecordingFile, RecordingWriter
from rhdlink import Host
from rhdlink.host.plugins.logger import Logger
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.recording import play
from rhdlink.variables import Database, TimeStamp
from rhdlink.wire.messages import END
from tests.harm import assert_harmless, strict
from tests.spawning import ENDINGS, Ending

from .conftest import Run, Spawn


def robot() -> Database:
    database = Database()
    database.read.add("tick")
    database.read.add("rotpos")
    database.read.add("\x1b[2Jodd", 2)
    database.write.add("cmdtransvel")
    return database


def batch(database: Database, tick: int, rotpos: int) -> bytes:
    database.read.set(0, tick, TimeStamp(1000 + tick, 0))
    database.read.set(1, rotpos, TimeStamp(1000 + tick, 0))
    return database.read.encode(database.read.dirty.take()) + END


def write(path: Path, chunks: Sequence[bytes | None], *, name: str = "rhd") -> Path:
    """Write a recording of these chunks, 10 ms apart; None is a lost connection."""
    writer = RecordingWriter(path)
    channel = writer.add_channel({"name": name})
    for number, chunk in enumerate(chunks):
        stamp = Stamp(100.0 + number / 100, 1.7e9 + number / 100)
        if chunk is None:
            writer.write(Kind.EVENT, channel, stamp, b'{"state": "lost", "error": null}')
        else:
            writer.write(Kind.BYTES, channel, stamp, chunk)
    writer.close()
    return path


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Recording of two connections; the first ends in the middle of a batch, and the second has a split handshake."""
    database = robot()
    greeting = database.encode_handshake("r")
    first = batch(database, 1, 40000)
    second = database.encode_handshake("r")
    chunks = [greeting, first, first[:5], None, second[:50], second[50:], batch(database, 2, 0), batch(database, 3, 0)]
    return write(tmp_path / "run.urlog", chunks)


def test_replay_prints_a_summary_of_the_recording(run: Run, recording: Path) -> None:
    status, out, err = run("replay", str(recording))
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == f"{recording}: 0.1 s, {recording.stat().st_size} bytes, complete"
    assert lines[1].startswith("5 batches, ")
    assert lines[1].endswith("2 connections, time stamps of 2 words")
    assert [line.split() for line in lines[2:]] == [
        ["tick", "set", "3", "times"],
        ["rotpos", "set", "3", "times"],
        ["\\x1b[2Jodd", "set", "0", "times"],
        ["cmdtransvel", "set", "0", "times"],
    ]
    assert_harmless(out)
    summary = strict(run("replay", str(recording), "--json")[1])
    assert (summary["batches"], summary["connections"], summary["variables"]["tick"]) == (5, 2, 3)


def test_replay_prints_the_values_of_a_variable(run: Run, recording: Path) -> None:
    status, out, err = run("replay", str(recording), "--rate", "max", "rotpos")
    assert (status, err) == (0, "")
    # The second handshake repeats the values known by then.
    assert [line.partition(" | ")[2] for line in out.splitlines()] == [
        "rotpos 40000 = 1 rad",
        "rotpos 40000 = 1 rad",
        "rotpos 0 = 0 rad",
        "rotpos 0 = 0 rad",
    ]


def test_replay_prints_json_at_the_given_rate(run: Run, recording: Path) -> None:
    began = time.monotonic()
    status, out, _ = run("replay", str(recording), "tick", "--json", "--rate", "0.5", "--count", "3")
    assert status == 0
    assert time.monotonic() - began > 0.1  # 60 ms of it were played
    updates = [strict(line) for line in out.splitlines()]
    assert [each["variables"]["tick"] for each in updates] == [[1], [1], [2]]
    assert updates[0]["received"] == pytest.approx(1.7e9 + 0.01)


@pytest.mark.parametrize(
    ("chunks", "name", "argv", "said"),
    [
        ([], "realtime", (), "has no channel 'rhd'; its channels are realtime"),
        ([b"nothing"], "rhd", (), "cannot begin a package"),
        ([robot().encode_handshake("r")], "rhd", ("speedl", "--rate", "max"), "contains no variable 'speedl'"),
    ],
)
def test_replay_reports_invalid_recordings(
    run: Run, tmp_path: Path, chunks: list[bytes], name: str, argv: tuple[str, ...], said: str
) -> None:
    path = write(tmp_path / "x.urlog", chunks, name=name)
    status, out, err = run("replay", str(path), *argv)
    assert (status, out) == (1, "")
    assert said in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("argv", [("x", "tick"), ("x", "--count", "1"), ("x", "--rate", "0"), ("x", "--rate", "-1")])
def test_wrong_usage_of_replay_exits_with_2(run: Run, recording: Path, argv: tuple[str, ...]) -> None:
    status, out, err = run("replay", *(str(recording) if each == "x" else each for each in argv))
    assert (status, out) == (2, "")
    assert err.startswith("usage: rhdlink replay")


@pytest.mark.simulated_time
def test_recording_can_be_replayed_and_dissected(run: Run, address: str, tmp_path: Path) -> None:
    path = str(tmp_path / "drive.urlog")
    status, out, err = run("record", address, path, "--count", "20")
    assert status == 0
    assert err == f"rhdlink: recording {address} into {path}; Ctrl-C ends it\n"
    assert ", complete\n" in out
    assert "linesensor" in out
    status, out, _ = run("replay", path, "tick", "counter", "--rate", "max", "--json")
    assert status == 0
    updates = [strict(line)["variables"] for line in out.splitlines()]
    assert len(updates) >= 20
    # The handshake may fall between a plugin and the tick, and then the counter in the first batch is not new.
    assert all(each["counter"][0] == 1 - each["tick"][0] for each in updates[2:])
    status, out, _ = run("dissect", path, "--count", "2")
    assert (status, out.splitlines()[0]) == (0, "#1 ar: grants access as reader, 2 bytes at 0")


@pytest.mark.simulated_time
def test_record_never_overwrites_a_file(run: Run, address: str, recording: Path) -> None:
    before = recording.read_bytes()
    status, out, err = run("record", address, str(recording))
    assert (status, out) == (1, "")
    assert "exists" in err
    assert recording.read_bytes() == before


@pytest.mark.simulated_time
def test_failed_connection_leaves_no_file(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "drive.urlog"
    assert run("record", "127.0.0.1:1", str(path))[0] == 1
    assert not path.exists()


@pytest.mark.slow
@pytest.mark.parametrize(("end", "status"), ENDINGS)
@pytest.mark.real_time
def test_signal_completes_the_recording(spawn: Spawn, address: str, tmp_path: Path, end: Ending, status: int) -> None:
    path = tmp_path / "drive.urlog"
    process = spawn("record", address, str(path))
    assert process.stderr is not None
    assert "recording" in process.stderr.readline()
    end(process)
    out, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (status, "")
    assert ", complete\n" in out
    assert RecordingFile(path).is_complete


@pytest.mark.simulated_time
def test_lost_connection_is_in_the_recording(tmp_path: Path, own_port: int) -> None:
    path = tmp_path / "drive.urlog"
    with Host([Turtle()], port=own_port, pacing="lockstep"):
        robot = rhdlink.connect(f"127.0.0.1:{own_port}", record=path)
        robot.sync()
    with pytest.raises(rhdlink.ConnectionLost):
        robot.sync()
    with Host([Turtle()], port=own_port, pacing="lockstep"):
        robot.sync()
        robot.close()
    moments = [(moment.connection, moment.is_handshake) for moment in play(RecordingFile(path))]
    assert moments == [(1, True), (1, False), (2, True), (2, False)]


@pytest.mark.simulated_time
def test_failing_disk_stops_the_recording_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(writer: RecordingWriter, *_: object) -> None:
        writer.failure = "the disk is full"
        raise rhdlink.BadRecording(writer.failure)

    with Host([Turtle()], port=0, pacing="lockstep") as host:
        robot = rhdlink.connect(f"127.0.0.1:{host.port}", record=tmp_path / "drive.urlog")
        monkeypatch.setattr(RecordingWriter, "write", full)
        robot.sync()
        robot.sync()
        assert caplog.text.count("the disk is full; the connection continues without recording") == 1
        with pytest.raises(rhdlink.BadRecording):
            robot.close()
        robot.close()
    assert not RecordingFile(tmp_path / "drive.urlog").is_complete


@pytest.mark.simulated_time
def test_recording_of_the_logger_can_be_replayed(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "drive.urlog"
    with (
        Host([Turtle(), Logger(path)], port=0, pacing="lockstep") as host,
        rhdlink.connect(f"127.0.0.1:{host.port}", rhdlink.robots.VelocityOmega, access="w") as robot,
    ):
        robot.cmdtransvel = 0.5
        for _ in range(11):
            robot.sync()
    status, out, _ = run("replay", str(path), "transpos", "cmdtransvel", "--rate", "max")
    assert status == 0
    assert "cmdtransvel 50000 = 0.5 m/s" in out
    assert "transpos 5000" in out
