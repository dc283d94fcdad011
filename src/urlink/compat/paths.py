"""Paths of ur_rtde's `movePath`, as waypoints of `robot.motion.path`."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

from linkcore.errors import BadValue
from urlink.motion.path import Joint, Linear, Waypoint
from urlink.vectors import six

from .interface import NotOffered

__all__ = ["Path", "PathEntry"]


class _MoveType(IntEnum):
    MoveJ = 0
    MoveL = 1
    MoveP = 2
    MoveC = 3


class _PositionType(IntEnum):
    PositionTcpPose = 0
    PositionJoints = 1


class PathEntry:
    """One movement of a path.

    Args:
        move_type: `MoveJ`, `MoveL` or `MoveP`; an arc (`MoveC`) is not offered.
        position_type: `PositionTcpPose` or `PositionJoints`; it must suit the movement: joints for `MoveJ`, poses for
            `MoveL` and `MoveP`.
        parameters: six coordinates, speed, acceleration, and blend radius in m.

    Raises:
        BadValue: not nine numbers.
        NotOffered: an arc, or a position type that does not suit the movement.
    """

    eMoveType, ePositionType = _MoveType, _PositionType
    MoveJ, MoveL, MoveP, MoveC = _MoveType
    PositionTcpPose, PositionJoints = _PositionType

    def __init__(self, move_type: int, position_type: int, parameters: Sequence[float]) -> None:
        self._waypoint = _waypoint(_MoveType(move_type), _PositionType(position_type), list(parameters))


def _waypoint(move: _MoveType, position: _PositionType, parameters: list[float]) -> Waypoint:
    if len(parameters) != 9:
        raise BadValue(f"{parameters!r}; expected six coordinates, speed, acceleration and blend")
    *place, speed, acceleration, blend = parameters
    goal = six(place, "path entry").tolist()
    if move is _MoveType.MoveJ and position is _PositionType.PositionJoints:
        return Joint(goal, blend=blend, speed=speed, acceleration=acceleration)
    if move in (_MoveType.MoveL, _MoveType.MoveP) and position is _PositionType.PositionTcpPose:
        return Linear(goal, blend=blend, speed=speed, acceleration=acceleration)
    raise NotOffered(f"{move.name} with {position.name}: use urlink's robot.motion.path, which has arcs too")


class Path:
    """A sequence of movements."""

    def __init__(self) -> None:
        self._entries: list[PathEntry] = []

    def addEntry(self, entry: PathEntry) -> None:
        """Add one movement."""
        self._entries.append(entry)

    def appendMovejPath(self, path: Sequence[Sequence[float]]) -> None:
        """Add joint movements: six joint positions, speed, acceleration and blend of each."""
        self._entries += [PathEntry(_MoveType.MoveJ, _PositionType.PositionJoints, each) for each in path]

    def appendMovelPath(self, path: Sequence[Sequence[float]]) -> None:
        """Add lines of the tool: a pose, speed, acceleration and blend of each."""
        self._entries += [PathEntry(_MoveType.MoveL, _PositionType.PositionTcpPose, each) for each in path]

    def clear(self) -> None:
        """Remove all movements."""
        self._entries.clear()

    def size(self) -> int:
        """The number of movements."""
        return len(self._entries)

    def waypoints(self) -> list[PathEntry]:
        """The movements."""
        return list(self._entries)

    def _waypoints(self) -> list[Waypoint]:
        return [entry._waypoint for entry in self._entries]
