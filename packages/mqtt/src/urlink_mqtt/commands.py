"""Commands that a client can send to a robot, the form of their messages, and their expiry.

A suspended broker, network or server delivers a command late, and its client might have abandoned it by then. So each
status contains the time of the server's own clock. A client sends this time back with its command, together with the
maximum age of the command. The server compares its clock only with its own earlier time, and rejects late commands.
Only ``stop`` and ``cancel`` have no age, because a late stop is better than no stop.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import uuid
from collections.abc import Callable, Mapping
from typing import Any

from linkcore import clock
from urlink import BadValue, LinkTimeout, LocalError, Robot

__all__ = ["COMMANDS", "LARGEST_AGE", "MOTIONS", "Asked", "ServerClock", "begin", "read"]

#: Largest age that a client may ask for, in s.
LARGEST_AGE = 60.0

_MOTIONS = ("move_joints", "move_linear", "speed_joints", "speed_linear")
_OUTPUTS = ("set_digital_out", "set_configurable_digital_out", "set_tool_digital_out", "set_analog_out")
_SETTINGS = ("set_payload", "set_tcp", "set_speed_slider")
_DASHBOARD = ("power_on", "power_off", "brake_release", "unlock_protective_stop", "load")


def _of(part: Callable[[Robot], Any], name: str) -> Callable[[Robot], Callable[..., Any]]:
    return lambda robot: getattr(part(robot), name)


#: Name of a command, and the function that returns the robot's method for it. The server implements `stop` and
#: `cancel`.
COMMANDS: Mapping[str, Callable[[Robot], Callable[..., Any]]] = {
    **{name: _of(lambda robot: robot.motion, name) for name in _MOTIONS},
    **{name: _of(lambda robot: robot.io, name) for name in _OUTPUTS},
    **{name: _of(lambda robot: robot, name) for name in _SETTINGS},
    **{name: _of(lambda robot: robot.dashboard, name) for name in _DASHBOARD},
    "enable": _of(lambda robot: robot.safety, "enable"),
}
#: Commands that move the arm. Their motions end when their client is lost.
MOTIONS = frozenset(_MOTIONS)


@dataclasses.dataclass(frozen=True)
class Asked:
    """Command as a client sends it.

    Attributes:
        client: Id of the client; "" for none.
        id: Id of the command, which its answer repeats.
        server, time: Values from the newest status that the client has.
        age: Time, in s, for which the command is valid after `time`.
        arguments: Arguments of the robot's method.
    """

    client: str = ""
    id: str = ""
    server: str = ""
    time: float = math.nan
    age: float = math.nan
    arguments: Mapping[str, Any] = dataclasses.field(default_factory=dict)


_NAMES = [field.name for field in dataclasses.fields(Asked)]


def read(payload: bytes) -> Asked:
    """Read a command from a message; an empty message is a command without any values.

    Raises:
        BadValue: If it is not a JSON object with these names, or a value has another type.
    """
    try:
        said = json.loads(payload or b"{}")
    except (ValueError, RecursionError) as error:
        raise BadValue(f"the command is not valid JSON: {error}") from None
    if not isinstance(said, dict) or said.keys() - set(_NAMES):
        raise BadValue(f"the command is {str(said)[:80]}; expected an object with some of {', '.join(_NAMES)}")
    for name, kind in (("client", str), ("id", str), ("server", str), ("time", float | int), ("age", float | int)):
        if name in said and (not isinstance(said[name], kind) or isinstance(said[name], bool)):
            raise BadValue(
                f"{name} is {str(said[name])[:80]!r}; expected {'text' if kind is str else 'a number of seconds'}"
            )
    if not isinstance(said.get("arguments", {}), dict):
        raise BadValue("arguments are not an object; expected an object of names and values")
    return Asked(**said)


def begin(robot: Robot, name: str, arguments: Mapping[str, Any]) -> Any:
    """Execute a command; return the handle of a motion, or the result of another command.

    Raises:
        BadValue: If the command does not exist, or the arguments do not fit its method. Nothing is sent.
        LinkError: If the method raises it.
    """
    if name not in COMMANDS:
        raise BadValue(f"unknown command {name!r:.80}; expected one of cancel, stop, {', '.join(sorted(COMMANDS))}")
    method = COMMANDS[name](robot)
    try:
        if "wait" in arguments:
            raise TypeError("got an unexpected keyword argument 'wait'")
        inspect.signature(method).bind(**arguments)
        return method(**arguments)
    except TypeError as error:
        # For example text instead of a number. The methods check their arguments before they send anything.
        raise BadValue(f"{name}: {error}") from error


class ServerClock:
    """Clock of one server, used to expire commands.

    Args:
        now: Monotonic clock, in seconds.

    Attributes:
        now: Monotonic clock, in seconds.
    """

    def __init__(self, now: Callable[[], float] = clock.now) -> None:
        self.now = now
        self._server = uuid.uuid4().hex

    def described(self) -> dict[str, Any]:
        """Return the time and the id of the server, in the form in which a client sends them back."""
        return {"server": self._server, "time": self.now()}

    def check(self, asked: Asked) -> None:
        """Reject a command that must no longer be executed.

        Raises:
            BadValue: If it has no time or age, or its age is too large.
            LinkTimeout: If it is older than its `age`.
            LocalError: If the time is from another server.
        """
        if not asked.server or not math.isfinite(asked.time) or not 0 < asked.age <= LARGEST_AGE:
            raise BadValue(
                "a command needs server and time (from the newest status), and age: the seconds for which it is valid "
                f"after that time, more than 0 and at most {LARGEST_AGE:g}"
            )
        if asked.server != self._server:
            raise LocalError(
                "the command is for an earlier server or another robot; use the newest status of this robot"
            )
        late = self.now() - asked.time
        if not 0 <= late <= asked.age:
            raise LinkTimeout(
                f"the command arrived {late:.1f} s after the status that it refers to, but was valid for "
                f"{asked.age:g} s; it was not executed"
            )
