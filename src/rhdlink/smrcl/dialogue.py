"""Server side of a mission, which gets commands from clients instead of a file.

MRC receives such commands on its port.

Clients send lines of text with at most 255 characters. Some words are answered immediately (`eval`, `getevent`,
`beginplan`, ...). All other lines are commands, which are queued and executed in order. Events report the outcome of a
command. A client fetches events one by one with `getevent`, or receives them immediately as XML (``set "xmlon" 1``).

All clients share one queue, because there is one robot. Each client has its own ids, events, streams and output form
(text or XML). This module opens no socket: bytes come in through `Session.receive` and go out through `Session.take`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from .arithmetic import format_number, leading_number
from .effects import MissionEffects
from .motion.basic import Stop
from .plan import ERROR, FREE_LINE, Failure, MissionPlan, PlanLine, Run
from .recipients import Session

#: Maximum number of queued commands, and of plans, as in MRC.
MOST_COMMANDS, MOST_PLANS = 400, 10
#: Maximum number of lines of a plan. MRC has 100000 bytes for them.
MOST_PLAN_LINES = 5000
#: Maximum number of lines that are taken from a client in one cycle.
_MOST_LINES = 100
#: Maximum number of failures that are kept.
_MOST_FAILURES = 100


@dataclass
class _Queued:
    """Command that is queued or running."""

    session: Session
    number: int
    text: str


class ClientDialogue:
    """Program that executes commands from clients, with one step per cycle.

    Args:
        effects: Objects that commands use, and the interpreter that executes them.

    Attributes:
        sessions: Sessions of the clients.
        failures: Last 100 failures of commands, the newest last. Any thread may copy the list.
        queue: Queued commands.
        run: Program that is executed.
    """

    def __init__(self, effects: MissionEffects) -> None:
        self._effects = effects
        self._vehicle = effects.vehicle
        self._interpreter = effects.interpreter
        self._outbox = effects.output
        self._profile = effects.profile
        self.sessions: list[Session] = []
        self.failures: list[Failure] = []
        self.queue: deque[_Queued] = deque()
        self.run: Run | None = None
        self._plans: list[MissionPlan] = []
        self._current: _Queued | None = None
        # MRC keeps the result of the previous command, and an empty plan ends with it.
        self._result = 0.0
        self._cycles = -1
        self._is_ending = False

    # -- clients --------------------------------------------------------------------------------------

    def connect(self) -> Session:
        """Add a new client."""
        session = Session(self._outbox, self._vehicle.symbols.pool)
        self.sessions.append(session)
        return session

    def disconnect(self, session: Session) -> None:
        """Remove a client.

        In the sound profile its commands are flushed, and the robot stops if one of them was running.
        """
        session.is_closed = True
        if session not in self.sessions:
            return
        self.sessions.remove(session)
        if not self._profile.client_loss_stops:
            return
        self.queue = deque(each for each in self.queue if each.session is not session)
        if self._current is not None and self._current.session is session:
            self.run = self._current = None
            self._interpreter.skips = False
            self._vehicle.control.finish()

    def is_busy(self, session: Session) -> bool:
        """Whether a line or command of the client is queued or executed, or the client waits for an event."""
        commands = [each for each in (self._current, *self.queue) if each is not None]
        return session.backlog > 0 or session.is_waiting or any(each.session is session for each in commands)

    # -- cycles ---------------------------------------------------------------------------------------

    def step(self) -> bool:
        """Perform one cycle. Return whether the dialogue has ended."""
        self._cycles += 1
        time = self._interpreter.time
        for session in self.sessions:
            session.begin_cycle(self._cycles, time)
        is_over = self._is_ending
        if is_over:
            self.run = None
            self._vehicle.control.start(Stop())
        else:
            for session in list(self.sessions):
                self._take_lines(session)
            self._go_on()
        if self.run is None:
            vehicle = self._vehicle
            vehicle.variables.update(vehicle, vehicle.odometry.distance, self._cycles, time)
        for session in self.sessions:
            session.end_cycle()
        return is_over

    def fail(self, failure: Failure) -> None:
        """End the current command with an error. Queued commands are executed afterwards."""
        run, current = self.run, self._current
        if run is not None and current is not None:
            run.failure, run.result = failure, ERROR
            self._interpreter.skips = False
            self._finish(run, current)
        elif not self.failures or self.failures[-1] != failure:
            self.note(failure)

    def note(self, failure: Failure) -> None:
        """Add a failure, and forget the oldest ones."""
        self.failures.append(failure)
        del self.failures[:-_MOST_FAILURES]

    def tell(self, plain: str, xml: str) -> None:
        """Send an event about the robot to every client."""
        for session in self.sessions:
            session.event(plain, xml)

    def _take_lines(self, session: Session) -> None:
        for _ in range(_MOST_LINES):
            line = session.next_line()
            if line is None or session.is_closed:
                return
            self._take_line(session, line)

    def _take_line(self, session: Session, line: str) -> None:
        # The order matters, because only the beginning of the line is compared: `planet` is a line of a plan.
        if line.startswith("exit"):
            session.send("ok\n")
            if not self._profile.client_loss_stops:
                self._is_ending = True
            else:
                self.disconnect(session)
        elif line.startswith("logoff"):
            session.send("ok\n")
            self.disconnect(session)
        elif not line:
            pass
        elif line.startswith("beginplan"):
            self._begin_plan(session, line[9:])
        elif line.startswith("deleteplan"):
            self._delete_plan(line[10:])
            session.send("ok\n")
        elif line.startswith("endplan"):
            self._end_plan(session, line[7:])
        elif line.startswith("plan"):
            self._add_to_plan(session, line[4:])
        elif line.startswith("getevent"):
            session.ask_event(leading_number(line[8:]) or 0.0)
        elif line.startswith("eval"):
            session.send(self._evaluate(session, line))
        elif line.startswith("setvar"):
            # There is no answer, even if the line is wrong.
            self._effects.client = session
            self._interpreter.perform_aside(f"set   {line[6:]}")
        elif line.startswith("laserscan"):
            # The answer has 361 values of two bytes. Laser scanners are not supported, and MRC sends zeros without a
            # scanner.
            session.send("\0" * 722)
        elif line.startswith("flushcmds"):
            self._flush(session)
        elif self._effects.is_reading and self._current is not None and self._current.session is session:
            self._effects.take_input(line)
        else:
            self._enqueue(session, line)

    def _enqueue(self, session: Session, line: str) -> None:
        session.commands += 1
        if len(self.queue) >= MOST_COMMANDS:
            session.answer_command(session.commands, "refused")
            return
        self.queue.append(_Queued(session, session.commands, line))
        session.answer_command(session.commands, "queued")

    def _flush(self, session: Session) -> None:
        self.queue.clear()
        self.run = None
        self._interpreter.skips = False
        if self._profile.flush_stops:
            self._vehicle.control.finish()
        current = self._current
        session.answer_command(0 if current is None else current.number, "flushed")

    def _evaluate(self, session: Session, line: str) -> str:
        values = self._interpreter.evaluate(line)
        if values is None:
            return "syntaxerror\n"
        if not session.uses_xml:
            return "".join(f"{format_number(value)} " for value in values) + "\n"
        found = "<eval "
        # The names are cut out of the line. The first one begins after "eval $", and each other one two characters
        # after the end of the previous one.
        place = 6
        for value in values:
            end = line.find(";", place) if place <= len(line) else -1
            end = len(line) if end < 0 else end
            found += f'{line[place:end]}="{format_number(value)}" '
            place = end + 2
        return f"{found}/>\n"

    # -- plans ----------------------------------------------------------------------------------------

    def _begin_plan(self, session: Session, name: str) -> None:
        if len(self._plans) < MOST_PLANS:
            session.recorded = MissionPlan([], name)
            self._plans.append(session.recorded)
            self._outbox.message(f"beginplan {name}\n")
            session.send("ok\n")
        else:
            # MRC answers ok, and adds the lines to the previous plan.
            session.recorded = None
            session.send(f"error there are {MOST_PLANS} plans already\n")

    def _add_to_plan(self, session: Session, text: str) -> None:
        plan = session.recorded
        if plan is None or len(plan.lines) >= MOST_PLAN_LINES:
            session.send("error no plan has begun, or it is too long\n")
            return
        plan.append(PlanLine(text.lstrip(" \t"), len(plan.lines) + 1))
        self._outbox.message(f"plan {text}\n")
        session.send("ok\n")

    def _end_plan(self, session: Session, text: str) -> None:
        plan = session.recorded or MissionPlan([])
        self._outbox.message("\n" + "".join(f"{line.text}\0" for line in plan.lines) + f"endplan {text}\n")
        # MRC prints addresses; these numbers count from the beginning of the plan.
        size = sum(len(line.text) + 1 for line in plan.lines)
        self._outbox.message(f"start 0 end {size:x}  label 0 nlabels {len(plan.labels)}\n")
        session.send("ok\n")

    def _delete_plan(self, name: str) -> None:
        for plan in self._plans:
            if self._is_named(plan, name):
                self._plans.remove(plan)
                return

    def _is_named(self, plan: MissionPlan, name: str) -> bool:
        # In MRC, the blank before a name is part of the name.
        return plan.name == name or (self._profile.names_are_checked and plan.name.strip() == name.strip())

    # -- the queue ------------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Continue the current command, and begin others until one takes time."""
        left = MOST_COMMANDS
        while True:
            run, current = self.run, self._current
            if run is not None and current is not None:
                self._effects.client = current.session
                if not self._interpreter.step(run):
                    return
                self._finish(run, current)
            elif self.queue:
                self._begin(self.queue.popleft())
            left -= 1
            if self.run is not None or not self.queue or left < 0:
                return

    def _begin(self, queued: _Queued) -> None:
        self._current = queued
        self._effects.client = session = queued.session
        run = Run(self._plan(queued.text), self._result)
        if not self._interpreter.step(run):
            self.run = run
            session.command_event(queued.number, "started")
            return
        self._keep(run)
        if run.result == ERROR:
            session.command_event(queued.number, "syntaxerror")
        elif run.result == FREE_LINE:
            session.command_event(queued.number, "assignment")
        else:
            session.command_event(queued.number, "stopcond", run.result)

    def _finish(self, run: Run, current: _Queued) -> None:
        self.run = None
        self._keep(run)
        # A plan whose last line took no time ends without an event.
        if run.result != FREE_LINE:
            current.session.command_event(current.number, "stopcond", run.result)

    def _keep(self, run: Run) -> None:
        self._result = run.result
        if run.failure is not None:
            self.note(run.failure)

    def _plan(self, text: str) -> MissionPlan:
        if not text.startswith("runplan"):
            return MissionPlan([PlanLine(text, 1)])
        for plan in self._plans:
            if self._is_named(plan, text[7:]):
                return MissionPlan(plan.lines, plan.name)
        # As in MRC, execute a line of two blanks instead.
        return MissionPlan([PlanLine("  ", 1)])
