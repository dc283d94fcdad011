"""Objects that command a robot, without threads, sockets or a clock: the test calls subscribers and advances time."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

from linkcore.clock import Stamp
from linkcore.errors import LinkTimeout
from linkcore.handle import Handle, Lifecycle
from linkcore.net.undo import PendingUndos, Undo
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.threads import CallbackThread
from tests.fakes.clock import Clock
from tests.fakes.packets import packet
from urlink.command.channel import CommandChannel
from urlink.command.interlock import Interlock
from urlink.command.programs import Programs
from urlink.command.safety_monitor import SafetyMonitor
from urlink.command.section import Section
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.primary.robot_message import KeyMessage, RuntimeExceptionMessage, TextMessage
from urlink.protocol.primary.robot_state import MasterboardData, RobotModeData, RobotState
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.wrapping import StartPlace
from urlink.session.identity import Identity, KnownIdentity

FIRMWARE = (5, 11)
#: Registers with the start permission of programs, as in `urlink.connect`.
START_PLACE = StartPlace(47, tuple(range(24, 32)))


def slow(safety: SafetyMode = SafetyMode.NORMAL, mode: RobotMode = RobotMode.RUNNING, **modes: bool) -> RobotState:
    """Return a state of the primary interface."""
    package = packet(RobotModeData, FIRMWARE, robot_mode=mode, **modes)
    return RobotState(package, packet(MasterboardData, FIRMWARE, safety_mode=safety))


def fast(safety: SafetyMode = SafetyMode.NORMAL, mode: RobotMode = RobotMode.RUNNING) -> RealtimeState:
    """Return a state of the real-time interface."""
    return packet(RealtimeState, FIRMWARE, robot_mode=mode, safety_mode=safety)


class Subscriber:
    """Fake of `Subscription`."""

    def __init__(self, kind: type, callback: Callable[[Any], object], among: list[Subscriber]) -> None:
        self.kind = kind
        self.callback = callback
        self._among = among
        among.append(self)

    def close(self, timeout: float = 0.0) -> None:
        assert timeout == 0.0, "inline subscriptions must be closed without waiting"
        self._among.remove(self)

    def __enter__(self) -> None:
        pass

    def __exit__(self, *exc: object) -> None:
        self.close()


class Line:
    """Fake of `Connection`.

    Args:
        waits: Function that is called instead of waiting for room, with the timeout in seconds.
    """

    name = "line"

    def __init__(self, waits: Callable[[float], object] = lambda seconds: None) -> None:
        self.state = ConnectionState.CONNECTED
        self.counters = SimpleNamespace(connections=1)
        self.subscribers: list[Subscriber] = []
        #: Seconds of silence, and the function to call after this time.
        self.watches: list[tuple[float, Callable[[float], object]]] = []
        self.silence = SimpleNamespace(limit=None, watch=self.watch)
        self.fan_out = SimpleNamespace(newest=lambda kind: None)
        self.sent: list[str] = []
        self.aborts = 0
        #: Number of bytes that it still accepts; None for no limit.
        self.room: int | None = None
        self._waits = waits

    def subscribe_inline(self, kind: type, callback: Callable[[Any], object], **options: object) -> Subscriber:
        return Subscriber(kind, callback, self.subscribers)

    def watch(self, seconds: float, hook: Callable[[float], object]) -> Callable[[], None]:
        watch = (seconds, hook)
        self.watches.append(watch)
        return lambda: self.watches.remove(watch)

    def reads_here(self) -> bool:
        """Return True for every thread, so nothing waits, because no packet could arrive."""
        return True

    def look(self) -> None:
        """Do nothing, because packets are delivered immediately."""

    def deliver(self, packet: Any) -> None:
        for each in tuple(self.subscribers):
            if isinstance(packet, each.kind):
                each.callback(packet)

    def be_silent(self) -> None:
        """Call all watchers, as if the robot had been silent for their time."""
        for seconds, hook in tuple(self.watches):
            hook(seconds)

    def send_some(self, data: memoryview) -> int:
        count = len(data) if self.room is None else min(self.room, len(data))
        if self.room is not None:
            self.room -= count
        if count:
            self.sent.append(bytes(data[:count]).decode())
        return count

    def wait_for_room(self, timeout: float) -> bool:
        self._waits(timeout)
        return self.room != 0

    def abort(self) -> None:
        self.aborts += 1


class Desk:
    """Monitor and channel between two lines. Each wait for room takes `pace` seconds, and calls `meanwhile`.

    Args:
        stale_after: See `Interlock`, in seconds.
        may_wait: Whether this thread may wait for packets of the robot.
    """

    def __init__(self, *, stale_after: float = math.inf, may_wait: bool = False) -> None:
        self.clock = Clock()
        self.pace = 0.2
        self.waits: list[float] = []
        self.meanwhile: Callable[[], object] = lambda: None
        self.primary, self.realtime = Line(self._wait), Line()
        slow, fast = cast(Connection, self.primary), cast(Connection, self.realtime)
        self.section = Section(lambda: not may_wait)
        self.interlock = Interlock(stale_after=stale_after)
        # Callbacks are called immediately.
        self.callbacks = cast(CallbackThread, SimpleNamespace(call=lambda function, *arguments: function(*arguments)))
        self.monitor = SafetyMonitor(slow, fast, self.interlock, self.section, self.callbacks, self.clock)
        self.undos = PendingUndos("controller")
        self.channel = CommandChannel(slow, self.monitor, self.section, self.clock, self.undos)

    def _wait(self, seconds: float) -> None:
        self.waits.append(seconds)
        self.clock.now += self.pace
        self.meanwhile()

    def clear(self) -> None:
        """Report a state that permits motions on both lines."""
        self.monitor.listen(closely=True)
        self.primary.deliver(slow())
        self.realtime.deliver(fast())
        assert self.monitor.refusal_to_begin() is None

    def event(self, line: Line, state: ConnectionState, error: Exception | None = None) -> None:
        line.deliver(ConnectionEvent(state, line.name, error, Stamp(self.clock.now, self.clock.now)))

    @property
    def sent(self) -> list[str]:
        return self.primary.sent


def give_up(undos: PendingUndos, name: str, undo: Callable[[Any, Callable[[], bool]], object]) -> None:
    """Send a command that is not answered, so that its undo is pending."""
    client = SimpleNamespace(close=lambda: None)
    with contextlib.suppress(LinkTimeout), undos.command(name, 0.0, Undo(lambda: client, undo)) as sent:
        sent()
        raise LinkTimeout("no answer")
    assert undos.pending == (name,)


STARTED, STOPPED = "PROGRAM_XXX_STARTED", "PROGRAM_XXX_STOPPED"


class Run(Handle):
    """Handle of a sent program; `life` is its life, and `texts` holds the texts that it has sent."""

    def __init__(self, desk: Programming, life: Lifecycle, name: str, **options: Any) -> None:
        super().__init__(life)
        self.life = life
        self._desk = desk
        self.texts: list[str] = []
        #: Name of the program on the controller.
        self.program = name

    def says(self, word: str) -> None:
        self._desk.primary.deliver(TextMessage(FIRMWARE, text=f"{self.program} {word}"))

    def begins(self) -> None:
        self._desk.key(STARTED, self.program)
        self.says("started")

    def stops(self) -> None:
        self._desk.key(STOPPED, self.program)

    @property
    def end(self) -> str:
        """Description of the end of the program."""
        return f"{type(self.error).__name__}: {self.error}" if self.error is not None else self.phase.value


class Programming(Desk):
    """Desk with programs, and with a robot that permits motions."""

    def __init__(
        self, *, start_timeout: float = 5.0, start_place: StartPlace = START_PLACE, firmware: str = "5.11"
    ) -> None:
        super().__init__()
        identity = Identity(Firmware.parse(firmware), True, None)
        self.programs = Programs(
            cast(Connection, self.primary),
            self.channel,
            self.monitor,
            self.section,
            self.callbacks,
            start_timeout=start_timeout,
            start_place=start_place,
            who=KnownIdentity(lambda: identity),
            clock=self.clock,
        )
        self.clear()

    def motion(self, *, asks: bool = True, **options: Any) -> Run:
        """Start a motion of the library."""
        wrapped = self.programs.own(["movej(q)"], asks=asks)
        return self._start(wrapped, self.programs.life(f"motion {wrapped.name}"), **options)

    def script(self, source: str = "movej(q)", **options: Any) -> Run:
        """Start a script of a user."""
        wrapped = self.programs.wrap(source)
        options = {"is_motion": False, "left_alone": "it might still run", **options}
        return self._start(wrapped, self.programs.life(wrapped.name), **options)

    def _start(self, wrapped: Any, life: Lifecycle, **options: Any) -> Run:
        run = Run(self, life, wrapped.name)
        self.programs.start(wrapped, life, on_text=run.texts.append, **options)
        return run

    def key(self, title: str, name: str) -> None:
        self.primary.deliver(KeyMessage(FIRMWARE, title=title, text=name))

    def exception(self, text: str, line: int = 1, column: int = 1) -> None:
        self.primary.deliver(RuntimeExceptionMessage(FIRMWARE, line=line, column=column, text=text))

    def state(self, later: float = 0.0, *, runs: bool = False, paused: bool = False) -> None:
        """Report a state, `later` seconds later."""
        self.clock.now += later
        self.primary.deliver(slow(is_program_running=runs, is_program_paused=paused))

    @property
    def stops(self) -> int:
        """Number of sent brake commands."""
        return sum("stopj(2.0)" in text for text in self.sent)
