"""RTDE end to end: `robot.rtde` and `robot.registers` with the simulated controller, recordings and replay."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import urlink
from linkcore.errors import BadRecording, BadValue, LocalError
from tests.waiting import until
from urlink import InputInUse, NoSuchVariable
from urlink.rtde import OUTPUTS, Inputs, Outputs

pytestmark = pytest.mark.simulated_time


@pytest.fixture(params=["3.15", "5.4", "5.25"])
def robot(request: pytest.FixtureRequest) -> Iterator[urlink.Robot]:
    model = "ur5" if request.param.startswith("3") else "ur5e"
    with urlink.connect(f"sim://{model}?firmware={request.param}") as robot:
        yield robot


def test_every_variable_of_the_controller_is_streamed(robot: urlink.Robot) -> None:
    missing = robot.rtde.missing()
    assert missing == tuple(name for name, variable in OUTPUTS.items() if not variable.is_in(robot.firmware))
    names = [name for name in OUTPUTS if "register" not in name]
    stream = robot.rtde.outputs(*names, missing="leave_out")
    state = stream.wait()
    for name in names:
        assert (getattr(state, name) is None) == (name in missing)
    assert stream.controller is not None
    assert stream.controller[:2] == robot.firmware[:2]
    until(lambda: stream.stats.rate > 0.5 * robot.firmware.rate)
    assert stream.stats.failed == 0


def test_inputs_and_registers_take_effect(robot: urlink.Robot) -> None:
    outputs = robot.rtde.outputs(
        "target_speed_fraction", "actual_digital_output_bits", "input_int_register_24", "input_bit_register_64"
    )
    with robot.rtde.inputs("speed_slider_fraction", "standard_digital_output") as inputs:
        inputs.send(speed_slider_fraction=0.25)
        until(lambda: outputs.latest is not None and outputs.latest.target_speed_fraction == 0.25)
        inputs.send(standard_digital_output={1: True})
        until(lambda: outputs.latest is not None and bool(outputs.latest.actual_digital_output_bits & 0b10))
        with pytest.raises(InputInUse, match="speed_slider_mask"):
            robot.rtde.inputs("speed_slider_fraction")
        held = robot.rtde.who_holds()
        assert held["speed_slider_fraction"] == held["standard_digital_output_mask"] == "in use"
        assert "input_int_register_24" not in held
    robot.registers.write_integer(24, -7)
    robot.registers.write_bit(64, True)
    until(lambda: outputs.latest is not None and outputs.latest.input_int_register_24 == -7)
    until(lambda: outputs.latest is not None and outputs.latest.input_bit_register_64)

    def is_free() -> bool:
        return "speed_slider_mask" not in robot.rtde.who_holds()

    until(is_free)


def test_program_and_client_share_registers() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.registers.write_integer(24, 20)
        robot.registers.write_float(25, 0.5)
        robot.script.run(
            "write_output_integer_register(26, read_input_integer_register(24) + 1)\n"
            "write_output_float_register(27, read_input_float_register(25) * 3)"
        ).wait(10)
        until(lambda: robot.registers.read_integer(26) == 21)
        assert robot.registers.read_float(27) == 1.5


def test_subscription_continues_after_reconnection() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11", silence=0.5) as robot:
        stream = robot.rtde.outputs("timestamp", "actual_q", frequency=50)
        got: list[Outputs] = []
        stream.subscribe(got.append)
        inputs: Inputs = robot.rtde.inputs("input_int_register_24")
        until(lambda: bool(got))
        robot.controller.faults.cut("rtde")
        until(lambda: stream.stats.reconnects >= 1)
        count = len(got)
        until(lambda: len(got) > count)

        def is_sent() -> bool:
            try:
                inputs.send(input_int_register_24=3)
            except urlink.RemoteError:
                return False
            return True

        until(is_sent)


def test_recording_contains_the_recipe(tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    with urlink.connect("sim://ur5e?firmware=5.4") as robot:
        stream = robot.rtde.outputs("timestamp", "actual_q", "robot_mode", "payload", missing="leave_out")
        first = stream.wait()  # the recording starts after the recipe was negotiated
        with robot.record(path, ["realtime", stream]):
            until(lambda: stream.latest is not None and stream.latest.timestamp > first.timestamp + 0.1)
            robot.controller.faults.cut("rtde")  # the second connection is recorded from its start
            until(lambda: stream.stats.reconnects == 1)
            until(lambda: stream.latest is not None)
            last = stream.wait()
    with urlink.connect(f"replay://{path}?rate=max") as robot:
        again = robot.rtde.outputs()
        assert again.names == ("timestamp", "actual_q", "robot_mode", "payload")
        assert again.left_out == ("payload",)
        states: list[Any] = list(again)
        times = [state.timestamp for state in states]
        assert times == sorted(times)
        assert times[0] <= first.timestamp + 0.1
        assert last.timestamp <= times[-1]
        assert states[-1].actual_q.shape == (6,)
        assert (states[0].payload, states[-1].payload) == (None, None)
        assert again.stats.failed == 0
    with urlink.connect(f"replay://{path}?rate=max") as robot:
        with pytest.raises(BadValue, match="recorded without actual_qd; it contains timestamp, actual_q"):
            robot.rtde.outputs("actual_qd")
        with pytest.raises(LocalError, match="recording"):
            robot.rtde.inputs("input_int_register_24")
        with pytest.raises(BadValue, match="recording"):
            robot.rtde.missing()
        assert robot.rtde.outputs("actual_q").wait().actual_q.shape == (6,)


def test_replay_without_rtde_raises_for_outputs(tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    with urlink.connect("sim://ur5e?firmware=5.4") as robot, robot.record(path, ["realtime"]):
        robot.realtime.wait()
    with urlink.connect(f"replay://{path}") as robot, pytest.raises(BadRecording, match="has no channel 'rtde'"):
        robot.rtde.outputs("actual_q")


def test_robot_close_closes_rtde() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        stream = robot.rtde.outputs("timestamp")
        stream.start()
        with pytest.raises(NoSuchVariable, match="actual_qq"):
            robot.rtde.outputs("actual_qq").start()
    with pytest.raises(urlink.Closed):
        stream.wait()
    with pytest.raises(urlink.Closed):
        robot.rtde.outputs("timestamp").start()
