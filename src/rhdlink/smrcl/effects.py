"""Objects that commands use, and the commands that do not move the robot.

These are the commands for flow, log, events, texts and special hardware.

A command is a function. It takes `MissionEffects` and the command's parameters, sets the default end of its line, and
returns whether the line takes time. `commands` has the table of all commands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from linkcore.errors import BadValue

from .arithmetic import format_number, truncate
from .expressions import LineFault, Value
from .interpreter import ScriptInterpreter, never
from .motion.control import ControlledMotion
from .plan import Outcome, Run
from .recipients import Recipient
from .symbols import DataLog, split_index

if TYPE_CHECKING:
    from .commands import ScriptCommand

#: Function that executes a command that needs hardware. It is called with the parameters, and can return system
#: variables by name. The function for `read` returns a text.
Hook = Callable[..., Mapping[str, float] | str | None]

#: Maximum length of the text buffer, in characters.
_BUFFER = 255
#: Maximum number of watches in the sound profile; MRC has two.
_MOST_WATCHES = 100


class Watch:
    """Condition that is tested in every cycle. An event is sent when it becomes true."""

    def __init__(self, name: str, conditions: Sequence[Value]) -> None:
        self.name = name
        self._conditions = conditions
        self._value = 0.0

    def update(self, interpreter: ScriptInterpreter) -> bool:
        """Test the condition. Return whether its value has risen in this cycle.

        Raises:
            LineFault: If the condition cannot be computed.
        """
        value = interpreter.watch(self._conditions)
        has_risen = value > self._value
        self._value = value
        return has_risen


def always() -> bool:
    """Return True: default end of a command that is done immediately."""
    return True


class MissionEffects:
    """Objects that commands use.

    Args:
        interpreter: Interpreter that executes the lines.
        hooks: Functions for commands that need hardware, by the name of the command.

    Attributes:
        interpreter, hooks: The arguments.
        vehicle: Robot that moves.
        output: Receiver of the output that MRC prints.
        client: Receiver of texts, events, streams and logs.
        profile: Profile of the mission, like MRC or sound.
        symbols: Variables of the mission.
        command: Current command, or the last one.
        run: Plan to which the command belongs.
        conditions: Stop conditions of the command.
        log: Log of the variables.
        watches: Active watches.
        text_buffer: Text that `stringcat` has made.
        is_reading: Whether `read` waits for a line from its client.
        side_is_left: Whether `followwall` follows a wall on the left.
        signal: Parameters of `funcgen`.
        routine_result: Value that `resetmotors` prints, which is the x coordinate at its previous execution.
    """

    def __init__(self, interpreter: ScriptInterpreter, hooks: Mapping[str, Hook]) -> None:
        self.interpreter = interpreter
        self.hooks = hooks
        self.vehicle = interpreter.vehicle
        self.output = interpreter.output
        self.client: Recipient = interpreter.output
        self.profile = interpreter.profile
        self.symbols = interpreter.symbols
        self.command: ScriptCommand
        self.run: Run
        self.conditions: Sequence[Value] = ()
        self.log = DataLog(interpreter.symbols.pool)
        self.watches: list[Watch] = []
        self.text_buffer = ""
        self.is_reading = False
        self.side_is_left = True
        self.signal = [0.0] * 5
        self.routine_result = 0.0

    def perform(
        self, command: ScriptCommand, parameters: Sequence[float | str], run: Run, conditions: Sequence[Value]
    ) -> Outcome:
        """Execute a command.

        Raises:
            LineFault: If the command cannot be executed.
        """
        self.command, self.run, self.conditions = command, run, conditions
        return command.execute(self, *parameters)

    # -- when the next line begins ----------------------------------------------------------------------

    def wait(self, end: Callable[[], bool]) -> Outcome:
        """End for a line that takes time, by default until `end` is true."""
        self.interpreter.default_end = end
        return Outcome.WAIT

    def at_once(self) -> Outcome:
        """End for a line that is done immediately. The next line follows in the next cycle."""
        return self.wait(always)

    def go_on(self, end: Callable[[], bool] = always) -> Outcome:
        """End for a line that takes no time. `end` applies to a following line of stop conditions."""
        self.interpreter.default_end = end
        return Outcome.NEXT

    def move(self, motion: ControlledMotion) -> Outcome:
        """Begin a motion. The line takes until the end of the motion."""
        control = self.vehicle.control
        control.start(motion)
        return self.wait(lambda: motion.is_done(control))

    # -- missing names and hardware ----------------------------------------------------------------------

    def reject_name(self, reason: str, mrc: str = "") -> None:
        """Fail because of a name. In MRC's profile, print MRC's message and continue."""
        if self.profile.names_are_checked:
            raise LineFault(reason)
        if mrc:
            self.output.message(mrc)

    def use_hook(self, *parameters: float | str, mrc: str | None = None) -> None:
        """Call the user's function for a command that needs hardware.

        Args:
            parameters: Parameters of the command.
            mrc: Text that MRC prints without the hardware. The default is the command's `hook`, with the parameters in
                it.
        """
        name = self.command.name
        hook = self.hooks.get(name)
        if hook is not None:
            found = self.call_hook(hook, *parameters)
            try:
                self.vehicle.variables.provide(found or {})
            except (BadValue, TypeError, AttributeError) as error:
                raise LineFault(f"the function for {name} did not return system variables: {error}") from error
        elif self.profile.needs_are_checked:
            raise LineFault(f'{name} needs hardware; register a function for it with mission.on("{name}", function)')
        elif text := (self.command.hook or "").format(*parameters) if mrc is None else mrc:
            self.output.message(text)

    def call_hook(self, hook: Hook, *parameters: float | str) -> Any:
        """Call a function of the user and return its result.

        Raises:
            LineFault: If the function raises an exception.
        """
        try:
            return hook(*parameters)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise LineFault(f"the function for {self.command.name} raised {reason}") from error

    # -- the text buffer ------------------------------------------------------------------------------

    def set_text(self, text: str) -> None:
        """Set the text buffer. Text beyond its size is cut off."""
        self.text_buffer = text[:_BUFFER]

    def take_input(self, text: str) -> None:
        """Put a line that arrived for `read` into the text buffer."""
        self.is_reading = False
        self.set_text(text)


# -- flow ---------------------------------------------------------------------------------------------


def pass_label(effects: MissionEffects, name: str) -> Outcome:
    """`label`: target of `goto`, `call` and `if`."""
    return effects.go_on(never)


def go_to(effects: MissionEffects, label: str) -> Outcome:
    """`goto`: continue with the line that has a label."""
    effects.interpreter.go_to(label, effects.run)
    return effects.go_on(never)


def call(effects: MissionEffects, label: str) -> Outcome:
    """`call`: continue with the line that has a label, until `return`."""
    run, most = effects.run, effects.interpreter.limits.calls
    back = run.plan.next
    effects.interpreter.go_to(label, run)
    if len(run.calls) >= most:
        raise LineFault(f"calls are nested too deeply; the maximum is {most}", is_limit=True)
    run.calls.append(back)
    return effects.go_on(never)


def go_back(effects: MissionEffects) -> Outcome:
    """`return`: continue after the last `call`."""
    run = effects.run
    if not run.calls:
        raise LineFault("'return' was executed without a preceding 'call'")
    run.plan.next = run.calls.pop()
    return effects.go_on(never)


def wait(effects: MissionEffects, seconds: float) -> Outcome:
    """`wait`: wait for some seconds, during which the current motion continues."""
    pool, place = effects.symbols.pool, effects.symbols.system["cmdtime"].place
    return effects.wait(lambda: pool[place] >= seconds)


# -- log, streams, watches, events, texts -------------------------------------------------------------


def log(effects: MissionEffects, *names: str) -> Outcome:
    """`log`: log variables in each cycle."""
    for text in names:
        if len(effects.log.places) >= DataLog.MOST_COLUMNS:
            effects.reject_name(f"a log can have at most {DataLog.MOST_COLUMNS} variables", "logtable full\n")
            continue
        is_system = text[:1] == "$"
        name, index = split_index(text[1:] if is_system else text)
        symbol = effects.symbols.find_system(name) if is_system else effects.symbols.user.get(name)
        if symbol is None:
            effects.reject_name(f"there is no variable {text}")
            continue
        if effects.profile.indices_are_checked and not 0 <= index < symbol.size:
            raise LineFault(f"index {index} is beyond {name}, which has {symbol.size} values")
        if 0 <= symbol.place + index < len(effects.symbols.pool):
            effects.log.places.append(symbol.place + index)
    return effects.at_once()


def control_log(effects: MissionEffects, word: str, name: str = "log", unused: str = "") -> Outcome:
    """`control`: start, stop, reset or save the log; it is saved as `name`."""
    if word == "stoplog":
        effects.log.is_on = False
    elif word == "startlog":
        effects.log.is_on = True
    elif word == "resetlog":
        effects.log.reset()
    elif word == "removelogvars":
        effects.log.places.clear()
    elif word == "savelog":
        effects.client.save_log(name, effects.log.text)
    else:
        effects.reject_name(f'control has no word "{word}"')
    return effects.at_once()


def stream(effects: MissionEffects, period: float, *names: str) -> Outcome:
    """`stream`: send variables to the client, every `period` cycles."""
    variables = []
    for text in names:
        # MRC searches for both: a system variable without the first character, and a variable of the script.
        is_system = text[:1] == "$" or not effects.profile.names_are_checked
        system = effects.symbols.find_system(text[1:]) if is_system else None
        user = effects.symbols.user.get(text)
        if system is None and user is None:
            effects.reject_name(f"there is no variable {text}")
        variables += [(each.name, each.place) for each in (system, user) if each is not None]
    effects.client.stream(truncate(period), variables)
    return effects.at_once()


def add_watch(effects: MissionEffects, name: str, number: float) -> Outcome:
    """`addwatch`: send an event whenever the watch's condition becomes true."""
    most = _MOST_WATCHES if effects.profile.watches_apart else 2
    if len(effects.watches) < most:
        effects.watches.append(Watch(name if effects.profile.watches_apart else name[:31], effects.conditions))
    elif effects.profile.watches_apart:
        raise LineFault(f"there are already {most} watches", is_limit=True)
    return effects.at_once()


