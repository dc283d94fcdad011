"""Run of the test. The stages run one after the other, each only with consent, and are recorded in a logbook."""

from __future__ import annotations

import importlib.metadata
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from linkcore import clock
from urlink import BadValue, LinkError, Robot, connect
from urlink.tools import RecordingAddress, SimulatorAddress, local_address, parse_address, simulated

from .causes import refuted_positions
from .evidence import Evidence, Note
from .listening import listen
from .logbook import Logbook
from .moving import move
from .person import Nobody, OfTheSimulator, Person, is_held_by
from .report import judge
from .requirements import requirements
from .standing import stand
from .swings import swing

#: Description of the action of each stage, used to ask for consent.
STAGES: Mapping[int, str] = {
    0: "only reads: connects to every interface, listens, and sends queries that change nothing",
    1: "moves nothing: sets slider, TCP and payload and restores them, runs programs that sleep",
    2: "MOVES wrist 3 by 3 degrees while the dead-man switch is held; a person must stand at the emergency stop",
    3: "MOVES one joint after the other by 17 degrees to either side, each after your consent, for `identify`; "
    "the dead-man switch must be held, and a person must stand at the emergency stop",
}

#: Usual duration of each stage, in s. The time to listen is added to stage 0.
_USUAL: Mapping[int, float] = {0: 1.0, 1: 38.0, 2: 56.0, 3: 62.0}


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
    reverse_host: str | None = None,
    reverse_peer: str | None = None,
    progress: Callable[[float, str], object] = lambda part, doing: None,
) -> tuple[str, ...]:
    """Run stages against a controller.

    Args:
        address: Address of a robot or of the simulator.
        path: Path of the logbook, a file that does not exist yet.
        stages: Numbers of the stages, in this order.
        consent: Function that is called before each stage, and before each joint of stage 3, with the number of the
            stage and its action. The function returns the reason why the stage may not run, or "".
        person: Person for actions that no program can do. If None, no person is present; for a simulated arm, a
            stand-in acts immediately.
        dead_man: Number of the digital input that is on while the arm may move in stages 2 and 3.
        seconds: Time to listen in stage 0, in s.
        timeout: Maximum time to connect, in s.
        reverse_host: Address of this computer as seen by the robot; see `urlink.connect`.
        reverse_peer: Source address of the robot's connections; see `urlink.connect`.
        progress: Function that is called at each step with the estimated completed fraction, 0 to 1, and a description
            of the step.

    Returns:
        Texts in the logbook that reveal the place of the test: the addresses of the robot and of this computer.

    Raises:
        BadAddress: If the address is invalid.
        BadValue: If the address is a recording.
        BadRecording: If the logbook exists, or cannot be written.
        RemoteError: If the controller cannot be reached, or does not report its identity.
    """
    place = parse_address(address)
    if isinstance(place, RecordingAddress):
        raise BadValue(f"{address} is a recording; expected the address of a controller, or --replay with a bundle")
    controller = None
    if isinstance(place, SimulatorAddress):
        controller, place = simulated(place)
        person = person or OfTheSimulator(controller)
    try:
        with Logbook(path, place.ports, _Pace(stages, seconds, progress).noted) as book:
            _about(book, address, controller is not None or _is_loopback(place.host))
            with connect(str(place), timeout=timeout, reverse_host=reverse_host, reverse_peer=reverse_peer) as robot:
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
                    # The guard uses the positions to decide when to stop the arm, so nothing may move if they are
                    # wrong.
                    wrong = _wrong_positions(robot, path) if number >= _MOVES else ""
                    refused = wrong or consent(number, STAGES[number]) or ended
                    ended = _run_stage(number, begin[number], refused, book) or ended
        return (place.host, local_address(place.host))
    finally:
        if controller is not None:
            controller.close()


#: First stage that moves the arm, and time in s to listen to its positions if stage 0 was not requested.
_MOVES, _LISTENED = 2, 3.0


def _wrong_positions(robot: Robot, path: Path) -> str:
    """Return the reason why the joint positions are wrong, according to the evidence so far; "" if there is none."""
    robot.realtime.wait(5.0)
    evidence = Evidence(path)
    if not evidence.said("stage"):
        # Stage 0 was not requested, so listen now.
        clock.sleep(_LISTENED)
        evidence = Evidence(path)
        evidence.notes.append(Note(0.0, "stage", {"number": 0}))
    positions = {name: each for name, each in requirements().items() if each.stage == 0}
    why = refuted_positions(judge(evidence, positions))
    return f"the joint positions cannot be trusted, because {why}" if why else ""


class _Pace:
    """Progress of the stages, estimated from their usual durations."""

    def __init__(self, stages: Sequence[int], seconds: float, progress: Callable[[float, str], object]) -> None:
        self._left = list(stages)
        self._usual = {**_USUAL, 0: _USUAL[0] + seconds}
        self._all = sum(self._usual[number] for number in stages)
        self._progress = progress
        self._stage: int | None = None
        self._begun = 0.0

    def noted(self, step: str) -> None:
        """Process the beginning of a step. The step "stage" begins the next stage."""
        if step == "stage" and self._left:
            self._stage, self._begun = self._left.pop(0), clock.now()
        if self._stage is None:
            return
        usual = self._usual[self._stage]
        left = sum(self._usual[number] for number in self._left) + max(usual - clock.now() + self._begun, 0.0)
        self._progress(1.0 - left / self._all, f"stage {self._stage}" + ("" if step == "stage" else f": {step}"))


def _run_stage(number: int, begin: Callable[[], None], refused: str, book: Logbook) -> str:
    """Run a stage unless it is refused. Return a message with the reason if it ends early, otherwise ""."""
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


def _is_loopback(host: str) -> bool:
    """Return whether a host is this computer. A controller on this computer is a simulator."""
    return host == "localhost" or host == "::1" or host.startswith("127.")


def _about(book: Logbook, address: str, is_simulated: bool) -> None:
    try:
        version = importlib.metadata.version("urlink-robot")
    except importlib.metadata.PackageNotFoundError:
        version = "not installed"
    book.note(
        "about",
        wall=time.time(),
        address=address,
        simulated=is_simulated,
        urlink=version,
        python=platform.python_version(),
        numpy=np.__version__,
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
    )
