"""Real-time interface, port 30003. It sends one packet per cycle, and nothing else at the beginning of a connection.

See docs/protocols/realtime.md.
"""

from __future__ import annotations

from collections.abc import Callable

from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState

from ..rtde_variables import MAIN_VOLTAGE, ROBOT_VOLTAGE, execution_time, robot_current
from ..state import ControllerState
from .interface import Fields, Form, Interface, InterfaceClient, ScriptReceiver


class RealtimeInterface(Interface):
    """Real-time interface of one controller.

    Args:
        state: State of the controller.
        receiver: Function that makes the receiver of a client, given the name of the interface.
    """

    def __init__(self, state: ControllerState, receiver: Callable[[str, InterfaceClient], ScriptReceiver]) -> None:
        self._state = state
        self._make_receiver = receiver
        self._form: Form | None = None
        self._firmware: Firmware | None = None

    def next_cycle(self, cycle: int) -> int:
        return cycle + 1

    def packets(self, cycle: int) -> list[bytes]:
        return [self.packet()]

    def receiver(self, client: InterfaceClient) -> ScriptReceiver:
        return self._make_receiver("realtime", client)

    def packet(self) -> bytes:
        """Return the packet of this cycle."""
        firmware = self._state.firmware
        if self._form is None or self._firmware is not firmware:  # initially, and after a reboot into another firmware
            self._form, self._firmware = Form(RealtimeState.LAYOUTS.of(firmware)), firmware
        return self._form.pack(_fields(self._state))


def _fields(state: ControllerState) -> Fields:
    arm, modes, signals = state.arm, state.modes, state.signals
    s = arm.sample
    return {
        "time": state.time,
        "q_target": s.q_target,
        "qd_target": s.qd_target,
        "qdd_target": s.qdd_target,
        "I_target": s.I_target,
        "M_target": s.M_target,
        "q_actual": s.q_actual,
        "qd_actual": s.qd_actual,
        "I_actual": s.I_actual,
        "I_control": s.I_control,
        "tool_vector_actual": s.pose_actual,
        "tcp_speed_actual": s.speed_actual,
        "tcp_force": s.force,
        "tool_vector_target": s.pose_target,
        "tcp_speed_target": s.speed_target,
        "digital_input_bits": signals.digital_inputs,
        "motor_temperatures": s.T_motor,
        "controller_timer": execution_time(state),
        "robot_mode": modes.robot_mode,
        "joint_modes": [modes.joint_mode] * 6,
        "safety_mode": modes.safety_mode,
        "tool_accelerometer": s.accelerometer,
        "speed_scaling": state.speed_scaling,
        "linear_momentum_norm": s.momentum,
        "V_main": MAIN_VOLTAGE,
        "V_robot": ROBOT_VOLTAGE if modes.is_powered else 0.0,
        "I_robot": robot_current(state),
        "V_actual": s.V_actual,
        "digital_output_bits": signals.digital_outputs,
        "program_state": modes.program_state,
        "elbow_position": s.elbow_position,
        "elbow_velocity": s.elbow_velocity,
        "safety_status": modes.safety_mode,
        "payload_mass": arm.payload,
        "payload_cog": arm.payload_cog,
        "payload_inertia": arm.payload_inertia,
        # These fields are unused, or have a meaning that only the vendor knows; zero is assumed.
        "test_value": 0.0,
        "unused": [0.0] * 15,
        "reserved_a": [0.0] * 6,
        "reserved_b": [0.0] * 6,
        "reserved_c": 0.0,
        "reserved_d": 0.0,
        "reserved_e": [0.0] * 3,
    }
