"""Names of the same quantity on the real-time interface, in RTDE, and on the primary interface."""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import Elsewhere

if TYPE_CHECKING:
    from linkcore.wire.packet import State

#: One row for each quantity: its names on the real-time interface, in RTDE, and on the primary interface.
_TABLE = """
    q_actual                actual_q                    joint_data.q_actual
    q_target                target_q                    joint_data.q_target
    qd_actual               actual_qd                   joint_data.qd_actual
    qd_target               target_qd                   -
    qdd_target              target_qdd                  -
    I_target                target_current              -
    I_actual                actual_current              joint_data.I_actual
    I_control               joint_control_output        -
    M_target                target_moment               -
    V_actual                actual_joint_voltage        joint_data.V_actual
    motor_temperatures      joint_temperatures          joint_data.T_motor
    joint_modes             joint_mode                  joint_data.joint_modes
    tool_vector_actual      actual_TCP_pose             cartesian_info.X
    tool_vector_target      target_TCP_pose             -
    tcp_speed_actual        actual_TCP_speed            -
    tcp_speed_target        target_TCP_speed            -
    tcp_force               actual_TCP_force            force_mode_data.Fx
    tool_accelerometer      actual_tool_accelerometer   -
    time                    timestamp                   robot_mode_data.timestamp
    controller_timer        actual_execution_time       -
    robot_mode              robot_mode                  robot_mode_data.robot_mode
    safety_mode             safety_mode                 masterboard_data.safety_mode
    speed_scaling           speed_scaling               robot_mode_data.speed_scaling
    linear_momentum_norm    actual_momentum             -
    digital_input_bits      actual_digital_input_bits   masterboard_data.digital_input_bits
    digital_output_bits     actual_digital_output_bits  masterboard_data.digital_output_bits
    V_main                  actual_main_voltage         -
    V_robot                 actual_robot_voltage        masterboard_data.robot_voltage_48V
    I_robot                 actual_robot_current        masterboard_data.robot_current
    program_state           runtime_state               -
    payload_mass            payload                     -
    payload_cog             payload_cog                 -
    payload_inertia         payload_inertia             -
    elbow_position          elbow_position              -
    elbow_velocity          elbow_velocity              -
"""
INTERFACES = ("realtime", "rtde", "primary")
QUANTITIES = tuple(tuple(line.split()) for line in _TABLE.strip().splitlines())
#: Short names of real-time quantities that other libraries and programs use.
_SHORT = {"q": "q_actual", "qd": "qd_actual", "tcp": "tool_vector_actual", "pose": "tool_vector_actual"}


def name_on(interface: str, name: str) -> str | None:
    """Return the name of a quantity on one interface, given its name on any interface; None if it is unknown.

    >>> name_on("realtime", "actual_q"), name_on("rtde", "q_actual")
    ('q_actual', 'actual_q')
    >>> name_on("primary", "actual_q")
    'joint_data.q_actual'

    Args:
        interface: Interface of the returned name: one of `INTERFACES`.
        name: Name of the quantity on any interface.
    """
    at = INTERFACES.index(interface)
    for row in QUANTITIES:
        if name in (*row, row[2].rpartition(".")[2]) or _SHORT.get(name) == row[0]:
            return None if row[at] == "-" else row[at]
    return None


def hint_other_interfaces(kind: type[State], interface: str) -> None:
    """Let a packet class raise an error with the correct name, for each name of a field on another interface."""
    for name in {*_SHORT, *(part for row in QUANTITIES for part in (*row[:2], row[2].rpartition(".")[2]))}:
        own = name_on(interface, name)
        field = None if own is None else own.rpartition(".")[2] if kind.FIELDS else own
        is_there = not kind.FIELDS or interface == "rtde" or field in kind.FIELDS
        if field not in (None, name) and is_there and not hasattr(kind, name):
            setattr(kind, name, Elsewhere(name, str(field)))
