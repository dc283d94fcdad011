"""`urlink monitor`: watch a robot live."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from linkcore.cli.program import Interruption
from linkcore.errors import LinkError, LinkTimeout
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.streaming.stream import Stream

from ..address import RecordingAddress, SimulatorAddress, parse_address
from ..interfaces.primary.robot_message import RobotMessage, UnnamedMessage12, VersionMessage
from ..robot import Robot, connect
from .glance import Glance, StreamStatus, line, status_of
from .options import Subparsers, add_address, add_command, add_interface, seconds
from .reading import Reading, read
from .values import as_text

__all__ = ["add_parser", "watch", "with_motion"]

_DESCRIPTION = """\
Watch a robot: joints, tool, modes, inputs and outputs, and how regularly its data arrives.

On a terminal the view is drawn ten times a second; elsewhere it is one line a second, as with --plain. It
says SLOW where less than 95 % of the states that the controller sends arrive, and counts as missed what
never came by the controller's own clock. When the connection is lost the view says LOST, shows the last
values as old, and goes on as soon as the controller is back. The real-time interface shows tool speed and
force 125 or 500 times a second; the primary interface ten times a second, with the analogue signals and
the messages of the controller."""

_EXAMPLES = (
    "urlink monitor 192.168.56.101",
    "urlink monitor 'sim://ur10?firmware=3.4' --interface primary",
    "urlink monitor 'replay:///tmp/run.urlog?rate=2' --plain",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "monitor", "watch a robot live", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    add_interface(parser, ("realtime", "primary"))
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds (never)")
    parser.add_argument("--plain", action="store_true", help="plain lines, one a second, also on a terminal")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Watch until the time is up, a recording is over, or Ctrl-C.

    Raises:
        RemoteError: the robot cannot be connected to, or no state came.
    """
    with connect(with_motion(args.address), timeout=args.connect_timeout) as robot:
        glances = watch(robot, args.interface)
        next(glances)  # connects: an error is printed before anything is drawn
        show, pause = _painter(args.plain)
        until = None if args.duration is None else time.monotonic() + args.duration
        with Interruption() as interruption, show as draw:
            _await_first(glances, interruption, until)
            while True:
                glance = next(glances)
                over = glance.status is StreamStatus.ENDED or (until is not None and time.monotonic() >= until)
                # Once more at the end, so that the last values stay on the screen.
                draw(glance)
                if over or interruption.wait(_next(pause, until)):
                    break
        interruption.raise_if_any()
        if glance.reading is None:
            raise LinkTimeout(
                f"{args.address}: no state came"
                + ("" if args.duration is None else f" within {args.duration:g} s")
                + ("" if glance.trouble is None else f" ({glance.trouble})")
            )
    return 0


def with_motion(address: str) -> str:
    """The address; that of a simulated arm which says nothing of its motion with the demonstration, to have a view."""
    place = parse_address(address)
    if not isinstance(place, SimulatorAddress) or place.motion is not None:
        return address
    return f"{address}{'&' if '?' in address else '?'}motion=demo"


def _await_first(glances: Iterator[Glance], interruption: Interruption, until: float | None) -> None:
    """Wait briefly for the first state, so that the first picture has values."""
    deadline = time.monotonic() + 0.5
    deadline = deadline if until is None else min(deadline, until)
    while time.monotonic() < deadline:
        glance = next(glances)
        if glance.reading is not None or glance.status is StreamStatus.ENDED or interruption.wait(0.01):
            break


def _next(pause: float, until: float | None) -> float:
    return pause if until is None else max(min(pause, until - time.monotonic()), 0.0)


