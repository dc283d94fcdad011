"""`urlink echo`: prints packets, one line each."""

from __future__ import annotations

import argparse

from linkcore.cli.options import command

from .options import ADDRESS, connected
from .packet_printing import PRINTED, kind_of, print_packets, shower


@command("echo", "print packets, one line each", *ADDRESS, *PRINTED)
def run(args: argparse.Namespace) -> int:
    """Print every packet in order, one line each.

    Without FIELD, a line contains all fields. Fields of the real-time interface are named directly, for example
    q_actual. Fields of robot states (--interface primary) follow the name of their sub-package, for example
    joint_data.q_actual. --type selects sub-packages, messages or other packages by class. A field that the controller
    does not send is printed as "-", and as null in JSON. If the output is too slow, packets are dropped. The number of
    dropped packets is printed on stderr at the end.

    examples:
      urlink echo 192.168.56.101 q_actual tcp_force
      urlink echo sim:// --json --count 1
      urlink echo 192.168.56.101 --interface primary joint_data.T_motor robot_mode_data.robot_mode
      urlink echo 192.168.56.101 --type RobotMessage
    """
    interface, kind = kind_of(args)
    show = shower(args, kind)
    with connected(args) as robot:
        print_packets(robot, interface, kind, show, args)
    return 0
