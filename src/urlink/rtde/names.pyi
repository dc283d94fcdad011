"""The names of all variables, and what type each has in a state: for type checkers and editors only.

Made of `urlink.protocol.rtde.variables`, which is the table; a test holds the two equal.
"""

# fmt: off

from __future__ import annotations

from typing import Literal

from linkcore.wire.packet import Vector

from ..protocol.enums import (
    JointMode,
    ProgramState,
    RobotMode,
    SafetyMode,
    TimeScaleSource,
    ToolDigitalOutputMode,
    ToolMode,
    ToolOutputMode,
)
from ..protocol.rtde.recipes import Outputs

__all__ = ["AnyOutputs", "InputName", "OutputName"]

OutputName = Literal[
    "timestamp", "target_q", "target_qd", "target_qdd", "target_current", "target_moment", "actual_q", "actual_qd",
    "actual_current", "actual_current_window", "actual_current_as_torque", "joint_control_output", "actual_TCP_pose",
    "actual_TCP_speed", "actual_TCP_acceleration", "actual_TCP_force", "target_TCP_pose", "target_TCP_speed",
    "target_TCP_acceleration", "tcp_offset", "actual_digital_input_bits", "actual_configurable_digital_input_bits",
    "joint_temperatures", "actual_execution_time", "target_execution_time", "robot_mode", "joint_mode", "safety_mode",
    "safety_status", "actual_tool_accelerometer", "speed_scaling", "target_speed_fraction", "time_scale_source",
    "actual_momentum", "actual_main_voltage", "actual_robot_voltage", "actual_robot_current",
    "actual_robot_energy_consumed", "actual_robot_braking_energy_dissipated", "actual_joint_voltage",
    "actual_digital_output_bits", "actual_configurable_digital_output_bits", "runtime_state", "elbow_position",
    "elbow_velocity", "robot_status_bits", "safety_status_bits", "analog_io_types", "standard_analog_input0",
    "standard_analog_input1", "standard_analog_output0", "standard_analog_output1", "io_current",
    "euromap67_input_bits", "euromap67_output_bits", "euromap67_24V_voltage", "euromap67_24V_current", "tool_mode",
    "tool_analog_input_types", "tool_analog_input0", "tool_analog_input1", "tool_output_voltage", "tool_output_current",
    "tool_temperature", "tool_output_mode", "tool_digital_output0_mode", "tool_digital_output1_mode",
    "tcp_force_scalar", "joint_position_deviation_ratio", "collision_detection_ratio", "ft_raw_wrench",
    "wrench_calc_from_currents", "payload", "payload_cog", "payload_inertia", "script_control_line", "target_gravity",
    "target_base_acceleration", "target_base_wrench", "control_step", "encoder0_raw", "encoder1_raw",
    "output_bit_registers0_to_31", "output_bit_registers32_to_63", "output_bit_register_64", "output_bit_register_65",
    "output_bit_register_66", "output_bit_register_67", "output_bit_register_68", "output_bit_register_69",
    "output_bit_register_70", "output_bit_register_71", "output_bit_register_72", "output_bit_register_73",
    "output_bit_register_74", "output_bit_register_75", "output_bit_register_76", "output_bit_register_77",
    "output_bit_register_78", "output_bit_register_79", "output_bit_register_80", "output_bit_register_81",
    "output_bit_register_82", "output_bit_register_83", "output_bit_register_84", "output_bit_register_85",
    "output_bit_register_86", "output_bit_register_87", "output_bit_register_88", "output_bit_register_89",
    "output_bit_register_90", "output_bit_register_91", "output_bit_register_92", "output_bit_register_93",
    "output_bit_register_94", "output_bit_register_95", "output_bit_register_96", "output_bit_register_97",
    "output_bit_register_98", "output_bit_register_99", "output_bit_register_100", "output_bit_register_101",
    "output_bit_register_102", "output_bit_register_103", "output_bit_register_104", "output_bit_register_105",
    "output_bit_register_106", "output_bit_register_107", "output_bit_register_108", "output_bit_register_109",
    "output_bit_register_110", "output_bit_register_111", "output_bit_register_112", "output_bit_register_113",
    "output_bit_register_114", "output_bit_register_115", "output_bit_register_116", "output_bit_register_117",
    "output_bit_register_118", "output_bit_register_119", "output_bit_register_120", "output_bit_register_121",
    "output_bit_register_122", "output_bit_register_123", "output_bit_register_124", "output_bit_register_125",
    "output_bit_register_126", "output_bit_register_127", "output_int_register_0", "output_int_register_1",
    "output_int_register_2", "output_int_register_3", "output_int_register_4", "output_int_register_5",
    "output_int_register_6", "output_int_register_7", "output_int_register_8", "output_int_register_9",
    "output_int_register_10", "output_int_register_11", "output_int_register_12", "output_int_register_13",
    "output_int_register_14", "output_int_register_15", "output_int_register_16", "output_int_register_17",
    "output_int_register_18", "output_int_register_19", "output_int_register_20", "output_int_register_21",
    "output_int_register_22", "output_int_register_23", "output_int_register_24", "output_int_register_25",
    "output_int_register_26", "output_int_register_27", "output_int_register_28", "output_int_register_29",
    "output_int_register_30", "output_int_register_31", "output_int_register_32", "output_int_register_33",
    "output_int_register_34", "output_int_register_35", "output_int_register_36", "output_int_register_37",
    "output_int_register_38", "output_int_register_39", "output_int_register_40", "output_int_register_41",
    "output_int_register_42", "output_int_register_43", "output_int_register_44", "output_int_register_45",
    "output_int_register_46", "output_int_register_47", "output_double_register_0", "output_double_register_1",
    "output_double_register_2", "output_double_register_3", "output_double_register_4", "output_double_register_5",
    "output_double_register_6", "output_double_register_7", "output_double_register_8", "output_double_register_9",
    "output_double_register_10", "output_double_register_11", "output_double_register_12", "output_double_register_13",
    "output_double_register_14", "output_double_register_15", "output_double_register_16", "output_double_register_17",
    "output_double_register_18", "output_double_register_19", "output_double_register_20", "output_double_register_21",
    "output_double_register_22", "output_double_register_23", "output_double_register_24", "output_double_register_25",
    "output_double_register_26", "output_double_register_27", "output_double_register_28", "output_double_register_29",
    "output_double_register_30", "output_double_register_31", "output_double_register_32", "output_double_register_33",
    "output_double_register_34", "output_double_register_35", "output_double_register_36", "output_double_register_37",
    "output_double_register_38", "output_double_register_39", "output_double_register_40", "output_double_register_41",
    "output_double_register_42", "output_double_register_43", "output_double_register_44", "output_double_register_45",
    "output_double_register_46", "output_double_register_47", "input_bit_registers0_to_31",
    "input_bit_registers32_to_63", "input_bit_register_64", "input_bit_register_65", "input_bit_register_66",
    "input_bit_register_67", "input_bit_register_68", "input_bit_register_69", "input_bit_register_70",
    "input_bit_register_71", "input_bit_register_72", "input_bit_register_73", "input_bit_register_74",
    "input_bit_register_75", "input_bit_register_76", "input_bit_register_77", "input_bit_register_78",
    "input_bit_register_79", "input_bit_register_80", "input_bit_register_81", "input_bit_register_82",
    "input_bit_register_83", "input_bit_register_84", "input_bit_register_85", "input_bit_register_86",
    "input_bit_register_87", "input_bit_register_88", "input_bit_register_89", "input_bit_register_90",
    "input_bit_register_91", "input_bit_register_92", "input_bit_register_93", "input_bit_register_94",
    "input_bit_register_95", "input_bit_register_96", "input_bit_register_97", "input_bit_register_98",
    "input_bit_register_99", "input_bit_register_100", "input_bit_register_101", "input_bit_register_102",
    "input_bit_register_103", "input_bit_register_104", "input_bit_register_105", "input_bit_register_106",
    "input_bit_register_107", "input_bit_register_108", "input_bit_register_109", "input_bit_register_110",
    "input_bit_register_111", "input_bit_register_112", "input_bit_register_113", "input_bit_register_114",
    "input_bit_register_115", "input_bit_register_116", "input_bit_register_117", "input_bit_register_118",
    "input_bit_register_119", "input_bit_register_120", "input_bit_register_121", "input_bit_register_122",
    "input_bit_register_123", "input_bit_register_124", "input_bit_register_125", "input_bit_register_126",
    "input_bit_register_127", "input_int_register_0", "input_int_register_1", "input_int_register_2",
    "input_int_register_3", "input_int_register_4", "input_int_register_5", "input_int_register_6",
    "input_int_register_7", "input_int_register_8", "input_int_register_9", "input_int_register_10",
    "input_int_register_11", "input_int_register_12", "input_int_register_13", "input_int_register_14",
    "input_int_register_15", "input_int_register_16", "input_int_register_17", "input_int_register_18",
    "input_int_register_19", "input_int_register_20", "input_int_register_21", "input_int_register_22",
    "input_int_register_23", "input_int_register_24", "input_int_register_25", "input_int_register_26",
    "input_int_register_27", "input_int_register_28", "input_int_register_29", "input_int_register_30",
    "input_int_register_31", "input_int_register_32", "input_int_register_33", "input_int_register_34",
    "input_int_register_35", "input_int_register_36", "input_int_register_37", "input_int_register_38",
    "input_int_register_39", "input_int_register_40", "input_int_register_41", "input_int_register_42",
    "input_int_register_43", "input_int_register_44", "input_int_register_45", "input_int_register_46",
    "input_int_register_47", "input_double_register_0", "input_double_register_1", "input_double_register_2",
    "input_double_register_3", "input_double_register_4", "input_double_register_5", "input_double_register_6",
    "input_double_register_7", "input_double_register_8", "input_double_register_9", "input_double_register_10",
    "input_double_register_11", "input_double_register_12", "input_double_register_13", "input_double_register_14",
    "input_double_register_15", "input_double_register_16", "input_double_register_17", "input_double_register_18",
    "input_double_register_19", "input_double_register_20", "input_double_register_21", "input_double_register_22",
    "input_double_register_23", "input_double_register_24", "input_double_register_25", "input_double_register_26",
    "input_double_register_27", "input_double_register_28", "input_double_register_29", "input_double_register_30",
    "input_double_register_31", "input_double_register_32", "input_double_register_33", "input_double_register_34",
    "input_double_register_35", "input_double_register_36", "input_double_register_37", "input_double_register_38",
    "input_double_register_39", "input_double_register_40", "input_double_register_41", "input_double_register_42",
    "input_double_register_43", "input_double_register_44", "input_double_register_45", "input_double_register_46",
    "input_double_register_47",
]

