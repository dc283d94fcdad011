"""Missions in a user's program: run directly, started with a handle, or debugged, on a robot in this process."""

from __future__ import annotations

import asyncio
import logging
import math
import re
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from rhdlink import BadMission, BadValue, Cancelled, Closed, LinkTimeout, Mission, MissionFailed, MissionLimit, Phase
from rhdlink.errors import WrongVariables
from rhdlink.host.config import BadConfiguration
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.world import World
from rhdlink.smrcl.interpreter import MissionLimits
from rhdlink.smrcl.mission import LARGEST, read_script
from rhdlink.smrcl.recipients import Said, SaidKind
from rhdlink.smrcl.robot_conf import VELOMEGA, InputRoute
from rhdlink.smrcl.robot_link import PluginLink
from tests.waiting import interrupted, until

pytestmark = pytest.mark.simulated_time

#: Script that continues until it is ended.
ENDLESS = 'label "on"\nwait 1\ngoto "on"\n'


def turtle() -> Turtle:
    return Turtle(World(1000.0))


def is_stopped(robot: Turtle) -> bool:
    """Whether the last command was a stop, which differs from a robot without commands."""
    return robot.cmdtransvel == robot.cmdrotvel == 0


# -- run ----------------------------------------------------------------------------------------------------


def test_mission_runs_to_its_end() -> None:
    robot = turtle()
    texts: list[str] = []
    mission = Mission('a = 0.5\nfwd a\nturn 90\nprint "done"\neval 3*a\n', robot)
    run = mission.on("values", texts.append).on("text", texts.append).run()
    assert (run.phase, run.done, run.error, run.progress) == (Phase.DONE, True, None, 1.0)
    assert run.variables == {"a": 0.5}
    x, y, theta = robot.world.odometry
    assert (x, y, math.degrees(theta)) == pytest.approx((0.5, 0.0, 90.0), abs=0.5)
    assert (run.pose.x, run.pose.y) == pytest.approx((x, y), abs=0.001)
    assert run.system("$odox") == run.pose.x
    assert run.cycles > 300
    assert texts == ["done", "1.500000  "]
    assert (run.line, run.text, run.conditions) == (5, "eval 3*a", ())
    assert is_stopped(robot)


SPIRAL = (
    'log "$odox"\n'
    + "".join(f"d = {0.2 + 0.1 * leg}\nfwd d\nturn 90\n" for leg in range(8))
    + "turn 45\nfwd 0.5\nstop\n"
)
ARC = 'log "$odox"\nfwd 0.3\nturnr 0.5 90\nfwd 0.3\nstop\n'


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "script", "cycles", "end"),
    [
        (Turtle, SPIRAL, 3464, (-0.0490, -0.0489, 764.98)),
        (Turtle, ARC, 642, (0.7952, 0.8018, 90.31)),
        (SmrTurtle, SPIRAL, 3455, (-0.0490, -0.0488, 765.01)),
        (SmrTurtle, ARC, 650, (0.8018, 0.7991, 90.02)),
    ],
)
def test_drives_end_at_the_pose_reached_with_mrc(
    robot: type[Turtle | SmrTurtle], script: str, cycles: int, end: tuple[float, float, float]
) -> None:
    """The poses in m, m and degrees, and the numbers of cycles, come from lockstep runs of MRC."""
    world = World(1000.0)
    run = Mission(script, robot(world), compat="mrc").run()
    x, y, theta = world.odometry
    assert (round(x, 4), round(y, 4), round(math.degrees(theta), 2)) == end
    assert run.cycles == cycles


def test_mission_can_be_run_again_from_its_beginning() -> None:
    mission = Mission("n = n + 1\nfwd 0.1\n", turtle(), variables={"n": 41.0})
    first, second = mission.run(), mission.run()
    assert first.variables == second.variables == {"n": 42.0}
    assert first is not second


def test_script_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "square.smr"
    path.write_bytes("% schräg\nfwd 0.1\n".encode("latin-1"))
    for source in (path, str(path)):
        mission = Mission(source, turtle())
        assert mission.name == "square.smr"
        assert mission.run().phase is Phase.DONE
    assert read_script(path).startswith("% schräg")
    with pytest.raises(BadValue, match=r"gone\.smr: No such file"):
        Mission(tmp_path / "gone.smr")
    path.write_bytes(b"%" * (LARGEST + 1))
    with pytest.raises(BadValue, match="larger than"):
        Mission(path)


