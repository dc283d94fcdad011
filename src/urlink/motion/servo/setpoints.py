"""Set-points: how the streaming program follows them, and the set-points that are sent, one for each cycle.

A `LinkDialogue` decides the messages, for this program and for others that are linked to this computer.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from ...protocol.firmware import Firmware
from ...protocol.realtime.packets import RealtimeState
from ...script.links import InputRegisters, ReverseSocket, Writer, missable
from ...script.streaming import COASTING, streaming
from ..links.messages import STOP_MESSAGE, setpoint
from ..moves.speed_limit import SpeedLimit


class LinkDialogue(ABC):
    """Decides the messages for a program, from the bytes that it sends and from the states of the robot; sans-IO.

    Args:
        write: makes the lines of the program, for its link.

    Attributes:
        farewell: the message that ends the program and brakes; empty if the program ends by itself.
        is_over: whether no message is left to send: where it is, the BRAKE of the motion's life follows.
        survives_its_program: whether the program may end by itself before the dialogue is over.
        watchdog: Seconds without a message after which the program brakes, for error messages; None if unknown.
    """

    watchdog: float | None = None
    farewell = STOP_MESSAGE
    is_over = False
    survives_its_program = False

    def __init__(self, write: Writer) -> None:
        self._write = write

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        """The lines of the program, which receives its messages over `link`."""
        return self._write(link)

    @abstractmethod
    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        """The message that answers a state; raises `LinkError` if the motion cannot go on."""

    def resume(self, state: RealtimeState) -> None:  # noqa: B027 -- most have nothing to do then
        """Go on after a pause: the arm stands where the program has left it, or close to that."""

    def conclude(self) -> None:  # noqa: B027 -- only one of them has something left to do then
        """Handle that the program has ended by itself."""


@dataclass(frozen=True)
class Servoing:
    """The parameters by which set-points are followed.

    Attributes:
        firmware: of the controller.
        speeds: (6,) rad/s, the largest of each joint.
        watchdog: seconds without a set-point after which the robot brakes.
        lookahead_time, gain: of ``servoj``, if the firmware has them.
        period: seconds between two set-points, if they do not come in each cycle; else 0.
    """

    firmware: Firmware
    speeds: tuple[float, ...]
    watchdog: float
    lookahead_time: float
    gain: float
    period: float = 0.0

    @property
    def _coasting(self) -> float:
        """Seconds of coasting: three periods, so that a loop slower than the controller moves the arm evenly."""
        return max(COASTING, 3.0 * self.period)

    @property
    def coastable(self) -> int:
        """Cycles for which the program on the robot coasts at most."""
        return missable(min(self.watchdog, self._coasting), self.firmware.rate)

    @property
    def late(self) -> float:
        """Seconds of lateness that may be made up for at once, since the robot has coasted meanwhile."""
        return self.coastable / self.firmware.rate

    def coasting(self, missed: int) -> float:
        """Number of cycles at full speed that lead as far as coasting for `missed` cycles."""
        n = min(missed, self.coastable)
        return n - n * (n + 1) / (2.0 * self.coastable)

    def share(self, missed: int) -> float:
        """The fraction of the full speed after coasting for `missed` cycles."""
        return 1.0 - min(missed, self.coastable) / self.coastable

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        """The lines of the program, which receives its set-points over `link`."""
        return streaming(
            self.firmware,
            link,
            speeds=self.speeds,
            watchdog=self.watchdog,
            coasting=self._coasting,
            lookahead_time=self.lookahead_time,
            gain=self.gain,
        )


class SetpointStream:
    """The last set-point that was sent, and how far the program on the robot has gone on from it.

    While set-points are missed, that program goes on at the speed that came with the last one, ever slower
    (`urlink.script.streaming`): it coasts. It counts its own cycles, which take longer while motion is scaled down.
    Other times are those of the controller's clock; `now` is monotonic s here.

    Args:
        servoing: how set-points are followed.

    Attributes:
        cycle: s of the controller.
        q: the last set-point, (6,) rad; empty before `begin`.
        qd: (6,) rad/s with which the program goes on from there; empty before `begin`.
    """

    def __init__(self, servoing: Servoing) -> None:
        self._servoing = servoing
        self.cycle = 1.0 / servoing.firmware.rate
        self._limit = SpeedLimit(servoing.speeds, self.cycle, late=servoing.late)
        self.q: list[float] = []
        self.qd: list[float] = []
        #: s since the last set-point, on the controller's clock and for the program; from `begin` on
        self._since: float
        self._since_scaled: float

    def begin(self, q: Sequence[float]) -> None:
        """The arm rests at `q` (6, rad)."""
        self.q, self.qd, self._since, self._since_scaled = list(q), [0.0] * 6, 0.0, 0.0

    def advance(self, seconds: float, scaled: float) -> None:
        """Advance the time, by so many s on the controller's clock and so many for the program."""
        self._since += seconds
        self._since_scaled += scaled

    @property
    def is_due(self) -> bool:
        """Whether the cycle of the last set-point is over, so that the next one may be sent."""
        return self._since >= 0.5 * self.cycle

    @property
    def missed(self) -> int:
        """Cycles of the program without a set-point since the last one."""
        return max(round(self._since_scaled / self.cycle) - 1, 0)

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
        self.q, self.qd, self._since, self._since_scaled = q, qd, 0.0, 0.0
        return setpoint(q, qd)
