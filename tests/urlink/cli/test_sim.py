from __future__ import annotations

import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

import urlink
from tests.spawning import ENDINGS, Ending
from tests.waiting import until
from urlink.packets import SafetyMode
from urlink.session.address import RobotAddress, parse_address

from .conftest import Run

pytestmark = pytest.mark.real_time

Spawn = Callable[..., "subprocess.Popen[str]"]


def test_sim_ends_after_duration(run: Run) -> None:
    status, out, err = run("sim", "--duration", "0.2")
    assert status == 0
    assert out.startswith("ur://127.0.0.1?primary=")
    assert out.count("\n") == 1
    assert err.startswith("urlink: UR5e, firmware 5.")


@pytest.mark.slow
@pytest.mark.parametrize(("end", "status"), ENDINGS)
def test_sim_serves_until_a_signal(spawn: Spawn, end: Ending, status: int) -> None:
    process = spawn("sim", "--model", "UR10", "--firmware", "3.4", "--host", "127.0.0.1")
    assert process.stdout is not None
    address = process.stdout.readline().strip()
    with urlink.connect(address) as robot:
        assert (robot.model, str(robot.firmware)) == ("UR10", "3.4")
        robot.realtime.wait()
    end(process)
    _, err = process.communicate(timeout=20)
    assert process.returncode == status
    assert "Traceback" not in err
    with pytest.raises(urlink.ConnectFailed):
        urlink.connect(address, timeout=1.0)


@pytest.mark.slow
def test_sim_injects_scheduled_faults(spawn: Spawn) -> None:
    # Repeat the faults, because connecting can take long on a busy computer.
    faults = [
        option for at in range(1, 30) for option in ("--fault", f"protective_stop@{at}", "--fault", f"clear@{at}.5")
    ]
    process = spawn("sim", *faults)
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        seen: list[SafetyMode | None] = []
        for state in robot.realtime:
            if state.safety_mode not in seen[-1:]:
                seen.append(state.safety_mode)
            if seen[-2:] == [SafetyMode.PROTECTIVE_STOP, SafetyMode.NORMAL]:
                break
    assert set(seen) == {SafetyMode.PROTECTIVE_STOP, SafetyMode.NORMAL}
    process.terminate()
    assert process.wait(20) == 143


def test_help_lists_every_fault(run: Run) -> None:
    from urlink.simulator.faults import FAULTS

    out = run("sim", "--help")[1]
    for name in FAULTS:
        assert f"\n  {name}" in out


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("--firmware", "3.4", "--model", "UR5e"), "does not run firmware 3.4"),
        (("--firmware", "9"), "'9' is not a version"),
        (("--fault", "stall@1"), "stall needs seconds"),
        (("--fault", "reboot=3.4@1"), "does not run firmware 3.4"),
        (("--host", "192.0.2.1"), "192.0.2.1"),
    ],
)
def test_sim_fails_for_impossible_options(run: Run, argv: tuple[str, ...], said: str) -> None:
    status, out, err = run("sim", *argv, "--duration", "0.1")
    assert (status, out) == (1, "")
    assert said in err
    assert err.count("\n") == 1


def test_sim_uses_standard_ports(run: Run) -> None:
    status, out, err = run("sim", "--ports", "standard", "--duration", "0.1")
    if status == 1:
        assert "30001" in err  # another process uses the ports
    else:
        assert (status, out) == (0, "127.0.0.1\n")


@pytest.mark.slow
def test_sim_loads_programs_over_dashboard(spawn: Spawn, tmp_path: Path) -> None:
    (tmp_path / "pick.script").write_text('def pick():\n  textmsg("picked")\n  sleep(60)\nend\n', encoding="utf-8")
    process = spawn("sim", "--program", f"pick.urp={tmp_path / 'pick.script'}")
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        texts: list[urlink.packets.TextMessage] = []
        robot.primary.subscribe(texts.append, urlink.packets.TextMessage)
        robot.dashboard.load("pick.urp")
        with pytest.raises(urlink.DashboardRefused):
            robot.dashboard.load("place.urp")
        robot.dashboard.play()
        until(lambda: [message.text for message in texts] == ["picked"])


@pytest.mark.slow
def test_sim_in_local_control_refuses_commands(spawn: Spawn) -> None:
    process = spawn("sim", "--local-control")
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        assert robot.dashboard.is_in_remote_control() is False
        with pytest.raises(urlink.DashboardRefused, match="Remote Control"):
            robot.dashboard.power_off()


