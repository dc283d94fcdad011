"""`urlink monitor`: watch a robot live."""

from __future__ import annotations

import argparse
import contextlib
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from linkcore import clock
from linkcore.cli.options import DURATION, argument, command
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption, drawing, quoted
from linkcore.errors import LinkError, LinkTimeout
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.streaming.stream import Stream

from ..protocol.primary.robot_message import RobotMessage, UnnamedMessage12, VersionMessage
from ..robot import Robot
from ..session.address import RecordingAddress, SimulatorAddress, parse_address
from .monitor_view import MonitorView, Reading, StreamStatus, line, read, status_of
from .options import ADDRESS, connected, interface_of, tell
from .packet_fields import as_text
from .packet_stream import counted

if TYPE_CHECKING:
    from .monitor_panel import MonitorPanel


@command(
    "monitor",
    "watch a robot live",
    *ADDRESS,
    interface_of(("realtime", "primary")),
    DURATION,
    argument("--plain", action="store_true", help="print one line per second, even on a terminal"),
)
def run(args: argparse.Namespace) -> int:
    """Watch a robot: joints, tool, modes, inputs and outputs, and the rate of its data.

    On a terminal, the view is drawn ten times a second. Otherwise, and with --plain, one line is printed per second.
    The status is SLOW if less than 95 % of the controller's states arrive. `missed` counts states that never arrived,
    and `duplicates` counts states that arrived twice, based on the controller's clock. When the connection is lost,
    the view shows LOST and marks the last values as old. The view continues when the controller is available again.

    The real-time interface sends 125 or 500 states a second, with tool speed and force. The primary interface sends
    ten states a second, with the analogue signals and the messages of the controller. At the end, a summary and a next
    step are printed on stderr.

    examples:
      urlink monitor 192.168.56.101
      urlink monitor 'sim://ur10?firmware=3.4' --interface primary
      urlink monitor 'replay:///tmp/run.urlog?rate=2' --plain
    """
    with connected(args, with_motion(args.address)) as robot:
        views = watch(robot, args.interface)
        with ProgressBar(f"connecting to {args.address}", args.quiet):
            next(views)  # connects, so an error is printed before anything is drawn
        begun = clock.now()
        with Interruption(args.duration) as interruption, drawing(args.plain, tell, _line, _panel) as (draw, pause):
            _await_first(views, interruption)
            while True:
                # Draw once more at the end, so that the last values stay on the screen.
                is_over = interruption.is_over
                view = next(views)
                draw(view)
                if is_over or view.status is StreamStatus.ENDED:
                    break
                interruption.wait(pause)
        if view.reading is None and interruption.number is None:
            raise LinkTimeout(
                f"{args.address}: no state arrived"
                + ("" if args.duration is None else f" within {args.duration:g} s")
                + ("" if view.trouble is None else f" ({view.trouble})")
            )
        tell(summary(view, clock.now() - begun))
        tell(next_step(view, args.address))
    return interruption.status


def summary(view: MonitorView, seconds: float) -> str:
    """Return the monitor's statistics of the last `seconds` as a line."""
    stats = view.stats
    rate = f", {stats.received / seconds:.1f} Hz on average" if seconds >= 1.0 else ""
    longest = f", longest gap {stats.longest_gap:.3f} s" if stats.gaps else ""
    return f"watched for {seconds:.1f} s{rate}; {counted(stats)}{longest}"


def next_step(view: MonitorView, address: str) -> str:
    """Return a suggestion for the next command, with a description of this command."""
    place, given = parse_address(address), quoted(address)
    if isinstance(place, RecordingAddress):
        return f"next: urlink replay {quoted(str(place.path))} to summarise the recording"
    is_regular = view.status is StreamStatus.CONNECTED and not view.stats.missed and not view.stats.reconnects
    if not is_regular:
        return f"next: urlink doctor {given} to find the cause of missing states"
    return f"next: urlink record {given} run.urlog to record what the robot sends"


def with_motion(address: str) -> str:
    """Return the address; for a simulated arm without a motion, add the demonstration motion."""
    place = parse_address(address)
    if not isinstance(place, SimulatorAddress) or place.motion is not None:
        return address
    return f"{address}{'&' if '?' in address else '?'}motion=demo"


def _await_first(views: Iterator[MonitorView], interruption: Interruption) -> None:
    """Wait briefly for the first state, so that the first view has values."""
    deadline = clock.now() + 0.5
    while clock.now() < deadline:
        view = next(views)
        if view.reading is not None or view.status is StreamStatus.ENDED or interruption.wait(0.01):
            break


def watch(robot: Robot, interface: str) -> Iterator[MonitorView]:
    """Yield a view of the robot each time the iterator is advanced, without end.

    Raises:
        RemoteError: If the first connection could not be made, or the stream gave up reconnecting.
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
            messages[:] = [_as_text(message)]

    if interface == "primary":
        # Subscribe to messages first: the first subscription connects, and then the controller sends messages
        # immediately.
        stream.subscribe(on_message, RobotMessage)
    stream.subscribe(on_connection, ConnectionEvent)
    reading: Reading | None = None
    since, counted = clock.now(), 0
    while True:
        if stream.failure is not None:
            raise stream.failure
        connection, state = stream.connection, stream.latest
        if state is not None:
            reading = read(state)
        stats = stream.stats
        if connection is not ConnectionState.CONNECTED or stats.reconnects != counted:
            since, counted = clock.now(), stats.reconnects
        # Less than a second is too short to measure a rate.
        rate = stats.rate if clock.now() - since > 1.1 else None
        yield MonitorView(
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
    """Return the states per second that this controller sends, or that a recording plays."""
    place = parse_address(robot.address)
    times = place.rate if isinstance(place, RecordingAddress) else 1.0
    return (10.0 if interface == "primary" else float(robot.firmware.rate)) * times or None


def _as_text(message: RobotMessage) -> str:
    """Return the content of a message, without the fields that all messages have."""
    own = [name for name in message.FIELDS if name not in RobotMessage.FIELDS]
    values = ((name, getattr(message, name)) for name in own)
    return f"{type(message).__name__} " + " ".join(
        f"{name}={as_text(value)}" for name, value in values if value is not None
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
        with contextlib.suppress(LinkError):  # if the connection is lost again, the next one retries
            identity = self._robot.identity
            self._text = f"{identity.model or 'UR'}  firmware {identity.firmware}"


def _line(view: MonitorView) -> str:
    return line(view, time.strftime("%H:%M:%S"))


def _panel(view: MonitorView) -> MonitorPanel:
    from .monitor_panel import MonitorPanel  # imported here, because the module needs rich

    return MonitorPanel(view)
