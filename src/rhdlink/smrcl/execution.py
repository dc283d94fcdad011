"""The loop of a mission on a robot: exchange, compute, and what a user's program sees of it."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linkcore.arguments import check_callable
from linkcore.errors import BadValue, LinkError

from ..errors import MissionFailed, MissionLimit
from .commands import COMMANDS
from .controller import MissionController
from .effects import Hook
from .recipients import Said, SaidKind
from .robot_link import RobotLink

if TYPE_CHECKING:
    from typing_extensions import Self

_log = logging.getLogger(__name__)

#: Gives a value in each cycle: a number, or for "line" and "ir" as many as there are sensors.
Provider = Callable[[], "float | Sequence[float]"]

#: Seconds for the last words to a robot that does not answer.
_STAND_TIMEOUT = 0.5


#: Commands that a function can carry out.
_COMMANDS = frozenset(command.name for command in COMMANDS.values() if command.hook is not None)
_OBSERVED = frozenset(kind.value for kind in SaidKind if kind is not SaidKind.LOG)


@dataclass
class Callbacks:
    """The callbacks of a user's program. All of them are called between two ticks, so they have to be quick.

    Attributes:
        hooks: what carries out commands that need hardware, by the name of the command.
        observers: functions that are called with texts, by kind: "line", "values", "message", "text", "event".
        readers: functions that are called with all output.
        providers: of sensors and system variables, by name.
        functions: for expressions, by name.
    """

    hooks: dict[str, Hook] = field(default_factory=dict)
    observers: dict[str, list[Callable[[str], object]]] = field(default_factory=dict)
    readers: list[Callable[[Said], object]] = field(default_factory=list)
    providers: dict[str, Provider] = field(default_factory=dict)
    functions: dict[str, Callable[..., float]] = field(default_factory=dict)

    def tell(self, said: Said) -> None:
        """Call the readers, and the observers of this kind. What one raises is logged; the others are called."""
        for reader in self.readers:
            self._call(reader, said)
        for observer in self.observers.get(said.kind.value, ()):
            self._call(observer, said.text.rstrip("\n"))

    @staticmethod
    def _call(function: Callable[[Any], object], what: Any) -> None:
        try:
            function(what)
        except Exception:
            _log.exception("%r raised", function)


class WithCallbacks:
    """What takes callbacks of a user's program: a mission, or its server."""

    def __init__(self) -> None:
        self._callbacks = Callbacks()

    def on(self, name: str, function: Callable[..., object]) -> Self:
        """Have a function carry out a command, or get the output of one kind. Returns this.

        A command that needs hardware ("vision", "laser", "get", "play", "speak", "open", "writewifi", "wallest",
        "barcode", "movetoxyz") calls it with its parameters; it may return system variables by name, as in
        ``{"vis0": 1.0}``. The one for "read" returns the text that was asked for.

        For "line" the function is called with each line that is executed, for "values" with the values of `eval`, for
        "text" with the text of `print`, for "event" and "message" with each of these.

        All of it is called between two ticks of the robot and has to be quick.

        Raises:
            BadValue: there is nothing of that name, or it cannot be called.
        """
        check_callable(function, "function")
        if name in _COMMANDS:
            self._callbacks.hooks[name] = function  # type: ignore[assignment]
        elif name in _OBSERVED:
            self._callbacks.observers.setdefault(name, []).append(function)
        else:
            names = ", ".join(sorted(_COMMANDS | _OBSERVED))
            raise BadValue(f"a mission has no {name!r}; expected one of {names}")
        return self

    def on_said(self, function: Callable[[Said], object]) -> Self:
        """Have a function get all output of the mission, in its order and with its kind. Returns this.

        Raises:
            BadValue: it cannot be called.
        """
        check_callable(function, "function")
        self._callbacks.readers.append(function)
        return self

    def provide(self, name: str, provider: Provider) -> Self:
        """Have a function give a value in each cycle. Returns this.

        Args:
            name: "line" for the brightness under each line sensor, 0 for black and 1 for white; "ir" for the five
                infrared distances in m, from left to right; or the name of a built-in system variable.
            provider: is called between two ticks of the robot and has to be quick.

        Raises:
            BadValue: it cannot be called.
        """
        check_callable(provider, "provider")
        self._callbacks.providers[name.removeprefix("$")] = provider
        return self


