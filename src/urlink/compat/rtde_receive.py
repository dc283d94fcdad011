"""The receive interface of ur_rtde, over `robot.rtde`."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO, TypeVar

import numpy as np

import urlink
from linkcore.errors import BadValue, LocalError
from linkcore.streaming.packet_queue import block
from linkcore.streaming.subscription import Subscription
from urlink.interfaces.enums import SafetyStatusBits
from urlink.rtde import OutputStream

from .interface import RtdeInterface, succeeds

__all__ = ["RTDEReceiveInterface"]

#: Variables that are requested if none are named; those that a controller does not have are left out.
_VARIABLES = (
    *("timestamp", "target_q", "target_qd", "target_qdd", "target_current", "target_moment"),
    *("actual_q", "actual_qd", "actual_current", "joint_control_output"),
    *("actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "target_TCP_pose", "target_TCP_speed"),
    *("actual_digital_input_bits", "joint_temperatures", "actual_execution_time"),
    *("robot_mode", "joint_mode", "safety_mode", "actual_tool_accelerometer"),
    *("speed_scaling", "target_speed_fraction", "actual_momentum"),
    *("actual_main_voltage", "actual_robot_voltage", "actual_robot_current", "actual_joint_voltage"),
    *("actual_digital_output_bits", "runtime_state"),
    *("standard_analog_input0", "standard_analog_input1", "standard_analog_output0", "standard_analog_output1"),
    *("robot_status_bits", "safety_status_bits", "ft_raw_wrench", "payload", "payload_cog", "payload_inertia"),
)
#: Seconds to wait for a state if there is none: at first, and after a lost connection.
_TIMEOUT = 5.0


_T = TypeVar("_T")


def _getter(name: str, convert: Callable[[Any], _T], doc: str) -> Callable[[RTDEReceiveInterface], _T]:
    """A method that returns the newest value of a variable."""

    def get(self: RTDEReceiveInterface) -> _T:
        return convert(self._value(name))

    get.__doc__ = doc
    return get


def _vector(value: Any) -> list[float]:
    values: list[float] = value.tolist()
    return values


def _integers(values: Any) -> list[int]:
    return [int(value) for value in values]


class RTDEReceiveInterface(RtdeInterface):
    """Variables of a controller, one method for each. While the connection is lost, they wait for the next package.

    Args:
        hostname: address of the robot.
        frequency: packages a second; -1 for the controller's rate.
        variables: names; none for all that the methods need.
        verbose: without effect.
        use_upper_range_registers: without effect: registers are given by their own numbers.
        rt_priority: without effect.

    Raises:
        NoSuchVariable: the controller does not have one of the named variables.
        BadValue: the controller does not have this frequency, or a name is invalid.
        RemoteError: the robot cannot be reached.
    """

    def __init__(
        self,
        hostname: str,
        frequency: float = -1.0,
        variables: Sequence[str] = (),
        verbose: bool = False,
        use_upper_range_registers: bool = False,
        rt_priority: int = 0,
    ) -> None:
        super().__init__(hostname, frequency)
        try:
            self._stream: OutputStream[Any] = self._robot.rtde.outputs(
                *(variables or _VARIABLES),
                frequency=None if frequency <= 0.0 else frequency,
                missing="error" if variables else "leave_out",
            )
            self._registers = self._robot.rtde.registers(lower=True)
            self._stream.wait(_TIMEOUT)
        except BaseException:
            self.disconnect()
            raise
        self._recording: tuple[Subscription, TextIO] | None = None

    def isConnected(self) -> bool:
        """Whether packages arrive."""
        return self._stream.connection is urlink.ConnectionState.CONNECTED

    def reconnect(self) -> bool:
        """Wait until packages arrive again. A lost connection is made again without this call."""
        return succeeds(lambda: self._stream.wait(2 * _TIMEOUT))

    def disconnect(self) -> None:
        """Disconnect, and end a recording; the object cannot be used again."""
        self.stopFileRecording()
        super().disconnect()

    # -- values ------------------------------------------------------------------------------------------

    def _value(self, name: str) -> Any:
        """The newest value of a variable.

        Raises:
            LocalError: it was not requested, or the controller does not have it.
            RemoteError: no packages arrive.
        """
        state = self._stream.latest or self._stream.wait(_TIMEOUT)
        value = getattr(state, name, None)
        if value is None:
            raise LocalError(f"{name} is not received: it was not requested, or this controller does not have it")
        return value

    getTimestamp = _getter("timestamp", float, "Seconds since the controller was started.")
    getTargetQ = _getter("target_q", _vector, "Target joint positions, rad.")
    getTargetQd = _getter("target_qd", _vector, "Target joint speeds, rad/s.")
    getTargetQdd = _getter("target_qdd", _vector, "Target joint accelerations, rad/s².")
    getTargetCurrent = _getter("target_current", _vector, "Target joint currents, A.")
    getTargetMoment = _getter("target_moment", _vector, "Target joint torques, Nm.")
    getActualQ = _getter("actual_q", _vector, "Joint positions, rad.")
    getActualQd = _getter("actual_qd", _vector, "Joint speeds, rad/s.")
    getActualCurrent = _getter("actual_current", _vector, "Joint currents, A.")
    getJointControlOutput = _getter("joint_control_output", _vector, "Control currents of the joints, A.")
    getActualTCPPose = _getter(
        "actual_TCP_pose", _vector, "Pose of the tool in the base frame: m, and rotation vector in rad."
    )
    getActualTCPSpeed = _getter("actual_TCP_speed", _vector, "Speed of the tool in the base frame: m/s and rad/s.")
    getActualTCPForce = _getter("actual_TCP_force", _vector, "Force at the tool: N and Nm.")
    getTargetTCPPose = _getter(
        "target_TCP_pose", _vector, "Target pose of the tool in the base frame: m, and rotation vector in rad."
    )
    getTargetTCPSpeed = _getter(
        "target_TCP_speed", _vector, "Target speed of the tool in the base frame: m/s and rad/s."
    )
    getActualDigitalInputBits = _getter(
        "actual_digital_input_bits",
        int,
        "Digital inputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 of the tool.",
    )

    def getDigitalInState(self, input_id: int) -> bool:
        """One digital input, by its bit in `getActualDigitalInputBits`."""
        return _bit(self.getActualDigitalInputBits(), input_id)

    getJointTemperatures = _getter("joint_temperatures", _vector, "Joint temperatures, °C.")
    getActualExecutionTime = _getter(
        "actual_execution_time", float, "Execution time of the controller's real-time thread."
    )
    getRobotMode = _getter("robot_mode", int, "Robot mode, a number of `urlink.packets.RobotMode`.")
    getJointMode = _getter("joint_mode", _integers, "Mode of each joint, numbers of `urlink.packets.JointMode`.")
    getSafetyMode = _getter("safety_mode", int, "Safety mode, a number of `urlink.packets.SafetyMode`.")
    getActualToolAccelerometer = _getter("actual_tool_accelerometer", _vector, "(3,) acceleration of the tool, m/s².")
    getSpeedScaling = _getter("speed_scaling", float, "Speed scaling of the trajectory limiter.")
    getTargetSpeedFraction = _getter("target_speed_fraction", float, "Target speed fraction: the slider.")

    def getSpeedScalingCombined(self) -> float:
        """The scaling of motions: speed scaling times target speed fraction, both of the same package."""
        state = self._stream.latest or self._stream.wait(_TIMEOUT)
        return float(state.speed_scaling * state.target_speed_fraction)

    getActualMomentum = _getter("actual_momentum", float, "Norm of the Cartesian linear momentum.")
    getActualMainVoltage = _getter("actual_main_voltage", float, "Main voltage of the safety control board, V.")
    getActualRobotVoltage = _getter(
        "actual_robot_voltage", float, "Robot voltage (48 V) of the safety control board, V."
    )
    getActualRobotCurrent = _getter("actual_robot_current", float, "Robot current of the safety control board, A.")
    getActualJointVoltage = _getter("actual_joint_voltage", _vector, "Joint voltages, V.")
    getActualDigitalOutputBits = _getter(
        "actual_digital_output_bits",
        int,
        "Digital outputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 of the tool.",
    )

    def getDigitalOutState(self, output_id: int) -> bool:
        """One digital output, by its bit in `getActualDigitalOutputBits`."""
        return _bit(self.getActualDigitalOutputBits(), output_id)

    getRuntimeState = _getter("runtime_state", int, "State of the program, a number of `urlink.packets.ProgramState`.")
    getStandardAnalogInput0 = _getter("standard_analog_input0", float, "Standard analogue input 0, A or V.")
    getStandardAnalogInput1 = _getter("standard_analog_input1", float, "Standard analogue input 1, A or V.")
    getStandardAnalogOutput0 = _getter("standard_analog_output0", float, "Standard analogue output 0, A or V.")
    getStandardAnalogOutput1 = _getter("standard_analog_output1", float, "Standard analogue output 1, A or V.")
    getRobotStatus = _getter(
        "robot_status_bits",
        int,
        "Bits of the robot status: 0 power on, 1 program running, 2 teach button, 3 power button.",
    )
    getSafetyStatusBits = _getter(
        "safety_status_bits", int, "Bits of the safety status, those of `urlink.SafetyStatusBits`."
    )

    def isProtectiveStopped(self) -> bool:
        """Whether a protective stop holds."""
        return bool(self.getSafetyStatusBits() & SafetyStatusBits.PROTECTIVE_STOPPED)

    def isEmergencyStopped(self) -> bool:
        """Whether an emergency stop holds."""
        return bool(self.getSafetyStatusBits() & SafetyStatusBits.EMERGENCY_STOPPED)

    getFtRawWrench = _getter("ft_raw_wrench", _vector, "Raw force and torque of the sensor, from 5.9 on: N and Nm.")
    getPayload = _getter("payload", float, "Mass of the payload, kg, from 3.11 and 5.5.1 on.")
    getPayloadCog = _getter("payload_cog", _vector, "(3,) centre of gravity of the payload, m.")
    getPayloadInertia = _getter(
        "payload_inertia", _vector, "(6,) inertia of the payload, kg m², from 3.15 and 5.11 on."
    )

    def getOutputIntRegister(self, output_id: int) -> int:
        """Output integer register, 0 to 47 by its own number."""
        return self._registers.read_integer(output_id)

    def getOutputDoubleRegister(self, output_id: int) -> float:
        """Output float register, 0 to 47 by its own number."""
        return self._registers.read_float(output_id)

    # -- recording ---------------------------------------------------------------------------------------

    def startFileRecording(self, filename: str, variables: Sequence[str] = ()) -> bool:
        """Write every package to a CSV file from now on: a row each, vectors as `name_0` to `name_5`.

        Args:
            filename: of the file, which is overwritten.
            variables: which of those that are received; none for all.

        Raises:
            LocalError: a recording is in progress, or a variable is not received.
            BadValue: the file cannot be written.
        """
        if self._recording is not None:
            raise LocalError("a recording is under way; stopFileRecording() ends it")
        state = self._stream.wait(_TIMEOUT)
        names = [name for name in variables or self._stream.names if variables or getattr(state, name) is not None]
        for name in names:
            self._value(name)
        try:
            file = Path(filename).open("w", newline="", encoding="utf-8")  # noqa: SIM115  # closed at the end
        except OSError as error:
            raise BadValue(f"cannot write {filename}: {error.strerror or error}") from error
        rows = csv.writer(file)
        rows.writerow([column for name in names for column in _columns(name, getattr(state, name))])
        subscription = self._stream.subscribe(
            lambda state: rows.writerow([cell for name in names for cell in _cells(getattr(state, name))]),
            policy=block,
        )
        self._recording = subscription, file
        return True

    def stopFileRecording(self) -> bool:
        """End the recording; False if there is none."""
        if getattr(self, "_recording", None) is None:
            return False
        assert self._recording is not None
        (subscription, file), self._recording = self._recording, None
        subscription.close()
        file.close()
        return True


def _bit(bits: int, number: int) -> bool:
    return bool(bits >> number & 1)


def _columns(name: str, value: Any) -> list[str]:
    is_array = isinstance(value, (np.ndarray, tuple))
    return [f"{name}_{index}" for index in range(len(value))] if is_array else [name]


def _cells(value: Any) -> list[Any]:
    if isinstance(value, np.ndarray):
        return list(value.tolist())
    return [int(each) for each in value] if isinstance(value, tuple) else [value]
