"""Run each program in examples/ as a user would run it, and check that the commands in the documents exist.

Most examples run in simulated time in this process. One example of each kind runs in its own process.
"""

import ast
import contextlib
import csv
import io
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

import rhdlink.cli
import urlink.cli
from tests.mosquitto import needs_broker

pytestmark = pytest.mark.simulated_time

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
#: Time limit for an example, in s. On an idle processor, an example takes one or two seconds.
PATIENCE = 200.0
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def run(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run an example in this process; return its output and its exit status."""
    command = [str(EXAMPLES / name), *arguments]
    code: object = 0
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as errors,
    ):
        patch.setattr(sys, "argv", command)
        try:
            runpy.run_path(command[0], run_name="__main__")
        except SystemExit as ended:
            code = ended.code or 0
        except Exception:
            traceback.print_exc()
            code = 1
    assert isinstance(code, int)
    return subprocess.CompletedProcess(command, code, out.getvalue(), errors.getvalue())


def run_process(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(EXAMPLES / name), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


def output(name: str, *arguments: str) -> str:
    return checked(run(name, *arguments))


def checked(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


@pytest.mark.real_time
def test_print_state_prints_robot_and_states() -> None:
    lines = checked(run_process("print_state.py", "sim://ur10?firmware=3.4", "--duration", "0.7")).splitlines()
    assert lines[0] == "UR10, firmware 3.4"
    assert lines[1].endswith("rad  RUNNING")
    assert lines[-1].endswith("states received")


def test_print_state_prints_question_mark_without_robot_mode() -> None:
    lines = output("print_state.py", "sim://ur5?firmware=1.5", "--duration", "0.3").splitlines()
    assert lines[1].endswith("rad  ?")


@pytest.mark.real_time
def test_watch_safety_prints_modes_and_messages() -> None:
    """Read until all expected lines were printed; after a reconnection, the example prints the mode again."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / "watch_safety.py"), "--demonstrate", "--duration", "40"]
    modes, printed = ["NORMAL"], ""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        for line in process.stdout:
            printed += line
            _, _, mode = line.rstrip().partition("safety mode: ")
            if mode and mode != modes[-1]:
                modes.append(mode)
            if len(modes) == 3 and "code=153" in printed:
                break
        process.kill()
        assert process.stderr.read() == ""
    assert modes == ["NORMAL", "PROTECTIVE_STOP", "NORMAL"]
    assert " connected\n" in printed
    assert "code=153" in printed


@pytest.mark.slow
def test_press_and_teach_presses_records_and_plays() -> None:
    lines = output("press_and_teach.py").splitlines()
    assert lines[0].startswith("the table is at z = ")
    assert lines[1] == "pressed with 10 N"
    assert lines[2:] == ["recorded a waypoint", "recorded a waypoint", "played"]


@pytest.mark.slow
def test_soft_press_presses_and_releases() -> None:
    assert output("soft_press.py").splitlines() == ["presses softly", "released"]


def shown(cell: dict[str, Any], names: dict[str, Any]) -> list[str]:
    """Run a cell as a kernel does; return the representations of its last value that a notebook would show."""
    *statements, last = ast.parse("".join(cell["source"])).body
    exec(compile(ast.Module(statements, []), "cell", "exec"), names)
    if not isinstance(last, ast.Expr):
        exec(compile(ast.Module([last], []), "cell", "exec"), names)
        return []
    value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    return [
        f"{type(value).__name__} {show} {len(getattr(value, show)()) > 100}"
        for show in ("_repr_html_", "_repr_png_")
        if hasattr(value, show)
    ]


@pytest.mark.slow
def test_notebook_cells_show_their_last_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("MPLBACKEND", "agg")
    cells = json.loads((EXAMPLES / "notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    assert [line for cell in cells if cell["cell_type"] == "code" for line in shown(cell, names)] == [
        "Robot _repr_html_ True",
        "RealtimeState _repr_html_ True",
        "Motion _repr_html_ True",
        "Recording _repr_html_ True",
        "Plot _repr_png_ True",
    ]


def test_rtde_cell_prints_increasing_numbers() -> None:
    lines = output("rtde_cell.py", "--count", "5").splitlines()
    counted = [int(line.rpartition(" ")[2]) for line in lines]
    assert len(counted) == 5
    assert counted == sorted(counted)
    assert counted[-1] > counted[0]


def test_log_to_csv_writes_a_row_for_each_state(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    text = output("log_to_csv.py", str(file), "--duration", "0.5")
    with file.open(newline="") as lines:
        head, *rows = csv.reader(lines)
    assert head[:3] == ["wall", "time", "q0"]
    assert all(len(row) == len(head) for row in rows)
    assert text == f"{len(rows)} states written, 0 dropped, 0 failed\n"
    assert len(rows) > 10


def test_closed_loop_monitor_passes_within_limits() -> None:
    assert output("closed_loop_monitor.py", "--duration", "0.5", "--deadline", "5").endswith("all within limits\n")


def test_closed_loop_monitor_fails_beyond_limits() -> None:
    done = run("closed_loop_monitor.py", "--duration", "10", "--deadline", "5", "--speed", "0.1")
    assert done.returncode == 1
    assert "a joint moves at" in done.stdout


@pytest.mark.slow
def test_named_points_moves_with_another_tool() -> None:
    assert output("named_points.py").splitlines() == [
        "at_part: reachable, TCP changed by 30 mm",
        "above_part: reachable, TCP changed by 30 mm",
        "refused without keep",
        "the new TCP is at the part",
    ]


def test_two_robots_prints_both_robots() -> None:
    lines = output("two_robots.py", "--duration", "1").splitlines()
    assert {line.partition(": ")[0] for line in lines} == {"sim://ur5e", "sim://ur10?firmware=3.4"}
    assert all("tool at" in line and line.endswith("0 reconnects") for line in lines[-2:])


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.parametrize(("name", "passed"), [("test_your_own_program.py", 7), ("simulated_cell.py", 3)])
def test_example_tests_pass_without_plugins_of_this_project(name: str, passed: int) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"examples/{name}"]
    env = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(
        command, cwd=EXAMPLES.parent, env=env, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 0, done.stdout
    assert f"{passed} passed" in done.stdout


def test_move_and_wait_returns_home() -> None:
    home, higher, again = output("move_and_wait.py", "--speed", "1").splitlines()
    assert home == "at home"
    assert higher.startswith("5 cm higher")
    assert again.startswith("at home again")


@pytest.mark.parametrize("options", [(), ("--low-bandwidth",)])
def test_follow_csv_follows_the_file(tmp_path: Path, options: tuple[str, ...]) -> None:
    rows = ["time,q0,q1,q2,q3,q4,q5", "0,0,-1.57,1.57,-1.57,-1.57,0", "0.5,0,-1.57,1.57,-1.57,-1.57,0.2"]
    file = tmp_path / "turn.csv"
    file.write_text("\n".join(rows) + "\n")
    followed, furthest = output("follow_csv.py", "--file", str(file), *options).splitlines()
    assert followed == "followed 2 points in 0.5 s"
    assert len(furthest.partition(":")[2].split()) == 6


def test_follow_csv_rejects_missing_file(tmp_path: Path) -> None:
    done = run("follow_csv.py", "--file", str(tmp_path / "nothing.csv"))
    assert done.returncode == 1
    assert done.stderr.startswith("BadValue: ")


def test_servo_loop_prints_statistics() -> None:
    first, second = output("servo_loop.py", "--duration", "0.5").splitlines()
    assert re.fullmatch(r"\d+ set-points, every \d+\.\d{3} ms, \d+ late", first)
    assert second.startswith("off by less than")


@pytest.mark.slow
def test_policy_chunks_never_starves() -> None:
    text = output("policy_chunks.py", "--duration", "1.5")
    assert re.fullmatch(r"\d+ chunks in 1\.5 s, starved 0 times\n", text)


def test_umi_schedule_prints_numbers_of_poses() -> None:
    text = output("umi_schedule.py", "--duration", "0.6")
    assert re.fullmatch(r"\d+ poses scheduled, \d+ of them too late; \d+ states seen at last\n", text)


def test_gello_servo_keeps_speed_limit() -> None:
    text = output("gello_servo.py", "--duration", "0.5")
    printed = re.fullmatch(r"(\d+) targets, \d+ late; never faster than (\d\.\d\d) rad/s\n", text)
    assert printed is not None
    assert int(printed[1]) > 3
    assert float(printed[2]) <= 1.5


def test_watch_and_recover_continues_after_stop() -> None:
    lines = output("watch_and_recover.py", "--demonstrate", "--rounds", "1").splitlines()
    assert lines == [
        "not moving: the robot is stopped: protective stop",
        "find the cause, and clear the stop at the pendant",
        "continuing",
        "done",
    ]


def test_run_script_prints_messages_of_program() -> None:
    assert output("run_script.py").splitlines() == ["waves: 1", "waves: 2", "finished"]


def test_run_script_prints_the_invalid_line(tmp_path: Path) -> None:
    file = tmp_path / "wrong.script"
    file.write_text("a = 1\ntxtmsg(a)\n")
    done = run("run_script.py", "--file", str(file))
    assert done.returncode == 1
    assert done.stderr.splitlines() == ["line 2: txtmsg(a)", "compile_error_name_not_found:txtmsg:"]


def points_of(path: Path) -> list[tuple[float, float]]:
    """Return the points of the path in a drawing."""
    (line,) = ElementTree.parse(path).getroot().iter("{http://www.w3.org/2000/svg}polyline")
    return [(float(x), float(y)) for x, y in (point.split(",") for point in line.attrib["points"].split())]


@pytest.mark.slow
def test_rhd_spiral_ends_at_its_start(tmp_path: Path) -> None:
    text = output("rhd_spiral.py", str(tmp_path / "spiral.svg"))
    assert re.search(r"ended 0\.0[0-2] m from the start", text), text
    points = points_of(tmp_path / "spiral.svg")
    assert points[-1] == pytest.approx(points[0], abs=1.0)
    # The second-to-last leg is 4.8 m long; 480 pixels show 11 m.
    assert max(y for _, y in points) - min(y for _, y in points) == pytest.approx(4.8 * 480 / 11, abs=2.0)


@pytest.mark.parametrize("options", [(), ("--radius", "1.0", "--angle", "-270"), ("--radius", "0.5", "--angle", "90")])
def test_rhd_arc_ends_at_the_computed_pose(tmp_path: Path, options: tuple[str, ...]) -> None:
    text = output("rhd_arc.py", str(tmp_path / "arc.svg"), *options)
    ended, should = ([float(number) for number in re.findall(r"-?\d+\.\d+", line)] for line in text.splitlines())
    assert ended[:2] == pytest.approx(should[:2], abs=0.002)
    assert ended[2] == pytest.approx(should[2], abs=0.02)
    assert len(points_of(tmp_path / "arc.svg")) > 50


@needs_broker
@pytest.mark.slow
@pytest.mark.real_time
def test_robobot_line_stops_before_the_wall(broker: int) -> None:
    lines = checked(run_process("robobot_line.py", "--port", str(broker))).splitlines()
    assert lines[1].startswith("followline")
    assert float(lines[-2].split()[-1]) == pytest.approx(0.4, abs=0.05)
    found = re.search(r"x (.*) m, y (.*) m, heading", lines[-1])
    assert found is not None
    assert float(found.group(1)) == pytest.approx(5.1, abs=0.1)


@pytest.mark.slow
@pytest.mark.real_time
def test_rhd_mission_docks_when_started_in_each_of_three_ways(tmp_path: Path) -> None:
    """The mission is started from Python, from the command line, and through the port of the server."""
    lines = checked(run_process("rhd_mission.py", str(tmp_path / "way.svg"))).splitlines()
    assert [line.strip() for line in lines[:2]] == ["userevent round", "userevent docked"]
    ends = [re.match(r"(.*?) +ended at x (.*) m, y (.*) m, heading (.*) deg", line) for line in lines[2:]]
    found = {end.group(1): tuple(map(float, end.groups()[1:])) for end in ends if end is not None}
    assert found.keys() == {"Python", "command line", "port"}
    # All end at the same place, 3.5 m and 6 m from the start. On a busy machine, the mission on the port is some cycles
    # late.
    for x, y, heading in found.values():
        assert (x, y) == pytest.approx((5.0, 8.0), abs=0.05)
        assert heading == pytest.approx(0.0, abs=3.0)
    assert "<polyline" in (tmp_path / "way.svg").read_text()


def test_every_example_is_run_by_a_test() -> None:
    """An example is run by this module, or by `nox -s interop`, which installs its requirements."""
    tests = [Path(__file__), *Path(__file__).parent.parent.joinpath("interop").glob("test_*.py")]
    named = "".join(path.read_text() for path in tests)
    assert [path.name for path in sorted(EXAMPLES.glob("*.py")) if path.name not in named] == []


MAINS = {"urlink": urlink.cli.main, "rhdlink": rhdlink.cli.main}


def commands() -> list[tuple[str, str]]:
    """Return the commands in the shell blocks of the documents: the program, and its arguments."""
    found = []
    for document in DOCUMENTS:
        for block in re.findall(r"^ *```sh\n(.*?)^ *```", document.read_text(), re.DOTALL | re.MULTILINE):
            for part in re.split(r"\n|&&|\|", block.replace("\\\n", " ")):
                command = re.match(r"\s*\$?\s*(?:\S*/)?(urlink|rhdlink)\s+(.*)", part)
                if command:
                    found.append((command[1], command[2].partition("#")[0].partition(">")[0].strip()))
    return found


@pytest.mark.parametrize(("program", "command"), commands())
def test_options_of_commands_in_documents_exist(program: str, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    name, *arguments = shlex.split(command)
    if name.startswith("-") or name == "COMMAND":
        return
    assert MAINS[program]([name, "--help"]) == 0
    known = capsys.readouterr().out
    options = {argument.partition("=")[0] for argument in arguments if argument.startswith("-")}
    assert [option for option in options if option not in known] == []
