"""The receive interface of ur_rtde, over `robot.rtde`."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

import urlink
from linkcore.errors import BadValue, LocalError
from linkcore.streaming.policy import block
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

    def _vector(self, name: str) -> list[float]:
        values: list[float] = self._value(name).tolist()
        return values

    def _number(self, name: str) -> float:
        return float(self._value(name))

    def _integer(self, name: str) -> int:
        return int(self._value(name))

    def getTimestamp(self) -> float:
        """Seconds since the controller was started."""
        return self._number("timestamp")

    def getTargetQ(self) -> list[float]:
        """Target joint positions, rad."""
        return self._vector("target_q")

    def getTargetQd(self) -> list[float]:
        """Target joint speeds, rad/s."""
        return self._vector("target_qd")

    def getTargetQdd(self) -> list[float]:
        """Target joint accelerations, rad/s²."""
        return self._vector("target_qdd")

    def getTargetCurrent(self) -> list[float]:
        """Target joint currents, A."""
        return self._vector("target_current")

    def getTargetMoment(self) -> list[float]:
        """Target joint torques, Nm."""
        return self._vector("target_moment")

    def getActualQ(self) -> list[float]:
        """Joint positions, rad."""
        return self._vector("actual_q")

    def getActualQd(self) -> list[float]:
        """Joint speeds, rad/s."""
        return self._vector("actual_qd")

    def getActualCurrent(self) -> list[float]:
        """Joint currents, A."""
        return self._vector("actual_current")

    def getJointControlOutput(self) -> list[float]:
        """Control currents of the joints, A."""
        return self._vector("joint_control_output")

    def getActualTCPPose(self) -> list[float]:
        """Pose of the tool in the base frame: m, and rotation vector in rad."""
        return self._vector("actual_TCP_pose")

    def getActualTCPSpeed(self) -> list[float]:
        """Speed of the tool in the base frame: m/s and rad/s."""
        return self._vector("actual_TCP_speed")

    def getActualTCPForce(self) -> list[float]:
        """Force at the tool: N and Nm."""
        return self._vector("actual_TCP_force")

    def getTargetTCPPose(self) -> list[float]:
        """Target pose of the tool in the base frame: m, and rotation vector in rad."""
        return self._vector("target_TCP_pose")

    def getTargetTCPSpeed(self) -> list[float]:
        """Target speed of the tool in the base frame: m/s and rad/s."""
        return self._vector("target_TCP_speed")

    def getActualDigitalInputBits(self) -> int:
        """Digital inputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 of the tool."""
        return self._integer("actual_digital_input_bits")

    def getDigitalInState(self, input_id: int) -> bool:
        """One digital input, by its bit in `getActualDigitalInputBits`."""
        return _bit(self.getActualDigitalInputBits(), input_id)

    def getJointTemperatures(self) -> list[float]:
        """Joint temperatures, °C."""
        return self._vector("joint_temperatures")

    def getActualExecutionTime(self) -> float:
        """Execution time of the controller's real-time thread."""
        return self._number("actual_execution_time")

    def getRobotMode(self) -> int:
        """Robot mode, a number of `urlink.packets.RobotMode`."""
        return self._integer("robot_mode")

    def getJointMode(self) -> list[int]:
        """Mode of each joint, numbers of `urlink.packets.JointMode`."""
        return [int(mode) for mode in self._value("joint_mode")]

    def getSafetyMode(self) -> int:
        """Safety mode, a number of `urlink.packets.SafetyMode`."""
        return self._integer("safety_mode")

    def getActualToolAccelerometer(self) -> list[float]:
        """(3,) acceleration of the tool, m/s²."""
        return self._vector("actual_tool_accelerometer")

    def getSpeedScaling(self) -> float:
        """Speed scaling of the trajectory limiter."""
        return self._number("speed_scaling")

    def getTargetSpeedFraction(self) -> float:
        """Target speed fraction: the slider."""
        return self._number("target_speed_fraction")

    def getSpeedScalingCombined(self) -> float:
        """The scaling of motions: speed scaling times target speed fraction, both of the same package."""
        state = self._stream.latest or self._stream.wait(_TIMEOUT)
        return float(state.speed_scaling * state.target_speed_fraction)

    def getActualMomentum(self) -> float:
        """Norm of the Cartesian linear momentum."""
        return self._number("actual_momentum")

    def getActualMainVoltage(self) -> float:
        """Main voltage of the safety control board, V."""
        return self._number("actual_main_voltage")

    def getActualRobotVoltage(self) -> float:
        """Robot voltage (48 V) of the safety control board, V."""
        return self._number("actual_robot_voltage")

    def getActualRobotCurrent(self) -> float:
        """Robot current of the safety control board, A."""
        return self._number("actual_robot_current")

    def getActualJointVoltage(self) -> list[float]:
        """Joint voltages, V."""
        return self._vector("actual_joint_voltage")

    def getActualDigitalOutputBits(self) -> int:
        """Digital outputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 of the tool."""
        return self._integer("actual_digital_output_bits")

    def getDigitalOutState(self, output_id: int) -> bool:
        """One digital output, by its bit in `getActualDigitalOutputBits`."""
        return _bit(self.getActualDigitalOutputBits(), output_id)

    def getRuntimeState(self) -> int:
        """State of the program, a number of `urlink.packets.ProgramState`."""
        return self._integer("runtime_state")

    def getStandardAnalogInput0(self) -> float:
        """Standard analogue input 0, A or V."""
        return self._number("standard_analog_input0")

    def getStandardAnalogInput1(self) -> float:
        """Standard analogue input 1, A or V."""
        return self._number("standard_analog_input1")

    def getStandardAnalogOutput0(self) -> float:
        """Standard analogue output 0, A or V."""
        return self._number("standard_analog_output0")

    def getStandardAnalogOutput1(self) -> float:
        """Standard analogue output 1, A or V."""
        return self._number("standard_analog_output1")

    def getRobotStatus(self) -> int:
        """Bits of the robot status: 0 power on, 1 program running, 2 teach button, 3 power button."""
        return self._integer("robot_status_bits")

    def getSafetyStatusBits(self) -> int:
        """Bits of the safety status, those of `urlink.SafetyStatusBits`."""
        return self._integer("safety_status_bits")

    def isProtectiveStopped(self) -> bool:
        """Whether a protective stop holds."""
        return bool(self.getSafetyStatusBits() & SafetyStatusBits.PROTECTIVE_STOPPED)

    def isEmergencyStopped(self) -> bool:
        """Whether an emergency stop holds."""
        return bool(self.getSafetyStatusBits() & SafetyStatusBits.EMERGENCY_STOPPED)

    def getFtRawWrench(self) -> list[float]:
        """Raw force and torque of the sensor, from 5.9 on: N and Nm."""
        return self._vector("ft_raw_wrench")

    def getPayload(self) -> float:
        """Mass of the payload, kg, from 3.11 and 5.5.1 on."""
        return self._number("payload")

    def getPayloadCog(self) -> list[float]:
        """(3,) centre of gravity of the payload, m."""
        return self._vector("payload_cog")

    def getPayloadInertia(self) -> list[float]:
        """(6,) inertia of the payload, kg m², from 3.15 and 5.11 on."""
        return self._vector("payload_inertia")

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
