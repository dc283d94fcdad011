"""Tests of the count of states that a controller did not send, on every kind of stream and in recordings.

They are counted by the controller's own clock.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.recording.file import Kind, RecordingWriter
from linkcore.streaming.statistics import StreamStatistics
from tests import platforms
from tests.waiting import until
from urlink.packets import RobotModeData, Stamp
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.protocol.primary.robot_state import RobotState
from urlink.protocol.rtde.protocol import package_periods
from urlink.rtde.outputs import OutputStream
from urlink.simulator import Controller

pytestmark = pytest.mark.simulated_time

#: Time for which the controller is silent, in s.
SILENT = 0.3


@pytest.fixture(params=["3.4", "3.15", "5.11"])
def controller(request: pytest.FixtureRequest) -> Iterator[Controller]:
    with Controller("UR5" if request.param[0] == "3" else "UR5e", request.param) as controller:
        yield controller


@pytest.fixture(autouse=True)
def is_clear(controller: Controller) -> None:
    controller.faults.clear()


def missing_in(times: list[float], period: float) -> int:
    # The first state of a connection is sent at once, so the second may be early.
    return int(np.sum(np.maximum(np.round(np.diff(times) / period) - 1, 0)))


def agrees(stats: StreamStatistics, times: list[float], period: float) -> None:
    """Check the counts of a stream against all states that it has delivered."""
    assert stats.missed == missing_in(times, period)
    assert stats.missed >= int((SILENT - 0.1) / period)
    assert stats.gaps >= 1
    assert stats.longest_gap == pytest.approx(max(np.diff(times)))
    assert stats.received == stats.decoded + stats.failed


def across_a_silence(controller: Controller, stream: OutputStream[Any]) -> list[float]:
    """Return the times of all states of a stream, before and after a silence, and close the stream."""
    times: list[float] = []
    stream.subscribe(lambda state: times.append(state.timestamp), inline=True)
    until(lambda: len(times) > 10)
    controller.faults.stall(SILENT, "rtde")
    until(lambda: stream.stats.gaps)
    stream.close()
    return times


def test_realtime_counts_missed_states(controller: Controller) -> None:
    period = 1 / urlink.Firmware.parse(controller.firmware).rate
    with urlink.connect(controller.address) as robot:
        times: list[float] = []
        # The function runs in the reading thread, so that it sees every received state.
        robot.realtime.subscribe(lambda state: times.append(state.time), inline=True)
        until(lambda: len(times) > 10)
        assert robot.realtime.stats.missed == missing_in(times, period)
        controller.faults.stall(SILENT, "realtime")
        until(lambda: robot.realtime.stats.gaps)
        robot.realtime.close()
        agrees(robot.realtime.stats, times, period)


def test_rtde_counts_missed_states(controller: Controller) -> None:
    rate = urlink.Firmware.parse(controller.firmware).rate
    # A package is sent every floor(rate / frequency) cycles: here every cycle, and every second cycle.
    for frequency, period in ((0.6 * rate, 1 / rate), (rate / 2.5, 2 / rate)):
        with (
            urlink.connect(controller.address) as robot,
            robot.rtde.outputs("timestamp", "actual_q", frequency=frequency) as stream,
        ):
            times = across_a_silence(controller, stream)
            agrees(stream.stats, times, period)


def test_rtde_counts_no_missed_states_without_a_timestamp(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot, robot.rtde.outputs("actual_q") as stream:
        stream.wait()
        assert stream.stats.missed is None


def test_package_periods_follow_rate_and_frequency() -> None:
    assert package_periods(None, 500, 1) == (0.002,)
    assert package_periods(100, 125, 1) == (0.008,)
    assert package_periods(400, 500, 1) == (0.002,)
    assert package_periods(1e6, 125, 1) == (0.008,)
    assert package_periods(25, 125, 1) == package_periods(25, 500, 1) == (0.04,)
    assert sorted(package_periods(None, None, 1)) == [0.002, 0.008]
    assert package_periods(10, 500, None) == (0.008,)
    assert package_periods(10, 50, None) == (0.02,)
    assert package_periods(5e-324, 500, 1)[0] > 1e5


def test_primary_counts_missed_states(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot:
        times: list[float] = []
        robot.primary.subscribe(lambda mode: times.append(mode.timestamp / 1e6), RobotModeData, inline=True)
        until(lambda: len(times) > 3)
        controller.faults.stall(2 * SILENT, "primary")
        until(lambda: robot.primary.stats.gaps)
        robot.primary.close()
        stats = robot.primary.stats
        assert stats.missed == missing_in(times, 0.1) >= 4


def test_robot_state_has_no_known_clock_for_cb2() -> None:
    protocol = PrimaryProtocol()
    for number in range(3):
        for version in ("1.8", "3.4", "5.11"):
            state = bytes(RobotState(RobotModeData(version, timestamp=number * 1_000_000)))
            (frame,) = protocol.framer.feed(state)
            assert (protocol.cycles is not None and protocol.cycles._moment(frame)) == (
                None if version == "1.8" else float(number)
            )


def test_async_realtime_counts_missed_states(controller: Controller) -> None:
    period = 1 / urlink.Firmware.parse(controller.firmware).rate
    times: list[float] = []

    async def read() -> None:
        async with urlink.connect_async(controller.address) as robot:
            await robot.realtime.subscribe(lambda state: times.append(state.time))
            while len(times) < 10:
                await asyncio.sleep(0.002)
            controller.faults.stall(SILENT, "realtime")
            while not robot.realtime.stats.gaps:
                await asyncio.sleep(0.002)
            await robot.realtime.close()
            agrees(robot.realtime.stats, times, period)

    asyncio.run(asyncio.wait_for(read(), 30))


@pytest.mark.slow
@platforms.needs_shared_descriptors
@pytest.mark.real_time
def test_isolated_realtime_counts_missed_states(controller: Controller) -> None:
    period = 1 / urlink.Firmware.parse(controller.firmware).rate
    with urlink.connect(controller.address, isolate=True, timeout=60.0) as robot:
        times: list[float] = []
        robot.realtime.subscribe(lambda state: times.append(state.time), inline=True)
        until(lambda: len(times) > 10)
        controller.faults.stall(SILENT, "realtime")
        until(lambda: robot.realtime.stats.gaps)
        robot.realtime.close()
        agrees(robot.realtime.stats, times, period)


def test_missed_counts_nothing_between_two_connections(controller: Controller) -> None:
    """The clock of a restarted controller starts from 0, so no states are counted between two connections."""
    period = 1 / urlink.Firmware.parse(controller.firmware).rate
    connections: list[list[float]] = [[]]

    def is_connected_again(known: int) -> bool:
        return len(connections) >= known + 3

    with urlink.connect(controller.address) as robot:
        robot.realtime.subscribe(lambda state: connections[-1].append(state.time), inline=True)
        robot.realtime.subscribe(lambda event: connections.append([]), urlink.ConnectionEvent, inline=True)
        for _ in range(3):
            until(lambda: connections[-1])
            known = len(connections)
            controller.faults.cut("realtime")
            # The three events are: connection lost, connecting, and connected.
            until(partial(is_connected_again, known))
        until(lambda: connections[-1])
        robot.realtime.close()
        assert robot.realtime.stats.reconnects == 3
        assert robot.realtime.stats.missed == sum(missing_in(times, period) for times in connections)


def test_recording_reports_missing_states(controller: Controller, tmp_path: Path) -> None:
    period = 1 / urlink.Firmware.parse(controller.firmware).rate
    with urlink.connect(controller.address) as robot:
        outputs = robot.rtde.outputs("timestamp", "actual_q", frequency=25)
        with robot.record(tmp_path / "run.urlog", ["realtime", "primary", outputs]):
            robot.realtime.wait()
            robot.primary.of(RobotModeData).wait()
            outputs.wait()
            controller.faults.stall(2 * SILENT)
            until(lambda: robot.realtime.stats.gaps and robot.primary.stats.gaps and outputs.stats.gaps)
        outputs.close()
    run = urlink.load(tmp_path / "run.urlog")
    for table, field, unit, each in (
        (run.realtime, "time", 1.0, period),
        (run.primary, "robot_mode_data.timestamp", 1e-6, 0.1),
        (run.rtde, "timestamp", 1.0, 0.04),
    ):
        missing = missing_in((table[field] * unit).tolist(), each)
        assert sum(gap.cycles for gap in table.gaps) == missing >= (2 * SILENT - 0.2) / each
        longest = max(table.gaps, key=lambda gap: gap.seconds)
        assert longest.seconds == pytest.approx(np.diff(table[field] * unit).max())
        assert longest.end - longest.start > 0.1
        assert table.between(0, longest.start).missing == ()
        (said,) = table.missing
        assert said.startswith(f"{missing} of {missing + len(table)} cycles are missing (")
        assert f"{longest.start:.3f} to {longest.end:.3f}" in said
    assert [each.partition(":")[0] for each in run.missing] == ["realtime", "primary", "rtde"]


@pytest.mark.parametrize("lost", [(), (5,), (7, 8, 9, 20)])
def test_recording_reports_gaps_only_for_lost_states(tmp_path: Path, lost: tuple[int, ...]) -> None:
    writer = RecordingWriter(tmp_path / "run.urlog")
    channel = writer.add_channel({"name": "realtime", "firmware": "5.11"})
    for number in range(30):
        if number not in lost:
            data = bytes(urlink.packets.RealtimeState("5.11", time=number * 0.002))
            # All states arrive at regular times.
            writer.write(Kind.BYTES, channel, Stamp(100 + number * 0.002, 0), data)
    writer.close()
    run = urlink.load(tmp_path / "run.urlog")
    assert bool(run.missing) == bool(lost)
    assert sum(gap.cycles for gap in run.realtime.gaps) == len(lost)
