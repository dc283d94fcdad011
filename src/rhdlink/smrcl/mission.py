"""Missions for a user's program: a script and a robot, executed in a thread or step by step."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from linkcore import clock
from linkcore.arguments import check_callable, check_seconds
from linkcore.errors import BadValue, LinkTimeout, LocalError
from linkcore.handle import Event, Handle, Lifecycle
from linkcore.names import StrictAttributes
from linkcore.threads import CallbackThread, started

from ..errors import BadMission, MissionFailed, Mistake
from ..host.world import Pose
from .checking import check
from .commands import RESERVED
from .controller import MissionController
from .execution import MissionExecution, WithCallbacks, leaving_at_exit, log_saver
from .interpreter import MissionLimits
from .plan import MissionPlan, PlanLine, split_lines
from .profile import Profile, find_profile
from .robot_conf import RobotConf
from .robot_link import AnyRobot, RobotLink, open_link, suitable_conf

if TYPE_CHECKING:
    from typing_extensions import Self

#: Time that a robot gets to stop when the process ends, in s.
_LEAVE_TIMEOUT = 1.0
#: Maximum size of a script, in bytes. MRC has room for 100000.
LARGEST = 1 << 20


def read_script(path: str | os.PathLike[str]) -> str:
    """Read a script from a file, as UTF-8 or otherwise as Latin-1.

    Every file is valid Latin-1.

    Raises:
        BadValue: If the file cannot be read, or is too large.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise BadValue(f"cannot read {os.fspath(path)}: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > LARGEST:
        raise BadValue(f"{os.fspath(path)} is larger than {LARGEST} bytes, so it is not a script")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


class Mission(StrictAttributes, WithCallbacks):
    """Mission: a script and its robot::

        mission = Mission("square.smr", robot)
        mission.on("text", print)
        mission.run()

    A mission can be run any number of times, each time from its beginning. At the end of a mission, the robot is always
    stopped. If this process is killed, the host must stop the robot.

    Args:
        source: Script: a path, or the text itself if it has more than one line or does not end in ".smr".
        robot: Robot that is connected with write access, an address, or a plugin such as `Turtle()`. A plugin runs in
            this process, as fast as possible. With None, the script can only be checked.
        compat: "sound", or "mrc" for the behaviour of the original; see `Profile`.
        conf: Description of the robot: a `RobotConf`, the path of a `robot.conf`, or the path of its folder, with the
            calibrations of the robot's name. The default is a typical robot with the same variables.
        variables: Variables of the script that exist before it begins.
        limits: Limits of the mission.
        log_folder: Folder for the logs that the script saves. The rows that remain at the end are saved there as
            ``log``. By default, logs are not saved.

    Raises:
        BadValue: If an argument is not valid, or the script cannot be read.
    """

    def __init__(
        self,
        source: str | os.PathLike[str],
        robot: AnyRobot | None = None,
        *,
        compat: Profile | str = "sound",
        conf: RobotConf | str | os.PathLike[str] | None = None,
        variables: Mapping[str, float] | None = None,
        limits: MissionLimits | None = None,
        log_folder: str | os.PathLike[str] | None = None,
    ) -> None:
        super().__init__()
        is_path = not isinstance(source, str) or ("\n" not in source and source.endswith(".smr"))
        self.name = Path(source).name if is_path else "script"
        self.source = read_script(source) if is_path else str(source)
        self.profile = find_profile(compat)
        self._robot = robot
        self._conf = conf
        self._variables = dict(variables or {})
        self._limits = limits
        self._log_folder = log_folder

    # -- a user's program ----------------------------------------------------------------------------

    def function(self, name: str, function: Callable[..., float]) -> Self:
        """Register a function for expressions: ``mission.function("dist", math.dist)``.

        Returns the mission.

        Raises:
            BadValue: If the name is not allowed or already in use, or the function is not callable.
        """
        check_callable(function, "function")
        if not (name.isascii() and name.isalnum() and name[:1].isalpha()) or name in RESERVED:
            raise BadValue(
                f"a function cannot be named {name!r}; expected letters and digits, but not a word of SMR-CL"
            )
        self._callbacks.functions[name] = function
        return self

    # -- checking ------------------------------------------------------------------------------------

    def check(self) -> list[Mistake]:
        """List every mistake that can be found before the script runs, in order of its lines."""
        return self._check(None)

    def _check(self, system: Collection[str] | None) -> list[Mistake]:
        return check(
            MissionPlan(split_lines(self.source, cuts=False)),
            functions=self._callbacks.functions,
            variables=self._variables,
            checks_numbers=self.profile.numbers_are_checked,
            system=system,
        )

    # -- running -------------------------------------------------------------------------------------

    def run(self, timeout: float | None = None) -> MissionRun:
        """Run the mission in this thread, to its end.

        Args:
            timeout: Time in seconds after which the mission is cancelled. If None, there is no limit.

        Returns:
            The finished run.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
            LinkTimeout: If the mission does not end in time, or the robot does not answer. In the first case, the robot
                is stopped.
            BadMission: If the script contains mistakes. Nothing is executed.
            MissionFailed: If a line cannot be executed.
            BadConfiguration: If `conf` cannot be read, or contains an invalid setting.
            AccessDenied, WrongVariables: If the robot cannot be driven. Connecting can raise other errors; see
                `rhdlink.connect`.
            ConnectionLost: If the robot disconnects.
        """
        seconds = math.inf if timeout is None else check_seconds(timeout, "timeout")
        run = self._prepare()
        run._run(clock.now() + seconds)
        if run.error is not None:
            raise run.error
        return run

    def start(self) -> MissionRun:
        """Run the mission in another thread.

        Returns:
            The handle of the run.

        Raises:
            LinkError: If the mission cannot begin; see `run`.
        """
        run = self._prepare()
        run._start()
        return run

    def debug(self, breakpoints: Iterable[int] = ()) -> Debugger:
        """Run the mission step by step, and up to breakpoints.

        The robot stops whenever the mission is held.

        Args:
            breakpoints: Line numbers in the file.

        Raises:
            LinkError: If the mission cannot begin; see `run`.
        """
        return Debugger(self._prepare(), breakpoints)

    def _prepare(self) -> MissionRun:
        if self._robot is None:
            raise BadValue("the mission has no robot, so it can be checked but not run; pass robot=")
        link = open_link(self._robot)
        owned = None if link is self._robot else link
        try:
            controller = self._controller(link)
        except BaseException:
            if owned is not None:
                owned.close()
            raise
        execution = MissionExecution(link, controller, self._callbacks, log_saver(self._log_folder))
        return MissionRun(self.name, execution, owned)

    def _controller(self, link: RobotLink) -> MissionController:
        controller = MissionController(
            suitable_conf(self._conf, link),
            link.read,
            link.write,
            profile=self.profile,
            functions=self._callbacks.functions,
            hooks=self._callbacks.hooks,
            limits=self._limits,
        )
        symbols = controller.vehicle.symbols
        if self.profile.checks_first and (mistakes := self._check(symbols.system)):
            raise BadMission(self.name, mistakes)
        for name, value in self._variables.items():
            if (symbol := symbols.make(name)) is not None:
                symbols.pool[symbol.place] = float(value)
        controller.load(self.source)
        return controller

    def __repr__(self) -> str:
        return f"<Mission {self.name}, {self.source.count(chr(10)) + 1} lines, profile {self.profile.name}>"


class MissionRun(Handle):
    """Handle of one run of a mission. Made by `Mission`."""

    def __init__(self, name: str, execution: MissionExecution, owned: RobotLink | None) -> None:
        super().__init__(Lifecycle(name, CallbackThread(f"mission {name} callbacks")))
        self._execution = execution
        self._owned = owned

    # -- its current state ----------------------------------------------------------------------------

    @property
    def line(self) -> int:
        """Number of the current or last line in the file; 0 before the first line."""
        return self._line.number if self._line is not None else 0

    @property
    def text(self) -> str:
        """Text of the current or last line."""
        return self._line.text.strip() if self._line is not None else ""

    @property
    def _line(self) -> PlanLine | None:
        run = self._execution.controller.run
        return None if run is None else run.line

    @property
    def progress(self) -> float:
        """Position in the script, from 0 to 1. It is 1 only after the script has reached its end."""
        if self.done and self.error is None:
            return 1.0
        run = self._execution.controller.run
        lines = 0 if run is None else len(run.plan.lines)
        return max(self.line - 1, 0) / lines if lines else 0.0

    @property
    def conditions(self) -> tuple[bool, ...]:
        """Last values of the stop conditions of the current or last line."""
        return self._execution.controller.interpreter.conditions

    @property
    def cycles(self) -> int:
        """Number of ticks of the robot so far."""
        return self._execution.cycles

    @property
    def pose(self) -> Pose:
        """Pose of the robot from the mission's odometry: x in m, y in m, heading in rad."""
        pose = self._execution.controller.vehicle.odometry.pose
        return Pose(pose.x, pose.y, pose.th)

    @property
    def variables(self) -> Mapping[str, float | tuple[float, ...]]:
        """Variables of the script, by name; arrays as tuples."""
        symbols = self._execution.controller.vehicle.symbols
        found: dict[str, float | tuple[float, ...]] = {}
        for name, symbol in list(symbols.user.items()):
            values = tuple(symbols.pool[symbol.place : symbol.place + symbol.size])
            found[name] = values[0] if symbol.size == 1 else values
        return found

    def system(self, name: str) -> float:
        """Return the last value of a system variable: ``run.system("$targetdist")``.

        Raises:
            BadValue: If there is no such system variable.
        """
        symbols = self._execution.controller.vehicle.symbols
        symbol = symbols.system.get(name.removeprefix("$"))
        if symbol is None:
            raise BadValue(f"the robot has no system variable {name}")
        return symbols.pool[symbol.place]

    # -- its life ------------------------------------------------------------------------------------

    def wait(self, timeout: float = 3600.0, *, cancel: bool = True) -> None:
        """Wait for the end of the mission, by default for at most one hour; see `Handle.wait`."""
        super().wait(timeout, cancel=cancel)

    def cancel(self) -> None:
        """End the mission and stop the robot at its next tick.

        `cancel` returns immediately, and `wait` returns when the robot is at rest.
        """
        if self._life.happened(Event.SEND):
            self._life.fire(Event.BRAKE)
        else:
            self._close()
            self._life.cancel("cancelled")

    def _start(self) -> None:
        self._life.fire(Event.SEND)
        thread = threading.Thread(target=self._run_in_thread, name=f"mission {self.name}", daemon=True)
        try:
            started(thread)
        except LocalError:
            self._close()
            raise

    def _run_in_thread(self) -> None:
        with leaving_at_exit(self._leave):
            self._run()

    def _leave(self) -> None:
        self.cancel()
        self._life.wait(_LEAVE_TIMEOUT)

    def _run(self, until: float = math.inf) -> None:
        self._begin()
        try:
            while not (self.done or self._life.happened(Event.BRAKE)):
                if not self._execution.cycle():
                    break
                if until < math.inf and clock.now() > until:
                    raise LinkTimeout(f"{self.name} did not end in time; it was cancelled, and the robot was stopped")
        except BaseException as error:
            self._execution.stand()
            self._end(error if isinstance(error, Exception) else MissionFailed(f"interrupted by {error!r}"))
            if not isinstance(error, Exception):
                raise
            return
        if not self._execution.controller.is_finished:
            self._execution.stand()
        self._end(self._execution.error)

    def _begin(self) -> None:
        self._life.fire(Event.SEND)
        self._life.begin()

    def _end(self, error: Exception | None) -> None:
        self._close()
        if error is not None:
            self._life.fail(error)
        elif self._life.happened(Event.BRAKE) and not self._execution.controller.is_finished:
            self._life.cancel("cancelled")
        else:
            self._life.finish()

    def _close(self) -> None:
        if self._owned is not None:
            self._owned.close()


class Debugger(StrictAttributes):
    """Mission that is executed line by line.

    `Mission.debug` makes it. Use it as a context manager to close it at the end of a block.

    Attributes:
        breakpoints: Numbers of the lines before which `resume` stops.
        run: Handle of the run, with its variables, pose and so on.
    """

    def __init__(self, run: MissionRun, breakpoints: Iterable[int]) -> None:
        self.run = run
        self.breakpoints = set(breakpoints)
        self._execution = run._execution
        self._steps = True
        self._passes = False
        self._next: PlanLine | None = None
        run._begin()
        self._execution.controller.interpreter.holds = self._holds

    def _holds(self, line: PlanLine) -> bool:
        if self._passes:
            self._passes = False
            return False
        self._next = line
        return self._steps or line.number in self.breakpoints

    @property
    def line(self) -> int | None:
        """Number of the line in the file that comes next; None after the mission has ended."""
        return None if self.run.done or self._next is None else self._next.number

    @property
    def text(self) -> str:
        """Text of the line that comes next."""
        return "" if self.run.done or self._next is None else self._next.text.strip()

    def step(self) -> int | None:
        """Execute the next line, until the line after it is due to begin.

        Returns:
            The number of that next line; None after the mission has ended.

        Raises:
            MissionFailed: If the line cannot be executed.
            ConnectionLost, LinkTimeout: If the robot disconnects or does not answer.
        """
        self._steps = True
        return self._go_on()

    def resume(self) -> int | None:
        """Execute until the next breakpoint.

        Returns:
            The number of the line at the breakpoint; None after the mission has ended.

        Raises:
            LinkError: If a line cannot be executed, or the robot does not answer; see `step`.
        """
        self._steps = False
        return self._go_on()

    def _go_on(self) -> int | None:
        if self.run.done:
            return None
        controller = self._execution.controller
        self._passes = self._next is not None
        try:
            while True:
                if not self._execution.cycle():
                    self._finish()
                    break
                if controller.is_held:
                    # Exchange once more, to send the stop command to the robot.
                    self._execution.cycle()
                    break
        except Exception:
            self.close()
            raise
        return self.line

    def _finish(self) -> None:
        error = self._execution.error
        self.run._end(error)
        if error is not None:
            raise error

    def close(self) -> None:
        """Stop the robot and end the mission. Idempotent."""
        if not self.run.done:
            self._execution.stand()
            self.run.cancel()
            self.run._end(None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
