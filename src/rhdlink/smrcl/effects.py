"""What commands act on, and what many of them do; the commands of flow, log, events, texts and special hardware.

A command is a function: it takes `MissionEffects` and the command's parameters, sets the default end of its line, and
returns how the line goes on. `commands` has the table of all.
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

#: What carries out a command that needs hardware: it is given the parameters, and may return system variables by name.
#: The one for `read` returns a text.
Hook = Callable[..., Mapping[str, float] | str | None]

#: Characters of the text buffer.
_BUFFER = 255
#: Watches under the sound profile; MRC has two.
_MOST_WATCHES = 100


class Watch:
    """A condition that is tested in every cycle, and sends an event when it becomes true."""

    def __init__(self, name: str, conditions: Sequence[Value]) -> None:
        self.name = name
        self._conditions = conditions
        self._value = 0.0

    def update(self, interpreter: ScriptInterpreter) -> bool:
        """Whether it has risen in this cycle.

        Raises:
            LineFault: its condition cannot be computed.
        """
        value = interpreter.watch(self._conditions)
        has_risen = value > self._value
        self._value = value
        return has_risen


def always() -> bool:
    """The default end of what is done at once."""
    return True


class MissionEffects:
    """What commands act on.

    Args:
        interpreter: whose lines they are.
        hooks: what carries out commands that need hardware, by the name of the command.

    Attributes:
        interpreter, hooks: as given.
        vehicle: what moves.
        output: gets the output that MRC prints.
        client: receives texts, events, streams and logs.
        profile: as MRC does it, or sound.
        symbols: the variables of the mission.
        command: the present one, or the last.
        run: the plan that it belongs to.
        conditions: its stop conditions.
        log: of the variables.
        watches: of conditions.
        text_buffer: what `stringcat` has made.
        is_reading: `read` waits for a line from its client.
        side_is_left: the side of the wall that `followwall` follows.
        signal: the parameters of `funcgen`.
        routine_result: what `resetmotors` prints: the x that it found the time before.
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
            LineFault: it cannot be executed.
        """
        self.command, self.run, self.conditions = command, run, conditions
        return command.carry_out(self, *parameters)

    # -- how a line goes on ---------------------------------------------------------------------------

    def wait(self, end: Callable[[], bool]) -> Outcome:
        """The line takes time, by default until `end` is true."""
        self.interpreter.default_end = end
        return Outcome.WAIT

    def at_once(self) -> Outcome:
        """The line is done, and the next one follows in the next cycle."""
        return self.wait(always)

    def go_on(self, end: Callable[[], bool] = always) -> Outcome:
        """The line takes no time. `end` is that of a line of stop conditions that follows."""
        self.interpreter.default_end = end
        return Outcome.NEXT

    def move(self, motion: ControlledMotion) -> Outcome:
        """Begin a motion; the line takes until its end."""
        control = self.vehicle.control
        control.start(motion)
        return self.wait(lambda: motion.is_done(control))

    # -- what is not there ----------------------------------------------------------------------------

    def reject_name(self, reason: str, mrc: str = "") -> None:
        """Fail because of a name, or say what MRC says and go on."""
        if self.profile.names_are_checked:
            raise LineFault(reason)
        if mrc:
            self.output.message(mrc)

    def use_hook(self, *parameters: float | str, mrc: str | None = None) -> None:
        """Have a function of the user do what needs hardware.

        Args:
            mrc: what MRC prints instead; by default the command's `hook`, with the first parameter in it.
        """
        name = self.command.name
        hook = self.hooks.get(name)
        if hook is not None:
            found = self.call_hook(hook, *parameters)
            try:
                self.vehicle.variables.provide(found or {})
            except (BadValue, TypeError, AttributeError) as error:
                raise LineFault(f"the function for {name} returned no system variables: {error}") from error
        elif self.profile.needs_are_checked:
            raise LineFault(
                f'{name} needs hardware: give the mission a function for it, mission.on("{name}", function)'
            )
        elif text := (self.command.hook or "").format(*parameters) if mrc is None else mrc:
            self.output.message(text)

    def call_hook(self, hook: Hook, *parameters: float | str) -> Any:
        """What a function of the user returns.

        Raises:
            LineFault: it raised.
        """
        try:
            return hook(*parameters)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise LineFault(f"the function for {self.command.name} raised {reason}") from error

    # -- the text buffer ------------------------------------------------------------------------------

    def set_text(self, text: str) -> None:
        """Set the text buffer; what it has no room for is cut off."""
        self.text_buffer = text[:_BUFFER]

    def take_input(self, text: str) -> None:
        """A line for `read` has come; it becomes the text buffer."""
        self.is_reading = False
        self.set_text(text)


# -- flow ---------------------------------------------------------------------------------------------


def pass_label(effects: MissionEffects, name: str) -> Outcome:
    """`label`: where `goto`, `call` and `if` lead."""
    return effects.go_on(never)


def go_to(effects: MissionEffects, label: str) -> Outcome:
    """`goto`: the line with a label comes next."""
    effects.interpreter.go_to(label, effects.run)
    return effects.go_on(never)


def call(effects: MissionEffects, label: str) -> Outcome:
    """`call`: likewise, up to `return`."""
    run, most = effects.run, effects.interpreter.limits.calls
    back = run.plan.next
    effects.interpreter.go_to(label, run)
    if len(run.calls) >= most:
        raise LineFault(f"more than {most} calls within each other", is_limit=True)
    run.calls.append(back)
    return effects.go_on(never)


def go_back(effects: MissionEffects) -> Outcome:
    """`return`: behind the last `call`."""
    run = effects.run
    if not run.calls:
        raise LineFault("return without a call")
    run.plan.next = run.calls.pop()
    return effects.go_on(never)


def wait(effects: MissionEffects, seconds: float) -> Outcome:
    """`wait`: seconds, in which the present motion goes on."""
    pool, place = effects.symbols.pool, effects.symbols.system["cmdtime"].place
    return effects.wait(lambda: pool[place] >= seconds)


# -- log, streams, watches, events, texts -------------------------------------------------------------


def log(effects: MissionEffects, *names: str) -> Outcome:
    """`log`: have variables logged in each cycle."""
    for text in names:
        if len(effects.log.places) >= DataLog.MOST_COLUMNS:
            effects.reject_name(f"a log has at most {DataLog.MOST_COLUMNS} variables", "logtable full\n")
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
    """`control`: the log; it is saved as `name`."""
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
        effects.reject_name(f'control knows no word "{word}"')
    return effects.at_once()


def stream(effects: MissionEffects, period: float, *names: str) -> Outcome:
    """`stream`: send variables to the client, every `period` cycles."""
    variables = []
    for text in names:
        # MRC looks for both, a system variable behind the first character and a variable of the script.
        is_system = text[:1] == "$" or not effects.profile.names_are_checked
        system = effects.symbols.find_system(text[1:]) if is_system else None
        user = effects.symbols.user.get(text)
        if system is None and user is None:
            effects.reject_name(f"there is no variable {text}")
        variables += [(each.name, each.place) for each in (system, user) if each is not None]
    effects.client.stream(truncate(period), variables)
    return effects.at_once()


def add_watch(effects: MissionEffects, name: str, number: float) -> Outcome:
    """`addwatch`: an event whenever its condition becomes true."""
    most = _MOST_WATCHES if effects.profile.watches_apart else 2
    if len(effects.watches) < most:
        effects.watches.append(Watch(name if effects.profile.watches_apart else name[:31], effects.conditions))
    elif effects.profile.watches_apart:
        raise LineFault(f"there are {most} watches already", is_limit=True)
    return effects.at_once()


def put_event(effects: MissionEffects, name: str) -> Outcome:
    """`putevent`: an event that the client gets when it asks for one."""
    effects.client.user_event(name)
    return effects.go_on()


def sync_event(effects: MissionEffects, name: str) -> Outcome:
    """`syncevent`: one that the client is sent at once."""
    effects.client.sync_event(name)
    return effects.go_on()


def print_text(effects: MissionEffects, text: str) -> Outcome:
    """`print`: to the client."""
    effects.client.text(text)
    return effects.at_once()


def read(effects: MissionEffects, prompt: str) -> Outcome:
    """`read`: ask the client; its answer becomes the text buffer."""
    hook = effects.hooks.get("read")
    if hook is not None:
        effects.set_text(str(effects.call_hook(hook, prompt)))
        return effects.at_once()
    effects.client.text(prompt)
    if not effects.profile.reads_input:
        return effects.wait(never)
    if not effects.client.can_answer:
        raise LineFault('read needs an answer: give the mission a function for it, mission.on("read", function)')
    effects.is_reading = True
    return effects.wait(lambda: not effects.is_reading)


def join_texts(effects: MissionEffects, *parts: float | str) -> Outcome:
    """`stringcat`: into the text buffer."""
    texts = []
    for part in parts:
        if isinstance(part, str):
            texts.append(effects.text_buffer if part == "$str" else part)
        else:
            texts.append(f"{format_number(part)} ")
    return _keep_text(effects, "".join(texts))


def write_whole(effects: MissionEffects, value: float) -> Outcome:
    """`tointstring`: a number without its fraction, into the text buffer."""
    return _keep_text(effects, f"{truncate(value)} ")


def _keep_text(effects: MissionEffects, text: str) -> Outcome:
    effects.set_text(text)
    effects.output.message(f"strbuf {effects.text_buffer} \n")
    return effects.at_once()


# -- special hardware ---------------------------------------------------------------------------------


def ask(effects: MissionEffects, *parameters: float | str) -> Outcome:
    """What a function of the user does; without one, see `ScriptCommand.hook`."""
    effects.use_hook(*parameters)
    return effects.at_once()


def ask_of_text(effects: MissionEffects, text: str) -> Outcome:
    """Likewise, of a text or of the text buffer for `"$str"`."""
    return ask(effects, effects.text_buffer if text[:1] == "$" else text)


def get(effects: MissionEffects, what: str, text: str = "") -> Outcome:
    """`get`: where a guide mark is."""
    if what == "guidemark":
        effects.vehicle.variables.provide({"guidemarkok": 0.0})
        return ask(effects, what, text)
    effects.reject_name(f'get knows no "{what}", only guidemark')
    return effects.at_once()


def estimate_wall(effects: MissionEffects, method: str, *parameters: float) -> Outcome:
    """`wallest`: where a wall is, by a method; which MRC knows beside these two is not known."""
    effects.use_hook(method, *parameters, mrc="" if method[1:2] in ("b", "c") else "Wrong parameter \n")
    return effects.at_once()
