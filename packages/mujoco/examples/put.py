"""Take a box from one place of a table and put it at another, once for each given place.

python put.py                        # in the simulator, with table.xml in this folder
python put.py 192.168.56.101         # the same program on another controller, without a world to inspect
"""

from __future__ import annotations

import math
import sys
from itertools import pairwise
from pathlib import Path

import urlink

DOWN = (math.pi, 0.0, 0.0)
#: Positions in the base frame, in m: the first place of the box, and the next ones.
PLACES = ((-0.45, 0.2), (-0.55, -0.2), (-0.35, -0.1))
ABOVE, AT = 0.15, 0.026


def main(address: str) -> None:
    with urlink.connect(address) as robot:
        robot.gripper.activate()
        world = None
        if robot.controller is not None:
            world = getattr(robot.controller.world.scene, "world", None)

        def go(place: tuple[float, float], height: float) -> None:
            robot.motion.move_linear([*place, height, *DOWN], speed=0.25, acceleration=1.0, wait=True)

        go(PLACES[0], ABOVE)
        for place, next_one in pairwise(PLACES):
            go(place, AT)
            held = robot.gripper.close()
            print(
                f"between the fingers: {1000 * held.opening():.0f} mm"
                if held.object_detected
                else "no object between the fingers"
            )
            go(place, ABOVE)
            go(next_one, ABOVE)
            go(next_one, AT)
            robot.gripper.open()
            go(next_one, ABOVE)
            if world is not None:
                print("position of the box:", world.pose("box")[:3].round(3).tolist())


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else f"sim://ur5e?scene={Path(__file__).with_name('table.xml')}")
