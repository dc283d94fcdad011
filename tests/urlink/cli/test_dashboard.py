from __future__ import annotations

import pytest

from tests.waiting import until
from urlink.protocol.enums import RobotMode
from urlink.simulator import Controller

from .conftest import Run

pytestmark = pytest.mark.simulated_time


def test_dashboard_prints_reply(run: Run, address: str) -> None:
    assert run("dashboard", address, "robotmode") == (0, "Robotmode: RUNNING\n", "")


def test_dashboard_joins_words_of_command(run: Run, controller: Controller, address: str) -> None:
    assert run("dashboard", address, "popup", "mind", "the", "gap") == (0, "showing popup\n", "")
    assert controller.pendant.popup == "mind the gap"
    assert run("dashboard", address, "close", "popup") == (0, "closing popup\n", "")


def test_dashboard_start_powers_arm_on(run: Run) -> None:
    with Controller("UR5e", "5.11") as controller:
        controller.faults.power_off()
        until(lambda: controller.modes.robot_mode is RobotMode.POWER_OFF)  # `start` does nothing to a running arm
        assert run("dashboard", controller.address, "start") == (0, "the arm is running\n", "")
        assert controller.modes.may_move


def test_dashboard_start_fails_on_cb2(run: Run, old_address: str) -> None:
    status, _, err = run("dashboard", old_address, "start")
    assert status == 1
    assert "CB2" in err


def test_recording_has_no_dashboard(run: Run, silent_address: str) -> None:
    status, _, err = run("dashboard", silent_address, "robotmode")
    assert status == 1
    assert "recording" in err


def test_dashboard_rejects_line_breaks(run: Run, address: str) -> None:
    status, _, err = run("dashboard", address, "popup a\npower off")
    assert status == 1
    assert err.count("\n") == 1


def test_dashboard_fails_when_controller_refuses(run: Run, address: str) -> None:
    assert run("dashboard", address, "load", "nix.urp") == (1, "File not found: nix.urp\n", "")
    status, out, err = run("dashboard", address, "no", "such", "thing")
    assert (status, err) == (1, "")
    assert out.casefold().startswith("could not understand")
