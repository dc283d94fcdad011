"""The set-points of a servo whose targets pass a target filter."""

from __future__ import annotations

from collections.abc import Sequence

from .jerk_limited import JointLimit, TargetFilter

__all__ = ["FilteredTargets"]


class FilteredTargets:
    """Makes the set-points of a servo from the last target of `Servo.send`.

    Args:
        limits: of each joint.
        cycle: s of the controller's cycle.

    Attributes:
        newest: the last target, (6,) rad; set by the thread that calls `Servo.send`.
    """

    def __init__(self, limits: Sequence[JointLimit], cycle: float) -> None:
        self.newest: list[float] | None = None
        self._limits, self._cycle = limits, cycle
        self._filter: TargetFilter  # made by `begin`, which comes first

    @property
    def has_targets(self) -> bool:
        return self.newest is not None

    def begin(self, time: float, q: Sequence[float]) -> None:
        self._filter = TargetFilter(q, self._limits)

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        self._filter.advance(seconds)
        return list(self._filter.q), list(self._filter.qd)

    def restart(self, time: float, q: Sequence[float], qd: Sequence[float]) -> None:
        self._filter.restart(q, qd)

    def at(self, time: float) -> tuple[list[float], list[float]]:
        assert self.newest is not None  # `has_targets`
        self._filter.aim(self.newest)
        return self._filter.after(self._cycle)

    def accept(self, time: float) -> None:
        self._filter.advance(self._cycle)
