"""The view of `urlink monitor` at one moment: the values of a state, their age, and a line of text.

The values are the same for every interface and firmware; `monitor_panel` draws them.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from linkcore.clock import Stamp
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.statistics import StreamStatistics
from linkcore.text import printable
from linkcore.wire.packet import State

from ..protocol.enums import AnalogDomain
from ..protocol.primary.robot_state import MasterboardData, RobotModeData, RobotState, ToolData
from ..protocol.realtime.packets import RealtimeState
from .packet_stream import counted

#: Age of the newest state, in seconds, above which its values count as old although the connection exists. In this
#: time, a 10 Hz interface sends five states, and the real-time interface sends 60 or more states.
FRESH = 0.5
#: Fraction of the usual rate below which the status is SLOW, even if the newest state is recent.
ENOUGH = 0.95


@dataclass(frozen=True)
class AnalogSignal:
    """One analogue input or output; `place` is "in", "tool" or "out"."""

    place: str
    value: float
    unit: str


@dataclass(frozen=True)
class Reading:
    """One state as the monitor shows it. A value that the controller did not send is None or an empty vector.

    Attributes:
        received: Time of arrival.
        q: Joint positions in rad. Other values per joint: speeds in rad/s, currents in A, temperatures in degC.
        pose: Pose of the tool, in m and rad. Other attributes of the tool: speed in m/s and rad/s, force on the tool in
            N and Nm.
        robot_mode: Name of the robot mode. The other modes are also given as names.
        speed_scaling: Speed of the program; 1 is full speed.
        digital_inputs: Bit mask of the inputs; the outputs are a bit mask too.
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
        """Time since the state arrived, in seconds."""
        return 0.0 if self.received is None else max(self.received.age, 0.0)


def read(state: State) -> Reading:
    """Return the reading of a real-time state or a robot state."""
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
        # The safety status of newer firmware distinguishes stops that the safety mode does not distinguish.
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
    """Return the safety mode. CB2 does not send a safety mode; for CB2, derive it from the robot mode."""
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


class StreamStatus(enum.Enum):
    """Status of a stream, as one word. The status shows whether the displayed values are current."""

    CONNECTING = "CONNECTING"
    WAITING = "WAITING"
    CONNECTED = "CONNECTED"
    SLOW = "SLOW"
    SILENT = "SILENT"
    LOST = "LOST"
    ENDED = "ENDED"


def status_of(
    connection: ConnectionState,
    has_latest: bool,
    reading: Reading | None,
    rate: float | None = None,
    usual: float | None = None,
) -> StreamStatus:
    """Return the status of a stream.

    Args:
        connection: State of the stream's connection.
        has_latest: Whether the property `latest` of the stream is a state. After the connection was lost, `latest` is
            None.
        reading: Last reading, possibly old; None before the first state.
        rate: States per second; None if unknown.
        usual: States per second that the controller sends; None if unknown.
    """
    if connection is ConnectionState.CLOSED:
        return StreamStatus.ENDED
    if connection is ConnectionState.CONNECTED:
        if reading is None:
            return StreamStatus.WAITING
        if not has_latest or reading.age > FRESH:
            return StreamStatus.SILENT
        is_slow = rate is not None and usual is not None and rate < ENOUGH * usual
        return StreamStatus.SLOW if is_slow else StreamStatus.CONNECTED
    # While the stream is reconnecting, the status remains LOST.
    return StreamStatus.CONNECTING if reading is None else StreamStatus.LOST


@dataclass(frozen=True)
class MonitorView:
    """View of the monitor at one moment.

    Attributes:
        robot: Model and firmware.
        address: Address of the robot, and its interface.
        status: State of the stream, which shows whether the reading is current.
        reading: Newest reading, or the last reading before the connection was lost; None before the first reading.
        stats: Statistics of the stream.
        rate: States per second; None in the first second.
        usual: States per second that the controller sends; None if unknown.
        trouble: Last error of the connection, or None.
        message: Last robot message, or None.
    """

    robot: str
    address: str
    status: StreamStatus
    reading: Reading | None
    stats: StreamStatistics
    rate: float | None = None
    usual: float | None = None
    trouble: str | None = None
    message: str | None = None

    @property
    def is_fresh(self) -> bool:
        """Whether the reading is current."""
        return self.status in (StreamStatus.CONNECTED, StreamStatus.SLOW)


def rate_text(view: MonitorView) -> str:
    """Format the rate. If the rate is too low, add the usual rate: "111.0 of 500 Hz"."""
    if view.rate is None:
        return "- Hz"
    of = f" of {view.usual:g}" if view.status is StreamStatus.SLOW else ""
    return f"{view.rate:.1f}{of} Hz"


def line(view: MonitorView, clock: str) -> str:
    """Format the most important values as one line; old values are marked as old."""
    parts = [f"{clock} {view.status.value}", printable(view.robot)]
    reading, stats = view.reading, view.stats
    if view.is_fresh:
        parts.append(rate_text(view))
    elif view.trouble is not None and view.status is not StreamStatus.ENDED:
        parts.append(printable(view.trouble))
    if reading is None:
        parts.append("no state yet")
    else:
        parts.append(f"age {age_text(reading.age)}" if view.is_fresh else f"OLD DATA, {age_text(reading.age)}")
        if reading.q is not None:
            parts.append(f"q {_vector([math.degrees(value) for value in reading.q], 1)} deg")
        if reading.pose is not None:
            parts.append(f"tool {_vector(reading.pose[:3], 3)} m")
        modes = (("robot", reading.robot_mode), ("safety", reading.safety_mode), ("program", reading.program))
        parts += [f"{name} {printable(mode)}" for name, mode in modes if mode is not None]
    return " | ".join([*parts, counted(stats)])


def age_text(seconds: float) -> str:
    """Format an age, in short form: ``2 ms``, ``3.4 s``, ``12 min``."""
    if seconds < 1.0:
        return f"{seconds * 1000:.0f} ms"
    return f"{seconds:.1f} s" if seconds < 600.0 else f"{seconds / 60:.0f} min"


def _vector(values: Sequence[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)
