"""Client for robots that are served in other processes."""

from __future__ import annotations

import contextlib
import json
import queue
import uuid
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import zenoh
import zenoh.ext

import urlink
from linkcore import clock
from linkcore.numbering import Numbering
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

#: Time, in s, that Zenoh may exceed a timeout before it reports that no answer arrived.
_GRACE = 1.0
#: Commands that the server executes no matter how late they arrive, because they stop the arm.
_ALWAYS = frozenset({"cancel", "stop"})
#: Errors of urlink that are constructed from a message alone, by name.
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
        robot: Name of the robot.
        state: Decoded packet.
        received: Time at which the packet arrived at the server, by the clocks of that computer.
        sequence: Number of the packet since the server started, in the order in which the server received them.
    """

    robot: str
    state: State
    received: Stamp
    sequence: int


class Watch:
    """Subscription to the packets of one or many robots; a context manager.

    Attributes:
        received: Number of packets that arrived.
        missed: Number of packets that the server received but that did not arrive here. The server numbers packets
            before any queue; it does not number packets that it leaves out on purpose (`rate`).
        failed: Number of packets that could not be decoded.
    """

    def __init__(self, session: zenoh.Session, key: str, callback: Callable[[Sample], object]) -> None:
        self.received = self.missed = self.failed = 0
        self._callback = callback
        self._expected: dict[str, int] = {}  # number of the next packet of each robot
        # A late subscriber receives the newest value, also from robots that appear later.
        self._subscriber = zenoh.ext.declare_advanced_subscriber(
            session,
            key,
            self._heard,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        )

    def close(self) -> None:
        """End the subscription."""
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
        self.missed += max(decoded.sequence - expected, 0)  # a smaller number means that the server was restarted
        self._callback(decoded)


def robots(session: zenoh.Session, *, prefix: str = PREFIX, timeout: float = 2.0) -> list[str]:
    """Return the names of the robots that are served now."""
    replies = session.liveliness().get(f"{key_of(prefix, '*')}/alive", timeout=timeout)
    return sorted({str(reply.ok.key_expr).split("/")[-2] for reply in replies if reply.ok is not None})


class RemoteRobot:
    """Client for a robot that a `urlink_zenoh.Server` serves; a context manager.

    A motion that it started ends when this process ends or loses its connection. The liveliness token of the object
    shows the server that the client still exists.

    Args:
        session: Zenoh session. It is not closed with the robot.
        name: Name of the robot.
        prefix: First part of all keys.
        timeout: Maximum time, in s, for an answer. It does not limit the wait for the end of a motion.

    Attributes:
        client: Id by which the server identifies this client.
    """

    def __init__(self, session: zenoh.Session, name: str, *, prefix: str = PREFIX, timeout: float = 5.0) -> None:
        self.client = uuid.uuid4().hex
        self.name = name
        self._session = session
        self._key = key_of(prefix, check_name(name))
        self._timeout = timeout
        self._token = session.liveliness().declare_token(f"{self._key}/client/{self.client}")
        self._is_closed = False
        #: The last `stop` or `cancel` has a number too, from the same counter as the calls of this object.
        self._numbers = Numbering()
        self._last_stop = 0

    def close(self) -> None:
        """Remove the liveliness token: the server ends the motion of this client; idempotent."""
        if not self._is_closed:
            self._is_closed = True
            with contextlib.suppress(zenoh.ZError):  # the session is already closed, and the token with it
                self._token.undeclare()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # -- state -----------------------------------------------------------------------------------------

    @property
    def info(self) -> dict[str, Any]:
        """Model and firmware of the robot, the commands it accepts, and the layout of its packets.

        Raises:
            LinkTimeout: If no answer arrives.
        """
        return self._asked("info")

    @property
    def status(self) -> dict[str, Any]:
        """Most recently published status of the robot. For errors, see `info`."""
        return self._asked("status")

    @property
    def latest(self) -> RealtimeState:
        """Most recently published packet. For errors, see `info`."""
        for reply in self._session.get(f"{self._key}/realtime", timeout=self._timeout):
            if reply.ok is not None:
                state = _decoded(reply.ok).state
                if isinstance(state, RealtimeState):
                    return state
        raise LinkTimeout(f"no packet from {self._key}; it is not served, or the robot has not sent a packet yet")

    def watch(self, callback: Callable[[Sample], object], interface: str = "realtime") -> Watch:
        """Call `callback` with each packet, in a thread of Zenoh.

        A slow callback delays all other callbacks.
        """
        return Watch(self._session, f"{self._key}/{interface}", callback)

    # -- commands --------------------------------------------------------------------------------------

    def call(self, command: str, /, *, wait: bool | float = False, **arguments: Any) -> dict[str, Any]:
        """Send a command to the robot.

        Args:
            command: Name of the command, one of ``info["commands"]``.
            wait: Whether to wait until the motion has ended. True waits up to 60 s, a number waits that many seconds.
                If the wait is interrupted or times out, the motion is cancelled.
            arguments: Arguments of the robot's method, such as ``q=[...]`` of ``move_joints``.

        Returns:
            For a motion: its `id`, `phase` and `progress`.

        Raises:
            LinkTimeout: If no answer arrives within the timeout, or the motion does not end in time. The command is
                cancelled then. If it arrives later, the server rejects it, because it is valid for `timeout` seconds by
                the server's clock.
            Cancelled: If another thread called `stop` or `cancel` of this object in the meantime.
            LinkError: If the robot's method raised it at the server, for example `SafetyStop` or `BadValue`.
        """
        seconds = 60.0 if wait is True else float(wait)
        asked = uuid.uuid4().hex
        number = self._numbers.next()
        if command in _ALWAYS:
            self._last_stop = number
        selector = f"{self._key}/command/{command}?client={self.client};command={asked}"
        if command not in _ALWAYS:
            clock = self._asked("clock")
            if number < self._last_stop:
                raise Cancelled(f"the robot was stopped after the call of {command}; nothing was sent")
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
                    f"{command} did not finish within {seconds:g} s, or {self._key} is not served"
                ) from None
            raise
        except LinkError:
            raise
        except BaseException:
            self._give_up(asked)
            raise
        return answer

    def _give_up(self, asked: str) -> None:
        """Cancel a command, or have it rejected if it arrives later.

        Do not wait for an answer: it might never come.
        """
        with contextlib.suppress(zenoh.ZError):  # if the session is closed, the motions of this client end anyway
            selector = f"{self._key}/command/cancel?client={self.client}"
            ignored: queue.SimpleQueue[zenoh.Reply] = queue.SimpleQueue()
            self._session.get(selector, ignored.put, payload=json_of({"command": asked}), timeout=self._timeout)

    def _asked(self, what: str) -> dict[str, Any]:
        return self._first(f"{self._key}/{what}", self._timeout, None)

    def _first(self, selector: str, timeout: float, payload: bytes | None) -> dict[str, Any]:
        """Return the first answer to a query."""
        answers: queue.SimpleQueue[zenoh.Reply | None] = queue.SimpleQueue()
        handler = zenoh.handlers.Callback(answers.put, lambda: answers.put(None))
        self._session.get(selector, handler, payload=payload, timeout=timeout)
        # Do not iterate over the replies: Python would not handle signals during the wait.
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
        raise RemoteError(f"the answer is not valid JSON: {error}") from None
    if not isinstance(content, dict):
        raise RemoteError(f"the answer is {content!r}; expected an object")
    return content


def _raised(said: dict[str, Any]) -> LinkError:
    """Return the error that a server reported, with the type that it has at the server."""
    name, message = str(said.get("error")), str(said.get("message"))
    if name == "ScriptError" or {"line", "column", "text"} <= said.keys():
        return ScriptError(said["line"], said["column"], said["text"])
    if "cause" in said:
        return (NotEnabled if name == "NotEnabled" else SafetyStop)(message, str(said["cause"]))
    return _PLAIN.get(name, RemoteError)(message)


def _decoded(sample: zenoh.Sample) -> Sample:
    """Decode a published packet.

    Raises:
        PacketError, BadValue: If the sample is not a valid packet.
    """
    named = firmware_of(sample.encoding)
    if named is None:
        raise BadValue(f"{sample.key_expr} has the encoding {sample.encoding}; expected an encoding of robot packets")
    interface, firmware = named
    sequence, received = stamped(b"" if sample.attachment is None else bytes(sample.attachment))
    states: list[State] = list(urlink.decode(bytes(sample.payload), interface, firmware))  # type: ignore[call-overload]
    return Sample(str(sample.key_expr).split("/")[-2], states[0], received, sequence)
