"""Oracle: conditions that must be true in a world at every moment.

The arm is checked in each cycle. It may move only while a client wants it to: from the request of the client until the
end was reported to it, and for the time that an arm needs to brake. If the error of a call states that the arm might
still move, it may do so until the program on the controller has ended.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from linkcore.simulated import Simulation
from urlink.simulator import Controller
from urlink.simulator.robot.sensors import Samples

from . import guarded, learned, waits
from .counted import Counted
from .observed import ADMITS, BRAKING, Observed, here
from .promises import Promises

__all__ = ["ADMITS", "BRAKING", "Outcome", "Watch"]

#: Joint speed above which the arm counts as moving, in rad/s.
MOVES = 0.01
#: Increase of speed in one cycle above which the arm starts to move, in rad/s: profiles of moves start with less.
BEGINS = 1e-5
#: Time between two cycles that shows a suspended controller, in s: without clients, a cycle is late by 0.1 s.
_SUSPENDED = 0.15
#: Programs with a separate owner: the program that is saved on the pendant, and programs of foreign clients.
_OWNED = ("pick", "foreign")


@dataclass
class Outcome:
    """Result of a run.

    Attributes:
        faults: Descriptions of faults; empty in a good run.
        trace, steps: Trace and number of steps of the scheduler.
        moved: Time for which the arm moved, in s.
        simulated: Simulated time, in s.
        places: See `Observed.places`.
        log: Requests, events and results, with their times.
    """

    faults: list[str] = field(default_factory=list)
    trace: int = 0
    steps: int = 0
    moved: float = 0.0
    simulated: float = 0.0
    places: set[tuple[tuple[str, str], tuple[str, str]]] = field(default_factory=set)
    log: list[str] = field(default_factory=list)


class Watch:
    """Check of the arm in every cycle.

    Args:
        sim, controller: Parts of the world.
        outcome: Result to write.
        is_quiet: Whether no stop can come, and the robot cannot disconnect.
        is_alone: Whether one client makes one request, and there are no events.

    Attributes:
        observed: Programs and handles of the world.
    """

    def __init__(
        self, sim: Simulation, controller: Controller, outcome: Outcome, *, is_quiet: bool, is_alone: bool
    ) -> None:
        self._is_quiet = is_quiet
        self._sim = sim
        self._controller = controller
        self._outcome = outcome
        self.observed = Observed(sim, controller, self._once)
        self._promises = Promises(sim, controller, self.observed, self._once, is_alone=is_alone)
        self._counted = Counted(controller.firmware.rate, self._once)
        #: Clients that want the arm to move; `_until` is the time until which it may move without one.
        self.wanting: set[int] = set()
        self._until = self._looked = 0.0
        self._is_admitted = False
        self._reported: set[str] = set()
        self._q: tuple[float, ...] = tuple(controller.arm.setpoint.q)
        self._qd: tuple[float, ...] = (0.0,) * 6
        self._time = 0.0
        #: Whether a person jogs the arm at the pendant.
        self.is_led = False
        #: Largest acceleration so far, in rad/s².
        self.accelerated = 0.0
        advance = controller._control.advance

        def observed() -> None:
            advance()
            self._look()

        controller._control.advance = observed  # type: ignore[method-assign]
        advance_many = controller._control.advance_many

        def many_at_rest(cycles: int) -> Samples | None:
            # Each cycle of a moving arm is checked. A test of the simulator compares cycles that are executed at once.
            return advance_many(cycles) if controller.arm.is_unchanging else None

        controller._control.advance_many = many_at_rest  # type: ignore[method-assign]

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Observe the library, too, while the block lasts."""
        with (
            self.observed.watching(),
            self._counted.watching(),
            self._promises.watching(),
            guarded.watching(self._once),
            learned.watching(self._once),
            waits.watching(self._once),
        ):
            yield
        self._outcome.places = self.observed.places

    def note(self, text: str) -> None:
        self._outcome.log.append(f"{self._sim.now:10.6f} {text}")

    def fault(self, text: str) -> None:
        self.note(f"FAULT: {text}")
        self._outcome.faults.append(text)

    def begin(self, client: int) -> None:
        """Record a request of a client."""
        self.wanting.add(client)

    def end(self, client: int, error: BaseException | None) -> None:
        """Record that the end was reported to a client, unless it no longer exists."""
        if client in self.wanting:
            self.wanting.discard(client)
            self._until = max(self._until, self._sim.now + BRAKING)
            if error is not None and ADMITS.search(str(error)):
                self._is_admitted = True

    def told(self, client: int, what: str, error: BaseException | None) -> None:
        """Record the reported result of a request of a client."""
        said = "well" if error is None else f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        self.note(f"client {client}: {what} ended: {said}")
        if self._is_quiet and type(error).__name__ in ("NotRunning", "SafetyStop"):
            self._once(f"{what} ended with {said}, in a world without events")

    def gone(self, client: int) -> None:
        """Record that a client was killed: programs that run on their own may continue to their end."""
        self.wanting.discard(client)
        self._is_admitted = True

    def resumes(self) -> None:
        """Record the end of a safeguard stop, after which the controller resumes its program automatically."""
        self.observed.played.append(self._sim.now)

    @property
    def is_at_rest(self) -> bool:
        """Whether no program is on the controller and the arm does not move."""
        return not self._controller.is_running_program and max(map(abs, self._qd)) <= MOVES

    def _look(self) -> None:
        controller, observed = self._controller, self.observed
        setpoint = controller.arm.setpoint
        missed = self._sim.now - self._looked
        if missed > _SUSPENDED and self._until > self._looked:
            self._until += missed  # the arm continues to brake when the controller resumes
        self._looked = self._sim.now
        q, qd = tuple(setpoint.q), tuple(setpoint.qd)
        if controller.program_name in _OWNED:
            self._until = self._sim.now + BRAKING
        speed, before = max(map(abs, qd)), max(map(abs, self._qd))
        period = 1.0 / controller.firmware.rate
        leap = _most(q, self._q)
        if leap > 1.2 * period * 3.5:  # rad/s: above each joint's limit of 3.34
            self._once(f"a leap of {leap:.4f} rad in one cycle")
        if speed > 3.5:
            self._once(f"a joint moves at {speed:.2f} rad/s")
        self.accelerated = max(self.accelerated, _most(qd, self._qd) / period)
        self._q, self._qd = q, qd
        self._note_stop()
        observed.count_rests()
        main = controller._runner.main
        sent = None if main is None else observed.programs.get(main.name)
        if speed > before + BEGINS and sent is not None and observed.waits(sent) and not self.is_led:
            self._once(f"{sent.wrapped.name} ({sent.life.name}) moves the arm without a permission from its client")
        if speed <= MOVES:
            if not controller.is_running_program:
                self._is_admitted = False
            return
        self._outcome.moved += period
        if not self.is_led:
            self._promises.look(speed)
        if sent is not None:
            why = observed.why_not(sent, is_faster=speed > before + 1e-3)
            if why is not None:
                self._once(f"the arm moves at {speed:.3f} rad/s by {sent.wrapped.name} ({sent.life.name}), {why}")
        elif (controller.program_name or "").startswith("urlink_stop_") and speed <= before + BEGINS:
            pass  # the stop of a client, which may have stopped an abandoned program
        elif not self.wanting and self._sim.now > self._until and not self._is_admitted:
            self._once(f"the arm moves at {speed:.3f} rad/s, but no client wants it to: {controller.program_name}")

    def _note_stop(self) -> None:
        controller, observed = self._controller, self.observed
        if controller.time < self._time:  # the controller was booted
            observed.stops.clear()
            closed = set(controller.ports.values()) - here().listeners.keys()
            if controller.is_up and closed:
                self._once(f"the controller is up after a boot, but its ports are closed: {sorted(closed)}")
        self._time = controller.time
        if controller.stopped_since is None:
            observed.stop_holds = False
            return
        observed.stops[round(controller.time * controller.firmware.rate)] = True
        if not observed.stop_holds:
            observed.stop_holds = True
            observed.stopped.append([self._sim.now, self._sim.now])
        observed.stopped[-1][1] = self._sim.now

    def _once(self, text: str) -> None:
        kind = re.sub(r"[\d.]+", "", text)[:40]
        if kind not in self._reported:
            self._reported.add(kind)
            self.fault(text)


def _most(values: tuple[float, ...], before: tuple[float, ...]) -> float:
    """Return the largest change among the six values. In most cycles, no value has changed."""
    return 0.0 if values == before else max(abs(a - b) for a, b in zip(values, before, strict=True))
