"""The values of a state that the monitor shows: the same for every interface and firmware."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from linkcore.clock import Stamp
from linkcore.wire.packet import State

from ..interfaces.enums import AnalogDomain
from ..interfaces.primary.robot_state import MasterboardData, RobotModeData, RobotState, ToolData
from ..interfaces.realtime.packets import RealtimeState


@dataclass(frozen=True)
class AnalogSignal:
    """One analogue input or output; `place` is "in", "tool" or "out"."""

    place: str
    value: float
    unit: str


@dataclass(frozen=True)
class Reading:
    """One state as the monitor shows it; None, or an empty vector, is what the controller did not send.

    Attributes:
        received: when it arrived.
        q: joint positions, rad; likewise for each joint: speeds in rad/s, currents in A, temperatures in degC.
        pose: of the tool, m and rad; its speed in m/s and rad/s, the force on it in N and Nm.
        robot_mode: by name, as are the other modes.
        speed_scaling: 1 is the full speed of the program.
        digital_inputs: bit mask, as are the outputs.
    """

    received: Stamp | None
    q: Sequence[float] | None = None
    qd: Sequence[float] | None = None
    currents: Sequence[float] | None = None
    temperatures: Sequence[float] | None = None
    joint_modes: Sequence[str] | None = None
    pose: Sequence[float] | None = None
    speed: Sequence[float] | None = None
    force: Sequence[float] | None = None
    robot_mode: str | None = None
    safety_mode: str | None = None
    program: str | None = None
    speed_scaling: float | None = None
    digital_inputs: int | None = None
    digital_outputs: int | None = None
    analog: tuple[AnalogSignal, ...] = ()

    @property
    def age(self) -> float:
        """Seconds since it arrived."""
        return 0.0 if self.received is None else max(self.received.age, 0.0)


def read(state: State) -> Reading:
    """The reading of a real-time or robot state."""
    if isinstance(state, RealtimeState):
        return _realtime(state)
    assert isinstance(state, RobotState)
    return _primary(state)


def _numbers(vector: Any) -> list[float] | None:
    return None if vector is None else [float(element) for element in vector]


def _name(code: Any) -> str | None:
    return None if code is None else str(code.name)


def _realtime(state: RealtimeState) -> Reading:
    modes = state.joint_modes
    return Reading(
        received=state.received,
        q=_numbers(state.q_actual),
        qd=_numbers(state.qd_actual),
        currents=_numbers(state.I_actual),
        temperatures=_numbers(state.motor_temperatures),
        joint_modes=None if modes is None else [mode.name for mode in modes],
        pose=_numbers(state.tool_vector_actual),
        speed=_numbers(state.tcp_speed_actual),
        force=_numbers(state.tcp_force),
        robot_mode=_name(state.robot_mode),
        # In the status of newer firmware there are stops of their own which the mode does not distinguish.
        safety_mode=_name(state.safety_mode if state.safety_status is None else state.safety_status),
        program=_name(state.program_state),
        speed_scaling=state.speed_scaling,
        digital_inputs=state.digital_input_bits,
        digital_outputs=state.digital_output_bits,
    )


def _primary(state: RobotState) -> Reading:
    mode, joints, tool = state.robot_mode_data, state.joint_data, state.tool_data
    board, pose, force = state.masterboard_data, state.cartesian_info, state.force_mode_data
    return Reading(
        received=state.received,
        q=None if joints is None else _numbers(joints.q_actual),
        qd=None if joints is None else _numbers(joints.qd_actual),
        currents=None if joints is None else _numbers(joints.I_actual),
        temperatures=None if joints is None else _numbers(joints.T_motor),
        joint_modes=None if joints is None else [mode.name for mode in joints.joint_modes],
        pose=None if pose is None else [pose.X, pose.Y, pose.Z, pose.Rx, pose.Ry, pose.Rz],
        force=None if force is None else [force.Fx, force.Fy, force.Fz, force.Frx, force.Fry, force.Frz],
        robot_mode=None if mode is None else mode.robot_mode.name,
        safety_mode=_safety(mode, board),
        program=None if mode is None else _program(mode),
        speed_scaling=None if mode is None else mode.speed_scaling,
        digital_inputs=None if board is None else board.digital_input_bits,
        digital_outputs=None if board is None else board.digital_output_bits,
        analog=_analog(board, tool),
    )


def _safety(mode: RobotModeData | None, board: MasterboardData | None) -> str | None:
    """The safety mode; CB2 has none, so for CB2 what the flags of the robot mode say."""
    if board is not None and board.safety_mode is not None:
        return board.safety_mode.name
    if mode is None:
        return None
    if mode.is_emergency_stopped:
        return "EMERGENCY_STOP"
    return "PROTECTIVE_STOP" if mode.is_protective_stopped else "NORMAL"


def _program(mode: RobotModeData) -> str:
    if mode.is_program_paused:
        return "PAUSED"
    return "PLAYING" if mode.is_program_running else "STOPPED"


def _analog(board: MasterboardData | None, tool: ToolData | None) -> tuple[AnalogSignal, ...]:
    found = []
    if board is not None:
        found += [
            _one("in", board.analog_input_0, board.analog_input_range_0),
            _one("in", board.analog_input_1, board.analog_input_range_1),
        ]
    if tool is not None:
        found += [
            _one("tool", tool.analog_input_2, tool.analog_input_range_2),
            _one("tool", tool.analog_input_3, tool.analog_input_range_3),
        ]
    if board is not None:
        found += [
            _one("out", board.analog_output_0, board.analog_output_domain_0),
            _one("out", board.analog_output_1, board.analog_output_domain_1),
        ]
    return tuple(found)


def _one(place: str, value: float, domain: AnalogDomain) -> AnalogSignal:
    if domain == AnalogDomain.CURRENT:
        return AnalogSignal(place, value * 1000.0, "mA")
    return AnalogSignal(place, value, "V" if domain == AnalogDomain.VOLTAGE else "?")
