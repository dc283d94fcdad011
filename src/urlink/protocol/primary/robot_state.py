"""The robot state (package type 16) of the primary and secondary interface, and its sub-packages.

Sub-packages are recognised by type, and their layouts by size, because sizes grew from release to release. Their order
is not guaranteed.
Source: docs/protocols/primary.md, section Robot state, with the evidence for each size and field.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Generic, NoReturn, TypeVar, overload

from linkcore.clock import Stamp
from linkcore.errors import BadValue
from linkcore.wire.fields import (
    Coded,
    Float32b,
    Float64b,
    Int8sb,
    Int8ub,
    Int16sb,
    Int16ub,
    Int32sb,
    Int32ub,
    Int64ub,
    Raw,
)
from linkcore.wire.packet import IntVector, State, Vector, packet, wire

from ..enums import (
    AnalogDomain,
    ControlMode,
    JointMode,
    MasterOnOffState,
    MasterSafetyState,
    RobotMode,
    RobotModeCB2,
    RobotType,
    SafetyMode,
    ToolMode,
    ToolOutputMode,
)
from ..field_names import hint_other_interfaces
from ..headers import PACKAGE

if TYPE_CHECKING:
    from linkcore.wire.schema import Row

_Bool = Coded(Int8ub, bool)
_Domain = Coded(Int8ub, AnalogDomain)


class SubPackage(State):
    """Part of a robot state. Subscribe to one by its class."""

    __slots__ = ()


@packet(header=PACKAGE, type=0)
class RobotModeData(SubPackage):
    """Modes of the robot and the program, and the allowed speed."""

    timestamp: int = wire(Int64ub, "us", "time since start; on CB2 another unit, probably ms")
    is_robot_connected: bool = wire(_Bool, "", "a real robot is connected")
    is_robot_enabled: bool = wire(_Bool, "", "the real robot is enabled")
    is_power_on: bool = wire(_Bool, "", "the robot is powered")
    is_emergency_stopped: bool = wire(_Bool, "", "emergency stop")
    is_protective_stopped: bool = wire(_Bool, "", "protective stop (CB2: security stop)")
    is_program_running: bool = wire(_Bool, "", "a program runs")
    is_program_paused: bool = wire(_Bool, "", "the program is paused")
    robot_mode: RobotMode | RobotModeCB2 = wire(
        Coded(Int8sb, RobotMode), "", "robot mode", before=("3.0", Coded(Int8ub, RobotModeCB2))
    )
    control_mode: ControlMode | None = wire(Coded(Int8ub, ControlMode), "", "control mode", since="3.0")
    target_speed_fraction: float = wire(Float64b, "1", "speed slider (CB2: speed fraction)")
    speed_scaling: float | None = wire(Float64b, "1", "speed that remains after all limits", since="3.0")
    target_speed_fraction_limit: float | None = wire(Float64b, "1", "upper limit of the slider", since="3.2")
    reserved: int | None = wire(Int8ub, "", "internal to the vendor", since="3.5")


@packet(header=PACKAGE, type=1)
class JointData(SubPackage):
    """Positions, velocities, currents, voltages and temperatures of the six joints; on the wire joint by joint."""

    q_actual: Vector = wire(Float64b[6], "rad", "actual joint positions", interleave="joint")
    q_target: Vector = wire(Float64b[6], "rad", "target joint positions", interleave="joint")
    qd_actual: Vector = wire(Float64b[6], "rad/s", "actual joint velocities", interleave="joint")
    I_actual: Vector = wire(Float32b[6], "A", "actual joint currents", interleave="joint")
    V_actual: Vector = wire(Float32b[6], "V", "actual joint voltages", interleave="joint")
    T_motor: Vector = wire(Float32b[6], "degC", "motor temperatures", interleave="joint")
    T_micro: Vector = wire(Float32b[6], "degC", "joint electronics; zero on e-Series", interleave="joint")
    joint_modes: tuple[JointMode, ...] = wire(Coded(Int8ub, JointMode)[6], "", "joint modes", interleave="joint")


@packet(header=PACKAGE, type=2)
class ToolData(SubPackage):
    """Inputs, supply and mode of the tool connector."""

    analog_input_range_2: AnalogDomain = wire(_Domain, "", "quantity of analogue input 2")
    analog_input_range_3: AnalogDomain = wire(_Domain, "", "quantity of analogue input 3")
    analog_input_2: float = wire(Float64b, "A or V", "analogue input 2")
    analog_input_3: float = wire(Float64b, "A or V", "analogue input 3")
    tool_voltage_48V: float = wire(Float32b, "V", "48 V rail at the tool")
    tool_output_voltage: int = wire(Int8ub, "V", "voltage supplied to the tool: 0, 12 or 24")
    tool_current: float = wire(Float32b, "A", "current into the tool")
    tool_temperature: float = wire(Float32b, "degC", "temperature of the tool board")
    tool_mode: ToolMode = wire(Coded(Int8ub, ToolMode), "", "tool mode")


@packet(header=PACKAGE, type=3)
class MasterboardData(SubPackage):
    """Inputs, outputs, supply and safety of the control box, and Euromap 67 if it is installed."""

    digital_input_bits: int = wire(Int32ub, "bits", "digital inputs, see DigitalBits", before=("3.0", Int16ub))
    digital_output_bits: int = wire(Int32ub, "bits", "digital outputs, see DigitalBits", before=("3.0", Int16ub))
    analog_input_range_0: AnalogDomain = wire(_Domain, "", "quantity of analogue input 0")
    analog_input_range_1: AnalogDomain = wire(_Domain, "", "quantity of analogue input 1")
    analog_input_0: float = wire(Float64b, "A or V", "analogue input 0")
    analog_input_1: float = wire(Float64b, "A or V", "analogue input 1")
    analog_output_domain_0: AnalogDomain = wire(_Domain, "", "quantity of analogue output 0")
    analog_output_domain_1: AnalogDomain = wire(_Domain, "", "quantity of analogue output 1")
    analog_output_0: float = wire(Float64b, "A or V", "analogue output 0")
    analog_output_1: float = wire(Float64b, "A or V", "analogue output 1")
    masterboard_temperature: float = wire(Float32b, "degC", "temperature of the masterboard")
    robot_voltage_48V: float = wire(Float32b, "V", "48 V rail of the robot")
    robot_current: float = wire(Float32b, "A", "current into the robot")
    master_io_current: float = wire(Float32b, "A", "current of the inputs and outputs")
    master_safety_state: MasterSafetyState | None = wire(
        Coded(Int8ub, MasterSafetyState), "", "safety state of CB2", since="1.6", until="3.0"
    )
    master_on_off_state: MasterOnOffState | None = wire(
        Coded(Int8ub, MasterOnOffState), "", "power state of CB2", since="1.6", until="3.0"
    )
    safety_mode: SafetyMode | None = wire(Coded(Int8ub, SafetyMode), "", "safety mode", since="3.0")
    is_in_reduced_mode: bool | None = wire(_Bool, "", "reduced mode", since="3.0")
    is_euromap_installed: bool | None = wire(_Bool, "", "Euromap 67 interface is installed", since="1.6")
    euromap_input_bits: int | None = wire(
        Int32ub, "bits", "Euromap inputs", since="1.6", before=("3.0", Int32sb), block="is_euromap_installed"
    )
    euromap_output_bits: int | None = wire(
        Int32ub, "bits", "Euromap outputs", since="1.6", before=("3.0", Int32sb), block="is_euromap_installed"
    )
    euromap_voltage_24V: float | None = wire(
        Float32b, "V", "Euromap 24 V rail", since="1.6", before=("3.0", Int16sb), block="is_euromap_installed"
    )
    euromap_current: float | None = wire(
        Float32b, "A", "Euromap current", since="1.6", before=("3.0", Int16sb), block="is_euromap_installed"
    )
    reserved_checksum: int | None = wire(Int32ub, "", "internal; equals SafetyData.checksum in captures", since="3.0")
    operational_mode_selector_input: int | None = wire(Int8ub, "", "operational mode selector", since="3.2")
    three_position_enabling_device_input: int | None = wire(Int8ub, "", "three-position enabling device", since="3.2")
    reserved: int | None = wire(Int8ub, "", "internal to the vendor", since="3.10/5.4")


@packet(header=PACKAGE, type=4)
class CartesianInfo(SubPackage):
    """Pose of the tool in the base frame, and offset of the tool from the flange."""

    X: float = wire(Float64b, "m", "position")
    Y: float = wire(Float64b, "m", "position")
    Z: float = wire(Float64b, "m", "position")
    Rx: float = wire(Float64b, "rad", "rotation vector")
    Ry: float = wire(Float64b, "rad", "rotation vector")
    Rz: float = wire(Float64b, "rad", "rotation vector")
    # Sources disagree whether 3.1 or 3.2 was the first release with this field. With 3.2 here, both sizes are accepted
    # from a 3.1 controller.
    tcp_offset_X: float | None = wire(Float64b, "m", "offset of the tool from the flange", since="3.2")
    tcp_offset_Y: float | None = wire(Float64b, "m", "offset of the tool from the flange", since="3.2")
    tcp_offset_Z: float | None = wire(Float64b, "m", "offset of the tool from the flange", since="3.2")
    tcp_offset_Rx: float | None = wire(Float64b, "rad", "rotation of the tool on the flange", since="3.2")
    tcp_offset_Ry: float | None = wire(Float64b, "rad", "rotation of the tool on the flange", since="3.2")
    tcp_offset_Rz: float | None = wire(Float64b, "rad", "rotation of the tool on the flange", since="3.2")


def tool_offset(info: CartesianInfo) -> list[float] | None:
    """Return the pose of the tool in the flange frame, in m and rad; None if it is not sent."""
    if info.tcp_offset_X is None:
        return None
    return [getattr(info, f"tcp_offset_{axis}") for axis in ("X", "Y", "Z", "Rx", "Ry", "Rz")]


@packet(header=PACKAGE, type=5)
class KinematicsInfo(SubPackage):
    """Denavit-Hartenberg parameters of this individual arm; only in the first state of a connection."""

    checksum: IntVector = wire(Int32ub[6], "", "checksums of the calibration", since="1.8")
    dh_theta: Vector = wire(Float64b[6], "rad", "DH theta", since="1.8")
    dh_a: Vector = wire(Float64b[6], "m", "DH a", since="1.8")
    dh_d: Vector = wire(Float64b[6], "m", "DH d", since="1.8")
    dh_alpha: Vector = wire(Float64b[6], "rad", "DH alpha", since="1.8")
    calibration_status: int = wire(Int32ub, "", "calibration status", since="1.8")


@packet(header=PACKAGE, type=5)
class LaserPointer(SubPackage):
    """Obsolete type 5 of the oldest CB2 controllers, recognised by its size."""

    pointer: Vector = wire(Float64b[3], "", "obsolete laser pointer; 1000, 1000, 1000 in the capture", until="1.6")


@packet(header=PACKAGE, type=6)
class ConfigurationData(SubPackage):
    """Limits, nominal geometry and type of the robot; only in the first state of a connection."""

    joint_min_limit: Vector = wire(Float64b[6], "rad", "lower joint limits", since="1.8", interleave="position")
    joint_max_limit: Vector = wire(Float64b[6], "rad", "upper joint limits", since="1.8", interleave="position")
    joint_max_speed: Vector = wire(Float64b[6], "rad/s", "joint speed limits", since="1.8", interleave="speed")
    joint_max_acceleration: Vector = wire(
        Float64b[6], "rad/s^2", "joint acceleration limits", since="1.8", interleave="speed"
    )
    v_joint_default: float = wire(Float64b, "rad/s", "default joint speed", since="1.8")
    a_joint_default: float = wire(Float64b, "rad/s^2", "default joint acceleration", since="1.8")
    v_tool_default: float = wire(Float64b, "m/s", "default tool speed", since="1.8")
    a_tool_default: float = wire(Float64b, "m/s^2", "default tool acceleration", since="1.8")
    eq_radius: float = wire(Float64b, "m", "characteristic size of the tool", since="1.8")
    dh_a: Vector = wire(Float64b[6], "m", "nominal DH a", since="1.8")
    dh_d: Vector = wire(Float64b[6], "m", "nominal DH d", since="1.8")
    dh_alpha: Vector = wire(Float64b[6], "rad", "nominal DH alpha", since="1.8")
    dh_theta: Vector = wire(Float64b[6], "rad", "nominal DH theta", since="1.8")
    masterboard_version: int = wire(Int32sb, "", "version of the masterboard", since="1.8")
    controller_box_type: int = wire(Int32sb, "", "type of the control box", since="1.8")
    robot_type: RobotType = wire(Coded(Int32sb, RobotType), "", "type of the arm", since="1.8")
    robot_sub_type: int = wire(Int32sb, "", "sub-type of the arm", since="1.8")
    motor_type: IntVector | None = wire(Int32sb[6], "", "types of the motors", since="1.8", until="3.0")
    reserved: IntVector | None = wire(Int16sb[2], "", "internal to the vendor", since="5.25/10.12")


@packet(header=PACKAGE, type=7)
class ForceModeData(SubPackage):
    """Wrench at the tool."""

    Fx: float = wire(Float64b, "N", "force", since="1.7")
    Fy: float = wire(Float64b, "N", "force", since="1.7")
    Fz: float = wire(Float64b, "N", "force", since="1.7")
    Frx: float = wire(Float64b, "Nm", "torque", since="1.7")
    Fry: float = wire(Float64b, "Nm", "torque", since="1.7")
    Frz: float = wire(Float64b, "Nm", "torque", since="1.7")
    robot_dexterity: float = wire(Float64b, "", "distance of the arm from a singular posture", since="1.7")


@packet(header=PACKAGE, type=8)
class AdditionalInfo(SubPackage):
    """Buttons of the teach pendant."""

    ctrl_bits: int | None = wire(Int32ub, "bits", "internal to early CB2", since="1.7", until="1.8")
    teach_button: int | None = wire(Int8ub, "", "teach button of early CB2", since="1.7", until="1.8")
    freedrive_button_pressed: bool | None = wire(_Bool, "", "teach (freedrive) button is pressed", since="1.8")
    freedrive_button_enabled: bool | None = wire(_Bool, "", "teach (freedrive) button is enabled", since="1.8")
    # Size 8 is verified for 3.3 and later. Nothing is known about 3.2 itself, so its size is inferred.
    io_enabled_freedrive: bool | None = wire(_Bool, "", "an input enables freedrive", since="3.3")
    reserved: int | None = wire(Int8ub, "", "internal to the vendor", since="3.10/5.4")


@packet(header=PACKAGE, type=9)
class CalibrationData(SubPackage):
    """Force offsets; internal to the vendor."""

    Fx: float = wire(Float64b, "N", "force", since="1.8")
    Fy: float = wire(Float64b, "N", "force", since="1.8")
    Fz: float = wire(Float64b, "N", "force", since="1.8")
    Frx: float = wire(Float64b, "Nm", "torque", since="1.8")
    Fry: float = wire(Float64b, "Nm", "torque", since="1.8")
    Frz: float = wire(Float64b, "Nm", "torque", since="1.8")


@packet(header=PACKAGE, type=10)
class SafetyData(SubPackage):
    """Undocumented sub-package for the vendor. The meaning of its fields is inferred from three captures."""

    checksum: int = wire(Int32ub, "", "checksum of the safety configuration", since="3.5")
    reserved: IntVector = wire(Int8ub[2], "", "unknown", since="3.5")
    elbow_sphere_centre: Vector = wire(Float64b[3], "m", "near the elbow in the captures", since="3.5")
    elbow_sphere_radius: float = wire(Float64b, "m", "0.13 for UR5e, 0.1 for UR3e, 0 on CB3", since="3.5")


@packet(header=PACKAGE, type=11)
class ToolCommunicationInfo(SubPackage):
    """Serial line through the tool connector."""

    is_enabled: bool = wire(_Bool, "", "tool communication is enabled", since="5.0")
    baud_rate: int = wire(Int32sb, "Bd", "baud rate", since="5.0")
    parity: int = wire(Int32sb, "", "0 none, 1 odd, 2 even", since="5.0")
    stop_bits: int = wire(Int32sb, "", "stop bits", since="5.0")
    rx_idle_chars: float = wire(Float32b, "characters", "idle time when receiving", since="5.0")
    tx_idle_chars: float = wire(Float32b, "characters", "idle time when sending", since="5.0")


@packet(header=PACKAGE, type=12)
class ToolModeInfo(SubPackage):
    """Use of the outputs of the tool connector."""

    output_mode: ToolOutputMode = wire(Coded(Int8ub, ToolOutputMode), "", "tool output mode", since="5.2")
    digital_output_0_mode: int = wire(Int8ub, "", "0 single, 1 sinking, 2 sourcing, 3 push-pull", since="5.2")
    digital_output_1_mode: int = wire(Int8ub, "", "0 single, 1 sinking, 2 sourcing, 3 push-pull", since="5.2")


@packet(header=PACKAGE, type=13)
class SingularityInfo(SubPackage):
    """Undocumented sub-package for the vendor. It is unknown which release was the first to send it."""

    severity: int = wire(Int8ub, "", "severity")
    singularity_type: int = wire(Int8ub, "", "type")


@packet(header=PACKAGE)
class UnknownSubPackage(SubPackage):
    """Sub-package without a layout in this library. Its bytes are kept unchanged."""

    payload: bytes = wire(Raw(), "", "bytes after the header")

    @property
    def type(self) -> int:
        """Type byte of the sub-package."""
        return self._data[4]

    def to_dict(self) -> dict[str, Any]:
        """Return the type byte and the payload."""
        return {"type": self.type, **SubPackage.to_dict(self)}

    def __str__(self) -> str:
        return f"UnknownSubPackage(type={self.type}, payload={self._data[5:]!r})"

    __repr__ = __str__


#: Type byte -> class. If a number had two meanings, the size decides.
SUB_PACKAGES: dict[int, tuple[type[SubPackage], ...]] = {
    0: (RobotModeData,),
    1: (JointData,),
    2: (ToolData,),
    3: (MasterboardData,),
    4: (CartesianInfo,),
    5: (KinematicsInfo, LaserPointer),
    6: (ConfigurationData,),
    7: (ForceModeData,),
    8: (AdditionalInfo,),
    9: (CalibrationData,),
    10: (SafetyData,),
    11: (ToolCommunicationInfo,),
    12: (ToolModeInfo,),
    13: (SingularityInfo,),
}

_Part = TypeVar("_Part", bound=SubPackage)


class _Slot(Generic[_Part]):
    """Attribute for the sub-package of one class in a robot state; None if it was not sent."""

    def __init__(self, kind: type[_Part]) -> None:
        self.kind = kind
        self.__doc__ = kind.__doc__

    @overload
    def __get__(self, state: None, owner: object) -> _Slot[_Part]: ...
    @overload
    def __get__(self, state: RobotState, owner: object) -> _Part | None: ...
    def __get__(self, state: RobotState | None, owner: object) -> Any:
        return self if state is None else state.get(self.kind)


class RobotState(State):
    """Robot state: the sub-packages of one package.

    Each sub-package is an attribute, or None if the package does not contain it. `packages` contains
    all of them in the order of sending, including unknown ones. Only the first state of a connection
    contains kinematics and configuration.

    ``RobotState(RobotModeData("5.4", ...), ...)`` builds a robot state.
    """

    __slots__ = ()

    robot_mode_data = _Slot(RobotModeData)
    joint_data = _Slot(JointData)
    tool_data = _Slot(ToolData)
    masterboard_data = _Slot(MasterboardData)
    cartesian_info = _Slot(CartesianInfo)
    kinematics_info = _Slot(KinematicsInfo)
    laser_pointer = _Slot(LaserPointer)
    configuration_data = _Slot(ConfigurationData)
    force_mode_data = _Slot(ForceModeData)
    additional_info = _Slot(AdditionalInfo)
    calibration_data = _Slot(CalibrationData)
    safety_data = _Slot(SafetyData)
    tool_communication_info = _Slot(ToolCommunicationInfo)
    tool_mode_info = _Slot(ToolModeInfo)
    singularity_info = _Slot(SingularityInfo)

    def __init__(self, *packages: SubPackage) -> None:
        body = b"".join(map(bytes, packages))
        self._data = PACKAGE.pack(size=PACKAGE.width + len(body), type=16) + body
        self._stamp = None
        self._values = packages

    @classmethod
    def of(cls, data: bytes, packages: tuple[SubPackage, ...], stamp: Stamp | None) -> RobotState:
        """Return the state of a received package; `packages` are its parts."""
        state = object.__new__(cls)
        state._data = data
        state._stamp = stamp
        state._values = packages
        return state

    @property
    def packages(self) -> tuple[SubPackage, ...]:
        """Sub-packages in the order of sending."""
        packages: tuple[SubPackage, ...] = self._values
        return packages

    @property
    def sizes(self) -> dict[int, int]:
        """Type byte of each sub-package -> its size in bytes, including the header."""
        return {bytes(package)[4]: len(bytes(package)) for package in self.packages}

    def get(self, kind: type[_Part]) -> _Part | None:
        """Return the sub-package of class `kind`, or None if the package does not contain it."""
        for package in self._values:
            if type(package) is kind:
                return package
        return None

    def __iter__(self) -> Iterator[SubPackage]:
        return iter(self.packages)

    @property
    def tail(self) -> bytes:
        """Always empty, because the sub-packages keep their own tails."""
        return b""

    def dissect(self) -> Iterator[Row]:
        """Yield every part of the bytes. The fields have the names of their sub-packages as prefix."""
        from linkcore.wire.schema import header_rows  # imported here, because it imports construct

        yield from header_rows(PACKAGE, self._data)
        at = PACKAGE.width
        for package in self.packages:
            for row in package.dissect():
                yield row._replace(offset=at + row.offset, name=f"{snake_case(type(package).__name__)}.{row.name}")
            at += len(bytes(package))

    def __reduce__(self) -> tuple[object, ...]:
        return (RobotState.of, (self._data, self._values, self._stamp))

    @classmethod
    def dtype(cls, version: object = None) -> NoReturn:
        """Raise an error, because the sub-packages vary.

        Raises:
            BadValue: If it is called.
        """
        raise BadValue("RobotState has no numpy dtype, because its sub-packages vary; use the dtype of a sub-package")

    def to_dict(self) -> dict[str, Any]:
        """Return name of each sub-package -> its `to_dict()`. The name of an unknown sub-package contains its type."""
        return {_key(package): package.to_dict() for package in self.packages}

    def __str__(self) -> str:
        return f"RobotState({', '.join(map(str, self.packages))})"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return "".join(package._repr_html_() for package in self.packages)


for _kind in (RobotState, RobotModeData, JointData, ToolData, MasterboardData, CartesianInfo, ForceModeData):
    hint_other_interfaces(_kind, "primary")


def _key(package: SubPackage) -> str:
    name = snake_case(type(package).__name__)
    return f"{name}_{package.type}" if isinstance(package, UnknownSubPackage) else name


def snake_case(name: str) -> str:
    """Convert a class name: ``RobotModeData`` -> ``robot_mode_data``."""
    return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name).lstrip("_")
