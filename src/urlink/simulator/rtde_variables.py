"""RTDE variables of the simulated controller: functions that read outputs from its state, or apply inputs to it.

If another interface also sends a value, both interfaces read it from the same source, so that the values of one cycle
are equal. The only exception is `timestamp`, which is larger by `UPTIME` than `time` on the real-time interface. Real
controllers have been running for a while when a client connects, and the UR Client Library waits until `timestamp` is
above 40 s (docs/protocols/rtde.md).

Variables that are not modelled have assumed values. The energy counters include only the electronics. Ratios, encoders
and Euromap values are zero. `actual_current_window` is 2 A, and `script_control_line` is always 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import add, mul
from types import MappingProxyType
from typing import Any

from urlink.arm.parameters import number
from urlink.protocol.enums import ProgramState, RobotStatusBits, SafetyStatusBits
from urlink.protocol.rtde.variables import INPUTS

from .registers import BITS, NUMBERS, Bank
from .robot.characteristics import EXECUTION_TIME
from .robot.modes import StopState
from .robot.sensors import Sample
from .state import ControllerState

#: Initial value of `timestamp`, in s.
UPTIME = 45.0
#: Supply voltages of the controller and of the robot arm, in V.
MAIN_VOLTAGE, ROBOT_VOLTAGE = number("main_voltage"), number("robot_voltage")
# Three terms of the robot current: the electronics at rest, in A; the current per joint power, in A/W; and the current
# per sum of squared motor currents, in 1/A.
_IDLE, _OF_POWER, _OF_HEAT = (
    number("robot_idle_current"),
    number("robot_current_of_power"),
    number("robot_current_of_heat"),
)

Output = Callable[[ControllerState], Any]

_WORD = 0xFFFFFFFF


def _robot_status(state: ControllerState) -> int:
    bits = RobotStatusBits(0)
    if state.modes.is_powered:
        bits |= RobotStatusBits.POWER_ON
    if state.modes.program_state is ProgramState.PLAYING:
        bits |= RobotStatusBits.PROGRAM_RUNNING
    if state.teach_button:
        bits |= RobotStatusBits.TEACH_BUTTON_PRESSED
    return int(bits)


_SAFETY_BITS = {
    StopState.NONE: SafetyStatusBits.NORMAL_MODE,
    StopState.PROTECTIVE: SafetyStatusBits.PROTECTIVE_STOPPED | SafetyStatusBits.STOPPED_DUE_TO_SAFETY,
    StopState.SAFEGUARD: SafetyStatusBits.SAFEGUARD_STOPPED | SafetyStatusBits.STOPPED_DUE_TO_SAFETY,
    StopState.EMERGENCY: (
        SafetyStatusBits.ROBOT_EMERGENCY_STOPPED
        | SafetyStatusBits.EMERGENCY_STOPPED
        | SafetyStatusBits.STOPPED_DUE_TO_SAFETY
    ),
}


def _analog_types(state: ControllerState) -> int:
    signals = state.signals
    types = [*signals.analog_input_ranges[:2], *signals.analog_output_domains]
    return sum(bit << at for at, bit in enumerate(types))


def _tool_analog_types(state: ControllerState) -> int:
    first, second = state.signals.analog_input_ranges[2:]
    return first | second << 1


def timestamp_at(time: float) -> float:
    """Return `timestamp` at a time since the controller came up, both in s."""
    return UPTIME + time


def robot_current(state: ControllerState) -> float:
    """Return the robot current, in A."""
    return current_of(state.arm.sample, state.arm.motors.torque_constants, state.modes.is_powered)


def current_of(s: Sample, torque_constants: Sequence[float], is_powered: bool) -> float:
    """Return the robot current, in A: the sum of the parts for the electronics, the joint power and the motor heat.

    The joint power is that of the motor currents, so it includes friction. The formula was identified for a UR3e. It is
    assumed that it applies to other arms too.

    Args:
        s: Values of the sensors.
        torque_constants: Torque constants of the motors, shape (6,), in Nm/A.
        is_powered: Whether the joints have power.
    """
    if not is_powered:
        return 0.0
    # Do not use `sum`, which rounds differently since Python 3.12. The same run must send the same bytes with every
    # version of Python.
    torques = map(mul, s.I_actual, torque_constants)
    power: float = reduce(add, map(mul, torques, s.qd_actual))
    heat: float = reduce(add, map(mul, s.I_actual, s.I_actual))
    return max(_IDLE + _OF_POWER * power + _OF_HEAT * heat, 0.0)


def execution_time(state: ControllerState) -> float:
    """Return the time that the controller needs to execute one cycle, in ms."""
    return execution_time_of(state.firmware.is_e_series, state.modes.program_state)


def execution_time_of(is_e_series: bool, program_state: ProgramState) -> float:
    """Return the time that a controller needs to execute one cycle, in ms. A running program increases it.

    A real CB2 reported 0.06 ms.
    """
    if not is_e_series:
        return 0.06
    idle, busy = EXECUTION_TIME
    return busy if program_state is ProgramState.PLAYING else idle


def _outputs() -> dict[str, Output]:
    found = dict[str, Output](
        timestamp=lambda s: timestamp_at(s.time),
        target_q=lambda s: s.arm.sample.q_target,
        target_qd=lambda s: s.arm.sample.qd_target,
        target_qdd=lambda s: s.arm.sample.qdd_target,
        target_current=lambda s: s.arm.sample.I_target,
        target_moment=lambda s: s.arm.sample.M_target,
        actual_q=lambda s: s.arm.sample.q_actual,
        actual_qd=lambda s: s.arm.sample.qd_actual,
        actual_current=lambda s: s.arm.sample.I_actual,
        actual_current_window=lambda s: [2.0] * 6,
        actual_current_as_torque=lambda s: s.arm.current_as_torque,
        joint_control_output=lambda s: s.arm.sample.I_control,
        actual_TCP_pose=lambda s: s.arm.sample.pose_actual,
        actual_TCP_speed=lambda s: s.arm.sample.speed_actual,
        actual_TCP_acceleration=lambda s: s.arm.tool_acceleration,
        actual_TCP_force=lambda s: s.arm.sample.force,
        target_TCP_pose=lambda s: s.arm.sample.pose_target,
        target_TCP_speed=lambda s: s.arm.sample.speed_target,
        target_TCP_acceleration=lambda s: s.arm.tool_acceleration,
        tcp_offset=lambda s: s.arm.tcp,
        actual_digital_input_bits=lambda s: s.signals.digital_inputs,
        actual_configurable_digital_input_bits=lambda s: s.signals.digital_inputs >> 8 & 0xFF,
        joint_temperatures=lambda s: s.arm.sample.T_motor,
        actual_execution_time=execution_time,
        target_execution_time=execution_time,
        robot_mode=lambda s: s.modes.robot_mode,
        joint_mode=lambda s: [s.modes.joint_mode] * 6,
        safety_mode=lambda s: s.modes.safety_mode,
        safety_status=lambda s: s.modes.safety_mode,
        actual_tool_accelerometer=lambda s: s.arm.sample.accelerometer,
        speed_scaling=lambda s: s.speed_scaling,
        target_speed_fraction=lambda s: s.speed_fraction,
        time_scale_source=lambda s: s.time_scale_source,
        actual_momentum=lambda s: s.arm.sample.momentum,
        actual_main_voltage=lambda s: MAIN_VOLTAGE,
        actual_robot_voltage=lambda s: ROBOT_VOLTAGE if s.modes.is_powered else 0.0,
        actual_robot_current=robot_current,
        actual_robot_energy_consumed=lambda s: ROBOT_VOLTAGE * _IDLE * (UPTIME + s.time),
        actual_robot_braking_energy_dissipated=lambda s: 0.0,
        actual_joint_voltage=lambda s: s.arm.sample.V_actual,
        actual_digital_output_bits=lambda s: s.signals.digital_outputs,
        actual_configurable_digital_output_bits=lambda s: s.signals.digital_outputs >> 8 & 0xFF,
        runtime_state=lambda s: s.modes.program_state,
        elbow_position=lambda s: s.arm.sample.elbow_position,
        elbow_velocity=lambda s: s.arm.sample.elbow_velocity,
        robot_status_bits=_robot_status,
        safety_status_bits=lambda s: int(_SAFETY_BITS[s.modes.stop]),
        analog_io_types=_analog_types,
        standard_analog_input0=lambda s: s.signals.analog_inputs[0],
        standard_analog_input1=lambda s: s.signals.analog_inputs[1],
        standard_analog_output0=lambda s: s.signals.analog_outputs[0],
        standard_analog_output1=lambda s: s.signals.analog_outputs[1],
        io_current=lambda s: 0.0,
        euromap67_input_bits=lambda s: 0,
        euromap67_output_bits=lambda s: 0,
        euromap67_24V_voltage=lambda s: 0.0,
        euromap67_24V_current=lambda s: 0.0,
        tool_mode=lambda s: s.modes.tool_mode,
        tool_analog_input_types=_tool_analog_types,
        tool_analog_input0=lambda s: s.signals.analog_inputs[2],
        tool_analog_input1=lambda s: s.signals.analog_inputs[3],
        tool_output_voltage=lambda s: s.signals.tool_output_voltage if s.modes.is_powered else 0,
        tool_output_current=lambda s: 0.006 if s.modes.is_powered else 0.0,
        tool_temperature=lambda s: s.arm.sample.T_motor[5] + 15.0,
        tool_output_mode=lambda s: s.signals.tool_output_mode,
        tool_digital_output0_mode=lambda s: s.signals.tool_digital_output_modes[0],
        tool_digital_output1_mode=lambda s: s.signals.tool_digital_output_modes[1],
        tcp_force_scalar=lambda s: math.hypot(*s.arm.sample.force[:3]),
        joint_position_deviation_ratio=lambda s: 0.0,
        collision_detection_ratio=lambda s: 0.0,
        ft_raw_wrench=lambda s: s.arm.raw_wrench,
        wrench_calc_from_currents=lambda s: s.arm.sample.force,
        payload=lambda s: s.arm.payload,
        payload_cog=lambda s: s.arm.payload_cog,
        payload_inertia=lambda s: s.arm.payload_inertia,
        script_control_line=lambda s: 0,
        target_gravity=lambda s: s.arm.gravity,
        target_base_acceleration=lambda s: [0.0] * 6,
        target_base_wrench=lambda s: [0.0] * 6,
        control_step=lambda s: s.uptime,
        encoder0_raw=lambda s: 0,
        encoder1_raw=lambda s: 0,
    )
    found |= _registers("output", lambda s: s.registers.outputs)
    return found | _registers("input", lambda s: s.registers.inputs)


def _registers(direction: str, bank: Callable[[ControllerState], Bank]) -> dict[str, Output]:
    """Return the registers of one direction."""

    def word(first: int) -> Output:
        return lambda s: bank(s).bits >> first & _WORD

    def bit(number: int) -> Output:
        return lambda s: bool(bank(s).bits >> number & 1)

    def integer(number: int) -> Output:
        return lambda s: bank(s).integers[number]

    def double(number: int) -> Output:
        return lambda s: bank(s).floats[number]

    found = {f"{direction}_bit_registers0_to_31": word(0), f"{direction}_bit_registers32_to_63": word(32)}
    found |= {f"{direction}_bit_register_{number}": bit(number) for number in range(64, BITS)}
    found |= {f"{direction}_int_register_{number}": integer(number) for number in range(NUMBERS)}
    return found | {f"{direction}_double_register_{number}": double(number) for number in range(NUMBERS)}


#: Name of an output -> function that reads its value from the state.
OUTPUT_VALUES: Mapping[str, Output] = MappingProxyType(_outputs())


# -- inputs ----------------------------------------------------------------------------------------------

Change = Callable[[ControllerState, Mapping[str, Any]], None]


def write_inputs(state: ControllerState, values: Mapping[str, Any]) -> None:
    """Apply the inputs of one data package, by name.

    All inputs keep their last value. When a package contains any input of a group of outputs, the controller applies
    the group's current mask and values. It is assumed that a mask and its values can arrive in different recipes. The
    speed slider moves once for each package in which its mask is 1. A value of NaN moves neither the slider nor an
    analogue output.

    In local control, an e-Series controller accepts values for registers, but not for outputs and the speed slider.
    This is a cautious assumption: it is known only that such a controller accepts no URScript.
    """
    state.rtde_inputs.update(values)
    for change in dict.fromkeys(_CHANGES[name] for name in values):
        if not state.is_local or change is _input_registers:
            change(state, values)


def _slider(state: ControllerState, values: Mapping[str, Any]) -> None:
    fraction = state.rtde_inputs.get("speed_slider_fraction", 0.0)
    if values.get("speed_slider_mask") == 1 and not math.isnan(fraction):
        state.speed_fraction = min(max(fraction, 0.0), 1.0)


def _analog(state: ControllerState, values: Mapping[str, Any]) -> None:
    held, signals = state.rtde_inputs, state.signals
    for at in (0, 1):
        level = held.get(f"standard_analog_output_{at}", 0.0)
        if held.get("standard_analog_output_mask", 0) >> at & 1 and not math.isnan(level):
            signals.analog_output_domains[at] = held.get("standard_analog_output_type", 0) >> at & 1
            signals.set_analog_fraction(at, min(max(level, 0.0), 1.0))


def _digital(group: str, first: int, count: int) -> Change:
    """Return a function that sets the outputs of a group. Only outputs in the group's mask are set.

    The function sets `count` bits of the digital outputs, beginning at bit `first`.
    """

    def change(state: ControllerState, values: Mapping[str, Any]) -> None:
        held, signals = state.rtde_inputs, state.signals
        mask = held.get(f"{group}_digital_output_mask", 0) & (1 << count) - 1
        levels = held.get(f"{group}_digital_output", 0) & mask
        signals.digital_outputs = signals.digital_outputs & ~(mask << first) | levels << first

    return change


def _force(state: ControllerState, values: Mapping[str, Any]) -> None:
    state.arm.external_force = values["external_force_torque"]


def _input_registers(state: ControllerState, values: Mapping[str, Any]) -> None:
    bank = state.registers.inputs
    for name, value in values.items():
        kind, at = _REGISTERS.get(name, ("", 0))
        if kind == "word":
            bank.bits = bank.bits & ~(_WORD << at) | value << at
        elif kind == "bit":
            bank.set_bit(at, value)
        elif kind == "int":
            bank.integers[at] = value
        elif kind == "double":
            bank.floats[at] = value


def _register_of(name: str) -> tuple[str, int] | None:
    """Return the kind and the number of an input register; None if the input is not a register.

    The kind is "word" (with the number of its first bit), "bit", "int" or "double".
    """
    if not name.startswith("input_"):
        return None
    if "_bit_registers" in name:
        return "word", 0 if name.endswith("_31") else 32
    _, kind, _, number = name.split("_")
    return kind, int(number)


_REGISTERS = {name: register for name in INPUTS if (register := _register_of(name)) is not None}
_GROUPS: dict[str, Change] = {
    "speed_slider_": _slider,
    "standard_digital_": _digital("standard", 0, 8),
    "configurable_digital_": _digital("configurable", 8, 8),
    "tool_digital_": _digital("tool", 16, 2),
    "standard_analog_": _analog,
    "external_force_": _force,
    "input_": _input_registers,
}
_CHANGES = {name: change for name in INPUTS for begin, change in _GROUPS.items() if name.startswith(begin)}
