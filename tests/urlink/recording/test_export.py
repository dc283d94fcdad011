"""Export: each format is opened by a third-party reader, and contains the recorded values."""

from __future__ import annotations

import contextlib
import csv
import importlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhdlink
import rhdlink.cli
import urlink
import urlink.cli
from linkcore.cli.progress import ProgressBar
from linkcore.recording.table_files import chosen, export
from rhdlink.host.plugins.turtle import Turtle
from urlink.arm.poses import compose, quaternion_to_rotvec

CAPTURE = Path(__file__).resolve().parents[3] / "captures" / "simulator-5.11.urlog"

# The first import of h5py starts the process `uname -p`. Import it before tests that must not start a process.
with contextlib.suppress(ImportError):
    importlib.import_module("h5py")


def reader(name: str) -> Any:
    """Import a package that reads a format; skip the test if it is not installed."""
    package = name.partition(".")[0]
    pytest.importorskip(package, reason=f"{package} is not installed; nox -f nightly.py -s data installs it")
    return importlib.import_module(name)


def read_mcap(path: Path) -> dict[str, list[Any]]:
    """Return the messages of each topic, as a reader of ROS 2 files decodes them."""
    with path.open("rb") as file:
        messages = reader("mcap.reader").make_reader(
            file, decoder_factories=[reader("mcap_ros2.decoder").DecoderFactory()]
        )
        found: dict[str, list[Any]] = {}
        for message in messages.iter_decoded_messages():
            found.setdefault(message.channel.topic, []).append(message)
    return found


@pytest.fixture
def recording() -> urlink.Recording:
    return urlink.load(CAPTURE)


def test_export_writes_csv(recording: urlink.Recording, tmp_path: Path) -> None:
    path = recording.export(tmp_path / "run.csv", ["q_actual", "robot_mode"])
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["t", "wall", *(f"q_actual_{number}" for number in range(6)), "robot_mode"]
    assert [[float(each) for each in row[2:8]] for row in rows[1:]] == recording.realtime["q_actual"].tolist()
    assert np.datetime64(rows[1][1].rstrip("Z")) == recording.realtime.wall[0]
    recording.export(path, ["q_actual"], rate=10)
    assert len(path.read_text().splitlines()) == 1 + len(recording.realtime.resampled(10))


def test_single_elements_are_exported(recording: urlink.Recording, tmp_path: Path) -> None:
    path = recording.export(tmp_path / "run.csv", ["q_actual_3", "time"])
    assert path.read_text().splitlines()[0] == "t,wall,q_actual_3,time"
    assert recording.realtime["q_actual_3"].tolist() == recording.realtime["q_actual"][:, 3].tolist()
    names = ["q_actual_5", "q_actual_6", "q_actual_x", "time_0"]
    assert [name in recording.realtime for name in names] == [True, False, False, False]


def test_single_field_is_exported(recording: urlink.Recording, tmp_path: Path) -> None:
    path = recording.export(tmp_path / "run.csv", "qd_actual")
    assert path.read_text().splitlines()[0].startswith("t,wall,qd_actual_0,")


def test_resampled_element_equals_resampled_field(recording: urlink.Recording) -> None:
    names = ["tool_vector_actual_4", "tool_vector_actual"]
    tables = [chosen(recording.tables, [name], rate=20)["realtime"] for name in names]
    assert list(tables[0].fields) == names[:1]
    assert tables[0][names[0]].tolist() == tables[1][names[1]][:, 4].tolist()


def test_export_writes_parquet(recording: urlink.Recording, tmp_path: Path) -> None:
    parquet = reader("pyarrow.parquet")
    table = parquet.read_table(recording.export(tmp_path / "run.parquet"))
    assert table.num_rows == len(recording.realtime)
    assert table["q_actual_3"].to_pylist() == recording.realtime["q_actual"][:, 3].tolist()
    assert table["robot_mode"].to_pylist() == recording.realtime["robot_mode"].tolist()
    assert table["wall"].cast("int64").to_pylist() == recording.realtime.wall.astype(int).tolist()
    assert table.schema.field("tcp_force_2").metadata[b"unit"] == b"N, Nm"


def test_export_writes_mat(recording: urlink.Recording, tmp_path: Path) -> None:
    scipy = reader("scipy.io")
    found = scipy.loadmat(recording.export(tmp_path / "run.mat"), simplify_cells=True)
    np.testing.assert_array_equal(found["realtime"]["q_actual"], recording.realtime["q_actual"])
    np.testing.assert_array_equal(found["realtime"]["t"], recording.realtime.time)
    np.testing.assert_array_equal(found["primary"]["joint_data_T_motor"], recording.primary["joint_data.T_motor"])


def test_export_writes_h5(recording: urlink.Recording, tmp_path: Path) -> None:
    h5py = reader("h5py")
    with h5py.File(recording.export(tmp_path / "run.h5", ["tcp_force", "joint_data.q_actual"])) as file:
        np.testing.assert_array_equal(file["realtime/tcp_force"], recording.realtime["tcp_force"])
        assert file["realtime/tcp_force"].attrs["unit"] == "N, Nm"
        assert sorted(file["realtime"]) == ["t", "tcp_force", "wall"]
        assert file["primary/joint_data.q_actual"].shape == recording.primary["joint_data.q_actual"].shape


