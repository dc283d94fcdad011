"""Following a path from rest to rest, at the pace that the speed slider sets."""

from __future__ import annotations

from typing import Protocol

from ..motion import Setpoint
from .blend import Remainder
from .move import Move
from .profile import Profile

__all__ = ["Path", "Travel"]

_REST = [0.0] * 6


class Path(Protocol):
    """Where the joints are along a way."""

    length: float
    speed: float
    acceleration: float

    def setpoint(self, way: float, speed: float, acceleration: float, last: Setpoint, seconds: float) -> Setpoint:
        """The joints where so much of the way is behind them; `last` is the path's set-point of the cycle before."""

    def end(self, near: list[float]) -> list[float]:
        """The joints at the end of a path that has brought them to `near`."""

    def left(self, q: list[float]) -> float:
        """How far the TCP is from its place at the end when the joints are at `q`, m."""


class Travel:
    """One path move. It is over at its end, or within the blend radius of it, in the second half of the way.

    That a blend never begins in the first half is a guess: a controller ignores blends that overlap.

    Attributes:
        move: what the program waits for.
    """

    def __init__(self, path: Path, profile: Profile, start: list[float], remainder: Remainder | None, r: float) -> None:
        self.move = Move()
        self._path, self._profile, self._remainder, self._radius = path, profile, remainder, r
        self._time = 0.0
        self._way = (0.0, 0.0)
        self._last = Setpoint(start, _REST, _REST)
        self.is_at_rest = False

    @property
    def blends(self) -> bool:
        """The program has gone on, and the arm has not yet arrived."""
        return self.move.is_over and not self.is_at_rest and self._way[1] > 0.0

    def corner(self) -> tuple[list[float], float]:
        """Where the joints would come to rest, and in how many seconds if they slowed down evenly from now on."""
        way, speed = self._way
        return self._path.end(self._last.q), 2.0 * (self._profile.length - way) / speed

    def advance(self, last: Setpoint, seconds: float, pace: float, change: float) -> Setpoint:
        """The set-point one cycle later, at a pace that has changed by `change` over the cycle."""
        time = self._time + (pace - 0.5 * change) * seconds
        arrives = time >= self._profile.duration
        if arrives:
            setpoint = Setpoint(self._path.end(self._last.q), _REST, _REST)
            way, speed = self._profile.length, 0.0
        else:
            way, speed, acceleration = self._profile.at(time)
            acceleration = acceleration * pace * pace + speed * change / seconds
            speed *= pace
            setpoint = self._path.setpoint(way, speed, acceleration, self._last, seconds)
        self._time, self._way, self._last = time, (way, speed), setpoint
        if self._remainder is not None:
            q, qd, qdd = self._remainder.advance(seconds)
            if self._remainder.is_over:
                self._remainder = None
            else:
                setpoint = Setpoint(
                    [a + b for a, b in zip(setpoint.q, q, strict=True)],
                    [a + b for a, b in zip(setpoint.qd, qd, strict=True)],
                    [a + b for a, b in zip(setpoint.qdd, qdd, strict=True)],
                )
        if arrives and self._remainder is None:
            self.is_at_rest = self.move.is_over = True
        elif self._blend_begins(way, setpoint.q):
            # Found now, so that a corner which cannot be reached is a violation in this cycle.
            self._path.end(self._last.q)
            self.move.is_over = True
        return setpoint

    def _blend_begins(self, way: float, q: list[float]) -> bool:
        if self.move.is_over or not self._radius or way < 0.5 * self._profile.length:
            return False
        return self._path.left(q) <= self._radius

    def restart(self, remainder: Remainder) -> None:
        """Go on from rest elsewhere: the remainder leads back to the path."""
        self._remainder = remainder
        self._last = Setpoint(self._last.q, _REST, _REST)
        self._way = (self._way[0], 0.0)

    @property
    def place(self) -> list[float]:
        """The joints on the path itself, without what is left of an older one."""
        return self._last.q
