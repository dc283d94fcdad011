"""Loop of a mission on a robot, which exchanges values, computes, and calls the user's functions."""

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

#: Function that returns a value in each cycle: a number, or for "line" and "ir" one number per sensor.
Provider = Callable[[], "float | Sequence[float]"]

#: Maximum time for the final stop command to a robot that does not answer, in s.
_STAND_TIMEOUT = 0.5


#: Commands that a user's function can execute.
_COMMANDS = frozenset(command.name for command in COMMANDS.values() if command.hook is not None)
_OBSERVED = frozenset(kind.value for kind in SaidKind if kind is not SaidKind.LOG)


@dataclass
class Callbacks:
    """Callbacks of a user's program.

    All callbacks are called between two ticks, so they must be quick.

    Attributes:
        hooks: Functions for commands that need hardware, by the name of the command.
        observers: Functions that are called with texts, by kind: "line", "values", "message", "text", "event".
        readers: Functions that are called with all output.
        providers: Functions that return values of sensors and system variables, by name.
        functions: Functions for expressions, by name.
    """

    hooks: dict[str, Hook] = field(default_factory=dict)
    observers: dict[str, list[Callable[[str], object]]] = field(default_factory=dict)
    readers: list[Callable[[Said], object]] = field(default_factory=list)
    providers: dict[str, Provider] = field(default_factory=dict)
    functions: dict[str, Callable[..., float]] = field(default_factory=dict)

    def tell(self, said: Said) -> None:
        """Call the readers, and the observers of this kind. Exceptions are logged."""
        for reader in self.readers:
            self._call(reader, said)
        for observer in self.observers.get(said.kind.value, ()):
            self._call(observer, said.text.rstrip("\n"))

    @staticmethod
    def _call(function: Callable[[Any], object], what: Any) -> None:
        try:
            function(what)
        except Exception:
            _log.exception("%r raised an exception", function)


class WithCallbacks:
    """Base class of objects that take callbacks of a user's program: a mission, or its server."""

    def __init__(self) -> None:
        self._callbacks = Callbacks()

    def on(self, name: str, function: Callable[..., object]) -> Self:
        """Register a function that executes a command, or receives one kind of output.

        Returns this object.

        A command that needs hardware ("vision", "laser", "get", "play", "speak", "open", "writewifi", "wallest",
        "barcode", "movetoxyz") calls the function with its parameters. The function can return system variables by
        name, for example ``{"vis0": 1.0}``. The function for "read" returns the requested text.

        For "line", the function is called with each executed line. For "values" it gets the values of `eval`, for
        "text" the text of `print`, and for "event" and "message" each event or message.

        Every function is called between two ticks of the robot and must be quick.

        Raises:
            BadValue: If there is no command or output with this name, or the function is not callable.
        """
        check_callable(function, "function")
        if name in _COMMANDS:
            self._callbacks.hooks[name] = function  # type: ignore[assignment]
        elif name in _OBSERVED:
            self._callbacks.observers.setdefault(name, []).append(function)
        else:
            names = ", ".join(sorted(_COMMANDS | _OBSERVED))
            raise BadValue(f"unknown command or output {name!r}; expected one of {names}")
        return self

    def on_said(self, function: Callable[[Said], object]) -> Self:
        """Register a function that receives all output of the mission. Returns this object.

        The function is called with each output and its kind, in order.

        Raises:
            BadValue: If the function is not callable.
        """
        check_callable(function, "function")
        self._callbacks.readers.append(function)
        return self

    def provide(self, name: str, provider: Provider) -> Self:
        """Register a function that provides a value in each cycle. Returns this object.

        Args:
            name: "line" for the brightness under each line sensor, 0 for black and 1 for white; "ir" for the five
                infrared distances in m, from left to right; or the name of a built-in system variable.
            provider: Function that returns the value. It is called between two ticks of the robot and must be quick.

        Raises:
            BadValue: If the provider is not callable.
        """
        check_callable(provider, "provider")
        self._callbacks.providers[name.removeprefix("$")] = provider
        return self


class MissionExecution:
    """One execution of a mission.

    Args:
        link: Link to the robot.
        controller: Controller with the loaded mission.
        callbacks: Callbacks of a user's program.
        save_log: Function that is called with the name and the text of each log that the script saves. At the end it is
            also called with "log" and the remaining rows.
        before_step: Function that is called after the robot has answered, before anything is computed.

    Attributes:
        controller: Controller that executes the mission.
        cycles: Number of exchanges with the robot so far.
        is_unchanged: Whether the next values to write equal the last written values.
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
        self.is_unchanged = False
        self._link = link
        self._callbacks = callbacks
        self._save_log = save_log
        self._request: Mapping[str, Sequence[int]] = controller.first_request()
        self._period = controller.vehicle.control.parameters.period

    def cycle(self) -> bool:
        """Exchange values with the robot once, and compute.

        Returns:
            False when the mission has ended and the robot is at rest; otherwise True.

        Raises:
            RemoteError: If the robot has disconnected or does not answer.
            MissionFailed: If a provider raises an exception.
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
        self.is_unchanged = self._request == told
        for said in controller.take_said():
            if said.kind is SaidKind.LOG:
                self._save(said.text)
            else:
                self._callbacks.tell(said)
        self._save_rest()
        return True

    def _time(self) -> float:
        """Return the value of ``$time``.

        If the robot's time stops between two exchanges, it is the elapsed time of the robot.
        """
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
                raise MissionFailed(f"the provider of {name!r} raised {type(error).__name__}: {error}") from error

    def _save(self, text: str) -> None:
        name, _, rows = text.partition("\n")
        if self._save_log is None:
            _log.warning("log %r is not saved: the mission has no log_folder", name)
        else:
            self._save_log(name, rows)

    def _save_rest(self) -> None:
        log = self.controller.effects.log
        if self.controller.is_finished and self._save_log is not None and len(log):
            self._save_log("log", log.text)

    @property
    def error(self) -> MissionFailed | None:
        """Error that ended the mission early, for the user's program; None if there was none."""
        failure = self.controller.failure
        if failure is None:
            return None
        kind = MissionLimit if failure.is_limit else MissionFailed
        return kind(failure.reason, failure.line, failure.text, failure.column)

    def stand(self) -> None:
        """Stop the robot if it can still be reached. Never raises an exception."""
        request = self.controller.vehicle.stand()
        # The first exchange sends the request, and the second one shows that the robot received it.
        with contextlib.suppress(LinkError):
            for _ in range(2):
                self._link.exchange(request, _STAND_TIMEOUT)
            self._request, self.is_unchanged = request, True


@contextlib.contextmanager
def leaving_at_exit(leave: Callable[[], object]) -> Iterator[None]:
    """Call `leave` if the process ends during the block.

    A daemon thread would otherwise freeze between two ticks, and the robot would keep its last speeds.
    """
    atexit.register(leave)
    try:
        yield
    finally:
        atexit.unregister(leave)


def log_saver(folder: str | os.PathLike[str] | None) -> Callable[[str, str], object] | None:
    """Return a function that saves logs in a folder, and only there; None if there is no folder."""
    if folder is None:
        return None
    place = Path(folder)

    def save(name: str, text: str) -> None:
        # A script can name any file, and it might come from an untrusted client.
        if not name or name in (".", "..") or Path(name).name != name or "\\" in name:
            raise MissionFailed(f"cannot save a log as {name!r}; expected a name without a folder")
        try:
            (place / name).write_text(text, encoding="ascii")
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise MissionFailed(f"cannot write the log {place / name}: {reason}") from error

    return save
