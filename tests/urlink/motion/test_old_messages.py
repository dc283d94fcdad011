"""Messages that were queued while the controller hung, and programs that end by its clock."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import ConnectionLost
from linkcore.simulated import Computer, Simulation, simulated_time
from tests.fakes.rehearsal import turned
from tests.urlink.motion.bench import Bench
from urlink.protocol.firmware import Firmware
from urlink.robot import Robot
from urlink.script.force_control import Pressing, force_mode, freedrive
from urlink.script.links import LINK_ENDED, STARVED, ReverseSocket
from urlink.script.messages import WAIT_MESSAGE, dated, setpoint
from urlink.script.streaming import jogging, streaming
from urlink.simulator import Controller, Still

STILL = [0.0] * 6
LINK = ReverseSocket("10.0.0.1", 50001, 7)
#: one firmware of CB2, CB3, e-Series and PolyScope X
FIRMWARES = ["1.8", "3.15", "5.11", "10.12"]
#: Time in s of the robot without a message until it brakes, and speed of the moved joint in rad/s.
WATCHDOG, SPEED = 0.1, 0.5
CELL = "192.168.0.100"


@pytest.mark.parametrize("firmware", [*map(Firmware.parse, FIRMWARES)], ids=str)
@pytest.mark.parametrize("late", [0.0, 0.09])
def test_late_messages_are_obeyed_within_watchdog_time(firmware: Firmware, late: float) -> None:
    """Some states reach this computer late, by nearly the time of the watchdog, and others immediately."""
    bench = Bench(streaming(firmware, LINK, speeds=[3.0] * 6, watchdog=WATCHDOG), firmware)
    bench.run(5, lambda: bench.deliver(WAIT_MESSAGE))
    begin, most = bench.cycle, round(late * firmware.rate)

    def feed() -> None:
        i = bench.cycle - begin
        message = setpoint(turned(SPEED * i * bench.period), [*STILL[:5], SPEED])
        bench.sockets.waiting += dated(message, max(bench.cycle - i % (most + 1), 0))

    bench.run(firmware.rate, feed)
    assert not bench.execution.is_over
    # The look-ahead time of CB3 makes the arm lag by about a tenth of a second.
    assert bench.q_actual[5] == pytest.approx(turned(SPEED)[5], abs=0.06)


@pytest.mark.parametrize("firmware", [*map(Firmware.parse, FIRMWARES)], ids=str)
def test_old_set_points_are_followed_for_one_watchdog_time(firmware: Firmware) -> None:
    bench = Bench(streaming(firmware, LINK, speeds=[3.0] * 6, watchdog=WATCHDOG), firmware)
    bench.run(5, lambda: bench.deliver(WAIT_MESSAGE))
    last = bench.cycle  # cycle of the last state before the controller hung

    def feed() -> None:
        message = setpoint(turned(SPEED * (bench.cycle - last) * bench.period), [*STILL[:5], SPEED])
        bench.sockets.waiting += dated(message, last)

    told: list[float] = []
    bench.watch_servoj(lambda q: told.append(q[5]))
    bench.run(firmware.rate, feed)
    assert bench.execution.is_over
    assert STARVED in bench.said
    # The arm follows set-points for the watchdog's time, then coasts for the same time, half as far.
    assert told[-1] - turned(0.0)[5] == pytest.approx(1.5 * WATCHDOG * SPEED, abs=0.02)


@pytest.mark.parametrize("version", FIRMWARES)
def test_old_speeds_are_obeyed_for_one_watchdog_time(version: str) -> None:
    firmware = Firmware.parse(version)
    body = jogging(firmware, LINK, is_tool=False, acceleration=5.0, watchdog=WATCHDOG)
    bench = Bench(body, firmware)
    bench.run(5, lambda: bench.deliver(WAIT_MESSAGE))
    last, before = bench.cycle, bench.q_actual[5]

    def feed() -> None:
        bench.sockets.waiting += dated(setpoint([*STILL[:5], SPEED], STILL), last)

    bench.run(firmware.rate, feed)
    assert bench.execution.is_over
    assert STARVED in bench.said
    # The arm keeps the last speed for the same time as the old ones; a tenth of a second is for changes of speed.
    assert 0.0 < bench.q_actual[5] - before < 3.0 * WATCHDOG * SPEED


def followed(firmware: Firmware, watchdog: float) -> Bench:
    """Return a program that has received a set-point in each cycle for a fifth of a second."""
    bench = Bench(streaming(firmware, LINK, speeds=[3.0] * 6, watchdog=watchdog), firmware)
    bench.run(5, lambda: bench.deliver(WAIT_MESSAGE))
    bench.run(firmware.rate // 5, lambda: bench.deliver(setpoint(turned(0.0), STILL)))
    return bench


@pytest.mark.slow
@pytest.mark.matrix(4)
@pytest.mark.parametrize("firmware", [*map(Firmware.parse, FIRMWARES)], ids=str)
@pytest.mark.parametrize("watchdog", [WATCHDOG, 1.9, 3.0, 5.0, 10.0])
def test_silence_ends_program_after_watchdog_time(firmware: Firmware, watchdog: float) -> None:
    """This also holds for watchdogs longer than the program's read timeout, which is 2 s."""
    bench = followed(firmware, watchdog)
    bench.run(round((watchdog - 0.05) * firmware.rate))
    assert bench.said == []
    bench.run(round(0.1 * firmware.rate))
    assert bench.said == [STARVED]
    bench.run(3 * firmware.rate)
    assert bench.execution.is_over