InputName = Literal[
    "speed_slider_mask", "speed_slider_fraction", "standard_digital_output_mask", "standard_digital_output",
    "configurable_digital_output_mask", "configurable_digital_output", "tool_digital_output_mask",
    "tool_digital_output", "standard_analog_output_mask", "standard_analog_output_type", "standard_analog_output_0",
    "standard_analog_output_1", "external_force_torque", "input_bit_registers0_to_31", "input_bit_registers32_to_63",
    "input_bit_register_64", "input_bit_register_65", "input_bit_register_66", "input_bit_register_67",
    "input_bit_register_68", "input_bit_register_69", "input_bit_register_70", "input_bit_register_71",
    "input_bit_register_72", "input_bit_register_73", "input_bit_register_74", "input_bit_register_75",
    "input_bit_register_76", "input_bit_register_77", "input_bit_register_78", "input_bit_register_79",
    "input_bit_register_80", "input_bit_register_81", "input_bit_register_82", "input_bit_register_83",
    "input_bit_register_84", "input_bit_register_85", "input_bit_register_86", "input_bit_register_87",
    "input_bit_register_88", "input_bit_register_89", "input_bit_register_90", "input_bit_register_91",
    "input_bit_register_92", "input_bit_register_93", "input_bit_register_94", "input_bit_register_95",
    "input_bit_register_96", "input_bit_register_97", "input_bit_register_98", "input_bit_register_99",
    "input_bit_register_100", "input_bit_register_101", "input_bit_register_102", "input_bit_register_103",
    "input_bit_register_104", "input_bit_register_105", "input_bit_register_106", "input_bit_register_107",
    "input_bit_register_108", "input_bit_register_109", "input_bit_register_110", "input_bit_register_111",
    "input_bit_register_112", "input_bit_register_113", "input_bit_register_114", "input_bit_register_115",
    "input_bit_register_116", "input_bit_register_117", "input_bit_register_118", "input_bit_register_119",
    "input_bit_register_120", "input_bit_register_121", "input_bit_register_122", "input_bit_register_123",
    "input_bit_register_124", "input_bit_register_125", "input_bit_register_126", "input_bit_register_127",
    "input_int_register_0", "input_int_register_1", "input_int_register_2", "input_int_register_3",
    "input_int_register_4", "input_int_register_5", "input_int_register_6", "input_int_register_7",
    "input_int_register_8", "input_int_register_9", "input_int_register_10", "input_int_register_11",
    "input_int_register_12", "input_int_register_13", "input_int_register_14", "input_int_register_15",
    "input_int_register_16", "input_int_register_17", "input_int_register_18", "input_int_register_19",
    "input_int_register_20", "input_int_register_21", "input_int_register_22", "input_int_register_23",
    "input_int_register_24", "input_int_register_25", "input_int_register_26", "input_int_register_27",
    "input_int_register_28", "input_int_register_29", "input_int_register_30", "input_int_register_31",
    "input_int_register_32", "input_int_register_33", "input_int_register_34", "input_int_register_35",
    "input_int_register_36", "input_int_register_37", "input_int_register_38", "input_int_register_39",
    "input_int_register_40", "input_int_register_41", "input_int_register_42", "input_int_register_43",
    "input_int_register_44", "input_int_register_45", "input_int_register_46", "input_int_register_47",
    "input_double_register_0", "input_double_register_1", "input_double_register_2", "input_double_register_3",
    "input_double_register_4", "input_double_register_5", "input_double_register_6", "input_double_register_7",
    "input_double_register_8", "input_double_register_9", "input_double_register_10", "input_double_register_11",
    "input_double_register_12", "input_double_register_13", "input_double_register_14", "input_double_register_15",
    "input_double_register_16", "input_double_register_17", "input_double_register_18", "input_double_register_19",
    "input_double_register_20", "input_double_register_21", "input_double_register_22", "input_double_register_23",
    "input_double_register_24", "input_double_register_25", "input_double_register_26", "input_double_register_27",
    "input_double_register_28", "input_double_register_29", "input_double_register_30", "input_double_register_31",
    "input_double_register_32", "input_double_register_33", "input_double_register_34", "input_double_register_35",
    "input_double_register_36", "input_double_register_37", "input_double_register_38", "input_double_register_39",
    "input_double_register_40", "input_double_register_41", "input_double_register_42", "input_double_register_43",
    "input_double_register_44", "input_double_register_45", "input_double_register_46", "input_double_register_47",
]


