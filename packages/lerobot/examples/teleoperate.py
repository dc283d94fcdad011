"""Let one arm follow another that a person moves by hand, with LeRobot's own interfaces.

python teleoperate.py 192.168.56.101 192.168.56.102      # leader, follower
python teleoperate.py "sim://?motion=demo" sim:// --seconds 2
"""

from __future__ import annotations

import argparse
import time

from lerobot_robot_urlink import UR, URConfig, URLeader, URLeaderConfig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("leader")
    parser.add_argument("follower")
    parser.add_argument("--seconds", type=float, default=60.0)
    args = parser.parse_args()
    leader, follower = URLeader(URLeaderConfig(address=args.leader)), UR(URConfig(address=args.follower, fps=50.0))
    leader.connect()
    try:
        follower.connect()
        try:
            end = time.monotonic() + args.seconds
            while time.monotonic() < end:
                follower.send_action(leader.get_action())
                time.sleep(1.0 / follower.config.fps)
            print({name: round(value, 3) for name, value in follower.get_observation().items()})
        finally:
            follower.disconnect()
    finally:
        leader.disconnect()


if __name__ == "__main__":
    main()