class MissionExecution:
    """One execution of a mission.

    Args:
        link: to the robot.
        controller: with what is to be executed.
        callbacks: a user's program.
        save_log: is given the name and the text of each log that the script saves, and as "log" what is left in it at
            the end.
        before_step: is called when the robot has answered, before anything is computed.

    Attributes:
        controller: what executes.
        cycles: exchanges with the robot so far.
        is_told: what is to be written next is what was written last.
    """

    def __init__(
        self,
        link: RobotLink,
        controller: MissionController,
        callbacks: Callbacks,
        save_log: Callable[[str, str], object] | None = None,
        before_step: Callable[[], object] | None = None,
    ) -> None:
        self._before_step = before_step
        self.controller = controller
        self.cycles = 0
        self.is_told = False
        self._link = link
        self._callbacks = callbacks
        self._save_log = save_log
        self._request: Mapping[str, Sequence[int]] = controller.first_request()
        self._period = controller.vehicle.control.parameters.period

    def cycle(self) -> bool:
        """One exchange with the robot, and what follows from it; False when the mission is over and the robot stands.

        Raises:
            RemoteError: the robot is gone, or silent.
            MissionFailed: a provider raised.
        """
        controller = self.controller
        raw = self._link.exchange(self._request)
        self.cycles += 1
        if controller.is_finished:
            return False
        if self._callbacks.providers:
            self._provide()
        if self._before_step is not None:
            self._before_step()
        told, self._request = self._request, controller.step(raw, self._time())
        self.is_told = self._request == told
        for said in controller.take_said():
            if said.kind is SaidKind.LOG:
                self._save(said.text)
            else:
                self._callbacks.tell(said)
        self._save_rest()
        return True

    def _time(self) -> float:
        """``$time``: of a robot whose time stands still between two exchanges the time that it has lived."""
        if not self._link.is_lockstep:
            return time.time()
        return self.cycles * self._period if self.controller.vehicle.profile.knows_time else 0.0

    def _provide(self) -> None:
        vehicle = self.controller.vehicle
        for name, provider in self._callbacks.providers.items():
            try:
                value = provider()
                if name == "line":
                    vehicle.see_line(value)  # type: ignore[arg-type]
                elif name == "ir":
                    vehicle.see_distances(value)  # type: ignore[arg-type]
                else:
                    vehicle.variables.provide({name: value})  # type: ignore[dict-item]
            except Exception as error:
                raise MissionFailed(f"what provides {name!r} raised {type(error).__name__}: {error}") from error

    def _save(self, text: str) -> None:
        name, _, rows = text.partition("\n")
        if self._save_log is None:
            _log.warning("the log %r is not saved: the mission has no folder for it", name)
        else:
            self._save_log(name, rows)

    def _save_rest(self) -> None:
        log = self.controller.effects.log
        if self.controller.is_finished and self._save_log is not None and len(log):
            self._save_log("log", log.text)

    @property
    def error(self) -> MissionFailed | None:
        """The error that a user's program gets, for why the mission ended early; None if it did not."""
        failure = self.controller.failure
        if failure is None:
            return None
        kind = MissionLimit if failure.is_limit else MissionFailed
        return kind(failure.reason, failure.line, failure.text, failure.column)

    def stand(self) -> None:
        """Have the robot stand, if it can still be reached. Never raises."""
        request = self.controller.vehicle.stand()
        # The first exchange sends it, the second one shows that it was taken.
        with contextlib.suppress(LinkError):
            for _ in range(2):
                self._link.exchange(request, _STAND_TIMEOUT)
            self._request, self.is_told = request, True


@contextlib.contextmanager
def leaving_at_exit(leave: Callable[[], object]) -> Iterator[None]:
    """While the block lasts, a process that comes to its end calls `leave` first.

    A daemon thread would otherwise be frozen between two ticks, with the robot at its last speeds.
    """
    atexit.register(leave)
    try:
        yield
    finally:
        atexit.unregister(leave)


def log_saver(folder: str | os.PathLike[str] | None) -> Callable[[str, str], object] | None:
    """Saves logs in a folder, and nowhere else; None for no folder."""
    if folder is None:
        return None
    place = Path(folder)

    def save(name: str, text: str) -> None:
        # A script, also one of an untrusted client, may name any file.
        if not name or name in (".", "..") or Path(name).name != name or "\\" in name:
            raise MissionFailed(f"a log cannot be saved as {name!r}; expected a name without a folder")
        try:
            (place / name).write_text(text, encoding="ascii")
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise MissionFailed(f"the log {place / name} cannot be written: {reason}") from error

    return save
