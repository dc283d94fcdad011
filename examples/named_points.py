"""Teach points by name, change the tool, check the points, and move to them.

python examples/named_points.py                                  # the simulator, and a temporary file
python examples/named_points.py 192.168.56.101 --file cell.json  # a robot; the arm moves by 5 cm
"""

import argparse
import sys
import tempfile
from pathlib import Path

import urlink


def work(robot, tool):
    """Teach two points, change the TCP to `tool` metres in front of the flange, and visit the points again."""
    motion, points = robot.motion, robot.points
    points.teach("at_part", replace=True)
    above = points["at_part"].pose.copy()
    above[2] += 0.05
    motion.move_linear(above, speed=0.1, wait=True)
    points.teach("above_part", replace=True)

    before = points["at_part"].tcp
    robot.set_tcp([0.0, 0.0, before[2] + tool, 0.0, 0.0, 0.0])
    try:
        for check in points.check_all():
            print(f"{check.name}: {check.verdict}, TCP changed by {check.moved * 1000:.0f} mm")
        try:
            motion.move_joints(points["above_part"], speed=0.3)
        except urlink.BadValue:
            print("refused without keep")
        motion.move_joints(points["above_part"], speed=0.3, keep="pose", wait=True)
        motion.move_linear(points["at_part"], speed=0.1, keep="pose", wait=True)
        off = abs(robot.realtime.wait().tool_vector_actual[:3] - points["at_part"].pose[:3]).max()
        print("the new TCP is at the part" if off < 1e-3 else f"the new TCP is {off:.4f} m away from the part")
    finally:
        robot.set_tcp(before)


def main() -> int:
    parser = argparse.ArgumentParser(description="Teach points by name, and move to them with another tool.")
    parser.add_argument("address", nargs="?", default="sim://ur5e", help="robot (default: sim://ur5e)")
    parser.add_argument("--file", help="JSON file of the points (default: a temporary file)")
    parser.add_argument("--tool", type=float, default=0.03, help="additional length of the tool, m (default: 0.03)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        try:
            with urlink.connect(args.address, points=args.file or Path(folder) / "cell.json") as robot:
                work(robot, args.tool)
        except urlink.LinkError as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