@pytest.mark.parametrize("firmware", [*map(Firmware.parse, FIRMWARES)], ids=str)
@pytest.mark.parametrize("watchdog", [WATCHDOG, 5.0])
def test_closed_connection_ends_program_at_once(firmware: Firmware, watchdog: float) -> None:
    bench = followed(firmware, watchdog)
    bench.sockets.is_open = False
    bench.run(round(0.3 * firmware.rate))
    assert bench.said == [LINK_ENDED]
    assert bench.execution.is_over


@pytest.mark.parametrize("watchdog", [WATCHDOG, 5.0])
def test_program_without_first_set_point_ends(watchdog: float) -> None:
    firmware = Firmware(5, 11)
    bench = Bench(streaming(firmware, LINK, speeds=[3.0] * 6, watchdog=watchdog), firmware)
    bench.run(5, lambda: bench.deliver(WAIT_MESSAGE))
    bench.run(round(max(watchdog, 2.0) + 2.0) * firmware.rate)
    assert bench.said == [LINK_ENDED]
    assert bench.execution.is_over


class Compliant(Bench):
    """Bench that records the compliant modes, without an arm."""

    modes: tuple[str, ...] = ()
    pose_target = (0.0,) * 6

    def force_mode(self, task: object) -> None:
        self.modes = (*self.modes, "force_mode")

    def freedrive(self, axes: object, frame: object) -> None:
        self.modes = (*self.modes, "freedrive")

    def end_compliance(self) -> None:
        self.modes = (*self.modes, "end")

    def set_force_damping(self, damping: float) -> None:
        pass

    set_force_gain = set_force_damping


@pytest.mark.parametrize("version", ["3.15", "5.11", "10.12"])
@pytest.mark.parametrize("kind", ["force_mode", "freedrive"])
def test_old_messages_end_compliant_mode(version: str, kind: str) -> None:
    firmware = Firmware.parse(version)
    if kind == "force_mode":
        axes, limits = (False, False, True, False, False, False), (0.1,) * 6
        pressing = Pressing(tuple(STILL), axes, limits, kind=2, damping=None, gain=None)
        body = force_mode(firmware, LINK, pressing, watchdog=WATCHDOG)
    else:
        body = freedrive(firmware, LINK, None, STILL, watchdog=WATCHDOG)
    bench = Compliant(body, firmware)
    message = setpoint([0.0, 0.0, -10.0, 0.0, 0.0, 0.0], STILL)
    bench.run(5, lambda: bench.deliver(WAIT_MESSAGE))
    bench.run(firmware.rate, lambda: bench.deliver(message))
    assert list(bench.modes) == [kind]
    last = bench.cycle  # cycle of the last state before the controller hung

    def feed() -> None:
        bench.sockets.waiting += dated(message, last)

    # For the watchdog's time, messages might be late because of jitter. After the same time again, the mode ends.
    bench.run(round(1.8 * WATCHDOG * firmware.rate), feed)
    assert list(bench.modes) == [kind]
    bench.run(round(0.4 * WATCHDOG * firmware.rate), feed)
    assert list(bench.modes) == [kind, "end"]
    assert STARVED in bench.said


