"""`rhdlink vars`, `get`, `set` and `watch`: the variables of a robot, once or live."""

from __future__ import annotations

import argparse
import itertools
import re
import shlex
from collections.abc import Collection, Iterable

from linkcore import clock
from linkcore.cli.options import DURATION, argument, command, positive_int, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption, drawing
from linkcore.streaming.packet_queue import PacketQueue, drop_oldest
from linkcore.text import printable, strict_json

from ..client import Variables
from ..errors import NotThere
from ..sync_thread import SyncThread
from ..variables.snapshot import Update
from .options import ADDRESS, connected, tell
from .view import TYPES, RateCounter, View, as_columns, as_json, typed, update_as_json, with_meaning, words_of


def _check_names(names: Iterable[str], robot: Variables | Collection[str], where: str) -> None:
    """Raise `NotThere` for names that are not variables."""
    missing = [name for name in names if name not in robot]
    if missing:
        raise NotThere(f"{where} has no variable {', '.join(map(repr, missing))}; `rhdlink vars` lists all")


def _word(text: str) -> int:
    if not re.fullmatch(r"[+-]?[0-9]{1,10}", text) or not -(2**31) <= int(text) < 2**31:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 32 bits")
    return int(text)


@command(
    "vars",
    "list the variables of a robot",
    *ADDRESS,
    argument("--json", action="store_true", help="one JSON object a line, for each variable"),
)
def _list(args: argparse.Namespace) -> int:
    """List the variables of a robot: direction, id, name, words, meaning, and when each was set.

    `read` variables go from the robot to programs, `write` variables from programs to the robot. A robot sends
    only the name and the length of a variable; the meaning after the `=` is that of the name by convention. A
    time of 0 means that a variable was never set.

    examples:
      rhdlink vars localhost
      rhdlink vars smr12:24902 --json
      rhdlink vars localhost --json | jq -r .name
    """
    with connected(args) as robot:
        # The values of the handshake are the newest.
        found = robot.variables
        if args.json:
            for variable in found:
                print(strict_json(as_json(variable)))
            return 0
        print(printable(f"{robot.address}: {len(found)} variables, time stamps of {robot.width} words"))
        if not found:
            return 0  # no columns either
        rows = [as_columns(variable) for variable in found]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        # A long array must not push the columns after it off the screen.
        widths[3] = min(widths[3], 40)
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return 0


@command(
    "get",
    "print the values of variables",
    *ADDRESS,
    argument("names", metavar="NAME", nargs="+", help="a variable of the robot", trailing=True),
    argument("--as", dest="type", choices=tuple(TYPES), help="decode the words as values of this type"),
    argument("--order", choices=("little", "big"), default="little", help="of values of two words (little)"),
    argument("--json", action="store_true", help="one JSON object a line, for each variable"),
)
def _get(args: argparse.Namespace) -> int:
    """Print the values of variables, one line each, in the order in which they are named.

    The words come first, as they are on the wire; after the `=` stands their meaning, if the name has one by
    convention. If a read and a write variable have the same name, the read variable is printed.

    With --as the words are decoded as values of a type, and only these are printed.

    examples:
      rhdlink get localhost tick
      rhdlink get smr12 encl encr linesensor
      rhdlink get localhost transpos rotpos --json
      rhdlink get localhost bearing --as float64
    """
    with connected(args) as robot:
        by_name = {variable.name: variable for variable in reversed(robot.variables)}
        _check_names(args.names, by_name, robot.address)
        for name in args.names:
            variable = by_name[name]
            words = words_of(variable.value)
            values = None if args.type is None else typed(name, words, args.type, args.order)
            if args.json:
                print(strict_json(as_json(variable) | ({} if values is None else {"values": values})))
                continue
            if values is not None:
                print(f"{printable(name)} {' '.join(map(repr, values))}")
                continue
            print(f"{printable(name)} {with_meaning(variable.direction, name, words, None)}")
    return 0


