"""Person next to the arm, for actions that no program can do: turn a key, press a button, pull a cable."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Literal, Protocol

from linkcore import clock
from urlink import RealtimeState
from urlink.simulator import Controller
from urlink.tools import GRAVITY

from ..identification.exercise import input_is_on

Deed = Literal[
    "local",
    "remote",
    "protective-stop",
    "unlock",
    "outputs",
    "inputs",
    "press",
    "weight",
    "no-weight",
    "stop-at-rest",
    "power-off",
]

#: Mass that the person hangs on the tool, in kg.
WEIGHT = 2.0

#: Requests to the person.
DEEDS: Mapping[Deed, str] = {
    "local": "Switch the robot to local control at the pendant",
    "remote": "Switch the robot to remote control at the pendant",
    "protective-stop": "Cause a protective stop: hold the tool against its rotation, or press the safeguard",
    "unlock": "Unlock the protective stop at the pendant, and take your hands away",
    "outputs": "Make sure that every standard digital output may switch on for half a second",
    "inputs": "Prepare to switch each standard digital input, 0 to 7, on and off again, one after the other",
    "press": "Switch the next digital input on and off again",
    "weight": f"Hang a weight of {WEIGHT:g} kg on the tool, or push it straight down with {WEIGHT * 10:.0f} N",
    "no-weight": "Take the weight off the tool",
    "stop-at-rest": "Cause a protective stop or a safeguard stop while the arm is at rest",
    "power-off": "Make sure that the arm may be powered off and on again; its brakes move it a little",
}


class Person(Protocol):
    """Person who performs the requested actions."""

    def does(self, deed: Deed) -> bool:
        """Request an action, and wait for the person. Return whether the person has done the action."""

    def holds(self) -> bool:
        """Return whether the person holds the dead-man switch, if no digital input shows this."""


def is_held_by(person: Person, dead_man: int | None) -> Callable[[RealtimeState], bool]:
    """Return a function that takes a state, and returns whether the dead-man switch is held.

    The digital input `dead_man` shows this. If `dead_man` is None, the person reports it.
    """
    return input_is_on(dead_man) if dead_man is not None else lambda state: person.holds()


class Nobody:
    """Stand-in for a person, if no person is present."""

    def does(self, deed: Deed) -> bool:
        """Return False, because nothing is done."""
        return False

    def holds(self) -> bool:
        """Return False, because nothing may move."""
        return False


class AtTheTerminal:
    """Person at the terminal."""

    def does(self, deed: Deed) -> bool:
        """Ask on stderr, and read a line. Enter means done, any other line means not done."""
        print(f"{DEEDS[deed]}, then press Enter (n: skip it): ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip() == ""

    def holds(self) -> bool:
        """Return False, because a terminal does not report that a key is held. A digital input is needed for this."""
        return False


class OfTheSimulator:
    """Stand-in for a person, which acts on a simulated controller."""

    def __init__(self, controller: Controller) -> None:
        self._deeds: dict[Deed, Callable[[], object]] = {
            "local": lambda: setattr(controller, "remote_control", False),
            "remote": lambda: setattr(controller, "remote_control", True),
            "protective-stop": controller.faults.protective_stop,
            "unlock": controller.faults.clear,
            "stop-at-rest": controller.faults.protective_stop,
            "weight": lambda: controller.push((0.0, 0.0, -GRAVITY * WEIGHT, 0.0, 0.0, 0.0)),
            "no-weight": lambda: controller.push((0.0,) * 6),
            "press": self._press,
        }
        self._controller = controller
        self._pressed = 0

    def does(self, deed: Deed) -> bool:
        """Do the action immediately, and return True."""
        if deed in self._deeds:
            self._deeds[deed]()
        return True

    def holds(self) -> bool:
        """Return True, because the simulated person always holds the switch."""
        return True

    def _press(self) -> None:
        for on in (True, False):
            self._controller.signals.set_digital_input(self._pressed % 8, on)
            clock.sleep(0.3)
        self._pressed += 1