def watch(robot: Robot, interface: str) -> Iterator[Glance]:
    """A glance at the robot each time the iterator is advanced, without end.

    Raises:
        RemoteError: the first connection could not be made, or the stream gave up.
    """
    stream: Stream[Any] = robot.primary if interface == "primary" else robot.realtime
    identity = _Name(robot)
    usual = _usual_rate(robot, interface)
    troubles: list[str] = []
    messages: list[str] = []

    def on_connection(event: ConnectionEvent) -> None:
        if event.error is not None:
            troubles[:] = [str(event.error)]
        elif event.state is ConnectionState.CONNECTED:
            troubles.clear()

    def on_message(message: RobotMessage) -> None:
        if not isinstance(message, (VersionMessage, UnnamedMessage12)):  # sent at the start of every connection
            messages[:] = [_told(message)]

    if interface == "primary":
        # Subscribed first: the first subscription connects, and messages are sent at once.
        stream.subscribe(on_message, RobotMessage)
    stream.subscribe(on_connection, ConnectionEvent)
    reading: Reading | None = None
    since, counted = time.monotonic(), 0
    while True:
        if stream.failure is not None:
            raise stream.failure
        connection, state = stream.connection, stream.latest
        if state is not None:
            reading = read(state)
        stats = stream.stats
        if connection is not ConnectionState.CONNECTED or stats.reconnects != counted:
            since, counted = time.monotonic(), stats.reconnects
        # Less than a second is too short to measure a rate.
        rate = stats.rate if time.monotonic() - since > 1.1 else None
        yield Glance(
            robot=identity.after(stats.reconnects),
            address=f"{robot.address} {interface}",
            status=status_of(connection, state is not None, reading, rate, usual),
            reading=reading,
            stats=stats,
            rate=rate,
            usual=usual,
            trouble=next(iter(troubles), None),
            message=next(iter(messages), None),
        )


def _usual_rate(robot: Robot, interface: str) -> float | None:
    """States a second that this controller sends; as many as are played, of a recording."""
    place = parse_address(robot.address)
    times = place.rate if isinstance(place, RecordingAddress) else 1.0
    return (10.0 if interface == "primary" else float(robot.firmware.rate)) * times or None


def _told(message: RobotMessage) -> str:
    """The content of a message, without the fields that all messages have."""
    own = [name for name in message.FIELDS if name not in RobotMessage.FIELDS]
    told = ((name, getattr(message, name)) for name in own)
    return f"{type(message).__name__} " + " ".join(
        f"{name}={as_text(value)}" for name, value in told if value is not None
    )


class _Name:
    """Model and firmware, read again in the background after each reconnect."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._asked = 0
        self._text = ""
        self._ask()

    def after(self, reconnects: int) -> str:
        if reconnects != self._asked:
            self._asked = reconnects
            threading.Thread(target=self._ask, name="identity", daemon=True).start()
        return self._text

    def _ask(self) -> None:
        with contextlib.suppress(LinkError):  # lost again: the next reconnect tries again
            identity = self._robot.identity
            self._text = f"{identity.model or 'UR'}  firmware {identity.firmware}"


_Draw = Callable[[Glance], None]


def _painter(plain: bool) -> tuple[contextlib.AbstractContextManager[_Draw], float]:
    """The function that shows glances, and the seconds between two of them."""
    if plain or not sys.stdout.isatty() or os.environ.get("TERM") == "dumb":
        return _lines(), 1.0
    try:
        import rich  # noqa: F401
    except ImportError:
        print("urlink: plain lines, since rich is not installed; pip install 'urlink[cli]' adds it", file=sys.stderr)
        return _lines(), 1.0
    return _pictures(), 0.1


@contextlib.contextmanager
def _lines() -> Iterator[_Draw]:
    def draw(glance: Glance) -> None:
        print(line(glance, time.strftime("%H:%M:%S")), flush=True)

    yield draw


@contextlib.contextmanager
def _pictures() -> Iterator[_Draw]:
    from rich.console import Console
    from rich.live import Live

    from .picture import Picture

    # The last picture stays on the screen, where it can be read and copied.
    console, to_terminal = Console(), sys.stderr.isatty()
    with Live(console=console, auto_refresh=False, vertical_overflow="crop", redirect_stderr=to_terminal) as live:
        yield lambda glance: live.update(Picture(glance), refresh=True)
