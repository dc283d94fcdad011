"""The effects of the language's commands.

One method for each command, by its name. It returns `Outcome.WAIT` for a line that takes time, and sets the default end
of that line, or `Outcome.NEXT` for one that does not. Commands that are done at once have a default end that is true.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from linkcore.errors import BadValue

from .arithmetic import cosine, divide, format_number, sine, truncate
from .expressions import LineFault, Value
from .interpreter import Outcome, Output, Run, ScriptInterpreter, never
from .motion.basic import Align, FollowDirection, Forward, FunctionGenerator, Stop, Wheels
from .motion.control import ControlledMotion, Standing
from .motion.following import FollowLine, FollowWall, FollowWallTable
from .motion.topoint import DriveToPoint
from .motion.turning import ArcTurn, Clothoid, Turn
from .odometry import Pose
from .outbox import DataLog
from .sensors import LineKind
from .symbols import split_index
from .vehicle import Vehicle

__all__ = ["Hook", "MissionEffects", "Recipient", "Watch", "always"]

#: What fulfils a command that needs hardware: it is given the parameters, and may return system variables by name. The
#: one for `read` returns a text.
Hook = Callable[..., Mapping[str, float] | str | None]

#: m, or rad, beyond which no motion is meant.
_FARTHEST = 1e6

#: Characters of the string buffer.
_BUFFER = 255

#: What `set` accepts for hardware that no robot of today has, and that MRC only stores.
_STORED_ONLY = frozenset(
    (
        *("linedetect", "rollpitchon", "rolloffset", "pitchoffset", "paintServoStatus", "kalmanon"),
        *("hakoliftinggearstateref", "hakopowertakeoffstateref"),
    )
)
#: Names of `set` that stand for a write variable of the robot.
_WRITTEN = {"hakomanual": "hakomanual", "hakoenginespeed": "enginespeedref"}


class Recipient(Protocol):
    """Receives what a script says to its client: the session of the client that sent the command, or an outbox."""

    @property
    def can_answer(self) -> bool:
        """It can send a line for `read`."""

    def text(self, text: str) -> None:
        """`print`, `read`."""

    def user_event(self, name: str) -> None:
        """`putevent`."""

    def sync_event(self, name: str) -> None:
        """`syncevent`."""

    def set_xml(self, is_on: bool) -> None:
        """``set "xmlon"``."""

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """`stream`: names, and places in the pool."""

    def save_log(self, name: str, text: str) -> None:
        """`control "savelog"`."""


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
    """The commands.

    Args:
        vehicle: what moves.
        interpreter: whose lines they are.
        output: gets the output that MRC prints.
        client: receives texts, events, streams and logs.
        hooks: what fulfils commands that need hardware, by the name of the command.

    Attributes:
        log: of the variables.
        watches: of conditions.
        text_buffer: what `stringcat` has made.
        is_reading: `read` waits for a line from its client.
    """

    #: Watches under the sound profile; MRC has two.
    MOST_WATCHES = 100

    def __init__(
        self,
        vehicle: Vehicle,
        interpreter: ScriptInterpreter,
        output: Output,
        client: Recipient,
        hooks: Mapping[str, Hook],
    ) -> None:
        self._vehicle = vehicle
        self._interpreter = interpreter
        self._output = output
        self._hooks = hooks
        self.client = client
        self._profile = vehicle.profile
        self._symbols = vehicle.symbols
        self.log = DataLog(vehicle.symbols.pool)
        self.watches: list[Watch] = []
        self.text_buffer = ""
        self.is_reading = False
        self._routine_result = 0.0
        self._command_time = vehicle.symbols.system["cmdtime"].place
        self._side_is_left = True
        self._signal = [0.0] * 5

    def perform(self, name: str, parameters: Sequence[float | str], run: Run, conditions: Sequence[Value]) -> Outcome:
        """Execute a command, see `Effects`."""
        if name == "addwatch":
            return self._addwatch(str(parameters[0]), conditions)
        method: Callable[..., Outcome] = getattr(self, f"_{name}")
        if name in ("goto", "call", "return", "resetmotors"):
            return method(run, *parameters)
        return method(*parameters)

    # -- motions ------------------------------------------------------------------------------------

    def _move(self, motion: ControlledMotion, *lengths: float) -> Outcome:
        for length in lengths if self._profile.numbers_are_checked else ():
            if not abs(length) <= _FARTHEST:
                raise LineFault(f"{format_number(length)} is no length or angle")
        control = self._vehicle.control
        control.start(motion)
        self._interpreter.default_end = lambda: motion.is_done(control)
        return Outcome.WAIT

    def _fwd(self, distance: float) -> Outcome:
        self._vehicle.control.distance = distance
        return self._move(Forward(distance), distance)

    def _turn(self, angle: float, unit: object = None) -> Outcome:
        return self._move(Turn(_radians(angle, unit)), angle)

    def _turnr(self, radius: float, angle: float, unit: object = None) -> Outcome:
        return self._move(ArcTurn(radius, _radians(angle, unit)), radius, angle)

    def _turnc(self, radius: float, angle: float, unit: object = None) -> Outcome:
        return self._move(Clothoid(radius, _radians(angle, unit)), radius, angle)

    def _drive(self, *reference: float) -> Outcome:
        return self._follow(FollowDirection(), reference)

    def _driveon(self, *reference: float) -> Outcome:
        return self._follow(FollowDirection(keeps_speed=True), reference)

    def _drivew(self, *reference: float) -> Outcome:
        return self._follow(FollowDirection(is_world=True), reference)

    def _driveonw(self, *reference: float) -> Outcome:
        return self._follow(FollowDirection(keeps_speed=True, is_world=True), reference)

    def _follow(self, motion: FollowDirection, reference: Sequence[float]) -> Outcome:
        vehicle = self._vehicle
        vehicle.control.distance = 0.0
        if len(reference) < 3:
            here = vehicle.estimated_pose()
            vehicle.control.reference.set(here.x, here.y, here.th)
            return self._move(motion)
        x, y, th = reference[:3]
        vehicle.control.reference.set(x, y, _radians(th, reference[3] if len(reference) > 3 else None))
        return self._move(motion, x, y, th)

    def _drivetopoint(self, x: float, y: float, th: float, radius: float, frame: object = None) -> Outcome:
        goal = Pose(x, y, _radians(th, None))
        return self._move(DriveToPoint(goal, radius, is_absolute=frame == "abs"), x, y, th, radius)

    def _motorcmds(self, left: float, right: float) -> Outcome:
        return self._move(Wheels(left, right), left, right)

    def _followline(self, kind: str) -> Outcome:
        try:
            self._vehicle.line_kind = LineKind(kind)
        except ValueError:
            if self._profile.names_are_checked:
                names = ", ".join(each.value for each in LineKind)
                raise LineFault(f'followline knows no line "{kind}", only {names}') from None
            self._vehicle.line_kind = LineKind.BLACK_MIDDLE
        return self._move(FollowLine())

    def _followwall(self, side: str, distance: float) -> Outcome:
        self._choose_side(side)
        return self._move(FollowWall(self._side_is_left, distance), distance)

    def _followwall2(self, side: str, distance: float) -> Outcome:
        self._choose_side(side)
        if side[1:2] not in ("d", "r"):
            self._reject_name(f'followwall2 knows no method "{side[1:2]}", only d and r', "Wrong parameter \n")
        if side[1:2] == "r":
            raise LineFault("followwall2 by regression needs an estimator of walls, which is not there; use rd or ld")
        if not self._vehicle.control.parameters.wall_table:
            raise LineFault("followwall2 needs the table of wdssparam.dat (wall_table of the robot's configuration)")
        return self._move(FollowWallTable(self._side_is_left, distance), distance)

    def _choose_side(self, side: str) -> None:
        if side[:1] in ("l", "r"):
            self._side_is_left = side[:1] == "l"
        else:
            self._reject_name(f'a side is "l" or "r", not "{side}"', "wrong parameter\n")

    def _stop(self) -> Outcome:
        return self._move(Stop())

    def _idle(self) -> Outcome:
        return self._move(Standing())

    def _align(self) -> Outcome:
        return self._move(Align())

    def _movetoxyz(self, x: float, y: float, z: float) -> Outcome:
        self._use_hook("movetoxyz", x, y, z)
        self._interpreter.default_end = never
        return Outcome.WAIT

    def _funcgen(self, *parameters: float) -> Outcome:
        # Those that are left out are those of the signal before.
        self._signal[: len(parameters)] = parameters
        return self._move(FunctionGenerator(self._signal), *parameters)

    def _ignoreobstacles(self) -> Outcome:
        self._vehicle.control.ignore_obstacles()
        return self._at_once()

    def _targethere(self) -> Outcome:
        self._vehicle.control.target = self._vehicle.odometry.pose.copy()
        self._interpreter.default_end = always
        return Outcome.NEXT

    def _resetodocov(self) -> Outcome:
        self._vehicle.covariance.reset()
        self._interpreter.default_end = always
        return Outcome.NEXT

    def _resetmotors(self, run: Run) -> Outcome:
        vehicle = self._vehicle
        self._output.message(f" p0 {format_number(self._routine_result)} \n")
        start = Pose()

        def routine(cycle: int) -> bool:
            nonlocal start
            if cycle == 0:
                self._output.message("reset state1\n")
                start = vehicle.odometry.pose.copy()
                self._routine_result = start.x
                vehicle.control.start(Standing())
                vehicle.reset_motors()
            if cycle < 6:
                return False
            self._output.message("reset state2 \n")
            vehicle.odometry.pose = start
            return True

        run.start_routine(routine)
        return Outcome.WAIT

    # -- flow ---------------------------------------------------------------------------------------

    def _label(self, name: str) -> Outcome:
        self._interpreter.default_end = never
        return Outcome.NEXT

    def _goto(self, run: Run, label: str) -> Outcome:
        self._interpreter.default_end = never
        self._interpreter.go_to(label, run)
        return Outcome.NEXT

    def _call(self, run: Run, label: str) -> Outcome:
        self._interpreter.default_end = never
        self._interpreter.call(label, run)
        return Outcome.NEXT

    def _return(self, run: Run) -> Outcome:
        self._interpreter.default_end = never
        self._interpreter.go_back(run)
        return Outcome.NEXT

    def _wait(self, seconds: float) -> Outcome:
        pool, place = self._symbols.pool, self._command_time
        self._interpreter.default_end = lambda: pool[place] >= seconds
        return Outcome.WAIT

    # -- variables ----------------------------------------------------------------------------------

    def _array(self, name: str, size: float) -> Outcome:
        count = truncate(size)
        if count < 0 or self._symbols.make_array(name, count) is None:
            raise LineFault(
                f"there is no room for an array of {format_number(size)} values; {self._symbols.free} are free",
                is_limit=True,
            )
        return self._at_once()

    def _trans(self, x0: float, y0: float, th0: float, x: float, y: float, th: float) -> Outcome:
        c, s = cosine(th0), sine(th0)
        self._vehicle.set_results(c * x - s * y + x0, s * x + c * y + y0, th + th0)
        return self._at_once()

    def _invtrans(self, x0: float, y0: float, th0: float, x: float, y: float, th: float) -> Outcome:
        c, s = cosine(th0), sine(th0)
        self._vehicle.set_results(c * (x - x0) + s * (y - y0), -s * (x - x0) + c * (y - y0), th - th0)
        return self._at_once()

    def _set(self, name: str, value: float) -> Outcome:
        special = _SETTINGS.get(name)
        if special is not None:
            self._check_setting(f'set "{name}"', value, is_positive=name == "odowidth")
            special(self, value)
        elif name in _STORED_ONLY:
            if self._profile.needs_are_checked:
                raise LineFault(f'set "{name}" is for hardware that this robot has not')
        elif name in _WRITTEN:
            self._set_raw(name, _WRITTEN[name], value)
        else:
            self._set_variable(name, value)
        return self._at_once()

    def _check_setting(self, what: str, value: float, *, is_positive: bool = False) -> None:
        if not self._profile.numbers_are_checked:
            return
        if not abs(value) <= _FARTHEST or (is_positive and value <= 0.0):
            expected = "a number above 0" if is_positive else "a number"
            raise LineFault(f"{what} takes {expected} of at most {_FARTHEST:g}, not {format_number(value)}")

    def _set_raw(self, name: str, variable: str, value: float) -> None:
        if not self._vehicle.set_word(variable, value) and self._profile.needs_are_checked:
            raise LineFault(f'set "{name}" needs a write variable {variable}, which this robot has not')

    def _set_variable(self, text: str, value: float) -> None:
        name, index = split_index(text)
        symbol = self._symbols.user.get(name)
        if symbol is None and name[:1] == "$":
            symbol = self._symbols.find_system(name[1:])
        if symbol is None:
            self._reject_name(f"there is no variable {name}")
            return
        place = symbol.place + index
        if self._profile.indices_are_checked and not 0 <= index < symbol.size:
            raise LineFault(f"index {index} is beyond {name}, which has {symbol.size} values")
        if 0 <= place < len(self._symbols.pool):
            self._symbols.pool[place] = value

    def _set_counter(self, value: float) -> None:
        if not self._interpreter.compiler.reset_counter(truncate(value)) and self._profile.names_are_checked:
            raise LineFault(f"there is no condition counter {format_number(value)}, only 0 to 9")

    def _set_odometry_ratio(self, ratio: float) -> None:
        odometry = self._vehicle.odometry
        mean = (odometry.right_scale + odometry.left_scale) / 2
        odometry.right_scale = divide(2 * ratio, 1 + ratio) * mean
        odometry.left_scale = divide(2, 1 + ratio) * mean

    def _set_odometry_mean(self, mean: float) -> None:
        odometry = self._vehicle.odometry
        ratio = divide(odometry.right_scale, odometry.left_scale)
        odometry.right_scale = divide(2 * ratio, 1 + ratio) * mean
        odometry.left_scale = divide(2, 1 + ratio) * mean

    def _set_kalman(self, value: float) -> None:
        vehicle = self._vehicle
        if value and "xkalman" not in vehicle.external and self._profile.needs_are_checked:
            raise LineFault('set "usekalmanodo" needs a filter that provides $xkalman, $ykalman and $thkalman')
        vehicle.uses_kalman = truncate(value) != 0
        vehicle.control.target = vehicle.kalman_pose()

    def _setoutput(self, text: str, value: float) -> Outcome:
        name, index = split_index(text)
        if not self._vehicle.set_output(name, index, value):
            self._reject_name(f"the robot has no write variable {text}")
        return self._at_once()

    def _setoffset(self, text: str, value: float) -> Outcome:
        name, index = split_index(text)
        if self._vehicle.set_scale(name, index, offset=value):
            self._output.message(f" offset assigned {format_number(value)}\n")
        else:
            self._reject_name(f"the robot has no variable {text}")
        return self._at_once()

    def _setgain(self, text: str, value: float) -> Outcome:
        name, index = split_index(text)
        if self._vehicle.set_scale(name, index, gain=value):
            self._output.message(f" gain assigned {format_number(value)}\n")
        else:
            self._reject_name(f"the robot has no variable {text}")
        return self._at_once()

    def _setpar(self, module: str, function: str, name: str, value: float) -> Outcome:
        self._check_setting(f"setpar of {name}", value)
        if not self._vehicle.set_parameter(module, function, name, value):
            self._reject_path(module, function, f"{name} of {module} {function} is no parameter")
        return self._at_once()

    def _routeinput(self, module: str, function: str, name: str, text: str) -> Outcome:
        variable, index = split_index(text)
        if not self._vehicle.has_input(module, function, name):
            self._reject_path(module, function, f"{name} of {module} {function} is no input")
            return self._at_once()
        symbol = self._symbols.find_system(variable)
        if symbol is None:
            self._reject_name(f"the robot has no variable {variable}", " input variable not found \n")
        elif 0 <= symbol.place + index < len(self._symbols.pool):
            self._vehicle.route_input(module, function, name, symbol.place + index)
        return self._at_once()

    def _routeoutput(self, source: str, text: str) -> Outcome:
        name, index = split_index(text)
        if name not in self._symbols.outputs:
            self._reject_name(f"the robot has no write variable {name}", "output not found\n")
        elif source != "funcgen":
            self._reject_name(f'there is no generator "{source}", only funcgen', "input not found\n")
        else:
            self._vehicle.generator_output = name, index
        return self._at_once()

    # -- log, streams, watches, events ----------------------------------------------------------------

    def _log(self, *names: str) -> Outcome:
        for text in names:
            if self.log.columns >= DataLog.MOST_COLUMNS:
                self._reject_name(f"a log has at most {DataLog.MOST_COLUMNS} variables", "logtable full\n")
                continue
            is_system = text[:1] == "$"
            name, index = split_index(text[1:] if is_system else text)
            symbol = self._symbols.find_system(name) if is_system else self._symbols.user.get(name)
            if symbol is None:
                self._reject_name(f"there is no variable {text}")
                continue
            if self._profile.indices_are_checked and not 0 <= index < symbol.size:
                raise LineFault(f"index {index} is beyond {name}, which has {symbol.size} values")
            if 0 <= symbol.place + index < len(self._symbols.pool):
                self.log.add(symbol.place + index)
        return self._at_once()

    def _control(self, word: str, name: str = "log", unused: str = "") -> Outcome:
        if word == "stoplog":
            self.log.is_on = False
        elif word == "startlog":
            self.log.is_on = True
        elif word == "resetlog":
            self.log.reset()
        elif word == "removelogvars":
            self.log.remove_all()
        elif word == "savelog":
            self.client.save_log(name, self.log.text)
        else:
            self._reject_name(f'control knows no word "{word}"')
        return self._at_once()

    def _stream(self, period: float, *names: str) -> Outcome:
        variables = []
        for text in names:
            # MRC looks for both, a system variable behind the first character and a variable of the script.
            system = self._symbols.find_system(text[1:]) if text[:1] == "$" or not self._checks_names else None
            user = self._symbols.user.get(text)
            if system is None and user is None:
                self._reject_name(f"there is no variable {text}")
            variables += [(each.name, each.place) for each in (system, user) if each is not None]
        self.client.stream(truncate(period), variables)
        return self._at_once()

    @property
    def _checks_names(self) -> bool:
        return self._profile.names_are_checked

    def _addwatch(self, name: str, conditions: Sequence[Value]) -> Outcome:
        if not conditions:
            raise LineFault('addwatch needs a condition, as in addwatch "name" 1 : ($odox > 1)')
        most = self.MOST_WATCHES if self._profile.watches_apart else 2
        if len(self.watches) < most:
            self.watches.append(Watch(name[:31] if not self._profile.watches_apart else name, conditions))
        elif self._profile.watches_apart:
            raise LineFault(f"there are {most} watches already", is_limit=True)
        return self._at_once()

    def _putevent(self, name: str) -> Outcome:
        self.client.user_event(name)
        self._interpreter.default_end = always
        return Outcome.NEXT

    def _syncevent(self, name: str) -> Outcome:
        self.client.sync_event(name)
        self._interpreter.default_end = always
        return Outcome.NEXT

    def _print(self, text: str) -> Outcome:
        self.client.text(text)
        return self._at_once()

    def _read(self, prompt: str) -> Outcome:
        hook = self._hooks.get("read")
        if hook is not None:
            answer = self._call_hook("read", hook, prompt)
            self.text_buffer = str(answer)[:_BUFFER]
            return self._at_once()
        self.client.text(prompt)
        if not self._profile.reads_input:
            self._interpreter.default_end = never
            return Outcome.WAIT
        if not self.client.can_answer:
            raise LineFault('read needs an answer: give the mission a function for it, mission.on("read", function)')
        self.is_reading = True
        self._interpreter.default_end = lambda: not self.is_reading
        return Outcome.WAIT

    def take_input(self, text: str) -> None:
        """A line for `read` has come; it becomes the text buffer."""
        self.is_reading = False
        self.text_buffer = text[:_BUFFER]

    # -- strings --------------------------------------------------------------------------------------

    def _stringcat(self, *parts: float | str) -> Outcome:
        texts = []
        for part in parts:
            if isinstance(part, str):
                texts.append(self.text_buffer if part == "$str" else part)
            else:
                texts.append(f"{format_number(part)} ")
        return self._keep_text("".join(texts))

    def _tointstring(self, value: float) -> Outcome:
        return self._keep_text(f"{truncate(value)} ")

    def _keep_text(self, text: str) -> Outcome:
        self.text_buffer = text[:_BUFFER]
        self._output.message(f"strbuf {self.text_buffer} \n")
        return self._at_once()

    # -- hardware -------------------------------------------------------------------------------------

    def _vision(self, text: str) -> Outcome:
        self._use_hook("vision", self._text_or_buffer(text), mrc="Not connected to cameraserver \n")
        return self._at_once()

    def _laser(self, text: str) -> Outcome:
        self._use_hook("laser", self._text_or_buffer(text), mrc="No connection to laserserver \n")
        return self._at_once()

    def _get(self, what: str, text: str = "") -> Outcome:
        if what == "guidemark":
            self._vehicle.provide({"guidemarkok": 0.0})
            self._use_hook("get", what, text)
        else:
            self._reject_name(f'get knows no "{what}", only guidemark')
        return self._at_once()

    def _play(self, name: str) -> Outcome:
        self._use_hook("play", name)
        return self._at_once()

    def _speak(self, text: str) -> Outcome:
        text = self._text_or_buffer(text)
        self._use_hook("speak", text, mrc=f'/usr/local/bin/flite -t "{text}"')
        return self._at_once()

    def _open(self, what: str) -> Outcome:
        self._use_hook("open", what, mrc=f"open {what} \n")
        return self._at_once()

    def _writewifi(self, text: str, first: float, second: float) -> Outcome:
        self._use_hook("writewifi", text, first, second)
        return self._at_once()

    def _wallest(self, *parameters: float | str) -> Outcome:
        # Which letters MRC takes beside these is not known.
        knows = str(parameters[0])[1:2] in ("b", "c")
        self._use_hook("wallest", *parameters, mrc="" if knows else "Wrong parameter \n")
        return self._at_once()

    def _barcode(self) -> Outcome:
        self._use_hook("barcode")
        return self._at_once()

    def _text_or_buffer(self, text: str) -> str:
        return self.text_buffer if text[:1] == "$" else text

    def _use_hook(self, name: str, *parameters: float | str, mrc: str = "") -> None:
        """Have a function of the user do what needs hardware.

        Args:
            mrc: what MRC prints instead.
        """
        hook = self._hooks.get(name)
        if hook is not None:
            found = self._call_hook(name, hook, *parameters)
            try:
                self._vehicle.provide(found or {})
            except (BadValue, TypeError, AttributeError) as error:
                raise LineFault(f"the function for {name} returned no system variables: {error}") from error
        elif self._profile.needs_are_checked:
            raise LineFault(
                f'{name} needs hardware: give the mission a function for it, mission.on("{name}", function)'
            )
        elif mrc:
            self._output.message(mrc)

    @staticmethod
    def _call_hook(name: str, hook: Hook, *parameters: float | str) -> Any:
        try:
            return hook(*parameters)
        except Exception as error:
            raise LineFault(f"the function for {name} raised {type(error).__name__}: {error}") from error

    # -- what is not there ------------------------------------------------------------------------------

    def _at_once(self) -> Outcome:
        self._interpreter.default_end = always
        return Outcome.WAIT

    def _reject_name(self, reason: str, mrc: str = "") -> None:
        """Fail because of a name, or say what MRC says and go on."""
        if self._profile.names_are_checked:
            raise LineFault(reason)
        if mrc:
            self._output.message(mrc)

    def _reject_path(self, module: str, function: str, reason: str) -> None:
        functions = self._vehicle.functions
        if module not in functions:
            self._reject_name(f'there is no module "{module}"', "module not found\n")
        elif function not in functions[module]:
            self._reject_name(f'{module} has no "{function}"', "paramlist not found\n")
        if not self._profile.names_are_checked:
            self._output.message("parameter not found \n")
        self._reject_name(reason)


def _radians(angle: float, unit: object) -> float:
    """An angle in degrees, or in radians if there is another parameter, whatever it is."""
    return angle * math.pi / 180.0 if unit is None else angle


def _setter(path: str) -> Callable[[MissionEffects, float], None]:
    """What sets an attribute of the vehicle: ``odometry.pose.x``."""
    *owners, attribute = path.split(".")

    def set_value(effects: MissionEffects, value: float) -> None:
        owner: object = effects._vehicle
        for name in owners:
            owner = getattr(owner, name)
        setattr(owner, attribute, value)

    return set_value


_SETTINGS: Mapping[str, Callable[[MissionEffects, float], None]] = {
    "$odox": _setter("odometry.pose.x"),
    "$odoy": _setter("odometry.pose.y"),
    "$odoth": _setter("odometry.pose.th"),
    "$gyro1off": _setter("heading_offset"),
    "$gyro1gain": _setter("heading_gain"),
    "$odocovE2": _setter("covariance.wheel"),
    "$odocovA2": _setter("covariance.base"),
    "odowidth": _setter("odometry.width"),
    "odocontrol": lambda effects, value: setattr(effects._vehicle.odometry, "heading_source", truncate(value)),
    "gyrotype": lambda effects, value: setattr(effects._vehicle.odometry, "is_rate", truncate(value) != 0),
    "odoratio": MissionEffects._set_odometry_ratio,
    "odoc0": MissionEffects._set_odometry_mean,
    "conditioncounter": MissionEffects._set_counter,
    "usekalmanodo": MissionEffects._set_kalman,
    "xmlon": lambda effects, value: effects.client.set_xml(truncate(value) != 0),
}
