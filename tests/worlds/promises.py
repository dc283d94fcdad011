"""Oracles, each with the sentence of the documentation that it holds the library to.

`watch` and `observed` look at programs and handles. Here are the promises about what moves the arm in a block, about
threads that keep a robot in step, and about what a call has done when it returns.
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

#: The oracles of this folder: where the promise is made, and what is promised.
PROMISES: Mapping[str, tuple[str, str]] = {
    "nothing unasked moves": ("docs/safety.md", "the arm moves only while a client wants it to, or brakes"),
    "a stop overtakes": ("Motions.stop", "a motion that was asked for before a stop is not sent after it has returned"),
    "a cancelled call leaves nothing": ("docs/asyncio.md", "what a cancelled call has begun on the robot is cancelled"),
    "a call that raises leaves nothing": ("docs/motion-ends.md", "without a handle nothing goes on"),
    "after close nothing is sent": ("Robot.close", "closes every connection"),
    "close is in time": ("AsyncRobot.close", "in `timeout` seconds"),
    "calls are in time": ("docs/errors.md", "every call that waits has a timeout"),
    "a speed expires": ("Jog.move", "until others come, or `timeout` seconds are over"),
    "a frame is that frame": ("Jog.move", "along and about the axes of the frame"),
    "a watchdog brakes": ("docs/motion-ends.md", "the robot brakes by itself when no set-point comes"),
    "a motion arrives": ("Motions.move_joints", "it is over when the arm is there"),
    "confirmed is done": ("IO.set_digital_out", "waits until the controller shows it"),
    "no burst": ("Variables.background", "a period that was missed is not made up for"),
    "every wait has an end": ("linkcore.clock.wait", "False if time is up"),
    "a lock guards": ("linkcore.threads", "no lock is held meanwhile and no robot is kept waiting"),
    "counters add up": ("docs/statistics.md", "what came is delivered, dropped or waiting"),
}
#: s on top of a watchdog or a timeout: the state that shows it, the way to the robot, and braking.
_BRAKED = BRAKING + 0.3
#: s in which a jog comes to rest from the speeds that `surface` draws.
_AT_REST = 1.0
#: The longest watchdog that `surface` draws, s.
_WATCHDOG = 0.5
#: rad/s above which the arm moves.
_MOVES = 0.02
#: Motions whose program ends with its messages; the others have points in store.
_LED = ("servo", "jog", "torque", "impedance", "force_mode", "speed_joints", "speed_linear")


class Promises:
    """Looks at what blocks have the arm do.

    Args:
        sim, controller, observed: of the world.
        fault: reports what must not be.
        is_alone: nothing but one thread of one client does anything in this world.
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
        #: by life cycle: when a jog was told a speed last, and when that expires; s
        self._expires: dict[object, float] = {}
        #: by life cycle: when its link sent a message last, s
        self._sent: dict[object, float] = {}
        self._life_of: dict[object, object] = {}
        self._moved: dict[object, float] = {}

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Observe, for as long as the block lasts."""
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
        """The arm moves as it was told, unless it was told something else since."""
        state = jog._context.realtime.latest
        told = self._moved.get(jog._life, 0.0)
        is_told_anew = self._sim.now - told < min(0.9 * jog.timeout, 0.28) - 1e-3
        if state is None or jog.done or is_told_anew or jog.timeout < 0.25:
            return
        along = direction(jog, speeds, state)
        if along is not None and along < 0.2:
            self._fault(f"a jog in frame {jog.frame} moves at {along:.2f} of the direction that it was told")

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
        """In each cycle in which the arm moves."""
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
            self._fault(f"the arm moves by {life.name}, to which nothing was sent since {last:.3f} s")
