"""Objects in a turtle's world: walls, and tape on the floor that line sensors detect.

Both consist of straight pieces. They are defined by points, or by an SVG drawing. Lines, polylines, polygons,
rectangles and paths of a drawing become tape. The width of the stroke is the width of the tape, and the colour of the
stroke determines whether the tape is black or white. Elements whose `class` contains "wall" are walls.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from linkcore.errors import BadValue

from .config import Element, parse_xml, read_file

Point = tuple[float, float]

#: Maximum number of pieces of tape and walls; with more, a step would take longer than a tick.
MOST_PIECES = 5000
#: Number of walls up to which a loop is faster than arrays.
_FEW = 20
#: Diameter of the spot that a line sensor sees, in m.
_SPOT = 0.01
#: Number of straight pieces that replace a curve.
_CURVE = 24
#: Default width of a tape, in m: the usual insulating tape is twice 19 mm. Line sensors are 2 cm apart.
_WIDTH = 0.038


@dataclass(frozen=True)
class Tape:
    """Tape on the floor, which forms a line.

    Attributes:
        points: Points on its centre line, in m; at least two.
        width: Width in m.
        brightness: Brightness from 0 for black to 1 for white.
    """

    points: tuple[Point, ...]
    width: float = _WIDTH
    brightness: float = 0.0

    def __post_init__(self) -> None:
        if len(self.points) < 2:
            raise BadValue("a tape needs at least two points")
        if not (0.0 < self.width < math.inf and 0.0 <= self.brightness <= 1.0):
            raise BadValue(
                f"a tape has width {self.width} m and brightness {self.brightness}; expected a width "
                "above 0 m and a brightness from 0 to 1"
            )
        _check(self.points)


class Scene:
    """Scene with tape on the floor, and walls.

    Args:
        tapes: Tapes; each one covers the tapes before it.
        walls: Lines of points, in m.
        floor: Brightness of the floor.

    Raises:
        BadValue: If points are not numbers, or there are too many pieces.
    """

    def __init__(
        self, tapes: Iterable[Tape] = (), walls: Iterable[Sequence[Point]] = (), *, floor: float = 1.0
    ) -> None:
        self.tapes = tuple(tapes)
        self.walls = tuple(tuple((float(x), float(y)) for x, y in wall) for wall in walls)
        self.floor = floor
        for wall in self.walls:
            _check(wall)
        if sum(len(each) for each in (*self.walls, *(tape.points for tape in self.tapes))) > MOST_PIECES:
            raise BadValue(f"too many pieces of tape and walls; the maximum is {MOST_PIECES}")
        self._pieces = [_Segments([tape.points]) for tape in self.tapes]
        self._walls = _Segments(self.walls)

    def brightness(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the brightness that a line sensor sees at points of shape (n, 2): 0 for black, 1 for white."""
        seen = np.full(len(points), self.floor)
        for tape, pieces in zip(self.tapes, self._pieces, strict=True):
            inside = tape.width / 2 - pieces.distance(points)
            covered = np.clip(0.5 + inside / _SPOT, 0.0, 1.0)
            seen += covered * (tape.brightness - seen)
        return seen

    def wall(self, x: float, y: float, angle: float) -> float:
        """Return the distance in metres from a place to the next wall in a direction; inf if there is none."""
        return self._walls.hit(x, y, math.cos(angle), math.sin(angle))

    def blocked(self, x: float, y: float, dx: float, dy: float) -> float:
        """Return the fraction of a path that can be driven before a wall is met; it may exceed 1."""
        return self._walls.hit(x, y, dx, dy)

    @classmethod
    def from_svg(cls, path: str | os.PathLike[str], size: float = 11.0) -> Scene:
        """Return the scene of a drawing.

        Args:
            path: Path of an SVG file. Its view box becomes the world, with the width `size` and the origin in its lower
                left corner.
            size: Width of the world, in m.

        Raises:
            BadValue: If the file cannot be read, is not a drawing, or has too many pieces.
        """
        return _drawn(parse_xml(read_file(path), Path(path).name), size)


