"""A simulated controller in a process of its own, which does and reports what it is told, line by line."""

from __future__ import annotations

import sys
import time
from typing import Any

from urlink.simulator import Controller, Still

#: s; longer than every case takes, so that nothing is left behind.
_LONGEST = 120.0
#: rad/s above which the arm moves, and s for which it has to rest.
_MOVES, _RESTS = 1e-3, 0.3
#: What is saved at its pendant.
FILES = {"/p.urp": "def p():\n  movej([0.8, -1.6, 1.6, -1.6, -1.6, 0.0], a=4, v=0.1)\nend\n"}
#: rad; elbow up, tool down.
READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)
#: N, along x; what a hand pushes with.
_PUSH = 20.0


class Reports:
    """What the test asks."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.until = time.monotonic() + _LONGEST

    def moves(self) -> bool:
        return max(map(abs, self.controller.arm.setpoint.qd)) > _MOVES

    def state(self) -> tuple[Any, ...]:
        """What a call may change: joints, fingers, mode, outputs."""
        controller = self.controller
        outputs = controller.signals.digital_outputs
        return list(controller.arm.setpoint.q), controller.gripper.position, controller.modes.robot_mode.name, outputs

    def rest(self, seconds: float) -> float:
        """s of the robot's time until nothing moves any more; `seconds` if that is not within them."""
        began = still = self.controller.time
        while (now := self.controller.time) < began + seconds and time.monotonic() < self.until:
            if self.moves():
                still = now
            if not began <= now or now - still > _RESTS:  # it has booted, or rests
                return still - began
            time.sleep(0.002)
        return seconds

    def after(self, seconds: float) -> None:
        """So much of the robot's time later."""
        end = self.controller.time + seconds
        while self.controller.time < end and time.monotonic() < self.until:
            time.sleep(0.002)

    def push(self, is_pushed: bool) -> None:
        self.controller.push([_PUSH if is_pushed else 0.0, 0, 0, 0, 0, 0])

    def cut(self) -> None:
        self.controller.faults.cut()

    def reboot(self) -> None:
        self.controller.faults.reboot()


def main(arm: str, firmware: str) -> None:
    with Controller(arm, firmware, motion=Still(READY), files=FILES) as controller:
        reports = Reports(controller)
        print(controller.address, flush=True)
        for line in sys.stdin:
            name, *arguments = line.split()
            print(repr(getattr(reports, name)(*map(float, arguments))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
