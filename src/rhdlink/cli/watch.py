"""`rhdlink watch`: the variables of a robot, live."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator

from linkcore.cli.options import Subparsers, add_command, positive_int, seconds
from linkcore.cli.program import Interruption
from linkcore.clock import Stamp
from linkcore.streaming.packet_queue import PacketQueue, drop_oldest
from linkcore.text import strict_json

from ..client import Variables, connect
from ..sync_thread import SyncThread
from ..variables.snapshot import Update
from .options import add_address, tell
from .units import update_as_json
from .values import check_names
from .view import RateCounter, View

__all__ = ["add_parser"]

_DESCRIPTION = """\
Watch variables live: their words, their meaning if their names are conventional ones, and how often per
second each is set. It connects as a reader, so the robot's master is not disturbed.

On a terminal the view is drawn ten times a second; elsewhere it is one line a second, as with --plain.
When the connection is lost the view says LOST, and goes on as soon as the robot is back. With --json each
sync that set a variable is one object: what was set, by name, and when it came."""

_EXAMPLES = (
    "rhdlink watch localhost",
    "rhdlink watch smr12 encl encr linesensor --plain",
    "rhdlink watch localhost transpos rotpos --json --count 100",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "watch", "watch variables live", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    parser.add_argument("names", metavar="NAME", nargs="*", help="watch only these variables")
    parser.add_argument("--period", type=seconds, metavar="S", help="seconds between syncs (every tick of the robot)")
    parser.add_argument("--plain", action="store_true", help="plain lines, one a second, also on a terminal")
    parser.add_argument("--json", action="store_true", help="one JSON object a line, for each sync that set a variable")
    parser.add_argument("--count", type=positive_int, metavar="N", help="end after N lines (never)")
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds (never)")
    parser.set_defaults(run=run, trailing="names")


def run(args: argparse.Namespace) -> int:
    """Watch until interrupted.

    Raises:
        NotThere: the robot has no such variable.
        RemoteError: the robot cannot be connected to.
    """
    with connect(args.address, timeout=args.timeout) as robot:
        check_names(args.names, robot, robot.address)
        until = None if args.duration is None else time.monotonic() + args.duration
        with Interruption() as interruption:
            (_lines if args.json else _views)(robot, args, until, interruption)
        interruption.raise_if_any()
    return 0


def _over(until: float | None) -> bool:
    return until is not None and time.monotonic() >= until


def _left(most: float, until: float | None) -> float:
    return most if until is None else max(min(most, until - time.monotonic()), 0.0)


def _check(sync_thread: SyncThread) -> None:
    if sync_thread.failure is not None:
        raise sync_thread.failure


def _lines(robot: Variables, args: argparse.Namespace, until: float | None, interruption: Interruption) -> None:
    """One JSON object for each update."""
    queue = PacketQueue(drop_oldest(16384))
    robot.subscribe(lambda update: queue.offer([update]), *args.names, policy=drop_oldest(16384))
    sync_thread = robot.background(args.period)
    shown = 0
    while interruption.number is None and not _over(until):
        update: Update | None = queue.next(_left(0.05, until))
        if update is None:
            _check(sync_thread)
            continue
        print(strict_json(update_as_json(update)), flush=True)
        shown += 1
        if shown == args.count:
            break
    if queue.dropped:
        tell(f"{queue.dropped} updates were dropped: the output was too slow for them")


def _views(robot: Variables, args: argparse.Namespace, until: float | None, interruption: Interruption) -> None:
    counter = RateCounter(time.monotonic())
    robot.subscribe(counter.on_update, *args.names)
    robot.subscribe_connection(counter.on_connection)
    sync_thread = robot.background(args.period)
    show, pause = _painter(args.plain)
    shown = 0
    with show as draw:
        # The first view comes after the first syncs; before them there are only the values of the handshake.
        is_over = interruption.wait(_left(min(0.2, pause), until))
        while True:
            _check(sync_thread)
            draw(_view(robot, counter, frozenset(args.names)))
            shown += 1
            if is_over or shown == args.count or _over(until):
                break
            is_over = interruption.wait(_left(pause, until))


def _view(robot: Variables, counter: RateCounter, names: frozenset[str]) -> View:
    now = Stamp.now().monotonic
    rate, rates = counter.rates(now)
    return View(
        robot=robot.address,
        connection=robot.connection,
        age=max(now - robot.received.monotonic, 0.0),
        rate=rate,
        rates=rates,
        variables=[each for each in robot.variables if not names or each.name in names],
        reconnects=robot.reconnects,
        trouble=counter.trouble,
    )


_Draw = Callable[[View], None]


def _painter(plain: bool) -> tuple[contextlib.AbstractContextManager[_Draw], float]:
    """The function that shows views, and the seconds between two of them."""
    if plain or not sys.stdout.isatty() or os.environ.get("TERM") == "dumb":
        return _plain(), 1.0
    try:
        import rich  # noqa: F401
    except ImportError:
        tell("plain lines, since rich is not installed; pip install 'urlink[cli]' adds it")
        return _plain(), 1.0
    return _panels(), 0.1


@contextlib.contextmanager
def _plain() -> Iterator[_Draw]:
    yield lambda view: print(view.as_line(time.strftime("%H:%M:%S")), flush=True)


@contextlib.contextmanager
def _panels() -> Iterator[_Draw]:
    from rich.console import Console
    from rich.live import Live

    from .view import ViewPanel

    # The last panel stays on the screen, where it can be read and copied.
    console, to_terminal = Console(), sys.stderr.isatty()
    with Live(console=console, auto_refresh=False, vertical_overflow="crop", redirect_stderr=to_terminal) as live:
        yield lambda view: live.update(ViewPanel(view), refresh=True)
