"""Tests of a pick-and-place program in simulated time, with lost connections to the robot.

`pick_and_place` stands for your program. In simulated time, it runs as fast as this computer can, on a simulated
computer next to that of the robot. The run is the same each time for the same seed, so a failure can be repeated. Run
it with pytest, or as a program, which prints how long it took.

    pytest examples/simulated_cell.py
    python examples/simulated_cell.py
"""

import contextlib
import time

import pytest

import urlink
from urlink.simulator import Controller, Still

ABOVE, PICK, PLACE = (
    (0.0, -1.57, 1.57, -1.57, -1.57, 0.0),
    (0.3, -1.4, 1.6, -1.77, -1.57, 0.0),
    (-0.3, -1.4, 1.6, -1.77, -1.57, 0.0),
)
GRIPPER = 0
ROBOT = "192.168.0.100"


def pick_and_place(address: str, parts: int, patience: float = 30.0) -> int:
    """Your program: carry some parts, and return their number.

    After a lost connection, it continues where it was.
    """
    carried = 0
    until = time.monotonic() + patience
    while carried < parts and time.monotonic() < until:
        with contextlib.suppress(urlink.RemoteError), urlink.connect(address, timeout=1.0, silence=0.5) as robot:
            robot.motion.stop(wait=True)  # ends a motion that a lost connection left behind
            while carried < parts:
                for where, is_closed in ((ABOVE, False), (PICK, True), (ABOVE, True), (PLACE, False)):
                    robot.motion.move_joints(where, speed=1.5).wait(10.0)
                    robot.io.set_digital_out(GRIPPER, is_closed)
                carried += 1
    return carried


def carried(seed: int, parts: int, *faults: str) -> tuple[int, float, int]:
    """Run the program next to a simulated robot.

    Returns:
        Number of carried parts, simulated time in s, and a checksum of the whole run.
    """
    with urlink.simulated_time(seed, limit=3600.0) as sim:
        cell = sim.computer("cell", ROBOT)
        with sim.on(cell):
            controller = Controller("UR5e", host=ROBOT, ports="standard", motion=Still()).start()
        sim.schedule(*faults)
        count = pick_and_place(ROBOT, parts)
        took = sim.now
        with sim.on(cell):
            controller.close()
        assert sim.threads == []
        assert sim.open_sockets == 0
        return count, took, sim.trace


@pytest.mark.parametrize("pulled", [0.05, 1.0])
def test_program_continues_after_lost_connection(pulled: float) -> None:
    count, took, _ = carried(1, 1, f"cut=cell@{pulled:.2f}", f"mend=cell@{pulled + 1.0:.2f}")
    assert count == 1
    assert took < 15.0


def test_same_seed_gives_same_run() -> None:
    faults = "reset=cell@1.5", "suspend=cell@2", "resume=cell@2.2"
    assert carried(7, 1, *faults) == carried(7, 1, *faults)


if __name__ == "__main__":
    begun = time.perf_counter()
    count, took, trace = carried(1, 20, "cut=cell@20.0", "mend=cell@21.5")
    print(f"{count} parts in {took:.1f} s of simulated time, in {time.perf_counter() - begun:.1f} s; trace {trace:08x}")
