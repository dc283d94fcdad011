from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

import urlink
from tests.waiting import until
from urlink.packets import SafetyMode

from .conftest import Run

pytestmark = pytest.mark.real_time

Spawn = Callable[..., "subprocess.Popen[str]"]


def test_duration(run: Run) -> None:
    status, out, err = run("sim", "--duration", "0.2")
    assert status == 0
    assert out.startswith("ur://127.0.0.1?primary=")
    assert out.count("\n") == 1
    assert err.startswith("urlink: UR5e, firmware 5.")


@pytest.mark.slow
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_serves_until_a_signal(spawn: Spawn, number: int, status: int) -> None:
    process = spawn("sim", "--model", "UR10", "--firmware", "3.4", "--host", "127.0.0.1")
    assert process.stdout is not None
    address = process.stdout.readline().strip()
    with urlink.connect(address) as robot:
        assert (robot.model, str(robot.firmware)) == ("UR10", "3.4")
        robot.realtime.wait()
    process.send_signal(number)
    _, err = process.communicate(timeout=20)
    assert process.returncode == status
    assert "Traceback" not in err
    with pytest.raises(urlink.ConnectFailed):
        urlink.connect(address, timeout=1.0)


@pytest.mark.slow
def test_faults_happen_at_their_time(spawn: Spawn) -> None:
    # Again and again, for a machine that takes long to connect.
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
def test_what_it_cannot_do(run: Run, argv: tuple[str, ...], said: str) -> None:
    status, out, err = run("sim", *argv, "--duration", "0.1")
    assert (status, out) == (1, "")
    assert said in err
    assert err.count("\n") == 1


def test_standard_ports(run: Run) -> None:
    status, out, err = run("sim", "--ports", "standard", "--duration", "0.1")
    if status == 1:
        assert "30001" in err  # something else on this machine has them
    else:
        assert (status, out) == (0, "127.0.0.1\n")


@pytest.mark.slow
def test_programs_that_the_dashboard_loads(spawn: Spawn, tmp_path: Path) -> None:
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
def test_local_control(spawn: Spawn) -> None:
    process = spawn("sim", "--local-control")
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        assert robot.dashboard.is_in_remote_control() is False
        with pytest.raises(urlink.DashboardRefused, match="Remote Control"):
            robot.dashboard.power_off()


@pytest.mark.parametrize(("argv", "is_moving"), [((), False), (("--motion", "demo"), True)])
def test_the_arm_stands_still_unless_it_is_to_move(spawn: Spawn, argv: tuple[str, ...], is_moving: bool) -> None:
    process = spawn("sim", *argv)
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        assert robot.dashboard.running() is is_moving
        until(lambda: robot.realtime.wait().qd_target.any() == is_moving)


@pytest.mark.slow
def test_like_the_simulator_of_the_vendor(spawn: Spawn) -> None:
    process = spawn("sim", "--like", "ursim", "--noise", "off")
    assert process.stdout is not None
    with urlink.connect(process.stdout.readline().strip()) as robot:
        state = robot.realtime.wait()
        assert state.q_actual.tolist() == [-1.6, -1.72, -2.2, -0.8, 1.6, 0.03]
        assert robot.dashboard.is_in_remote_control() is False
        assert robot.dashboard.loaded_program() == "Default program"
        assert robot.dashboard.program_state().name == "Default program"


@pytest.mark.parametrize("option", ["pick.urp", "=x", "pick.urp=/nowhere/pick.script"])
def test_programs_that_are_none(run: Run, option: str) -> None:
    status, _, err = run("sim", "--program", option)
    assert status == 2
    assert "--program" in err
