"""Expiry of commands, by the clock of the server that executes them.

A command can be delayed for a long time, for example in a suspended router or in a server without processor time. By
then, its client has abandoned it. Therefore a client asks for the time of the server first. It sends this time back
with its command, together with the maximum age of the command. The server compares its clock only with its own clock.

The server rejects a command that is late, has the time of another server, or was abandoned by its client. The order in
which the command and the notice of its client arrive does not matter.
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

#: Largest age that a client may ask for, in s.
LARGEST_AGE = 60.0
#: Maximum number of abandoned commands to remember.
_REMEMBERED = 10_000


class Expiry:
    """Clock of one served robot, and the commands that were abandoned.

    Args:
        now: Clock, in s.
    """

    def __init__(self, now: Callable[[], float] = clock.now) -> None:
        self._now = now
        self._server = uuid.uuid4().hex
        self._given_up: OrderedDict[str, None] = OrderedDict()
        self._lock = threading.Lock()

    def described(self) -> dict[str, object]:
        """Return the current time and the id of this server."""
        return {"server": self._server, "time": self._now()}

    def give_up(self, command: str) -> None:
        """Note that a client abandoned this command: it must not start, even if it arrives later."""
        with self._lock:
            self._given_up[command] = None
            while len(self._given_up) > _REMEMBERED:
                self._given_up.popitem(last=False)

    def is_given_up(self, command: str | None) -> bool:
        """Whether its client abandoned the command."""
        with self._lock:
            return command in self._given_up

    def check(self, parameters: Mapping[str, str | None]) -> None:
        """Reject a command that must no longer be executed.

        Args:
            parameters: Parameters of its query: `server` and `time` from the answer of the server, `age` in s, and
                `command`, the id of the command.

        Raises:
            BadValue: If a parameter is missing or invalid.
            LinkTimeout: If the command is older than its `age`.
            LocalError: If the time is from another server, or the command was abandoned.
        """
        command = parameters.get("command")
        if not command or parameters.get("server") is None:
            raise BadValue(
                "a command needs the parameters server and time (from the answer of the key clock), age (seconds for "
                "which it is valid after that time), and command (an id that no other command has)"
            )
        asked, age = _number(parameters, "time"), _number(parameters, "age")
        if not 0 < age <= LARGEST_AGE:
            raise BadValue(f"age={age:g}; expected more than 0 s and at most {LARGEST_AGE:g} s")
        if parameters["server"] != self._server:
            raise LocalError("the command is for an earlier server or another robot; ask for the time again")
        late = self._now() - asked
        if not 0 <= late <= age:
            raise LinkTimeout(
                f"the command arrived {late:.1f} s after its client asked for the time, but was valid for {age:g} s; "
                "it was not executed"
            )
        if self.is_given_up(command):
            raise LocalError("the client abandoned the command; it was not executed")


def _number(parameters: Mapping[str, str | None], name: str) -> float:
    try:
        value = float(parameters.get(name) or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadValue(f"{name}={parameters.get(name)!r}; expected a number of seconds")
    return value
