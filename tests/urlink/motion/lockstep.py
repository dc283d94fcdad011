"""A simulated controller and a robot that is connected to it, which go through the robot's time together.

Time passes a few cycles at once, and on only when the client has heard of them, so it passes as fast as the machine
makes it, and a busy one holds up both ends alike. Motions go by the controller's time.
"""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections.abc import Iterator

import numpy as np

import urlink
from tests.waiting import until
from urlink.interfaces.enums import ProgramState
from urlink.interfaces.realtime.packets import RealtimeState
from urlink.robot import Robot
from urlink.simulator import Controller, Still

__all__ = ["Lockstep"]

#: s of robot time at once, and s of this computer's that the client may take to hear of it.
_SLICE, _HEARD = 0.004, 0.2
#: s that the client may be without news: none comes while time stands still.
_FOREVER = 3600.0
TIMEOUT = 120.0
#: rad; elbow up, tool down.
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])


class Lockstep:
    """Both ends. Time passes within `passing`.

    Args:
        arm, firmware: of the controller.
    """

    def __init__(self, arm: str, firmware: str) -> None:
        self.controller = Controller(arm, firmware, motion=Still(), stepped=True)
        self._cycles = max(round(_SLICE * self.controller.firmware.rate), 1)
        self._heard = threading.Event()
        self._closing = contextlib.ExitStack()
        with contextlib.ExitStack() as opened:
            opened.enter_context(self.controller)
            with self.controller.passing():
                address = self.controller.address
                robot = urlink.connect(address, stale_after=_FOREVER, silence=_FOREVER, start_timeout=60.0)
                self.robot: Robot = opened.enter_context(robot)
                motion = self.robot.motion
                motion._context = dataclasses.replace(motion._context, clock=lambda: self.controller.time)
                opened.enter_context(self.robot.realtime.subscribe(self._hear, inline=True))
                self.robot.realtime.wait(TIMEOUT)
            self._closing = opened.pop_all()

    def close(self) -> None:
        """End both."""
        with self.controller.passing():
            self._closing.close()

    def _hear(self, state: RealtimeState) -> None:
        if state.time >= self.controller.time - 1e-9:
            self._heard.set()

    @contextlib.contextmanager
    def passing(self) -> Iterator[None]:
        """Let time pass until the block is left."""
        over = threading.Event()

        def run() -> None:
            while not over.is_set():
                self._heard.clear()
                self.controller.step(self._cycles)
                self._heard.wait(_HEARD)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    @property
    def speed(self) -> float:
        """rad/s of the fastest joint, of the arm itself and not as streams tell of it."""
        return max(map(abs, self.controller.arm.setpoint.qd))

    @property
    def q(self) -> list[float]:
        """rad; where the arm is led."""
        return list(self.controller.arm.setpoint.q)

    @property
    def is_over(self) -> bool:
        """The arm stands, and no program commands it: none runs, or it was paused by a stop."""
        is_paused = self.controller.modes.program_state is ProgramState.PAUSED
        return self.speed == 0.0 and (is_paused or not self.controller.is_running_program)

    def after(self, seconds: float) -> None:
        """Wait for so much of the robot's time."""
        end = self.controller.time + seconds
        until(lambda: self.controller.time >= end, TIMEOUT)

    def stands_still(self, seconds: float = 0.05) -> bool:
        """For so much of the robot's time, the arm does not move."""
        q = self.q
        self.after(seconds)
        return self.q == q and self.speed == 0.0

    def is_rigid(self) -> bool:
        """Pushed, the arm does not yield."""
        self.controller.push([0, 0, 30.0, 0, 0, 0])
        try:
            return self.stands_still()
        finally:
            self.controller.push([0.0] * 6)