def put_event(effects: MissionEffects, name: str) -> Outcome:
    """`putevent`: queue an event, which the client receives when it asks for one."""
    effects.client.user_event(name)
    return effects.go_on()


def sync_event(effects: MissionEffects, name: str) -> Outcome:
    """`syncevent`: send an event to the client immediately."""
    effects.client.sync_event(name)
    return effects.go_on()


def print_text(effects: MissionEffects, text: str) -> Outcome:
    """`print`: send a text to the client."""
    effects.client.text(text)
    return effects.at_once()


def read(effects: MissionEffects, prompt: str) -> Outcome:
    """`read`: ask the client. Its answer becomes the text buffer."""
    hook = effects.hooks.get("read")
    if hook is not None:
        effects.set_text(str(effects.call_hook(hook, prompt)))
        return effects.at_once()
    effects.client.text(prompt)
    if not effects.profile.reads_input:
        return effects.wait(never)
    if not effects.client.can_answer:
        raise LineFault('read needs an answer; register a function for it with mission.on("read", function)')
    effects.is_reading = True
    return effects.wait(lambda: not effects.is_reading)


def join_texts(effects: MissionEffects, *parts: float | str) -> Outcome:
    """`stringcat`: join texts and numbers into the text buffer."""
    texts = []
    for part in parts:
        if isinstance(part, str):
            texts.append(effects.text_buffer if part == "$str" else part)
        else:
            texts.append(f"{format_number(part)} ")
    return _keep_text(effects, "".join(texts))


