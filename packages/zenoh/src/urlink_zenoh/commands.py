"""Commands that a client can send to a robot: each calls a method of the robot with arguments from JSON."""

from __future__ import annotations

import enum
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from urlink import BadValue, Handle, LinkError, Robot, SafetyStop, ScriptError, Trajectory

__all__ = ["COMMANDS", "Command", "Kind", "failed", "read_arguments"]


class Kind(enum.Enum):
    """Effect of a command; commands of the same kind are executed one after the other."""

    #: moves the arm, passes the interlock, and ends when its client is lost
    MOTION = "motion"
    #: stops the arm
    STOP = "stop"
    #: does neither
    SETTING = "setting"


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        name: Name by which clients call it.
        kind: Effect of the command; see `Kind`.
        method: Function that returns the method of a robot that executes the command.
        hidden: Parameters of the method that a client cannot pass.
    """

    name: str
    kind: Kind
    method: Callable[[Robot], Callable[..., Any]]
    hidden: frozenset[str] = frozenset()

    def call(self, robot: Robot, arguments: Mapping[str, Any]) -> Any:
        """Execute the command.

        Raises:
            BadValue: If the arguments do not fit the method. Nothing is sent.
            LinkError: If the method raises it.
        """
        method = self.method(robot)
        hidden = sorted(self.hidden & arguments.keys())
        try:
            if hidden:
                raise TypeError(f"unexpected argument {hidden[0]!r}")
            inspect.signature(method).bind(**arguments)
        except TypeError as error:
            raise BadValue(f"{self.name}: {error}") from None
        try:
            return method(**arguments)
        except TypeError as error:
            # For example text instead of a number. The methods check their arguments before they send anything.
            raise BadValue(f"{self.name}: {error}") from error


def _follow(robot: Robot) -> Callable[..., Handle]:
    def follow(time: Any, q: Any, qd: Any = None, qdd: Any = None, **options: Any) -> Handle:
        unknown = options.keys() - _FOLLOW_OPTIONS
        if unknown:
            raise BadValue(f"follow: unexpected argument {min(unknown)!r}")
        return robot.motion.follow(Trajectory.from_arrays(time, q, qd, qdd), **options)

    return follow


_FOLLOW_OPTIONS = frozenset(
    {"low_bandwidth", "path_tolerance", "goal_tolerance", "goal_time", "start_tolerance", "watchdog"}
    | {"lookahead_time", "gain", "link"}
)
_WAIT = frozenset({"wait"})


def _commands() -> dict[str, Command]:
    motions = ("move_joints", "move_linear", "move_circular", "speed_joints", "speed_linear")
    outputs = ("digital_out", "configurable_digital_out", "tool_digital_out", "analog_out", "tool_voltage", "flag")
    settings = ("set_payload", "set_gravity", "set_tcp", "set_speed_slider", "popup")
    dashboard = ("power_on", "power_off", "brake_release", "unlock_protective_stop", "restart_safety")
    dialogues = ("close_safety_popup", "close_popup", "load")

    def of(part: Callable[[Robot], Any], name: str) -> Callable[[Robot], Callable[..., Any]]:
        return lambda robot: getattr(part(robot), name)

    found = [
        *(Command(name, Kind.MOTION, of(lambda robot: robot.motion, name), _WAIT) for name in motions),
        Command("follow", Kind.MOTION, _follow),
        Command("stop", Kind.STOP, of(lambda robot: robot.motion, "stop"), _WAIT),
        Command("enable", Kind.SETTING, of(lambda robot: robot.safety, "enable")),
        *(Command(f"set_{name}", Kind.SETTING, of(lambda robot: robot.io, f"set_{name}")) for name in outputs),
        *(Command(name, Kind.SETTING, of(lambda robot: robot, name)) for name in settings),
        *(Command(name, Kind.SETTING, of(lambda robot: robot.dashboard, name)) for name in (*dashboard, *dialogues)),
    ]
    return {command.name: command for command in found}


#: Commands by name. `cancel` is not in it, because the server implements it.
COMMANDS: Mapping[str, Command] = _commands()


def read_arguments(payload: bytes | None) -> dict[str, Any]:
    """Read the arguments of a query.

    Raises:
        BadValue: If they are not a JSON object.
    """
    if not payload:
        return {}
    try:
        arguments = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise BadValue(f"the arguments are not valid JSON: {error}") from None
    if not isinstance(arguments, dict):
        raise BadValue(f"the arguments are a {type(arguments).__name__}; expected a JSON object of names and values")
    return arguments


def failed(error: BaseException) -> dict[str, Any]:
    """Return the content of an error reply to a query."""
    said: dict[str, Any] = {"error": type(error).__name__, "message": str(error)}
    if isinstance(error, SafetyStop):
        said["cause"] = error.cause
    if isinstance(error, ScriptError):
        said |= {"line": error.line, "column": error.column, "text": error.text}
    if not isinstance(error, LinkError):
        said["error"] = "LocalError"
    return said
