"""`robot.clock` over a simulated network: drifting clocks, jitter, cut cables, and a restarted controller."""

from __future__ import annotations

import asyncio
import time

import pytest

import linkcore.clock
import urlink
from linkcore.errors import LinkTimeout, LocalError
from urlink.simulator import Controller

CELL = "192.168.0.100"


class Truth:
    """Clock that returns the exact time of a simulated controller on another computer, also between two cycles."""

    def __init__(self, sim: urlink.Simulation, controller: Controller) -> None:
        self._cell = sim.network.computers["cell"]
        self._sim = sim
        with sim.on(self._cell):
            self._began = linkcore.clock.now() - controller.time
            controller.start()

    def __call__(self) -> float:
        with self._sim.on(self._cell):
            return linkcore.clock.now() - self._began


@pytest.mark.slow
@pytest.mark.parametrize(
    ("firmware", "seed", "drift", "latency", "jitter"),
    [("5.11", 1, 100e-6, 1e-4, 5e-5), ("5.11", 2, -100e-6, 2e-3, 4e-3), ("3.15", 3, 60e-6, 5e-4, 1e-3)],
)
def test_clock_is_right_within_its_bound(firmware: str, seed: int, drift: float, latency: float, jitter: float) -> None:
    with urlink.simulated_time(seed, latency=latency, jitter=jitter) as sim:
        cell = sim.computer("cell", CELL)
        cell.rate, sim.here.rate = 1.0 + drift, 1.0 - 0.5 * drift
        with sim.on(cell):
            controller = Controller("UR5e" if firmware[0] == "5" else "UR5", firmware, host=CELL, ports="standard")
        truth = Truth(sim, controller)
        sim.schedule("cut=cell@8", "mend=cell@12", "reset=cell@20", "hold=here@24", "release=here@24.4")
        looks = wrong = 0
        with urlink.connect(CELL, silence=0.5) as robot:
            robot.realtime.wait()
            while sim.now < 30.0:
                time.sleep(sim.random.uniform(0.0, 0.02))
                true, now = truth(), linkcore.clock.now()
                off, bound = robot.clock.to_controller(now) - true, robot.clock.bound
                looks += 1
                wrong += abs(off) > bound
                assert robot.clock.to_local(true) - now == pytest.approx(-off, abs=1e-5)
            assert robot.realtime.stats.reconnects >= 2
            true_drift = (1.0 + drift) / (1.0 - 0.5 * drift) - 1.0
            assert robot.clock.drift == pytest.approx(true_drift, abs=2e-5 + 0.02 * jitter)
            assert robot.clock.offset == pytest.approx(true - now, abs=2.0 * bound)
            assert robot.clock.bound < 0.5 * (0.002 if firmware[0] == "5" else 0.008) + latency + 1.5 * jitter + 2e-4
            assert robot.clock.restarts == 0
            assert "ppm, within" in repr(robot.clock)
        with sim.on(cell):
            controller.close()
        assert looks > 2000
        assert wrong <= 0.001 * looks


@pytest.mark.slow
def test_clock_detects_restart_of_controller() -> None:
    with urlink.simulated_time(4) as sim:
        cell = sim.computer("cell", CELL)
        with sim.on(cell):
            controller = Controller("UR5e", host=CELL, ports="standard").start()
        with urlink.connect(CELL, silence=0.5) as robot:
            robot.realtime.wait()
            time.sleep(5.0)
            controller.faults.reboot(downtime=10.0)
            robot.realtime.of(urlink.ConnectionEvent).wait_until(
                lambda event: event.state is urlink.ConnectionState.CONNECTED, 60.0
            )
            robot.realtime.wait()
            time.sleep(0.1)
            assert robot.clock.restarts == 1
            # The time is that of the current cycle, which takes 2 ms.
            middle = pytest.approx(controller.time + 0.001, abs=robot.clock.bound + 0.001)
            assert robot.clock.to_controller(linkcore.clock.now()) == middle
        with sim.on(cell):
            controller.close()


@pytest.mark.simulated_time
def test_robot_clock_converts_after_the_first_state() -> None:
    with urlink.connect("sim://ur5e") as robot:
        clock = robot.clock
        assert repr(clock) == "<RobotClock: no state has arrived>"
        assert clock.to_local(robot.realtime.wait().time) == pytest.approx(linkcore.clock.now(), abs=0.05)
        robot.realtime.wait_until(lambda state: robot.clock.bound < 0.01)
    with urlink.connect("sim://ur5e") as robot:
        robot.controller.faults.stall(3600.0, "realtime")
        with pytest.raises(LinkTimeout):
            _ = robot.clock.offset


@pytest.mark.simulated_time
def test_clock_does_not_wait_in_asyncio() -> None:
    async def ask() -> None:
        async with urlink.connect_async("sim://ur5e") as robot:
            with pytest.raises(LocalError):
                _ = robot.clock.offset
            state = await robot.realtime.wait()
            assert state.received is not None
            assert robot.clock.to_local(state.time) == pytest.approx(state.received.monotonic, abs=0.05)

    asyncio.run(ask())
