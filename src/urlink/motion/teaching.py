"""Teaching: a person moves the arm by hand, and records waypoints with a call, a digital input or the freedrive button.

Taught waypoints can be saved, loaded, and played in the order in which they were recorded.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from linkcore.errors import BadValue, LocalError
from linkcore.names import StrictAttributes
from linkcore.pending_call import starts_motion
from linkcore.streaming.stream import Stream

from ..arm.vectors import FloatArray, six
from ..protocol.enums import RobotStatusBits
from ..protocol.realtime.packets import RealtimeState
from .moves.path import Joint, PathMotion
from .servo.force_control import Freedrive

if TYPE_CHECKING:
    from typing_extensions import Self

    from .motions import Motions

#: Format name and version at the beginning of a file. Other programs may also read such files.
_FORMAT, _VERSION = "urlink taught waypoints", 1


class _Player(Protocol):
    """Interface of a robot that can play waypoints."""

    @property
    def model(self) -> str | None: ...
    @property
    def motion(self) -> Motions: ...


@dataclass(frozen=True, eq=False)
class TaughtPoint:
    """Taught waypoint: position of the arm at the moment of recording.

    Attributes:
        q: Joint positions, shape (6,), in rad.
        pose: Pose of the TCP in the base frame, shape (6,), in m and rad. The pose is for display and for other
            programs; `play` uses the joint positions.
    """

    q: FloatArray
    pose: FloatArray


class Taught(StrictAttributes):
    """List of taught waypoints, in the order in which they were recorded.

    Args:
        points: Initial waypoints.
        model: Name of the arm; None if it is unknown.
    """

    def __init__(self, points: Iterable[TaughtPoint] = (), model: str | None = None) -> None:
        self.model = model
        self._points = list(points)

    @property
    def points(self) -> tuple[TaughtPoint, ...]:
        """Waypoints that have been taught so far."""
        return tuple(self._points)

    def __len__(self) -> int:
        return len(self._points)

    def __iter__(self) -> Iterator[TaughtPoint]:
        return iter(self.points)

    def __repr__(self) -> str:
        return f"<Taught {len(self)} waypoints of {self.model or 'an unknown arm'}>"

    def add(self, point: TaughtPoint) -> None:
        """Add a waypoint at the end."""
        self._points.append(point)

    def remove_last(self) -> TaughtPoint:
        """Remove the last waypoint, and return it.

        Raises:
            BadValue: If there is no waypoint.
        """
        if not self._points:
            raise BadValue("no waypoint was taught yet")
        return self._points.pop()

    # -- playing -------------------------------------------------------------------------------------

    def waypoints(self, blend: float = 0.0) -> list[Joint]:
        """Return the waypoints for `Motions.path`.

        The path between two waypoints is a straight line in joint space.

        Args:
            blend: Distance from each waypoint except the last, in m, at which the arm begins to round the corner; 0 to
                stop at each waypoint.
        """
        last = len(self) - 1
        return [Joint(point.q, blend=blend if i < last else 0.0) for i, point in enumerate(self.points)]

    def play(
        self,
        robot: _Player,
        *,
        speed: float = 0.5,
        acceleration: float = 1.0,
        blend: float = 0.0,
        wait: bool | float = False,
    ) -> PathMotion:
        """Move through all waypoints in one motion.

        Like every path, the motion is checked before it is sent. The arm first moves in a straight line in joint space
        from its current position to the first waypoint.

        Args:
            robot: Robot that plays the waypoints. It must have an arm of the same model.
            speed: Speed of the joint that moves furthest, in rad/s.
            acceleration: Acceleration of this joint, in rad/s².
            blend: See `waypoints`.
            wait: See `Motions`.

        Raises:
            BadValue: If there is no waypoint, if the arm has another model, or if the path fails a check.
        """
        if not self._points:
            raise BadValue("no waypoint was taught, so there is nothing to play")
        if None not in (self.model, robot.model) and self.model != robot.model:
            raise BadValue(f"the waypoints were taught on a {self.model}, but this is a {robot.model}")
        return robot.motion.path(self.waypoints(blend), joint_speed=speed, joint_acceleration=acceleration, wait=wait)

    # -- files ---------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the waypoints as JSON.

        If a file with this name exists, it is replaced completely or not at all.

        Raises:
            BadValue: If the file cannot be written.
        """
        held = {
            "format": _FORMAT,
            "version": _VERSION,
            "model": self.model,
            "waypoints": [{"q": point.q.tolist(), "pose": point.pose.tolist()} for point in self.points],
        }
        target = Path(path)
        beside = target.with_name(f".{target.name}.{os.getpid()}")
        try:
            beside.write_text(json.dumps(held, indent=1) + "\n", encoding="utf-8")
            beside.replace(target)
        except OSError as error:
            beside.unlink(missing_ok=True)
            raise BadValue(f"cannot write {target}: {error.strerror or error}") from error

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Taught:
        """Read waypoints that `save` has written.

        Raises:
            BadValue: If the file cannot be read, or does not contain taught waypoints. The message names the file.
        """
        try:
            held = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise BadValue(f"cannot read {path}: {error.strerror or error}") from error
        except (ValueError, RecursionError) as error:
            raise BadValue(f"{path} is not a JSON file: {error}") from None
        try:
            return cls._of(held)
        except BadValue as error:
            raise BadValue(f"{path}: {error}") from None

    @classmethod
    def _of(cls, held: Any) -> Taught:
        if not isinstance(held, dict) or held.get("format") != _FORMAT:
            raise BadValue(f'expected an object whose "format" is "{_FORMAT}"')
        if held.get("version") != _VERSION:
            raise BadValue(f"unknown version {held.get('version')!r}; expected {_VERSION}")
        model, waypoints = held.get("model"), held.get("waypoints")
        if model is not None and not isinstance(model, str):
            raise BadValue(f'"model" is {model!r}; expected a name or null')
        if not isinstance(waypoints, list):
            raise BadValue('"waypoints" must be a list')
        points = []
        for number, point in enumerate(waypoints):
            if not isinstance(point, dict) or not {"q", "pose"} <= point.keys():
                raise BadValue(f'waypoint {number} has no "q" and "pose"')
            points.append(TaughtPoint(six(point["q"], f"q of waypoint {number}"), six(point["pose"], "its pose")))
        return cls(points, model)