@pytest.mark.parametrize(("argv", "is_moving"), [((), False), (("--motion", "demo"), True)])
def test_simulated_arm_is_at_rest_unless_motion_is_demo(spawn: Spawn, argv: tuple[str, ...], is_moving: bool) -> None:
    process = spawn("sim", *argv)
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        assert robot.dashboard.running() is is_moving
        until(lambda: robot.realtime.wait().qd_target.any() == is_moving)


@pytest.mark.slow
def test_sim_like_ursim_starts_in_the_state_of_ursim(spawn: Spawn) -> None:
    process = spawn("sim", "--like", "ursim", "--noise", "off")
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        state = robot.realtime.wait()
        assert state.q_actual.tolist() == [-1.6, -1.72, -2.2, -0.8, 1.6, 0.03]
        assert robot.dashboard.is_in_remote_control() is False
        assert robot.dashboard.loaded_program() == "Default program"
        assert robot.dashboard.program_state().name == "Default program"


@pytest.mark.slow
def test_sim_like_ursim_passes_the_vendors_dashboard_tests(spawn: Spawn) -> None:
    # The commands, and the replies that the tests of the UR Client Library expect from URSim.
    process = spawn("sim", "--like", "ursim", "--firmware", "5.25", "--noise", "off")
    assert process.stdout is not None
    address = parse_address(process.stdout.readline().strip())
    assert isinstance(address, RobotAddress)
    ports = address.ports
    with (
        socket.create_connection(("127.0.0.1", ports["dashboard"]), timeout=20) as dashboard,
        socket.create_connection(("127.0.0.1", ports["primary"]), timeout=20) as primary,
        dashboard.makefile("rw", newline="\n") as lines,
    ):

        def ask(line: str) -> str:
            lines.write(f"{line}\n")
            lines.flush()
            return lines.readline().strip()

        assert lines.readline().startswith("Connected")
        for line, reply in (
            ("close safety popup", "closing safety popup"),
            ("is in remote control", "false"),
            ("load wait_program.urp", "Loading program: wait_program.urp"),
            ("load /ursim/programs/wait_program.urp", "Loading program: /ursim/programs/wait_program.urp"),
            ("load installation default.installation", "Loading installation: default.installation"),
            ("power off", "Powering off"),
        ):
            assert ask(line) == reply
        until(lambda: ask("robotmode") == "Robotmode: POWER_OFF")
        assert ask("restart safety") == "Restarting safety"
        assert ask("power on") == "Powering on"
        until(lambda: ask("robotmode") == "Robotmode: IDLE")
        assert ask("brake release") == "Brake releasing"
        until(lambda: ask("robotmode") == "Robotmode: RUNNING")
        assert ask("play") == "Starting program"
        until(lambda: ask("running") == "Program running: true")
        assert ask("programState") == "PLAYING wait_program.urp"
        assert ask("pause") == "Pausing program"
        until(lambda: ask("programState") == "PAUSED wait_program.urp")
        assert ask("play") == "Starting program"
        until(lambda: ask("programState") == "PLAYING wait_program.urp")
        assert ask("stop") == "Stopped"
        until(lambda: ask("programState") == "STOPPED wait_program.urp")
        assert ask("running") == "Program running: false"
        assert ask("isProgramSaved") == "true wait_program.urp"
        for mode in ("AUTOMATIC", "MANUAL"):
            assert ask(f"set operational mode {mode}") == f"Operational mode {mode} is set"
            assert ask("get operational mode") == mode
        assert ask("clear operational mode").startswith("No longer controlling the operational mode.")
        assert ask("get operational mode") == "NONE"
        assert ask("is in remote control") == "false"
        assert ask("generate flight report").startswith("Flight Report generated with id:")
        assert ask("generate support file .").startswith("Completed successfully:")
        assert ask("saveLog") == "Log saved to disk"
        # The test suites that use no program on the pendant send their scripts to the primary interface.
        primary.sendall(b"protective_stop()\n")
        until(lambda: ask("safetystatus") == "Safetystatus: PROTECTIVE_STOP")
        until(lambda: ask("unlock protective stop") == "Protective stop releasing")
        until(lambda: ask("safetymode") == "Safetymode: NORMAL")


@pytest.mark.slow
def test_sim_like_ursim_in_local_control_refuses_commands(spawn: Spawn) -> None:
    process = spawn("sim", "--like", "ursim", "--local-control")
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        assert robot.dashboard.is_in_remote_control() is False
        with pytest.raises(urlink.DashboardRefused, match="Remote Control"):
            robot.dashboard.power_off()


@pytest.mark.parametrize("option", ["pick.urp", "=x", "pick.urp=/nowhere/pick.script"])
def test_sim_rejects_invalid_program_option(run: Run, option: str) -> None:
    status, _, err = run("sim", "--program", option)
    assert status == 2
    assert "--program" in err
