"""The set-points that are sent, one for each cycle of the controller, and what the robot does when some are missed."""

from __future__ import annotations

from collections.abc import Sequence

from ..models import Model
from .setpoints import Servoing, setpoint
from .speed_limit import SpeedLimit

__all__ = ["SetpointStream"]


class SetpointStream:
    """The last set-point that was sent, and how far the program on the robot has gone on from it.

    While set-points are missed, that program goes on at the speed that came with the last one, ever slower
    (`urlink.urscript.streaming`): it coasts. Times are those of the controller's clock; `now` is monotonic s here.

    Args:
        servoing: how set-points are followed.
        model: the arm, whose joint speeds bound every set-point; None if it is not known.

    Attributes:
        cycle: s of the controller.
        q: the last set-point, (6,) rad; empty before `begin`.
        qd: (6,) rad/s with which the program goes on from there; empty before `begin`.
    """

    def __init__(self, servoing: Servoing, model: Model | None) -> None:
        self._servoing = servoing
        self.cycle = 1.0 / servoing.firmware.rate
        self._limit = SpeedLimit(model, self.cycle, late=servoing.late)
        self.q: list[float] = []
        self.qd: list[float] = []
        #: s since the last set-point
        self._since = 0.0

    def begin(self, q: Sequence[float]) -> None:
        """The arm rests at `q` (6, rad)."""
        self.q, self.qd = list(q), [0.0] * 6

    def advance(self, seconds: float) -> None:
        """Advance the time."""
        self._since += seconds

    @property
    def is_due(self) -> bool:
        """Whether the cycle of the last set-point is over, so that the next one may be sent."""
        return self._since >= 0.5 * self.cycle

    @property
    def missed(self) -> int:
        """Cycles without a set-point since the last one."""
        return max(round(self._since / self.cycle) - 1, 0)

    def coasted_time(self, missed: int) -> float:
        """s at the speed of the last set-point in which the arm goes as far as by coasting for `missed` cycles."""
        return self._servoing.coasting(missed) * self.cycle

    def coasted_to(self, missed: int) -> tuple[list[float], list[float]]:
        """Positions, rad, and speeds, rad/s, after coasting for `missed` cycles."""
        seconds, share = self.coasted_time(missed), self._servoing.share(missed)
        return [a + seconds * b for a, b in zip(self.q, self.qd, strict=True)], [share * each for each in self.qd]

    def excess(self, q: Sequence[float], now: float) -> str | None:
        """Why a set-point at `q` must not be sent: it is further away than a joint can move; None if it may."""
        return self._limit.excess(self.q, q, now)

    def send(self, q: list[float], qd: list[float], now: float) -> bytes:
        """The bytes of a set-point, which becomes the last one."""
        self._limit.take(self.q, q, now)
        self.q, self.qd, self._since = q, qd, 0.0
        return setpoint(q, qd)
