"""The dashboard client of the third-party library ur_rtde with the simulator's dashboard server.

The client asks for the version first, and omits commands that this version does not have. It raises an error for an
unexpected reply. So a call that returns has got the reply that the client expects from a real controller. The RTDE
interfaces of ur_rtde are tested in `test_ur_rtde_interfaces.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from tests.waiting import until
from urlink.simulator import Controller, Demonstration

dashboard_client = pytest.importorskip(
    "dashboard_client", reason="ur_rtde is not installed; `nox -s interop` installs it where there is a wheel of it"
)

pytestmark = pytest.mark.real_time

PATH = "/programs/wait.urp"
FILES = {PATH: "def wait():\n  sleep(30.0)\nend\n"}


@pytest.fixture(params=[("UR5", "3.15"), ("UR5e", "5.11")], ids=["3.15", "5.11"])
def controller(request: pytest.FixtureRequest) -> Iterator[Controller]:
    model, firmware = request.param
    with Controller(model, firmware, files=FILES, motion=Demonstration()) as controller:
        yield controller


@pytest.fixture
def client(controller: Controller) -> Iterator[Any]:
    client = dashboard_client.DashboardClient(controller.host, controller.ports["dashboard"])
    client.connect()
    try:
        yield client
    finally:
        client.disconnect()


def says(read: Callable[[], str], text: str) -> bool:
    return read() == text


def test_client_connects_and_disconnects(client: Any) -> None:
    assert client.isConnected()
    client.disconnect()
    assert not client.isConnected()


def test_client_reads_modes_version_and_program(controller: Controller, client: Any) -> None:
    assert client.robotmode() == "Robotmode: RUNNING"
    assert client.safetymode() == "Safetymode: NORMAL"
    assert client.polyscopeVersion().startswith(f"{controller.firmware.major}.{controller.firmware.minor}.")
    assert client.running()
    assert client.getLoadedProgram() == "No program loaded"
    assert client.getRobotModel() == "UR5"
    assert not client.isProgramSaved()
    if controller.firmware.is_e_series:
        assert client.safetystatus() == "Safetystatus: NORMAL"
        assert client.getSerialNumber() == controller.serial
        assert client.isInRemoteControl()


def test_client_switches_power_and_releases_brakes(controller: Controller, client: Any) -> None:
    client.powerOff()
    until(partial(says, client.robotmode, "Robotmode: POWER_OFF"))
    assert not client.running()
    client.powerOn()
    until(partial(says, client.robotmode, "Robotmode: IDLE"), 10)
    client.brakeRelease()
    until(partial(says, client.robotmode, "Robotmode: RUNNING"), 10)


def test_client_loads_plays_pauses_and_stops_programs(client: Any) -> None:
    with pytest.raises(RuntimeError, match="File not found"):
        client.loadURP("/programs/other.urp")
    client.loadURP(PATH)
    assert client.getLoadedProgram() == f"Loaded program: {PATH}"
    until(partial(says, client.programState, "STOPPED wait.urp"))
    for command, state in (
        (client.play, "PLAYING wait.urp"),
        (client.pause, "PAUSED wait.urp"),
        (client.play, "PLAYING wait.urp"),
        (client.stop, "STOPPED wait.urp"),
    ):
        command()
        until(partial(says, client.programState, state))


def test_client_shows_popups_and_adds_to_the_log(controller: Controller, client: Any) -> None:
    shown = []
    for command in (lambda: client.popup("Is anybody there?"), client.closePopup, client.closeSafetyPopup):
        command()
        shown.append(controller.pendant.popup)
    assert shown == ["Is anybody there?", None, None]
    client.addToLog("somebody was there")
    assert controller.pendant.log[-1] == "somebody was there"


@pytest.mark.slow
def test_client_unlocks_a_protective_stop_after_five_seconds(controller: Controller, client: Any) -> None:
    controller.faults.protective_stop()
    until(partial(says, client.safetymode, "Safetymode: PROTECTIVE_STOP"))
    with pytest.raises(RuntimeError, match="Cannot unlock protective stop until 5s after occurrence"):
        client.unlockProtectiveStop()

    def unlocked() -> bool:
        try:
            client.unlockProtectiveStop()
        except RuntimeError:
            return False
        return True

    until(unlocked, 10)
    until(partial(says, client.safetymode, "Safetymode: NORMAL"))


def test_play_raises_in_local_control(controller: Controller, client: Any) -> None:
    if not controller.firmware.is_e_series:
        pytest.skip("remote control came with the e-Series")
    controller.remote_control = False
    assert not client.isInRemoteControl()
    with pytest.raises(RuntimeError, match="Remote Control"):
        client.play()


def test_quit_closes_the_connection(client: Any) -> None:
    client.quit()
    with pytest.raises(RuntimeError):
        client.robotmode()