@pytest.mark.slow
@pytest.mark.real_time
def test_run_that_times_out_stops_the_robot() -> None:
    robot = turtle()
    with pytest.raises(LinkTimeout, match="did not end in time"):
        Mission("drive : ($drivendist > 900)\n", robot).run(timeout=0.5)
    assert robot.world.odometry.x > 0.0
    assert is_stopped(robot)


def test_script_with_errors_does_not_start() -> None:
    robot = turtle()
    with pytest.raises(BadMission) as caught:
        Mission("fwd 1\nfwd (\nturn 2 @w 3\n", robot).run()
    assert [(mistake.line, mistake.column > 0) for mistake in caught.value.mistakes] == [(2, True), (3, True)]
    assert "script: line 2, column" in str(caught.value)
    assert robot.world.odometry.x == 0.0


def test_failing_mission_reports_its_line() -> None:
    robot = turtle()
    with pytest.raises(MissionFailed) as caught:
        Mission('fwd 0.2\narray "a" 3\na[7] = 1\nfwd 5\n', robot).run()
    assert (caught.value.line, caught.value.text) == (3, "a[7] = 1")
    assert str(caught.value).startswith("line 3")
    assert is_stopped(robot)


def test_limits_can_be_set_for_each_mission() -> None:
    with pytest.raises(MissionLimit, match="50 lines in one cycle"):
        Mission('n = 1\nlabel "on"\ngoto "on"\n', turtle(), limits=MissionLimits(lines=50)).run()


def test_integer_variable_of_the_robot_can_be_a_speed() -> None:
    run = Mission("drive @v $tick : ($cmdtime > 0.1)\n", turtle()).run()
    assert (run.phase, run.error) == (Phase.DONE, None)
    assert run._execution.controller.vehicle.control.speed > 0.0


@pytest.mark.parametrize("compat", ["sound", "mrc"])
@pytest.mark.parametrize("variable", ["tick[99999]", "tick[-99999]"])
def test_input_route_beyond_a_variable_is_rejected(variable: str, compat: str) -> None:
    conf = replace(VELOMEGA, routes=(InputRoute("mrc", "motionconnect", "w2odox", variable),))
    with pytest.raises(BadConfiguration, match=re.escape(f"routeinput uses {variable}, which is not")):
        Mission("fwd 0.1\n", turtle(), conf=conf, compat=compat).run()


def test_mission_raises_without_a_robot_that_has_its_variables(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match="has no robot"):
        Mission("fwd 1\n").run()
    with pytest.raises(BadValue, match="expected a connected robot"):
        Mission("fwd 1\n", 7).run()  # type: ignore[arg-type]
    conf = tmp_path / "robot.conf"
    conf.write_text('<robot><robotinfo type="differential" name="smr"/></robot>')
    with pytest.raises(WrongVariables, match="there is no read variable encl"):
        Mission("fwd 1\n", turtle(), conf=conf).run()
    assert Mission("fwd 0.1\n", SmrTurtle(World(1000.0)), conf=conf).run().phase is Phase.DONE
    with pytest.raises(BadConfiguration, match="none"):
        Mission("fwd 1\n", turtle(), conf=tmp_path / "none").run()
    with pytest.raises(BadValue, match="expected 'sound', 'mrc'"):
        Mission("fwd 1\n", compat="loud")


def test_script_is_checked_with_or_without_a_robot() -> None:
    source = "x = $odox + $nosuch\n"
    assert Mission(source).check() == []
    with pytest.raises(BadMission, match=r"line 1, column 13: the robot has no system variable \$nosuch"):
        Mission(source, turtle()).run()
    mission = Mission("eval twice(a)\n", variables={"a": 1.0})
    assert [mistake.line for mistake in mission.check()] == [1]
    assert mission.function("twice", lambda value: 2 * value).check() == []


def test_mrc_profile_runs_up_to_an_invalid_line() -> None:
    robot = turtle()
    with pytest.raises(MissionFailed) as caught:
        Mission("fwd 0.3\nfwd (\n", robot, compat="mrc").run()
    assert caught.value.line == 2
    assert robot.world.odometry.x == pytest.approx(0.3, abs=0.02)


# -- callbacks and functions of a program -------------------------------------------------------------------


