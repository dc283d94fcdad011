"""Oracles, each with the promise of the documentation that it checks.

`watch` and `observed` check programs and handles. This module checks the promises about motions in a block, about
threads that keep a robot in sync, and about the effect of a call when it returns.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from linkcore.simulated import Simulation
from urlink.motion.links.register_link import RegisterLink
from urlink.motion.links.reverse import ReverseLink
from urlink.motion.servo.jog import Jog
from urlink.motion.servo.linked_program import LinkedProgram
from urlink.simulator import Controller

from .acting import direction
from .observed import BRAKING, Observed, replaced

__all__ = ["PROMISES", "Promises"]

#: Oracles of this folder: the place of the promise, and the promise.
PROMISES: Mapping[str, tuple[str, str]] = {
    "only requested motions": ("docs/safety.md", "the arm moves only while a client wants it to, or while it brakes"),
    "a stop overtakes": ("Motions.stop", "a motion that was requested before a stop is not sent after it has returned"),
    "a cancelled call leaves no motion": ("docs/asyncio.md", "motions that a cancelled call has started are cancelled"),
    "a call that raises leaves no motion": ("docs/motion-ends.md", "without a handle no motion continues"),
    "no data after close": ("Robot.close", "closes every connection"),
    "close ends in time": ("AsyncRobot.close", "within `timeout` seconds"),
    "calls end in time": ("docs/errors.md", "every call that waits has a timeout"),
    "a speed expires": ("Jog.move", "until other speeds are sent, or `timeout` seconds have passed"),
    "a frame is respected": ("Jog.move", "along and about the axes of the frame"),
    "a watchdog brakes": ("docs/motion-ends.md", "the robot brakes on its own when no set-point arrives"),
    "a motion arrives": ("Motions.move_joints", "the motion ends when the arm is at the goal"),
    "confirmed is done": ("IO.set_digital_out", "waits until the controller shows the value"),
    "no burst": ("Variables.background", "a missed period is not caught up on"),
    "every wait has an end": ("linkcore.clock.wait", "False if the time is up"),
    "a lock guards": ("linkcore.threads", "no lock is held during a callback, and the robot does not wait"),
    "counters add up": ("docs/statistics.md", "received packets are delivered, dropped or waiting"),
}
#: Time in addition to a watchdog or a timeout, in s: for the state that shows it, the network, and braking.
_BRAKED = BRAKING + 0.3
#: Time for a jog to come to rest from the speeds that `surface` draws, in s.
_AT_REST = 1.0
#: Longest watchdog that `surface` draws, in s.
_WATCHDOG = 0.5
#: Joint speed above which the arm counts as moving, in rad/s.
_MOVES = 0.02
#: Motions whose program ends with its messages; programs of the other motions have buffered points.
_LED = ("servo", "jog", "torque", "impedance", "force_mode", "speed_joints", "speed_linear")


class Promises:
    """Checks of the motions of blocks.

    Args:
        sim, controller, observed: Parts of the world.
        fault: Function that reports a fault.
        is_alone: Whether only one thread of one client acts in this world.
    """

    def __init__(
        self,
        sim: Simulation,
        controller: Controller,
        observed: Observed,
        fault: Callable[[str], object],
        *,
        is_alone: bool,
    ) -> None:
        self._sim = sim
        self._controller = controller
        self._observed = observed
        self._fault = fault
        self._is_alone = is_alone
        #: Time at which the last speed of a jog expires, by life cycle, in s.
        self._expires: dict[object, float] = {}
        #: Time of the last message of a link, by life cycle, in s.
        self._sent: dict[object, float] = {}
        self._life_of: dict[object, object] = {}
        self._moved: dict[object, float] = {}

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Observe while the block lasts."""
        with (
            replaced(Jog, "move", self._jogs),
            replaced(LinkedProgram, "say", self._says),
            replaced(ReverseLink, "send", self._sends),
            replaced(RegisterLink, "send", self._sends),
        ):
            yield

    def _jogs(self, move: Callable[..., None]) -> Callable[..., None]:
        def wrapped(jog: Jog, speeds: Any) -> None:
            move(jog, speeds)
            self._expires[jog._life] = self._sim.now + jog.timeout
            self._moved[jog._life] = self._sim.now
            if self._is_alone and np.any(speeds):
                self._sim.at(self._sim.now + min(0.9 * jog.timeout, 0.28), lambda: self._look_at(jog, speeds))

        return wrapped

    def _look_at(self, jog: Jog, speeds: Any) -> None:
        """Check that the arm moves in the commanded direction, unless another speed was commanded since."""
        state = jog._context.realtime.latest
        told = self._moved.get(jog._life, 0.0)
        is_told_anew = self._sim.now - told < min(0.9 * jog.timeout, 0.28) - 1e-3
        if state is None or jog.done or is_told_anew or jog.timeout < 0.25:
            return
        along = direction(jog, speeds, state)
        if along is not None and along < 0.2:
            self._fault(f"a jog in frame {jog.frame} moves with a cosine of {along:.2f} to the commanded direction")

    def _says(self, say: Callable[..., None]) -> Callable[..., None]:
        def wrapped(program: LinkedProgram, data: bytes) -> None:
            if program._link is not None:
                self._life_of[id(program._link)] = program._life
            say(program, data)

        return wrapped

    def _sends(self, send: Callable[..., None]) -> Callable[..., None]:
        def wrapped(link: object, data: bytes) -> None:
            send(link, data)
            life = self._life_of.get(id(link))
            if life is not None:
                self._sent[life] = self._sim.now

        return wrapped

    def look(self, speed: float) -> None:
        """Check one cycle in which the arm moves."""
        main = self._controller._runner.main
        sent = None if main is None else self._observed.programs.get(main.name)
        if sent is None or sent.ended is not None or speed <= _MOVES:
            return
        now, life = self._sim.now, sent.life
        if life.name == "jog":
            told = self._expires.get(life, sent.begun or now)
            if now > max(told, sent.begun or 0.0) + _AT_REST:
                self._fault(f"the arm moves at {speed:.3f} rad/s by a jog whose speed expired at {told:.3f} s")
        last = self._sent.get(life)
        is_led = sent.is_linked and life.name in _LED and last is not None
        if is_led and now > (last or 0.0) + _WATCHDOG + _BRAKED:
            self._fault(f"the arm moves by {life.name}, but no message was sent to it since {last:.3f} s")
