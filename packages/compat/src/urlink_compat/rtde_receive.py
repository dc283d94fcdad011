"""The receive interface of ur_rtde, over `robot.rtde`."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO, TypeVar

import numpy as np

import urlink
from urlink import BadValue, LocalError, Subscription, block
from urlink.rtde import OutputStream
from urlink.tools import SafetyStatusBits

from .interface import RtdeInterface, is_given, succeeds

__all__ = ["RTDEReceiveInterface"]

#: Maximum time in s to wait for a state if there is none: at the beginning, and after a lost connection.
_TIMEOUT = 5.0

_T = TypeVar("_T")


#: Default variables: the variables of all getters. Variables that a controller lacks are skipped.
_VARIABLES: list[str] = []


def _getter(name: str, convert: Callable[[Any], _T], doc: str) -> Callable[[RTDEReceiveInterface], _T]:
    """Return a method that returns the newest value of a variable."""

    def get(self: RTDEReceiveInterface) -> _T:
        return convert(self._value(name))

    _VARIABLES.append(name)
    get.__doc__ = doc
    return get


def _number(name: str, doc: str) -> Callable[[RTDEReceiveInterface], float]:
    return _getter(name, float, doc)


def _integer(name: str, doc: str) -> Callable[[RTDEReceiveInterface], int]:
    return _getter(name, int, doc)


def _integers(name: str, doc: str) -> Callable[[RTDEReceiveInterface], list[int]]:
    return _getter(name, lambda values: [int(value) for value in values], doc)


def _vector(name: str, doc: str) -> Callable[[RTDEReceiveInterface], list[float]]:
    return _getter(name, lambda values: values.tolist(), doc)


class RTDEReceiveInterface(RtdeInterface):
    """Variables of a controller, one method for each.  While the connection is lost, the methods wait for the next
    package.

        Args:
            hostname: Address of the robot.
            frequency: Packages per second; -1 for the controller's rate.
            variables: Names of the variables; none for all that the methods need.
            verbose: No effect.
            use_upper_range_registers: No effect, because registers are given by their own numbers.
            rt_priority: No effect.

        Raises:
            NoSuchVariable: If the controller does not have one of the named variables.
            BadValue: If the controller does not have this frequency, or a name is invalid.
            RemoteError: If the robot cannot be reached.
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
        self._recording: tuple[Subscription, TextIO] | None = None
        try:
            self._stream: OutputStream[Any] = self._robot.rtde.outputs(
                *(variables if is_given(variables) else _VARIABLES),
                frequency=None if frequency <= 0.0 else frequency,
                missing="error" if is_given(variables) else "leave_out",
            )
            self._registers = self._robot.rtde.registers(lower=True)
            self._stream.wait(_TIMEOUT)
        except BaseException:
            self.disconnect()
            raise

    def isConnected(self) -> bool:
        """Return whether packages arrive."""
        return self._stream.connection is urlink.ConnectionState.CONNECTED

    def reconnect(self) -> bool:
        """Wait until packages arrive again. A lost connection is restored automatically without this call."""
        return succeeds(lambda: self._stream.wait(2 * _TIMEOUT))

    def disconnect(self) -> None:
        """Disconnect, and end a recording. The object cannot be used again."""
        self.stopFileRecording()
        super().disconnect()

    # -- values ------------------------------------------------------------------------------------------

    def _value(self, name: str) -> Any:
        """Return the newest value of a variable.

        Raises:
            LocalError: If the variable was not requested, or the controller does not have it.
            RemoteError: If no packages arrive.
        """
        state = self._stream.latest or self._stream.wait(_TIMEOUT)
        value = getattr(state, name, None)
        if value is None:
            raise LocalError(f"{name} is not received: it was not requested, or this controller does not have it")
        return value

    getTimestamp = _number("timestamp", "Time since the start of the controller, in s.")
    getTargetQ = _vector("target_q", "Target joint positions, rad.")
    getTargetQd = _vector("target_qd", "Target joint speeds, rad/s.")
    getTargetQdd = _vector("target_qdd", "Target joint accelerations, rad/s².")
    getTargetCurrent = _vector("target_current", "Target joint currents, A.")
    getTargetMoment = _vector("target_moment", "Target joint torques, Nm.")
    getActualQ = _vector("actual_q", "Joint positions, rad.")
    getActualQd = _vector("actual_qd", "Joint speeds, rad/s.")
    getActualCurrent = _vector("actual_current", "Joint currents, A.")
    getJointControlOutput = _vector("joint_control_output", "Control currents of the joints, A.")
    getActualTCPPose = _vector("actual_TCP_pose", "Pose of the tool in the base frame: m, and rotation vector in rad.")
    getActualTCPSpeed = _vector("actual_TCP_speed", "Speed of the tool in the base frame: m/s and rad/s.")
    getActualTCPForce = _vector("actual_TCP_force", "Force at the tool: N and Nm.")
    getTargetTCPPose = _vector(
        "target_TCP_pose", "Target pose of the tool in the base frame: m, and rotation vector in rad."
    )
    getTargetTCPSpeed = _vector("target_TCP_speed", "Target speed of the tool in the base frame: m/s and rad/s.")
    getActualDigitalInputBits = _integer(
        "actual_digital_input_bits", "Digital inputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 of the tool."
    )

    def getDigitalInState(self, input_id: int) -> bool:
        """Return one digital input, by its bit in `getActualDigitalInputBits`."""
        return bool(self.getActualDigitalInputBits() >> input_id & 1)

    getJointTemperatures = _vector("joint_temperatures", "Joint temperatures, °C.")
    getActualExecutionTime = _number("actual_execution_time", "Execution time of the controller's real-time thread.")
    getRobotMode = _integer("robot_mode", "Robot mode, a number of `urlink.packets.RobotMode`.")
    getJointMode = _integers("joint_mode", "Mode of each joint, numbers of `urlink.packets.JointMode`.")
    getSafetyMode = _integer("safety_mode", "Safety mode, a number of `urlink.packets.SafetyMode`.")
    getActualToolAccelerometer = _vector("actual_tool_accelerometer", "Acceleration of the tool, shape (3,), m/s².")
    getSpeedScaling = _number("speed_scaling", "Speed scaling of the trajectory limiter.")
    getTargetSpeedFraction = _number("target_speed_fraction", "Target speed fraction: the slider.")

    def getSpeedScalingCombined(self) -> float:
        """Return the scaling of motions: speed scaling times target speed fraction, both from the same package."""
        state = self._stream.latest or self._stream.wait(_TIMEOUT)
        return float(state.speed_scaling * state.target_speed_fraction)

    getActualMomentum = _number("actual_momentum", "Norm of the Cartesian linear momentum.")
    getActualMainVoltage = _number("actual_main_voltage", "Main voltage of the safety control board, V.")
    getActualRobotVoltage = _number("actual_robot_voltage", "Robot voltage (48 V) of the safety control board, V.")
    getActualRobotCurrent = _number("actual_robot_current", "Robot current of the safety control board, A.")
    getActualJointVoltage = _vector("actual_joint_voltage", "Joint voltages, V.")
    getActualDigitalOutputBits = _integer(
        "actual_digital_output_bits", "Digital outputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 of the tool."
    )

    def getDigitalOutState(self, output_id: int) -> bool:
        """Return one digital output, by its bit in `getActualDigitalOutputBits`."""
        return bool(self.getActualDigitalOutputBits() >> output_id & 1)

    getRuntimeState = _integer("runtime_state", "State of the program, a number of `urlink.packets.ProgramState`.")
    getStandardAnalogInput0 = _number("standard_analog_input0", "Standard analogue input 0, A or V.")
    getStandardAnalogInput1 = _number("standard_analog_input1", "Standard analogue input 1, A or V.")
    getStandardAnalogOutput0 = _number("standard_analog_output0", "Standard analogue output 0, A or V.")
    getStandardAnalogOutput1 = _number("standard_analog_output1", "Standard analogue output 1, A or V.")
    getRobotStatus = _integer(
        "robot_status_bits", "Bits of the robot status: 0 power on, 1 program running, 2 teach button, 3 power button."
    )
    getSafetyStatusBits = _integer("safety_status_bits", "Bits of the safety status, as in `urlink.SafetyStatusBits`.")

    def isProtectiveStopped(self) -> bool:
        """Return whether a protective stop is active."""
        return bool(self.getSafetyStatusBits() & SafetyStatusBits.PROTECTIVE_STOPPED)

    def isEmergencyStopped(self) -> bool:
        """Return whether an emergency stop is active."""
        return bool(self.getSafetyStatusBits() & SafetyStatusBits.EMERGENCY_STOPPED)

    getFtRawWrench = _vector("ft_raw_wrench", "Raw force and torque of the sensor, N and Nm (5.9 or later).")
    getPayload = _number("payload", "Mass of the payload, kg (3.11 and 5.5.1, or later).")
    getPayloadCog = _vector("payload_cog", "Centre of gravity of the payload, shape (3,), m.")
    getPayloadInertia = _vector(
        "payload_inertia", "Inertia of the payload, shape (6,), kg m² (3.15 and 5.11, or later)."
    )

    def getOutputIntRegister(self, output_id: int) -> int:
        """Return output integer register 0 to 47, given by its own number."""
        return self._registers.read_integer(output_id)

    def getOutputDoubleRegister(self, output_id: int) -> float:
        """Return output float register 0 to 47, given by its own number."""
        return self._registers.read_float(output_id)

    # -- recording ---------------------------------------------------------------------------------------

    def startFileRecording(self, filename: str, variables: Sequence[str] = ()) -> bool:
        """Write every later package to a CSV file: one row each, vectors as `name_0` to `name_5`.

        Args:
            filename: Path of the file, which is overwritten.
            variables: Variables to write, among those that are received; none for all.

        Raises:
            LocalError: If a recording is in progress, or a variable is not received.
            BadValue: If the file cannot be written.
        """
        if self._recording is not None:
            raise LocalError("a recording is in progress; end it with stopFileRecording() first")
        state = self._stream.wait(_TIMEOUT)
        received = [name for name in self._stream.names if getattr(state, name) is not None]
        names = list(variables) if is_given(variables) else received
        for name in names:
            self._value(name)
        try:
            file = Path(filename).open("w", newline="", encoding="utf-8")  # noqa: SIM115  # closed at the end
        except OSError as error:
            raise BadValue(f"cannot write {filename}: {error.strerror or error}") from error
        rows = csv.writer(file)
        rows.writerow([column for name in names for column in _columns(name, getattr(state, name))])
        subscription = self._stream.subscribe(
            lambda state: rows.writerow([cell for name in names for cell in _cells(getattr(state, name))]), policy=block
        )
        self._recording = subscription, file
        return True

    def stopFileRecording(self) -> bool:
        """End the recording; return False if there is none."""
        if self._recording is None:
            return False
        (subscription, file), self._recording = self._recording, None
        subscription.close()
        file.close()
        return True


def _columns(name: str, value: Any) -> list[str]:
    is_array = isinstance(value, (np.ndarray, tuple))
    return [f"{name}_{index}" for index in range(len(value))] if is_array else [name]


def _cells(value: Any) -> list[Any]:
    if isinstance(value, np.ndarray):
        return list(value.tolist())
    return [int(each) for each in value] if isinstance(value, tuple) else [value]
