"""Waypoints of program files of PolyScope."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest

import urlink
from linkcore.errors import BadValue
from urlink.arm.kinematics import Arm
from urlink.arm.models import model
from urlink.motion.points import program_file
from urlink.motion.points.program_file import read_waypoints

# A waypoint that a UR10e has saved, and the pose that PolyScope wrote into the script of the same program. The numbers
# are from notes.md of the public repository pharmbio/robotlab.
Q = "1.9942498207092285, -1.6684614620604457, 1.9330504576312464, -0.2718423169902344, 1.3209004402160645, "
Q += "0.0036344528198242188"
KINEMATICS = {
    "deltaTheta": "-8.844411260213857E-8, -0.032582961261549755, -0.8772929446404238, 0.9098787703504071, "
    "2.101429764675086E-6, -1.9523604853220917E-7",
    "a": "1.2280920183406098E-4, -0.6118328650166482, -0.35064142434212725, 6.353071874199852E-5, "
    "-8.491717228743712E-5, 0.0",
    "d": "0.18107019996630838, -11.986107840354439, 254.02185121292118, -241.86139249326118, 0.11978728860232488, "
    "0.11569307278026907",
    "alpha": "1.570573614624119, 0.0016638537326948237, -0.0018631164519257151, 1.5706607381785331, "
    "-1.5704473543987978, 0.0",
}
POSE = [0.433025361705, -0.467959205379, 0.522310714714, 1.500318891221, 0.521427297251, 0.530987104689]
ZEROS = "0, 0, 0, 0, 0, 0"


def waypoint(
    name: str = "above",
    q: str = Q,
    tcp: str = ZEROS,
    table: dict[str, str] | None = None,
    kind: str = "Fixed",
) -> str:
    rows = "".join(f'<{key} value="{value}"/>' for key, value in (KINEMATICS if table is None else table).items())
    kinematics = f'<Kinematics status="LINEARIZED">{rows}</Kinematics>' if rows else ""
    return (
        f'<Waypoint type="{kind}" name="{name}"><motionParameters/><position><JointAngles angles="{q}"/>'
        f'<TCPOffset pose="{tcp}"/>{kinematics}</position></Waypoint>'
    )


def saved(folder: Path, *waypoints: str) -> Path:
    """Write a program with these waypoints, with the date of 1 March 2026."""
    moves = "".join(f'<Move motionType="MoveJ"><children>{each}</children></Move>' for each in waypoints)
    main = f"<MainProgram><children>{moves}</children></MainProgram>"
    text = f'<URProgram name="pick"><children>{main}</children></URProgram>'
    return packed(folder, gzip.compress(text.encode()))


def packed(folder: Path, data: bytes) -> Path:
    path = folder / "pick.urp"
    path.write_bytes(data)
    os.utime(path, (1772366400, 1772366400))
    return path


def test_waypoint_of_a_real_robot_has_the_pose_of_its_script(tmp_path: Path) -> None:
    points = read_waypoints(saved(tmp_path, waypoint()), model("UR10e"))
    assert list(points) == ["above"]
    point = points["above"]
    assert point.pose == pytest.approx(POSE, abs=1e-11)
    assert point.q.tolist() == [float(each) for each in Q.split(",")]
    assert point.tcp.tolist() == [0.0] * 6
    assert (point.model, point.date.isoformat()) == ("UR10e", "2026-03-01T12:00:00+00:00")


@pytest.mark.parametrize("table", [{}, dict.fromkeys(KINEMATICS, ZEROS)])
def test_waypoint_without_kinematics_has_the_published_pose(tmp_path: Path, table: dict[str, str]) -> None:
    path = saved(tmp_path, waypoint(q="0, -1.5, 1.5, 0, 1, 0", tcp="0, 0, 0.12, 0, 0, 0", table=table))
    point = read_waypoints(path, model("UR5e"))["above"]
    assert point.pose == pytest.approx(Arm("UR5e").forward([0, -1.5, 1.5, 0, 1, 0], [0, 0, 0.12, 0, 0, 0]))
    assert point.tcp.tolist() == [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]


def test_only_fixed_waypoints_are_read_in_their_order(tmp_path: Path) -> None:
    names = ["b", "a", "b"]
    others = [waypoint("v", kind="Variable"), '<Waypoint type="Relative" name="r"/>']
    points = read_waypoints(saved(tmp_path, *map(waypoint, names), *others), model("UR10e"))
    assert list(points) == ["b", "a"]


@pytest.mark.parametrize(
    ("waypoints", "message"),
    [
        ([], "the program has no fixed waypoint"),
        ([waypoint(kind="Variable")], "the program has no fixed waypoint"),
        ([waypoint(""), waypoint()], "waypoint '': point name ''; expected"),
        ([waypoint(), waypoint(q=ZEROS)], "two different waypoints are called 'above'"),
        ([waypoint(q="1, 2")], r"waypoint 'above': JointAngles has the shape \(2,\); expected six numbers"),
        ([waypoint(q="a, b")], "waypoint 'above': JointAngles is 'a, b'; expected six numbers"),
        ([waypoint(tcp="0, 0, 80, 0, 0, 0")], "waypoint 'above': the position in TCPOffset"),
        ([waypoint(table={"a": ZEROS})], "waypoint 'above': Kinematics has no deltaTheta with 'value'"),
        (
            ['<Waypoint type="Fixed" name="old"><position joints="0, 0, 0, 0, 0, 0"/></Waypoint>', waypoint()],
            "a waypoint has no JointAngles",
        ),
    ],
)
def test_unusable_waypoint_is_refused(tmp_path: Path, waypoints: list[str], message: str) -> None:
    with pytest.raises(BadValue, match=f"pick.urp: {message}"):
        read_waypoints(saved(tmp_path, *waypoints), model("UR10e"))


def test_program_of_another_arm_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match=r"pick\.urp: waypoint 'above': "):
        read_waypoints(saved(tmp_path, waypoint()), model("UR5e"))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"<URProgram/>", "not compressed with gzip"),
        (b"", "the compressed data is cut off"),
        (gzip.compress(b"<URProgram/>")[:-9], "the compressed data is cut off"),
        (gzip.compress(b"<URProgram>"), "not a valid XML file"),
        (gzip.compress(b'<?xml version="1.0" encoding="no"?><a/>'), "not a valid XML file"),
        (gzip.compress(b"<Other/>"), "the first element is 'Other'; expected the URProgram"),
        (gzip.compress(b'<!DOCTYPE a [<!ENTITY b "c">]><URProgram>&b;</URProgram>'), "has a document type"),
    ],
    # Compressed data contains the time, so pytest would give other names to the cases in each process.
    ids=["plain", "empty", "cut off", "not closed", "unknown encoding", "other element", "document type"],
)
def test_other_file_is_refused(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(BadValue, match=f"pick.urp: .*{message}"):
        read_waypoints(packed(tmp_path, data), model("UR10e"))


def test_too_large_program_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path, waypoint())
    monkeypatch.setattr(program_file, "_LARGEST", 100)
    with pytest.raises(BadValue, match="or larger than"):
        read_waypoints(path, model("UR10e"))


def test_missing_program_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match=r"cannot read .*none\.urp: No such file"):
        read_waypoints(tmp_path / "none.urp", model("UR10e"))


@pytest.mark.simulated_time
def test_robot_imports_a_program_of_its_model(tmp_path: Path) -> None:
    with urlink.connect("sim://ur10e", points=tmp_path / "cell.json") as robot:
        imported = robot.points.import_program(saved(tmp_path, waypoint("bin"), waypoint("home")))
        assert dict(robot.points) == imported
        assert list(imported) == ["bin", "home"]
        with pytest.raises(BadValue, match="already has a point 'bin'"):
            robot.points.import_program(saved(tmp_path, waypoint("new"), waypoint("bin")))
        assert list(robot.points) == ["bin", "home"]
        robot.points.import_program(saved(tmp_path, waypoint("bin")), replace=True)
    with urlink.connect("sim://ur5e", points=tmp_path / "cell.json") as robot, pytest.raises(BadValue):
        robot.points.import_program(saved(tmp_path, waypoint("new")))
