"""Every recording in captures/ decodes to the contents of its golden file. New recordings need no change here."""

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


def test_recordings_cover_every_firmware() -> None:
    firmware = {info["firmware"] for path in RECORDINGS for info in RecordingFile(path).channels.values()}
    missing = sorted(set(FIRMWARE) - firmware)
    assert not missing, f"no recording of firmware {', '.join(missing)}; run captures/make.py to record it"


@every_recording
def test_recording_is_complete(path: Path) -> None:
    recording = RecordingFile(path)
    assert recording.is_complete
    assert recording.left_out == 0


@every_recording
def test_recording_equals_its_golden_file(path: Path) -> None:
    if not golden_of(path).exists():
        pytest.fail(f"{path.name} has no {golden_of(path).name}; write it with captures/make.py --golden-only")
    expected: dict[str, Any] = json.loads(golden_of(path).read_text())
    found = golden(path)
    assert found["channels"] == expected["channels"]
    assert found["packets"].keys() == expected["packets"].keys()
    for interface, classes in expected["packets"].items():
        # Compare class by class, so that a failure names the class.
        assert found["packets"][interface].keys() == classes.keys()
        for name, told in classes.items():
            for which, packet in told.items():
                assert found["packets"][interface][name][which] == packet, f"{interface}: {which} {name}"


def test_every_golden_file_has_a_recording() -> None:
    names = {path.name for path in FOLDER.glob("*.golden.json")}
    assert_listed(
        {golden_of(path).name for path in RECORDINGS}, names, "captures/ (with captures/make.py --golden-only)"
    )


@every_recording
def test_simulator_recording_has_a_simulator_address(path: Path) -> None:
    if path.name.startswith("simulator-"):
        assert all(info["address"].startswith("sim://") for info in RecordingFile(path).channels.values())


@every_recording
@pytest.mark.real_time
def test_replay_of_a_recording_gives_the_same_packets(path: Path) -> None:
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
