"""Main loop of a mission, with one cycle for each answer of the robot.

The loop needs no robot, clock or thread.

::

    controller = MissionController(conf, read, write, profile=MRC)
    controller.load(source)
    request = controller.first_request()
    while not controller.is_finished:
        raw = exchange(request)                # the robot's read variables, by name
        request = controller.step(raw)         # the variables to write next
    exchange(request)                          # the robot stops

The order within a cycle is the same as in MRC: sensors, odometry, script, motion control, watches, log. Values that are
written in a cycle affect the next answer of the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from .arithmetic import format_number
from .commands import COMMANDS
from .dialogue import ClientDialogue
from .effects import Hook, MissionEffects
from .expressions import LineFault
from .interpreter import MissionLimits, ScriptInterpreter
from .motion.topoint import NoWay
from .plan import Failure, MissionPlan, Run, Stage, split_lines
from .profile import SOUND, Profile
from .recipients import Outbox, Said
from .robot_conf import RobotConf
from .vehicle import Vehicle

#: Number of warm-up cycles, as in MRC.
_WARM_UP = 20


class CycleProgram(Protocol):
    """Program of a controller: a script, or a dialogue with clients."""

    @property
    def run(self) -> Run | None:
        """Plan that is executed."""

    def step(self) -> bool:
        """Perform one cycle. Return whether the program has ended."""


@dataclass
class PlanProgram:
    """Program that executes one plan once.

    Attributes:
        interpreter: Interpreter that executes the lines of the plan.
        run: Execution of the plan.
    """

    interpreter: ScriptInterpreter
    run: Run

    def step(self) -> bool:
        """Perform one cycle. Return whether the script has ended."""
        return self.interpreter.step(self.run)


class MissionController:
    """Controller that executes a mission cycle by cycle.

    Args:
        conf: Description of the robot.
        read: Length of each of the robot's read variables, by name.
        write: Values of the robot's write variables, by name.
        profile: Profile of the mission, like MRC or sound.
        functions: Additional functions for expressions.
        hooks: Functions for commands that need hardware.
        limits: Limits of the mission.
        warm_up: Number of cycles before the first line, in which the filters of the sensors settle.

    Attributes:
        vehicle: The robot.
        interpreter: Interpreter that executes lines.
        effects: Objects that commands use.
        failure: Failure that ended the mission early; None if there was none.
        is_finished: Whether the mission has ended. The last result of `step` then stops the robot.
        cycle: Number of the cycle, counted from 0. It is -2 before the first answer of the robot, and -1 between this
            answer and the first cycle.
    """

    def __init__(
        self,
        conf: RobotConf,
        read: Mapping[str, int],
        write: Mapping[str, Sequence[int]],
        *,
        profile: Profile = SOUND,
        functions: Mapping[str, Callable[..., float]] | None = None,
        hooks: Mapping[str, Hook] | None = None,
        limits: MissionLimits | None = None,
        warm_up: int = _WARM_UP,
    ) -> None:
        self._warm_up = warm_up
        self.vehicle = Vehicle(conf, read, write, profile)
        self._outbox = Outbox()
        if not profile.says_why:
            self.vehicle.control.report = self._outbox.message
        self.interpreter = ScriptInterpreter(
            self.vehicle, self._outbox, COMMANDS, functions or {}, limits or MissionLimits()
        )
        self.effects = MissionEffects(self.interpreter, hooks or {})
        self.interpreter.perform = self.effects.perform
        self._profile = profile
        self._program: CycleProgram | None = None
        self.failure: Failure | None = None
        self.is_finished = False
        self.cycle = -2
        self._was_blocked = False

    # -- the program ------------------------------------------------------------------------------------

    def load(self, source: str) -> None:
        """Execute a script."""
        plan = MissionPlan(split_lines(source, cuts=not self._profile.checks_first))
        self._program = PlanProgram(self.interpreter, Run(plan))

    def serve(self) -> ClientDialogue:
        """Execute commands from clients.

        In MRC's profile, `exit` ends the whole dialogue; otherwise it ends only the client that sent it.
        """
        self._program = dialogue = ClientDialogue(self.effects)
        return dialogue

    def execute(self, program: CycleProgram) -> None:
        """Execute another program."""
        self._program = program

    @property
    def run(self) -> Run | None:
        """Plan that is executed."""
        return None if self._program is None else self._program.run

    def take_said(self) -> list[Said]:
        """Remove and return the output of the mission since the last call."""
        return self._outbox.take()

    # -- cycles -----------------------------------------------------------------------------------------

    def first_request(self) -> dict[str, list[int]]:
        """Return the variables to write before the first answer of the robot."""
        self.vehicle.outputs.reset_motors()
        return self.vehicle.outputs.take_changed()

    def step(self, raw: Mapping[str, Sequence[int]], time: float = 0.0) -> dict[str, list[int]]:
        """Perform one cycle.

        Args:
            raw: Read variables of the robot.
            time: Value of ``$time``, in s.

        Returns:
            Variables to write next, by name.
        """
        vehicle = self.vehicle
        self.cycle += 1
        if self.cycle < 0:
            vehicle.begin(raw)
            return {}
        self.interpreter.time = time
        is_over = False
        try:
            vehicle.sense(raw)
        except (ArithmeticError, ValueError) as error:
            self._fail(f"the robot's sensor values cannot be used: {error}")
        if self.cycle > self._warm_up:
            is_over = self._program is None or self._program.step()
            if isinstance(self._program, PlanProgram) and self._program.run.failure is not None:
                self.failure = self._program.run.failure
        written = vehicle.stand() if self.is_held else self._act()
        self._supervise()
        self.effects.log.update()
        if vehicle.functions.stop:
            if not isinstance(self._program, ClientDialogue) or not self._profile.client_loss_stops:
                is_over = True
            elif self._program.run is not None:
                self._fail("the input stop of mrccontrol is not 0")
            written.update(vehicle.stand())
        if is_over or self.failure is not None:
            self.is_finished = True
            written.update(vehicle.stand())
        return written

    @property
    def is_held(self) -> bool:
        """Whether the mission is held at a breakpoint."""
        run = self.run
        return run is not None and run.stage is Stage.HOLD

    def _act(self) -> dict[str, list[int]]:
        try:
            return self.vehicle.act()
        except NoWay as error:
            self._fail(str(error))
        except (ArithmeticError, ValueError) as error:
            self._fail(f"the motion cannot be computed: {error}")
        return self.vehicle.stand()

    def _fail(self, reason: str) -> None:
        """End the script, or the current command of a dialogue, and stop the robot."""
        self.vehicle.control.rest()
        failure = self.interpreter.failure(self.run, reason)
        if isinstance(self._program, ClientDialogue):
            self._program.fail(failure)
        else:
            self.failure = failure

    def _supervise(self) -> None:
        """Report changes of the motion-control status, and update the watches."""
        is_blocked = self.vehicle.control.is_blocked
        if is_blocked != self._was_blocked:
            self._was_blocked = is_blocked
            self._tell("motioncontrol status changed\n", '<motioncontrol status="changed" />\n')
        for watch in tuple(self.effects.watches):
            try:
                has_risen = watch.update(self.interpreter)
            except LineFault as fault:
                self.effects.watches.remove(watch)
                self._fail(f'watch "{watch.name}": {fault}')
                return
            if has_risen:
                time = format_number(self.interpreter.time)
                self._tell(f"watch {watch.name} fired {time} \n", f'<watch name="{watch.name}" time="{time}" /> \n')

    def _tell(self, plain: str, xml: str) -> None:
        if isinstance(self._program, ClientDialogue):
            self._program.tell(plain, xml)
        else:
            self._outbox.event(plain.strip())
