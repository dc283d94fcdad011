"""Every RTDE variable: the one table that the client, the simulator and the documentation stand on.

Sources: the vendor's RTDE article, the type list of the UR Client Library, the version table of TestCommUR, and
reports; docs/protocols/rtde.md, section Releases, says where they disagree. A client must not trust the releases: it
asks the controller, which answers NOT_FOUND for what it does not have.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from linkcore.wire.fields import Coded, Float64b, Int8ub, Int32sb, Int32ub, Int64ub, Shape, Since

from ...firmware import Firmware
from ..enums import (
    JointMode,
    ProgramState,
    RobotMode,
    SafetyMode,
    TimeScaleSource,
    ToolDigitalOutputMode,
    ToolMode,
    ToolOutputMode,
)

__all__ = ["INPUTS", "IN_USE", "NOT_FOUND", "OUTPUTS", "TYPES", "Evidence", "Variable", "shape_of"]

#: What a controller answers in place of a type: it has no such variable, or another client holds the input.
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"

#: The vendor's names of the types. STRING has a name too, but no variable and no known size.
TYPES: Mapping[str, Shape] = MappingProxyType(
    {
        "BOOL": Coded(Int8ub, bool),
        "UINT8": Int8ub,
        "UINT32": Int32ub,
        "UINT64": Int64ub,
        "INT32": Int32sb,
        "DOUBLE": Float64b,
        "VECTOR3D": Float64b[3],
        "VECTOR6D": Float64b[6],
        "VECTOR6INT32": Int32sb[6],
        "VECTOR6UINT32": Int32ub[6],
    }
)

#: What backs the release of a variable: the vendor, public drivers, a guess from its neighbours, or nothing.
Evidence = Literal["vendor", "drivers", "inferred", "unverified"]


class Variable(NamedTuple):
    """One variable.

    Attributes:
        name: the vendor's.
        type: the vendor's name of its type, a key of `TYPES`.
        unit: SI unit, or what the number is.
        doc: meaning.
        since: first release of each generation that has it; None where nobody knows.
        evidence: what backs `since`.
        meaning: what its numbers stand for.
    """

    name: str
    type: str
    unit: str
    doc: str
    since: Since | None
    evidence: Evidence
    meaning: Callable[[int], Any] | None = None

    def is_in(self, firmware: Firmware) -> bool:
        """Whether a controller of this firmware has it. Where the release is not known the answer is True, a guess."""
        return firmware.major >= 3 if self.since is None else firmware in self.since

    @property
    def shape(self) -> Shape:
        """On the wire."""
        return shape_of(self, self.type)


def shape_of(variable: Variable | None, type: str) -> Shape:
    """The shape of a variable that a controller answers this type for.

    Its numbers get their meaning where the type is the one of the table; None is a variable that nobody knows.

    Raises:
        KeyError: no such type.
    """
    shape = TYPES[type]
    if variable is None or variable.meaning is None or type != variable.type:
        return shape
    number = shape.number
    assert number is not None, "every type has a fixed size"
    coded = Coded(number, variable.meaning)
    return coded if shape.count is None else coded[shape.count]


_BASE = "3.3/5.0"


def _of(
    name: str,
    type: str,
    unit: str,
    doc: str,
    since: str | None = _BASE,
    evidence: Evidence | None = None,
    meaning: Callable[[int], Any] | None = None,
) -> Variable:
    """A row of the table: without a release nobody knows it, and of the base set the drivers do."""
    backed: Evidence = evidence or ("unverified" if since is None else "drivers" if since == _BASE else "vendor")
    return Variable(name, type, unit, doc, None if since is None else Since(since), backed, meaning)


def _registers(direction: str, first: str) -> Iterator[Variable]:
    """The general-purpose registers of one direction: 128 bits, 48 integers and 48 doubles.

    The lower half is for fieldbuses and PLCs, the upper half, which came later, for RTDE clients.
    """
    whose = f"general-purpose {direction} register"
    for low, high in ((0, 31), (32, 63)):
        yield _of(
            f"{direction}_bit_registers{low}_to_{high}", "UINT32", "bits", f"{whose}s, bits {low} to {high}", first
        )
    for number in range(64, 128):
        # TestCommUR has UINT32 here; the UR Client Library and the controllers it is tested on have BOOL.
        yield _of(f"{direction}_bit_register_{number}", "BOOL", "", f"{whose}, bit {number}", "3.9/5.3", "vendor")
    for kind, type in (("int", "INT32"), ("double", "DOUBLE")):
        for number in range(48):
            since = "3.4/5.0" if number < 24 else "3.9/5.3"
            yield _of(f"{direction}_{kind}_register_{number}", type, "", f"{whose} {number}", since, "vendor")


def _outputs() -> Iterator[Variable]:
    """What a controller sends."""
    yield _of("timestamp", "DOUBLE", "s", "time since the controller started")
    for name, unit, doc in (
        ("target_q", "rad", "target joint positions"),
        ("target_qd", "rad/s", "target joint velocities"),
        ("target_qdd", "rad/s^2", "target joint accelerations"),
        ("target_current", "A", "target joint currents"),
        ("target_moment", "Nm", "target joint moments"),
        ("actual_q", "rad", "actual joint positions"),
        ("actual_qd", "rad/s", "actual joint velocities"),
        ("actual_current", "A", "actual joint currents"),
    ):
        yield _of(name, "VECTOR6D", unit, doc)
    yield _of("actual_current_window", "VECTOR6D", "A", "allowed deviation of the joint currents", None)
    yield _of("actual_current_as_torque", "VECTOR6D", "Nm", "actual joint currents as torques", "5.23/10.11", "drivers")
    yield _of("joint_control_output", "VECTOR6D", "A", "joint control currents")
    yield _of(
        "actual_TCP_pose", "VECTOR6D", "m, rad", "actual pose of the tool in the base: position and rotation vector"
    )
    yield _of("actual_TCP_speed", "VECTOR6D", "m/s, rad/s", "actual speed of the tool")
    yield _of("actual_TCP_acceleration", "VECTOR6D", "m/s^2, rad/s^2", "actual acceleration of the tool", None)
    yield _of("actual_TCP_force", "VECTOR6D", "N, Nm", "generalised force at the tool, payload compensated")
    yield _of("target_TCP_pose", "VECTOR6D", "m, rad", "target pose of the tool: position and rotation vector")
    yield _of("target_TCP_speed", "VECTOR6D", "m/s, rad/s", "target speed of the tool")
    yield _of("target_TCP_acceleration", "VECTOR6D", "m/s^2, rad/s^2", "target acceleration of the tool", None)
    # Absent on 3.7; works from about 3.12 and 5.5.1 on, says a change log.
    yield _of(
        "tcp_offset", "VECTOR6D", "m, rad", "pose of the tool in the frame of the flange", "3.12/5.5.1", "inferred"
    )
    yield _of("actual_digital_input_bits", "UINT64", "bits", "digital inputs, see DigitalBits")
    yield _of("actual_configurable_digital_input_bits", "UINT64", "bits", "configurable digital inputs", None)
    yield _of("joint_temperatures", "VECTOR6D", "degC", "motor temperatures")
    yield _of("actual_execution_time", "DOUBLE", "ms", "real-time thread execution time")
    yield _of("target_execution_time", "DOUBLE", "ms", "target real-time thread execution time", None)
    yield _of("robot_mode", "INT32", "", "robot mode", meaning=RobotMode)
    yield _of("joint_mode", "VECTOR6INT32", "", "joint modes", meaning=JointMode)
    yield _of("safety_mode", "INT32", "", "safety mode", meaning=SafetyMode)
    yield _of("safety_status", "INT32", "", "safety status, finer than the mode", "3.10/5.4", meaning=SafetyMode)
    yield _of("actual_tool_accelerometer", "VECTOR3D", "m/s^2", "acceleration at the tool")
    yield _of("speed_scaling", "DOUBLE", "1", "speed scaling of the trajectory limiter")
    yield _of("target_speed_fraction", "DOUBLE", "1", "speed slider, 0 to 1")
    yield _of("time_scale_source", "INT32", "", "what limits the speed", None, meaning=TimeScaleSource)
    yield _of("actual_momentum", "DOUBLE", "kg m/s", "norm of the linear momentum")
    yield _of("actual_main_voltage", "DOUBLE", "V", "main voltage of the safety control board")
    yield _of("actual_robot_voltage", "DOUBLE", "V", "robot voltage (48 V)")
    yield _of("actual_robot_current", "DOUBLE", "A", "robot current")
    yield _of("actual_robot_energy_consumed", "DOUBLE", "J", "energy consumed by the robot", "5.23/10.11", "drivers")
    yield _of(
        "actual_robot_braking_energy_dissipated", "DOUBLE", "J", "energy lost by braking", "5.23/10.11", "inferred"
    )
    yield _of("actual_joint_voltage", "VECTOR6D", "V", "actual joint voltages")
    yield _of("actual_digital_output_bits", "UINT64", "bits", "digital outputs, see DigitalBits")
    yield _of("actual_configurable_digital_output_bits", "UINT64", "bits", "configurable digital outputs", None)
    yield _of("runtime_state", "UINT32", "", "program state", meaning=ProgramState)
    # The article says 3.5, TestCommUR 3.3; the later one is the safe one.
    yield _of("elbow_position", "VECTOR3D", "m", "position of the elbow", "3.5/5.0")
    yield _of("elbow_velocity", "VECTOR3D", "m/s", "velocity of the elbow", "3.5/5.0")
    yield _of("robot_status_bits", "UINT32", "bits", "power and program, see RobotStatusBits")
    yield _of("safety_status_bits", "UINT32", "bits", "what holds the robot, see SafetyStatusBits")
    yield _of("analog_io_types", "UINT32", "bits", "analogue inputs 0 and 1, outputs 0 and 1: 0 current, 1 voltage")
    for direction in ("input", "output"):
        for number in (0, 1):
            yield _of(f"standard_analog_{direction}{number}", "DOUBLE", "A or V", f"analogue {direction} {number}")
    yield _of("io_current", "DOUBLE", "A", "current of the inputs and outputs")
    yield _of("euromap67_input_bits", "UINT32", "bits", "Euromap 67 inputs")
    yield _of("euromap67_output_bits", "UINT32", "bits", "Euromap 67 outputs")
    yield _of("euromap67_24V_voltage", "DOUBLE", "V", "Euromap 67 24 V supply")
    yield _of("euromap67_24V_current", "DOUBLE", "A", "Euromap 67 24 V current")
    yield _of("tool_mode", "UINT32", "", "tool mode", meaning=ToolMode)
    yield _of("tool_analog_input_types", "UINT32", "bits", "tool analogue inputs 0 and 1: 0 current, 1 voltage")
    yield _of("tool_analog_input0", "DOUBLE", "A or V", "tool analogue input 0")
    yield _of("tool_analog_input1", "DOUBLE", "A or V", "tool analogue input 1")
    yield _of("tool_output_voltage", "INT32", "V", "tool supply: 0, 12 or 24")
    yield _of("tool_output_current", "DOUBLE", "A", "tool supply current")
    yield _of("tool_temperature", "DOUBLE", "degC", "tool temperature")
    yield _of("tool_output_mode", "UINT8", "", "use of the two tool outputs", "5.2", "drivers", ToolOutputMode)
    for number in (0, 1):
        yield _of(
            f"tool_digital_output{number}_mode",
            "UINT8",
            "",
            f"circuit of tool digital output {number}",
            "5.2",
            "drivers",
            ToolDigitalOutputMode,
        )
    yield _of("tcp_force_scalar", "DOUBLE", "N", "force at the tool")
    yield _of("joint_position_deviation_ratio", "DOUBLE", "1", "deviation of the joints, 1 where a stop follows", None)
    yield _of("collision_detection_ratio", "DOUBLE", "1", "detection of collisions, 1 where a stop follows", None)
    yield _of("ft_raw_wrench", "VECTOR6D", "N, Nm", "raw force and torque of the wrist sensor", "5.9")
    yield _of("wrench_calc_from_currents", "VECTOR6D", "N, Nm", "force and torque by the joint currents", None)
    yield _of("payload", "DOUBLE", "kg", "mass of the payload", "3.11/5.5.1")
    yield _of("payload_cog", "VECTOR3D", "m", "centre of gravity of the payload", "3.11/5.5.1")
    yield _of("payload_inertia", "VECTOR6D", "kg m^2", "inertia of the payload: xx, yy, zz, xy, xz, yz", "3.15/5.11")
    yield _of("script_control_line", "UINT32", "", "line of the program in control, 0 for none", "3.14/5.9")
    yield _of("target_gravity", "VECTOR3D", "m/s^2", "gravity that the dynamics reckon with", None)
    yield _of("target_base_acceleration", "VECTOR6D", "m/s^2, rad/s^2", "acceleration of the base", None)
    yield _of("target_base_wrench", "VECTOR6D", "N, Nm", "force and torque at the base", None)
    yield _of("control_step", "UINT64", "1", "number of the control cycle", None)
    yield _of("encoder0_raw", "INT32", "ticks", "raw count of encoder 0", None)
    yield _of("encoder1_raw", "INT32", "ticks", "raw count of encoder 1", None)
    yield from _registers("output", _BASE)
    yield from _registers("input", "3.4/5.0")


def _inputs() -> Iterator[Variable]:
    """What a client can write."""
    yield _of("speed_slider_mask", "UINT32", "", "1 moves the speed slider to the fraction, once; else nothing")
    yield _of("speed_slider_fraction", "DOUBLE", "1", "speed slider, 0 to 1")
    for which in ("standard", "configurable", "tool"):
        yield _of(f"{which}_digital_output_mask", "UINT8", "bits", f"which {which} digital outputs are set")
        yield _of(f"{which}_digital_output", "UINT8", "bits", f"{which} digital outputs")
    yield _of("standard_analog_output_mask", "UINT8", "bits", "which analogue outputs are set")
    yield _of("standard_analog_output_type", "UINT8", "bits", "analogue outputs 0 and 1: 0 current, 1 voltage")
    for number in (0, 1):
        # The drivers send 0 to 1 here and the type picks 4 to 20 mA or 0 to 10 V.
        yield _of(f"standard_analog_output_{number}", "DOUBLE", "1", f"analogue output {number}, 0 to 1 of its range")
    # Counts once ft_rtde_input_enable (3.14.1, 5.9.1) or enable_external_ft_sensor (before) was called.
    yield _of("external_force_torque", "VECTOR6D", "N, Nm", "force and torque of a sensor that the client reads")
    yield from _registers("input", "3.4/5.0")


#: name -> what a controller sends, the read-back of the input registers included.
OUTPUTS: Mapping[str, Variable] = MappingProxyType({variable.name: variable for variable in _outputs()})

#: name -> what a client can write.
INPUTS: Mapping[str, Variable] = MappingProxyType({variable.name: variable for variable in _inputs()})
