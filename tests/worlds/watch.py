"""What must be true of a world at every moment: the oracle.

The arm is looked at in each cycle. It may move only while somebody wants it to: from the moment at which a client asks
until the end has been reported to it, and for as long as an arm takes to brake. Where the error of a call states that
the arm may still move, it may, until the program on the controller is over.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from linkcore.simulated import Simulation
from urlink.simulator import Controller

__all__ = ["BRAKING", "Outcome", "Watch"]

#: rad/s above which the arm moves, and seconds in which it comes to rest after a stop.
MOVES, BRAKING = 0.01, 1.0
#: An error that admits that the arm may go on.
_ADMITS = re.compile(r"may still|may go on|to the end of")


@dataclass
class Outcome:
    """What a run has shown.

    Attributes:
        faults: what was not as it must be, in words; none in a good run.
        trace, steps: of the scheduler.
        moved: seconds for which the arm moved.
        simulated: seconds that passed.
        log: what was asked, what happened and what came of it, by its time.
    """

    faults: list[str] = field(default_factory=list)
    trace: int = 0
    steps: int = 0
    moved: float = 0.0
    simulated: float = 0.0
    log: list[str] = field(default_factory=list)


class Watch:
    """Looks at the arm in every cycle."""

    def __init__(self, sim: Simulation, controller: Controller, outcome: Outcome) -> None:
        self._sim = sim
        self._controller = controller
        self._outcome = outcome
        #: the clients that want the arm to move, and until when it may although none does
        self.wanting: set[int] = set()
        self._until = 0.0
        self._is_admitted = False
        self._is_reported = False
        self._q = np.array(controller.arm.setpoint.q)
        advance = controller._control.advance

        def observed() -> None:
            advance()
            self._look()

        controller._control.advance = observed  # type: ignore[method-assign]

    def note(self, text: str) -> None:
        self._outcome.log.append(f"{self._sim.now:10.6f} {text}")

    def fault(self, text: str) -> None:
        self.note(f"FAULT: {text}")
        self._outcome.faults.append(text)

    def begin(self, client: int) -> None:
        """A client asks for something."""
        self.wanting.add(client)

    def end(self, client: int, error: BaseException | None) -> None:
        """It has been told of the end, unless it is gone."""
        if client in self.wanting:
            self.wanting.discard(client)
            self._until = max(self._until, self._sim.now + BRAKING)
            if error is not None and _ADMITS.search(str(error)):
                self._is_admitted = True

    def gone(self, client: int) -> None:
        """A client is killed: what runs on the robot by itself may come to its end."""
        self.wanting.discard(client)
        self._is_admitted = True

    def _look(self) -> None:
        controller = self._controller
        setpoint = controller.arm.setpoint
        speed = float(np.max(np.abs(setpoint.qd)))
        q = np.array(setpoint.q)
        period = 1.0 / controller.firmware.rate
        if np.max(np.abs(q - self._q)) > 1.2 * period * 3.5:  # rad/s: above each joint's limit of 3.34
            self._once(f"a leap of {np.max(np.abs(q - self._q)):.4f} rad in one cycle")
        self._q = q
        if speed <= MOVES:
            if not controller.is_running_program:
                self._is_admitted = False
            return
        self._outcome.moved += period
        if not self.wanting and self._sim.now > self._until and not self._is_admitted:
            self._once(f"the arm moves at {speed:.3f} rad/s, and nobody wants it to: {controller.program_name}")

    def _once(self, text: str) -> None:
        if not self._is_reported:
            self._is_reported = True
            self.fault(text)
