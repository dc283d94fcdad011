"""A run: the stages one after the other, each with consent, everything of them in a logbook."""

from __future__ import annotations

import importlib.metadata
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from linkcore import clock
from urlink import BadValue, LinkError, connect
from urlink.tools import RecordingAddress, SimulatorAddress, local_address, parse_address, simulated

from .listening import listen
from .logbook import Logbook
from .moving import move
from .person import Nobody, OfTheSimulator, Person, is_held_by
from .standing import stand
from .swings import swing

#: What each stage does, for the question whether it may.
STAGES: Mapping[int, str] = {
    0: "reads: connects to every interface, listens, and asks what changes nothing",
    1: "moves nothing: sets slider, TCP and payload and puts them back, runs programs that sleep",
    2: "MOVES wrist 3 by 3 degrees while the dead man's input is on; somebody stands at the emergency stop",
    3: "MOVES one joint after the other by 17 degrees to either side, each after it has asked you, for `identify`; "
    "the dead man's input is on, somebody stands at the emergency stop",
}

#: Seconds that each stage usually takes; stage 0 also listens.
_USUAL: Mapping[int, float] = {0: 1.0, 1: 10.0, 2: 56.0, 3: 62.0}


def run(
    address: str,
    path: Path,
    stages: Sequence[int],
    consent: Callable[[int, str], str],
    *,
    person: Person | None = None,
    dead_man: int | None = None,
    seconds: float = 10.0,
    timeout: float = 5.0,
    progress: Callable[[float, str], object] = lambda part, doing: None,
) -> tuple[str, ...]:
    """Run stages against a controller.

    Args:
        address: of a robot or of the simulator.
        path: of the logbook, a file that does not exist yet.
        stages: their numbers, in this order.
        consent: asked before each stage, and each joint of stage 3, with the stage's number and what it does; returns
            why it may not be run, or "".
        person: who does what no program can; None for nobody, and for a simulated arm one that does it at once.
        dead_man: number of the digital input that is on while the arm may move in stages 2 and 3.
        seconds: for which stage 0 listens.
        timeout: s, for a connection to be made.
        progress: Called at each step with the estimated fraction that is done, 0 to 1, and a description of the step.

    Returns:
        what in the logbook shows where this was: the addresses of both sides.

    Raises:
        BadAddress, BadValue: no such address, or one of a recording.
        BadRecording: the logbook exists, or cannot be written.
        RemoteError: the controller cannot be reached, or does not say who it is.
    """
    place = parse_address(address)
    if isinstance(place, RecordingAddress):
        raise BadValue(f"{address} is a recording; accept needs a controller that is running, or --replay and a bundle")
    controller = None
    if isinstance(place, SimulatorAddress):
        controller, place = simulated(place)
        person = person or OfTheSimulator(controller)
    try:
        with Logbook(path, place.ports, _Pace(stages, seconds, progress).noted) as book:
            _about(book)
            with connect(str(place), timeout=timeout) as robot:
                book.note("identity", said_so=robot.identity.said_so, **robot.identity.description())
                person = person or Nobody()
                begin: dict[int, Callable[[], None]] = {
                    0: partial(listen, robot, place, book, seconds),
                    1: partial(stand, robot, place, book, person),
                    2: partial(move, robot, book, person, dead_man, isinstance(person, OfTheSimulator)),
                    3: partial(swing, robot, book, is_held_by(person, dead_man), partial(consent, 3)),
                }
                ended = ""
                for number in stages:
                    refused = consent(number, STAGES[number]) or ended
                    ended = _run_stage(number, begin[number], refused, book) or ended
        return (place.host, local_address(place.host))
    finally:
        if controller is not None:
            controller.close()


class _Pace:
    """Reports the progress of stages, according to how long each of them usually takes."""

    def __init__(self, stages: Sequence[int], seconds: float, progress: Callable[[float, str], object]) -> None:
        self._left = list(stages)
        self._usual = {**_USUAL, 0: _USUAL[0] + seconds}
        self._all = sum(self._usual[number] for number in stages)
        self._progress = progress
        self._stage: int | None = None
        self._begun = 0.0

    def noted(self, step: str) -> None:
        """A step has begun; "stage" begins the next stage."""
        if step == "stage" and self._left:
            self._stage, self._begun = self._left.pop(0), clock.now()
        if self._stage is None:
            return
        usual = self._usual[self._stage]
        left = sum(self._usual[number] for number in self._left) + max(usual - clock.now() + self._begun, 0.0)
        self._progress(1.0 - left / self._all, f"stage {self._stage}" + ("" if step == "stage" else f": {step}"))


def _run_stage(number: int, begin: Callable[[], None], refused: str, book: Logbook) -> str:
    """Run a stage, unless it is refused; returns that it ended early, and why, or ""."""
    if refused:
        book.note("stage", number=number, refused=refused)
        return ""
    book.note("stage", number=number)
    try:
        begin()
    except LinkError as error:
        book.note("stage-ended", number=number, error=str(error))
        return f"stage {number} ended early: {error}"
    return ""


def _about(book: Logbook) -> None:
    try:
        version = importlib.metadata.version("urlink-robot")
    except importlib.metadata.PackageNotFoundError:
        version = "not installed"
    book.note(
        "about",
        wall=time.time(),
        urlink=version,
        python=platform.python_version(),
        numpy=np.__version__,
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
    )
