"""`rhdlink mission`: scripts on a turtle and on a host, checks, and the port for clients of MRC."""

from __future__ import annotations

import re
import signal
import socket
from pathlib import Path

import pytest

from rhdlink import Host
from rhdlink.host.plugins.turtle import Turtle
from tests.spawning import interrupt
from tests.waiting import until

from .conftest import Run, Spawn

pytestmark = pytest.mark.simulated_time

MISSIONS = Path(__file__).parents[3] / "examples" / "missions"


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "way.smr"
    path.write_text('fwd 0.2\nturn 90\nputevent "corner"\nprint "there"\neval 1 ; 2\n', newline="\n")
    return path


def ended(err: str) -> tuple[float, ...]:
    """Return the final pose of the turtle: m, m, degrees."""
    found = re.search(r"ended at x (.*) m, y (.*) m, heading (.*) deg", err)
    assert found is not None, err
    return tuple(map(float, found.groups()))


@pytest.mark.parametrize("kind", [[], ["velocity"], ["smr"]])
def test_mission_runs_on_a_turtle(run: Run, script: Path, kind: list[str]) -> None:
    status, out, err = run("mission", str(script), "--turtle", *kind)
    assert (status, out) == (0, "there\n1.000000  2.000000  \n")
    assert ended(err) == pytest.approx((5.7, 5.5, 90.0), abs=0.6)
    assert "rhdlink: userevent corner\n" in err


def test_trace_prints_each_line(run: Run, script: Path) -> None:
    _, _, err = run("mission", str(script), "--turtle", "--trace")
    lines = [line for line in err.splitlines() if line.startswith("rhdlink: line")]
    assert lines[:2] == ["rhdlink: line 1: fwd 0.2", "rhdlink: line 2: turn 90"]
    assert len(lines) == 5


def test_mrc_profile_prints_the_output_of_mrc(run: Run, script: Path) -> None:
    status, out, _ = run("mission", str(script), "--turtle", "--profile", "mrc")
    assert status == 0
    assert out.startswith("Line no   1:   fwd 0.2\n \nLine no   2:   turn 90\n \n")
    assert out.endswith("Line no   5:   eval 1 ; 2\n \n1.000000  2.000000  \n")


@pytest.mark.slow
def test_svg_of_the_path_is_reproducible(run: Run, tmp_path: Path) -> None:
    """The drawing includes the tape and walls on the floor."""
    pictures = [tmp_path / "first.svg", tmp_path / "second.svg"]
    floor = ("--floor", str(MISSIONS / "floor.svg"), "--start", "1.5,2,0")
    for picture in pictures:
        status, _, _ = run("mission", str(MISSIONS / "arc.smr"), "--turtle", *floor, "--svg", str(picture))
        assert status == 0
    first, second = (picture.read_text() for picture in pictures)
    assert first == second
    assert first.count("<polyline") >= 3  # the tape, the walls, the path


def test_failing_mission_reports_line_and_column(run: Run, script: Path) -> None:
    script.write_text('fwd 0.1\n  array "a" 2\n  a[5] = 1\n')
    status, out, err = run("mission", str(script), "--turtle")
    assert (status, out) == (1, "")
    assert err.splitlines()[-1].startswith("rhdlink: line 3, column 3 (a[5] = 1): index 5 is beyond a")


def test_check_reports_the_errors_of_a_script(run: Run, script: Path) -> None:
    assert run("mission", "--check", str(script)) == (0, "", "rhdlink: way.smr: no mistakes found\n")
    script.write_text("fwd 1 2\nfwd x\n")
    status, out, _ = run("mission", "--check", str(script))
    assert status == 1
    assert out.splitlines() == [
        "way.smr: line 1, column 1: fwd takes 1 parameter, not 2",
        "way.smr: line 2, column 5: nothing in the script makes the variable x",
    ]
    status, out, err = run("mission", str(script), "--turtle")
    assert (status, out) == (1, "")
    assert "line 2, column 5" in err
    assert "ended at" not in err  # the mission has not started


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["gone.smr", "--turtle"], 1, "gone.smr: No such file"),
        (["--turtle"], 2, "no script was given"),
        (["{script}", "--serve"], 2, "takes commands from clients"),
        (["{script}", "--robot", "localhost:1"], 1, "localhost:1"),
        (["{script}", "--svg", "x.svg"], 2, "need --turtle"),
        (["{script}", "--turtle", "--svg", "x.gif"], 1, "unknown suffix of x.gif; expected .svg or .png"),
        (["{script}", "--turtle", "--floor", "none.svg"], 1, "none.svg: No such file"),
        (["{script}", "--turtle", "--start", "1,2"], 2, "expected X,Y,DEG"),
        (["{script}", "--turtle", "--conf", "none.conf"], 1, "none.conf: No such file"),
    ],
)
def test_invalid_arguments_are_reported(run: Run, script: Path, arguments: list[str], status: int, said: str) -> None:
    given = [argument.format(script=script) for argument in arguments]
    found, out, err = run("mission", *given)
    assert (found, out) == (status, "")
    assert said in err
    assert "Traceback" not in err


def test_log_is_written_to_its_folder(run: Run, script: Path, tmp_path: Path) -> None:
    script.write_text('log "$odox"\nfwd 0.05\ncontrol "savelog" "first"\n')
    assert run("mission", str(script), "--turtle", "--log-folder", str(tmp_path))[0] == 0
    first, rest = ((tmp_path / name).read_text().split() for name in ("first", "log"))
    assert float(first[-1]) == pytest.approx(0.05, abs=0.01)
    assert rest[: len(first)] == first


@pytest.mark.real_time
def test_mission_runs_on_a_robot_until_interrupted(spawn: Spawn, script: Path) -> None:
    robot = Turtle()
    script.write_text('label "on"\nturn 90\ngoto "on"\n')
    with Host([robot], port=0) as host:
        process = spawn("mission", str(script), "--robot", host.address)
        until(lambda: robot.world.odometry.theta > 0.2)
        interrupt(process)
        _, err = process.communicate(timeout=20)
        assert process.returncode == 130
        assert "Traceback" not in err
        until(lambda: robot.cmdtransvel == robot.cmdrotvel == 0)


@pytest.mark.slow
@pytest.mark.real_time
def test_control_characters_of_clients_are_escaped(spawn: Spawn) -> None:
    process = spawn("mission", "--serve", "--turtle", "--port", "0", "--profile", "mrc")
    assert process.stdout is not None
    host, _, port = process.stdout.readline().strip().rpartition(":")
    with socket.create_connection((host, int(port)), timeout=20) as client, client.makefile("r") as lines:
        client.sendall(b'stringcat "\x1b[2J"\nexit\n')
        assert lines.readline() == "ID1 queued\n"
        assert lines.readline() == "ok\n"
        out, err = process.communicate(timeout=20)
    assert process.returncode == 0
    assert "\x1b" not in out + err
    assert "stringcat" in out


@pytest.mark.slow
@pytest.mark.real_time
def test_mission_serves_clients_of_mrc(spawn: Spawn) -> None:
    process = spawn("mission", "--serve", "--turtle", "--port", "0")
    assert process.stdout is not None
    host, _, port = process.stdout.readline().strip().rpartition(":")
    with socket.create_connection((host, int(port)), timeout=20) as client, client.makefile("r") as lines:
        client.sendall(b"fwd 0.1\n")
        assert lines.readline() == "ID1 queued\n"
        client.sendall(b"getevent 10\n")
        assert lines.readline() == "ID1 started\n"
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=20)
    assert process.returncode == 143
    assert "Traceback" not in err
