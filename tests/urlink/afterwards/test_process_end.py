"""The arm stops when a program ends without closing its robot, unless the script was started as detached."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

import urlink
from urlink.simulator import Controller

pytestmark = [pytest.mark.real_time, pytest.mark.slow]

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
SCRIPT = "movej([2, -1.57, 1.57, -1.57, -1.57, 0], v=0.2)"
BEGIN = {
    "motion": "robot.motion.move_joints([2, -1.57, 1.57, -1.57, -1.57, 0], speed=0.2)",
    "script": f"robot.script.run({SCRIPT!r})",
    "detached": f"robot.script.run({SCRIPT!r}, detached=True)",
    "force": "block = robot.motion.force_mode('base', [0, 0, 1, 0, 0, 0], [0, 0, 20, 0, 0, 0], [0.1] * 6); "
    "block.__enter__()",
}
CHILD = """
import sys, time, urlink
robot = urlink.connect(sys.argv[1])
{begin}
deadline = time.monotonic() + 20
while not abs(robot.realtime.wait().qd_actual).max() > 0.01 and time.monotonic() < deadline:
    pass
print("moving", flush=True)
{end}
"""


@pytest.fixture(scope="module")
def controller() -> Iterator[Controller]:
    with Controller(model="ur5e", firmware="5.11") as controller:
        yield controller


@pytest.fixture
def robot(controller: Controller) -> Iterator[urlink.Robot]:
    with urlink.connect(controller.address) as robot:
        robot.motion.move_joints(HOME, speed=2.0).wait(20)
        yield robot


@pytest.mark.parametrize("begin", BEGIN)
@pytest.mark.parametrize("end", ["exit", "SIGTERM", "SIGINT"])
def test_arm_stops_when_the_process_ends(controller: Controller, robot: urlink.Robot, begin: str, end: str) -> None:
    lines = CHILD.format(begin=BEGIN[begin], end="" if end == "exit" else "time.sleep(30)")
    child = subprocess.Popen(
        [sys.executable, "-c", lines, str(controller.address)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == "moving\n", child.communicate()
        if end != "exit":
            child.send_signal(getattr(signal, end))
        _, errors = child.communicate(timeout=20)
    finally:
        child.kill()
    assert child.returncode == {"exit": 0, "SIGTERM": -signal.SIGTERM, "SIGINT": -signal.SIGINT}[end]
    if begin == "detached":
        assert robot.safety.is_enabled
        robot.realtime.wait_until(lambda state: abs(state.qd_actual).max() > 0.15, timeout=3.0)
    else:
        robot.realtime.wait_until(lambda state: abs(state.qd_actual).max() < 1e-3, timeout=3.0)
        assert "its robot was not closed" in errors
