"""`rhdlink watch`: show variables live, on a terminal or as lines."""

from __future__ import annotations

import argparse
import itertools

from linkcore import clock
from linkcore.cli.options import DURATION, argument, command, positive_int, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption, drawing, quoted
from linkcore.streaming.packet_queue import PacketQueue, drop_oldest
from linkcore.text import strict_json

from ..client import Variables
from ..sync.sync_thread import SyncThread
from ..variables.snapshot import Update
from .options import ADDRESS, connected, tell
from .variable_text import check_names, update_as_json
from .watch_view import RateCounter, View


@command(
    "watch",
    "watch variables live",
    *ADDRESS,
    argument("names", metavar="NAME", nargs="*", help="watch only these variables", trailing=True),
    argument("--period", type=seconds, metavar="S", help="seconds between syncs (default: every tick of the robot)"),
    argument("--plain", action="store_true", help="print one line per second, even on a terminal"),
    argument("--json", action="store_true", help="print one JSON object per line, for each sync that set a variable"),
    argument("--count", type=positive_int, metavar="N", help="end after N lines (default: never)"),
    DURATION,
)
def run(args: argparse.Namespace) -> int:
    """Watch variables live: their words, the meaning of conventional names, and how often per second each one is set.
    The command connects as a reader, so it does not disturb the robot's master.

    On a terminal, the view is drawn ten times per second. Elsewhere, or with --plain, one line is printed per second.
    If the connection is lost, the view shows LOST, and continues when the robot is back. At the end, a summary and a
    next step are printed on stderr. With --json, each sync that set a variable is one object: the set values by name,
    and their arrival time.

    examples:
      rhdlink watch localhost
      rhdlink watch smr12 encl encr linesensor --plain
      rhdlink watch localhost transpos rotpos --json --count 100
    """
    with connected(args) as robot:
        check_names(args.names, robot, robot.address)
        with Interruption(args.duration) as interruption:
            (_lines if args.json else _views)(robot, args, interruption)
        return interruption.status


def _check(sync_thread: SyncThread) -> None:
    if sync_thread.failure is not None:
        raise sync_thread.failure


def _lines(robot: Variables, args: argparse.Namespace, interruption: Interruption) -> None:
    """Print one JSON object for each update."""
    queue = PacketQueue(drop_oldest(16384))
    robot.subscribe(lambda update: queue.offer([update]), *args.names, policy=drop_oldest(16384))
    sync_thread = robot.background(args.period)
    shown = 0
    # On a terminal, the bar is shown only while nothing is printed.
    with ProgressBar("waiting for updates", args.quiet) as progress:
        while not interruption.is_over:
            update: Update | None = queue.next(0.05)
            if update is None:
                _check(sync_thread)
                continue
            print(strict_json(update_as_json(update)), flush=True)
            shown += 1
            progress(0.0 if args.count is None else shown / args.count, f"{shown} updates printed")
            if shown == args.count:
                break
    if queue.dropped:
        tell(f"dropped {queue.dropped} updates, because the output was too slow")


def _views(robot: Variables, args: argparse.Namespace, interruption: Interruption) -> None:
    counter = RateCounter(clock.now())
    robot.subscribe(counter.on_update, *args.names)
    robot.subscribe_connection(counter.on_connection)
    sync_thread = robot.background(args.period)
    begun = clock.now()
    with drawing(args.plain, tell, View.as_line, lambda view: view) as (draw, pause):
        # Draw the first view after the first syncs. Before them, there are only the values of the handshake.
        interruption.wait(min(0.2, pause))
        for shown in itertools.count(1):
            is_over = interruption.is_over
            _check(sync_thread)
            draw(_view(robot, counter, frozenset(args.names)))
            if is_over or shown == args.count:
                break
            interruption.wait(pause)
    seconds = clock.now() - begun
    rate = f" ({sync_thread.syncs / seconds:.1f}/s)" if seconds >= 1.0 else ""
    tell(f"watched for {seconds:.1f} s; {sync_thread.syncs} syncs{rate}, {robot.reconnects} reconnects")
    tell(f"next: rhdlink record {quoted(args.address)} drive.urlog records the robot's data")


def _view(robot: Variables, counter: RateCounter, names: frozenset[str]) -> View:
    rate, rates = counter.rates(clock.now())
    return View(
        robot=robot.address,
        connection=robot.connection,
        age=robot.received.age,
        rate=rate,
        rates=rates,
        variables=[each for each in robot.variables if not names or each.name in names],
        reconnects=robot.reconnects,
        trouble=counter.trouble,
    )
