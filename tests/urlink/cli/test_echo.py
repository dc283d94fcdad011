from __future__ import annotations

import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from tests.harm import HOSTILE, assert_harmless, strict
from urlink.cli.packet_stream import Tap
from urlink.packets import RealtimeState
from urlink.protocol.firmware import NEWEST
from urlink.robot import connect
from urlink.simulator import Controller
from urlink.simulator.faults.link import with_sub_package, with_tail

from .conftest import Run, write

pytestmark = pytest.mark.simulated_time

Spawn = Callable[..., "subprocess.Popen[str]"]


def played(path: Path, rate: str = "max") -> str:
    return f"replay://{str(path).replace(' ', '%20')}?rate={rate}"


def test_echo_prints_all_fields_on_one_line(run: Run, address: str) -> None:
    status, out, err = run("echo", address, "--count", "3")
    assert (status, err) == (0, "")
    assert out.count("\n") == 3
    for text in out.splitlines():
        assert text.startswith("RealtimeState(time=")
        assert "robot_mode=RUNNING" in text


def test_echo_prints_chosen_fields(run: Run, address: str) -> None:
    status, out, _ = run("echo", address, "robot_mode", "q_actual", "payload_mass", "--count", "1")
    assert status == 0
    assert out.startswith("robot_mode=RUNNING q_actual=[")
    assert out.endswith("] payload_mass=0\n")


def test_fields_may_follow_options(run: Run, address: str) -> None:
    status, out, _ = run("echo", address, "--count", "1", "robot_mode")
    assert (status, out) == (0, "robot_mode=RUNNING\n")


def test_missing_fields_are_printed_as_dash_or_null(run: Run, old_address: str) -> None:
    assert run("echo", old_address, "safety_mode", "--count", "1")[1] == "safety_mode=-\n"
    (record,) = map(strict, run("echo", old_address, "safety_mode", "--count", "1", "--json")[1].splitlines())
    assert record["safety_mode"] is None


def test_echo_prints_fields_of_sub_packages(run: Run, address: str) -> None:
    fields = ("joint_data.q_actual", "robot_mode_data.robot_mode", "singularity_info.severity", "tool_mode_info")
    status, out, _ = run("echo", address, *fields, "--interface", "primary", "--count", "1")
    assert status == 0
    assert out.startswith("joint_data.q_actual=[")
    assert "robot_mode_data.robot_mode=RUNNING singularity_info.severity=- tool_mode_info=ToolModeInfo(" in out


@pytest.mark.parametrize("interface", ["primary", "secondary"])
def test_echo_prints_robot_states_as_json(run: Run, address: str, interface: str) -> None:
    status, out, _ = run("echo", address, "--json", "--interface", interface, "--count", "2")
    assert status == 0
    first, second = map(strict, out.splitlines())
    assert first["type"] == "RobotState"
    assert len(first["joint_data"]["q_actual"]) == 6
    assert "configuration_data" in first
    assert "configuration_data" not in second
    assert second["received"] > first["received"] > 1e9


@pytest.mark.parametrize("kind", ["JointData", "VersionMessage", "RobotMessage", "State"])
def test_type_option_selects_the_packets(run: Run, address: str, kind: str) -> None:
    status, out, _ = run("echo", address, "--type", kind, "--count", "1", "--json")
    assert status == 0
    assert strict(out)["type"] == ("JointData" if kind == "JointData" else "VersionMessage")


def test_type_option_works_with_field(run: Run, address: str) -> None:
    assert run("echo", address, "major", "--type", "VersionMessage", "--count", "1")[1] == "major=5\n"


def test_unknown_field_lists_existing_fields(run: Run) -> None:
    status, out, err = run("echo", "sim://", "q_actually")
    assert (status, out) == (2, "")
    assert "RealtimeState has no field 'q_actually'" in err
    assert "tool_vector_actual" in err
    status, _, err = run("echo", "sim://", "q_actual", "--interface", "primary")
    assert status == 2
    assert "did you mean joint_data.q_actual?" in err