@command(
    "set",
    "write a variable, as master",
    *ADDRESS,
    argument("name", metavar="NAME", help="a write variable of the robot"),
    argument("values", metavar="VALUE", nargs="+", type=_word, help="its words"),
    argument("--hold", type=seconds, metavar="S", help="stay master for S seconds (leave at once)"),
)
def _set(args: argparse.Namespace) -> int:
    """Write a variable, as the master of the robot. A robot has one master at a time: while another program is
    master, this fails.

    VALUEs are the words of the variable as they are on the wire: whole numbers of 32 bits, one for each word;
    30000, and not 0.3 m/s. Many robots stop when their master leaves, which this does at once unless --hold
    says how long to stay; Ctrl-C ends that earlier. THIS MOVES A REAL ROBOT.

    examples:
      rhdlink set localhost cmdtransvel 30000 --hold 2
      rhdlink set smr12 speedl 10 --hold 1
      rhdlink set localhost cmdrotvel -- -20000
    """
    with connected(args, access="w") as robot, Interruption() as interruption:
        robot[args.name] = args.values if len(args.values) > 1 else args.values[0]
        robot.sync()  # the reply confirms the write
        (value,) = (each.value for each in robot.variables if (each.direction, each.name) == ("w", args.name))
        tell(f"{args.name} is {with_meaning('w', args.name, words_of(value))}")
        if args.hold is not None:
            interruption.end_after(args.hold)
            begun = clock.now()
            with ProgressBar(f"holding {args.name}", args.quiet) as progress:
                while not interruption.is_over:
                    robot.sync()
                    progress((clock.now() - begun) / args.hold)
    return interruption.status


@command(
    "watch",
    "watch variables live",
    *ADDRESS,
    argument("names", metavar="NAME", nargs="*", help="watch only these variables", trailing=True),
    argument("--period", type=seconds, metavar="S", help="seconds between syncs (every tick of the robot)"),
    argument("--plain", action="store_true", help="print one line per second, even on a terminal"),
    argument("--json", action="store_true", help="one JSON object a line, for each sync that set a variable"),
    argument("--count", type=positive_int, metavar="N", help="end after N lines (never)"),
    DURATION,
)
def _watch(args: argparse.Namespace) -> int:
    """Watch variables live: their words, their meaning if their names are conventional ones, and how often per
    second each is set. It connects as a reader, so the robot's master is not disturbed.

    On a terminal the view is drawn ten times a second; elsewhere it is one line a second, as with --plain. When
    the connection is lost the view shows LOST, and continues when the robot is back. At the end a summary and a
    next step are printed on stderr. With --json each sync that set a variable is one object: what was set, by
    name, and when it came.

    examples:
      rhdlink watch localhost
      rhdlink watch smr12 encl encr linesensor --plain
      rhdlink watch localhost transpos rotpos --json --count 100
    """
    with connected(args) as robot:
        _check_names(args.names, robot, robot.address)
        with Interruption(args.duration) as interruption:
            (_lines if args.json else _views)(robot, args, interruption)
        return interruption.status


def _check(sync_thread: SyncThread) -> None:
    if sync_thread.failure is not None:
        raise sync_thread.failure


def _lines(robot: Variables, args: argparse.Namespace, interruption: Interruption) -> None:
    """One JSON object for each update."""
    queue = PacketQueue(drop_oldest(16384))
    robot.subscribe(lambda update: queue.offer([update]), *args.names, policy=drop_oldest(16384))
    sync_thread = robot.background(args.period)
    shown = 0
    # On a terminal this is shown only while nothing is printed.
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
        tell(f"{queue.dropped} updates were dropped: the output was too slow for them")


def _views(robot: Variables, args: argparse.Namespace, interruption: Interruption) -> None:
    counter = RateCounter(clock.now())
    robot.subscribe(counter.on_update, *args.names)
    robot.subscribe_connection(counter.on_connection)
    sync_thread = robot.background(args.period)
    begun = clock.now()
    with drawing(args.plain, tell, View.as_line, lambda view: view) as (draw, pause):
        # The first view comes after the first syncs; before them there are only the values of the handshake.
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
    tell(f"next: rhdlink record {shlex.quote(args.address)} drive.urlog records what the robot sends")


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
