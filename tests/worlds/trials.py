"""Trials: short programs that use one part of the public interface, and compare its results with the true state.

A trial is a function whose docstring is the promise that it checks. Its numbers are drawn. No other client acts in its
world, so the trial knows the expected results: it makes the network silent, sets the input or causes the stop itself,
and reads the true state from the simulated controller. A world has several trials in a row on one robot.
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

#: Allowed delay after a promised time, in s: for a round trip, a cycle, and threads that take turns.
NEAR = 0.05


class Bench:
    """Tools of a trial.

    Args:
        sim, controller: Parts of the world.
        host: Address of the controller.
        robot: Connected robot: `urlink.Robot` or `AsyncRobot`, or None for trials of mobile robots.
        here: Computer of the client.
        there: Computer of the controller, or of the mobile robot.
        chance: Random generator.
        fault: Function that reports a fault.
        name: Name of the trial.
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
        """Time between two states, in s."""
        return 1.0 / self.controller.firmware.rate

    def check(self, is_right: Any, text: str) -> None:
        if not is_right:
            self._fault(f"{self.name}: {text}")

    @contextlib.contextmanager
    def silence(self) -> Iterator[None]:
        """Let no data arrive from the robot while the block lasts."""
        back = self.sim.network.route(self.there, self.here)
        back.is_silent = True
        try:
            yield
        finally:
            self.sim.network.mend(self.here, self.there)

    def reset(self) -> None:
        """Reset every connection; new ones can be made immediately."""
        self.sim.network.reset(self.here, self.there)

    @contextlib.contextmanager
    def raises(self, *kinds: type[BaseException], after: float = 0.0, within: float = NEAR) -> Iterator[None]:
        """Check that the block raises one of these errors, `after` seconds and at most `within` seconds later."""
        begun = self.now
        try:
            yield
        except kinds as error:
            took = self.now - begun
            self.check(after - 2e-3 <= took <= after + within, f"{error!r} after {took:.3f} s, promised: {after:.3f} s")
            # contextlib of CPython 3.13.0 would keep the error and its frames in a cycle.
            error.__traceback__ = None
        else:
            self.check(False, f"nothing was raised; expected {' or '.join(kind.__name__ for kind in kinds)}")

    @contextlib.contextmanager
    def quiet(self) -> Iterator[None]:
        """Disable logging in the block, because its log messages are expected."""
        before = logging.root.manager.disable
        logging.disable(logging.CRITICAL)
        try:
            yield
        finally:
            logging.disable(before)

    def thread(self, call: Callable[[], object]) -> threading.Thread:
        """Call a function in another thread."""
        thread = threading.Thread(target=call, name="trial", daemon=True)
        thread.start()
        return thread

    def joined(self, thread: threading.Thread, within: float) -> bool:
        """Check that a thread ends in time; return whether it did."""
        thread.join(within)
        self.check(not thread.is_alive(), f"a call has not ended within {within:g} s")
        return not thread.is_alive()

    def call(self, change: Callable[[], object]) -> None:
        """Change the controller, in its own thread."""
        self.controller.call(change)

    def ended(self, call: Callable[[], object]) -> tuple[threading.Thread, list[Any]]:
        """Call a function in another thread; return the thread, and a list for its result or error and the time."""
        outcome: list[Any] = []

        def make() -> None:
            try:
                outcome.append(call())
            except LinkError as error:
                outcome.append(error)
            outcome.append(self.now)

        return self.thread(make), outcome


Trial = Callable[[Bench], object]
#: Trials by name: with a robot for threads, with an asyncio robot, and with a mobile robot.
TRIALS: dict[str, Trial] = {}
AWAITED: dict[str, Callable[[Bench], Awaitable[object]]] = {}
MOBILE: dict[str, Trial] = {}


def trial(function: Trial) -> Trial:
    """Register a trial with a robot for threads."""
    TRIALS[f"try {function.__name__}"] = function
    return function


def awaited(function: Callable[[Bench], Awaitable[object]]) -> Callable[[Bench], Awaitable[object]]:
    """Register a trial with a robot for asyncio."""
    AWAITED[f"try {function.__name__} in a task"] = function
    return function


def mobile(function: Trial) -> Trial:
    """Register a trial with a mobile robot."""
    MOBILE[f"try {function.__name__} of a mobile robot"] = function
    return function


async def ended(bench: Bench, call: Awaitable[Any]) -> tuple[Any, float]:
    """Await an awaitable; return its result or error, and the time."""
    try:
        made = await call
    except (LinkError, asyncio.TimeoutError) as error:
        made = error
    return made, bench.now


# These modules contain the trials, and need the names above.
from . import (  # noqa: E402
    trials_in_tasks,
    trials_of_commands,
    trials_of_mobiles,
    trials_of_motions,
    trials_of_streams,
)

MODULES = (trials_in_tasks, trials_of_commands, trials_of_mobiles, trials_of_motions, trials_of_streams)
