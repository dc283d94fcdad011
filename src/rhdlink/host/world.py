"""World of a turtle: a walled square with one robot. It computes the motion of the robot, and draws its path.

x points to the right, y points up, and theta is counter-clockwise, in metres and radians. Pictures are written as SVG,
or as PNG if matplotlib is installed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from linkcore.errors import BadValue

from .scene import Scene

#: Distance, in m, that a robot keeps from a wall within the square.
_GAP = 1e-4
#: Maximum number of stored points of the path; above it, every second point is deleted.
_MOST_POINTS = 1 << 15


class Pose(NamedTuple):
    """Position and heading, in m, m and rad. The heading is not wrapped: two turns to the left are 4 pi."""

    x: float
    y: float
    theta: float


class Moved(NamedTuple):
    """Result of one step.

    Attributes:
        distance: Distance driven forward, in m; less than requested if a wall was in the way.
        angle: Angle turned to the left, in rad.
        is_blocked: Whether a wall was in the way.
    """

    distance: float
    angle: float
    is_blocked: bool


class World:
    """Square with walls, and one robot in it. The robot is a point.

    Steps follow the midpoint rule: the robot drives straight along its heading at the middle of the turn. With this
    rule, the recorded drives of the original programs are reproduced to the last digit.

    Args:
        size: Length of a wall, in m.
        start: Start of the robot, in m, m and rad; by default in the middle, heading along x.
        scene: Objects in the square; none by default.

    Attributes:
        size: See the argument `size`.
        scene: See the argument `scene`.
        start: Pose of the robot at the start.
        odometry: Pose relative to the start position, without rotation, in m, m and rad; exactly zero at the start.
        blocked: Number of steps in which a wall was in the way.

    Raises:
        BadValue: If the size is invalid, or the start is outside the square.
    """

    def __init__(
        self, size: float = 11.0, start: tuple[float, float, float] | None = None, scene: Scene | None = None
    ) -> None:
        if not isinstance(size, (int, float)) or not 0.0 < size < math.inf:
            raise BadValue(f"size={size!r}; expected a positive number of metres")
        self.size = size
        self.scene = scene
        try:
            self.start = Pose(size / 2, size / 2, 0.0) if start is None else Pose(*map(float, start))
        except (TypeError, ValueError):
            raise BadValue(f"start={start!r}; expected x (m), y (m) and theta (rad)") from None
        if not all(0.0 <= place <= size for place in self.start[:2]) or not math.isfinite(self.start.theta):
            raise BadValue(f"start={tuple(self.start)} is not within the square of {size:g} x {size:g} m")
        self.odometry = Pose(0.0, 0.0, 0.0)
        self.blocked = 0
        self._points = [(self.start.x, self.start.y)]
        # Distance between two points of the path, in metres: half a pixel of a picture.
        self._spacing = size / 4000.0

    @property
    def pose(self) -> Pose:
        """Pose of the robot in the square."""
        at, start = self.odometry, self.start
        return Pose(start.x + at.x, start.y + at.y, start.theta + at.theta)

    @property
    def path(self) -> npt.NDArray[np.float64]:
        """Path of the robot, shape (n, 2), in m; the first point is the start, and the last is the current position."""
        here = self.pose[:2]
        points = self._points if self._points[-1] == here else [*self._points, here]
        return np.array(points, dtype=np.float64)

    def step(self, linear: float, angular: float, seconds: float) -> Moved:
        """Drive with `linear` m/s and `angular` rad/s for `seconds`."""
        x, y, theta = self.odometry
        distance, angle = linear * seconds, angular * seconds
        half_way = self.start.theta + theta + angular * seconds / 2
        dx, dy = distance * math.cos(half_way), distance * math.sin(half_way)
        free = self._free(dx, dy)
        if free < 1.0:
            self.blocked += 1
            distance, dx, dy = distance * free, dx * free, dy * free
        self.odometry = Pose(x + dx, y + dy, theta + angle)
        if distance:
            self._remember()
        return Moved(distance, angle, free < 1.0)

    def wall(self, direction: float) -> float:
        """Return the distance in metres to the wall in `direction`, in rad to the left of the heading."""
        here = self.pose
        angle = here.theta + direction
        free = min(_until(here.x, math.cos(angle), self.size), _until(here.y, math.sin(angle), self.size))
        return free if self.scene is None else min(free, self.scene.wall(here.x, here.y, angle))

    def brightness(self, ahead: float, aside: Sequence[float]) -> npt.NDArray[np.float64]:
        """Return the brightness of the floor `ahead` m before the robot, at places `aside` m to its left.

        The brightness is 0 for black and 1 for white.
        """
        if self.scene is None:
            return np.ones(len(aside))
        x, y, theta = self.pose
        c, s = math.cos(theta), math.sin(theta)
        offset = np.asarray(aside, dtype=np.float64)
        places = np.stack((x + ahead * c - offset * s, y + ahead * s + offset * c), axis=1)
        return self.scene.brightness(places)

    def _free(self, dx: float, dy: float) -> float:
        """Return the fraction of a path that is free of walls, 0 to 1."""
        here = self.pose
        free = min(1.0, _until(here.x, dx, self.size), _until(here.y, dy, self.size))
        if self.scene is None or not (dx or dy):
            return free
        # Stop short of a wall: a robot exactly on a wall would pass through it with the next step.
        until_wall = self.scene.blocked(here.x, here.y, dx, dy) - _GAP / math.hypot(dx, dy)
        return min(free, max(until_wall, 0.0))

    def _remember(self) -> None:
        here = self.pose
        last = self._points[-1]
        if math.hypot(here.x - last[0], here.y - last[1]) < self._spacing:
            return
        self._points.append((here.x, here.y))
        if len(self._points) > _MOST_POINTS:
            del self._points[1::2]
            self._spacing *= 2.0


def _until(place: float, speed: float, size: float) -> float:
    """Return the time until a coordinate leaves the range from 0 to `size`."""
    # For a robot that drives along a wall, the cosine of the angle to the wall is about 6e-17. Such a robot must not
    # stop.
    if abs(speed) < 1e-12:
        return math.inf
    return max((size - place) / speed if speed > 0.0 else -place / speed, 0.0)


_PIXELS = 480.0
_MARGIN = 24.0
_PAPER, _WALL, _GRID, _PATH, _ROBOT = "#ffffff", "#37474f", "#eceff1", "#1565c0", "#c62828"


def svg(world: World, title: str = "") -> str:
    """Draw the square, the path and the robot as an SVG document, with a grid line for each metre.

    The same path gives the same text, so that pictures can be compared and kept under version control.
    """
    scale = _PIXELS / world.size
    whole = _PIXELS + 2 * _MARGIN

    def place(x: float, y: float) -> str:
        return f"{_MARGIN + x * scale:.1f},{_MARGIN + (world.size - y) * scale:.1f}"

    # A grid with more lines than pixels shows nothing.
    step = 10.0 ** max(math.ceil(math.log10(world.size / 50.0)), 0)
    marks = np.arange(0.0, world.size, step)[1:]
    lines = "".join(
        f"M{place(mark, 0)}L{place(mark, world.size)}M{place(0, mark)}L{place(world.size, mark)}" for mark in marks
    )
    points = " ".join(place(x, y) for x, y in world.path)
    x, y, theta = world.pose
    nose, arm = 14.0 / scale, 2.5
    corners = " ".join(
        place(x + nose * math.cos(theta + turn) * size, y + nose * math.sin(theta + turn) * size)
        for turn, size in ((0.0, 1.0), (arm, 0.7), (-arm, 0.7))
    )
    escaped = title.replace("&", "&amp;").replace("<", "&lt;")
    caption = f"<title>{escaped}</title>" if title else ""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {whole:g} {whole:g}" width="{whole:g}" '
        f'height="{whole:g}">{caption}\n'
        f'<rect width="{whole:g}" height="{whole:g}" fill="{_PAPER}"/>\n'
        f'<path d="{lines}" stroke="{_GRID}" fill="none"/>\n'
        f'<rect x="{_MARGIN:g}" y="{_MARGIN:g}" width="{_PIXELS:g}" height="{_PIXELS:g}" fill="none" '
        f'stroke="{_WALL}" stroke-width="3"/>\n'
        f"{_scene(world, place, scale)}"
        f'<polyline points="{points}" fill="none" stroke="{_PATH}" stroke-width="2" stroke-linejoin="round"/>\n'
        f'<polygon points="{corners}" fill="{_ROBOT}"/>\n'
        "</svg>\n"
    )


def _scene(world: World, place: Callable[[float, float], str], scale: float) -> str:
    """Draw the tape and the walls, if there are any."""
    if world.scene is None:
        return ""
    lines = []
    for tape in world.scene.tapes:
        points = " ".join(place(x, y) for x, y in tape.points)
        shade = "#" + 3 * f"{round(255 * tape.brightness):02x}"
        width = max(tape.width * scale, 0.5)
        lines.append(f'<polyline points="{points}" fill="none" stroke="{shade}" stroke-width="{width:.1f}"/>\n')
    for wall in world.scene.walls:
        points = " ".join(place(x, y) for x, y in wall)
        lines.append(f'<polyline points="{points}" fill="none" stroke="{_WALL}" stroke-width="3"/>\n')
    return "".join(lines)


def save(world: World, path: str | os.PathLike[str], title: str = "") -> None:
    """Write the picture to a file, in the format of its suffix: ``.svg`` or ``.png``.

    Raises:
        BadValue: If the suffix is different, matplotlib is missing for a PNG, or the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".svg":
            path.write_text(svg(world, title), encoding="utf-8")
        elif suffix == ".png":
            _save_png(world, path, title)
        else:
            raise BadValue(f"unknown suffix of {path}; expected .svg or .png")
    except OSError as error:
        raise BadValue(f"cannot write {path}: {error.strerror or error}") from error


def _save_png(world: World, path: Path, title: str) -> None:
    try:
        # pyplot is not used, because it would choose a window system for the whole program.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise BadValue(f"{path}: a PNG needs matplotlib; run pip install matplotlib, or write an .svg") from None
    figure = Figure(figsize=(5.3, 5.3), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set(xlim=(0, world.size), ylim=(0, world.size), aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title)
    axes.grid(color=_GRID)
    for tape in world.scene.tapes if world.scene is not None else ():
        axes.plot(*zip(*tape.points, strict=True), color=str(tape.brightness), linewidth=2.0)
    for wall in world.scene.walls if world.scene is not None else ():
        axes.plot(*zip(*wall, strict=True), color=_WALL, linewidth=2.0)
    axes.plot(*world.path.T, color=_PATH)
    x, y, theta = world.pose
    axes.plot(x, y, marker=(3, 0, math.degrees(theta) - 90.0), markersize=14, color=_ROBOT)
    figure.savefig(path)
