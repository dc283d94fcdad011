"""Repeat stage 2 while faults happen, in simulated time, and measure how far any joint leaves its start.

The controller is on a separate computer. At times that the seed determines, a fault happens to the controller, the
cable, the computer of the stage, or the key that the person holds. When a fault ends the stage, everything is repaired,
and the stage starts again with its steps in another order. So faults happen in each of the steps.
"""

from __future__ import annotations

import contextlib
import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

import numpy as np

import urlink
from linkcore.simulated.takeover import Simulation
from urlink.simulator import Controller
from urlink.simulator.robot.modes import Power, StopState
from urlink_accept.acceptance import moving
from urlink_accept.acceptance.logbook import Logbook
from urlink_accept.acceptance.person import OfTheSimulator
from urlink_accept.acceptance.standing import Told, try_each

__all__ = ["Ran", "faulted", "tried"]

HOST = "192.168.0.100"
#: Mean time between two faults; interval for checking the arm; wait after a stage for sent data, and after repair; in
#: s.
BETWEEN, LOOK, AFTER, MENDED = 0.5, 0.02, 0.3, 0.1
#: Duration of a reboot, and maximum time until the arm runs again, in s.
_DOWN, _RUNS = 0.3, 10.0
#: Faults that almost always end the stage. They are half as frequent as the others, so that later steps are reached
#: too.
_ENDS = (
    "protective stop",
    "safeguard stop",
    "emergency stop",
    "power off",
    "reboot",
    "connections reset",
    "key released",
)


@dataclass
class Ran:
    """Result of a run.

    Attributes:
        happened: Number of times, by fault, that a fault happened during the stage and changed the state.
        stages: Number of times that the stage started.
        steps: Number of times, by step, that a step started.
        away: Largest distance of any joint from its position when the steps of a stage started, in rad. A program of
            the previous stage may continue until then, for example after a safeguard stop has paused it.
    """

    happened: Counter[str] = field(default_factory=Counter)
    stages: int = 0
    steps: Counter[str] = field(default_factory=Counter)
    away: float = 0.0


class _Person(OfTheSimulator):
    """Person who holds the key until it is released."""

    is_held = True

    def holds(self) -> bool:
        return self.is_held


@dataclass
class _Cell:
    """Controller, network and person to which faults happen."""

    simulation: Simulation
    controller: Controller
    person: _Person
    draw: random.Random

    @property
    def stop(self) -> StopState:
        return self.controller.modes.stop

    @property
    def power(self) -> Power:
        return self.controller.modes.power

    def unplug(self) -> None:
        """Unplug the cable for a while."""
        network, here = self.simulation.network, self.simulation.here
        robot = network.computers["robot"]
        network.cut(here, robot)
        time.sleep(self.draw.uniform(0.1, 1.5))
        network.mend(here, robot)

    def freeze(self) -> None:
        """Freeze the program of the stage for a while."""
        self.simulation.here.suspend()
        time.sleep(self.draw.uniform(0.1, 2.0))
        self.simulation.here.resume()

    def slide(self, fraction: float) -> Callable[[], None]:
        return lambda: setattr(self.controller, "speed_fraction", fraction)

    def faults(self) -> Mapping[str, tuple[bool, Callable[[], object]]]:
        """Return whether each fault would change something now, and the function that causes it."""
        controller, do = self.controller, self.controller.faults
        is_up, may_move = controller.is_up, controller.modes.may_move
        return {
            "protective stop": (may_move, do.protective_stop),
            "safeguard stop that resumes": (may_move, do.safeguard_stop),
            "safeguard stop": (may_move, lambda: do.safeguard_stop(resumes=False)),
            "emergency stop": (self.stop is not StopState.EMERGENCY, do.emergency_stop),
            "unlocked": (self.stop is not StopState.NONE, do.clear),
            "power off": (self.power is not Power.OFF, do.power_off),
            "power on": (self.power in (Power.OFF, Power.IDLE) and self.stop is not StopState.EMERGENCY, do.power_on),
            "reboot": (is_up, lambda: do.reboot(downtime=_DOWN)),
            "connections reset": (is_up, do.cut),
            "realtime reset": (is_up, lambda: do.cut("realtime")),
            "primary reset": (is_up, lambda: do.cut("primary")),
            "silent 0.3 s": (is_up, lambda: do.stall(0.3)),
            "silent 1.5 s": (is_up, lambda: do.stall(1.5)),
            "garbage": (is_up, lambda: do.garbage(64)),
            "garbage in a packet": (is_up, lambda: do.garbage(64, inside=True)),
            "slider 100 %": (controller.speed_fraction != 1.0, self.slide(1.0)),
            "slider 0": (controller.speed_fraction != 0.0, self.slide(0.0)),
            "local control": (
                controller.firmware.is_e_series and controller.remote_control,
                lambda: setattr(controller, "remote_control", False),
            ),
            "cable out": (True, self.unplug),
            "program frozen": (True, self.freeze),
            "key released": (self.person.is_held, lambda: setattr(self.person, "is_held", False)),
        }

    def mend(self) -> None:
        """Repair everything, as a person at the robot would."""
        controller = self.controller
        controller.faults.heal()
        controller.remote_control, controller.speed_fraction, self.person.is_held = True, 1.0, True
        until = time.monotonic() + _RUNS
        while not (controller.is_up and controller.modes.may_move):
            assert time.monotonic() < until, "the arm does not run again"
            if controller.is_up:
                controller.faults.clear()
                controller.faults.power_on()
            time.sleep(0.1)


