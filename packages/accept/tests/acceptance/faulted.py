"""Stage 2 again and again while things go wrong, in simulated time: how far does any joint leave its start?

The controller is on a computer of its own. Once in a while, at moments that the seed draws, something happens to it, to
the cable, to the computer of the stage, or to the key that the person holds. When that ends the stage, somebody mends
what is broken, and the stage begins anew, with its steps in another order: so each of them is met by faults.
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
#: s between two faults, in the mean; between two looks at the arm; after a stage for what was sent, and after mending.
BETWEEN, LOOK, AFTER, MENDED = 0.5, 0.02, 0.3, 0.1
#: s that a reboot takes, and until when the arm has to run again.
_DOWN, _RUNS = 0.3, 10.0
#: Faults that end the stage nearly always: half as often as the others, so that some stages come to their later steps.
_ENDS = (
    "protective stop",
    "safeguard stop",
    "emergency stop",
    "power off",
    "reboot",
    "connections reset",
    "key let go of",
)


@dataclass
class Ran:
    """What came of a run.

    Attributes:
        happened: name of a fault -> how often it happened while the stage was under way, and changed something.
        stages: how often the stage began.
        steps: name of a step -> how often it was begun.
        away: rad by which any joint has left where it stood when the steps of a stage began, at most. A program of the
            stage before may go on until then, such as one that a safeguard stop had paused.
    """

    happened: Counter[str] = field(default_factory=Counter)
    stages: int = 0
    steps: Counter[str] = field(default_factory=Counter)
    away: float = 0.0


class _Person(OfTheSimulator):
    """Holds the key until it slips."""

    is_held = True

    def holds(self) -> bool:
        return self.is_held


@dataclass
class _Cell:
    """What things happen to."""

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
        """The cable is out for a while."""
        network, here = self.simulation.network, self.simulation.here
        robot = network.computers["robot"]
        network.cut(here, robot)
        time.sleep(self.draw.uniform(0.1, 1.5))
        network.mend(here, robot)

    def freeze(self) -> None:
        """The program of the stage is frozen for a while."""
        self.simulation.here.suspend()
        time.sleep(self.draw.uniform(0.1, 2.0))
        self.simulation.here.resume()

    def slide(self, fraction: float) -> Callable[[], None]:
        return lambda: setattr(self.controller, "speed_fraction", fraction)

    def faults(self) -> Mapping[str, tuple[bool, Callable[[], object]]]:
        """Name of a fault -> whether it would change something now, and what makes it happen."""
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
            "key let go of": (self.person.is_held, lambda: setattr(self.person, "is_held", False)),
        }

    def mend(self) -> None:
        """What is broken, by somebody who stands there."""
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
    """Run stage 2; what ended it early, or nothing."""
    with Logbook(path, controller.ports) as book:
        try:
            with urlink.connect(controller.address) as robot:
                moving.move(robot, book, person, dead_man, is_simulated_here=True)
        except urlink.LinkError as error:
            return str(error)
    return ""


def faulted(seed: int, seconds: float, folder: Path) -> Ran:
    """Run stage 2 for so many seconds of simulated time, most often on a CB3, which has fewer cycles.

    Args:
        seed: of everything.
        seconds: after which no stage begins.
        folder: for logbooks, which are not kept.
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
