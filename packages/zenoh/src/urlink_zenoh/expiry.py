"""Until when a command may be carried out, by the one clock of the server that carries it out.

A command can be held up for long on its way: in a router that was suspended, in a server that got no processor time.
Its client has given it up by then. So a client asks for the time of the server first, and sends it back with its
command and with the age that it may have at most: the server compares its clock with nothing but its own clock. It
refuses what is late, what carries the time of another server, and what its client has given up, whichever of the two
arrives first.
"""

from __future__ import annotations

import math
import threading
import uuid
from collections import OrderedDict
from collections.abc import Callable, Mapping

from linkcore import clock
from urlink import BadValue, LinkTimeout, LocalError

__all__ = ["LARGEST_AGE", "Expiry"]

#: Seconds of the largest age that a client may ask for.
LARGEST_AGE = 60.0
#: Commands that were given up and are remembered.
_REMEMBERED = 10_000


class Expiry:
    """The clock of one served robot, and the commands that were given up.

    Args:
        now: seconds of the clock.
    """

    def __init__(self, now: Callable[[], float] = clock.now) -> None:
        self._now = now
        self._server = uuid.uuid4().hex
        self._given_up: OrderedDict[str, None] = OrderedDict()
        self._lock = threading.Lock()

    def described(self) -> dict[str, object]:
        """The time, and whose it is."""
        return {"server": self._server, "time": self._now()}

    def give_up(self, command: str) -> None:
        """A client has given this command up: it is not to be carried out if it comes, or has not begun."""
        with self._lock:
            self._given_up[command] = None
            while len(self._given_up) > _REMEMBERED:
                self._given_up.popitem(last=False)

    def is_given_up(self, command: str | None) -> bool:
        """Whether its client has given it up."""
        with self._lock:
            return command in self._given_up

    def check(self, parameters: Mapping[str, str | None]) -> None:
        """Refuse a command that must not be carried out any more.

        Args:
            parameters: of its query: `server` and `time` as they were asked for, `age` in seconds, `command` its id.

        Raises:
            BadValue: a parameter is missing, or is not what it should be.
            LinkTimeout: it is older than it may be.
            LocalError: the time is that of another server, or the command was given up.
        """
        command = parameters.get("command")
        if not command or parameters.get("server") is None:
            raise BadValue(
                "a command needs the parameters server and time, which the key clock answers, age (the seconds for "
                "which it may be carried out after that time), and command (an id that no other command has)"
            )
        asked, age = _number(parameters, "time"), _number(parameters, "age")
        if not 0 < age <= LARGEST_AGE:
            raise BadValue(f"age={age:g}; expected more than 0 and at most {LARGEST_AGE:g} s")
        if parameters["server"] != self._server:
            raise LocalError("the command was meant for a server that is gone, or not for this robot; ask for the time")
        late = self._now() - asked
        if not 0 <= late <= age:
            raise LinkTimeout(
                f"the command came {late:.1f} s after its client asked for the time, and was to be refused "
                f"after {age:g} s: nothing was done"
            )
        if self.is_given_up(command):
            raise LocalError("its client has given the command up: nothing was done")


def _number(parameters: Mapping[str, str | None], name: str) -> float:
    try:
        value = float(parameters.get(name) or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadValue(f"{name}={parameters.get(name)!r}; expected a number of seconds")
    return value
