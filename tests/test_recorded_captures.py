"""Every recording in captures/ reads as its golden file says. A new one needs no change here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import urlink
from captures.make import FIRMWARE, golden, golden_of, packets
from linkcore.recording.file import RecordingFile
from linkcore.wire.packet import State
from tests.listed import assert_listed

FOLDER = Path(__file__).resolve().parents[1] / "captures"
RECORDINGS = sorted(FOLDER.glob("*.urlog"))

every_recording = pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)


def test_there_are_recordings_of_every_generation() -> None:
    firmware = {info["firmware"] for path in RECORDINGS for info in RecordingFile(path).channels.values()}
    missing = sorted(set(FIRMWARE) - firmware)
    assert not missing, f"run captures/make.py, which records into captures/ what is missing: {', '.join(missing)}"


@every_recording
def test_is_whole(path: Path) -> None:
    recording = RecordingFile(path)
    assert recording.is_complete
    assert recording.left_out == 0


@every_recording
def test_reads_as_its_golden_file_says(path: Path) -> None:
    if not golden_of(path).exists():
        pytest.fail(f"{path.name} has no {golden_of(path).name}; write it with captures/make.py --golden-only")
    expected: dict[str, Any] = json.loads(golden_of(path).read_text())
    found = golden(path)
    assert found["channels"] == expected["channels"]
    assert found["packets"].keys() == expected["packets"].keys()
    for interface, classes in expected["packets"].items():
        # Class by class, so that a difference is told where it is.
        assert found["packets"][interface].keys() == classes.keys()
        for name, told in classes.items():
            for which, packet in told.items():
                assert found["packets"][interface][name][which] == packet, f"{interface}: {which} {name}"


def test_no_golden_file_is_without_its_recording() -> None:
    names = {path.name for path in FOLDER.glob("*.golden.json")}
    assert_listed(
        {golden_of(path).name for path in RECORDINGS}, names, "captures/ (with captures/make.py --golden-only)"
    )


@every_recording
def test_says_where_it_comes_from(path: Path) -> None:
    if path.name.startswith("simulator-"):
        assert all(info["address"].startswith("sim://") for info in RecordingFile(path).channels.values())


@every_recording
@pytest.mark.real_time
def test_replayed_as_an_address_it_gives_the_same_packets(path: Path) -> None:
    recording = RecordingFile(path)
    info = recording.channels[0]
    with urlink.connect(f"replay://{path}?rate=max") as robot:
        assert str(robot.firmware) == info["firmware"]
        assert robot.model == info["model"]
        for channel in recording.channels.values():
            stream = getattr(robot, channel["name"])
            replayed: list[State] = list(stream.of(State))
            assert list(map(bytes, replayed)) == list(map(bytes, packets(path, channel["name"])))
            assert len(replayed) == stream.stats.received
            assert stream.stats.decoded == stream.stats.received
            assert stream.stats.failed == stream.stats.skipped == 0