def test_mission_output_is_delivered_by_kind_and_in_order() -> None:
    lines: list[str] = []
    everything: list[Said] = []
    mission = Mission('putevent "go"\nprint "a"\neval 2\n', turtle())
    mission.on("line", lines.append).on("event", lines.append).on("text", lines.append).on_said(everything.append).run()
    assert lines == ['putevent "go"', "userevent go", 'print "a"', "a", "eval 2"]
    kinds = [said.kind for said in everything if said.kind is not SaidKind.LINE]
    assert kinds == [SaidKind.EVENT, SaidKind.TEXT, SaidKind.VALUES]


def test_exception_in_a_callback_does_not_affect_others(caplog: pytest.LogCaptureFixture) -> None:
    heard: list[str] = []

    def broken(text: str) -> None:
        raise RuntimeError("no paper")

    with caplog.at_level(logging.ERROR):
        Mission('print "1"\n', turtle()).on("text", broken).on("text", heard.append).run()
    assert heard == ["1"]
    assert "no paper" in caplog.text


def test_command_for_special_hardware_calls_a_given_function() -> None:
    seen: list[tuple[object, ...]] = []

    def vision(*parameters: object) -> dict[str, float]:
        seen.append(parameters)
        return {"vis0": 3.5}

    run = Mission('vision "ball"\nx = $vis0\n', turtle()).on("vision", vision).run()
    assert seen == [("ball",)]
    assert run.variables == {"x": 3.5}
    with pytest.raises(MissionFailed, match=r"line 1, column 1 .*vision"):
        Mission('vision "ball"\n', turtle()).run()


def test_function_that_raises_ends_the_mission_on_its_line() -> None:
    def vision(*parameters: object) -> None:
        raise OSError("camera unplugged")

    robot = turtle()
    with pytest.raises(MissionFailed, match="camera unplugged") as caught:
        Mission('fwd 0.1\nvision "ball"\n', robot).on("vision", vision).run()
    assert caught.value.line == 2
    assert is_stopped(robot)


def test_mission_reads_values_from_provider_functions() -> None:
    mission = Mission("x = $line3\ny = $irdistfrontmiddle\nz = $gpsdop\n", turtle())
    mission.provide("line", lambda: [1, 1, 1, 0.25, 1, 1, 1, 1]).provide("ir", lambda: [1, 2, 3, 4, 5])
    run = mission.provide("$gpsdop", lambda: 9.0).run()
    assert run.variables == pytest.approx({"x": 0.25, "y": 3.0, "z": 9.0}, abs=0.01)


@pytest.mark.parametrize(
    ("name", "provider"),
    [
        ("line", lambda: [1, 2]),
        ("ir", lambda: "near"),
        ("gpsdop", lambda: "good"),
        ("nosuch", lambda: 1.0),
        ("gpsdop", lambda: 1 / 0),
    ],
)
def test_provider_that_fails_ends_the_mission(name: str, provider: Callable[[], float]) -> None:
    robot = turtle()
    with pytest.raises(MissionFailed, match=f"the provider of '{name}' raised"):
        Mission("fwd 1\n", robot).provide(name, provider).run()
    assert is_stopped(robot)


def test_invalid_callbacks_and_names_are_rejected() -> None:
    mission = Mission("fwd 1\n")
    refusals: list[Callable[[], object]] = [
        lambda: mission.on("text", 7),  # type: ignore[arg-type]
        lambda: mission.on_said(7),  # type: ignore[arg-type]
        lambda: mission.provide("line", 7),  # type: ignore[arg-type]
        lambda: mission.function("f", 7),  # type: ignore[arg-type]
        lambda: mission.function("sin", math.sin),
        lambda: mission.function("a b", math.sin),
        lambda: mission.on("sleep", print),
    ]
    for refused in refusals:
        with pytest.raises(BadValue):
            refused()


def test_expressions_call_functions_of_the_program() -> None:
    run = Mission("d = dist(3, 4)\n", turtle()).function("dist", math.hypot).run()
    assert run.variables == {"d": 5.0}
    with pytest.raises(MissionFailed, match=r"line 2, column 7 .*dist\(\) raised TypeError"):
        Mission("c = 1\nd = c+dist(1)\n", turtle()).function("dist", lambda a, b: a + b).run()


def test_arrays_are_returned_as_tuples() -> None:
    run = Mission('array "a" 3\na[1] = 2\nb = 7\n', turtle()).run()
    assert run.variables == {"a": (0.0, 2.0, 0.0), "b": 7.0}


# -- logs ---------------------------------------------------------------------------------------------------


