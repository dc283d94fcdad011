"""`StopRecord`: the data from which the cause of a stop is found, from live packets, a recording or a table of a log.

Every column is optional, because real logs rarely contain all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from linkcore.clock import Stamp
from linkcore.errors import PacketError, RemoteError
from linkcore.streaming.flight_record import Received, Sent
from linkcore.wire.framing import PacketProtocol

from ..arm.models import Model
from ..arm.vectors import FloatArray
from ..protocol.enums import ProgramState, RobotModeCB2, SafetyMode
from ..protocol.primary.robot_message import KeyMessage, RobotCommMessage
from ..protocol.realtime.packets import RealtimeState

#: Columns that a diagnosis uses, by their names on the real-time interface.
COLUMNS = (
    "q_target",
    "qd_target",
    "I_target",
    "I_actual",
    "q_actual",
    "qd_actual",
    "tool_vector_actual",
    "tcp_speed_target",
    "tcp_force",
    "robot_mode",
    "safety_mode",
    "safety_status",
    "speed_scaling",
    "program_state",
)

#: Bits of the RTDE variable `safety_status_bits`, with the safety mode that each of them means.
_BITS = {
    9: SafetyMode.FAULT,
    8: SafetyMode.VIOLATION,
    6: SafetyMode.ROBOT_EMERGENCY_STOP,
    5: SafetyMode.SYSTEM_EMERGENCY_STOP,
    7: SafetyMode.ROBOT_EMERGENCY_STOP,
    4: SafetyMode.SAFEGUARD_STOP,
    2: SafetyMode.PROTECTIVE_STOP,
    3: SafetyMode.RECOVERY,
    10: SafetyMode.PROTECTIVE_STOP,
}
_MODES_CB2 = {
    RobotModeCB2.SECURITY_STOPPED: SafetyMode.PROTECTIVE_STOP,
    RobotModeCB2.EMERGENCY_STOPPED: SafetyMode.ROBOT_EMERGENCY_STOP,
    RobotModeCB2.FATAL_ERROR: SafetyMode.FAULT,
    RobotModeCB2.SAFEGUARD_STOP: SafetyMode.SAFEGUARD_STOP,
}
#: Safety modes that are not a stop, and the number for an unknown mode.
_GOOD = np.array([0, SafetyMode.NORMAL, SafetyMode.REDUCED], dtype=np.float64)
#: For inferred stops: time before the row in s, speed in rad/s of a moving arm, and deviation in rad that is far.
_MOVED, _MOVING, _FAR = 0.15, 0.02, 0.03


class Report(NamedTuple):
    """Report of the controller with a code.

    Attributes:
        time: Arrival, in s, on the time axis of the record.
        code, argument: Number of the report, and its argument.
        text: Text of the controller; it might be empty.
    """

    time: float
    code: int
    argument: int
    text: str


class Key(NamedTuple):
    """Report of the controller about a program.

    Attributes:
        time: Arrival, in s, on the time axis of the record.
        title: Title, such as "PROGRAM_XXX_STARTED".
        text: Name of the program.
    """

    time: float
    title: str
    text: str


class StopMoment(NamedTuple):
    """Row in which a stop is first reported.

    Attributes:
        row: Number of the row.
        mode: Safety mode that is reported.
        had_begun: Whether the record begins with the stop, so that nothing before it is known.
    """

    row: int
    mode: SafetyMode
    had_begun: bool = False


@dataclass
class StopRecord:
    """Columns, reports and sent messages around one or more stops.

    Attributes:
        time: Time of each row, in s, shape (n,).
        columns: Name -> values, shape (n,) or (n, k); NaN for values that are not known.
        reports: Reports with a code, in order of arrival; None if none could be recorded.
        keys: Reports about programs; None if none could be recorded.
        sent: Messages that this program sent to the robot.
        is_own: Function that returns whether this program sent the program with a given name; None if it is unknown.
        model: Model of the arm; None if it is unknown.
        is_cb2: Whether the robot modes are those of CB2.
        missing: Remarks about data that are not there.
    """

    time: FloatArray
    columns: Mapping[str, FloatArray]
    reports: Sequence[Report] | None = None
    keys: Sequence[Key] | None = None
    sent: Sequence[Sent] = ()
    is_own: Callable[[str], bool] | None = None
    model: Model | None = None
    is_cb2: bool = False
    missing: list[str] = field(default_factory=list)

    @property
    def safety(self) -> FloatArray | None:
        """Safety mode of each row, as a number, 0 if it is unknown; None if no column contains it."""
        every = self._safety_columns
        # Logs can contain a column that is not updated, beside one that is.
        return next((each for each in every if (~np.isin(each, _GOOD)).any()), every[0] if every else None)

    @property
    def _safety_columns(self) -> list[FloatArray]:
        known, found = self.columns, []
        for name in ("safety_status", "safety_mode"):
            column = known.get(name)
            if column is not None and column.ndim == 1 and np.isfinite(column).any():
                found.append(np.nan_to_num(column))
        bits = known.get("safety_status_bits")
        if bits is not None and bits.ndim == 1:
            modes = np.where(np.isfinite(bits), float(SafetyMode.NORMAL), 0.0)
            whole = np.nan_to_num(bits).astype(np.int64)
            for bit, mode in reversed(_BITS.items()):
                modes = np.where((whole >> bit) & 1 == 1, float(mode), modes)
            found.append(modes)
        if self.is_cb2 and "robot_mode" in known:
            robot = known["robot_mode"]
            modes = np.where(np.isfinite(robot), float(SafetyMode.NORMAL), 0.0)
            for robot_mode, mode in _MODES_CB2.items():
                modes = np.where(robot == robot_mode, float(mode), modes)
            found.append(modes)
        return found

    @property
    def stops(self) -> list[StopMoment]:
        """Rows in which a safety stop begins. If no column contains the safety mode, stops are inferred."""
        modes = self.safety
        if modes is None:
            return self._inferred
        if not len(modes):
            return []
        stopped = ~np.isin(modes, _GOOD)
        begins = (np.flatnonzero(stopped[1:] & ~stopped[:-1]) + 1).tolist()
        found = [StopMoment(row, SafetyMode(int(modes[row]))) for row in begins]
        return [StopMoment(0, SafetyMode(int(modes[0])), had_begun=True), *found] if stopped[0] else found

    @property
    def _inferred(self) -> list[StopMoment]:
        """Rows in which the program stops while the arm moves, or in which a joint begins to leave its target far."""
        known, rows = self.columns, []
        state, speeds = known.get("program_state"), known.get("qd_target", known.get("qd_actual"))
        if state is not None and state.ndim == 1 and speeds is not None and speeds.ndim == 2 and len(state) > 1:
            is_playing = state == ProgramState.PLAYING
            for row in (np.flatnonzero(is_playing[:-1] & ~is_playing[1:]) + 1).tolist():
                before = speeds[np.searchsorted(self.time, self.time[row] - _MOVED) : row]
                if len(before) and np.nanmax(np.abs(before), initial=0.0) > _MOVING:
                    rows.append(row)
        target, actual = known.get("q_target"), known.get("q_actual")
        if not rows and target is not None and actual is not None and target.shape == actual.shape and len(target) > 1:
            is_far = np.nan_to_num(np.abs(actual - target)).reshape(len(target), -1).max(axis=1) > _FAR
            rows = (np.flatnonzero(is_far[1:] & ~is_far[:-1]) + 1).tolist()
        return [StopMoment(row, SafetyMode.UNDEFINED) for row in rows]

    def between(self, begin: float, end: float) -> StopRecord:
        """Return the rows and messages from `begin` to `end`, in s."""
        rows = slice(*np.searchsorted(self.time, (begin, end), side="left").tolist())
        return StopRecord(
            self.time[rows],
            {name: column[rows] for name, column in self.columns.items()},
            None if self.reports is None else [each for each in self.reports if begin <= each.time <= end],
            None if self.keys is None else [each for each in self.keys if begin <= each.time <= end],
            [each for each in self.sent if begin <= each.time <= end],
            self.is_own,
            self.model,
            self.is_cb2,
            list(self.missing),
        )


def packets_in(chunks: Iterable[Received], make: Callable[[], PacketProtocol]) -> list[Any]:
    """Return the packets in received bytes. Packets that cannot be decoded are skipped.

    Args:
        chunks: Received bytes; an empty chunk marks a new connection.
        make: Function that returns the protocol of a connection.
    """
    protocol, found = make(), []
    for chunk in chunks:
        if not chunk.data:
            protocol = make()
            continue
        try:
            frames = protocol.framer.feed(chunk.data)
        except RemoteError:
            protocol = make()
            continue
        for frame in frames:
            try:
                found.append(protocol.decode(frame, Stamp(chunk.time, chunk.time)))
            except PacketError:
                continue
    return found


def columns_of(states: Sequence[RealtimeState]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the arrival times and the columns of real-time states."""
    time = np.array([np.nan if each.received is None else each.received.monotonic for each in states])
    columns: dict[str, FloatArray] = {}
    for name in COLUMNS:
        values = [getattr(each, name) for each in states]
        first = next((value for value in values if value is not None), None)
        if first is not None:
            lacking = np.full(np.shape(first), np.nan)
            columns[name] = np.array([lacking if value is None else value for value in values], dtype=np.float64)
    return time, columns


def messages_of(packets: Iterable[Any]) -> tuple[list[Report], list[Key]]:
    """Return the reports with codes, and the reports about programs, in packets of the primary interface."""
    reports, keys = [], []
    for each in packets:
        if each.received is None:
            continue
        time = each.received.monotonic
        if isinstance(each, RobotCommMessage):
            reports.append(Report(time, each.code, each.argument, each.text))
        elif isinstance(each, KeyMessage):
            keys.append(Key(time, each.title, each.text))
    return reports, keys
