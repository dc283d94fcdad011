"""A simulated controller that does and reports what it is asked; as a process: `python -m ... ARM FIRMWARE`."""

from __future__ import annotations

import sys
import time
from typing import Any

from urlink.simulator import Controller, Still

__all__ = ["READY", "Reports", "make"]

#: s; longer than every case takes, so that nothing is left behind.
_LONGEST = 300.0
#: rad/s above which the arm moves.
_MOVES = 1e-3
#: What is saved at its pendant.
FILES = {"/p.urp": "def p():\n  movej([0.8, -1.6, 1.6, -1.6, -1.6, 0.0], a=4, v=0.1)\nend\n"}
#: rad; elbow up, tool down.
READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)
#: N, along x; what a hand pushes with.
_PUSH = 20.0


def make(arm: str, firmware: str, **where: Any) -> Controller:
    return Controller(arm, firmware, motion=Still(READY), files=FILES, **where)


class Reports:
    """What the test asks. The arm is looked at in each cycle; seconds are those of the robot, boots included."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.until = time.monotonic() + _LONGEST
        self.rate = controller.firmware.rate
        self._marked = self._moved = 0
        self._longest_rest = 0
        advance = controller._control.advance

        def observed() -> None:
            advance()
            if self.moves():
                self._longest_rest = max(self._longest_rest, controller.cycle - self._moved)
                self._moved = controller.cycle

        controller._control.advance = observed  # type: ignore[method-assign]

    def moves(self) -> bool:
        return max(map(abs, self.controller.arm.setpoint.qd)) > _MOVES

    def state(self) -> tuple[Any, ...]:
        """What a call may change: joints, fingers, mode, outputs."""
        controller = self.controller
        outputs = controller.signals.digital_outputs
        return list(controller.arm.setpoint.q), controller.gripper.position, controller.modes.robot_mode.name, outputs

    def mark(self) -> None:
        """From now on counts what `moved` reports."""
        self._marked = self._moved = self.controller.cycle
        self._longest_rest = 0

    def moved(self) -> tuple[float, float]:
        """s from the mark to the last cycle in which the arm moved, and for which it rested at most until then."""
        return (self._moved - self._marked) / self.rate, self._longest_rest / self.rate

    def after(self, seconds: float) -> None:
        """So much later."""
        end = self.controller.cycle + seconds * self.rate
        while self.controller.cycle < end and time.monotonic() < self.until:
            time.sleep(0.01)

    def end(self) -> list[float]:
        """Where the joints are, in 1e-4 rad, when the arm has come to rest."""
        while self.controller.cycle - self._moved < self.rate and time.monotonic() < self.until:
            time.sleep(0.01)
        return [round(each, 4) for each in self.controller.arm.setpoint.q]

    def push(self, is_pushed: bool) -> None:
        self.controller.push([_PUSH if is_pushed else 0.0, 0, 0, 0, 0, 0])

    def cut(self) -> None:
        self.controller.faults.cut()

    def reboot(self) -> None:
        self.controller.faults.reboot()


def main(arm: str, firmware: str) -> None:
    with make(arm, firmware) as controller:
        reports = Reports(controller)
        print(controller.address, flush=True)
        for line in sys.stdin:
            name, *arguments = line.split()
            print(repr(getattr(reports, name)(*map(float, arguments))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