#: Time in s after a waypoint within which the digital input records no further waypoint. It suppresses the bouncing of
#: a switch.
_BOUNCE = 0.2


class Teaching(StrictAttributes):
    """Teaching of waypoints while a ``with`` block is open; see `robot.teach`.

    Args:
        realtime: Stream with the positions of the arm.
        model: Name of the arm; None if it is unknown.
        freedrive: Freedrive that is active while the block is open; None if the person uses the freedrive button
            of the arm.
        input_bit: Bit number of a digital input. When this input is switched on, a waypoint is recorded. None for no
            input.
        buttons: Stream with `robot_status_bits`. When these bits show that the freedrive button was released, a
            waypoint is recorded. None for no button.
        on_point: Function that is called with each waypoint, in the thread that recorded this waypoint.

    Attributes:
        taught: Waypoints recorded so far. They remain after the block is left.
    """

    def __init__(
        self,
        realtime: Stream[RealtimeState],
        model: str | None,
        freedrive: Freedrive | None,
        input_bit: int | None,
        buttons: Stream[Any] | None,
        on_point: Callable[[TaughtPoint], object],
    ) -> None:
        self.taught = Taught(model=model)
        self._realtime = realtime
        self._freedrive = freedrive
        self._input_bit = input_bit
        self._buttons = buttons
        self._on_point = on_point
        #: exit stack that is closed when the block is left; None outside of the block
        self._open: contextlib.ExitStack | None = None
        # Chosen so that the first state never records a waypoint, even if the input is on or the button is not pressed.
        self._was_on, self._was_held = True, False
        self._kept_at = -math.inf

    @property
    def freedrive(self) -> Freedrive | None:
        """Freedrive of this block; None if the person uses the freedrive button of the arm."""
        return self._freedrive

    @starts_motion
    def __enter__(self) -> Self:
        """Start freedrive, and begin to watch the input and the button.

        Raises:
            SafetyStop, NotRunning: If the arm may not be moved now.
            LinkError: If freedrive cannot start for another reason.
            LocalError: If this object was used before.
        """
        with contextlib.ExitStack() as opened:
            if self._freedrive is not None:
                opened.enter_context(self._freedrive)
            if self._input_bit is not None:
                subscription = self._realtime.subscribe(self._look_at_input)
                opened.callback(subscription.close)
            if self._buttons is not None:
                opened.callback(self._buttons.close)
                watch = self._buttons.subscribe(self._look_at_button)
                opened.callback(watch.close)
            self._open = opened.pop_all()
        return self

    def __exit__(self, *exc: object) -> None:
        """End freedrive, and stop watching the input and the button. The waypoints remain."""
        opened, self._open = self._open, None
        assert opened is not None, "only an entered block is left"
        opened.close()

    def record(self) -> TaughtPoint:
        """Record the current position of the arm as the next waypoint.

        Raises:
            LocalError: If called outside the ``with`` block.
            LinkError: If freedrive has ended (the error states the reason), or if no state arrives.
        """
        if self._open is None:
            raise LocalError("the block is not open; record waypoints within it: with robot.teach() as teaching: ...")
        if self._freedrive is not None and self._freedrive.error is not None:
            raise self._freedrive.error
        return self._keep(self._realtime.wait())

    def _keep(self, state: RealtimeState) -> TaughtPoint:
        point = TaughtPoint(six(state.q_actual, "q_actual"), six(state.tool_vector_actual, "tool_vector_actual"))
        self.taught.add(point)
        self._on_point(point)
        return point

    def _look_at_input(self, state: RealtimeState) -> None:
        assert self._input_bit is not None
        is_on = bool(state.digital_input_bits >> self._input_bit & 1)
        if is_on and not self._was_on and state.time - self._kept_at > _BOUNCE:
            self._kept_at = state.time
            self._keep(state)
        self._was_on = is_on

    def _look_at_button(self, state: Any) -> None:
        is_held = bool(state.robot_status_bits & RobotStatusBits.TEACH_BUTTON_PRESSED)
        if self._was_held and not is_held:
            self._keep(self._realtime.wait())
        self._was_held = is_held

    def __repr__(self) -> str:
        return f"<Teaching {len(self.taught)} waypoints>"
