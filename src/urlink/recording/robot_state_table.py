"""Recorded robot states as a table: the columns of their sub-packages, and the messages between the states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from linkcore.errors import BadValue
from linkcore.names import unknown_attribute
from linkcore.recording.columns import ArrayColumns, Columns, JoinedColumns, PacketColumns, columns_of
from linkcore.recording.packets import states_of
from linkcore.recording.table import ClockColumn, Table
from linkcore.wire.packet import State

from ..protocol.primary.robot_message import OtherPackage, RobotMessage
from ..protocol.primary.robot_state import SUB_PACKAGES, RobotState, SubPackage, UnknownSubPackage, snake_case

_CLASSES = {
    snake_case(kind.__name__): kind
    for kinds in SUB_PACKAGES.values()
    for kind in kinds
    if kind is not UnknownSubPackage
}

#: Sub-packages that the controller sends only in the first state of a connection.
_FIRST_ONLY = ("kinematics_info", "configuration_data")

#: Function that converts record numbers to two arrays: times in s since the start of the recording, and wall times.
Timed = Callable[[Any], tuple[Any, Any]]


class RobotStates(Table):
    """Table with a row for each robot state, for example ``run.primary["joint_data.q_actual"]``. Made by `Recording`.

    The table has the columns of those sub-packages that every robot state contains. The method `of`, and attributes
    such as ``joint_data`` and ``tool_data``, return a table of one class of packets with its own times.

    Attributes:
        messages: Robot messages and other packages, in order of arrival, with their stamps.
    """

    def __init__(
        self,
        name: str,
        decoded: Sequence[tuple[int, State]],
        timed: Timed,
        begins: list[int],
        missing: Sequence[str],
        clock: ClockColumn | None = None,
    ) -> None:
        self._decoded = decoded
        self._timed = timed
        self._known: dict[type[State], Table] = {}
        states = [(record, state) for record, state in decoded if isinstance(state, RobotState)]
        records = np.array([record for record, _ in states], np.int64)
        by_class: dict[str, list[tuple[int, State]]] = {}
        for record, state in states:
            for part in state:
                by_class.setdefault(snake_case(type(part).__name__), []).append((record, part))
        everywhere: dict[str, Columns] = {
            part: _columns(found)
            for part, found in by_class.items()
            if part in _CLASSES and part not in _FIRST_ONLY and [record for record, _ in found] == records.tolist()
        }
        time, wall = timed(records)
        begins = np.searchsorted(records, begins).tolist()
        super().__init__(name, JoinedColumns(everywhere), time, wall, begins, missing, clock)
        self.messages = [state for _, state in decoded if isinstance(state, (RobotMessage, OtherPackage))]

    @property
    def robot_messages(self) -> list[State]:
        """Robot messages in `messages`. The table ``of(RobotMessage)`` has one row for each of them."""
        return [state for state in self.messages if isinstance(state, RobotMessage)]

    def of(self, kind: type[State]) -> Table:
        """Return a table of all packets of one class: sub-packages, robot messages, or `OtherPackage`.

        Raises:
            BadValue: If `kind` is not one of these classes.
        """
        if not (isinstance(kind, type) and issubclass(kind, (SubPackage, RobotMessage, OtherPackage))):
            raise BadValue(f"kind={kind!r}; expected a class of sub-packages or messages, such as JointData")
        if kind not in self._known:
            found = [
                (record, part)
                for record, state in self._decoded
                for part in (state if isinstance(state, RobotState) else (state,))
                if isinstance(part, kind)
            ]
            time, wall = self._timed(np.array([record for record, _ in found], np.int64))
            self._known[kind] = Table(kind.__name__, _columns(found), time, wall)
        return self._known[kind]

    def __getattr__(self, name: str) -> Table:
        if name not in _CLASSES:
            raise unknown_attribute(self, name)
        return self.of(_CLASSES[name])

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *_CLASSES})


def _columns(found: Sequence[tuple[int, State]]) -> Columns:
    states = [state for _, state in found]
    if not states:
        return ArrayColumns({}, {})
    if any(state._layout.has_text for state in states):
        return columns_of(states)
    return PacketColumns(states_of(found))
