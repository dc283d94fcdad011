"""`urlink hz`: measures the rate and jitter of incoming states."""

from __future__ import annotations

import argparse

from linkcore.cli.options import DURATION, argument, command, positive_int

from ..protocol.ports import INTERFACES
from ..protocol.primary.robot_state import RobotState
from ..protocol.realtime.packets import RealtimeState
from .options import ADDRESS, connected, interface_of
from .rate_measurement import measure


@command(
    "hz",
    "measure the rate and jitter of incoming states",
    *ADDRESS,
    interface_of(INTERFACES),
    argument("--window", type=positive_int, default=1000, metavar="N", help="number of last periods (default: 1000)"),
    DURATION,
)
def run(args: argparse.Namespace) -> int:
    """Measure the rate and jitter of incoming states, based on the times at which their bytes arrive.

    Each second, one line is printed: the rate, the shortest, mean and longest period, and the standard deviation of
    the period over the last --window periods. The line ends with the counters of the stream since the start. `missed`
    counts states that never arrived, and `duplicates` counts states that arrived twice, based on the controller's
    clock. States that arrive in one segment have a period of zero between them. The real-time interface sends 500
    states a second on e-Series and 125 on CB2 and CB3. The primary and secondary interfaces send 10.

    examples:
      urlink hz 192.168.56.101
      urlink hz sim:// --duration 10 --window 5000
      urlink hz 192.168.56.101 --interface primary
    """
    kind = RealtimeState if args.interface == "realtime" else RobotState
    with connected(args) as robot:
        measure(getattr(robot, args.interface), kind, args.window, args.duration, quiet=args.quiet)
    return 0