def test_export_writes_mcap_for_ros(recording: urlink.Recording, tmp_path: Path) -> None:
    reader("mcap")
    found = read_mcap(recording.export(tmp_path / "run.mcap"))
    realtime = recording.realtime
    counts = Counter({topic: len(messages) for topic, messages in found.items()})
    each = dict.fromkeys(("/realtime", "/joint_states", "/tf", "/tcp_pose", "/tcp_speed", "/wrench"), len(realtime))
    robot_messages = recording.primary.of(urlink.packets.RobotMessage)
    assert counts == {**each, "/primary": len(recording.primary), "/log": len(robot_messages), "/robot_description": 1}
    types = {topic: messages[0].schema.name for topic, messages in found.items()}
    assert types["/joint_states"] == "sensor_msgs/msg/JointState"
    assert types["/tcp_pose"] == "geometry_msgs/msg/PoseStamped"
    assert types["/wrench"] == "geometry_msgs/msg/WrenchStamped"
    assert types["/log"] == "rcl_interfaces/msg/Log"
    states = [message.decoded_message for message in found["/joint_states"]]
    assert [list(state.position) for state in states] == realtime["q_actual"].tolist()
    assert [list(state.effort) for state in states] == realtime["I_actual"].tolist()
    assert states[0].name[0] == "shoulder_pan_joint"
    assert [message.message.log_time for message in found["/joint_states"]] == realtime.wall.astype(int).tolist()
    stamp = states[-1].header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == realtime.wall[-1].astype(int)
    pose = found["/tcp_pose"][-1].decoded_message.pose
    turn = pose.orientation
    assert [pose.position.x, pose.position.y, pose.position.z] == realtime["tool_vector_actual"][-1, :3].tolist()
    vector = quaternion_to_rotvec([turn.x, turn.y, turn.z, turn.w])
    np.testing.assert_allclose(vector, realtime["tool_vector_actual"][-1, 3:], atol=1e-9)
    # The chained frames of the links must end at the flange that the arm's own kinematics compute.
    reached, parent = np.zeros(6), "base_link"
    for link in found["/tf"][-1].decoded_message.transforms:
        assert link.header.frame_id == parent
        moved, turn = link.transform.translation, link.transform.rotation
        vector = quaternion_to_rotvec([turn.x, turn.y, turn.z, turn.w])
        reached, parent = compose(reached, [moved.x, moved.y, moved.z, *vector]), link.child_frame_id
    assert parent == "tool0"
    np.testing.assert_allclose(reached, recording.kinematics.forward(realtime["q_actual"][-1]), atol=1e-9)
    wrench = found["/wrench"][-1].decoded_message.wrench
    assert [wrench.force.z, wrench.torque.x] == realtime["tcp_force"][-1, 2:4].tolist()
    whole = found["/realtime"][-1].decoded_message
    assert list(whole.i_actual) == realtime["I_actual"][-1].tolist()
    assert (whole.robot_mode, whole.time) == (realtime["robot_mode"][-1], realtime["time"][-1])
    said = [message.decoded_message for message in found["/log"]]
    assert ("C153A0: Protective stop: position deviates from path", 40) in [(text.msg, text.level) for text in said]
    assert found["/robot_description"][0].decoded_message.data.startswith('<?xml version="1.0"?>\n<robot name="ur5e">')


