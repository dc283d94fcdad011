"""Every recorded run of the original MRC is compared tick by tick: commands, text, events and logs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rhdlink.smrcl.controller import MissionController
from rhdlink.smrcl.profile import MRC
from rhdlink.smrcl.robot_conf import VELOMEGA
from tests.rhdlink.smrcl.oracle import Recorded, drives, manifest, normal, older_drives, replay

DRIVES = drives()
pytestmark = pytest.mark.skipif(
    DRIVES is None, reason="the runs of the original MRC (../shared/captures/mrc beside the repository) are not here"
)
RUNS = [] if DRIVES is None else manifest(DRIVES)
OLDER = [] if DRIVES is None else older_drives(DRIVES)


def name_of(recorded: Recorded) -> str:
    return f"{recorded.script.partition('.')[0]}-{recorded.robot}"


@pytest.mark.parametrize("recorded", RUNS, ids=name_of)
def test_recorded_run_of_mrc_is_reproduced(recorded: Recorded) -> None:
    found = replay(recorded)
    assert found.differences == []
    assert found.is_finished
    assert found.ticks == len(recorded.rows())
    expected = recorded.file(recorded.stdout)
    # After this text, MRC prints its final messages.
    assert normal(found.printed) == normal(expected[: expected.rindex(" logging ")])
    if recorded.transcript:
        lines = [line.rstrip() for line in normal(recorded.file(recorded.transcript)).splitlines()]
        assert [normal(line).rstrip() for line in found.transcript] == lines
    for log in recorded.logs:
        name = "first.log" if ".first." in log else "log"
        assert found.logs[name] == recorded.file(log)


@pytest.mark.parametrize("recorded", OLDER, ids=name_of)
def test_older_recorded_drive_is_reproduced(recorded: Recorded) -> None:
    found = replay(recorded)
    assert found.differences == []
    assert (found.ticks, found.is_finished) == (len(recorded.rows()), True)


def run_alone(source: str) -> tuple[int, str]:
    """Return ticks and text of a script on a velocity-omega robot that follows its commands exactly."""
    read, write = {"tick": 1, "transpos": 1, "rotpos": 1}, {"cmdtransvel": [0], "cmdrotvel": [0]}
    controller = MissionController(VELOMEGA, read, write, profile=MRC)
    controller.load(source)
    request = controller.first_request()
    travelled = heading = 0.0
    velocity = rate = tick = 0
    text = ""
    while True:
        tick += 1
        travelled, heading = travelled + velocity / 1e5 * 0.01, heading + rate / 4e4 * 0.01
        velocity, rate = request.get("cmdtransvel", [velocity])[0], request.get("cmdrotvel", [rate])[0]
        if controller.is_finished or tick > 1000:
            return tick, text
        request = controller.step(
            {"tick": [tick], "transpos": [round(travelled * 1e5)], "rotpos": [round(heading * 4e4)]}
        )
        text += "".join(said.printed for said in controller.take_said())


def test_tiny_scripts_print_the_text_of_mrc() -> None:
    assert DRIVES is not None
    lines = (Path(DRIVES) / "oracle" / "oneliners.jsonl").read_text().splitlines()
    assert len(lines) >= 70
    for line in lines:
        expected = json.loads(line)
        ticks, text = run_alone(expected["script"])
        assert (ticks, normal(text)) == (expected["ticks"], normal(expected["stdout"])), expected["script"]
