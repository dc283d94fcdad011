"""Settings use RTDE inputs if these are available, and scripts otherwise; tests of the choice and its time."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator, Mapping
from types import SimpleNamespace
from typing import Any, cast

import pytest

import urlink
from linkcore.errors import ConnectFailed, ConnectionLost, LinkError
from linkcore.streaming.connection import Connection
from tests.fakes.clock import Clock
from tests.fakes.controller import ScriptedController
from tests.fakes.line import Line
from tests.waiting import until
from urlink import InputInUse
from urlink.command import settings
from urlink.command.channel import CommandChannel
from urlink.command.section import Section
from urlink.errors import NotConfirmed, NotRunning
from urlink.protocol.enums import RobotMode
from urlink.rtde import claims, client
from urlink.simulator import Controller

pytestmark = pytest.mark.simulated_time

# -- with a scripted controller ------------------------------------------------------------------------


class Inputs:
    """RTDE inputs that can be claimed, except inputs in `held`; `error` refuses every claim."""

    def __init__(self) -> None:
        self.held: set[str] = set()
        self.error: LinkError | None = None
        self.lost = False
        self.asked: list[tuple[tuple[str, ...], bool]] = []
        self.written: list[Mapping[str, Any]] = []
        self.aborted = 0

    def claim(self, names: tuple[str, ...], *, wait: bool) -> Callable[[Mapping[str, Any]], None] | None:
        self.asked.append((names, wait))
        if self.error is not None:
            raise self.error
        if self.held & set(names):
            raise InputInUse("in use", names)
        return self._write if wait else None

    def _write(self, values: Mapping[str, Any]) -> None:
        if self.lost:
            raise ConnectionLost("cut")
        self.written.append(values)

    def abort(self) -> None:
        self.aborted += 1


@pytest.fixture
def inputs() -> Inputs:
    return Inputs()


@pytest.fixture
def robot(inputs: Inputs, monkeypatch: pytest.MonkeyPatch) -> Iterator[ScriptedController]:
    monkeypatch.setattr(settings, "_SETTLED", 0.0)
    with ScriptedController(inputs=inputs) as robot:
        robot.clear()
        yield robot


def test_each_setting_writes_its_mask_and_value(robot: ScriptedController, inputs: Inputs) -> None:
    robot.state(board={"analog_output_domain_1": 1})
    acts: list[Callable[[], object]] = [
        lambda: robot.io.set_digital_out(3, True, confirm=0.01),
        lambda: robot.io.set_configurable_digital_out(7, False, confirm=0.01),
        lambda: robot.io.set_tool_digital_out(1, True, confirm=0.01),
        lambda: robot.io.set_analog_out(1, 0.5, confirm=0.01),
        lambda: robot.settings.speed_slider(0.25, 0.01),
    ]
    for number, act in enumerate(acts, 1):
        with pytest.raises(NotConfirmed):
            act()
        # After an unconfirmed setting, later ones on the same connection would be sent as text.
        robot.slow.put(ConnectionLost("cut"))
        until(lambda number=number: robot.slow.opened == number + 1)  # type: ignore[misc]
        robot.clear()
        robot.state(board={"analog_output_domain_1": 1})
        time.sleep(0.1)  # simulated time passes only when the states were read
    assert inputs.written == [
        {"standard_digital_output_mask": 8, "standard_digital_output": 8},
        {"configurable_digital_output_mask": 128, "configurable_digital_output": 0},
        {"tool_digital_output_mask": 2, "tool_digital_output": 2},
        {
            "standard_analog_output_mask": 2,
            "standard_analog_output_type": 2,  # voltage or current stays as it is
            "standard_analog_output_1": 0.5,
        },
        {"speed_slider_mask": 1, "speed_slider_fraction": 0.25},
    ]
    assert robot.sent == []
    robot.settings.flag(3, True)
    assert len(robot.sent) == 1


def test_unconfirmed_setting_switches_to_script(robot: ScriptedController, inputs: Inputs) -> None:
    for _ in range(2):
        with pytest.raises(NotConfirmed):
            robot.io.set_digital_out(0, True, confirm=0.01)
    assert (len(inputs.written), inputs.aborted, len(robot.sent)) == (1, 1, 1)


def test_setting_without_confirm_claims_nothing(robot: ScriptedController, inputs: Inputs) -> None:
    robot.io.set_digital_out(0, True, confirm=None)
    assert inputs.asked == [(("standard_digital_output_mask", "standard_digital_output"), False)]
    assert len(robot.sent) == 1


def test_rtde_package_does_not_overtake_a_script(
    robot: ScriptedController, inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(settings, "_SETTLED", 60.0)
    robot.io.set_digital_out(0, True, confirm=None)
    robot.io.set_digital_out(0, False, confirm=None)
    assert (len(inputs.asked), len(robot.sent)) == (1, 2)


@pytest.mark.parametrize("error", [ConnectFailed("refused"), urlink.LinkTimeout("no answer")], ids=str)
def test_rtde_is_tried_once_per_connection_if_it_is_missing(
    robot: ScriptedController, inputs: Inputs, error: LinkError
) -> None:
    inputs.error = error
    acts: list[Callable[[], object]] = [
        lambda: robot.io.set_digital_out(0, True, confirm=0.01),
        lambda: robot.io.set_digital_out(0, True, confirm=0.01),
        lambda: robot.settings.speed_slider(0.5, 0.01),
    ]
    for act in acts:
        with pytest.raises(NotConfirmed):
            act()
    assert (len(inputs.asked), len(robot.sent)) == (1, 3)
    inputs.error = None
    robot.slow.put(ConnectionLost("cut"))
    until(lambda: robot.slow.opened == 2)
    robot.clear()
    with pytest.raises(NotConfirmed):
        robot.io.set_digital_out(0, True, confirm=0.01)
    assert (len(inputs.written), len(robot.sent)) == (1, 3)


def test_input_in_use_does_not_block_other_inputs(robot: ScriptedController, inputs: Inputs) -> None:
    inputs.held = {"speed_slider_mask"}
    with pytest.raises(NotConfirmed):
        robot.settings.speed_slider(0.5, 0.01)
    assert (len(inputs.written), len(robot.sent)) == (0, 1)
    assert robot.settings._channel._is_refused(("speed_slider_mask", "speed_slider_fraction"))


def test_setting_is_sent_by_script_when_write_fails(robot: ScriptedController, inputs: Inputs) -> None:
    inputs.lost = True
    with pytest.raises(NotConfirmed):
        robot.io.set_digital_out(0, True, confirm=0.01)
    assert len(robot.sent) == 1


def test_setting_sends_nothing_when_robot_is_not_running(robot: ScriptedController, inputs: Inputs) -> None:
    robot.state(RobotMode.POWER_OFF)
    until(lambda: robot.safety.robot_mode is RobotMode.POWER_OFF)
    with pytest.raises(NotRunning):
        robot.io.set_digital_out(0, True)
    assert (inputs.asked, robot.sent) == ([], [])


# -- with a simulated clock ----------------------------------------------------------------------------


class Desk:
    """Setting channel on a command channel that accepts everything; `sent` lists the settings sent as text."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.sent: list[str] = []
        self.inputs = Inputs()
        self.line = Line()
        channel = SimpleNamespace(check_running=lambda: None, command=self.sent.append, beside=lambda send: send())
        self.settings = settings.SettingChannel(
            cast(CommandChannel, channel),
            cast(Connection, self.line),
            Section(),
            lambda: self.inputs,
            self.clock,
        )

    def send(self, values: Mapping[str, Any] | None) -> None:
        self.settings.send("text", lambda: values)


