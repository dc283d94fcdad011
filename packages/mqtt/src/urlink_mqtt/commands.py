"""What a client can ask of a robot, how it asks, and until when that may be carried out.

A broker, a network or a server that is suspended delivers late: a command may have been given up by then. So each
status has the time of the server's own clock; a client sends it back with its command and with the age that it may
have at most. The server compares its clock with nothing but its own earlier time, and refuses what is late. Only
``stop`` and ``cancel`` have no age: to stop late is better than not to stop.
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

#: Seconds of the largest age that a client may ask for.
LARGEST_AGE = 60.0

_MOTIONS = ("move_joints", "move_linear", "speed_joints", "speed_linear")
_OUTPUTS = ("set_digital_out", "set_configurable_digital_out", "set_tool_digital_out", "set_analog_out")
_SETTINGS = ("set_payload", "set_tcp", "set_speed_slider")
_DASHBOARD = ("power_on", "power_off", "brake_release", "unlock_protective_stop", "load")


def _of(part: Callable[[Robot], Any], name: str) -> Callable[[Robot], Callable[..., Any]]:
    return lambda robot: getattr(part(robot), name)


#: name -> what of a robot carries it out. `stop` and `cancel` are the server's own.
COMMANDS: Mapping[str, Callable[[Robot], Callable[..., Any]]] = {
    **{name: _of(lambda robot: robot.motion, name) for name in _MOTIONS},
    **{name: _of(lambda robot: robot.io, name) for name in _OUTPUTS},
    **{name: _of(lambda robot: robot, name) for name in _SETTINGS},
    **{name: _of(lambda robot: robot.dashboard, name) for name in _DASHBOARD},
    "enable": _of(lambda robot: robot.safety, "enable"),
}
#: Those that move the arm, and end with the client that asked for them.
MOTIONS = frozenset(_MOTIONS)


@dataclasses.dataclass(frozen=True)
class Asked:
    """A command as a client asks for it.

    Attributes:
        client: who asks; "" for nobody in particular.
        id: by which the client knows the answer.
        server, time: of the newest status that it has.
        age: s for which it may be carried out after that time.
        arguments: of the robot's method.
    """

    client: str = ""
    id: str = ""
    server: str = ""
    time: float = math.nan
    age: float = math.nan
    arguments: Mapping[str, Any] = dataclasses.field(default_factory=dict)


_NAMES = [field.name for field in dataclasses.fields(Asked)]


def read(payload: bytes) -> Asked:
    """A command out of a message; an empty message is one without anything.

    Raises:
        BadValue: it is no JSON object of these names, or a value has another type.
    """
    try:
        said = json.loads(payload or b"{}")
    except (ValueError, RecursionError) as error:
        raise BadValue(f"the command is no JSON: {error}") from None
    if not isinstance(said, dict) or said.keys() - set(_NAMES):
        raise BadValue(f"the command is {str(said)[:80]}; expected an object with some of {', '.join(_NAMES)}")
    for name, kind in (("client", str), ("id", str), ("server", str), ("time", float | int), ("age", float | int)):
        if name in said and (not isinstance(said[name], kind) or isinstance(said[name], bool)):
            raise BadValue(f"{name} is {str(said[name])[:80]!r}; expected {'text' if kind is str else 'a number of s'}")
    if not isinstance(said.get("arguments", {}), dict):
        raise BadValue("arguments are no object of names and values")
    return Asked(**said)


def begin(robot: Robot, name: str, arguments: Mapping[str, Any]) -> Any:
    """Carry a command out; of a motion its handle.

    Raises:
        BadValue: no such command, or the arguments are not those of the method; nothing was sent.
        LinkError: whatever the method raises.
    """
    if name not in COMMANDS:
        raise BadValue(f"no command {name!r:.80}; expected one of cancel, stop, {', '.join(sorted(COMMANDS))}")
    method = COMMANDS[name](robot)
    try:
        if "wait" in arguments:
            raise TypeError("got an unexpected keyword argument 'wait'")
        inspect.signature(method).bind(**arguments)
        return method(**arguments)
    except TypeError as error:
        # Also text where a number belongs, say: arguments are looked at before anything is sent.
        raise BadValue(f"{name}: {error}") from error


class ServerClock:
    """The clock of one server, by which commands expire.

    Args:
        now: Monotonic clock, in seconds.

    Attributes:
        now: as given.
    """

    def __init__(self, now: Callable[[], float] = clock.now) -> None:
        self.now = now
        self._server = uuid.uuid4().hex

    def described(self) -> dict[str, Any]:
        """The time, and whose it is, as a client sends them back."""
        return {"server": self._server, "time": self.now()}

    def check(self, asked: Asked) -> None:
        """Refuse a command that must not be carried out any more.

        Raises:
            BadValue: it has no time and age, or an age that is too large.
            LinkTimeout: it is older than it may be.
            LocalError: the time is that of another server.
        """
        if not asked.server or not math.isfinite(asked.time) or not 0 < asked.age <= LARGEST_AGE:
            raise BadValue(
                "a command needs server and time, as the newest status has them, and age: the seconds for which it may "
                f"be carried out after that time, more than 0 and at most {LARGEST_AGE:g}"
            )
        if asked.server != self._server:
            raise LocalError("the command was meant for a server that is gone, or for another robot")
        late = self.now() - asked.time
        if not 0 <= late <= asked.age:
            raise LinkTimeout(
                f"the command came {late:.1f} s after the status that its client had, and was to be refused after "
                f"{asked.age:g} s: nothing was done"
            )