class AnyOutputs(Outputs):
    """A state of outputs that were asked for by name: these are their types. It has no others."""

    timestamp: float
    target_q: Vector
    target_qd: Vector
    target_qdd: Vector
    target_current: Vector
    target_moment: Vector
    actual_q: Vector
    actual_qd: Vector
    actual_current: Vector
    actual_current_window: Vector
    actual_current_as_torque: Vector
    joint_control_output: Vector
    actual_TCP_pose: Vector
    actual_TCP_speed: Vector
    actual_TCP_acceleration: Vector
    actual_TCP_force: Vector
    target_TCP_pose: Vector
    target_TCP_speed: Vector
    target_TCP_acceleration: Vector
    tcp_offset: Vector
    actual_digital_input_bits: int
    actual_configurable_digital_input_bits: int
    joint_temperatures: Vector
    actual_execution_time: float
    target_execution_time: float
    robot_mode: RobotMode
    joint_mode: tuple[JointMode, ...]
    safety_mode: SafetyMode
    safety_status: SafetyMode
    actual_tool_accelerometer: Vector
    speed_scaling: float
    target_speed_fraction: float
    time_scale_source: TimeScaleSource
    actual_momentum: float
    actual_main_voltage: float
    actual_robot_voltage: float
    actual_robot_current: float
    actual_robot_energy_consumed: float
    actual_robot_braking_energy_dissipated: float
    actual_joint_voltage: Vector
    actual_digital_output_bits: int
    actual_configurable_digital_output_bits: int
    runtime_state: ProgramState
    elbow_position: Vector
    elbow_velocity: Vector
    robot_status_bits: int
    safety_status_bits: int
    analog_io_types: int
    standard_analog_input0: float
    standard_analog_input1: float
    standard_analog_output0: float
    standard_analog_output1: float
    io_current: float
    euromap67_input_bits: int
    euromap67_output_bits: int
    euromap67_24V_voltage: float
    euromap67_24V_current: float
    tool_mode: ToolMode
    tool_analog_input_types: int
    tool_analog_input0: float
    tool_analog_input1: float
    tool_output_voltage: int
    tool_output_current: float
    tool_temperature: float
    tool_output_mode: ToolOutputMode
    tool_digital_output0_mode: ToolDigitalOutputMode
    tool_digital_output1_mode: ToolDigitalOutputMode
    tcp_force_scalar: float
    joint_position_deviation_ratio: float
    collision_detection_ratio: float
    ft_raw_wrench: Vector
    wrench_calc_from_currents: Vector
    payload: float
    payload_cog: Vector
    payload_inertia: Vector
    script_control_line: int
    target_gravity: Vector
    target_base_acceleration: Vector
    target_base_wrench: Vector
    control_step: int
    encoder0_raw: int
    encoder1_raw: int
    output_bit_registers0_to_31: int
    output_bit_registers32_to_63: int
    output_bit_register_64: bool
    output_bit_register_65: bool
    output_bit_register_66: bool
    output_bit_register_67: bool
    output_bit_register_68: bool
    output_bit_register_69: bool
    output_bit_register_70: bool
    output_bit_register_71: bool
    output_bit_register_72: bool
    output_bit_register_73: bool
    output_bit_register_74: bool
    output_bit_register_75: bool
    output_bit_register_76: bool
    output_bit_register_77: bool
    output_bit_register_78: bool
    output_bit_register_79: bool
    output_bit_register_80: bool
    output_bit_register_81: bool
    output_bit_register_82: bool
    output_bit_register_83: bool
    output_bit_register_84: bool
    output_bit_register_85: bool
    output_bit_register_86: bool
    output_bit_register_87: bool
    output_bit_register_88: bool
    output_bit_register_89: bool
    output_bit_register_90: bool
    output_bit_register_91: bool
    output_bit_register_92: bool
    output_bit_register_93: bool
    output_bit_register_94: bool
    output_bit_register_95: bool
    output_bit_register_96: bool
    output_bit_register_97: bool
    output_bit_register_98: bool
    output_bit_register_99: bool
    output_bit_register_100: bool
    output_bit_register_101: bool
    output_bit_register_102: bool
    output_bit_register_103: bool
    output_bit_register_104: bool
    output_bit_register_105: bool
    output_bit_register_106: bool
    output_bit_register_107: bool
    output_bit_register_108: bool
    output_bit_register_109: bool
    output_bit_register_110: bool
    output_bit_register_111: bool
    output_bit_register_112: bool
    output_bit_register_113: bool
    output_bit_register_114: bool
    output_bit_register_115: bool
    output_bit_register_116: bool
    output_bit_register_117: bool
    output_bit_register_118: bool
    output_bit_register_119: bool
    output_bit_register_120: bool
    output_bit_register_121: bool
    output_bit_register_122: bool
    output_bit_register_123: bool
    output_bit_register_124: bool
    output_bit_register_125: bool
    output_bit_register_126: bool
    output_bit_register_127: bool
    output_int_register_0: int
    output_int_register_1: int
    output_int_register_2: int
    output_int_register_3: int
    output_int_register_4: int
    output_int_register_5: int
    output_int_register_6: int
    output_int_register_7: int
    output_int_register_8: int
    output_int_register_9: int
    output_int_register_10: int
    output_int_register_11: int
    output_int_register_12: int
    output_int_register_13: int
    output_int_register_14: int
    output_int_register_15: int
    output_int_register_16: int
    output_int_register_17: int
    output_int_register_18: int
    output_int_register_19: int
    output_int_register_20: int
    output_int_register_21: int
    output_int_register_22: int
    output_int_register_23: int
    output_int_register_24: int
    output_int_register_25: int
    output_int_register_26: int
    output_int_register_27: int
    output_int_register_28: int
    output_int_register_29: int
    output_int_register_30: int
    output_int_register_31: int
    output_int_register_32: int
    output_int_register_33: int
    output_int_register_34: int
    output_int_register_35: int
    output_int_register_36: int
    output_int_register_37: int
    output_int_register_38: int
    output_int_register_39: int
    output_int_register_40: int
    output_int_register_41: int
    output_int_register_42: int
    output_int_register_43: int
    output_int_register_44: int
    output_int_register_45: int
    output_int_register_46: int
    output_int_register_47: int
    output_double_register_0: float
    output_double_register_1: float
    output_double_register_2: float
    output_double_register_3: float
    output_double_register_4: float
    output_double_register_5: float
    output_double_register_6: float
    output_double_register_7: float
    output_double_register_8: float
    output_double_register_9: float
    output_double_register_10: float
    output_double_register_11: float
    output_double_register_12: float
    output_double_register_13: float
    output_double_register_14: float
    output_double_register_15: float
    output_double_register_16: float
    output_double_register_17: float
    output_double_register_18: float
    output_double_register_19: float
    output_double_register_20: float
    output_double_register_21: float
    output_double_register_22: float
    output_double_register_23: float
    output_double_register_24: float
    output_double_register_25: float
    output_double_register_26: float
    output_double_register_27: float
    output_double_register_28: float
    output_double_register_29: float
    output_double_register_30: float
    output_double_register_31: float
    output_double_register_32: float
    output_double_register_33: float
    output_double_register_34: float
    output_double_register_35: float
    output_double_register_36: float
    output_double_register_37: float
    output_double_register_38: float
    output_double_register_39: float
    output_double_register_40: float
    output_double_register_41: float
    output_double_register_42: float
    output_double_register_43: float
    output_double_register_44: float
    output_double_register_45: float
    output_double_register_46: float
    output_double_register_47: float
    input_bit_registers0_to_31: int
    input_bit_registers32_to_63: int
    input_bit_register_64: bool
    input_bit_register_65: bool
    input_bit_register_66: bool
    input_bit_register_67: bool
    input_bit_register_68: bool
    input_bit_register_69: bool
    input_bit_register_70: bool
    input_bit_register_71: bool
    input_bit_register_72: bool
    input_bit_register_73: bool
    input_bit_register_74: bool
    input_bit_register_75: bool
    input_bit_register_76: bool
    input_bit_register_77: bool
    input_bit_register_78: bool
    input_bit_register_79: bool
    input_bit_register_80: bool
    input_bit_register_81: bool
    input_bit_register_82: bool
    input_bit_register_83: bool
    input_bit_register_84: bool
    input_bit_register_85: bool
    input_bit_register_86: bool
    input_bit_register_87: bool
    input_bit_register_88: bool
    input_bit_register_89: bool
    input_bit_register_90: bool
    input_bit_register_91: bool
    input_bit_register_92: bool
    input_bit_register_93: bool
    input_bit_register_94: bool
    input_bit_register_95: bool
    input_bit_register_96: bool
    input_bit_register_97: bool
    input_bit_register_98: bool
    input_bit_register_99: bool
    input_bit_register_100: bool
    input_bit_register_101: bool
    input_bit_register_102: bool
    input_bit_register_103: bool
    input_bit_register_104: bool
    input_bit_register_105: bool
    input_bit_register_106: bool
    input_bit_register_107: bool
    input_bit_register_108: bool
    input_bit_register_109: bool
    input_bit_register_110: bool
    input_bit_register_111: bool
    input_bit_register_112: bool
    input_bit_register_113: bool
    input_bit_register_114: bool
    input_bit_register_115: bool
    input_bit_register_116: bool
    input_bit_register_117: bool
    input_bit_register_118: bool
    input_bit_register_119: bool
    input_bit_register_120: bool
    input_bit_register_121: bool
    input_bit_register_122: bool
    input_bit_register_123: bool
    input_bit_register_124: bool
    input_bit_register_125: bool
    input_bit_register_126: bool
    input_bit_register_127: bool
    input_int_register_0: int
    input_int_register_1: int
    input_int_register_2: int
    input_int_register_3: int
    input_int_register_4: int
    input_int_register_5: int
    input_int_register_6: int
    input_int_register_7: int
    input_int_register_8: int
    input_int_register_9: int
    input_int_register_10: int
    input_int_register_11: int
    input_int_register_12: int
    input_int_register_13: int
    input_int_register_14: int
    input_int_register_15: int
    input_int_register_16: int
    input_int_register_17: int
    input_int_register_18: int
    input_int_register_19: int
    input_int_register_20: int
    input_int_register_21: int
    input_int_register_22: int
    input_int_register_23: int
    input_int_register_24: int
    input_int_register_25: int
    input_int_register_26: int
    input_int_register_27: int
    input_int_register_28: int
    input_int_register_29: int
    input_int_register_30: int
    input_int_register_31: int
    input_int_register_32: int
    input_int_register_33: int
    input_int_register_34: int
    input_int_register_35: int
    input_int_register_36: int
    input_int_register_37: int
    input_int_register_38: int
    input_int_register_39: int
    input_int_register_40: int
    input_int_register_41: int
    input_int_register_42: int
    input_int_register_43: int
    input_int_register_44: int
    input_int_register_45: int
    input_int_register_46: int
    input_int_register_47: int
    input_double_register_0: float
    input_double_register_1: float
    input_double_register_2: float
    input_double_register_3: float
    input_double_register_4: float
    input_double_register_5: float
    input_double_register_6: float
    input_double_register_7: float
    input_double_register_8: float
    input_double_register_9: float
    input_double_register_10: float
    input_double_register_11: float
    input_double_register_12: float
    input_double_register_13: float
    input_double_register_14: float
    input_double_register_15: float
    input_double_register_16: float
    input_double_register_17: float
    input_double_register_18: float
    input_double_register_19: float
    input_double_register_20: float
    input_double_register_21: float
    input_double_register_22: float
    input_double_register_23: float
    input_double_register_24: float
    input_double_register_25: float
    input_double_register_26: float
    input_double_register_27: float
    input_double_register_28: float
    input_double_register_29: float
    input_double_register_30: float
    input_double_register_31: float
    input_double_register_32: float
    input_double_register_33: float
    input_double_register_34: float
    input_double_register_35: float
    input_double_register_36: float
    input_double_register_37: float
    input_double_register_38: float
    input_double_register_39: float
    input_double_register_40: float
    input_double_register_41: float
    input_double_register_42: float
    input_double_register_43: float
    input_double_register_44: float
    input_double_register_45: float
    input_double_register_46: float
    input_double_register_47: float