def test_setting_uses_rtde_again_half_a_second_after_a_script() -> None:
    desk = Desk()
    desk.inputs.held = {"a"}
    desk.send({"a": 1})
    for later, written in ((0.499, 0), (0.499, 0), (0.5, 1), (0.0, 2)):
        desk.clock.now += later
        desk.send({"b": 1})
        assert len(desk.inputs.written) == written
    assert len(desk.sent) == 3


def test_setting_without_rtde_inputs_is_sent_as_script() -> None:
    """For example, whether an analogue output is a voltage or a current is unknown before the robot reports it."""
    desk = Desk()
    desk.send(None)
    assert (desk.inputs.asked, desk.sent) == ([], ["text"])
    desk.clock.now += 1.0
    desk.send({"a": 1})
    assert (desk.inputs.written, desk.sent) == ([{"a": 1}], ["text"])


def test_refused_input_is_not_requested_again_until_reconnection(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    desk = Desk()
    desk.inputs.held = {"a"}
    for _ in range(2):
        desk.send({"a": 1})
        desk.clock.now += 1.0
    assert len(desk.inputs.asked) == 1
    assert caplog.text.count("('a',) are sent by script: in use") == 1
    desk.settings.doubt()
    desk.settings.doubt()
    assert desk.inputs.aborted == 1
    desk.send({"b": 1})
    assert len(desk.inputs.asked) == 1
    desk.line.counters.connections += 1
    desk.clock.now += 1.0
    desk.send({"b": 1})
    assert desk.inputs.written == [{"b": 1}]


# -- with the simulator --------------------------------------------------------------------------------


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


def set_all(robot: urlink.Robot, on: bool) -> None:
    """Set each output and the slider; each call is confirmed or raises."""
    robot.io.set_digital_out(3, on)
    robot.io.set_configurable_digital_out(7, on)
    robot.io.set_tool_digital_out(1, on)
    robot.io.set_analog_out(1, 0.5 if on else 0.25)
    robot.set_speed_slider(0.5 if on else 1.0)


def texts(controller: Controller) -> list[str]:
    return [line for _, line in controller.received]


def connect(controller: Controller) -> urlink.Robot:
    """Connect with long timeouts, because a busy computer might delay the controller."""
    return urlink.connect(controller.address, stale_after=20.0, silence=30.0)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use long claim timeouts, because a claim can take longer on a busy computer than a setting would wait."""
    for place in (claims, client):
        monkeypatch.setattr(place, "CLAIM_TIMEOUT", 20.0)
    monkeypatch.setattr(claims, "HOLD", 60.0)


@pytest.mark.slow
@pytest.mark.usefixtures("patient")
def test_settings_use_rtde_and_release_claims(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    controller.received.clear()
    connections: list[Connection] = []

    def noting(connection: Connection, *arguments: Any) -> claims.Claims:
        connections.append(connection)
        return claims.Claims(connection, *arguments)

    monkeypatch.setattr(client, "Claims", noting)
    with connect(controller) as robot, connect(controller) as other:
        for on in (True, False):
            set_all(robot, on)
            with monkeypatch.context() as soon:
                soon.setattr(claims, "HOLD", 0.0)
                until(lambda: not other.rtde.who_holds())
        robot.io.set_digital_out(3, True)
        assert other.rtde.who_holds()
        with robot.rtde.inputs("standard_digital_output") as inputs:  # claimed by the same robot object
            inputs.send(standard_digital_output={3: False})
            until(lambda: not robot.io.digital_out(3))
        robot.io.set_digital_out(3, True)
        connections[-1].abort()
        until(lambda: connections[-1].failure is not None)
        robot.io.set_digital_out(3, False)
    assert texts(controller) == []


@pytest.mark.usefixtures("patient")
def test_input_of_another_client_is_set_by_script(controller: Controller) -> None:
    controller.received.clear()
    with connect(controller) as robot, connect(controller) as other:
        with other.rtde.inputs("speed_slider_fraction"):
            set_all(robot, True)
            assert texts(controller) == ["set speed 0.5"]
            robot.set_speed_slider(0.75)
        robot.set_speed_slider(1.0)  # the claim is not tried again on the same connection
        assert texts(controller) == [f"set speed {each}" for each in (0.5, 0.75, 1.0)]
        controller.faults.cut("primary")
        until(lambda: robot.primary.stats.reconnects)
        robot.safety.wait_until_clear(5)
        time.sleep(settings._SETTLED)
        robot.set_speed_slider(0.9)
        assert len(texts(controller)) == 3


def test_settings_use_script_when_rtde_port_is_closed(controller: Controller) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        closed = server.getsockname()[1]
    served = dict(controller.ports) | {"rtde": closed}
    address = f"ur://{controller.host}?" + "&".join(f"{name}={port}" for name, port in served.items())
    controller.received.clear()
    with urlink.connect(address) as robot:
        set_all(robot, True)
        set_all(robot, False)
        assert len(texts(controller)) == 2 * (4 * 3 + 1)
