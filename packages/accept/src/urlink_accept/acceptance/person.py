"""The person beside the arm, who does what no program can: turns a key, presses a button, pulls a cable."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Literal, Protocol

from urlink import RealtimeState
from urlink.simulator import Controller

from ..identification.exercise import input_is_on

Deed = Literal["local", "remote", "protective-stop", "unlock"]

#: What a person is asked to do.
DEEDS: Mapping[Deed, str] = {
    "local": "Switch the robot to local control at the pendant",
    "remote": "Switch the robot to remote control at the pendant",
    "protective-stop": "Cause a protective stop: hold the tool against its turning, or press the safeguard",
    "unlock": "Unlock the protective stop at the pendant, and take the hands away",
}


class Person(Protocol):
    """Does what is asked."""

    def does(self, deed: Deed) -> bool:
        """Ask for it, and wait until it is done; False if it is not."""

    def holds(self) -> bool:
        """The arm may move, where no digital input shows it."""


def is_held_by(person: Person, dead_man: int | None) -> Callable[[RealtimeState], bool]:
    """Whether the arm may move, by a state: the dead man's input is on, or the person holds it where that is None."""
    return input_is_on(dead_man) if dead_man is not None else lambda state: person.holds()


class Nobody:
    """Nobody is there."""

    def does(self, deed: Deed) -> bool:
        """Nothing is done."""
        return False

    def holds(self) -> bool:
        """Nothing may move."""
        return False


class AtTheTerminal:
    """Whoever reads the terminal."""

    def does(self, deed: Deed) -> bool:
        """Ask on stderr, and read a line: Enter says that it is done, anything else that it is not."""
        print(f"{DEEDS[deed]}, then press Enter (n: leave it out): ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip() == ""

    def holds(self) -> bool:
        """A terminal does not report that a key is held: a digital input has to."""
        return False


class OfTheSimulator:
    """Does it to a simulated controller."""

    def __init__(self, controller: Controller) -> None:
        self._deeds: dict[Deed, Callable[[], object]] = {
            "local": lambda: setattr(controller, "remote_control", False),
            "remote": lambda: setattr(controller, "remote_control", True),
            "protective-stop": controller.faults.protective_stop,
            "unlock": controller.faults.clear,
        }

    def does(self, deed: Deed) -> bool:
        """Do it at once."""
        self._deeds[deed]()
        return True

    def holds(self) -> bool:
        """All the time."""
        return True
