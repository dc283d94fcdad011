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
    "measure how regularly states come",
    *ADDRESS,
    interface_of(INTERFACES),
    argument("--window", type=positive_int, default=1000, metavar="N", help="periods to look back on (1000)"),
    DURATION,
)
def run(args: argparse.Namespace) -> int:
    """Measure how regularly states come, by the times at which their bytes arrived here.

    One line a second: the rate, the shortest, mean and longest period and its standard deviation over the
    last --window periods, and what the stream has counted since the start; missed is what never came, and
    duplicates what came twice, by the controller's own clock. States that arrive in one segment have a period
    of zero between them. On e-Series the real-time interface sends 500 states a second, on CB2 and CB3 125,
    the primary and secondary interface 10.

    examples:
      urlink hz 192.168.56.101
      urlink hz sim:// --duration 10 --window 5000
      urlink hz 192.168.56.101 --interface primary
    """
    kind = RealtimeState if args.interface == "realtime" else RobotState
    with connected(args) as robot:
        measure(getattr(robot, args.interface), kind, args.window, args.duration, quiet=args.quiet)
    return 0
