from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from linkcore.clock import Stamp
from linkcore.recording.file import Kind, RecordingWriter
from tests.harm import HOSTILE, assert_harmless, strict
from urlink.packets import RealtimeState
from urlink.protocol.firmware import RELEASES
from urlink.simulator import Controller

from .conftest import Run, write

pytestmark = pytest.mark.simulated_time


def test_replay_prints_summary(run: Run, recording: Path) -> None:
    status, out, err = run("replay", str(recording))
    assert (status, err) == (0, "")
    assert out.startswith(f"{recording}: 0.5 s, {recording.stat().st_size} bytes, complete\n")
    assert "realtime: UR5e, firmware 5.11, made\n" in out
    assert f" for 0.490 s, {20 * 1220} bytes\n" in out
    assert "  20 RealtimeState, 38.8 packets/s\n  1 silence, the longest 0.310 s\n" in out
    assert "  1 VersionMessage, 1 TextMessage, 1 RobotState, 100.0 packets/s\n  no silence\n" in out
    assert out.count("  no cycle is missing\n") == 2


def test_replay_prints_summary_as_json(run: Run, recording: Path) -> None:
    summary = strict(run("replay", str(recording), "--json")[1])
    assert summary["is_complete"] is True
    assert summary["left_out"] == 0
    realtime, primary = summary["channels"]
    assert realtime["packets"] == {"RealtimeState": 20}
    assert realtime["gaps"] == pytest.approx([0.31])
    assert realtime["missing"] == {"cycles": 0, "gaps": 0, "longest": 0.0}
    assert primary["packets"] == {"VersionMessage": 1, "TextMessage": 1, "RobotState": 1}


def test_replay_reports_damage(run: Run, recording: Path) -> None:
    data = recording.read_bytes()
    recording.write_bytes(data[:-100])
    status, out, _ = run("replay", str(recording))
    assert status == 0
    assert "not closed properly, for example after a crash; " in out
    assert " bytes at the end are damaged or unfinished, and were ignored" in out
    assert strict(run("replay", str(recording), "--json")[1])["left_out"] > 0


def test_replay_reports_undecoded_bytes(run: Run, tmp_path: Path) -> None:
    good = bytes(RealtimeState("5.11"))
    garbage = b"\xff" * 50
    path = tmp_path / "x.urlog"
    writer = RecordingWriter(path)
    channel = writer.add_channel({"name": "realtime"})
    chunks = [good, garbage, good + good, good[:100]]
    for at, state in ((1.0, "connected"), (3.0, "lost"), (4.0, "connected")):
        event = json.dumps({"state": state, "error": HOSTILE if state == "lost" else None}).encode()
        writer.write(Kind.EVENT, channel, Stamp(at, at), event)
        for chunk in chunks if state == "connected" else []:
            writer.write(Kind.BYTES, channel, Stamp(at, at), chunk)
    writer.close()
    status, out, _ = run("replay", str(path))
    assert status == 0
    assert "unknown arm, firmware unknown, -" in out
    assert "  6 RealtimeState, " in out
    assert "0 packets not decoded, 100 bytes outside packets, 200 bytes of unfinished packets" in out
    assert "2 connections, lost 1 time\n    safe\\x1b[2J" in out
    assert_harmless(out)


def test_replay_reports_channel_without_bytes(run: Run, tmp_path: Path) -> None:
    path = write(tmp_path / "x.urlog", {"realtime": []}, info={"model": HOSTILE, "address": HOSTILE})
    status, out, _ = run("replay", str(path))
    assert status == 0
    assert out.endswith("  no bytes\n")
    assert_harmless(out)


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_replay_plays_every_firmware(run: Run, tmp_path: Path, release: object) -> None:
    controller = Controller(None, release.since)  # type: ignore[attr-defined]
    controller.step()
    channels = {"realtime": [controller.realtime_packet()], "primary": controller.greeting("primary")}
    path = write(tmp_path / "x.urlog", channels, info={"firmware": str(controller.firmware)})
    for interface in channels:
        status, out, err = run("replay", str(path), "--rate", "max", "--interface", interface, "--json")
        assert (status, err) == (0, "")
        assert strict(out.splitlines()[-1])["type"] in ("RealtimeState", "RobotState")


def test_replay_with_rate_prints_like_echo(run: Run, recording: Path) -> None:
    status, out, err = run("replay", str(recording), "--rate", "max", "time", "robot_mode", "--count", "2")
    assert (status, err) == (0, "")
    assert out == "time=0 robot_mode=DISCONNECTED\ntime=0.002 robot_mode=DISCONNECTED\n"
    status, out, _ = run("replay", str(recording), "--rate", "max", "--json", "--type", "TextMessage")
    assert strict(out)["text"] == HOSTILE
    assert_harmless(out)


def test_replay_keeps_recorded_timing(run: Run, recording: Path) -> None:
    started = time.monotonic()
    assert run("replay", str(recording), "--rate", "1", "time")[1].count("\n") == 20
    at_one = time.monotonic() - started
    started = time.monotonic()
    assert run("replay", str(recording), "--rate", "8", "time")[1].count("\n") == 20
    at_eight = time.monotonic() - started
    assert at_one >= 0.49  # the duration of the recording
    assert at_eight >= 0.06
    assert at_eight < at_one


def test_fields_without_rate_are_rejected(run: Run, recording: Path) -> None:
    status, _, err = run("replay", str(recording), "q_actual")
    assert status == 2
    assert "need --rate" in err


def test_replay_fails_for_unrecorded_interface(run: Run, recording: Path) -> None:
    status, out, err = run("replay", str(recording), "--rate", "max", "--interface", "secondary")
    assert (status, out) == (1, "")
    assert "has no channel 'secondary'; its channels are realtime, primary" in err


def test_replay_rejects_unknown_field(run: Run, recording: Path) -> None:
    assert run("replay", str(recording), "--rate", "max", "nonsense")[0] == 2


@pytest.fixture
def with_holes(tmp_path: Path) -> Path:
    """Recording of real-time states that arrived regularly, but some are missing by the controller's own clock."""
    numbers = [*range(60), *range(80, 90), *range(130, 200)]
    return write(tmp_path / "holes.urlog", {"realtime": [bytes(RealtimeState("5.11", time=n / 500)) for n in numbers]})


HOLES = "60 of 200 cycles are missing (2 gaps, the longest 0.082 s)"


@pytest.mark.parametrize(
    "command",
    [
        ("replay", "{}"),
        ("info", "replay://{}"),
        ("export", "{}", "{}.csv", "q_actual"),
        ("echo", "replay://{}?rate=max"),
        ("hz", "replay://{}?rate=max"),
        ("record", "replay://{}?rate=max", "{}.copy.urlog", "--interface", "realtime"),
    ],
    ids=lambda command: command[0],
)
def test_missing_cycles_are_reported(run: Run, with_holes: Path, command: tuple[str, ...]) -> None:
    status, out, err = run(*(word.format(with_holes) for word in command))
    assert status == 0
    assert HOLES in out + err


def test_missing_cycles_are_reported_in_json(run: Run, with_holes: Path) -> None:
    (said,) = strict(run("info", f"replay://{with_holes}", "--json")[1])["missing"]
    assert said.startswith(f"realtime: {HOLES}: ")