def write_whole(effects: MissionEffects, value: float) -> Outcome:
    """`tointstring`: put a number without its fraction into the text buffer."""
    return _keep_text(effects, f"{truncate(value)} ")


def _keep_text(effects: MissionEffects, text: str) -> Outcome:
    effects.set_text(text)
    effects.output.message(f"strbuf {effects.text_buffer} \n")
    return effects.at_once()


# -- special hardware ---------------------------------------------------------------------------------


def ask(effects: MissionEffects, *parameters: float | str) -> Outcome:
    """Call the user's function for the command. Without a function, see `ScriptCommand.hook`."""
    effects.use_hook(*parameters)
    return effects.at_once()


def ask_of_text(effects: MissionEffects, text: str) -> Outcome:
    """Call the user's function with a text; `"$str"` is the text buffer."""
    return ask(effects, effects.text_buffer if text[:1] == "$" else text)


def get(effects: MissionEffects, what: str, text: str = "") -> Outcome:
    """`get`: find the position of a guide mark."""
    if what == "guidemark":
        effects.vehicle.variables.provide({"guidemarkok": 0.0})
        return ask(effects, what, text)
    effects.reject_name(f'get cannot find "{what}"; expected guidemark')
    return effects.at_once()


def estimate_wall(effects: MissionEffects, method: str, *parameters: float) -> Outcome:
    """`wallest`: estimate the position of a wall.

    MRC has two methods; whether it has more is unknown.
    """
    effects.use_hook(method, *parameters, mrc="" if method[1:2] in ("b", "c") else "Wrong parameter \n")
    return effects.at_once()
