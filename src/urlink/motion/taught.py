"""Waypoints that were taught by hand: saved, loaded and played."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from linkcore.errors import BadValue

from ..vectors import FloatArray, six
from .path import Joint, PathMotion

if TYPE_CHECKING:
    from .motions import Motions

#: What a file begins with; other programs may read it too.
_FORMAT, _VERSION = "urlink taught waypoints", 1


class _Player(Protocol):
    """A robot."""

    @property
    def model(self) -> str | None: ...
    @property
    def motion(self) -> Motions: ...


@dataclass(frozen=True, eq=False)
class TaughtPoint:
    """A waypoint: the position of the arm when it was recorded.

    Attributes:
        q: (6,) joint positions, rad.
        pose: (6,) of the TCP in the base frame, m and rad; for display and other programs: the joint positions are
            played.
    """

    q: FloatArray
    pose: FloatArray


class Taught:
    """Waypoints in the order in which they were taught.

    Args:
        points: the first ones.
        model: name of the arm; None if it is not known.
    """

    def __init__(self, points: Iterable[TaughtPoint] = (), model: str | None = None) -> None:
        self.model = model
        self._points = list(points)

    @property
    def points(self) -> tuple[TaughtPoint, ...]:
        """The waypoints so far."""
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
            BadValue: there is none.
        """
        if not self._points:
            raise BadValue("no waypoint was taught yet")
        return self._points.pop()

    # -- playing -------------------------------------------------------------------------------------

    def waypoints(self, blend: float = 0.0) -> list[Joint]:
        """The waypoints for `Motions.path`: straight in joint space from one to the next.

        Args:
            blend: radius in m, at all but the last, at which the arm begins to round the corner; 0 to stop there.
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
        """Move through all of them in one motion, which is checked before it is sent, as any path.

        The arm first moves straight in joint space to the first waypoint, from wherever it is.

        Args:
            robot: the robot, with an arm of the same model.
            speed: rad/s of the joint that moves furthest.
            acceleration: rad/s² of that joint.
            blend: see `waypoints`.
            wait: see `Motions`.

        Raises:
            BadValue: there is no waypoint, the arm is of another model, or the path fails its checks.
        """
        if not self._points:
            raise BadValue("no waypoint was taught, so there is nothing to play")
        if None not in (self.model, robot.model) and self.model != robot.model:
            raise BadValue(f"the waypoints were taught on a {self.model}, and this is a {robot.model}")
        return robot.motion.path(self.waypoints(blend), joint_speed=speed, joint_acceleration=acceleration, wait=wait)

    # -- files ---------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write them as JSON; an older file of that name is replaced completely or not at all.

        Raises:
            BadValue: it cannot be written.
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
        """Read what `save` has written.

        Raises:
            BadValue: it cannot be read, or holds something else; the message says what.
        """
        try:
            held = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise BadValue(f"cannot read {path}: {error.strerror or error}") from error
        except (ValueError, RecursionError) as error:
            raise BadValue(f"{path} is no JSON: {error}") from None
        try:
            return cls._of(held)
        except BadValue as error:
            raise BadValue(f"{path}: {error}") from None

    @classmethod
    def _of(cls, held: Any) -> Taught:
        if not isinstance(held, dict) or held.get("format") != _FORMAT:
            raise BadValue(f'expected an object whose "format" is "{_FORMAT}"')
        if held.get("version") != _VERSION:
            raise BadValue(f"version {held.get('version')!r} is not known; expected {_VERSION}")
        model, waypoints = held.get("model"), held.get("waypoints")
        if model is not None and not isinstance(model, str):
            raise BadValue(f'"model" is {model!r}; expected a name or null')
        if not isinstance(waypoints, list):
            raise BadValue('"waypoints" is no list')
        points = []
        for number, point in enumerate(waypoints):
            if not isinstance(point, dict) or not {"q", "pose"} <= point.keys():
                raise BadValue(f'waypoint {number} has no "q" and "pose"')
            points.append(TaughtPoint(six(point["q"], f"q of waypoint {number}"), six(point["pose"], "its pose")))
        return cls(points, model)
