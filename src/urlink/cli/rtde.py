"""`urlink rtde`: prints variables of the controller by name."""

from __future__ import annotations

import argparse
import csv
import io
import itertools
import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from typing import Any

from linkcore import clock
from linkcore.cli.options import DURATION, argument, command, one_of, positive_int, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.errors import BadValue
from linkcore.text import strict_json
from linkcore.wire.state import State, plain

from ..protocol.rtde.recipes import Outputs
from ..robot import Robot
from ..rtde import INPUTS, OUTPUTS, OutputStream, Variable
from .options import ADDRESS, connected, tell
from .packet_fields import as_json, as_text
from .packet_stream import Tap
from .rate_measurement import measure


@command(
    "rtde",
    "print variables of the controller",
    *ADDRESS,
    argument(
        "names",
        metavar="NAME",
        nargs="*",
        help="variables to print, such as actual_q",
        words=lambda: OUTPUTS,
        trailing=True,
    ),
    argument("--list", action="store_true", help="print the variables that this controller has, and end"),
    argument("--frequency", type=float, metavar="HZ", help="packages per second (default: the controller's rate)"),
    argument("--leave-out", action="store_true", help="skip variables that the controller does not have"),
    one_of(
        argument("--json", action="store_true", help="print one JSON object per line; NaN and infinities are null"),
        argument("--csv", action="store_true", help="print a header, then one line each, with a column per number"),
        argument("--hz", action="store_true", help="measure the rate and jitter of packages, as `urlink hz` does"),
    ),
    argument("--record", metavar="FILE", help="also record into a file, which must not exist yet"),
    argument(
        "--count", type=positive_int, metavar="N", help="end after N lines; --hz prints one per second (default: never)"
    ),
    DURATION,
    argument("--timeout", type=seconds, metavar="S", help="fail if nothing arrives for S seconds (default: never)"),
)
def run(args: argparse.Namespace) -> int:
    """Print variables of the controller over RTDE (port 30004), one line per data package.

    --list prints the variables that this controller has, with their types and units, and the inputs that another
    client has claimed. A variable that the controller does not have is an error, unless --leave-out is given. --record
    also writes the packages to a file. If the address is a recording, you do not have to name the variables.

    examples:
      urlink rtde 192.168.56.101 actual_q actual_TCP_pose --frequency 125
      urlink rtde sim:// timestamp actual_q --csv --count 500 > run.csv
      urlink rtde 192.168.56.101 --list
      urlink rtde 192.168.56.101 timestamp --hz --duration 10
      urlink rtde 192.168.56.101 actual_q output_double_register_24 --record run.urlog
      urlink rtde replay:///tmp/run.urlog --json
    """
    if args.list and args.duration is not None:
        args.usage_error("--list ends on its own; omit --duration")
    with connected(args) as robot:
        if args.list:
            with ProgressBar("checking every variable", args.quiet):
                _list(robot)
            return 0
        missing: Any = "leave_out" if args.leave_out else "error"
        stream: OutputStream[Any] = robot.rtde.outputs(*args.names, frequency=args.frequency, missing=missing)
        with nullcontext() if args.record is None else robot.record(args.record, [stream]):
            if args.hz:
                measure(stream, Outputs, 1000, args.duration, args.count, quiet=args.quiet)
            else:
                _print(stream, args)
    return 0


def _print(stream: OutputStream[Any], args: argparse.Namespace) -> None:
    names = args.names or list(stream.names)
    # On a terminal, the progress bar is shown only until the first package is printed. `Tap` connects and subscribes; a
    # recording starts to play at this subscription.
    with ProgressBar("waiting for RTDE", args.quiet) as progress, Tap(stream, Outputs) as tap:
        if stream.left_out:
            tell(f"this controller does not have {', '.join(stream.left_out)}")
        show = _as_json if args.json else _csv_of(stream, names) if args.csv else _as_line(names)
        begun = clock.now()
        packets = itertools.islice(tap.packets(args.timeout, args.duration), args.count)
        for number, packet in enumerate(packets, 1):
            print(show(packet), flush=True)
            by_time = (clock.now() - begun) / (args.duration or math.inf)
            progress(max(by_time, number / (args.count or math.inf)), f"{number} packages printed")


def _as_json(packet: State) -> str:
    return strict_json(as_json(packet))


def _as_line(names: Sequence[str]) -> Callable[[State], str]:
    return lambda packet: " ".join(f"{name}={as_text(getattr(packet, name))}" for name in names)


def _csv_of(stream: OutputStream[Any], names: Sequence[str]) -> Callable[[State], str]:
    """Print the header line; return a function that formats a packet as a line."""
    recipe = stream.recipe
    assert recipe is not None, "the stream is connected"
    counts = {name: recipe.fields[name].shape.count for name in names if name in recipe.fields}
    columns = ["received"]
    for name in names:
        count = counts.get(name)
        columns += [name] if count is None else [f"{name}_{number}" for number in range(count)]
    print(_csv_line(columns))

    def line(packet: State) -> str:
        row: list[Any] = ["" if packet.received is None else packet.received.wall]
        for name in names:
            value = plain(getattr(packet, name))
            row += value if isinstance(value, list) else [value]
        return _csv_line(row)

    return line


def _csv_line(row: Sequence[Any]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(["" if cell is None else cell for cell in row])
    return text.getvalue()


def _list(robot: Robot) -> None:
    """Print the variables of the table, and which of them this controller has.

    Raises:
        BadValue: If the address is a recording.
    """
    if robot.rtde.is_recorded:
        raise BadValue(f"{robot.address} is a recording; it contains {', '.join(robot.rtde.outputs().names)}")
    missing = set(robot.rtde.missing())
    held = robot.rtde.who_holds()
    print("outputs")
    for variable in OUTPUTS.values():
        if variable.name not in missing:
            print(_described(variable, ""))
    print("inputs")
    for variable in INPUTS.values():
        if held.get(variable.name) != "not there":
            print(_described(variable, held.get(variable.name, "")))
    if missing:
        print("outputs of other firmware, which this controller does not have")
        for name in sorted(missing):
            print(_described(OUTPUTS[name], ""))


def _described(variable: Variable, note: str) -> str:
    unit = f" [{variable.unit}]" if variable.unit else ""
    mark = f"  ({note})" if note else ""
    return f"  {variable.name:42} {variable.type:13} {variable.doc}{unit}{mark}"
