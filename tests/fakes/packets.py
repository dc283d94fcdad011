"""Factory for the packets that fakes send: an arm that is powered on, at rest and in normal mode.

A packet class of the library fills every omitted field with zero. A fake that relied on this would silently report an
unpowered arm. In this module each field has a stated value, and `packet` rejects a field without one.
"""

from __future__ import annotations

from typing import Any, TypeVar

from linkcore.wire.state import State
from urlink.protocol.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.primary.robot_state import CartesianInfo, MasterboardData, RobotModeData, ToolData
from urlink.protocol.realtime.packets import RealtimeState

S = TypeVar("S", bound=State)

_SIX_ZEROS = (0.0,) * 6
_THREE_ZEROS = (0.0,) * 3

#: Values of all fields of each packet class for an arm at rest, in the unit of the field.
AT_REST: dict[type[State], dict[str, Any]] = {
    RealtimeState: {
        "time": 0.0,
        "q_target": _SIX_ZEROS,
        "qd_target": _SIX_ZEROS,
        "qdd_target": _SIX_ZEROS,
        "I_target": _SIX_ZEROS,
        "M_target": _SIX_ZEROS,
        "q_actual": _SIX_ZEROS,
        "qd_actual": _SIX_ZEROS,
        "I_actual": _SIX_ZEROS,
        "I_control": _SIX_ZEROS,
        "tool_vector_actual": _SIX_ZEROS,
        "tcp_speed_actual": _SIX_ZEROS,
        "tcp_force": _SIX_ZEROS,
        "tool_vector_target": _SIX_ZEROS,
        "tcp_speed_target": _SIX_ZEROS,
        "digital_input_bits": 0,
        "motor_temperatures": (25.0,) * 6,
        "controller_timer": 0.0,
        "test_value": 0.0,
        "robot_mode": RobotMode.RUNNING,
        "joint_modes": (253,) * 6,
        "safety_mode": SafetyMode.NORMAL,
        "reserved_a": _SIX_ZEROS,
        "tool_accelerometer": (0.0, 0.0, -9.82),
        "unused": (0.0,) * 15,
        "reserved_b": _SIX_ZEROS,
        "speed_scaling": 1.0,
        "linear_momentum_norm": 0.0,
        "reserved_c": 0.0,
        "reserved_d": 0.0,
        "V_main": 48.0,
        "V_robot": 48.0,
        "I_robot": 0.5,
        "V_actual": (48.0,) * 6,
        "digital_output_bits": 0,
        "program_state": 1,
        "elbow_position": _THREE_ZEROS,
        "elbow_velocity": _THREE_ZEROS,
        "safety_status": SafetyMode.NORMAL,
        "reserved_e": _THREE_ZEROS,
        "payload_mass": 0.0,
        "payload_cog": _THREE_ZEROS,
        "payload_inertia": _SIX_ZEROS,
    },
    RobotModeData: {
        "timestamp": 0,
        "is_robot_connected": True,
        "is_robot_enabled": True,
        "is_power_on": True,
        "is_emergency_stopped": False,
        "is_protective_stopped": False,
        "is_program_running": False,
        "is_program_paused": False,
        "robot_mode": RobotMode.RUNNING,
        "control_mode": 0,
        "target_speed_fraction": 1.0,
        "speed_scaling": 1.0,
        "target_speed_fraction_limit": 1.0,
        "reserved": 0,
    },
    MasterboardData: {
        "digital_input_bits": 0,
        "digital_output_bits": 0,
        "analog_input_range_0": 0,
        "analog_input_range_1": 0,
        "analog_input_0": 0.0,
        "analog_input_1": 0.0,
        "analog_output_domain_0": 0,
        "analog_output_domain_1": 0,
        "analog_output_0": 0.0,
        "analog_output_1": 0.0,
        "masterboard_temperature": 40.0,
        "robot_voltage_48V": 48.0,
        "robot_current": 0.5,
        "master_io_current": 0.1,
        "master_safety_state": MasterSafetyState.OK,
        "master_on_off_state": 0,
        "safety_mode": SafetyMode.NORMAL,
        "is_in_reduced_mode": False,
        "is_euromap_installed": False,
        "euromap_input_bits": 0,
        "euromap_output_bits": 0,
        "euromap_voltage_24V": 0.0,
        "euromap_current": 0.0,
        "reserved_checksum": 0,
        "operational_mode_selector_input": 0,
        "three_position_enabling_device_input": 0,
        "reserved": 0,
    },
    ToolData: {
        "analog_input_range_2": 0,
        "analog_input_range_3": 0,
        "analog_input_2": 0.0,
        "analog_input_3": 0.0,
        "tool_voltage_48V": 48.0,
        "tool_output_voltage": 0,
        "tool_current": 0.1,
        "tool_temperature": 30.0,
        "tool_mode": 253,
    },
    CartesianInfo: dict.fromkeys(
        [*("X", "Y", "Z", "Rx", "Ry", "Rz"), *(f"tcp_offset_{axis}" for axis in ("X", "Y", "Z", "Rx", "Ry", "Rz"))], 0.0
    ),
}


def packet(kind: type[S], version: Firmware | tuple[int, int], **fields: Any) -> S:
    """Build a packet of an arm at rest, with `fields` in place of its values.

    Raises:
        BadValue: If the packet has no field of a given name in this version, or if `AT_REST` misses one of its fields.
    """
    layout = kind.LAYOUTS.of(version)
    at_rest = {name: value for name, value in AT_REST[kind].items() if name in layout.places}
    if "robot_mode" in at_rest and Firmware(*version).is_cb2:
        at_rest["robot_mode"] = RobotModeCB2.RUNNING
    values = {**at_rest, **fields}
    layout.check_complete(values)
    return kind(version, **values)