def test_type_of_another_interface_is_rejected(run: Run) -> None:
    status, _, err = run("echo", "sim://", "--type", "JointData", "--interface", "realtime")
    assert status == 2
    assert "the realtime interface does not send JointData" in err
    assert run("echo", "sim://", "--type", "Nonsense")[0] == 2


def test_json_is_strict_and_complete(run: Run, recording: Path) -> None:
    status, out, err = run("echo", played(recording), "--json")
    assert (status, err) == (0, "")
    records = list(map(strict, out.splitlines()))
    assert [record["time"] for record in records] == [number / 500 for number in range(20)]
    assert records[3]["q_actual"] == [3.0, -1.5, 0.0, None, 0.0, 3.0]
    assert records[0]["received"] == pytest.approx(1.7e9 + 1000.0)


@pytest.mark.parametrize("options", [(), ("--json",), ("text",), ("text", "--json")])
def test_hostile_text_never_reaches_the_terminal(run: Run, recording: Path, options: tuple[str, ...]) -> None:
    status, out, err = run("echo", played(recording), "--type", "TextMessage", *options)
    assert (status, err) == (0, "")
    assert out.count("\n") == 1
    assert_harmless(out)
    if "--json" in options:
        assert strict(out)["text"] == HOSTILE
    else:
        assert "\\x1b[2J" in out


def test_unknown_tails_and_sub_packages_are_shown(run: Run, tmp_path: Path) -> None:
    controller = Controller("UR5e", NEWEST)
    controller.step()
    state = with_sub_package(with_sub_package(controller.state_package(), 77, b"one"), 78, b"two")
    packet = with_tail(controller.realtime_packet(), b"newfield")
    path = write(tmp_path / "x.urlog", {"realtime": [packet], "primary": [state]})
    record = strict(run("echo", played(path), "--interface", "primary", "--json")[1])
    assert [each["package_type"] for each in record["unknown_sub_packages"]] == [77, 78]
    assert record["unknown_sub_packages"][1]["payload"] == b"two".hex()
    out = run("echo", played(path))[1]
    assert out.endswith(f" tail={b'newfield'.hex()}\n")


def test_echo_times_out(run: Run, controller: Controller, address: str) -> None:
    controller.faults.stall(30, "realtime")
    try:
        status, out, err = run("echo", address, "--timeout", "0.2")
    finally:
        controller.faults.heal()
    assert (status, out) == (1, "")
    assert err.endswith("realtime within 0.2 s\n")


def test_dropped_packets_are_reported(capsys: pytest.CaptureFixture[str], address: str) -> None:
    with connect(address) as robot, Tap(robot.realtime, RealtimeState) as tap:
        assert tap.take(5.0)
        assert capsys.readouterr().err == ""
        # As if the output had been blocked for half a minute.
        tap._queue.offer([robot.realtime.wait()] * 20000)
    assert "packets were dropped, because the output was too slow" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.real_time
def test_lost_connection_is_reported_and_echo_continues(spawn: Spawn) -> None:
    with Controller("UR5e", "5.11") as controller:
        process = spawn("echo", controller.address, "time")
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline()
        controller.faults.cut()
        assert "connection lost: " in process.stderr.readline()
        for text in process.stdout:  # echo reconnects and continues automatically
            if float(text.partition("=")[2]) >= controller.time - 0.1:
                break
        process.terminate()
        assert process.wait(20) == 143


def test_echo_loses_no_state_at_full_rate(run: Run, controller: Controller, address: str) -> None:
    before = controller.counters.skipped
    status, out, err = run("echo", address, "time", "--count", "400")
    assert (status, err) == (0, "")
    times = [float(text.partition("=")[2]) for text in out.splitlines()]
    steps = [round((later - earlier) * 500) for earlier, later in pairwise(times)]
    if controller.counters.skipped == before:  # the simulator itself kept up
        assert set(steps) == {1}