def tried(controller: Controller, path: Path, person: OfTheSimulator, dead_man: int | None = None) -> str:
    """Run stage 2, and return the error that ended it early, or an empty text."""
    with Logbook(path, controller.ports) as book:
        try:
            with urlink.connect(controller.address) as robot:
                moving.move(robot, book, person, dead_man, is_simulated_here=True)
        except urlink.LinkError as error:
            return str(error)
    return ""


def faulted(seed: int, seconds: float, folder: Path) -> Ran:
    """Run stage 2 for some seconds of simulated time, mostly on a CB3, which has fewer cycles.

    Args:
        seed: Seed of all random choices.
        seconds: Time after which no further stage starts, in s.
        folder: Folder for logbooks, which are deleted.
    """
    draw = random.Random(seed)
    model, firmware = ("UR5e", draw.choice(("5.11", "5.25", "10.12"))) if seed % 10 == 9 else ("UR5", "3.15")
    ran, start = Ran(), np.zeros(6)

    def in_another_order(book: Logbook, steps: Mapping[str, Callable[[], Told]], between: Callable[[], object]) -> None:
        nonlocal start
        start = np.array(controller.arm.sample.q_target)
        names = draw.sample(sorted(steps), len(steps))
        begun = {name: (lambda name=name: (ran.steps.update([name]), steps[name]())[1]) for name in names}
        try_each(book, begun, between)

    with urlink.simulated_time(seed=seed, limit=1e6) as simulation, contextlib.ExitStack() as until:
        robot = simulation.computer("robot", HOST)
        with simulation.on(robot):
            controller = Controller(model, firmware, host=HOST, seed=seed).start()
            until.callback(lambda: closed(simulation, controller))
        cell = _Cell(simulation, controller, _Person(controller), draw)
        start = np.array(controller.arm.sample.q_target)
        is_under_way, is_over = threading.Event(), threading.Event()

        def look() -> None:
            ran.away = max(ran.away, float(np.abs(np.array(controller.arm.sample.q_target) - start).max()))
            simulation.at(simulation.now + LOOK, look)

        def happen() -> None:
            while not is_over.wait(draw.expovariate(1.0 / BETWEEN)):
                if is_under_way.is_set():
                    can = {name: do for name, (changes, do) in cell.faults().items() if changes}
                    (name,) = draw.choices(sorted(can), [1 if name in _ENDS else 2 for name in sorted(can)])
                    ran.happened[name] += 1
                    can[name]()

        with simulation.on(robot):
            thread = threading.Thread(target=happen, daemon=True)
            thread.start()
        look()
        until.enter_context(patch("urlink_accept.acceptance.moving.try_each", in_another_order))
        began = time.monotonic()
        while time.monotonic() < began + seconds:
            cell.mend()
            time.sleep(MENDED)
            ran.stages += 1
            is_under_way.set()
            tried(controller, folder / "run.urlog", cell.person)
            is_under_way.clear()
            time.sleep(AFTER)
            (folder / "run.urlog").unlink(missing_ok=True)
        is_over.set()
        thread.join()
    return ran


def closed(simulation: Simulation, controller: Controller) -> None:
    with simulation.on(simulation.network.computers["robot"]):
        controller.close()
