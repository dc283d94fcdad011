"""Parameters for following set-points on the robot, and the stream that sends one set-point in each cycle.

A `LinkDialogue` decides the messages for each program with a link to this computer.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from ...protocol.firmware import Firmware
from ...protocol.realtime.packets import RealtimeState
from ...script.links import InputRegisters, ReverseSocket, Writer, missable
from ...script.messages import STOP_MESSAGE, setpoint
from ...script.streaming import COASTING, streaming
from ..moves.speed_limit import SpeedLimit


class LinkDialogue(ABC):
    """Dialogue with a program: decides the messages from the program's bytes and the robot's states.

    It does no I/O.

    Args:
        write: Function that returns the lines of the program for its link.

    Attributes:
        farewell: Message after which the program brakes and ends; empty if the program ends on its own.
        is_over: Whether no message is left to send. Then the event BRAKE of the motion's life cycle follows.
        survives_its_program: Whether the program may end on its own before the dialogue has ended.
        watchdog: Longest time without a message, in s, after which the program brakes; used in error messages. None if
            it is unknown.
        is_mute: Whether this dialogue no longer answers states, because the user's loop sends the messages. `step` then
            neither raises an error nor waits.
    """

    watchdog: float | None = None
    farewell = STOP_MESSAGE
    is_over = False
    survives_its_program = False
    is_mute = False

    def __init__(self, write: Writer) -> None:
        self._write = write

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        """Return the lines of the program, which receives its messages over `link`."""
        return self._write(link)

    @abstractmethod
    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        """Return the message that answers a state; raise `LinkError` if the motion cannot continue."""

    def resume(self, state: RealtimeState) -> None:  # noqa: B027 -- most dialogues do nothing after a pause
        """Continue after a pause. The arm is at rest at the position where it was paused, or close to it."""

    def conclude(self) -> None:  # noqa: B027 -- only one dialogue has to do something here
        """Record that the program has ended on its own."""


@dataclass(frozen=True)
class Servoing:
    """Parameters with which the program on the robot follows set-points.

    Attributes:
        firmware: Firmware of the controller.
        speeds: Largest speed of each joint, shape (6,), in rad/s.
        watchdog: Longest time without a set-point, in seconds. After this time, the robot brakes.
        lookahead_time, gain: Parameters of ``servoj``, if the firmware has them.
        period: Time between two set-points, in seconds, if they do not arrive in each cycle; otherwise 0.
    """

    firmware: Firmware
    speeds: tuple[float, ...]
    watchdog: float
    lookahead_time: float
    gain: float
    period: float = 0.0

    @property
    def _coasting(self) -> float:
        """Duration of coasting, in s: at least three periods, so that a slow loop still moves the arm evenly."""
        return max(COASTING, 3.0 * self.period)

    @property
    def coastable(self) -> int:
        """Largest number of cycles for which the program on the robot coasts."""
        return missable(min(self.watchdog, self._coasting), self.firmware.rate)

    @property
    def coasted(self) -> float:
        """Longest time in s at constant speed that covers the distance of coasting until the robot is at rest."""
        return self.coasting(self.coastable) / self.firmware.rate

    @property
    def late(self) -> float:
        """Delay in s that the next set-point may make up for at once, because the robot has coasted meanwhile."""
        return self.coastable / self.firmware.rate

    def coasting(self, missed: int) -> float:
        """Return the number of cycles at the initial speed that cover as much as coasting for `missed` cycles."""
        n = min(missed, self.coastable)
        return n - n * (n + 1) / (2.0 * self.coastable)

    def share(self, missed: int) -> float:
        """Return the fraction of the initial speed that is left after coasting for `missed` cycles."""
        return 1.0 - min(missed, self.coastable) / self.coastable

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        """Return the lines of the program, which receives its set-points over `link`."""
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
    """Stream of set-points: the last set-point, and the distance that the robot has coasted since then.

    While set-points are missing, the program on the robot coasts: it continues at the speed of the last set-point and
    slows down steadily (`urlink.script.streaming`). The program counts its own cycles, which take longer while the
    speed scaling is below 100 %. Other times are on the controller's clock. The argument `now` is a monotonic time in
    s.

    Args:
        servoing: Parameters for following set-points.

    Attributes:
        cycle: Cycle of the controller, in s.
        q: Last set-point, shape (6,), in rad; empty before `begin`.
        qd: Speeds of the program after this set-point, shape (6,), in rad/s; empty before `begin`.
    """

    def __init__(self, servoing: Servoing) -> None:
        self._servoing = servoing
        self.cycle = 1.0 / servoing.firmware.rate
        self._limit = SpeedLimit(servoing.speeds, self.cycle, late=servoing.late)
        self.q: list[float] = []
        self.qd: list[float] = []
        #: time in s since the last set-point, on the controller's clock and on the program's clock; set by `begin`
        self._since: float
        self._since_scaled: float

    def begin(self, q: Sequence[float]) -> None:
        """Begin with the arm at rest at `q`, (6,) rad."""
        self.q, self.qd, self._since, self._since_scaled = list(q), [0.0] * 6, 0.0, 0.0

    def advance(self, seconds: float, scaled: float) -> None:
        """Advance the time by `seconds` on the controller's clock, and by `scaled` seconds for the program."""
        self._since += seconds
        self._since_scaled += scaled

    @property
    def is_due(self) -> bool:
        """Whether the cycle of the last set-point has ended, so that the next set-point may be sent."""
        return self._since >= 0.5 * self.cycle

    @property
    def missed(self) -> int:
        """Number of program cycles without a set-point since the last set-point."""
        return max(round(self._since_scaled / self.cycle) - 1, 0)

    def coasted_time(self, missed: int) -> float:
        """Return the time in s at constant speed that covers the same distance as coasting for `missed` cycles."""
        return self._servoing.coasting(missed) * self.cycle

    def coasted_to(self, missed: int) -> tuple[list[float], list[float]]:
        """Return the positions in rad, and speeds in rad/s, after coasting for `missed` cycles."""
        seconds, share = self.coasted_time(missed), self._servoing.share(missed)
        return [a + seconds * b for a, b in zip(self.q, self.qd, strict=True)], [share * each for each in self.qd]

    def excess(self, q: Sequence[float], now: float) -> str | None:
        """Return a message if a set-point at `q` is further away than a joint can move; None if it may be sent."""
        return self._limit.excess(self.q, q, now)

    def send(self, q: list[float], qd: list[float], now: float) -> bytes:
        """Return the message with a set-point, and record it as the last set-point."""
        self._limit.take(self.q, q, now)
        self.q, self.qd, self._since, self._since_scaled = q, qd, 0.0, 0.0
        return setpoint(q, qd)
