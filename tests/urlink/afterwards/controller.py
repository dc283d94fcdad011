"""Simulated controller that executes and reports requests of a test; as a process: `python -m ... ARM FIRMWARE`."""

from __future__ import annotations

import sys
import time
from typing import Any

from urlink.simulator import Controller, Still

__all__ = ["READY", "Reports", "make"]

#: Time limit for waits, in s. It is longer than every case, and ensures that no process is left behind.
_LONGEST = 300.0
#: Joint speed above which the arm counts as moving, in rad/s.
_MOVES = 1e-3
#: Programs that are saved on the pendant.
FILES = {"/p.urp": "def p():\n  movej([0.8, -1.6, 1.6, -1.6, -1.6, 0.0], a=4, v=0.1)\nend\n"}
#: Joint positions with the elbow up and the tool down, in rad.
READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)
#: Force along x with which a hand pushes the arm, in N.
_PUSH = 20.0


def make(arm: str, firmware: str, **where: Any) -> Controller:
    return Controller(arm, firmware, motion=Still(READY), files=FILES, **where)


class Reports:
    """Requests of the test. The arm is observed in each cycle. Times are seconds of the robot, including its boots."""

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
        """Return the values that a call may change: joints, fingers, mode and outputs."""
        controller = self.controller
        outputs = controller.signals.digital_outputs
        return list(controller.arm.setpoint.q), controller.gripper.position, controller.modes.robot_mode.name, outputs

    def mark(self) -> None:
        """Start the measurement that `moved` reports."""
        self._marked = self._moved = self.controller.cycle
        self._longest_rest = 0

    def moved(self) -> tuple[float, float]:
        """Return the time from the mark to the last movement, and the longest rest before it, both in s."""
        return (self._moved - self._marked) / self.rate, self._longest_rest / self.rate

    def after(self, seconds: float) -> None:
        """Wait for this time of the robot."""
        end = self.controller.cycle + seconds * self.rate
        while self.controller.cycle < end and time.monotonic() < self.until:
            time.sleep(0.01)

    def end(self) -> list[float]:
        """Wait until the arm is at rest, and return the joint positions, rounded to 1e-4 rad."""
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
