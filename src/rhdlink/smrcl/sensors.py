"""Sensors of a mission (infrared distances and line sensors), whose raw values are processed as in MRC.

Infrared: raw values are bytes. A distance is ``k1 / (raw - k2)`` m, at most 1 m. Five sensors are used: left, front
left, front middle, front right and right. The sixth is unused.

Line: a robot usually has 8 sensors from side to side. The leftmost sensor is the last one, so positions increase to the
left. The calibration converts the raw values to 0 on black and 1 on white, and then they are smoothed. Uncalibrated
sensors read 0: black everywhere. MRC keeps the sums in 32-bit floats. Their rounding affects the commands, so this
module rounds in the same way.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from struct import Struct

from .arithmetic import divide, truncate

#: Maximum range of an infrared sensor, in m.
_FARTHEST = 1.0

#: Brightness of the darkest sensor that separates a line from no line.
_THRESHOLD = 0.43

_FLOAT = Struct("f")


class LineKind(enum.Enum):
    """Kind of line that `followline` follows, with its name in the language."""

    BLACK_MIDDLE = "bm"
    BLACK_LEFT = "bl"
    BLACK_RIGHT = "br"
    WHITE_MIDDLE = "wm"
    WHITE_LEFT = "wl"
    WHITE_RIGHT = "wr"
    CAMERA = "bmc"


def _single(value: float) -> float:
    """Round `value` to a float of 32 bits."""
    try:
        found: float = _FLOAT.unpack(_FLOAT.pack(value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)
    return found


class InfraredSensors:
    """Distances from raw values of infrared sensors.

    Args:
        k1: Factor of each sensor, in m.
        k2: Raw value of each sensor at an infinite distance.

    Attributes:
        distances: Distance of each sensor, in m; 0 before the first update.
        raw: Raw values of the last update; empty before the first update.
    """

    def __init__(self, k1: Sequence[float], k2: Sequence[float]) -> None:
        self._parameters = tuple(zip(k1, k2, strict=True))
        self.distances = [0.0] * len(self._parameters)
        self.raw: Sequence[int] = ()

    def update(self, raw: Sequence[int]) -> None:
        """Perform one cycle."""
        if raw == self.raw:
            return
        self.raw = raw
        distances = self.distances
        for number, ((k1, k2), value) in enumerate(zip(self._parameters, raw, strict=False)):
            # MRC keeps the raw value in a byte, and the difference in an int.
            above = truncate(value % 256 - k2)
            distances[number] = _FARTHEST if above < 1 else k1 / above

    @property
    def front(self) -> float:
        """Smallest of the three front distances, in m."""
        return min(self.distances[1:4])


class LineSensor:
    """The line under the robot.

    Args:
        size: Number of sensors, 5 to 30.
        smoothing: Part of the previous value that is kept in each cycle, 0..1.
        white, black: Raw values of each sensor on white and on black. If None, every sensor reads black.

    Attributes:
        size: Number of sensors.
        values: Value of each sensor: 0 is black, 1 is white; not smoothed.
        smoothed: Smoothed value of each sensor.
        raw: Raw values of the last update; empty before the first update.
        is_missing: Whether no black line has been detected for 6 cycles.
    """

    def __init__(
        self, size: int, smoothing: float, white: Sequence[float] | None, black: Sequence[float] | None
    ) -> None:
        self.size = size
        self._smoothing = smoothing
        self._offset = [0.0] * size if black is None else list(black)
        self._gain = (
            [0.0] * size
            if white is None or black is None
            else [divide(1.0, on_white - on_black) for on_white, on_black in zip(white, black, strict=True)]
        )
        self.values = [0.0] * size
        self.smoothed = [0.0] * size
        self.is_missing = False
        self._count = 0
        self.raw: Sequence[int] = ()
        self._is_settled = False
        self._darkest = self._brightest = 0.0
        self._brightest_place = 0
        self._halves = (True, True, False, False)
        # Computed on demand, and kept until the next cycle. Without a sensor, the positions stay 0.
        self._positions: dict[LineKind, float] = dict.fromkeys(LineKind, 0.0)
        self._black_crossing = _Crossing()
        self._white_crossing = _Crossing()

    def update(self, raw: Sequence[int]) -> None:
        """Perform one cycle with raw values."""
        if raw == self.raw and self._is_settled:
            self._miss()
            return
        self.raw = raw
        gain, offset = self._gain, self._offset
        self.see([gain[each] * (raw[each] - offset[each]) for each in range(self.size)])

    def see(self, values: Sequence[float]) -> None:
        """Perform one cycle with calibrated values."""
        keep = self._smoothing
        smoothed = [old * keep + new * (1 - keep) for old, new in zip(self.smoothed, values, strict=True)]
        self._is_settled = smoothed == self.smoothed
        self.values = list(values)
        self.smoothed = smoothed
        brightest, darkest, place = 0.0, 100.0, 0
        for number, value in enumerate(smoothed):
            if value > brightest:
                brightest, place = _single(value), number
            if value < darkest:
                darkest = _single(value)
        self._darkest, self._brightest, self._brightest_place = darkest, brightest, place
        self._miss()
        self._halves = (
            max(smoothed[:4]) <= 0.2,
            max(smoothed[self.size - 4 :]) <= 0.2,
            min(smoothed[:4]) >= 0.75,
            min(smoothed[4:8]) >= 0.75,
        )
        self._positions.clear()

    def position(self, kind: LineKind) -> float:
        """Return the position of a line, in cm to the left of the middle."""
        if kind not in self._positions:
            self._locate()
        return self._positions[kind]

    def _locate(self) -> None:
        smoothed, brightest, darkest = self.smoothed, self._brightest, self._darkest
        middle = (self.size - 1) / 2.0
        mass = weighted = 0.0
        for number, value in enumerate(smoothed):
            mass = _single(mass + (brightest - value))
            weighted = _single(weighted + (brightest - value) * number)
        # The centre is nan if all sensors read the same value.
        centre = _single(divide(weighted, mass))
        black = _edges(smoothed, _single((darkest + brightest) / 2.0))
        white = _edges([-value for value in smoothed], -(darkest + brightest) / 2.0)
        # An edge is detected about one sensor before its position.
        self._positions = {
            LineKind.BLACK_MIDDLE: (centre - middle) * 2,
            LineKind.BLACK_RIGHT: (black[0] + 1.1 - middle) * 2,
            LineKind.BLACK_LEFT: (black[1] - 1.1 - middle) * 2,
            LineKind.WHITE_MIDDLE: (self._brightest_place - middle) * 2,
            LineKind.WHITE_RIGHT: (white[0] + 1.1 - middle) * 2,
            LineKind.WHITE_LEFT: (white[1] - 1.1 - middle) * 2,
        }

    def _miss(self) -> None:
        """Set `is_missing` after the darkest sensor has measured a line, or no line, for 6 cycles."""
        if (self._darkest < _THRESHOLD) if self.is_missing else (self._darkest > _THRESHOLD):
            self._count += 1
            if self._count > 5:
                self._count = 0
                self.is_missing = not self.is_missing

    @property
    def is_found(self) -> bool:
        """Whether the two sensors in the middle (numbers 3 and 4) are on black."""
        return self.smoothed[3] < 0.3 and self.smoothed[4] < 0.3

    def crosses_black(self, distance: float) -> bool:
        """Whether both halves have been on black within 3 cm.

        `distance` is the driven distance in m.
        """
        return self._black_crossing.update(self._halves[0], self._halves[1], distance)

    def crosses_white(self, distance: float) -> bool:
        """Whether both halves have been on white within 3 cm."""
        return self._white_crossing.update(self._halves[2], self._halves[3], distance)


def _edges(smoothed: Sequence[float], cross: float) -> tuple[float, float]:
    """Return the first position from each end at which the brightness falls below `cross`.

    The positions are in units of the distance between two sensors.
    """
    last = len(smoothed) - 1
    inner, outer = 0, -1
    for number in range(1, last + 1):
        if smoothed[number] > cross:
            inner = number
        else:
            outer = number
            break
    left = -1.0
    if outer > 0 and smoothed[outer] < smoothed[inner]:
        left = _single(inner + (smoothed[inner] - cross) / (smoothed[inner] - smoothed[outer]))
        if left < 0:
            left = _single(left / 3)
        left = max(left, -1.0)
    inner, outer = last, -1
    for number in range(last - 1, -1, -1):
        if smoothed[number] > cross:
            inner = number
        else:
            outer = number
            break
    right = last + 1.0
    if outer >= 0 and smoothed[outer] < smoothed[inner]:
        right = _single(inner - (smoothed[inner] - cross) / (smoothed[inner] - smoothed[outer]))
        if right > last:
            right = _single(last + (right - last) / 3.0)
        right = min(right, last + 1.0)
    return left, right


class _Crossing:
    """Position at which each half of the sensor was last on the line.

    Both positions begin at 0 m, as in MRC.
    """

    def __init__(self) -> None:
        self._first = self._second = 0.0

    def update(self, first: bool, second: bool, distance: float) -> bool:
        crosses = False
        if first:
            self._first = distance
            crosses = abs(self._first - self._second) < 0.03
        if second:
            self._second = distance
            crosses = crosses or abs(self._first - self._second) < 0.03
        return crosses
