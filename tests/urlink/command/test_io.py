"""Inputs and outputs: the sent text, and the values read back."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from linkcore.errors import BadValue, LinkTimeout
from tests.fakes.controller import ScriptedController
from tests.fakes.packets import packet
from tests.waiting import until
from urlink.command import io as module
from urlink.command.io import IO, Analog
from urlink.errors import NotRunning
from urlink.protocol.enums import AnalogDomain, RobotMode, SafetyMode
from urlink.protocol.primary.robot_state import ToolData
from urlink.protocol.realtime.packets import RealtimeState

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def robot() -> Iterator[ScriptedController]:
    with ScriptedController() as robot:
        robot.clear()
        yield robot


@pytest.mark.parametrize(
    ("act", "statement"),
    [
        (lambda io: io.set_digital_out(7, True, confirm=None), "set_standard_digital_out(7, True)"),
        (lambda io: io.set_configurable_digital_out(7, False, confirm=None), "set_configurable_digital_out(7, False)"),
        (lambda io: io.set_tool_digital_out(1, True, confirm=None), "set_tool_digital_out(1, True)"),
        (lambda io: io.set_analog_out(1, 0.5, confirm=None), "set_standard_analog_out(1, 0.5)"),
        (lambda io: io.set_tool_voltage(12, confirm=None), "set_tool_voltage(12)"),
        (lambda io: io.set_flag(3, True), "set_flag(3, True)"),
    ],
)
def test_setter_sends_secondary_program(robot: ScriptedController, act: Callable[[IO], None], statement: str) -> None:
    act(robot.io)
    assert robot.sent == [f"sec urlink_command():\n  {statement}\nend\n"]


@pytest.mark.parametrize(
    "act",
    [
        lambda io: io.set_digital_out(8, True),
        lambda io: io.set_digital_out(0, "on"),
        lambda io: io.set_configurable_digital_out(-1, True),
        lambda io: io.set_tool_digital_out(2, True),
        lambda io: io.set_analog_out(0, 5.0),
        lambda io: io.set_tool_voltage(48),
        lambda io: io.set_flag(99, True),
        lambda io: io.set_digital_out(0, True, confirm=-1),
        lambda io: io.digital_in(8),
        lambda io: io.digital_out(1.5),
        lambda io: io.configurable_digital_in(8),
        lambda io: io.tool_digital_out(2),
        lambda io: io.analog_in(2),
        lambda io: io.analog_out(-1),
        lambda io: io.analog_out(2),
        lambda io: io.tool_analog_in(2),
    ],
)
def test_io_rejects_missing_channels_and_invalid_values(robot: ScriptedController, act: Callable[[IO], object]) -> None:
    with pytest.raises(BadValue):
        act(robot.io)
    assert robot.sent == []


def test_io_getters_read_primary_and_realtime_states(robot: ScriptedController) -> None:
    io = robot.io
    board = {
        "digital_input_bits": 1 << 3 | 1 << 8 | 1 << 17,
        "digital_output_bits": 1 << 7 | 1 << 15 | 1 << 16,
        "analog_input_0": 1.5,
        "analog_input_range_0": AnalogDomain.VOLTAGE,
        "analog_input_1": 0.004,
        "analog_output_1": 0.02,
        "analog_output_domain_0": AnalogDomain.VOLTAGE,
    }
    tool = {"analog_input_2": 2.5, "analog_input_range_2": 1, "analog_input_3": 3.5, "tool_output_voltage": 24}
    robot.state(board=board, tool=tool)
    robot.fast.put(bytes(packet(RealtimeState, robot.firmware, digital_input_bits=board["digital_input_bits"])))
    until(lambda: io.tool_voltage == 24 and io.digital_in(3))
    assert [io.digital_in(number) for number in range(8)] == [number == 3 for number in range(8)]
    assert [io.digital_out(number) for number in range(8)] == [number == 7 for number in range(8)]
    assert [io.configurable_digital_in(number) for number in range(8)] == [number == 0 for number in range(8)]
    assert [io.configurable_digital_out(number) for number in range(8)] == [number == 7 for number in range(8)]
    assert [io.tool_digital_in(number) for number in range(2)] == [False, True]
    assert [io.tool_digital_out(number) for number in range(2)] == [True, False]
    assert io.analog_in(0) == Analog(1.5, AnalogDomain.VOLTAGE)
    assert io.analog_in(1) == Analog(0.004, AnalogDomain.CURRENT)
    assert io.analog_out(0) == Analog(0.0, AnalogDomain.VOLTAGE)
    assert io.analog_out(1) == Analog(0.02, AnalogDomain.CURRENT)
    assert io.tool_analog_in(0) == Analog(2.5, AnalogDomain.VOLTAGE)
    assert io.tool_analog_in(1) == Analog(3.5, AnalogDomain.CURRENT)
    assert io.tool_voltage == 24
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", io._repr_html_())
    assert cells[1::2] == ["3, 8, 17", "7, 15, 16", "1.5 V", "0.004 A", "0 V", "0.02 A"]


def test_cb2_reads_and_sets_its_outputs() -> None:
    with ScriptedController("1.8") as robot:
        robot.clear(board={"digital_output_bits": 1 << 8})
        robot.fast.put(bytes(packet(RealtimeState, robot.firmware, digital_input_bits=1 << 9)))
        io = robot.io
        until(lambda: io.tool_digital_in(1))
        assert [io.tool_digital_in(number) for number in range(2)] == [False, True]
        assert [io.tool_digital_out(number) for number in range(2)] == [True, False]
        io.set_tool_digital_out(0, True)
        io.set_analog_out(0, 1, confirm=None)
        assert [text.splitlines()[1] for text in robot.sent] == [
            "  set_digital_out(8, True)",
            "  set_analog_out(0, 1.0)",
        ]
        for act in (
            lambda: io.set_configurable_digital_out(0, True),
            lambda: io.configurable_digital_in(0),
            lambda: io.configurable_digital_out(0),
        ):
            with pytest.raises(BadValue, match="no configurable digital"):
                act()


def test_setter_needs_running_robot_but_ignores_stops(robot: ScriptedController) -> None:
    io = robot.io
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: robot.safety.cause == "protective stop")
    io.set_tool_voltage(0, confirm=None)
    robot.state(RobotMode.POWER_OFF)
    until(lambda: robot.safety.robot_mode is RobotMode.POWER_OFF)
    with pytest.raises(NotRunning):
        io.set_tool_voltage(0, confirm=None)
    assert len(robot.sent) == 1


def test_digital_in_times_out_without_state(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_FIRST_STATE", 0.05)
    with ScriptedController() as robot, pytest.raises(LinkTimeout):
        robot.io.digital_in(0)


def test_getter_waits_two_seconds_for_first_state() -> None:
    waited: list[float] = []

    def wait(timeout: float) -> ToolData:
        waited.append(timeout)
        return ToolData((5, 11), tool_output_voltage=12)

    primary: Any = SimpleNamespace(of=lambda kind: SimpleNamespace(latest=None, wait=wait))
    unused: Any = None
    assert IO(unused, primary, unused).tool_voltage == 12
    assert waited == [2.0]


# -- waiting for an input ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("firmware", "wait", "bit"),
    [
        ("5.11", lambda io, on, timeout: io.wait_digital_in(3, on, timeout), 3),
        ("5.11", lambda io, on, timeout: io.wait_configurable_digital_in(3, on, timeout), 11),
        ("5.11", lambda io, on, timeout: io.wait_tool_digital_in(1, on, timeout), 17),
        ("1.8", lambda io, on, timeout: io.wait_tool_digital_in(1, on, timeout), 9),
    ],
)
def test_wait_digital_in_uses_realtime_states(firmware: str, wait: Callable[[IO, bool, float], None], bit: int) -> None:
    with ScriptedController(firmware) as robot:

        def show(bits: int) -> None:
            robot.fast.put(bytes(packet(RealtimeState, robot.firmware, digital_input_bits=bits)))

        show(~(1 << bit) & 0xFFFF)
        with pytest.raises(LinkTimeout, match=r"digital input \d was not switched on: .*within 0\.05 s"):
            wait(robot.io, True, 0.05)
        thread = threading.Thread(target=lambda: show(1 << bit))
        thread.start()
        wait(robot.io, True, 10.0)
        thread.join()
        wait(robot.io, True, 10.0)
        show(0)
        wait(robot.io, False, 10.0)


@pytest.mark.parametrize("bank", ["", "configurable_", "tool_"])
def test_digital_in_is_current_after_wait(robot: ScriptedController, bank: str) -> None:
    bit = {"": 1, "configurable_": 9, "tool_": 17}[bank]
    wait, read = getattr(robot.io, f"wait_{bank}digital_in"), getattr(robot.io, f"{bank}digital_in")
    # The primary interface, which sends ten times a second, has not reported the input yet.
    robot.state(board={"digital_input_bits": 0})
    for on in (True, False, True):
        robot.fast.put(bytes(packet(RealtimeState, robot.firmware, digital_input_bits=on << bit)))
        wait(1, on, 10.0)
        assert read(1) == on


@pytest.mark.parametrize(
    "wait",
    [
        lambda io: io.wait_digital_in(8),
        lambda io: io.wait_digital_in(0, "high"),
        lambda io: io.wait_tool_digital_in(0, True, -1.0),
    ],
)
def test_wait_digital_in_rejects_invalid_arguments(robot: ScriptedController, wait: Callable[[IO], None]) -> None:
    with pytest.raises(BadValue):
        wait(robot.io)