def _check(points: Sequence[Point]) -> None:
    if not all(math.isfinite(x) and math.isfinite(y) for x, y in points):
        raise BadValue("a point is not finite; expected finite numbers in m")


class _Segments:
    """Straight pieces as arrays."""

    def __init__(self, lines: Iterable[Sequence[Point]]) -> None:
        pieces = [(a, b) for line in lines for a, b in pairwise(line)]
        ends = np.array(pieces, dtype=np.float64).reshape(-1, 2, 2)
        self._start = ends[:, 0]
        self._way = ends[:, 1] - ends[:, 0]
        self._squared = np.maximum((self._way**2).sum(axis=1), 1e-18)
        self._few = np.hstack((self._start, self._way))[:_FEW].tolist()

    def distance(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the distance from each of some points to the nearest piece, in m."""
        to = points[:, None] - self._start
        part = np.clip((to * self._way).sum(axis=2) / self._squared, 0.0, 1.0)
        away = to - part[..., None] * self._way
        nearest: npt.NDArray[np.float64] = np.sqrt((away**2).sum(axis=2).min(axis=1))
        return nearest

    def hit(self, x: float, y: float, dx: float, dy: float) -> float:
        """Return the multiple of (dx, dy) by which a point can move before it meets a piece; inf if it meets none."""
        if len(self._few) == len(self._start):
            return self._hit_few(x, y, dx, dy)
        to_x, to_y = self._start[:, 0] - x, self._start[:, 1] - y
        way_x, way_y = self._way[:, 0], self._way[:, 1]
        across = dx * way_y - dy * way_x
        with np.errstate(divide="ignore", invalid="ignore"):
            times = (to_x * way_y - to_y * way_x) / across
            along = (to_x * dy - to_y * dx) / across
        met = times[(times >= 0.0) & (along >= 0.0) & (along <= 1.0)]
        return float(met.min()) if len(met) else math.inf

    def _hit_few(self, x: float, y: float, dx: float, dy: float) -> float:
        """Do the same as `hit`, with a loop. For up to about 20 pieces, this is faster than arrays."""
        nearest = math.inf
        for start_x, start_y, way_x, way_y in self._few:
            across = dx * way_y - dy * way_x
            if across == 0.0:
                continue
            to_x, to_y = start_x - x, start_y - y
            times = (to_x * way_y - to_y * way_x) / across
            if 0.0 <= times < nearest and 0.0 <= (to_x * dy - to_y * dx) / across <= 1.0:
                nearest = times
        return nearest


def _drawn(root: Element, size: float) -> Scene:
    """Return the scene of an SVG drawing."""
    if root.tag.rpartition(":")[2] != "svg":
        root.reject("the root element of a drawing must be <svg>")
    box = [float(each) for each in _NUMBER.findall(root.attributes.get("viewBox", ""))]
    if len(box) != 4:
        box = [0.0, 0.0, root.number("width", size), root.number("height", size)]
    left, top, width, height = box
    if not width > 0.0:
        root.reject("the view box has no width")
    scale = size / width
    tapes, walls = [], []
    for element in _all(root):
        is_wall = "wall" in element.attributes.get("class", "")
        for points in _shape(element):
            if len(points) < 2:
                continue
            # In a drawing, y points down.
            placed = tuple(((x - left) * scale, (top + height - y) * scale) for x, y in points)
            if is_wall:
                walls.append(placed)
            else:
                tapes.append(Tape(placed, _width(element, scale), _brightness(element)))
    return Scene(tapes, walls)


_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_COMMAND = re.compile(rf"[A-Za-z]|{_NUMBER.pattern}")
_WHITE = ("white", "#fff", "#ffffff")


def _all(element: Element) -> Iterator[Element]:
    yield element
    for child in element.children:
        yield from _all(child)


def _style(element: Element, name: str) -> str:
    """Return a property of an element, from its style or from an attribute; "" if there is neither."""
    for entry in element.attributes.get("style", "").split(";"):
        key, _, value = entry.partition(":")
        if key.strip() == name:
            return value.strip()
    return element.attributes.get(name, "").strip()


def _width(element: Element, scale: float) -> float:
    text = _style(element, "stroke-width")
    found = _NUMBER.match(text)
    if text and found is None:
        element.reject(f"stroke-width={text!r} is not a number")
    width = float(found.group()) * scale if found else _WIDTH
    return width if width > 0.0 else _WIDTH


def _brightness(element: Element) -> float:
    return 1.0 if _style(element, "stroke").lower() in _WHITE else 0.0


def _shape(element: Element) -> Iterator[list[Point]]:
    """Yield the lines of an element; none if it is not a shape."""
    tag = element.tag.rpartition(":")[2]
    if tag == "line":
        yield [(element.number(f"x{n}", 0.0), element.number(f"y{n}", 0.0)) for n in (1, 2)]
    elif tag in ("polyline", "polygon"):
        numbers = [float(each) for each in _NUMBER.findall(element.attributes.get("points", ""))]
        points = list(zip(numbers[::2], numbers[1::2], strict=False))
        yield [*points, points[0]] if tag == "polygon" and points else points
    elif tag == "rect":
        x, y, width, height = (element.number(name, 0.0) for name in ("x", "y", "width", "height"))
        yield [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]
    elif tag == "circle":
        x, y, radius = (element.number(name, 0.0) for name in ("cx", "cy", "r"))
        turns = [math.tau * step / (2 * _CURVE) for step in range(2 * _CURVE + 1)]
        yield [(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]
    elif tag == "path":
        yield from _path(element)


#: Command of a path -> number of coordinates that it takes.
_TAKEN = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "Q": 4, "Z": 0}


def _path(element: Element) -> Iterator[list[Point]]:
    """Yield the lines of a path: moves, straight lines and Bezier curves."""
    words = _COMMAND.findall(element.attributes.get("d", ""))
    line: list[Point] = []
    x = y = 0.0
    place, command = 0, ""
    while place < len(words):
        if words[place].isalpha():
            command = words[place]
            place += 1
        elif command.upper() in ("", "Z"):
            element.reject("the path contains numbers instead of a command")
        kind = command.upper()
        count = _TAKEN.get(kind)
        if count is None:
            element.reject(f"the path contains the command {command}; expected one of M, L, H, V, C, Q and Z")
        try:
            numbers = [float(word) for word in words[place : place + count]]
        except ValueError:
            numbers = []
        if len(numbers) < count:
            element.reject(f"the path ends within the command {command}")
        place += count
        if command.islower():
            numbers = [number + (y if kind == "V" or index % 2 else x) for index, number in enumerate(numbers)]
        if kind == "Z":
            if line:
                line.append(line[0])
                x, y = line[0]
            continue
        x, y = numbers[-2:] if count > 1 else (numbers[0], y) if kind == "H" else (x, numbers[0])
        if kind == "M":
            if line:
                yield line
            line = [(x, y)]
            command = "l" if command == "m" else "L"
        elif kind in ("C", "Q"):
            line += _curve([line[-1] if line else (0.0, 0.0), *zip(numbers[::2], numbers[1::2], strict=True)])
        else:
            line.append((x, y))
    if line:
        yield line


def _curve(controls: Sequence[Point]) -> Iterator[Point]:
    """Yield the points of a Bezier curve after its first point, by repeated interpolation."""
    for step in range(1, _CURVE + 1):
        part = step / _CURVE
        points = list(controls)
        while len(points) > 1:
            points = [(a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])) for a, b in pairwise(points)]
        yield points[0]