def test_failed_export_keeps_existing_file(recording: urlink.Recording, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("precious")
    for fields, complaint in (
        (["q_actuel"], "did you mean q_actual"),
        (["q_actual", "joint_data.q_actual"], r"can hold only one table, but there are realtime, primary"),
    ):
        with pytest.raises(urlink.BadValue, match=complaint):
            recording.export(path, fields)
    with pytest.raises(urlink.BadValue, match=r"no format has the suffix '\.xls'; expected one of \.csv, \.parquet"):
        recording.export(tmp_path / "run.xls")

    def fail(unfinished: Path, *args: object) -> None:
        unfinished.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(urlink.BadRecording, match="No space left"):
        export(path, recording.tables, writers={".csv": fail})
    assert path.read_text() == "precious"
    assert [each.name for each in tmp_path.iterdir()] == ["run.csv"]
    with pytest.raises(urlink.BadRecording, match="cannot write"):
        recording.export(tmp_path / "nowhere" / "run.csv")


class Described:
    """Stand-in for a terminal that collects the descriptions of progress."""

    texts: list[str]

    def __init__(self, bar: ProgressBar) -> None:
        self.bar = bar

    def __setattr__(self, name: str, value: object) -> None:
        super().__setattr__(name, value)
        if isinstance(value, ProgressBar):
            self.texts.append(value.text)

    def open(self) -> None: ...

    def close(self) -> None: ...


@pytest.mark.real_time
def test_long_commands_describe_their_progress(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("linkcore.cli.progress._Screen", Described)
    Described.texts = []
    drive = tmp_path / "drive.urlog"
    with (
        rhdlink.Host([Turtle()], port=0, pacing="lockstep") as host,
        rhdlink.connect(host.address, record=drive) as robot,
    ):
        robot.sync()
        recorded = ["record", host.address, str(tmp_path / "again.urlog"), "--count", "9", "--duration", "20"]
        # In lockstep, the other client has to sync too.
        with robot.background():
            assert rhdlink.cli.main(recorded) == 0
    commands: tuple[tuple[Callable[[Sequence[str]], int], list[str], str], ...] = (
        (rhdlink.cli.main, [], "connecting recording, recording reading"),
        (urlink.cli.main, ["replay", str(CAPTURE)], "reading"),
        (urlink.cli.main, ["replay", str(CAPTURE), "--rate", "max", "--count", "9"], "reading playing waiting 9"),
        (urlink.cli.main, ["dissect", str(CAPTURE), "--count", "3"], "dissecting"),
        (urlink.cli.main, ["export", str(CAPTURE), str(tmp_path / "run.csv"), "tcp_force"], "reading writing"),
        (urlink.cli.main, ["info", f"replay://{CAPTURE}"], "connecting reading"),
        (rhdlink.cli.main, ["replay", str(drive)], "reading"),
        (rhdlink.cli.main, ["export", str(drive), str(tmp_path / "drive.csv")], "reading writing"),
        (rhdlink.cli.main, ["dissect", str(drive)], "dissecting"),
    )
    for main, words, described in commands:
        assert not words or main(words) == 0
        assert set(described.split()) <= {text.split()[0] for text in Described.texts}, words
        capsys.readouterr()
        Described.texts = []
        assert not words or main([*words[:1], "--quiet", *words[1:]]) == 0
        assert (Described.texts, capsys.readouterr().err) == ([], "")


@pytest.mark.real_time
def test_export_command_writes_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.csv"
    assert urlink.cli.main(["export", str(CAPTURE), str(path), "--rate", "20", "tcp_force"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{path}: ")
    assert err == ""
    assert path.read_text().startswith("t,wall,tcp_force_0")
    assert urlink.cli.main(["export", str(CAPTURE), str(path), "nothing"]) == 1
    assert "has no field 'nothing'" in capsys.readouterr().err
    assert urlink.cli.main(["export", str(CAPTURE), str(path), "--rate", "0"]) == 2
    capsys.readouterr()
    with (
        rhdlink.Host([Turtle()], port=0, pacing="lockstep") as host,
        rhdlink.connect(host.address, record=tmp_path / "drive.urlog") as robot,
    ):
        robot.sync()
    drive = tmp_path / "drive.csv"
    assert rhdlink.cli.main(["export", str(tmp_path / "drive.urlog"), str(drive)]) == 0
    assert "2 batches" in capsys.readouterr().out
    assert len(drive.read_text().splitlines()) == 3
    reader("mcap")
    assert rhdlink.cli.main(["export", str(tmp_path / "drive.urlog"), str(tmp_path / "drive.mcap")]) == 0
    table = rhdlink.load(tmp_path / "drive.urlog")
    batches = read_mcap(tmp_path / "drive.mcap")["/rhd"]
    assert [batch.schema.name for batch in batches] == ["recorded_msgs/msg/Rhd"] * 2
    assert [batch.message.log_time for batch in batches] == table.wall.astype(int).tolist()
    assert [batch.decoded_message.transpos for batch in batches] == table["transpos"].tolist()
    assert table.export(drive, ["transpos"]).read_text().startswith("t,wall,transpos\n")


def test_exported_file_names_its_robot(recording: urlink.Recording, tmp_path: Path) -> None:
    start = f"{recording.realtime.wall[0] - np.timedelta64(round(recording.realtime.time[0] * 1e9), 'ns')}Z"
    said: dict[str, dict[str, str]] = {}
    for suffix, package in (
        (".parquet", "pyarrow.parquet"),
        (".h5", "h5py"),
        (".mat", "scipy.io"),
        (".mcap", "mcap.reader"),
    ):
        read = reader(package)
        path = recording.export(tmp_path / f"run{suffix}", ["q_actual"])
        if suffix == ".parquet":
            about = read.read_schema(path).metadata
            said[suffix] = {key.decode(): value.decode() for key, value in about.items()}
        elif suffix == ".h5":
            with read.File(path) as file:
                said[suffix] = dict(file.attrs)
        elif suffix == ".mat":
            about = read.loadmat(path, simplify_cells=True)["about"]
            said[suffix] = {key: str(value) for key, value in about.items()}
        else:
            with path.open("rb") as file:
                (about,) = (
                    each.metadata for each in read.make_reader(file).iter_metadata() if each.name == "recording"
                )
            said[suffix] = dict(about)
    for suffix, about in said.items():
        assert (about["robot"], about["firmware"]) == (recording.model, str(recording.firmware)), suffix
        assert abs(np.datetime64(about["start"].rstrip("Z")) - np.datetime64(start.rstrip("Z"))) < np.timedelta64(
            1, "ms"
        )
        assert "monotonic clock" in about["clock"]
