"""States of a robot in the structures of Robot Raconteur."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from RobotRaconteurCompanion.Util.DateTimeUtil import DateTimeUtil
from RobotRaconteurCompanion.Util.SensorDataUtil import SensorDataUtil

from urlink import LinkError
from urlink.packets import RealtimeState, RobotMode, SafetyMode

from .description import pose_array

__all__ = ["Commanded", "States", "controller_state_of"]

_ROBOT = "com.robotraconteur.robotics.robot"
#: Time, in s, without a state after which the robot counts as lost.
_SILENT = 0.5

_ESTOPS = (
    SafetyMode.SYSTEM_EMERGENCY_STOP,
    SafetyMode.ROBOT_EMERGENCY_STOP,
    SafetyMode.IMMI_EMERGENCY_STOP,
    SafetyMode.PROFISAFE_EMERGENCY_STOP,
)
_ERRORS = (SafetyMode.PROTECTIVE_STOP, SafetyMode.VIOLATION, SafetyMode.FAULT)
_CLEAR = (SafetyMode.NORMAL, SafetyMode.REDUCED, None)


@dataclass(frozen=True)
class Commanded:
    """Commands of clients at one moment.

    Attributes:
        mode: Name of the `RobotCommandMode`.
        refusal: Error with which a motion would be refused; None if it would not.
        has_position, has_velocity: Whether commands arrive by this wire.
        trajectory: Time since the trajectory started, in s, its duration, in s, and its waypoint; None without one.
    """

    mode: str
    refusal: LinkError | None
    has_position: bool = False
    has_velocity: bool = False
    trajectory: tuple[float, float, int] | None = None


def controller_state_of(state: RealtimeState | None) -> str:
    """Return the name of the `RobotControllerState`."""
    if state is None:
        return "undefined"
    safety = state.safety_mode
    if safety in _ESTOPS:
        return "emergency_stop"
    if safety not in _CLEAR:
        return "guard_stop"
    mode = state.robot_mode
    if mode in (RobotMode.BOOTING, RobotMode.CONFIRM_SAFETY, RobotMode.UPDATING_FIRMWARE):
        return "init"
    # Compare names, because CB2 uses other numbers. Its oldest firmware sends no mode.
    return "motor_on" if mode is None or mode.name.startswith("RUNNING") else "motor_off"


class States:
    """Factory of the structures of one robot."""

    def __init__(self, node: Any, device_info: Any) -> None:
        self._node = node
        self._device_info = device_info
        self._time = DateTimeUtil(node)
        self._headers = SensorDataUtil(node)
        constants = node.GetConstants(_ROBOT)
        self.modes: dict[str, int] = constants["RobotCommandMode"]
        self.controllers: dict[str, int] = constants["RobotControllerState"]
        self.operational: dict[str, int] = constants["RobotOperationalMode"]
        self._flags: dict[str, int] = constants["RobotStateFlags"]
        joints = node.GetConstants("com.robotraconteur.robotics.joints")
        self._position_units = np.full(6, joints["JointPositionUnits"]["radian"], np.uint8)
        self._effort_units = np.full(6, joints["JointEffortUnits"]["ampere"], np.uint8)
        self._simple = node.GetStructureType(f"{_ROBOT}.RobotState")
        self._advanced = node.GetStructureType(f"{_ROBOT}.AdvancedRobotState")
        self._sensor = node.GetStructureType(f"{_ROBOT}.RobotStateSensorData")
        self._velocity = node.GetNamedArrayDType("com.robotraconteur.geometry.SpatialVelocity")
        self.number = 0

    def flags(self, state: RealtimeState | None, commanded: Commanded) -> int:
        """Return the `RobotStateFlags`."""
        names = ["homed"]
        if state is None or state.received is None or state.received.age > _SILENT:
            names.append("communication_failure")
        else:
            if state.safety_mode in _ERRORS:
                names.append("error")
            if state.safety_mode == SafetyMode.FAULT:
                names.append("fatal_error")
            if state.safety_mode in _ESTOPS:
                names.append("estop")
            if controller_state_of(state) == "motor_on":
                names.append("enabled")
                if commanded.refusal is None:
                    names.append("ready")
        if commanded.has_position:
            names.append("valid_position_command")
        if commanded.has_velocity:
            names.append("valid_velocity_command")
        if commanded.trajectory is not None:
            names.append("trajectory_running")
        return sum(self._flags[name] for name in names)

    def make(self, state: RealtimeState, commanded: Commanded) -> tuple[Any, Any, Any, Any]:
        """Make `RobotState`, `AdvancedRobotState`, `RobotStateSensorData` and `DeviceTime`.

        All of them describe the same moment.
        """
        self.number += 1
        simple, advanced = self._simple(), self._advanced()
        pose = pose_array(self._node, state.tool_vector_actual)
        speed = np.zeros((1,), self._velocity)
        speed[0]["linear"] = tuple(state.tcp_speed_actual[:3])
        speed[0]["angular"] = tuple(state.tcp_speed_actual[3:])
        controller = self.controllers[controller_state_of(state)]
        flags, stamp = self.flags(state, commanded), self._time.TimeSpec3Now()
        for each in (simple, advanced):
            each.ts = stamp
            each.seqno = self.number
            each.command_mode = self.modes[commanded.mode]
            each.operational_mode = self.operational["cobot"]
            each.controller_state = controller
            each.robot_state_flags = flags
            each.joint_position = state.q_actual
            each.joint_velocity = state.qd_actual
            each.joint_effort = state.I_actual
            each.joint_position_command = state.q_target
            each.joint_velocity_command = state.qd_target
            each.kin_chain_tcp = pose
            each.kin_chain_tcp_vel = speed
            each.trajectory_running = commanded.trajectory is not None
        advanced.joint_position_units = self._position_units
        advanced.joint_effort_units = self._effort_units
        if commanded.trajectory is not None:
            now, whole, waypoint = commanded.trajectory
            advanced.trajectory_time = now
            advanced.trajectory_max_time = whole
            advanced.trajectory_current_waypoint = waypoint
        sensor = self._sensor()
        sensor.data_header = self._headers.FillSensorDataHeader(self._device_info, self.number)
        sensor.robot_state = advanced
        return simple, advanced, sensor, self._time.FillDeviceTime(self._device_info, self.number)
