"""What commands act on, and what many of them do; those of the flow of a script and of special hardware.

A command is a function: it takes `MissionEffects` and the command's parameters, sets the default end of its line, and
returns how the line goes on. `commands` has the table of all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from linkcore.errors import BadValue

from .expressions import LineFault, Value
from .interpreter import Outcome, Output, Run, ScriptInterpreter, never
from .motion.control import ControlledMotion
from .outbox import DataLog, Recipient
from .vehicle import Vehicle

if TYPE_CHECKING:
    from .commands import ScriptCommand

#: What fulfils a command that needs hardware: it is given the parameters, and may return system variables by name. The
#: one for `read` returns a text.
Hook = Callable[..., Mapping[str, float] | str | None]

#: Characters of the text buffer.
_BUFFER = 255


class Watch:
    """A condition that is tested in every cycle, and sends an event when it becomes true."""

    def __init__(self, name: str, conditions: Sequence[Value]) -> None:
        self.name = name
        self._conditions = conditions
        self._value = 0.0

    def update(self, interpreter: ScriptInterpreter) -> bool:
        """Whether it has risen in this cycle.

        Raises:
            Fault: its condition cannot be computed.
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
        vehicle: what moves.
        interpreter: whose lines they are.
        output: gets the output that MRC prints.
        client: receives texts, events, streams and logs.
        hooks: what fulfils commands that need hardware, by the name of the command.

    Attributes:
        run: the plan that the present command belongs to.
        conditions: the stop conditions of the present command.
        log: of the variables.
        watches: of conditions.
        text_buffer: what `stringcat` has made.
        is_reading: `read` waits for a line from its client.
        side_is_left: the side of the wall that `followwall` follows.
        signal: the parameters of `funcgen`.
        routine_result: what `resetmotors` prints: the x that it found the time before.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        interpreter: ScriptInterpreter,
        output: Output,
        client: Recipient,
        hooks: Mapping[str, Hook],
    ) -> None:
        self.vehicle = vehicle
        self.interpreter = interpreter
        self.output = output
        self.client = client
        self.hooks = hooks
        self.profile = vehicle.profile
        self.symbols = vehicle.symbols
        self.run: Run
        self.conditions: Sequence[Value] = ()
        self.log = DataLog(vehicle.symbols.pool)
        self.watches: list[Watch] = []
        self.text_buffer = ""
        self.is_reading = False
        self.side_is_left = True
        self.signal = [0.0] * 5
        self.routine_result = 0.0

    def perform(
        self, command: ScriptCommand, parameters: Sequence[float | str], run: Run, conditions: Sequence[Value]
    ) -> Outcome:
        """Execute a command, see `interpreter.Effects`."""
        self.run, self.conditions = run, conditions
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

    def use_hook(self, name: str, *parameters: float | str, mrc: str = "") -> None:
        """Have a function of the user do what needs hardware.

        Args:
            mrc: what MRC prints instead.
        """
        hook = self.hooks.get(name)
        if hook is not None:
            found = call_hook(name, hook, *parameters)
            try:
                self.vehicle.provide(found or {})
            except (BadValue, TypeError, AttributeError) as error:
                raise LineFault(f"the function for {name} returned no system variables: {error}") from error
        elif self.profile.needs_are_checked:
            raise LineFault(
                f'{name} needs hardware: give the mission a function for it, mission.on("{name}", function)'
            )
        elif mrc:
            self.output.message(mrc)

    # -- the text buffer ------------------------------------------------------------------------------

    def set_text(self, text: str) -> None:
        """Set the text buffer; what it has no room for is cut off."""
        self.text_buffer = text[:_BUFFER]

    def text_of(self, text: str) -> str:
        """A text that a command is given, or the text buffer for `"$str"`."""
        return self.text_buffer if text[:1] == "$" else text

    def take_input(self, text: str) -> None:
        """A line for `read` has come; it becomes the text buffer."""
        self.is_reading = False
        self.set_text(text)


def call_hook(name: str, hook: Hook, *parameters: float | str) -> Any:
    """What a function of the user returns.

    Raises:
        LineFault: it raised.
    """
    try:
        return hook(*parameters)
    except Exception as error:
        raise LineFault(f"the function for {name} raised {type(error).__name__}: {error}") from error


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
    effects.interpreter.call(label, effects.run)
    return effects.go_on(never)


def go_back(effects: MissionEffects) -> Outcome:
    """`return`: behind the last `call`."""
    effects.interpreter.go_back(effects.run)
    return effects.go_on(never)


def wait(effects: MissionEffects, seconds: float) -> Outcome:
    """`wait`: seconds, in which the present motion goes on."""
    pool, place = effects.symbols.pool, effects.symbols.system["cmdtime"].place
    return effects.wait(lambda: pool[place] >= seconds)


# -- special hardware ---------------------------------------------------------------------------------


def ask_camera(effects: MissionEffects, text: str) -> Outcome:
    """`vision`: what the camera sees."""
    effects.use_hook("vision", effects.text_of(text), mrc="Not connected to cameraserver \n")
    return effects.at_once()


def ask_laser(effects: MissionEffects, text: str) -> Outcome:
    """`laser`: what the laser scanner sees."""
    effects.use_hook("laser", effects.text_of(text), mrc="No connection to laserserver \n")
    return effects.at_once()


def get(effects: MissionEffects, what: str, text: str = "") -> Outcome:
    """`get`: where a guide mark is."""
    if what == "guidemark":
        effects.vehicle.provide({"guidemarkok": 0.0})
        effects.use_hook("get", what, text)
    else:
        effects.reject_name(f'get knows no "{what}", only guidemark')
    return effects.at_once()


def play(effects: MissionEffects, name: str) -> Outcome:
    """`play`: a sound."""
    effects.use_hook("play", name)
    return effects.at_once()


def speak(effects: MissionEffects, text: str) -> Outcome:
    """`speak`: a text."""
    text = effects.text_of(text)
    effects.use_hook("speak", text, mrc=f'/usr/local/bin/flite -t "{text}"')
    return effects.at_once()


def open_device(effects: MissionEffects, what: str) -> Outcome:
    """`open`: a device."""
    effects.use_hook("open", what, mrc=f"open {what} \n")
    return effects.at_once()


def write_wifi(effects: MissionEffects, text: str, first: float, second: float) -> Outcome:
    """`writewifi`: two numbers."""
    effects.use_hook("writewifi", text, first, second)
    return effects.at_once()


def estimate_wall(effects: MissionEffects, *parameters: float | str) -> Outcome:
    """`wallest`: where a wall is."""
    # Which letters MRC takes beside these is not known.
    knows = str(parameters[0])[1:2] in ("b", "c")
    effects.use_hook("wallest", *parameters, mrc="" if knows else "Wrong parameter \n")
    return effects.at_once()


def read_barcode(effects: MissionEffects) -> Outcome:
    """`barcode`: the one in front of the reader."""
    effects.use_hook("barcode")
    return effects.at_once()
