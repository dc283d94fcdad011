"""Movements of ur_rtde's control interface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, overload

from linkcore.handle import Motion
from urlink.motion import PathMotion
from urlink.urscript import text

from .blocks import Blocks
from .control_tool import STATE_TIMEOUT, ControlTool
from .interface import succeeds
from .paths import Path

__all__ = ["LONGEST", "AsyncOperationStatus", "ControlMoves"]

#: Seconds that a motion may take; the other client waits so long too.
LONGEST = 300.0


class AsyncOperationStatus:
    """How far an asynchronous motion has got.

    Args:
        value: the other client's word: bits 24 to 30 the number of the operation, 16 to 23 a count of changes, 15
            whether it runs, 0 to 14 its progress.
    """

    def __init__(self, value: int) -> None:
        self._value = value

    def value(self) -> int:
        """The word."""
        return self._value

    def isAsyncOperationRunning(self) -> bool:
        """It is under way."""
        return bool(self._value >> 15 & 1)

    def operationId(self) -> int:
        """Number of the operation, which no two in a row share."""
        return self._value >> 24 & 0x7F

    def changeCount(self) -> int:
        """A count that changes with the rest."""
        return self._value >> 16 & 0xFF

    def progress(self) -> int:
        """Number of the movement of a path that is under way, from 0."""
        return self._value & 0x7FFF

    def equals(self, other: AsyncOperationStatus) -> bool:
        """Nothing has changed from one to the other."""
        return self._value == other._value


class ControlMoves(ControlTool):
    """Movements that come to an end by themselves, and stops.

    Args:
        hostname: address of the robot.
        frequency: of the loop that `initPeriod` and `waitPeriod` pace, in Hz; -1 for the controller's rate.

    Raises:
        RemoteError: the robot cannot be reached.
    """

    def __init__(self, hostname: str, frequency: float = -1.0) -> None:
        super().__init__(hostname, frequency)
        try:
            self._robot.primary.wait(STATE_TIMEOUT)
        except BaseException:
            super().disconnect()
            raise
        self._blocks = Blocks(self._robot)
        #: the set-point that was sent last, with its look-ahead time and gain; None where no servo is open
        self._last: tuple[list[float], float, float] | None = None
        self._operation: Motion | None = None
        self._operations = 0

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
        """Move the joints to positions, rad, at rad/s and rad/s²; or along a path of such, each with speed,
        acceleration and blend behind them."""
        if path is not None or _is_path(q):
            entries = Path()
            entries.appendMovejPath(q if path is None else path)
            return self.movePath(entries, asynchronous or speed is True)
        return self._move(lambda: self._robot.motion.move_joints(q, speed, acceleration), asynchronous)

    def moveJ_IK(
        self, pose: Sequence[float], speed: float = 1.05, acceleration: float = 1.4, asynchronous: bool = False
    ) -> bool:
        """Move the joints to where the tool is at a pose, the nearest way to reach it."""
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
        """Move the tool in a line to a pose, m and rotation vector in rad, at m/s and m/s²; or along a path of such,
        each with speed, acceleration and blend behind them."""
        if path is not None or _is_path(pose):
            entries = Path()
            entries.appendMovelPath(pose if path is None else path)
            return self.movePath(entries, asynchronous or speed is True)
        return self._move(lambda: self._robot.motion.move_linear(pose, speed, acceleration), asynchronous)

    def moveL_FK(
        self, q: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool:
        """Move the tool in a line to where it is at joint positions."""
        return self.moveL(self.getForwardKinematics(q), speed, acceleration, asynchronous)

    def movePath(self, path: Path, asynchronous: bool = False) -> bool:
        """Make the movements of a path, one after the other, with their blends."""
        waypoints = path._waypoints()
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
        """No set-points, no speeds and no force mode from here on: the arm stands."""
        self._last = None
        self._blocks.close()

    def getAsyncOperationProgress(self) -> int:
        """Number of the movement that an asynchronous motion has got to, from 0; -1 and -2 in turns for none."""
        status = self.getAsyncOperationProgressEx()
        return status.progress() if status.isAsyncOperationRunning() else -1 - self._operations % 2

    def getAsyncOperationProgressEx(self) -> AsyncOperationStatus:
        """How far the last asynchronous motion has got."""
        motion = self._operation
        is_running = motion is not None and not motion.done
        progress = (motion.segment or 0) if isinstance(motion, PathMotion) else 0
        changes = (2 * self._operations + (not is_running) + progress) & 0xFF
        return AsyncOperationStatus(self._operations << 24 | changes << 16 | is_running << 15 | progress)

    def stopJ(self, a: float = 2.0, asynchronous: bool = False) -> None:
        """Stop what moves, by the joints, at rad/s²."""
        self._stop(lambda: self._robot.motion.stop(a), asynchronous)

    def stopL(self, a: float = 10.0, asynchronous: bool = False) -> None:
        """Stop what moves, along the path of the tool, at m/s²."""
        self._stop(lambda: self._robot.script.run(f"stopl({text.number(a, 'a', 0.0, 100.0)})"), asynchronous)

    def _stop(self, begin: Callable[[], Any], asynchronous: bool) -> None:
        def stop() -> None:
            self._end_block()
            handle = begin()
            if not asynchronous:
                handle.wait(LONGEST)

        succeeds(stop)


def _is_path(value: Any) -> bool:
    """A list of lists."""
    return len(value) > 0 and hasattr(value[0], "__len__")
