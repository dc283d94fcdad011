"""A robot as a client in another process has it."""

from __future__ import annotations

import contextlib
import itertools
import json
import queue
import uuid
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import zenoh
import zenoh.ext

import urlink
from linkcore import clock
from urlink import (
    BadValue,
    Cancelled,
    LinkError,
    LinkTimeout,
    NotEnabled,
    PacketError,
    RemoteError,
    SafetyStop,
    ScriptError,
)
from urlink.packets import RealtimeState, Stamp, State

from .description import json_of
from .expiry import LARGEST_AGE
from .keys import JSON, PREFIX, check_name, firmware_of, key_of, stamped

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["RemoteRobot", "Sample", "Watch", "robots"]

#: Seconds that Zenoh may take longer to tell that nobody answers.
_GRACE = 1.0
#: Commands that are carried out however late they come: they make the arm stop.
_ALWAYS = frozenset({"cancel", "stop"})
#: Errors of the library that are made of their message alone.
_PLAIN = {
    name: error
    for name in dir(urlink)
    if isinstance(error := getattr(urlink, name), type)
    and issubclass(error, LinkError)
    and not issubclass(error, (SafetyStop, ScriptError, PacketError))
}


class Sample(NamedTuple):
    """A packet of a robot.

    Attributes:
        robot: name of the robot.
        state: the packet, decoded.
        received: when it arrived at the server, by the clocks of the computer there.
        sequence: its number since the server began, counted as the server received them.
    """

    robot: str
    state: State
    received: Stamp
    sequence: int


class Watch:
    """A subscription to the packets of one or many robots; a context manager.

    Attributes:
        received: packets that came.
        missed: packets that the server has received and that did not come, by their numbers. These are given before any
            queue, but for what the server leaves out on purpose (`rate`).
        failed: packets that could not be decoded.
    """

    def __init__(self, session: zenoh.Session, key: str, callback: Callable[[Sample], object]) -> None:
        self.received = self.missed = self.failed = 0
        self._callback = callback
        self._expected: dict[str, int] = {}  # number of the next packet of each robot
        # As one that comes late it gets the newest value, also of robots that come even later.
        self._subscriber = zenoh.ext.declare_advanced_subscriber(
            session,
            key,
            self._heard,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        )

    def close(self) -> None:
        """End it."""
        self._subscriber.undeclare()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _heard(self, sample: zenoh.Sample) -> None:
        try:
            decoded = _decoded(sample)
        except LinkError:
            self.failed += 1
            return
        self.received += 1
        expected = self._expected.get(decoded.robot, decoded.sequence)
        self._expected[decoded.robot] = decoded.sequence + 1
        self.missed += max(decoded.sequence - expected, 0)  # less than expected: its server began anew
        self._callback(decoded)


def robots(session: zenoh.Session, *, prefix: str = PREFIX, timeout: float = 2.0) -> list[str]:
    """The names of the robots that are served now."""
    replies = session.liveliness().get(f"{key_of(prefix, '*')}/alive", timeout=timeout)
    return sorted({str(reply.ok.key_expr).split("/")[-2] for reply in replies if reply.ok is not None})