# -- controller and client, in simulated time -----------------------------------------------------------------------


class Ends:
    """A controller on its own computer, and a robot that is connected to it."""

    def __init__(self, sim: Simulation, cell: Computer, controller: Controller, robot: Robot) -> None:
        self.sim, self.cell, self.controller, self.robot = sim, cell, controller, robot

    @property
    def base(self) -> float:
        """Commanded position of the base, in rad."""
        return float(self.controller.arm.setpoint.q[0])

    @property
    def speed(self) -> float:
        """Speed of the fastest joint, in rad/s."""
        return max(map(abs, self.controller.arm.setpoint.qd))

    def hang(self, seconds: float) -> None:
        """Suspend the controller for `seconds`, starting now."""
        self.cell.suspend()
        self.sim.at(self.sim.now + seconds, self.cell.resume)


@contextlib.contextmanager
def ends(arm: str, firmware: str) -> Iterator[Ends]:
    with simulated_time(1, latency=0.0005, jitter=0.0, limit=60.0) as sim:
        cell = sim.computer("cell", CELL)
        with sim.on(cell):
            controller = Controller(arm, firmware, host=CELL, ports="standard", motion=Still()).start()
        with urlink.connect(CELL) as robot:
            robot.realtime.wait()
            yield Ends(sim, cell, controller, robot)
        with sim.on(cell):
            controller.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arm", "firmware", "link"),
    [
        ("UR5", "1.8", "reverse"),
        ("UR5", "3.15", "reverse"),
        ("UR5e", "5.11", "reverse"),
        ("UR5e", "10.12", "reverse"),
        ("UR5", "3.15", "rtde"),
        ("UR5e", "5.11", "rtde"),
        ("UR5e", "10.12", "rtde"),
    ],
)
def test_hung_controller_does_not_catch_up(arm: str, firmware: str, link: str) -> None:
    """A loop continues, by the clock of this computer, while the controller hangs for 0.8 s."""
    with ends(arm, firmware) as both:
        robot, cycle = both.robot, 1.0 / both.robot.firmware.rate
        way: dict[str, Any] = {} if link == "reverse" else {"link": link}
        hung: float | None = None
        with pytest.raises(ConnectionLost), robot.motion.servo(watchdog=WATCHDOG, **way) as servo:  # noqa: PT012 -- any of its set-points may fail
            begin, q = time.monotonic(), np.array(robot.realtime.wait().q_target)
            while (t := time.monotonic() - begin) < 3.0:
                servo.send(q + np.array([SPEED * t, 0.0, 0.0, 0.0, 0.0, 0.0]))
                if hung is None and t > 0.3:
                    hung = both.base
                    both.hang(0.8)
                time.sleep(cycle)
        assert hung is not None
        time.sleep(1.0)
        assert both.speed == 0.0
        # The watchdog's time at the old set-points, the same time coasting, and braking.
        assert 0.0 <= both.base - hung < 2.5 * WATCHDOG * SPEED


@pytest.mark.parametrize("share", [1.0, 0.2])
def test_torque_block_ends_at_rest_on_slow_controller(share: float) -> None:
    """At a fifth of its speed, the controller needs longer to brake than the library's own clock would wait."""
    with ends("UR5e", "10.12") as both:
        with both.robot.motion.torque(watchdog=0.5) as block:
            both.cell.rate = share
            end = time.monotonic() + 20.0
            while both.speed < 1.0:
                assert time.monotonic() < end
                block.send([30.0, 0.0, 0.0, 0.0, 0.0, 0.0])
                time.sleep(0.002)
        assert both.speed == 0.0
        assert block.error is None
