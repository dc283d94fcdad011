"""Motions of ur_rtde's control interface, single or along a path, and the kinematics that they need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any, overload

from urlink import BadValue, Joint, Linear, Motion, SessionLimits
from urlink.arm.kinematics import Unreachable
from urlink.motion import PathMotion, Waypoint
from urlink.packets import CartesianInfo
from urlink.tools import six, text, tool_offset

from .interface import Blocks, NotOffered, RtdeInterface, is_given, succeeds

__all__ = ["LONGEST", "STATE_TIMEOUT", "AsyncOperationStatus", "ControlMoves", "Path", "PathEntry"]


class _MoveType(IntEnum):
    MoveJ = 0
    MoveL = 1
    MoveP = 2
    MoveC = 3


class _PositionType(IntEnum):
    PositionTcpPose = 0
    PositionJoints = 1


class PathEntry:
    """One motion of a path.

    Args:
        move_type: Type `MoveJ`, `MoveL` or `MoveP`. An arc (`MoveC`) is not offered.
        position_type: Type `PositionTcpPose` or `PositionJoints`. It must match the motion: joints for `MoveJ`, poses
            for `MoveL` and `MoveP`.
        parameters: Six coordinates, speed, acceleration, and blend radius in m.

    Raises:
        BadValue: If `parameters` is not nine numbers.
        NotOffered: If the motion is an arc, or the position type does not match the motion.
    """

    eMoveType, ePositionType = _MoveType, _PositionType
    MoveJ, MoveL, MoveP, MoveC = _MoveType
    PositionTcpPose, PositionJoints = _PositionType

    def __init__(self, move_type: int, position_type: int, parameters: Sequence[float]) -> None:
        self._waypoint = _waypoint(_MoveType(move_type), _PositionType(position_type), list(parameters))


def _waypoint(move: _MoveType, position: _PositionType, parameters: list[float]) -> Waypoint:
    if len(parameters) != 9:
        raise BadValue(f"parameters={parameters!r}; expected six coordinates, speed, acceleration and blend")
    *place, speed, acceleration, blend = parameters
    goal = six(place, "path entry").tolist()
    if move is _MoveType.MoveJ and position is _PositionType.PositionJoints:
        return Joint(goal, blend=blend, speed=speed, acceleration=acceleration)
    if move in (_MoveType.MoveL, _MoveType.MoveP) and position is _PositionType.PositionTcpPose:
        return Linear(goal, blend=blend, speed=speed, acceleration=acceleration)
    raise NotOffered(
        f"{move.name} with {position.name} is not offered; use robot.motion.path of urlink, which has arcs"
    )


class Path:
    """Sequence of motions."""

    def __init__(self) -> None:
        self._entries: list[PathEntry] = []

    def addEntry(self, entry: PathEntry) -> None:
        """Add one motion."""
        self._entries.append(entry)

    def appendMovejPath(self, path: Sequence[Sequence[float]]) -> None:
        """Add joint motions: six joint positions, speed, acceleration and blend for each."""
        self._entries += [PathEntry(_MoveType.MoveJ, _PositionType.PositionJoints, each) for each in path]

    def appendMovelPath(self, path: Sequence[Sequence[float]]) -> None:
        """Add lines of the tool: a pose, speed, acceleration and blend for each."""
        self._entries += [PathEntry(_MoveType.MoveL, _PositionType.PositionTcpPose, each) for each in path]

    def clear(self) -> None:
        """Remove all motions."""
        self._entries.clear()

    def size(self) -> int:
        """Return the number of motions."""
        return len(self._entries)

    def waypoints(self) -> list[PathEntry]:
        """Return the motions."""
        return list(self._entries)


#: Maximum time in s to wait for the end of a motion, as in the other client.
LONGEST = 300.0
#: Maximum time in s to wait for a state.
STATE_TIMEOUT = 5.0


class AsyncOperationStatus:
    """Progress of an asynchronous motion.

    Args:
        value: Status word of the other client: bits 24 to 30 are the number of the operation, 16 to 23 a count of
            changes, 15 whether it is running, and 0 to 14 its progress.
    """

    def __init__(self, value: int) -> None:
        self._value = value

    def value(self) -> int:
        """Return the status word."""
        return self._value

    def isAsyncOperationRunning(self) -> bool:
        """Return whether the operation is running."""
        return bool(self._value >> 15 & 1)

    def operationId(self) -> int:
        """Return the number of the operation. Two consecutive operations have different numbers."""
        return self._value >> 24 & 0x7F

    def changeCount(self) -> int:
        """Return the count of the changes of the status."""
        return self._value >> 16 & 0xFF

    def progress(self) -> int:
        """Return the number of the current motion of a path, starting from 0."""
        return self._value & 0x7FFF

    def equals(self, other: AsyncOperationStatus) -> bool:
        """Return whether both have the same value."""
        return self._value == other._value


class ControlMoves(RtdeInterface):
    """Kinematics, motions that end on their own, and stops.

    Args:
        hostname: Address of the robot.
        frequency: Frequency of the loop for `initPeriod` and `waitPeriod`, in Hz; -1 for the controller's rate.

    Raises:
        RemoteError: If the robot cannot be reached.
    """

    def __init__(self, hostname: str, frequency: float = -1.0, *, limits: SessionLimits | None = None) -> None:
        super().__init__(hostname, frequency, limits=limits)
        try:
            self._robot.primary.wait(STATE_TIMEOUT)
        except BaseException:
            super().disconnect()
            raise
        self._blocks = Blocks(self._robot)
        #: Last set-point, with its look-ahead time and gain; None if no servo is open.
        self._last: tuple[list[float], float, float] | None = None
        self._operation: Motion | None = None
        self._operations = 0

    def getTCPOffset(self) -> list[float]:
        """Return the TCP, a pose in the flange frame, in m and rad (firmware 3.2 or later)."""
        feed = self._robot.primary.of(CartesianInfo)
        info = feed.latest or feed.wait(STATE_TIMEOUT)
        offset = tool_offset(info)
        if offset is None:
            raise NotOffered("this controller does not send its TCP offset; firmware 3.2 or later is required")
        return offset

    def getForwardKinematics(self, q: Sequence[float] = (), tcp_offset: Sequence[float] = ()) -> list[float]:
        """Return the pose of the tool at joint positions; without arguments, at the current positions and TCP."""
        values = q if is_given(q) else self._robot.realtime.wait(STATE_TIMEOUT).q_actual
        tcp = tcp_offset if is_given(tcp_offset) else self.getTCPOffset()
        return list(map(float, self._robot.kinematics.forward(values, tcp)))

    def getInverseKinematics(
        self,
        x: Sequence[float],
        qnear: Sequence[float] = (),
        max_position_error: float = 1e-10,
        max_orientation_error: float = 1e-10,
    ) -> list[float]:
        """Return the joint positions for a pose of the tool, closest to `qnear` or to the target joint positions.

        The maximum errors have no effect, because the result is exact to 1e-12 m and rad.

        Raises:
            Unreachable: If the pose is out of reach.
        """
        near = qnear if is_given(qnear) else self._robot.realtime.wait(STATE_TIMEOUT).q_target
        return list(map(float, self._robot.kinematics.inverse(x, near, self.getTCPOffset())))

    def getInverseKinematicsHasSolution(
        self,
        x: Sequence[float],
        qnear: Sequence[float] = (),
        max_position_error: float = 1e-10,
        max_orientation_error: float = 1e-10,
    ) -> bool:
        """Return whether a pose of the tool is within reach."""
        try:
            self.getInverseKinematics(x, qnear)
        except Unreachable:
            return False
        return True

    def getActualToolFlangePose(self) -> list[float]:
        """Return the pose of the flange."""
        q = self._robot.realtime.wait(STATE_TIMEOUT).q_actual
        return list(map(float, self._robot.kinematics.forward(q)))

    @overload
    def moveJ(
        self, q: Sequence[float], speed: float = 1.05, acceleration: float = 1.4, asynchronous: bool = False
    ) -> bool: ...
    @overload
    def moveJ(self, q: Sequence[Sequence[float]], speed: bool = False) -> bool: ...
    @overload
    def moveJ(self, *, path: Sequence[Sequence[float]], asynchronous: bool = False) -> bool: ...
    def moveJ(
        self,
        q: Any = None,
        speed: float = 1.05,
        acceleration: float = 1.4,
        asynchronous: bool = False,
        *,
        path: Sequence[Sequence[float]] | None = None,
    ) -> bool:
        """Move the joints to positions in rad, at rad/s and rad/s².

        It can also move along a path, whose rows are six positions, speed, acceleration and blend radius.
        """
        if path is not None or _is_path(q):
            entries = Path()
            entries.appendMovejPath(q if path is None else path)
            return self.movePath(entries, asynchronous or speed is True)
        return self._move(lambda: self._robot.motion.move_joints(q, speed, acceleration), asynchronous)

    def moveJ_IK(
        self, pose: Sequence[float], speed: float = 1.05, acceleration: float = 1.4, asynchronous: bool = False
    ) -> bool:
        """Move the joints to the positions for a pose of the tool that are closest to the current positions."""
        return self.moveJ(self.getInverseKinematics(pose), speed, acceleration, asynchronous)

    @overload
    def moveL(
        self, pose: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool: ...
    @overload
    def moveL(self, pose: Sequence[Sequence[float]], speed: bool = False) -> bool: ...
    @overload
    def moveL(self, *, path: Sequence[Sequence[float]], asynchronous: bool = False) -> bool: ...
    def moveL(
        self,
        pose: Any = None,
        speed: float = 0.25,
        acceleration: float = 1.2,
        asynchronous: bool = False,
        *,
        path: Sequence[Sequence[float]] | None = None,
    ) -> bool:
        """Move the tool in a line to a pose (m, and rotation vector in rad), at m/s and m/s².

        It can also move along a path, whose rows are a pose, speed, acceleration and blend radius.
        """
        if path is not None or _is_path(pose):
            entries = Path()
            entries.appendMovelPath(pose if path is None else path)
            return self.movePath(entries, asynchronous or speed is True)
        return self._move(lambda: self._robot.motion.move_linear(pose, speed, acceleration), asynchronous)

    def moveL_FK(
        self, q: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool:
        """Move the tool in a line to its pose at given joint positions."""
        return self.moveL(self.getForwardKinematics(q), speed, acceleration, asynchronous)

    def movePath(self, path: Path, asynchronous: bool = False) -> bool:
        """Execute the motions of a path one after the other, with their blends."""
        waypoints = [entry._waypoint for entry in path.waypoints()]
        return self._move(lambda: self._robot.motion.path(waypoints), asynchronous)

    def _move(self, begin: Callable[[], Motion], asynchronous: bool) -> bool:
        def move() -> None:
            self._end_block()
            motion = begin()
            if asynchronous:
                self._operation, self._operations = motion, self._operations % 127 + 1
            else:
                motion.wait(LONGEST)

        return succeeds(move)

    def _end_block(self) -> None:
        """End the open block, if there is one. The arm is at rest afterwards."""
        self._last = None
        self._blocks.close()

    def getAsyncOperationProgress(self) -> int:
        """Return the number of the current motion of an asynchronous path, from 0; if none is running, -1 or -2."""
        status = self.getAsyncOperationProgressEx()
        return status.progress() if status.isAsyncOperationRunning() else -1 - self._operations % 2

    def getAsyncOperationProgressEx(self) -> AsyncOperationStatus:
        """Return the status of the last asynchronous motion."""
        motion = self._operation
        is_running = motion is not None and not motion.done
        progress = (motion.segment or 0) if isinstance(motion, PathMotion) else 0
        changes = (2 * self._operations + (not is_running) + progress) & 0xFF
        return AsyncOperationStatus(self._operations << 24 | changes << 16 | is_running << 15 | progress)

    def stopJ(self, a: float = 2.0, asynchronous: bool = False) -> None:
        """Stop the arm in joint space, at rad/s²."""
        self._stop(lambda: self._robot.motion.stop(a), asynchronous)

    def stopL(self, a: float = 10.0, asynchronous: bool = False) -> None:
        """Stop the arm along the path of the tool, at m/s²."""
        self._stop(lambda: self._robot.script.run(f"stopl({text.number(a, 'a', 0.0, 100.0)})"), asynchronous)

    def _stop(self, begin: Callable[[], Any], asynchronous: bool) -> None:
        def stop() -> None:
            self._end_block()
            handle = begin()
            if not asynchronous:
                handle.wait(LONGEST)

        succeeds(stop)


def _is_path(value: Any) -> bool:
    """Return whether a value is a list of lists."""
    return len(value) > 0 and hasattr(value[0], "__len__")
