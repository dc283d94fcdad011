"""`robot.record("run.mcap")`: the file contains the data of the streams, even if the program was killed."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urlink
import urlink.cli
from linkcore.recording.mcap_file import McapFile
from tests import platforms
from tests.waiting import until

CAPTURE = Path(__file__).resolve().parents[3] / "captures" / "simulator-5.11.urlog"

pytest.importorskip("mcap", reason="mcap is not installed")
pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")

from mcap.reader import NonSeekingReader, make_reader  # noqa: E402  # only if they are installed
from mcap_ros2.decoder import DecoderFactory  # noqa: E402


def read(path: Path, *, whole: bool = True) -> dict[str, list[Any]]:
    """Return the messages of each topic; of an unfinished file, the messages before its end."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = (make_reader if whole else NonSeekingReader)(file, decoder_factories=[DecoderFactory()])
        try:
            for message in reader.iter_decoded_messages(log_time_order=whole):
                found.setdefault(message.channel.topic, []).append(message)
        except Exception:
            assert not whole
    return found


@pytest.mark.slow
@pytest.mark.simulated_time
def test_mcap_file_contains_all_streamed_data(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with urlink.connect(f"replay://{CAPTURE}?rate=max") as robot:
        recorder = robot.record(path)
        robot.realtime.join(10)
        robot.primary.join(10)
        recorder.close()
        recorder.close()
    run = urlink.load(CAPTURE)
    found = read(path)
    positions = [list(message.decoded_message.position) for message in found["/joint_states"]]
    assert positions == run.realtime["q_actual"].tolist()
    stamps = np.array([message.message.log_time for message in found["/realtime"]])
    assert np.abs(stamps - run.realtime.wall.astype(np.int64)).max() < 1000
    assert len(found["/primary"]) == len(run.primary)
    assert len(found["/log"]) == len(run.primary.of(urlink.packets.RobotMessage))
    assert len(found["/robot_description"]) == 1
    with urlink.connect(f"replay://{CAPTURE}?rate=max") as robot:
        with pytest.raises(urlink.BadRecording, match="never overwrites"):
            robot.record(path)
        with pytest.raises(urlink.BadValue, match=r"\.csv cannot be written live"):
            robot.record(tmp_path / "run.csv")
        with pytest.raises(urlink.BadRecording, match="cannot write"):
            robot.record(tmp_path / "nowhere" / "run.mcap")
    assert urlink.cli.main(["record", f"replay://{CAPTURE}?rate=max", str(tmp_path / "again.mcap")]) == 0
    assert len(read(tmp_path / "again.mcap")["/joint_states"]) == len(run.realtime)


@pytest.mark.simulated_time
def test_mcap_metadata_describe_robot(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    before = np.datetime64(time.time_ns(), "ns")
    with urlink.connect(f"replay://{CAPTURE}?rate=max") as robot, robot.record(path):
        robot.realtime.join(10)
    with path.open("rb") as file:
        (about,) = (each.metadata for each in make_reader(file).iter_metadata() if each.name == "recording")
    assert (about["robot"], about["firmware"]) == (robot.model, str(robot.firmware))
    assert about["address"] == robot.address
    assert before <= np.datetime64(about["start"].rstrip("Z")) <= np.datetime64(time.time_ns(), "ns")
    assert "UTC" in about["clock"]


def test_missing_extra_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with (
        urlink.connect(f"replay://{CAPTURE}?rate=max") as robot,
        pytest.raises(urlink.LocalError, match=r"pip install 'urlink-robot\[mcap\]'"),
    ):
        robot.record(tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.simulated_time
def test_disk_failure_is_reported_on_close(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with urlink.connect(f"replay://{CAPTURE}?rate=max") as robot:
        recorder = robot.record(tmp_path / "run.mcap")
        monkeypatch.setattr(McapFile, "write", fail)
        assert robot.realtime.join(10)
        with pytest.raises(urlink.BadRecording, match="No space left"):
            recorder.close()
        assert "No space left" in str(recorder.failure)


PROGRAM = """
import sys, time, urlink
with urlink.connect("sim://") as robot, robot.record(sys.argv[1]):
    robot.realtime.wait(10)
    print("recording", flush=True)
    time.sleep(60)
"""


@pytest.mark.slow
@platforms.needs_signals
@pytest.mark.real_time
def test_killed_program_leaves_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with subprocess.Popen([sys.executable, "-c", PROGRAM, str(path)], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "recording\n"
        until(lambda: path.stat().st_size > 50_000)
        program.send_signal(signal.SIGKILL)
    found = read(path, whole=False)
    times = [message.message.log_time for message in found["/joint_states"]]
    assert len(times) > 20
    assert times == sorted(times)
    assert len(found["/realtime"]) > 20
    assert found["/robot_description"]
