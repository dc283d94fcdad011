from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from linkcore.recording.file import Kind, RecordingFile
from tests.spawning import ENDINGS, Ending
from urlink import decode
from urlink.simulator import Controller

from .conftest import Run

pytestmark = pytest.mark.real_time

Spawn = Callable[..., "subprocess.Popen[str]"]


def payload(path: Path, name: str) -> bytes:
    recording = RecordingFile(path)
    number = recording.channel(name)
    return b"".join(each.payload for each in recording if each.kind is Kind.BYTES and each.channel == number)


def test_record_ends_after_duration(run: Run, address: str, tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    status, out, err = run("record", address, str(path), "--duration", "0.5")
    assert status == 0
    assert err == f"urlink: recording realtime and primary of {address} into {path}; Ctrl-C ends it\n"
    assert f"{path}: " in out
    assert "bytes, complete\n" in out
    assert " RealtimeState, " in out
    recording = RecordingFile(path)
    assert recording.is_complete
    assert [info["name"] for info in recording.channels.values()] == ["realtime", "primary"]
    assert len(payload(path, "realtime")) > 1220 * 100  # nominally 250 packets, fewer on a busy computer


@pytest.mark.parametrize("interface", ["realtime", "primary", "secondary"])
def test_record_obeys_count_and_interface(run: Run, address: str, tmp_path: Path, interface: str) -> None:
    path = tmp_path / "run.urlog"
    status, out, _ = run("record", address, str(path), "--interface", interface, "--count", "3")
    assert status == 0
    assert f"{interface}: UR5e, firmware 5.11, {address}" in out
    assert [info["name"] for info in RecordingFile(path).channels.values()] == [interface]
    assert len(decode(payload(path, interface), "realtime" if interface == "realtime" else "primary")) >= 3


def test_record_never_overwrites_a_file(run: Run, address: str, tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    path.write_text("precious")
    status, out, err = run("record", address, str(path), "--count", "1")
    assert (status, out) == (1, "")
    assert err == f"urlink: {path} exists; a recording never overwrites a file\n"
    assert path.read_text() == "precious"


@pytest.mark.slow
def test_lost_connections_are_in_the_file(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    with Controller("UR5e", "5.11") as controller:
        controller.schedule(*(f"cut@{half / 2}" for half in range(1, 60)))
        where = controller.address
        status, out, _ = run("record", where, str(path), "--interface", "realtime", "--duration", "2")
    assert status == 0
    assert "connections, lost " in out


@pytest.mark.slow
@pytest.mark.parametrize(("end", "status"), ENDINGS)
def test_signals_close_the_file_properly(spawn: Spawn, address: str, tmp_path: Path, end: Ending, status: int) -> None:
    path = tmp_path / "run.urlog"
    process = spawn("record", address, str(path))
    assert process.stderr is not None
    assert "Ctrl-C ends it" in process.stderr.readline()
    end(process)
    out, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (status, "")
    assert "bytes, complete\n" in out
    recording = RecordingFile(path)
    assert recording.is_complete
    assert recording.left_out == 0


def test_recording_of_a_recording_has_same_bytes(run: Run, recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "copy.urlog"
    source = f"replay://{str(recording).replace(' ', '%20')}?rate=max"
    status, _, _ = run("record", source, str(path))
    assert status == 0
    for name in ("realtime", "primary"):
        assert payload(path, name) == payload(recording, name)
