"""The output of a mission, and who receives it: the session of a client, or where there is none an outbox."""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from .arithmetic import format_number
from .plan import LONGEST_LINE, MissionPlan, PlanLine

#: Messages of one cycle that are kept; a script can print 20000.
_MOST = 50_000
#: Events of a client, and variables in its stream: as in MRC.
MOST_EVENTS, MOST_STREAMED = 100, 20
#: Bytes that wait to be sent to a client before it is given up.
_MOST_WAITING = 1 << 20
#: Lines that may wait to be taken before nothing more should be read from the client.
MOST_BACKLOG = 1000


class SaidKind(enum.Enum):
    """The kind of an output."""

    #: A line is about to be executed.
    LINE = "line"
    #: The values of `eval`.
    VALUES = "values"
    #: What a command or an error has to say, for whoever reads along.
    MESSAGE = "message"
    #: `print` and `read`, without a client.
    TEXT = "text"
    #: `putevent`, `syncevent`, a watch, or the status of motion control, without a client.
    EVENT = "event"
    #: `stream`, without a client.
    STREAM = "stream"
    #: `control "savelog"`: the name, and the text behind a line feed.
    LOG = "log"


@dataclass(frozen=True)
class Said:
    """One output of a mission.

    Attributes:
        kind: what it is.
        text: in words. A line and values end with a line feed, a message as MRC prints it.
        number: of a line: how many have been executed; else 0.
        line: of a line: where it stands in the file; else 0.
    """

    kind: SaidKind
    text: str
    number: int = 0
    line: int = 0

    @property
    def printed(self) -> str:
        """As MRC prints it; "" for what it does not print."""
        if self.kind is SaidKind.LINE:
            return f"Line no {self.number:3d}:   {self.text} \n"
        return self.text if self.kind in (SaidKind.VALUES, SaidKind.MESSAGE) else ""


class Recipient(Protocol):
    """Receives what a script says to its client: the session of the client that sent the command, or an `Outbox`.

    Attributes:
        uses_xml: the form of events, for ``set "xmlon"``.
    """

    uses_xml: bool

    @property
    def can_answer(self) -> bool:
        """It can send a line for `read`."""

    def text(self, text: str) -> None:
        """`print`, `read`."""

    def user_event(self, name: str) -> None:
        """`putevent`."""

    def sync_event(self, name: str) -> None:
        """`syncevent`."""

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """`stream`: names, and places in the pool."""

    def save_log(self, name: str, text: str) -> None:
        """`control "savelog"`."""


class Outbox:
    """Collects the output of the interpreter; it takes the place of a client where there is none.

    Attributes:
        can_answer, uses_xml: see `Recipient`; there is no client to answer, or to send XML to.
    """

    can_answer = False
    uses_xml = False

    def __init__(self) -> None:
        self._said: list[Said] = []
        self._streamed = 0

    def take(self) -> list[Said]:
        """The output since the last call."""
        said, self._said = self._said, []
        return said

    def _add(self, kind: SaidKind, text: str, number: int = 0, line: int = 0) -> None:
        if len(self._said) < _MOST:
            self._said.append(Said(kind, text, number, line))

    # -- of the interpreter ---------------------------------------------------------------------------------

    def line(self, number: int, line: PlanLine) -> None:
        """A line is about to be executed."""
        self._add(SaidKind.LINE, line.text, number, line.number)

    def values(self, text: str) -> None:
        """The values of `eval`."""
        self._add(SaidKind.VALUES, text)

    def message(self, text: str) -> None:
        """What a command, or an error, has to say."""
        self._add(SaidKind.MESSAGE, text)

    # -- Recipient ------------------------------------------------------------------------------------

    def text(self, text: str) -> None:
        """`print`, `read`."""
        self._add(SaidKind.TEXT, text)

    def user_event(self, name: str) -> None:
        """`putevent`."""
        self._add(SaidKind.EVENT, f"userevent {name}")

    def sync_event(self, name: str) -> None:
        """`syncevent`."""
        self._add(SaidKind.EVENT, f"syncevent {name}")

    def event(self, text: str) -> None:
        """A watch, or the status of motion control."""
        self._add(SaidKind.EVENT, text)

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """Not sent, since there is no client; MRC prints each variable that was asked for."""
        for each in variables:
            self._streamed += 1
            self.message(f"streamvar {each[0]} {self._streamed} \n")

    def save_log(self, name: str, text: str) -> None:
        """`control "savelog"`."""
        self._add(SaidKind.LOG, f"{name}\n{text}")


