"""RTDE of the simulated controller: requests of real clients as bytes, to a stepped controller."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue
from tests.urlink.simulator.rtde_peer import Peer, package, step, types_of
from urlink.arm.dynamics import Dynamics
from urlink.protocol.firmware import Firmware
from urlink.protocol.rtde.variables import INPUTS, OUTPUTS
from urlink.simulator import Controller, Demonstration, Still
from urlink.simulator.interfaces.rtde import MOST_NAMES, UNREAD

FIRMWARES = ["3.4", "3.9", "3.15", "5.0", "5.4", "5.11", "5.25", "10.12"]
LOOP = """def loop():
  rtde_set_watchdog("input_int_register_0", 10, "{action}")
  while True:
    sync()
  end
end
"""
# The program moves down by 0.1 m and reports its target and its speed.
MOVING = """def moving():
  thread tell():
    while True:
      there = get_target_waypoint()
      speed = get_target_tcp_speed()
      write_output_float_register(0, there[2])
      write_output_float_register(1, speed[2])
      sync()
    end
  end
  run tell()
  goal = get_target_tcp_pose()
  goal[2] = goal[2] - 0.1
  write_output_float_register(2, goal[2])
  movel(goal, a=1.2, v=0.25)
end
"""


def controller(firmware: str = "5.11", **more: Any) -> Controller:
    return Controller(None, firmware, motion=more.pop("motion", Still()), **more)


# -- names and types -----------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_firmware_offers_exactly_its_variables(firmware: str) -> None:
    sim = controller(firmware)
    peer = Peer(sim)
    release = Firmware.parse(firmware)
    for name, variable in OUTPUTS.items():
        number, (kind,) = peer.outputs(name)
        assert (number, kind) == ((1, variable.type) if variable.is_in(release) else (0, "NOT_FOUND")), name
    for count, (name, variable) in enumerate(INPUTS.items(), 1):
        number, (kind,) = peer.inputs(name)
        wanted = (count if count < 256 else 0, variable.type) if variable.is_in(release) else (0, "NOT_FOUND")
        assert (number, kind) == wanted, name


def test_names_are_trimmed_and_may_end_with_a_comma() -> None:
    peer = Peer(controller())
    assert peer.ask("O", struct.pack(">d", 125.0) + b" timestamp , actual_q,") == b"\1DOUBLE,VECTOR6D"
    assert peer.ask("I", b"input_int_register_0, input_double_register_3 ,") == b"\1INT32,DOUBLE"


def test_unknown_name_rejects_the_recipe_and_claims_nothing() -> None:
    sim = controller()
    first, second = Peer(sim), Peer(sim)
    assert first.outputs("timestamp", "nonsense") == (0, ["DOUBLE", "NOT_FOUND"])
    assert not first.start()
    assert first.inputs("input_int_register_0", "nonsense") == (0, ["INT32", "NOT_FOUND"])
    assert second.inputs("input_int_register_0") == (1, ["INT32"])


@pytest.mark.parametrize("names", ["", ",", "timestamp,," * 200, "n" * (MOST_NAMES + 1)])
def test_empty_and_too_long_lists_of_names_are_rejected(names: str) -> None:
    peer = Peer(controller())
    assert peer.ask("O", struct.pack(">d", 125.0) + names.encode())[0] == 0
    assert peer.ask("I", names.encode())[0] == 0
    assert not peer.start()


def test_longest_list_of_names_is_accepted() -> None:
    peer = Peer(controller())
    names = b"timestamp," * (MOST_NAMES // 10)
    assert peer.ask("O", struct.pack(">d", 125.0) + names).count(b"DOUBLE") == MOST_NAMES // 10


# Outputs that the UR Client Library requests. It drops the names that do not exist and asks again.
DRIVER_OUTPUTS = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "speed_scaling",
    "target_speed_fraction",
    "runtime_state",
    "actual_TCP_force",
    "actual_TCP_pose",
    "actual_digital_input_bits",
    "actual_digital_output_bits",
    "standard_analog_input0",
    "standard_analog_input1",
    "standard_analog_output0",
    "standard_analog_output1",
    "analog_io_types",
    "tool_mode",
    "tool_analog_input_types",
    "tool_analog_input0",
    "tool_analog_input1",
    "tool_output_voltage",
    "tool_output_current",
    "tool_temperature",
    "robot_mode",
    "safety_mode",
    "robot_status_bits",
    "safety_status_bits",
    "actual_current",
    "tcp_offset",
]
DRIVER_INPUTS = [
    "speed_slider_mask",
    "speed_slider_fraction",
    "standard_digital_output_mask",
    "standard_digital_output",
    "configurable_digital_output_mask",
    "configurable_digital_output",
    "tool_digital_output_mask",
    "tool_digital_output",
    "standard_analog_output_mask",
    "standard_analog_output_type",
    "standard_analog_output_0",
    "standard_analog_output_1",
    "external_force_torque",
]


@pytest.mark.parametrize("firmware", ["3.9", "3.15", "5.4", "5.11", "5.25", "10.12"])
def test_vendor_driver_sets_up_its_recipes(firmware: str) -> None:
    sim = controller(firmware)
    peer = Peer(sim)
    number, types = peer.outputs(*DRIVER_OUTPUTS)
    missing = [name for name, kind in zip(DRIVER_OUTPUTS, types, strict=True) if kind == "NOT_FOUND"]
    assert missing == (["tcp_offset"] if firmware in ("3.9", "5.4") else [])
    if missing:
        assert number == 0
        number, _ = peer.outputs(*(name for name in DRIVER_OUTPUTS if name not in missing))
    assert number == 1
    # The driver starts, reads the time stamp, pauses, and only then claims its inputs.
    assert peer.start()
    step(sim)
    assert peer.data()[0]["timestamp"] > 40
    assert peer.ask("P") == b"\1"
    assert peer.inputs(*DRIVER_INPUTS)[0] == 1
    assert peer.start()


def test_recipe_may_contain_a_name_twice() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.outputs("timestamp", "timestamp")
    assert peer.start()
    step(sim)
    ((kind, payload),) = peer.take()
    assert kind == "U"
    assert payload[1:9] == payload[9:17]


# -- versions ------------------------------------------------------------------------------------------


def test_protocol_version_is_negotiated() -> None:
    peer = Peer(controller(), protocol=1)
    for wanted in (0, 3, 65535):
        assert peer.ask("V", struct.pack(">H", wanted)) == b"\0"
    assert peer.ask("O", b"timestamp") == b"DOUBLE"
    assert peer.ask("V", b"\0\2") == b"\1"
    assert not peer.start(), "the recipe was one of protocol 1"
    assert peer.ask("O", struct.pack(">d", 125.0) + b"timestamp") == b"\1DOUBLE"
    assert peer.ask("V", b"\0\1") == b"\1"
    assert peer.ask("O", b"timestamp") == b"DOUBLE"


def test_controller_version_is_reported_on_every_request() -> None:
    peer = Peer(controller("5.11.6.1234"))
    for _ in range(2):
        assert struct.unpack(">4I", peer.ask("v")) == (5, 11, 6, 1234)


@pytest.mark.parametrize("firmware", ["3.15", "5.11"])
def test_rtde_protocol_1_needs_no_request_and_has_no_recipe_ids(firmware: str) -> None:
    sim = controller(firmware)
    peer = Peer(sim, protocol=1)
    assert peer.outputs("timestamp", " actual_q") == (1, ["DOUBLE", "VECTOR6D"])
    assert peer.start()
    step(sim, sim.firmware.rate)
    data = peer.data()
    assert len(data) == 125
    assert data[-1]["timestamp"] - data[-2]["timestamp"] == pytest.approx(0.008)


def test_protocol_1_rejects_an_unknown_name_by_its_type() -> None:
    peer = Peer(controller(), protocol=1)
    assert peer.ask("O", b"timestamp,nonsense") == b"DOUBLE,NOT_FOUND"
    assert not peer.start()


@pytest.mark.parametrize("firmware", ["1.8", "3.2"])
def test_firmware_before_3_3_has_no_rtde(firmware: str) -> None:
    assert not controller(firmware).rtde.is_offered()
    assert controller("3.3").rtde.is_offered()


# -- frequency -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("firmware", "frequency", "cycles"),
    [
        *(("5.11", frequency, 1) for frequency in (500, 499, 300, 251, 9999)),
        *(("5.11", frequency, cycles) for frequency, cycles in ((250, 2), (125, 4), (100, 5), (1, 500), (0.5, 1000))),
        *(("3.15", frequency, cycles) for frequency, cycles in ((125, 1), (63, 1), (62, 2), (500, 1), (10, 12))),
    ],
)
def test_frequency_is_rounded_to_whole_cycles(firmware: str, frequency: float, cycles: int) -> None:
    sim = controller(firmware)
    peer = Peer(sim)
    peer.outputs("control_step", frequency=frequency)
    assert peer.start()
    begun = sim.cycle
    assert sim.rtde.next_cycle(begun) == begun + cycles
    step(sim, 3 * cycles)
    assert [data["control_step"] - begun for data in peer.data()] == [cycles, 2 * cycles, 3 * cycles]


@pytest.mark.parametrize("frequency", [0.0, -1.0, math.nan, math.inf])
def test_invalid_frequency_is_rejected(frequency: float) -> None:
    peer = Peer(controller())
    assert peer.outputs("timestamp", frequency=frequency) == (0, ["DOUBLE"])


@pytest.mark.property
@given(st.floats())
def test_any_frequency_is_accepted_or_rejected(frequency: float) -> None:
    """The period of 5e-324 Hz is too long for a number of cycles."""
    recipe, types = Peer(controller()).outputs("timestamp", frequency=frequency)
    assert (recipe, types) == (int(0.0 < frequency < math.inf), ["DOUBLE"])


def test_package_due_in_a_skipped_cycle_is_sent_next() -> None:
    """A server that is far behind skips cycles; a client with a low frequency might otherwise never get a package."""
    here = controller()
    peer = Peer(here)
    peer.outputs("timestamp", frequency=10)
    peer.start()
    came = []
    for cycles in (49, 2, 1, 47, 1, 120, 29, 1):
        here.step(cycles)
        here.rtde.packets(here.cycle)
        came.append(len(peer.data()))
    #       49 51 52 99 100 220 249 250
    assert came == [0, 1, 0, 0, 1, 1, 0, 1]


def test_each_client_has_its_own_frequency() -> None:
    sim = controller()
    peers = [Peer(sim, protocol) for protocol in (1, 2, 2, 2)]
    for peer, frequency in zip(peers, (125, 500, 100, 1), strict=True):
        peer.outputs("timestamp", frequency=frequency)
        assert peer.start()
    step(sim, 500)
    assert [len(peer.data()) for peer in peers] == [125, 500, 100, 1]


# -- start, pause, and outputs -------------------------------------------------------------------------


def test_start_needs_outputs_but_pause_is_always_accepted() -> None:
    sim = controller()
    peer = Peer(sim)
    assert peer.ask("P") == b"\1"
    assert not peer.start()
    peer.outputs("timestamp")
    step(sim, 3)
    assert peer.take() == []
    assert peer.start()
    step(sim, 3)
    assert len(peer.data()) == 3
    assert peer.ask("P") == b"\1"
    step(sim, 3)
    assert peer.take() == []
    assert peer.start()
    step(sim, 2)
    assert len(peer.data()) == 2


def test_second_recipe_replaces_the_first_and_stops_data() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.outputs("timestamp")
    assert peer.start()
    peer.outputs("robot_mode", "timestamp", frequency=250)
    step(sim, 4)
    assert peer.take() == []
    assert peer.start()
    step(sim, 4)
    assert [list(data) for data in peer.data()] == [["robot_mode", "timestamp"]] * 2


def test_timestamp_starts_above_40_seconds() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.outputs("timestamp")
    assert peer.start()
    step(sim, 500)
    data = peer.data()
    assert data[0]["timestamp"] > 40
    assert data[-1]["timestamp"] - data[0]["timestamp"] == pytest.approx(499 / 500)


def test_client_that_does_not_read_loses_data_then_is_closed() -> None:
    sim = controller()
    reader, sleeper = Peer(sim), Peer(sim)
    for peer in (reader, sleeper):
        peer.outputs("timestamp")
        assert peer.start()
    sleeper.pending = 1000
    step(sim, 10)
    assert sleeper.take() == []
    assert sim.counters.unread == 10
    sleeper.pending = 0
    step(sim, 1)
    assert len(sleeper.data()) == 1, "only the newest package; the skipped ones are lost"
    sleeper.pending = 1000
    open_after = []
    for cycles in (round(UNREAD * 500), 2):
        step(sim, cycles)
        open_after.append(sleeper.is_open)
    assert open_after == [True, False]
    assert sim.counters.dropped == 1
    assert len(reader.data()) == 10 + 1 + round(UNREAD * 500) + 2


# -- values --------------------------------------------------------------------------------------------

REALTIME = {
    "target_q": "q_target",
    "target_qd": "qd_target",
    "target_qdd": "qdd_target",
    "target_current": "I_target",
    "target_moment": "M_target",
    "actual_q": "q_actual",
    "actual_qd": "qd_actual",
    "actual_current": "I_actual",
    "joint_control_output": "I_control",
    "actual_TCP_pose": "tool_vector_actual",
    "actual_TCP_speed": "tcp_speed_actual",
    "actual_TCP_force": "tcp_force",
    "target_TCP_pose": "tool_vector_target",
    "target_TCP_speed": "tcp_speed_target",
    "actual_digital_input_bits": "digital_input_bits",
    "joint_temperatures": "motor_temperatures",
    "actual_execution_time": "controller_timer",
    "robot_mode": "robot_mode",
    "joint_mode": "joint_modes",
    "safety_mode": "safety_mode",
    "safety_status": "safety_status",
    "actual_tool_accelerometer": "tool_accelerometer",
    "speed_scaling": "speed_scaling",
    "actual_momentum": "linear_momentum_norm",
    "actual_main_voltage": "V_main",
    "actual_robot_voltage": "V_robot",
    "actual_robot_current": "I_robot",
    "actual_joint_voltage": "V_actual",
    "actual_digital_output_bits": "digital_output_bits",
    "runtime_state": "program_state",
    "elbow_position": "elbow_position",
    "elbow_velocity": "elbow_velocity",
    "payload": "payload_mass",
    "payload_cog": "payload_cog",
    "payload_inertia": "payload_inertia",
}


@pytest.mark.parametrize("firmware", ["3.5", "3.15", "5.4", "5.11", "5.25"])
def test_values_equal_those_of_the_other_interfaces(firmware: str) -> None:
    sim = controller(firmware, motion=Demonstration())
    peer = Peer(sim)
    names = [name for name, variable in OUTPUTS.items() if variable.is_in(sim.firmware)]
    here = [name for name in names if "_register" not in name]
    # The frequency selects every 12th or 50th cycle; the checked cycles are among them.
    assert peer.outputs(*here, frequency=10) == (1, types_of(here))
    assert peer.start()
    sim.signals.set_digital_input(3, True)
    sim.signals.set_digital_output(9, True)
    sim.arm.payload, sim.arm.tcp = 1.5, [0, 0, 0.1, 0, 0, 0]
    for cycles, event in ((300, None), (600, sim.faults.protective_stop), (600, sim.faults.emergency_stop)):
        if event is not None:
            event()
        step(sim, cycles)
        data = peer.data()[-1]
        (realtime,) = urlink.decode(sim.realtime_packet(), "realtime", firmware)
        for name, field in REALTIME.items():
            expected = getattr(realtime, field) if name in here else None
            if expected is not None:
                assert np.array_equal(np.asarray(data[name]), np.asarray(expected)), name
        assert data["timestamp"] - 45.0 == pytest.approx(realtime.time)
        (state,) = urlink.decode(sim.state_package(first=True), "primary", firmware)
        assert isinstance(state, urlink.packets.RobotState)
        assert state.masterboard_data
        assert state.robot_mode_data
        assert state.tool_data
        assert data["standard_analog_output0"] == pytest.approx(state.masterboard_data.analog_output_0)
        assert data["target_speed_fraction"] == pytest.approx(state.robot_mode_data.target_speed_fraction)
        assert data["tool_temperature"] == pytest.approx(state.tool_data.tool_temperature, abs=1e-4)
        status = state.robot_mode_data
        assert data["robot_status_bits"] == status.is_power_on | status.is_program_running << 1
        assert bool(data["safety_status_bits"] & 1 << 2) == status.is_protective_stopped
        assert bool(data["safety_status_bits"] & 1 << 7) == status.is_emergency_stopped
        assert data["tcp_force_scalar"] == pytest.approx(math.hypot(*data["actual_TCP_force"][:3]))
        if "tcp_offset" in here:
            assert data["tcp_offset"] == pytest.approx([0, 0, 0.1, 0, 0, 0])


@pytest.mark.slow
def test_tool_acceleration_is_the_derivative_of_its_speed() -> None:
    sim = controller(motion=Demonstration())
    peer = Peer(sim)
    peer.outputs("target_TCP_acceleration", "target_TCP_speed", "control_step")
    assert peer.start()
    step(sim, 1000)
    before, now, after = peer.data()[-3:]
    slope = (np.subtract(after["target_TCP_speed"], before["target_TCP_speed"])) * 250.0
    assert now["target_TCP_acceleration"] == pytest.approx(slope, abs=2e-4)


def test_registers_are_sent_as_written() -> None:
    sim = controller()
    peer = Peer(sim)
    sim.registers.outputs.bits = 1 << 0 | 1 << 31 | 1 << 33 | 1 << 64 | 1 << 127
    sim.registers.outputs.integers[24] = -7
    sim.registers.outputs.floats[47] = 0.25
    peer.inputs("input_int_register_1", "input_bit_registers32_to_63", "input_bit_register_70")
    peer.write(1, input_int_register_1=-3, input_bit_registers32_to_63=5, input_bit_register_70=True)
    expected = {
        "output_bit_registers0_to_31": 1 | 1 << 31,
        "output_bit_registers32_to_63": 2,
        "output_bit_register_64": True,
        "output_bit_register_65": False,
        "output_bit_register_127": True,
        "output_int_register_24": -7,
        "output_double_register_47": 0.25,
        "input_int_register_1": -3,
        "input_bit_registers32_to_63": 5,
        "input_bit_register_70": True,
    }
    peer.outputs(*expected)
    assert peer.start()
    step(sim)
    assert peer.data() == [expected]
    assert sim.registers.inputs.bits == 1 << 32 | 1 << 34 | 1 << 70


# -- inputs --------------------------------------------------------------------------------------------


def test_input_is_accepted_before_a_start_and_without_outputs() -> None:
    sim = controller()
    peer = Peer(sim)
    assert peer.inputs("input_int_register_23") == (1, ["INT32"])
    peer.write(1, input_int_register_23=42)
    assert sim.registers.inputs.integers[23] == 42


def test_input_can_be_claimed_by_only_one_client() -> None:
    sim = controller()
    first, second = Peer(sim), Peer(sim)
    for number in range(1, 24):
        assert first.inputs("input_int_register_0", f"input_double_register_{number}")[0] == number
    assert second.inputs("input_int_register_1", "input_int_register_0") == (0, ["INT32", "IN_USE"])
    assert second.inputs("input_int_register_1") == (2, ["INT32"]), "the rejected recipe claims nothing, but counts"
    first.close()
    assert second.inputs("input_int_register_0") == (3, ["INT32"])


def test_client_can_have_255_recipes() -> None:
    peer = Peer(controller())
    assert [peer.inputs("input_int_register_0")[0] for _ in range(257)] == [*range(1, 256), 0, 0]


@pytest.mark.parametrize("fieldbus", ["EtherNet/IP", "PROFINET"])
def test_fieldbus_reserves_the_lower_registers(fieldbus: str) -> None:
    sim = controller()
    peer = Peer(sim)
    sim.fieldbus = fieldbus
    assert peer.inputs("input_int_register_23")[1] == ["IN_USE"]
    assert peer.inputs("input_double_register_0")[1] == ["IN_USE"]
    assert peer.inputs("input_int_register_24", "input_double_register_24")[1] == ["INT32", "DOUBLE"]
    sim.fieldbus = None
    assert peer.inputs("input_int_register_23")[1] == ["INT32"]
    with pytest.raises(BadValue, match="expected None or one of EtherNet/IP, PROFINET"):
        sim.fieldbus = "CANopen"


@pytest.mark.parametrize(
    "payload",
    [b"\2" + bytes(4), b"\0" + bytes(4), b"\1" + bytes(3)],
    ids=["unknown", "zero", "short"],
)
def test_data_that_does_not_fit_its_recipe_is_ignored(payload: bytes) -> None:
    """A real client sends 52 bytes for a recipe of 56 bytes."""
    sim = controller()
    peer = Peer(sim)
    peer.inputs("input_int_register_0")
    peer.write(1, input_int_register_0=5)
    peer.put("U", payload)
    assert peer.is_open
    assert peer.take() == []
    assert sim.registers.inputs.integers[0] == 5
    assert sim.counters.ignored_packages == 1
    peer.write(1, input_int_register_0=6)
    assert sim.registers.inputs.integers[0] == 6


def test_data_longer_than_its_recipe_is_truncated() -> None:
    """ur_rtde sends two vectors for a recipe with one vector, in `getForwardKinematics(q, tcp_offset)`."""
    sim = controller()
    peer = Peer(sim)
    peer.inputs("input_int_register_0", "input_double_register_0")
    peer.put("U", b"\1" + struct.pack(">id", 43, 0.25) + bytes(48))
    assert (sim.registers.inputs.integers[0], sim.registers.inputs.floats[0]) == (43, 0.25)
    assert sim.counters.ignored_packages == 0
    assert peer.is_open


def test_only_outputs_in_the_mask_are_set() -> None:
    sim = controller()
    peer = Peer(sim)
    sim.signals.digital_outputs = 0b11 << 16 | 0xF0 << 8 | 0x0F
    for group in ("standard", "configurable", "tool"):
        peer.inputs(f"{group}_digital_output_mask", f"{group}_digital_output")
    peer.write(1, standard_digital_output_mask=0b0001_0001, standard_digital_output=0b1111_0000)
    assert sim.signals.digital_outputs & 0xFF == 0b0001_1110
    peer.write(2, configurable_digital_output_mask=0b1000_0001, configurable_digital_output=0b0000_0001)
    assert sim.signals.digital_outputs >> 8 & 0xFF == 0b0111_0001
    peer.write(3, tool_digital_output_mask=0xFE, tool_digital_output=0xFD)
    assert sim.signals.digital_outputs >> 16 == 0b01
    peer.write(1, standard_digital_output_mask=0, standard_digital_output=0xFF)
    assert sim.signals.digital_outputs & 0xFF == 0b0001_1110


def test_mask_and_value_may_come_in_different_recipes() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.inputs("standard_digital_output_mask")
    peer.inputs("standard_digital_output")
    peer.write(2, standard_digital_output=3)
    assert sim.signals.digital_outputs == 0
    peer.write(1, standard_digital_output_mask=1)
    assert sim.signals.digital_outputs == 1


def test_analogue_outputs_follow_mask_and_type() -> None:
    sim = controller()
    peer = Peer(sim)
    names = ["mask", "type", "0", "1"]
    peer.inputs(*(f"standard_analog_output_{name}" for name in names))

    def write(mask: int, types: int, first: float, second: float) -> list[float]:
        values = dict(zip(names, (mask, types, first, second), strict=True))
        peer.write(1, **{f"standard_analog_output_{name}": value for name, value in values.items()})
        return sim.signals.analog_outputs

    assert write(0b01, 0b00, 0.5, math.nan) == pytest.approx([0.012, 0.004])
    assert write(0b10, 0b11, 0.1, 0.5) == pytest.approx([0.012, 5.0])
    assert sim.signals.analog_output_domains == [0, 1]
    assert write(0b11, 0b10, -1.0, 7.0) == pytest.approx([0.004, 10.0])
    assert write(0b11, 0b10, math.nan, math.inf) == pytest.approx([0.004, 10.0])


def test_slider_moves_only_when_its_mask_is_one() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.inputs("speed_slider_mask", "speed_slider_fraction")
    peer.write(1, speed_slider_mask=1, speed_slider_fraction=0.25)
    assert sim.speed_fraction == 0.25
    for mask in (0, 2, 3):
        peer.write(1, speed_slider_mask=mask, speed_slider_fraction=0.75)
        assert sim.speed_fraction == 0.25
    sim.speed_fraction = 0.5
    step(sim, 10)
    assert sim.speed_fraction == 0.5
    for fraction, shown in ((1.5, 1.0), (-1.0, 0.0), (math.nan, 0.0)):
        peer.write(1, speed_slider_mask=1, speed_slider_fraction=fraction)
        assert sim.speed_fraction == shown


def test_inputs_keep_their_value_after_their_client_leaves() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.inputs("input_double_register_40")
    peer.write(1, input_double_register_40=1.25)
    peer.close()
    step(sim, 10)
    assert sim.registers.inputs.floats[40] == 1.25


def test_external_force_is_used_only_when_enabled() -> None:
    sim = controller()
    peer = Peer(sim)
    wrench = (1.0, 2.0, 2.0, 0.1, 0.2, 0.3)
    peer.inputs("external_force_torque")
    peer.outputs("actual_TCP_force", "tcp_force_scalar")
    assert peer.start()
    peer.write(1, external_force_torque=wrench)
    step(sim)
    assert peer.data()[-1]["actual_TCP_force"] != wrench
    sim.take("ft_rtde_input_enable(True, 0.5, [0, 0, 0], [0, 0, 0.05])")
    step(sim, 3)
    sim.take("write_output_float_register(0, force())")
    step(sim, 3)
    assert sim.registers.outputs.floats[0] == 3.0
    assert peer.data()[-1] == {"actual_TCP_force": wrench, "tcp_force_scalar": 3.0}
    sim.take("ft_rtde_input_enable(False)")
    step(sim, 3)
    assert peer.data()[-1]["actual_TCP_force"] != wrench


# -- programs ------------------------------------------------------------------------------------------


def test_program_reads_and_writes_registers() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.inputs("input_int_register_0", "input_double_register_24", "input_bit_register_64")
    peer.outputs("output_int_register_0", "output_double_register_24", "output_bit_register_64")
    assert peer.start()
    sim.take(
        "def echo():\n  while True:\n"
        "    write_output_integer_register(0, read_input_integer_register(0) + 1)\n"
        "    write_output_float_register(24, read_input_float_register(24) * 2)\n"
        "    write_output_boolean_register(64, not read_input_boolean_register(64))\n"
        "    sync()\n  end\nend\n"
    )
    peer.write(1, input_int_register_0=41, input_double_register_24=0.5, input_bit_register_64=False)
    step(sim, 2)
    assert peer.data()[-1] == {
        "output_int_register_0": 42,
        "output_double_register_24": 1.0,
        "output_bit_register_64": True,
    }
    sim.registers.inputs.floats[24] = np.float64(2.0)
    step(sim, 2)
    assert peer.data()[-1]["output_double_register_24"] == 4.0


@pytest.mark.parametrize(("action", "state"), [("IGNORE", 2), ("Pause", 4), ("stop", 1)])
def test_watchdog_is_reset_by_any_package_with_its_variable(action: str, state: int) -> None:
    sim = controller()
    peer = Peer(sim)
    peer.inputs("input_int_register_0", "input_int_register_5")
    peer.inputs("input_int_register_5")
    peer.outputs("runtime_state")
    assert peer.start()
    sim.take(LOOP.format(action=action))
    step(sim, 10)
    for _ in range(20):  # the same value every 40 ms
        peer.write(1, input_int_register_0=0, input_int_register_5=0)
        step(sim, 20)
    assert peer.data()[-1]["runtime_state"] == 2
    step(sim, 30)
    assert peer.data()[-1]["runtime_state"] == 2, "intervals of 50 ms are still in time"
    peer.write(2, input_int_register_5=1)
    step(sim, 20)
    assert peer.data()[-1]["runtime_state"] == state


def test_resumed_program_has_the_full_watchdog_time() -> None:
    sim = controller()
    sim.take(LOOP.format(action="pause"))
    step(sim, 100)
    assert sim.modes.program_state.name == "PAUSED"
    assert sim.pendant.play()
    step(sim, 45)
    assert sim.modes.program_state.name == "PLAYING"
    step(sim, 10)
    assert sim.modes.program_state.name == "PAUSED"


def test_watchdog_ends_with_its_program() -> None:
    sim = controller()
    sim.take(LOOP.format(action="stop"))
    step(sim, 5)
    sim.take("def other():\n  sleep(10)\nend\n")
    step(sim, 200)
    assert sim.program_name == "other"


def test_watchdog_of_an_unknown_input_is_an_error() -> None:
    sim = controller()
    sim.take(LOOP.replace("input_int_register_0", "output_int_register_0").format(action="stop"))
    step(sim)
    data = b"".join(sim.take_messages())
    (failed,) = [
        m for m in urlink.decode(data, "primary", "5.11") if isinstance(m, urlink.packets.RuntimeExceptionMessage)
    ]
    assert failed.text == "rtde_set_watchdog: there is no RTDE input 'output_int_register_0'"


def test_program_reads_its_waypoint_and_speed() -> None:
    sim = controller()
    sim.take(MOVING)
    step(sim, 100)
    waypoint, speed, wanted = sim.registers.outputs.floats[:3]
    assert waypoint == pytest.approx(wanted)
    assert speed == pytest.approx(sim.arm.sample.speed_target[2], abs=0.01)
    assert -0.25 <= speed < -0.1


# -- text ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", [1, 2])
def test_text_of_a_client_is_stored_without_reply(protocol: int) -> None:
    sim = controller()
    peer = Peer(sim, protocol)
    peer.put("M", b"\5hello\4test\3")
    assert peer.take() == []
    assert list(sim.received) == [("rtde", "test: hello")]


def test_text_of_the_controller_has_the_protocol_format() -> None:
    sim = controller()
    old, new = Peer(sim, 1), Peer(sim)
    sim.faults.rtde_text("watch out", "safety", 2)
    assert old.take() == [("M", b"\2watch out")]
    assert new.take() == [("M", b"\x09watch out\x06safety\2")]
    sim.faults.rtde_text("é" * 200)
    ((_, payload),) = new.take()
    assert payload[1 : 1 + payload[0]].decode() == "é" * 127


# -- bytes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("data", [package("Z", b"abc"), package("V"), package("V", b"\0"), package("I")[:3]])
def test_invalid_request_is_ignored(data: bytes) -> None:
    peer = Peer(controller())
    peer.session.feed(data)
    peer.take()
    assert peer.is_open
    assert peer.ask("P") == b"\1"


def test_package_shorter_than_its_header_ends_the_connection() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.inputs("input_int_register_0")
    peer.session.feed(b"\0\2V" + package("P"))
    assert not peer.is_open
    assert peer.sent == b""
    assert Peer(sim).inputs("input_int_register_0")[0] == 1


# -- faults --------------------------------------------------------------------------------------------


def test_stale_client_keeps_its_inputs_claimed() -> None:
    sim = controller()
    sim.faults.rtde_stale_inputs(1.0)
    first, second = Peer(sim), Peer(sim)
    first.inputs("input_int_register_0")
    first.close()
    step(sim, 499)
    assert second.inputs("input_int_register_0")[1] == ["IN_USE"]
    step(sim, 2)
    assert second.inputs("input_int_register_0")[1] == ["INT32"]
    third = Peer(sim)
    assert third.inputs("input_int_register_0")[1] == ["IN_USE"], "the second client still holds its claim"


def test_late_data_arrives_delayed_but_complete() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.outputs("timestamp")
    assert peer.start()
    sim.faults.rtde_late_data(0.1)
    step(sim, 50)
    assert peer.take() == []
    step(sim, 50)
    assert [package["timestamp"] for package in peer.data()] == pytest.approx([45 + n / 500 for n in range(1, 51)])
    sim.faults.heal()
    step(sim, 1)
    assert len(peer.data()) == 2


def test_start_can_be_refused_or_bring_no_data() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.outputs("timestamp")
    sim.faults.rtde_refuse_start()
    assert not peer.start()
    sim.faults.heal()
    sim.faults.rtde_no_data()
    assert peer.start()
    step(sim, 100)
    assert peer.take() == []
    sim.faults.heal()
    step(sim, 1)
    assert len(peer.data()) == 1


def test_protocol_2_can_be_refused() -> None:
    sim = controller()
    sim.faults.rtde_refuse_protocol_2()
    peer = Peer(sim, 1)
    assert peer.ask("V", b"\0\2") == b"\0"
    assert peer.ask("O", b"timestamp") == b"DOUBLE"


def test_text_and_data_before_or_instead_of_replies() -> None:
    sim = controller()
    sim.faults.rtde_hello()
    peer = Peer(sim, 1)
    assert peer.take() == [("M", b"\2SafetySetup has not been confirmed yet")]
    sim.faults.heal()
    peer = Peer(sim)
    peer.outputs("timestamp")
    sim.faults.rtde_text_before_reply("S", "soon")
    peer.put("S")
    assert [kind for kind, _ in peer.take()] == ["M", "S"]
    sim.faults.heal()
    sim.faults.rtde_data_before_start()
    peer.put("S")
    assert [kind for kind, _ in peer.take()] == ["U", "S"]
    sim.faults.heal()
    sim.faults.rtde_text_instead_of_reply("P", "no")
    peer.put("P")
    assert [kind for kind, _ in peer.take()] == ["M"]
    assert peer.ask("P") == b"\1"
    with pytest.raises(BadValue, match="V, v, O, I, S or P"):
        sim.faults.rtde_text_before_reply("U")


def test_reboot_during_a_handshake_resets_inputs() -> None:
    sim = controller()
    peer = Peer(sim)
    peer.inputs("input_int_register_0")
    peer.write(1, input_int_register_0=5)
    sim.faults.rtde_reboot_at_request("O", 0.01)
    peer.put("O", struct.pack(">d", 125.0) + b"timestamp")
    assert peer.take() == []
    was_up = sim.is_up
    peer.close()
    step(sim, 10)
    assert (was_up, sim.is_up) == (False, True)
    assert Peer(sim).inputs("input_int_register_0")[0] == 1
    assert sim.registers.inputs.integers[0] == 0


# -- dynamics ------------------------------------------------------------------------------------------

DYNAMICS = """def dynamics():
  q = [0.1, -1.4, 1.3, -1.5, -1.2, 0.2]
  qd = [0.5, -0.4, 0.3, 0.2, 0.1, 0.6]
  mass = get_mass_matrix(q)
  change = get_jacobian_time_derivative(q, qd)
  torque = get_coriolis_and_centrifugal_torques(q, qd)
  row = 0
  while row < 6:
    write_output_float_register(row, mass[row, 1])
    write_output_float_register(row + 6, change[row, 2])
    write_output_float_register(row + 12, torque[row])
    row = row + 1
  end
end
"""


def test_programs_compute_the_dynamics_of_the_library() -> None:
    q = np.array([0.1, -1.4, 1.3, -1.5, -1.2, 0.2])
    qd = np.array([0.5, -0.4, 0.3, 0.2, 0.1, 0.6])
    sim = controller("5.25")
    sim.arm.payload, sim.arm.payload_cog, sim.arm.tcp = 2.0, (0.0, 0.02, 0.1), [0, 0, 0.1, 0, 0, 0]
    sim.take(DYNAMICS)
    step(sim, 2)
    floats = sim.registers.outputs.floats
    arm = sim.arm.kinematics
    dynamics = Dynamics(arm, payload=2.0, payload_cog=[0, 0.02, 0.1])
    assert floats[:6] == pytest.approx(dynamics.mass_matrix(q)[:, 1].tolist())
    assert floats[12:18] == pytest.approx(dynamics.coriolis_torque(q, qd).tolist())
    change = (arm.jacobian(q + 1e-4 * qd, sim.arm.tcp) - arm.jacobian(q - 1e-4 * qd, sim.arm.tcp)) / 2e-4
    assert floats[6:12] == pytest.approx(change[:, 2].tolist(), abs=1e-6)
