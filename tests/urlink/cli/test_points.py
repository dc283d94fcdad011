"""`urlink points`: list, show, check, remove and import."""

from __future__ import annotations

import gzip
import json
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest

from urlink import Point
from urlink.arm.kinematics import Arm
from urlink.motion.points.point_file import PointFile

from .conftest import Run

Q = np.array([0.0, -1.5, 2.0, -2.0, -1.5, 0.0])
DATE = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)


def taught(tcp: float = 0.0, model: str = "UR5e") -> Point:
    offset = np.array([0.0, 0.0, tcp, 0.0, 0.0, 0.0])
    return Point(Q, Arm("UR5e").forward(Q, offset), offset, model, DATE)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "cell.json"
    PointFile(path).add({"above bin": taught(), "old": taught(0.1)}, replace=False)
    return path


def test_list_prints_a_line_for_each_point(run: Run, file: Path) -> None:
    status, out, err = run("points", "list", str(file))
    assert (status, err) == (0, "")
    assert out.splitlines() == ["above bin: UR5e, 2026-03-01 12:00 UTC", "old: UR5e, 2026-03-01 12:00 UTC"]
    status, out, _ = run("points", "list", str(file), "--json")
    lines = [json.loads(line) for line in out.splitlines()]
    assert [line["name"] for line in lines] == ["above bin", "old"]
    assert lines[0]["q"] == Q.tolist()


def test_show_prints_the_values_of_a_point(run: Run, file: Path) -> None:
    status, out, _ = run("points", "show", str(file), "old")
    assert status == 0
    assert out.splitlines()[:4] == [
        "old",
        "  model: UR5e",
        "  date: 2026-03-01T12:00:00+00:00",
        "  q: 0.000000 -1.500000 2.000000 -2.000000 -1.500000 0.000000",
    ]
    status, out, _ = run("points", "show", str(file), "old", "--json")
    assert json.loads(out)["tcp"][2] == 0.1


@pytest.mark.real_time
def test_check_reports_points_and_exits_with_1_if_unreachable(run: Run, file: Path) -> None:
    status, out, _ = run("points", "check", str(file), "sim://ur5e")
    assert status == 0
    lines = out.splitlines()
    assert lines[0] == "above bin: reachable, TCP unchanged"
    assert lines[1].startswith("old: reachable, TCP changed by 100.0 mm and 0.0 degrees, largest joint motion")
    PointFile(file).add({"other": taught(model="UR3e")}, replace=False)
    status, out, _ = run("points", "check", str(file), "sim://ur5e")
    assert status == 1
    assert out.splitlines()[2] == "other: refused, the point was taught on a UR3e, but this arm is a UR5e"
    status, out, _ = run("points", "check", str(file), "sim://ur5e", "old", "--json")
    assert status == 0
    (line,) = (json.loads(line) for line in out.splitlines())
    assert (line["name"], line["verdict"]) == ("old", "reachable")
    assert line["tcp_moved"] == pytest.approx(0.1)


def test_remove_deletes_points(run: Run, file: Path) -> None:
    status, out, _ = run("points", "remove", str(file), "old")
    assert (status, out) == (0, "removed old\n")
    assert list(PointFile(file).read()) == ["above bin"]


def test_import_adds_the_waypoints_of_a_program(run: Run, file: Path, tmp_path: Path) -> None:
    program = tmp_path / "pick.urp"
    position = (
        '<position><JointAngles angles="0, -1.5, 2, -2, -1.5, 0"/><TCPOffset pose="0, 0, 0, 0, 0, 0"/></position>'
    )
    text = f'<URProgram><Waypoint type="Fixed" name="old">{position}</Waypoint></URProgram>'
    program.write_bytes(gzip.compress(text.encode()))
    status, _, err = run("points", "import", str(file), str(program), "--model", "ur5e")
    assert status == 1
    assert "already has a point 'old'" in err
    status, out, _ = run("points", "import", str(file), str(program), "--model", "ur5e", "--replace")
    assert (status, out) == (0, "imported old\n")
    assert PointFile(file).point("old").pose == pytest.approx(taught().pose)


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["list", "none.json"], 1, "none.json does not exist"),
        (["list", "FILE", "bin"], 2, "list takes only FILE"),
        (["show", "FILE"], 2, "show needs the names of points"),
        (["show", "FILE", "bin"], 1, "has no point 'bin'"),
        (["remove", "FILE"], 2, "remove needs the names of points"),
        (["remove", "FILE", "old", "bin"], 1, "has no point 'bin'"),
        (["check", "FILE"], 2, "check needs the address of a robot"),
        (["check", "FILE", "sim://", "bin"], 1, "has no point 'bin'"),
        (["import", "FILE", "pick.urp"], 2, "import needs one program (.urp) and --model ARM"),
        (["import", "FILE", "--model", "UR5e"], 2, "import needs one program"),
        (["import", "FILE", "pick.urp", "--model", "UR5f"], 1, "UR5f"),
        (["import", "FILE", "none.urp", "--model", "UR5e"], 1, "cannot read none.urp"),
        (["move", "FILE"], 2, "invalid choice: 'move'"),
    ],
)
def test_points_refuses_invalid_arguments(run: Run, file: Path, arguments: list[str], status: int, text: str) -> None:
    found, _, err = run("points", *(str(file) if each == "FILE" else each for each in arguments))
    assert found == status
    assert text in err
    assert list(PointFile(file).read()) == ["above bin", "old"]