class Session:
    """One client.

    Args:
        outbox: gets the output that MRC prints.
        pool: the values of the variables.

    Attributes:
        is_closed: it has left, or was given up; nothing more is taken from it.
        uses_xml: the form of its events. Those that wait keep theirs.
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
        """Take what has come. Lines end with CR, LF, or both in either order."""
        if self.is_closed:
            return
        for byte in data:
            if byte in (10, 13):
                if self._after and byte != self._after:
                    # The second half of the end of a line.
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
        """The bytes to be sent, which are then removed here."""
        answers, self._answers = bytes(self._answers), bytearray()
        return answers

    def send(self, text: str) -> None:
        """Send a text, unless the client takes nothing any more."""
        self._answers += text.encode("latin-1", "replace")
        if len(self._answers) > _MOST_WAITING:
            self.is_closed = True

    @property
    def backlog(self) -> int:
        """Lines that wait to be taken."""
        return len(self._lines)

    @property
    def is_waiting(self) -> bool:
        """Whether the client waits for an event."""
        return self._waiting is not None

    def next_line(self) -> str | None:
        """The next line, or None."""
        return self._lines.popleft() if self._lines else None

    # -- what the client is sent ----------------------------------------------------------------------

    def event(self, plain: str, xml: str) -> None:
        """Send an event in the xml form, or keep it until it is requested.

        Of more than `MOST_EVENTS` the newest are lost, as in MRC.
        """
        if self.uses_xml:
            self.send(xml)
        elif len(self._events) < MOST_EVENTS:
            self._events.append(plain)

    def command_event(self, number: int, status: str, condition: float | None = None) -> None:
        """The outcome of a command."""
        plain, xml = f"ID{number} {status}", f'<cmd id="{number}" status="{status}"'
        if condition is not None:
            found = format_number(condition)
            plain, xml = f"{plain} {found}", f'<cmd id="{number}" status="finished" stopcond="{found}"'
        self.event(f"{plain}\n", f"{xml} />\n")

    def answer_command(self, number: int, status: str) -> None:
        """The immediate answer to a command."""
        self.send(f'<cmd id="{number}" status="{status}" />\n' if self.uses_xml else f"ID{number} {status}\n")

    def ask_event(self, seconds: float) -> None:
        """Send the oldest event, or the next one within some seconds. Asking again replaces the question."""
        if self._events:
            self.send(self._events.popleft())
        else:
            self._waiting = int(max(-(2.0**31), min(2.0**31, seconds * 100)))

    def end_cycle(self) -> None:
        """Answer a `getevent` that waits: with the oldest event, or when its time is up with `eventtimeout`."""
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
        """Send the streamed variables in each cycle in which they are due; `time` is ``$time`` of this one."""
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
        """It can send a line."""
        return not self.is_closed

    def text(self, text: str) -> None:
        """`print`, `read`."""
        self.send(text)

    def user_event(self, name: str) -> None:
        """`putevent`."""
        self.event(f"userevent {name}\n", f'<userevent name="{name}" />\n')

    def sync_event(self, name: str) -> None:
        """`syncevent`: not queued in either form."""
        self.send(f"syncevent {name}\n")

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """`stream`: add variables, and send all of them in each `period`-th cycle; with 0 send these once."""
        if period == 0:
            self._send_streamed(variables)
            return
        self._stream_period = abs(period)
        for each in variables[: MOST_STREAMED - len(self._streamed)]:
            self._streamed.append(each)
            self._outbox.message(f"streamvar {each[0]} {len(self._streamed)} \n")

    def save_log(self, name: str, text: str) -> None:
        """`control "savelog"`."""
        self._outbox.save_log(name, text)
