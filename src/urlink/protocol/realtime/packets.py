"""Packet of the real-time interface (port 30003, read-only 30013): all fields and sizes.

Complete real bytes confirm only the 812-byte packet (CB2 1.8). The other sizes are based on public decoders that agree.
Sources: docs/protocols/realtime.md, sections Length by firmware, Two orders of fields, What the doubles hold.
"""

from __future__ import annotations

from linkcore.wire.fields import Coded, Float64b, Mask64
from linkcore.wire.packet import State, Vector, packet, wire

from ..enums import JointMode, ProgramState, RobotMode, RobotModeCB2, SafetyMode
from ..field_names import hint_other_interfaces
from ..headers import REALTIME

# CB2 and later controllers share the offsets below 396 and from 684 upwards, and order the fields in between
# differently. Only the size of a packet shows its order: packets of up to 812 bytes have this order.
_CB2_ORDER = [
    "time",
    "q_target",
    "qd_target",
    "qdd_target",
    "I_target",
    "M_target",
    "q_actual",
    "qd_actual",
    "I_actual",
    "tool_accelerometer",
    "unused",
    "tcp_force",
    "tool_vector_actual",
    "tcp_speed_actual",
    "digital_input_bits",
    "motor_temperatures",
    "controller_timer",
    "test_value",
    "robot_mode",
    "joint_modes",
]


@packet(header=REALTIME, reorder=("3.0", _CB2_ORDER))
class RealtimeState(State):
    """State of the arm, every 8 ms (CB2, CB3) or 2 ms (e-Series).

    Vectors are read-only float64 arrays of the declared length. A field that the firmware does not
    send is None.
    """

    time: float = wire(Float64b, "s", "time since the controller started", since="1.5")
    q_target: Vector = wire(Float64b[6], "rad", "target joint positions", since="1.5")
    qd_target: Vector = wire(Float64b[6], "rad/s", "target joint velocities", since="1.5")
    qdd_target: Vector = wire(Float64b[6], "rad/s^2", "target joint accelerations", since="1.5")
    I_target: Vector = wire(Float64b[6], "A", "target joint currents", since="1.5")
    M_target: Vector = wire(Float64b[6], "Nm", "target joint moments", since="1.5")
    q_actual: Vector = wire(Float64b[6], "rad", "actual joint positions", since="1.5")
    qd_actual: Vector = wire(Float64b[6], "rad/s", "actual joint velocities", since="1.5")
    I_actual: Vector = wire(Float64b[6], "A", "actual joint currents", since="1.5")
    I_control: Vector | None = wire(Float64b[6], "A", "joint control currents", since="3.0")
    tool_vector_actual: Vector = wire(
        Float64b[6], "m, rad", "actual pose of the tool: position and rotation vector", since="1.5"
    )
    tcp_speed_actual: Vector = wire(Float64b[6], "m/s, rad/s", "actual speed of the tool", since="1.5")
    tcp_force: Vector = wire(Float64b[6], "N, Nm", "generalised force at the tool", since="1.5")
    tool_vector_target: Vector | None = wire(
        Float64b[6], "m, rad", "target pose of the tool: position and rotation vector", since="3.0"
    )
    tcp_speed_target: Vector | None = wire(Float64b[6], "m/s, rad/s", "target speed of the tool", since="3.0")
    digital_input_bits: int = wire(Mask64, "bits", "digital inputs, see DigitalBits", since="1.5")
    motor_temperatures: Vector = wire(Float64b[6], "degC", "motor temperatures", since="1.5")
    controller_timer: float = wire(Float64b, "ms", "real-time thread execution time", since="1.5")
    test_value: float = wire(Float64b, "", "internal to the vendor", since="1.5")
    robot_mode: RobotMode | RobotModeCB2 | None = wire(
        Coded(Float64b, RobotMode), "", "robot mode", since="1.6", before=("3.0", Coded(Float64b, RobotModeCB2))
    )
    joint_modes: tuple[JointMode, ...] | None = wire(Coded(Float64b, JointMode)[6], "", "joint modes", since="1.8")
    safety_mode: SafetyMode | None = wire(Coded(Float64b, SafetyMode), "", "safety mode", since="3.0")
    reserved_a: Vector | None = wire(Float64b[6], "", "internal to the vendor", since="3.0")
    tool_accelerometer: Vector = wire(
        Float64b[3], "m/s^2", "acceleration at the tool; meaningful since 1.7", since="1.5"
    )
    unused: Vector | None = wire(Float64b[15], "", "unused cells of CB2", since="1.5", until="3.0")
    reserved_b: Vector | None = wire(Float64b[6], "", "internal to the vendor", since="3.0")
    speed_scaling: float | None = wire(Float64b, "1", "speed scaling of the trajectory limiter", since="3.0")
    linear_momentum_norm: float | None = wire(Float64b, "kg m/s", "norm of the linear momentum", since="3.0")
    reserved_c: float | None = wire(Float64b, "", "internal to the vendor", since="3.0")
    reserved_d: float | None = wire(Float64b, "", "internal to the vendor", since="3.0")
    V_main: float | None = wire(Float64b, "V", "masterboard main voltage", since="3.0")
    V_robot: float | None = wire(Float64b, "V", "masterboard robot voltage (48 V)", since="3.0")
    I_robot: float | None = wire(Float64b, "A", "masterboard robot current", since="3.0")
    V_actual: Vector | None = wire(Float64b[6], "V", "actual joint voltages", since="3.0")
    digital_output_bits: int | None = wire(Mask64, "bits", "digital outputs, see DigitalBits", since="3.2")
    program_state: ProgramState | None = wire(Coded(Float64b, ProgramState), "", "program state", since="3.2")
    elbow_position: Vector | None = wire(Float64b[3], "m", "position of the elbow", since="3.5/5.0")
    elbow_velocity: Vector | None = wire(Float64b[3], "m/s", "velocity of the elbow", since="3.5/5.0")
    safety_status: SafetyMode | None = wire(Coded(Float64b, SafetyMode), "", "safety status", since="3.10/5.4")
    reserved_e: Vector | None = wire(Float64b[3], "", "internal to the vendor", since="3.14/5.9")
    payload_mass: float | None = wire(Float64b, "kg", "mass of the payload", since="5.10")
    payload_cog: Vector | None = wire(Float64b[3], "m", "centre of gravity of the payload", since="5.10")
    payload_inertia: Vector | None = wire(
        Float64b[6], "kg m^2", "inertia of the payload: xx, yy, zz, xy, xz, yz", since="5.10"
    )
    # -- fields of a later release

    @property
    def digital_coding(self) -> str | None:
        """Encoding of `digital_input_bits` by this controller: "integer", "double", or None.

        Public decoders disagree. In the only captured packets, all inputs are off, which looks the same
        in both encodings. If all inputs are off, the result is None.
        """
        at = self._layout.places["digital_input_bits"].offset
        raw = int.from_bytes(bytes(self)[at : at + 8], "big")
        return None if raw == 0 else "double" if raw >> 48 else "integer"


hint_other_interfaces(RealtimeState, "realtime")