class RemoteRobot:
    """A robot that a `urlink_zenoh.Server` serves somewhere; a context manager.

    Its motions end when this process ends, or loses its connection: as long as it is open, its liveliness token says
    that somebody is there.

    Args:
        session: of Zenoh; it is not closed with the robot.
        name: of the robot.
        prefix: what all keys begin with.
        timeout: seconds that an answer may take, but for a motion that is waited for.

    Attributes:
        client: the id by which the server knows this client.
    """

    def __init__(self, session: zenoh.Session, name: str, *, prefix: str = PREFIX, timeout: float = 5.0) -> None:
        self.client = uuid.uuid4().hex
        self.name = name
        self._session = session
        self._key = key_of(prefix, check_name(name))
        self._timeout = timeout
        self._token = session.liveliness().declare_token(f"{self._key}/client/{self.client}")
        self._is_closed = False
        #: calls of this object are numbered, and so is the last `stop` or `cancel`
        self._numbers = itertools.count(1)
        self._last_stop = 0

    def close(self) -> None:
        """Let the server know that this client is gone, which ends its motion; idempotent."""
        if not self._is_closed:
            self._is_closed = True
            with contextlib.suppress(zenoh.ZError):  # the session is closed, and with it the token
                self._token.undeclare()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # -- what it says ----------------------------------------------------------------------------------

    @property
    def info(self) -> dict[str, Any]:
        """Who the robot is, which commands it takes, and the layout of its packets.

        Raises:
            LinkTimeout: nobody answers.
        """
        return self._asked("info")

    @property
    def status(self) -> dict[str, Any]:
        """How the robot is, as it was published last. Raises as `info`."""
        return self._asked("status")

    @property
    def latest(self) -> RealtimeState:
        """The newest packet that was published. Raises as `info`."""
        for reply in self._session.get(f"{self._key}/realtime", timeout=self._timeout):
            if reply.ok is not None:
                state = _decoded(reply.ok).state
                if isinstance(state, RealtimeState):
                    return state
        raise LinkTimeout(f"no packet of {self._key}: nobody serves it, or nothing has come of the robot")

    def watch(self, callback: Callable[[Sample], object], interface: str = "realtime") -> Watch:
        """Call back with each packet, in a thread of Zenoh's: a callback that is slow keeps others waiting."""
        return Watch(self._session, f"{self._key}/{interface}", callback)

    # -- what it is told -------------------------------------------------------------------------------

    def call(self, command: str, /, *, wait: bool | float = False, **arguments: Any) -> dict[str, Any]:
        """Let the robot carry out a command.

        Args:
            command: its name, one of ``info["commands"]``.
            wait: until a motion is over, for 60 s or so many seconds; what interrupts the waiting cancels it, and so
                does the end of that time.
            arguments: of the method of the robot, such as ``q=[...]`` of ``move_joints``.

        Returns:
            Of a motion its `id`, `phase` and `progress`.

        Raises:
            LinkTimeout: nobody answers within the timeout, or the motion is not over in time. The command is cancelled
                then, and one that arrives later is refused: it is valid for `timeout` seconds by the server's clock.
            Cancelled: If another thread has called `stop` or `cancel` of this object meanwhile.
            LinkError: what the robot's own method raised there: `SafetyStop`, `BadValue`, ...
        """
        seconds = 60.0 if wait is True else float(wait)
        asked = uuid.uuid4().hex
        number = next(self._numbers)
        if command in _ALWAYS:
            self._last_stop = number
        selector = f"{self._key}/command/{command}?client={self.client};command={asked}"
        if command not in _ALWAYS:
            clock = self._asked("clock")
            if number < self._last_stop:
                raise Cancelled(f"the robot was stopped after {command} was called, so it sends nothing")
            selector += f";server={clock['server']};time={clock['time']!r};age={min(self._timeout, LARGEST_AGE)!r}"
        if seconds:
            selector += ";wait=true"
        payload = {name: getattr(value, "tolist", lambda value=value: value)() for name, value in arguments.items()}
        try:
            answer = self._first(selector, seconds or self._timeout, json_of(payload))
        except LinkTimeout:
            self._give_up(asked)
            if seconds:
                raise LinkTimeout(
                    f"{command} was not over within {seconds:g} s, or nobody serves {self._key}"
                ) from None
            raise
        except LinkError:
            raise
        except BaseException:
            self._give_up(asked)
            raise
        return answer

    def _give_up(self, asked: str) -> None:
        """Have a command cancelled, or refused if it comes; without waiting for an answer, which may never come."""
        with contextlib.suppress(zenoh.ZError):  # the session is closed, and with it this client's motions end
            selector = f"{self._key}/command/cancel?client={self.client}"
            ignored: queue.SimpleQueue[zenoh.Reply] = queue.SimpleQueue()
            self._session.get(selector, ignored.put, payload=json_of({"command": asked}), timeout=self._timeout)

    def _asked(self, what: str) -> dict[str, Any]:
        return self._first(f"{self._key}/{what}", self._timeout, None)

    def _first(self, selector: str, timeout: float, payload: bytes | None) -> dict[str, Any]:
        """The first answer to a query."""
        answers: queue.SimpleQueue[zenoh.Reply | None] = queue.SimpleQueue()
        handler = zenoh.handlers.Callback(answers.put, lambda: answers.put(None))
        self._session.get(selector, handler, payload=payload, timeout=timeout)
        # Not by iterating over the replies: no signal is heard then.
        with contextlib.suppress(queue.Empty):
            while (reply := clock.get(answers, timeout + _GRACE)) is not None:
                if reply.ok is not None:
                    return dict(_json(reply.ok.payload))
                if reply.err is not None and reply.err.encoding == JSON:
                    raise _raised(_json(reply.err.payload))
        raise LinkTimeout(f"no answer from {selector.partition('?')[0]} within {timeout:g} s")


def _json(payload: zenoh.ZBytes) -> dict[str, Any]:
    try:
        content = json.loads(bytes(payload))
    except ValueError as error:
        raise RemoteError(f"the answer is no JSON: {error}") from None
    if not isinstance(content, dict):
        raise RemoteError(f"the answer is {content!r}; expected an object")
    return content


def _raised(said: dict[str, Any]) -> LinkError:
    """The error that a server tells of, as it would be raised there."""
    name, message = str(said.get("error")), str(said.get("message"))
    if name == "ScriptError" or {"line", "column", "text"} <= said.keys():
        return ScriptError(said["line"], said["column"], said["text"])
    if "cause" in said:
        return (NotEnabled if name == "NotEnabled" else SafetyStop)(message, str(said["cause"]))
    return _PLAIN.get(name, RemoteError)(message)


def _decoded(sample: zenoh.Sample) -> Sample:
    """A packet out of what was published.

    Raises:
        PacketError, BadValue: it is none.
    """
    named = firmware_of(sample.encoding)
    if named is None:
        raise BadValue(f"{sample.key_expr} has the encoding {sample.encoding}; expected packets of a robot")
    interface, firmware = named
    sequence, received = stamped(b"" if sample.attachment is None else bytes(sample.attachment))
    states: list[State] = list(urlink.decode(bytes(sample.payload), interface, firmware))  # type: ignore[call-overload]
    return Sample(str(sample.key_expr).split("/")[-2], states[0], received, sequence)
