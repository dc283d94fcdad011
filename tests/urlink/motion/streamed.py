"""Run a stream of points on one arm without a controller, network or clock; the test advances each cycle."""

from __future__ import annotations

import contextlib
import struct
from collections import deque
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import NamedTuple, cast

import numpy as np

from tests.fakes.rehearsal import HOME
from tests.urlink.motion.bench import Bench
from urlink.arm.kinematics import Arm
from urlink.arm.models import model
from urlink.arm.vectors import FloatArray
from urlink.motion.moves.speed_limit import largest_speeds
from urlink.motion.servo.jerk_limited import joint_limits
from urlink.motion.stream.stream_feed import StreamFeed
from urlink.motion.stream.stream_points import PointReader, Points
from urlink.motion.stream.stream_steps import Bounds, Handed
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.buffering import MESSAGE, REPORTED, RESTING, buffering
from urlink.script.links import ReverseSocket
from urlink.script.messages import dated

__all__ = ["ACCELERATION", "JERK", "Report", "Streamed"]

#: Acceleration in rad/s² and jerk in rad/s³ of the braking and corrections that a stream adds.
ACCELERATION, JERK = 10.0, 100.0
_MESSAGE, _REPORT = struct.Struct(f">{MESSAGE}i"), struct.Struct(f">{REPORTED}i")


class Report(NamedTuple):
    """Numbers of a report, as the program sends them; see `urlink.script.buffering`."""

    messages: int
    epoch: int
    head: int
    base: int
    passed: int
    phase: int


class Streamed:
    """Feed of a stream and the program that buffers its points; `path` holds one set-point per cycle.

    `sent` holds the numbers of each message that the feed has sent. `report` is the last report that it has read, and
    `since_report` the number of cycles since then.

    Args:
        firmware: Firmware of the controller.
        buffer: Time in s that the program buffers.
        way: Delay of messages and of reports, each in cycles.
        watchdog: Time in s without a message after which the program brakes.
    """

    BEGIN = 50.0

    def __init__(self, firmware: Firmware, buffer: float = 0.3, way: int = 0, watchdog: float = 1.0) -> None:
        arm = model("UR5e" if firmware.is_e_series else "UR5")
        limits = joint_limits(arm, largest_speeds(arm), ACCELERATION, JERK)
        self.bounds = Bounds(arm, largest_speeds(arm), limits)
        self.period = 1.0 / firmware.rate
        capacity = round(buffer / (2.0 * self.period)) + 4
        own = {"acceleration": [ACCELERATION] * 6, "jerk": [JERK] * 6, "watchdog": watchdog}

        def write(link: ReverseSocket) -> list[str]:
            return buffering(firmware, link, capacity=capacity, **own)  # type: ignore[arg-type]

        self.feed = StreamFeed(write, contextlib.nullcontext(), self.bounds, self.period, capacity, buffer)
        kinematics = Arm(arm)
        self.reader = PointReader(self.bounds, 2.0 * self.period, lambda pose, near: kinematics.inverse(pose, near))
        self.bench = Bench(self.program(write), firmware)
        self.path: list[list[float]] = []
        self.bench.watch_servoj(self.path.append, is_followed=False)
        self.capacity = capacity
        self.way = way
        self.sent: list[tuple[int, ...]] = []
        self.report = Report(0, 0, 0, 0, 0, RESTING)
        self.since_report = 0
        self._received = b""
        self._there: deque[bytes] = deque()
        self._back: deque[bytes] = deque()
        self.run(3)
        assert self.feed.begun.done()

    def program(self, write: Callable[[ReverseSocket], list[str]]) -> list[str]:
        """Return the lines of the program."""
        return write(ReverseSocket("10.0.0.1", 50001, 7))

    def state(self) -> RealtimeState:
        """Return a state with the fields that a stream reads."""
        q = np.array(self.path[-1] if self.path else HOME)
        time = self.BEGIN + self.bench.cycle * self.period
        return cast(
            RealtimeState,
            SimpleNamespace(time=time, q_target=q, qd_target=np.zeros(6), program_state=None, speed_scaling=None),
        )

    def run(self, cycles: int = 1, *, is_frozen: bool = False) -> None:
        """Run `cycles` cycles; with `is_frozen`, this computer does not run."""
        for _ in range(cycles):
            sent, self.bench.sockets.sent = bytes(self.bench.sockets.sent), bytearray()
            if self.bench.cycle < 2:
                sent = b""  # the program's token
            self._back.append(sent)
            if not is_frozen:
                received = b""
                while len(self._back) > self.way:
                    received += self._back.popleft()
                self._there.append(self.answer(received))
            while len(self._there) > self.way or (is_frozen and self._there):
                self.bench.sockets.waiting += self._there.popleft()
            self.bench.run()

    def answer(self, received: bytes) -> bytes:
        """Give the feed what it has received, and a state; return its message."""
        self._received += received
        self.since_report += 1
        while len(self._received) >= _REPORT.size:
            self.report = Report(*_REPORT.unpack_from(self._received))
            self._received, self.since_report = self._received[_REPORT.size :], 0
        message = self.feed.step(received, self.state(), 1000.0 + self.bench.cycle * self.period)
        self.sent.append(_MESSAGE.unpack(message))
        return dated(message, self.bench.cycle)

    def receive(self, report: Report) -> None:
        """Give the feed a report from the test in the next cycle, in which the program does not run."""
        self._there.append(self.answer(_REPORT.pack(*report)))

    def append(self, points: Points) -> Handed:
        """Append points without waiting."""
        assert self.feed.mark is not None
        handed = Handed()
        self.feed.add(self.reader.after(points, self.feed.mark), handed)
        return handed

    def replace(self, since: float, points: Points) -> float:
        """Replace the tail of the stream; return the time at which the replacement starts."""
        assert self.feed.mark is not None
        done = self.feed.replace(since, self.reader.curve(points, since, self.feed.mark))
        self.until(done.done)
        return done.result()

    def clear(self) -> float:
        """Clear the stream; return its new end time."""
        done = self.feed.replace(0.0, ())
        self.until(done.done)
        return done.result()

    def until(self, condition: object, seconds: float = 20.0) -> None:
        """Run until `condition` is true."""
        for _ in range(round(seconds / self.period)):
            if condition():  # type: ignore[operator]
                return
            self.run()
        raise AssertionError("the condition did not become true in time")

    def run_dry(self) -> None:
        """Run until the arm is at rest and no point is left."""
        self.until(lambda: self.feed.is_dry)

    def derivatives(self, first: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return speeds, accelerations and jerks of the set-points since index `first`, by differences."""
        path: Sequence[Sequence[float]] = self.path[first:]
        qd = np.diff(np.array(path), axis=0) / self.period
        qdd = np.diff(qd, axis=0) / self.period
        return qd, qdd, np.diff(qdd, axis=0) / self.period
