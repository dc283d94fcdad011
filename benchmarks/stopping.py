"""Time until a program that uses asyncio sends a stop to the robot, while other calls of the same robot wait.

It is measured from the cancellation of a task that awaits a motion, and from ``await robot.motion.stop()``, until the
stop leaves this computer: alone, with 100 waits that were cancelled before, and with 100 waits that continue. The last
row is ``robot.close()`` with 100 waits that continue. In simulated time, computing takes no time, so only waiting
shows.

    python benchmarks/stopping.py                            # real and simulated time
    python benchmarks/stopping.py --quick                    # few repetitions
    python benchmarks/stopping.py --waits 500
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import statistics
import warnings
from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple

from _simulated import simulated

import urlink
from linkcore import clock
from linkcore.errors import LinkError
from linkcore.net.transport import TcpTransport
from urlink.simulator import Controller

#: Time difference, in s, below which two times count as equal.
RESOLUTION = 1e-6
#: Time, in s, between the cancellation of the waits and the stop; time for a motion to start.
PAUSE, BEGIN = 0.05, 0.3
SIMULATED = "192.168.0.100"


class Row(NamedTuple):
    """Times of the repetitions, in s."""

    what: str
    seconds: list[float]

    def shown(self, alone: Row | None) -> str:
        median, most = statistics.median(self.seconds), max(self.seconds)
        times = (
            "" if alone is None else f"{(median + RESOLUTION) / (statistics.median(alone.seconds) + RESOLUTION):6.2f}"
        )
        return f"{self.what:52} {median * 1e3:9.3f} {most * 1e3:9.3f} {times:>8}"


class Wire:
    """Record of the times at which a stop leaves this computer."""

    def __init__(self) -> None:
        self.stopped_at: list[float] = []
        send_some = TcpTransport.send_some

        def noting(transport: TcpTransport, data: bytes | memoryview) -> int:
            if b"urlink_stop" in bytes(data) or b"stopj" in bytes(data):
                self.stopped_at.append(clock.now())
            return send_some(transport, data)

        TcpTransport.send_some = noting  # type: ignore[method-assign, assignment]

    async def after(self, began: float) -> float:
        """Return the time, in s, from `began` to the first stop."""
        for _ in range(10_000):
            for at in tuple(self.stopped_at):
                if at >= began:
                    return at - began
            await asyncio.sleep(0.001)
        raise SystemExit("no stop was sent")


class Waits:
    """Calls that wait for an input that does not arrive."""

    def __init__(self, robot: urlink.AsyncRobot, count: int) -> None:
        self._tasks = [asyncio.create_task(self._wait(robot)) for _ in range(count)]

    async def _wait(self, robot: urlink.AsyncRobot) -> None:
        with contextlib.suppress(LinkError):  # the robot was closed
            await robot.io.wait_digital_in(0, True, timeout=60.0)

    async def cancel(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


async def _stop_after(
    robot: urlink.AsyncRobot, wire: Wire, *, by_cancel: bool, count: int, are_cancelled: bool
) -> float:
    """Return the time to the stop of a motion, in s, with `count` waits that start after it."""
    state = await robot.realtime.wait()
    far = state.q_target + (0.5 if state.q_target[0] < 0.0 else -0.5)
    motion = await robot.motion.move_joints(far, speed=0.3, wait=False)

    async def await_it() -> None:
        await motion

    task = asyncio.create_task(await_it())
    waits = Waits(robot, count)
    await asyncio.sleep(BEGIN)
    if are_cancelled:
        await waits.cancel()
        await asyncio.sleep(PAUSE)
    began = clock.now()
    if by_cancel:
        task.cancel()
    else:
        await robot.motion.stop()
    seconds = await wire.after(began)
    await asyncio.gather(task, return_exceptions=True)
    await waits.cancel()
    await robot.motion.stop(wait=True)
    return seconds


async def measured(address: str, wire: Wire, repetitions: int, count: int) -> list[tuple[Row, Row | None]]:
    rows: list[tuple[Row, Row | None]] = []
    for by_cancel, what in ((True, "cancel of a task"), (False, "await stop()")):
        alone: Row | None = None
        for beside in ("alone", f"with {count} cancelled waits", f"with {count} waits that continue"):
            row = Row(f"{what} {beside}", [])
            async with urlink.connect_async(address) as robot:
                await robot.realtime.wait()
                for _ in range(repetitions):
                    seconds = await _stop_after(
                        robot,
                        wire,
                        by_cancel=by_cancel,
                        count=0 if alone is None else count,
                        are_cancelled="cancelled" in beside,
                    )
                    row.seconds.append(seconds)
            rows.append((row, alone))
            alone = alone or row
    closing = Row(f"close() with {count} waits that continue", [])
    for _ in range(repetitions):
        robot = await urlink.connect_async(address)
        await robot.realtime.wait()
        waits = Waits(robot, count)
        await asyncio.sleep(PAUSE)
        began = clock.now()
        await robot.close()
        closing.seconds.append(clock.now() - began)
        await waits.cancel()
    rows.append((closing, None))
    return rows


def show(title: str, run: Callable[[], Coroutine[Any, Any, list[tuple[Row, Row | None]]]]) -> None:
    print(f"{title:52} {'median ms':>9} {'max ms':>9} {'multiple':>8}")
    for row, alone in asyncio.run(run()):
        print(row.shown(alone))


def main() -> None:
    parser = argparse.ArgumentParser(description="measure the time to a stop with asyncio while other calls wait")
    parser.add_argument("--quick", action="store_true", help="few repetitions")
    parser.add_argument("--waits", type=int, default=100, help="number of calls that wait (default: 100)")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    repetitions = 5 if options.quick else 30
    wire = Wire()
    with simulated("UR5e", "5.25") as address:
        show("real time", lambda: measured(address, wire, repetitions, options.waits))
    wire.stopped_at.clear()
    with urlink.simulated_time(seed=1) as sim:
        cell = sim.computer("cell", SIMULATED)
        with sim.on(cell):
            controller = Controller("UR5e", "5.25", host=SIMULATED, ports="standard").start()
        for route in (sim.network.route(sim.here, cell), sim.network.route(cell, sim.here)):
            route.latency = 0.0005
        show("simulated time", lambda: measured(SIMULATED, wire, repetitions, options.waits))
        with sim.on(cell):
            controller.close()


if __name__ == "__main__":
    main()
