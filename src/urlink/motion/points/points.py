"""`robot.points`: mapping of the points in a file, and the methods that teach, check and import points."""

from __future__ import annotations

import os
from collections.abc import ItemsView, Iterator, KeysView, Mapping, ValuesView
from datetime import datetime, timezone
from typing import TYPE_CHECKING

import numpy as np

from linkcore.clock import Stamp
from linkcore.errors import BadValue
from linkcore.names import StrictAttributes
from linkcore.streaming.stream import Stream

from ...arm.vectors import FloatArray
from ...protocol.realtime.packets import RealtimeState
from ...session.identity import KnownIdentity
from ..moves.path import shown_tcp
from .point import Point, PointCheck, check_taught_on, difference, has_changed, reached
from .point_file import PointFile

if TYPE_CHECKING:
    from ...arm.kinematics import Arm


class Points(StrictAttributes, Mapping[str, Point]):
    """Points of a robot by name: a read-only mapping, with methods that change the file.

    Each access reads the file, so that changes by other programs are visible. Each change replaces the file in one
    step, under a lock. Changes by other programs that use the same lock are never lost.

    Args:
        file: File of the points.
        realtime: Stream with the position of the arm.
        who: Identity of the controller.
    """

    def __init__(self, file: PointFile, realtime: Stream[RealtimeState], who: KnownIdentity) -> None:
        self._file = file
        self._realtime = realtime
        self._who = who

    # -- mapping -------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Point:
        return self._file.point(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._file.read())

    def __len__(self) -> int:
        return len(self._file.read())

    # The views are of one reading of the file. Those of `Mapping` would read it again for each point.

    def keys(self) -> KeysView[str]:
        """Names of all points, in the order of the file."""
        return self._file.read().keys()

    def values(self) -> ValuesView[Point]:
        """All points, in the order of the file."""
        return self._file.read().values()

    def items(self) -> ItemsView[str, Point]:
        """Names and points, in the order of the file."""
        return self._file.read().items()

    # -- changes -------------------------------------------------------------------------------------

    def teach(self, name: str, *, replace: bool = False) -> Point:
        """Store the current position of the arm as a point, and return the point.

        Args:
            name: Name of the point: 1 to 100 printable characters.
            replace: Whether to replace a point that has this name.

        Raises:
            BadValue: If the name is invalid, if a point has this name and `replace` is False, or if the file is
                damaged. The file is unchanged.
            LocalError: If the controller does not report a known arm, or if the file cannot be locked or written.
            RemoteError: If no state arrives.
        """
        arm, state = self._arm_and_state()
        received = state.received or Stamp.now()
        point = Point(
            q=_rounded(state.q_actual),
            pose=_rounded(state.tool_vector_actual),
            tcp=_rounded(shown_tcp(arm, state)),
            model=arm.model.name,
            date=datetime.fromtimestamp(received.wall, timezone.utc).replace(microsecond=0),
        )
        self._file.add({name: point}, replace=replace)
        return point

    def add(self, name: str, point: Point, *, replace: bool = False) -> None:
        """Store a point, for example a point of another file.

        Args:
            name: Name of the point: 1 to 100 printable characters.
            point: The point.
            replace: Whether to replace a point that has this name.

        Raises:
            BadValue, LocalError: See `teach`.
        """
        if not isinstance(point, Point):
            raise BadValue(f"point is {point!r}; expected a urlink.Point")
        self._file.add({name: point}, replace=replace)

    def remove(self, name: str) -> Point:
        """Remove a point from the file, and return it.

        Raises:
            NoSuchPoint: If no point has this name.
            BadValue, LocalError: See `teach`.
        """
        return self._file.remove((name,))[0]

    def import_program(self, path: str | os.PathLike[str], *, replace: bool = False) -> dict[str, Point]:
        """Add the fixed waypoints of a program that PolyScope has saved (.urp), and return them.

        Waypoints of the types "relative" and "variable" have no position in the file, so they are left out.

        Args:
            path: Program file of an e-Series controller.
            replace: Whether to replace points that have the same names.

        Raises:
            BadValue: If the file is not such a program, if it has no fixed waypoint, if a waypoint belongs to another
                arm model, or if a point exists and `replace` is False. Nothing is imported.
            LocalError: See `teach`.
        """
        from .program_file import read_waypoints  # imported here, because it needs an XML parser

        points = read_waypoints(path, self._who.identity.kinematics.model)
        self._file.add(points, replace=replace)
        return points

    # -- checks --------------------------------------------------------------------------------------

    def check(self, name: str) -> PointCheck:
        """Check whether the current TCP reaches the taught pose of a point, without moving the arm.

        The check solves the inverse kinematics near the taught joint positions. Collisions are not checked.

        Raises:
            NoSuchPoint: If no point has this name.
            BadValue: If the file is damaged.
            LocalError: If the controller does not report a known arm.
            RemoteError: If no state arrives.
        """
        point = self._file.point(name)
        arm, state = self._arm_and_state()
        return checked(name, point, arm, state)

    def check_all(self) -> list[PointCheck]:
        """Check all points; see `check`."""
        points = self._file.read()
        arm, state = self._arm_and_state()
        return [checked(name, point, arm, state) for name, point in points.items()]

    def _arm_and_state(self) -> tuple[Arm, RealtimeState]:
        return self._who.identity.kinematics, self._realtime.wait()

    def __repr__(self) -> str:
        return f"<Points of {self._file.path}>"


def _rounded(row: FloatArray) -> FloatArray:
    """Return numbers without the digits below a nanometre, which only make the file harder to read."""
    return row.round(9) + 0.0  # turns -0.0 into 0.0


def checked(name: str, point: Point, arm: Arm, state: RealtimeState) -> PointCheck:
    """Return the check of a point with the TCP of a state."""
    tcp = shown_tcp(arm, state)
    moved, turned = difference(point.tcp, tcp)
    try:
        check_taught_on(point, arm)
    except BadValue as error:
        return PointCheck(name, "refused", str(error), moved, turned)
    if not has_changed(moved, turned):
        return PointCheck(name, "unchanged", "", moved, turned, point.q)
    try:
        q = reached(point, arm, tcp)
    except BadValue as error:  # also `Unreachable`
        return PointCheck(name, "unreachable", str(error), moved, turned)
    return PointCheck(name, "reachable", "", moved, turned, q, float(np.abs(q - point.q).max()))
