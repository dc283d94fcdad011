"""Output of a mission, and the receivers of this output.

A receiver is the session of a client, or an outbox if there is no client.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from .arithmetic import format_number
from .plan import LONGEST_LINE, MissionPlan, PlanLine

#: Maximum number of messages that are stored for one cycle. A script can print 20000 messages in a cycle.
_MOST = 50_000
#: Maximum number of events of a client, and of variables in its stream, as in MRC.
MOST_EVENTS, MOST_STREAMED = 100, 20
#: Maximum number of bytes buffered for a client before its session is closed.
_MOST_WAITING = 1 << 20
#: Number of buffered lines above which no more bytes should be read from the client.
MOST_BACKLOG = 1000


class SaidKind(enum.Enum):
    """Kind of an output."""

    #: A line is about to be executed.
    LINE = "line"
    #: Values of `eval`.
    VALUES = "values"
    #: Message of a command or an error, for a person who watches the mission.
    MESSAGE = "message"
    #: Text of `print` and `read`, without a client.
    TEXT = "text"
    #: Event of `putevent`, `syncevent`, a watch, or the status of motion control, without a client.
    EVENT = "event"
    #: Values of `stream`, without a client.
    STREAM = "stream"
    #: Log of `control "savelog"`: the name, a line feed, and the text.
    LOG = "log"


@dataclass(frozen=True)
class Said:
    """Output of a mission, such as an event or a text.

    Attributes:
        kind: Kind of the output.
        text: Text of the output. Lines and values end with a line feed; messages are formatted as MRC prints them.
        number: For a line, the number of executed lines; otherwise 0.
        line: For a line, its number in the file; otherwise 0.
    """

    kind: SaidKind
    text: str
    number: int = 0
    line: int = 0

    @property
    def printed(self) -> str:
        """The text as MRC prints it; "" for output that MRC does not print."""
        if self.kind is SaidKind.LINE:
            return f"Line no {self.number:3d}:   {self.text} \n"
        return self.text if self.kind in (SaidKind.VALUES, SaidKind.MESSAGE) else ""


class Recipient(Protocol):
    """Receiver of a script's output to its client.

    It is the session of the client that sent the command, or an `Outbox`.

    Attributes:
        uses_xml: Whether events are sent as XML, set by ``set "xmlon"``.
    """

    uses_xml: bool

    @property
    def can_answer(self) -> bool:
        """Whether the client can send a line for `read`."""

    def text(self, text: str) -> None:
        """Receive a text of `print` or `read`."""

    def user_event(self, name: str) -> None:
        """Receive an event of `putevent`."""

    def sync_event(self, name: str) -> None:
        """Receive an event of `syncevent`."""

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """Receive the variables of `stream`: names, and indices in the pool."""

    def save_log(self, name: str, text: str) -> None:
        """Receive a log of `control "savelog"`."""


class Outbox:
    """Collector of the output of the interpreter. It replaces the session of a client if there is no client.

    Attributes:
        can_answer, uses_xml: See `Recipient`. They are False, because there is no client that could answer or receive
            XML.
    """

    can_answer = False
    uses_xml = False

    def __init__(self) -> None:
        self._said: list[Said] = []
        self._streamed = 0

    def take(self) -> list[Said]:
        """Remove and return the output since the last call."""
        said, self._said = self._said, []
        return said

    def _add(self, kind: SaidKind, text: str, number: int = 0, line: int = 0) -> None:
        if len(self._said) < _MOST:
            self._said.append(Said(kind, text, number, line))

    # -- output of the interpreter --------------------------------------------------------------------------

    def line(self, number: int, line: PlanLine) -> None:
        """Add a line that is about to be executed."""
        self._add(SaidKind.LINE, line.text, number, line.number)

    def values(self, text: str) -> None:
        """Add the values of `eval`."""
        self._add(SaidKind.VALUES, text)

    def message(self, text: str) -> None:
        """Add a message of a command or of an error."""
        self._add(SaidKind.MESSAGE, text)

    # -- Recipient ------------------------------------------------------------------------------------

    def text(self, text: str) -> None:
        """Add a text of `print` or `read`."""
        self._add(SaidKind.TEXT, text)

    def user_event(self, name: str) -> None:
        """Add an event of `putevent`."""
        self._add(SaidKind.EVENT, f"userevent {name}")

    def sync_event(self, name: str) -> None:
        """Add an event of `syncevent`."""
        self._add(SaidKind.EVENT, f"syncevent {name}")

    def event(self, text: str) -> None:
        """Add an event of a watch, or of the status of motion control."""
        self._add(SaidKind.EVENT, text)

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """Print each requested variable, as MRC does. Nothing is sent, because there is no client."""
        for each in variables:
            self._streamed += 1
            self.message(f"streamvar {each[0]} {self._streamed} \n")

    def save_log(self, name: str, text: str) -> None:
        """Add a log of `control "savelog"`."""
        self._add(SaidKind.LOG, f"{name}\n{text}")


class Session:
    """Session of one client.

    Args:
        outbox: Receiver of the output that MRC prints.
        pool: Values of the variables.

    Attributes:
        is_closed: Whether the client has left or was disconnected. Nothing more is received from it.
        uses_xml: Whether the events of the client are sent as XML. Queued events keep their form.
    """

    def __init__(self, outbox: Outbox, pool: Sequence[float]) -> None:
        self._outbox = outbox
        self._pool = pool
        self._time = 0.0
        self._line = bytearray()
        self._lines: deque[str] = deque()
        self._after = 0
        self._answers = bytearray()
        self._events: deque[str] = deque()
        self._waiting: int | None = None
        self._streamed: list[tuple[str, int]] = []
        self._stream_period = 1
        self.commands = 0
        self.uses_xml = False
        self.is_closed = False
        self.recorded: MissionPlan | None = None

    # -- bytes --------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        """Receive bytes. Lines end with CR, LF, or both in either order."""
        if self.is_closed:
            return
        for byte in data:
            if byte in (10, 13):
                if self._after and byte != self._after:
                    # This byte is the second half of a line end.
                    self._after = 0
                    continue
                self._after = byte
                self._lines.append(self._line.decode("latin-1"))
                self._line.clear()
            else:
                self._after = 0
                self._line.append(byte)
                if len(self._line) > LONGEST_LINE:
                    self.send(f"error a line has at most {LONGEST_LINE} characters\n")
                    self.is_closed = True
                    return

    def take(self) -> bytes:
        """Remove and return the bytes to send."""
        answers, self._answers = bytes(self._answers), bytearray()
        return answers

    def send(self, text: str) -> None:
        """Send a text. If the client does not read for too long, close the session."""
        self._answers += text.encode("latin-1", "replace")
        if len(self._answers) > _MOST_WAITING:
            self.is_closed = True

    @property
    def backlog(self) -> int:
        """Number of buffered lines."""
        return len(self._lines)

    @property
    def is_waiting(self) -> bool:
        """Whether the client waits for an event."""
        return self._waiting is not None

    def next_line(self) -> str | None:
        """Remove and return the next line; None if there is none."""
        return self._lines.popleft() if self._lines else None

    # -- data for the client --------------------------------------------------------------------------

    def event(self, plain: str, xml: str) -> None:
        """Send an event as XML, or keep it until it is requested.

        If there are more than `MOST_EVENTS`, the newest events are lost, as in MRC.
        """
        if self.uses_xml:
            self.send(xml)
        elif len(self._events) < MOST_EVENTS:
            self._events.append(plain)

    def command_event(self, number: int, status: str, condition: float | None = None) -> None:
        """Send the outcome of a command as an event."""
        plain, xml = f"ID{number} {status}", f'<cmd id="{number}" status="{status}"'
        if condition is not None:
            found = format_number(condition)
            plain, xml = f"{plain} {found}", f'<cmd id="{number}" status="finished" stopcond="{found}"'
        self.event(f"{plain}\n", f"{xml} />\n")

    def answer_command(self, number: int, status: str) -> None:
        """Send the immediate answer to a command."""
        self.send(f'<cmd id="{number}" status="{status}" />\n' if self.uses_xml else f"ID{number} {status}\n")

    def ask_event(self, seconds: float) -> None:
        """Send the oldest event. If there is none, send the next event that occurs within `seconds`.

        A new request replaces the pending one.
        """
        if self._events:
            self.send(self._events.popleft())
        else:
            self._waiting = int(max(-(2.0**31), min(2.0**31, seconds * 100)))

    def end_cycle(self) -> None:
        """Answer a pending `getevent` with the oldest event, or with `eventtimeout`.

        A client receives `eventtimeout` when the time of its request has expired.
        """
        if self._waiting is None:
            return
        if self._events:
            self.send(self._events.popleft())
            self._waiting = None
        elif self._waiting < 1:
            self.send("eventtimeout\n")
            self._waiting = None
        else:
            self._waiting -= 1

    def begin_cycle(self, cycle: int, time: float) -> None:
        """Send the streamed variables in each cycle in which they are due.

        `time` is ``$time`` of this cycle.
        """
        self._time = time
        if self._streamed and cycle % self._stream_period == 0:
            self._send_streamed(self._streamed)

    def _send_streamed(self, variables: Sequence[tuple[str, int]]) -> None:
        time, pool = format_number(self._time), self._pool
        if self.uses_xml:
            values = "".join(f'{name}="{format_number(pool[place])}" ' for name, place in variables)
            self.send(f'<data time="{time}" {values} />\n')
        else:
            values = "".join(f"{format_number(pool[place])} " for _, place in variables)
            self.send(f"stream {time} {values}\n")

    # -- Recipient ------------------------------------------------------------------------------------

    @property
    def can_answer(self) -> bool:
        """Whether the client can send a line."""
        return not self.is_closed

    def text(self, text: str) -> None:
        """Send a text of `print` or `read`."""
        self.send(text)

    def user_event(self, name: str) -> None:
        """Send or keep an event of `putevent`."""
        self.event(f"userevent {name}\n", f'<userevent name="{name}" />\n')

    def sync_event(self, name: str) -> None:
        """Send an event of `syncevent`. It is never queued, neither as text nor as XML."""
        self.send(f"syncevent {name}\n")

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """Add variables of `stream`, and send all of them in each `period`-th cycle.

        If `period` is 0, send only these variables, once.
        """
        if period == 0:
            self._send_streamed(variables)
            return
        self._stream_period = abs(period)
        for each in variables[: MOST_STREAMED - len(self._streamed)]:
            self._streamed.append(each)
            self._outbox.message(f"streamvar {each[0]} {len(self._streamed)} \n")

    def save_log(self, name: str, text: str) -> None:
        """Save a log of `control "savelog"`."""
        self._outbox.save_log(name, text)
