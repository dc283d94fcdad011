from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from urlink import Taught
from urlink.motion.points.point_file import PointFile
from urlink.simulator import Controller, Still

from .conftest import Run


@pytest.mark.slow
@pytest.mark.real_time
def test_teach_saves_waypoints_and_plays_them(
    spawn: Callable[..., subprocess.Popen[str]], run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "taught.json"
    with Controller("UR5e", "5.11", motion=Still()) as controller:
        process = spawn("teach", controller.address, str(file), stdin=subprocess.PIPE)
        out, _ = process.communicate("\n\n\nu\nwhat\nq\n", timeout=40)
        assert process.returncode == 0
        lines = out.splitlines()
        assert lines[0] == "move the arm; Enter saves a waypoint, q ends"
        assert [line.split(":")[0] for line in lines[1:4]] == ["q"] * 3
        assert lines[4:] == [
            "2 waypoints",
            "Enter saves a waypoint, u deletes the last one, q ends",
            f"2 waypoints in {file}",
        ]
        taught = Taught.load(file)
        assert (len(taught), taught.model) == (2, "UR5e")
        status, out, err = run("teach", controller.address, str(file), "--play", "--speed", "1")
        assert (status, err) == (0, "")
        assert out.splitlines()[-1] == "done"
        with Path("/dev/null").open() as nothing:
            monkeypatch.setattr(sys, "stdin", nothing)
            status, _, err = run("teach", controller.address, str(file))
        assert status == 1
        assert "no waypoint was taught, so nothing was saved" in err
    assert Taught.load(file).points


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["none.json", "--play"], 1, "cannot read none.json"),
        (["a.json", "--axes", "12"], 2, "'12' is not six digits 0 or 1"),
        (["a.json", "--digital-input", "9"], 1, "standard digital input"),
    ],
)
@pytest.mark.real_time
def test_teach_rejects_invalid_arguments(run: Run, arguments: list[str], status: int, text: str) -> None:
    found, _, err = run("teach", "sim://", *arguments)
    assert found == status
    assert text in err


@pytest.mark.slow
@pytest.mark.real_time
def test_teach_point_saves_one_point_by_name(
    spawn: Callable[..., subprocess.Popen[str]], run: Run, tmp_path: Path
) -> None:
    file = tmp_path / "cell.json"
    with Controller("UR5e", "5.11", motion=Still()) as controller:
        process = spawn("teach", controller.address, str(file), "--point", "bin", stdin=subprocess.PIPE)
        out, _ = process.communicate("what\n\n", timeout=40)
        assert process.returncode == 0
        lines = out.splitlines()
        assert lines[:2] == ["move the arm; Enter saves the point, q ends", "Enter saves the point, q ends"]
        assert lines[2].startswith(f"bin in {file}: q")
        point = PointFile(file).point("bin")
        assert point.model == "UR5e"
        status, _, err = run("teach", controller.address, str(file), "--point", "bin")
        assert status == 1
        assert "already has a point 'bin'; add --replace to replace it" in err
        process = spawn("teach", controller.address, str(file), "--point", "bin", "--replace", stdin=subprocess.PIPE)
        assert process.communicate("\n", timeout=40)[0].splitlines()[1].startswith("bin in ")
        process = spawn("teach", controller.address, str(file), "--point", "new", stdin=subprocess.PIPE)
        process.communicate("q\n", timeout=40)
        assert process.returncode == 1
    assert list(PointFile(file).read()) == ["bin"]


@pytest.mark.parametrize("more", [["--button"], ["--digital-input", "0"], ["--play"]])
@pytest.mark.real_time
def test_teach_point_refuses_options_of_waypoints(run: Run, more: list[str]) -> None:
    status, _, err = run("teach", "sim://", "cell.json", "--point", "bin", *more)
    assert status == 2
    assert "--point" in err