def test_log_is_saved_in_its_folder(tmp_path: Path) -> None:
    source = 'log "$odox" "$odoth"\nfwd 0.2\ncontrol "stoplog"\ncontrol "savelog"{}\n'
    Mission(source.format(' "way.txt"'), turtle(), log_folder=tmp_path).run()
    rows = [line.split() for line in (tmp_path / "way.txt").read_text().splitlines()]
    assert len(rows) > 60
    assert float(rows[-1][0]) == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("name", ["../way.txt", "/tmp/way.txt", "a/b", ".."])
def test_log_cannot_be_saved_outside_its_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    source = f'log "$odox"\nfwd 0.1\ncontrol "savelog" "{name}"\n'
    with pytest.raises(MissionFailed, match="without a folder"):
        Mission(source, turtle(), log_folder=folder).run()
    assert list(tmp_path.rglob("*")) == [folder]


def test_log_without_a_folder_is_reported_as_not_saved(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        Mission('log "$odox"\nfwd 0.1\ncontrol "savelog" "way.txt"\n', turtle()).run()
    assert "'way.txt' is not saved" in caplog.text
    with pytest.raises(MissionFailed, match="cannot write the log"):
        Mission('control "savelog" "way.txt"\n', turtle(), log_folder="/no/such/folder").run()


# -- started missions ---------------------------------------------------------------------------------------


def test_started_mission_is_a_handle() -> None:
    called: list[Phase] = []
    is_called = threading.Event()

    def note(run: object) -> None:
        called.append(run.phase)  # type: ignore[attr-defined]
        is_called.set()

    run = Mission("fwd 0.3\n", turtle()).start()
    run.add_done_callback(note)
    run.wait(20.0)
    assert run.phase is Phase.DONE
    assert is_called.wait(10.0)
    assert called == [Phase.DONE]
    run.cancel()
    assert run.phase is Phase.DONE


def test_started_mission_can_be_awaited() -> None:
    async def two() -> tuple[Phase, Phase]:
        good, bad = Mission("fwd 0.3\n", turtle()).start(), Mission("a = 1\na[3] = 2\n", turtle()).start()
        await asyncio.wait_for(good, 20.0)
        with pytest.raises(MissionFailed, match="line 2"):
            await asyncio.wait_for(bad, 20.0)
        return good.phase, bad.phase

    assert asyncio.run(two()) == (Phase.DONE, Phase.FAILED)


@pytest.mark.slow
def test_run_returns_the_values_of_its_stop_conditions() -> None:
    robot = turtle()
    with Mission("drive : ($drivendist > 900) | ($odox < 0)\n", robot).start() as run:
        until(lambda: run.conditions == (False, False))
        assert run.line == 1


@pytest.mark.slow
def test_cancelled_mission_stops_the_robot() -> None:
    robot = turtle()
    run = Mission(f"drive : ($drivendist > 1)\nn = 1\n{ENDLESS}", robot, limits=MissionLimits()).start()
    until(lambda: run.line > 2)
    assert 0.0 < run.progress <= 1.0
    assert run.variables == {"n": 1.0}
    run.cancel()
    with pytest.raises(Cancelled):
        run.wait(20.0)
    assert (run.phase, run.done) == (Phase.CANCELLED, True)
    assert is_stopped(robot)


@pytest.mark.real_time
def test_interrupted_wait_cancels_the_mission() -> None:
    robot = turtle()
    run = Mission("drive\n" + ENDLESS, robot).start()
    interrupted(run.wait, lambda: robot.world.odometry.x > 0.1)
    until(lambda: run.done)
    assert (run.phase, is_stopped(robot)) == (Phase.CANCELLED, True)


@pytest.mark.slow
def test_leaving_the_with_block_cancels_the_mission() -> None:
    robot = turtle()
    with Mission("drive\n" + ENDLESS, robot).start() as run:
        until(lambda: robot.world.odometry.x > 0.1)
    with pytest.raises(Cancelled):
        run.wait(20.0)
    assert is_stopped(robot)


def test_failure_in_the_thread_is_raised_by_wait() -> None:
    run = Mission("fwd 0.1\na[1] = 1\n", turtle(), variables={"a": 0.0}).start()
    with pytest.raises(MissionFailed, match="line 2"):
        run.wait(20.0)
    assert isinstance(run.error, MissionFailed)
    assert run.phase is Phase.FAILED
    with pytest.raises(BadMission):
        Mission("fwd (\n", turtle()).start()


def test_unknown_system_variable_is_rejected() -> None:
    run = Mission("fwd 0.1\n", turtle()).run()
    assert run.system("odox") == run.system("$odox") > 0.09
    with pytest.raises(BadValue, match="no system variable nosuch"):
        run.system("nosuch")


# -- debugger -----------------------------------------------------------------------------------------------


SQUARE = 'n = 0\nlabel "side"\nfwd 0.2\nturn 90\nn = n + 1\nif (n < 2) "side"\n'


def test_debugger_steps_line_by_line() -> None:
    robot = turtle()
    lines: list[int | None] = []
    with Mission(SQUARE, robot).debug() as debugger:
        assert (debugger.line, debugger.text) == (None, "")
        while (line := debugger.step()) is not None:
            lines.append(line)
            assert debugger.line == line
            assert is_stopped(robot)
    assert lines == [1, 2, 3, 4, 5, 6, 2, 3, 4, 5, 6]
    assert debugger.run.variables == {"n": 2.0}
    assert debugger.run.phase is Phase.DONE
    assert debugger.step() is None


def test_debugger_resumes_up_to_breakpoints() -> None:
    robot = turtle()
    with Mission(SQUARE, robot).debug([5]) as debugger:
        assert (debugger.resume(), debugger.text) == (5, "n = n + 1")
        assert debugger.run.variables == {"n": 0.0}
        assert math.degrees(robot.world.odometry.theta) == pytest.approx(90.0, abs=1.0)
        assert debugger.resume() == 5
        assert debugger.run.variables == {"n": 1.0}
        debugger.breakpoints.clear()
        assert debugger.resume() is None
    assert debugger.run.phase is Phase.DONE


def test_leaving_the_debugger_stops_the_robot() -> None:
    robot = turtle()
    with Mission(SQUARE, robot).debug([5]) as debugger:
        debugger.resume()
    assert debugger.run.phase is Phase.CANCELLED
    assert debugger.step() is None
    assert is_stopped(robot)


def test_line_that_fails_under_a_debugger_raises() -> None:
    with Mission("n = 1\nn[4] = 2\n", turtle()).debug() as debugger:
        debugger.step()
        debugger.step()
        with pytest.raises(MissionFailed, match="line 2"):
            debugger.step()
    assert debugger.run.phase is Phase.FAILED


# -- plugins in this process --------------------------------------------------------------------------------


def test_plugin_link_can_run_in_real_time() -> None:
    robot = turtle()
    link = PluginLink([robot], period=0.001, is_realtime=True)
    run = Mission("wait 0.1\n", link).start()
    run.wait(20.0)
    assert run.cycles >= 100
    link.close()
    link.close()
    with pytest.raises(BadValue, match="was closed"):
        link.exchange({})


def test_tick_of_a_plugin_link_wraps_like_that_of_a_host() -> None:
    link = PluginLink([turtle()])
    link.tick = 2**31 - 2
    ticks = [link.exchange({})["tick"] for _ in range(3)]
    assert ticks == [[2**31 - 1], [-(2**31)], [-(2**31) + 1]]
    # The tick of the link does not wrap.
    assert link.tick == 2**31 + 1


def test_mission_does_not_close_a_plugin_link_of_the_caller() -> None:
    robot = turtle()
    link = PluginLink([robot])
    Mission("fwd 0.1\n", link).run()
    Mission("fwd 0.1\n", link).run()
    assert robot.world.odometry.x == pytest.approx(0.2, abs=0.02)
    assert link.writers == 1
    link.close()
    assert link.writers == 0


def test_timeout_must_be_a_number_of_seconds() -> None:
    with pytest.raises(BadValue, match=r"timeout=True; expected a number of seconds, 0 or more"):
        Mission("wait 0.1\n", turtle()).run(timeout=True)
    with Mission("wait 0.1\n", turtle()).start() as run, pytest.raises(BadValue, match="timeout=True"):
        run.wait(timeout=True)


class Stopping(Turtle):
    """Turtle that stops its host after two ticks."""

    def periodic(self, tick: int) -> None:
        super().periodic(tick)
        if tick == 2:
            self.host.stop()


def test_plugin_link_ends_when_a_plugin_stops_it() -> None:
    robot = Stopping(World(11.0))
    link = PluginLink([robot])
    assert link.plugins == (robot,)
    link.exchange({})
    link.exchange({})
    with pytest.raises(Closed, match="a plugin has stopped the robot"):
        link.exchange({})
    link.close()
