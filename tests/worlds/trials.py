"""Trials: short programs that use one part of the public interface, and compare what it says with the truth.

A trial is a function whose docstring is the promise that it holds the library to. Its numbers are drawn. What it may
expect it knows, since nobody else acts in its world: it makes the network silent, holds the input or sets the stop
itself, and asks the simulated controller what is true. A world has several trials in a row on one robot.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import threading
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

from linkcore.errors import LinkError
from linkcore.simulated import Computer, Simulation
from urlink.simulator import Controller

__all__ = ["AWAITED", "MOBILE", "NEAR", "TRIALS", "Bench", "awaited", "mobile", "trial"]

#: s by which something may be later than it is promised: the way there and back, a cycle, and threads that take turns.
NEAR = 0.05


class Bench:
    """What a trial works with.

    Args:
        sim, controller: of the world.
        host: where the controller is.
        robot: connected: `urlink.Robot`, `AsyncRobot`, or what a mobile robot's program has.
        there: the computer of the controller, or of the mobile robot.
        chance: draws numbers.
        fault: reports what must not be.
        name: of the trial.
    """

    def __init__(
        self,
        sim: Simulation,
        controller: Controller,
        host: str,
        robot: Any,
        here: Computer,
        there: Computer,
        chance: random.Random,
        fault: Callable[[str], object],
        name: str,
    ) -> None:
        self.sim, self.controller, self.host, self.robot = sim, controller, host, robot
        self.here, self.there, self.chance, self.name = here, there, chance, name
        self._fault = fault

    @property
    def now(self) -> float:
        return self.sim.now

    @property
    def cycle(self) -> float:
        """s between two states."""
        return 1.0 / self.controller.firmware.rate

    def check(self, is_right: Any, text: str) -> None:
        if not is_right:
            self._fault(f"{self.name}: {text}")

    @contextlib.contextmanager
    def silence(self) -> Iterator[None]:
        """Nothing comes from the robot, for as long as the block lasts."""
        back = self.sim.network.route(self.there, self.here)
        back.is_silent = True
        try:
            yield
        finally:
            self.sim.network.mend(self.here, self.there)

    def reset(self) -> None:
        """Every connection is lost, and can be made again at once."""
        self.sim.network.reset(self.here, self.there)

    @contextlib.contextmanager
    def raises(self, *kinds: type[BaseException], after: float = 0.0, within: float = NEAR) -> Iterator[None]:
        """The block raises one of these, after so many seconds, and not much later."""
        begun = self.now
        try:
            yield
        except kinds as error:
            took = self.now - begun
            self.check(after - 2e-3 <= took <= after + within, f"{error!r} after {took:.3f} s, promised: {after:.3f} s")
        else:
            self.check(False, f"nothing was raised; expected {' or '.join(kind.__name__ for kind in kinds)}")

    @contextlib.contextmanager
    def quiet(self) -> Iterator[None]:
        """What is logged in the block is expected."""
        before = logging.root.manager.disable
        logging.disable(logging.CRITICAL)
        try:
            yield
        finally:
            logging.disable(before)

    def thread(self, call: Callable[[], object]) -> threading.Thread:
        """Call something in another thread."""
        thread = threading.Thread(target=call, name="trial", daemon=True)
        thread.start()
        return thread

    def joined(self, thread: threading.Thread, within: float) -> bool:
        """Whether a thread ends in time."""
        thread.join(within)
        self.check(not thread.is_alive(), f"a call has not ended within {within:g} s")
        return not thread.is_alive()

    def call(self, change: Callable[[], object]) -> None:
        """Change something of the controller, in its own thread."""
        self.controller.call(change)

    def ended(self, call: Callable[[], object]) -> tuple[threading.Thread, list[Any]]:
        """A call in another thread, and what comes of it: the result or the error, and when."""
        outcome: list[Any] = []

        def make() -> None:
            try:
                outcome.append(call())
            except LinkError as error:
                outcome.append(error)
            outcome.append(self.now)

        return self.thread(make), outcome


Trial = Callable[[Bench], object]
#: With a robot for threads, with one for asyncio, and with a mobile robot; by name.
TRIALS: dict[str, Trial] = {}
AWAITED: dict[str, Callable[[Bench], Awaitable[object]]] = {}
MOBILE: dict[str, Trial] = {}


def trial(function: Trial) -> Trial:
    """A trial with a robot for threads."""
    TRIALS[f"try {function.__name__}"] = function
    return function


def awaited(function: Callable[[Bench], Awaitable[object]]) -> Callable[[Bench], Awaitable[object]]:
    """A trial with a robot for asyncio."""
    AWAITED[f"try {function.__name__} in a task"] = function
    return function


def mobile(function: Trial) -> Trial:
    """A trial with a mobile robot."""
    MOBILE[f"try {function.__name__} of a mobile robot"] = function
    return function


async def ended(bench: Bench, call: Awaitable[Any]) -> tuple[Any, float]:
    """What comes of an awaitable, and when."""
    try:
        made = await call
    except (LinkError, asyncio.TimeoutError) as error:
        made = error
    return made, bench.now


# Which have the trials, and need the above.
from . import (  # noqa: E402
    trials_in_tasks,
    trials_of_commands,
    trials_of_mobiles,
    trials_of_motions,
    trials_of_streams,
)

MODULES = (trials_in_tasks, trials_of_commands, trials_of_mobiles, trials_of_motions, trials_of_streams)
