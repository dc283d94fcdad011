"""A stream of points on one arm, without controller, network or clock: cycle by cycle, as the test says."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np

from tests.fakes.rehearsal import HOME
from tests.urlink.motion.bench import Bench
from urlink.arm.kinematics import Arm
from urlink.arm.models import model
from urlink.arm.vectors import FloatArray
from urlink.motion.links.messages import dated
from urlink.motion.moves.speed_limit import largest_speeds
from urlink.motion.servo.jerk_limited import joint_limits
from urlink.motion.stream.stream_feed import StreamFeed
from urlink.motion.stream.stream_points import PointReader, Points
from urlink.motion.stream.stream_steps import Bounds, Handed
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.buffering import buffering
from urlink.script.links import ReverseSocket

__all__ = ["ACCELERATION", "JERK", "Streamed"]

#: rad/s² and rad/s³ of what a stream adds.
ACCELERATION, JERK = 10.0, 100.0


class Streamed:
    """What feeds a stream, and the program that holds its points; `path` are the set-points, one for each cycle.

    Args:
        firmware: of the controller.
        buffer: s that the program holds.
        way: cycles that messages and reports take, each.
        watchdog: s without a message.
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
        self.way = way
        self._there: deque[bytes] = deque()
        self._back: deque[bytes] = deque()
        self.run(3)
        assert self.feed.begun.done()

    def program(self, write: Callable[[ReverseSocket], list[str]]) -> list[str]:
        """Its lines."""
        return write(ReverseSocket("10.0.0.1", 50001, 7))

    def state(self) -> RealtimeState:
        """What of it a stream looks at."""
        q = np.array(self.path[-1] if self.path else HOME)
        time = self.BEGIN + self.bench.cycle * self.period
        return cast(
            RealtimeState,
            SimpleNamespace(time=time, q_target=q, qd_target=np.zeros(6), program_state=None, speed_scaling=None),
        )

    def run(self, cycles: int = 1, *, is_frozen: bool = False) -> None:
        """So many cycles; `is_frozen`: without this computer."""
        for _ in range(cycles):
            sent, self.bench.sockets.sent = bytes(self.bench.sockets.sent), bytearray()
            if self.bench.cycle < 2:
                sent = b""  # its token
            self._back.append(sent)
            if not is_frozen:
                received = b""
                while len(self._back) > self.way:
                    received += self._back.popleft()
                message = self.feed.step(received, self.state(), 1000.0 + self.bench.cycle * self.period)
                self._there.append(dated(message, self.bench.cycle))
            while len(self._there) > self.way or (is_frozen and self._there):
                self.bench.sockets.waiting += self._there.popleft()
            self.bench.run()

    def append(self, points: Points) -> Handed:
        """Append points, without waiting."""
        assert self.feed.mark is not None
        handed = Handed()
        self.feed.add(self.reader.after(points, self.feed.mark), handed)
        return handed

    def replace(self, since: float, points: Points) -> float:
        """Replace the tail; returns the time from which it holds."""
        assert self.feed.mark is not None
        done = self.feed.replace(since, self.reader.curve(points, since, self.feed.mark))
        self.until(done.done)
        return done.result()

    def clear(self) -> float:
        """Clear it; returns where it ends now."""
        done = self.feed.replace(0.0, ())
        self.until(done.done)
        return done.result()

    def until(self, condition: object, seconds: float = 20.0) -> None:
        """Run until something is so."""
        for _ in range(round(seconds / self.period)):
            if condition():  # type: ignore[operator]
                return
            self.run()
        raise AssertionError("it did not come to that")

    def run_dry(self) -> None:
        """Until the arm rests and no point is left."""
        self.until(lambda: self.feed.is_dry)

    def derivatives(self, first: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Speeds, accelerations and jerks of the set-points, by differences, from one of them on."""
        path: Sequence[Sequence[float]] = self.path[first:]
        qd = np.diff(np.array(path), axis=0) / self.period
        qdd = np.diff(qd, axis=0) / self.period
        return qd, qdd, np.diff(qdd, axis=0) / self.period
