"""The commands serve and turtle."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

import rhdlink
from linkcore.errors import BadValue
from tests.spawning import ENDINGS, Ending, interrupt

from .conftest import Run, Spawn

pytestmark = pytest.mark.real_time

CONFIG = """\
<rhd>
  <scheduler> <period value="{period}"/> <type value="usleep"/> </scheduler>
  <server> <port value="0"/> </server>
  <plugins>
    <robot enable="true" lib="{lib}" critical="true" start="7"/>
    <turtle enable="true" lib="rhdlink.host.plugins.turtle:Turtle"/>
  </plugins>
</rhd>
"""

PLUGIN = """\
import sys

from rhdlink import Int32, Plugin, Read, Write


class Robot(Plugin):
    counter = Read(Int32)
    fail = Write(Int32)

    def init(self, config):
        self.counter = config.integer("start", 0)

    def periodic(self, tick):
        if self.fail:
            raise RuntimeError("as told")

    def terminate(self):
        print("motors stopped", file=sys.stderr)
"""


@pytest.fixture
def config(tmp_path: Path, request: pytest.FixtureRequest) -> str:
    # Modules are cached by name, so each test needs a separate module.
    name = f"robot_of_{request.node.originalname}"
    (tmp_path / f"{name}.py").write_text(PLUGIN)
    path = tmp_path / "rhdconfig.xml"
    path.write_text(CONFIG.format(period=2000, lib=f"{name}:Robot"))
    return str(path)


def test_serve_prints_its_address_and_statistics(run: Run, config: str) -> None:
    before = list(sys.path)
    status, out, err = run("serve", config, "--duration", "0.1")
    assert status == 0
    assert out.startswith("127.0.0.1:")
    assert out.count("\n") == 1
    lines = err.splitlines()
    assert lines[0] == f"rhdlink: {config}: robot, turtle; Ctrl-C ends it; connect to"
    assert lines[1] == "motors stopped"
    assert " ticks, late by " in lines[2]
    assert sys.path == before


@pytest.mark.slow
@pytest.mark.parametrize(("end", "status"), ENDINGS)
def test_signal_ends_serve_in_order(spawn: Spawn, config: str, end: Ending, status: int) -> None:
    process = spawn("serve", config)
    assert process.stdout is not None
    with rhdlink.connect(process.stdout.readline().strip()) as robot:
        robot.sync()
        assert robot["counter"] == 7
        end(process)
        _, err = process.communicate(timeout=20)
    assert process.returncode == status
    assert "motors stopped" in err
    assert "Traceback" not in err


@pytest.mark.slow
def test_failing_critical_plugin_ends_serve_with_1(spawn: Spawn, config: str) -> None:
    process = spawn("serve", config)
    assert process.stdout is not None
    with rhdlink.connect(process.stdout.readline().strip(), access="w") as robot:
        robot["fail"] = 1
        robot.sync()
        _, err = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "motors stopped" in err
    assert err.endswith("rhdlink: plugin robot failed in periodic: RuntimeError: as told\n")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<rhd>", "invalid XML"),
        ("<rhd/>x", "invalid XML"),
        (CONFIG.format(period=-1, lib="x:Y"), "is not a whole number"),
        (CONFIG.format(period=2000, lib="libauserial.so.1"), "is a plugin in C"),
        (CONFIG.format(period=2000, lib="no_such_module_here:Robot"), "cannot import no_such_module_here"),
    ],
)
def test_serve_reports_invalid_configurations(run: Run, tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "rhdconfig.xml"
    path.write_text(text)
    status, out, err = run("serve", str(path))
    assert (status, out) == (1, "")
    assert said in err
    assert err.count("\n") == 1


def test_serve_listens_on_the_given_address(run: Run, config: str) -> None:
    status, out, _ = run("serve", config, "--listen", "127.0.0.2", "--port", "0", "--duration", "0.05")
    if status == 0:  # some systems have only one loopback address
        assert out.startswith("127.0.0.2:")


@pytest.mark.parametrize(
    ("drive", "names"), [("velocity", {"transpos", "cmdrotvel"}), ("smr", {"encl", "speedr", "irsensor"})]
)
def test_turtle_drives_and_saves_its_path(spawn: Spawn, tmp_path: Path, drive: str, names: set[str]) -> None:
    picture = tmp_path / "way.svg"
    process = spawn("turtle", "--port", "0", "--drive", drive, "--lockstep", "--picture", str(picture))
    assert process.stdout is not None
    with rhdlink.connect(process.stdout.readline().strip(), access="w") as robot:
        assert names <= {variable.name for variable in robot.variables}
        for name in ("cmdtransvel", "speedl", "speedr"):
            if name in robot:
                robot[name] = 100_000 if name == "cmdtransvel" else 100
        for _ in range(102):  # a command moves the robot in the round after its request, and the next reply reports it
            robot.sync()
        interrupt(process)
        _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "rhdlink: ended at x 6.5" in err
    assert "<polyline" in picture.read_text()


def test_turtle_ends_after_its_duration(run: Run) -> None:
    status, out, err = run("turtle", "--port", "0", "--duration", "0.05", "--period", "0.005")
    assert status == 0
    assert out.startswith("127.0.0.1:")
    assert err.startswith("rhdlink: turtle, driven by velocity; Ctrl-C ends it; connect to\n")
    assert "ended at x 5.500 m, y 5.500 m, heading 0.0 deg" in err


@pytest.mark.slow
@pytest.mark.parametrize("width", [2, 4])
def test_width_option_sets_the_width_of_time_stamps(spawn: Spawn, config: str, width: int) -> None:
    for command in (("turtle", "--port", "0"), ("serve", config)):
        process = spawn(*command, "--width", str(width))
        assert process.stdout is not None
        with rhdlink.connect(process.stdout.readline().strip(), access="w") as robot:
            assert robot.width == width
            robot.sync()
            # With the wrong width, the stamp of the tick would be far from the current time.
            assert abs(robot.stamp("tick").time - robot.received.wall) < 60.0
        interrupt(process)
        assert process.wait(20) == 130


def test_width_option_overrides_the_file(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "rhdconfig.xml"
    path.write_text("<rhd><server><port value='0'/><width value='4'/></server></rhd>")
    assert rhdlink.Host.from_config(path)._serving.keywords["width"] == 4
    assert rhdlink.Host.from_config(path, width=2)._serving.keywords["width"] == 2
    status, _, err = run("serve", str(path), "--width", "3")
    assert status == 2
    assert "--width" in err


def test_limit_options_are_passed_to_the_host(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[dict[str, Any]] = []

    def host(plugins: object, **options: Any) -> None:
        made.append(options)
        raise BadValue("made by the test")

    monkeypatch.setattr("rhdlink.cli.turtle.Host", host)
    run("turtle", "--port", "0", "--limit", "words=1000", "--limit", "batch=5000")
    (options,) = made
    assert options["limits"] == rhdlink.variables.Limits(words=1000, batch=5000)
    for wrong in ("words=0", "words", "words=many", "speed=3"):
        status, _, err = run("turtle", "--port", "0", "--limit", wrong)
        assert status == 2
        assert "expected NAME=N" in err
