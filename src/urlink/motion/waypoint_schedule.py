"""Waypoints with times on the robot's clock, and the set-points between them.

A cubic curve in joint space goes through the waypoints that are still ahead, from the present set-point and its speed,
to rest at the last waypoint; the speeds at those between are chosen as for a `Trajectory`. Each new waypoint makes a
new curve from there, so the speed never jumps.

As in the interpolation controller of UMI, a program for learning from demonstrations, a waypoint replaces those of the
same time or later, one whose time is past changes nothing, and one that cannot be reached in time is reached later. So
are all that are ahead if the arm is not at its set-point, because set-points were missed. That controller moves
straight from pose to pose, with a jump in speed at each.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager

import numpy as np

from linkcore.errors import BadValue

from ..models import Model
from .trajectory import Trajectory

#: s; waypoints that are closer in time count as one.
_CLOSEST = 1e-3
#: s for the rest of the path, if set-points were missed until all waypoints were past.
_LATE = 0.1
#: How often waypoints are postponed, and by which fraction of the time before the first of them: up to 400 times that.
_PUT_OFF, _LATER = 16, 0.45

_Waypoint = tuple[float, list[float]]


class Schedule:
    """Makes the set-points of a servo from waypoints.

    Args:
        model: its limits hold; None for an arm that is not known.
        cycle: s of the controller's cycle.
        delay: s from a state to the one in which the arm is at the set-point that answers it.
        section: of the robot: waypoints and states come in different threads.
    """

    def __init__(
        self, model: Model | None, cycle: float, delay: float, section: AbstractContextManager[object]
    ) -> None:
        self._model = model
        self._cycle = cycle
        self._delay = delay
        self._section = section
        self._waypoints: list[_Waypoint] = []
        #: begins at `_origin` on the robot's clock
        self._curve: Trajectory | None = None
        self._origin: float
        #: the time of the last set-point; None before the first
        self._now: float | None = None

    def add(self, q: list[float], at: float, time: float, here: Sequence[float]) -> float | None:
        """Be at `q` (6, rad) at a time on the robot's clock.

        Args:
            time: of the newest state.
            here: (6,) rad; target positions of the arm, for the case that it has not begun.

        Returns:
            when it will be there: `at`, or later if the arm needs more time; None if that time is past.

        Raises:
            BadValue: the curve leaves the range of a joint, or none was found that the arm can follow.
        """
        with self._section:
            anchor = self._now if self._now is not None else time + self._delay
            if at < anchor + self._cycle:
                return None
            waypoints = [each for each in self._waypoints if anchor + _CLOSEST < each[0] < at - _CLOSEST]
            q0, qd0 = self._sample(anchor) if self._now is not None else (list(here), [0.0] * 6)
            # A waypoint that is almost due is left out: the curve begins there anyway.
            self._plan(anchor, q0, qd0, [*waypoints, (at, q)], len(waypoints))
            return self._waypoints[-1][0]

    @property
    def last(self) -> list[float] | None:
        """The last waypoint, (6,) rad; None if there is none."""
        return self._waypoints[-1][1] if self._waypoints else None

    # -- the source of set-points --------------------------------------------------------------------

    @property
    def has_targets(self) -> bool:
        """Whether there is a waypoint."""
        return bool(self._waypoints)

    def begin(self, time: float, q: Sequence[float]) -> None:
        """The arm rests at `q`."""
        self._set_out(time + self._delay, q, [0.0] * 6)

    def restart(self, time: float, q: Sequence[float], qd: Sequence[float]) -> None:
        """Go on from `q` at speeds `qd`."""
        self._set_out(time + self._delay - self._cycle, q, qd)

    def _set_out(self, anchor: float, q: Sequence[float], qd: Sequence[float]) -> None:
        with self._section:
            self._now = anchor
            ahead = [each for each in self._waypoints if each[0] > anchor + self._cycle]
            self._plan(anchor, q, qd, ahead or [(anchor + _LATE, self._waypoints[-1][1])], 0)

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        """The present positions and speeds: time passes, whether set-points are sent or not."""
        with self._section:
            return self._sample(time + self._delay - self._cycle)

    def at(self, time: float, rate: float) -> tuple[list[float], list[float]]:
        """The set-point that answers the state of this time."""
        with self._section:
            return self._sample(time + self._delay)

    def accept(self, time: float, rate: float) -> None:
        """The set-point of this time was sent."""
        self._now = time + self._delay

    # ------------------------------------------------------------------------------------------------

    def _sample(self, t: float) -> tuple[list[float], list[float]]:
        assert self._curve is not None
        q, qd, _ = self._curve.sample(t - self._origin)
        return q, qd

    def _plan(
        self, anchor: float, q: Sequence[float], qd: Sequence[float], waypoints: list[_Waypoint], new: int
    ) -> None:
        """The curve from the present set-point through waypoints; those from number `new` on are put off if needed."""
        times = [time for time, _ in waypoints]
        places = np.array([list(q), *(place for _, place in waypoints)])
        before = times[new - 1] if new else anchor
        put_off = 0
        while True:
            curve = _curve(np.array([0.0, *(time - anchor for time in times)]), places, qd)
            try:
                curve.check(self._model)
                break
            except BadValue:
                if put_off == _PUT_OFF:
                    raise
            put_off += 1
            later = _LATER * (times[new] - before)
            times[new:] = [time + later for time in times[new:]]
        self._waypoints = [(time, place) for time, (_, place) in zip(times, waypoints, strict=True)]
        self._curve, self._origin = curve, anchor


def _curve(times: np.ndarray, places: np.ndarray, qd: Sequence[float]) -> Trajectory:
    """A curve through places at times, with speeds `qd` at first and rest at the end."""
    speeds = Trajectory.from_arrays(times, places).qd.copy()
    speeds[0] = qd
    return Trajectory.from_arrays(times, places, speeds)
