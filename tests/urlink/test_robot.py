"""Tests of `Robot` against simulated controllers of every generation, and with every fault."""

from __future__ import annotations

import asyncio
import importlib.metadata
import socket
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.streaming.statistics import StreamStatistics
from tests.waiting import until
from urlink import Backoff, ConnectionEvent, ConnectionState
from urlink.arm.models import MODELS
from urlink.packets import (
    JointData,
    KinematicsInfo,
    RealtimeState,
    RobotMessage,
    RobotMode,
    RobotModeCB2,
    RobotModeData,
    RobotState,
    SafetyMode,
    VersionMessage,
)
from urlink.protocol.firmware import RELEASES, Firmware, release_of
from urlink.session.address import RobotAddress
from urlink.simulator import Controller, Demonstration

pytestmark = pytest.mark.simulated_time

QUICK = Backoff(first=0.01, most=0.1)


def connect(controller: Controller, **options: object) -> urlink.Robot:
    return urlink.connect(controller.address, backoff=QUICK, **options)  # type: ignore[arg-type]


@pytest.fixture
def controller() -> Iterator[Controller]:
    before = set(threading.enumerate())
    with Controller("UR5e", "5.11", motion=Demonstration()) as controller:
        yield controller
    assert set(threading.enumerate()) <= before


@pytest.fixture
def robot(controller: Controller) -> Iterator[urlink.Robot]:
    with connect(controller) as robot:
        yield robot
        for stream in (robot.realtime, robot.primary, robot.secondary):
            adds_up(stream.stats)


def adds_up(stats: StreamStatistics) -> None:
    assert stats.received == stats.decoded + stats.failed


@pytest.mark.parametrize("row", RELEASES, ids=lambda row: str(row.since))
def test_robot_reads_every_firmware(row: urlink.protocol.firmware.Release) -> None:
    with Controller(None, row.since) as controller, connect(controller) as robot:
        assert robot.firmware[:2] == row.since[:2]
        assert robot.identity.said_so
        realtime = robot.realtime.wait(5)
        assert len(bytes(realtime)) == row.realtime
        assert realtime.tail == b""
        assert realtime.robot_mode in (RobotMode.RUNNING, RobotModeCB2.RUNNING, None)
        states = robot.primary.iterate(urlink.block, timeout=10)  # `wait` might miss the first one
        first, later = next(states), next(states)
        assert first.sizes == dict(row.state)
        assert set(first.sizes) - set(later.sizes) == row.first_state_only
        joints = later.joint_data
        assert joints is not None
        np.testing.assert_allclose(joints.q_actual, realtime.q_actual, atol=0.5)
        if 6 in row.state:
            assert robot.model == controller.model.name


@pytest.mark.parametrize("name", MODELS)
def test_robot_identifies_every_model(name: str) -> None:
    with Controller(name) as controller, connect(controller) as robot:
        # UR7e and UR12e cannot be distinguished from the arms that they succeed.
        assert robot.model == {"UR7e": "UR5e", "UR12e": "UR10e"}.get(name, name)
        table = robot.identity.dh_table
        assert table is not None
        np.testing.assert_array_equal(table.dh_a, controller.model.dh_a)


def test_connect_starts_and_stops_a_simulator() -> None:
    before = set(threading.enumerate())
    with urlink.connect("sim://ur10?firmware=3.4") as robot:
        assert (robot.model, robot.firmware) == ("UR10", Firmware(3, 4))
        for count, state in enumerate(robot.realtime):
            assert isinstance(state, RealtimeState)
            if count == 3:
                break
        assert robot.controller is not None
        assert robot.controller.ports
    assert robot.controller.ports == {}
    assert set(threading.enumerate()) <= before


def test_stream_opens_at_its_first_use(controller: Controller, robot: urlink.Robot) -> None:
    assert controller.counters.connections == 1  # connect() has identified the robot
    robot.realtime.wait(5)
    until(lambda: controller.counters.connections == 2)
    assert robot.primary.connection is ConnectionState.IDLE


def test_read_only_robot_reads_the_read_only_ports(controller: Controller) -> None:
    only = {name: port for name, port in controller.ports.items() if name.endswith("readonly")}
    ports = "&".join([f"{name}={number}" for name, number in only.items()])
    with urlink.connect(f"ur://{controller.host}?{ports}", read_only=True) as robot:
        assert robot.realtime.wait(5).q_actual.shape == (6,)
        assert robot.primary.wait(5).joint_data is not None


def test_primary_delivers_packets_by_type(controller: Controller, robot: urlink.Robot) -> None:
    modes: list[RobotModeData] = []
    messages: list[RobotMessage] = []
    # Messages are subscribed to first, because the first subscription opens the connection, which begins with the
    # version message.
    robot.primary.of(RobotMessage).subscribe(messages.append)
    robot.primary.subscribe(modes.append, RobotModeData)
    until(lambda: len(modes) > 2)
    assert isinstance(messages[0], VersionMessage)
    assert messages[0].build_date
    assert modes[-1].robot_mode is RobotMode.RUNNING
    assert robot.primary.of(JointData).latest is not None
    assert robot.primary.of(KinematicsInfo).latest is not None  # sent only once, with the first state
    assert isinstance(robot.primary.latest, RobotState)
    assert isinstance(robot.primary.of(RobotMessage).latest, RobotMessage)


def test_secondary_delivers_states(robot: urlink.Robot) -> None:
    assert robot.secondary.wait(5).joint_data is not None


def test_record_leaves_no_file_when_it_cannot_connect(tmp_path: Path) -> None:
    with Controller() as controller:
        robot = connect(controller)
    with robot, pytest.raises(urlink.ConnectFailed):
        robot.record(tmp_path / "run.urlog")
    assert list(tmp_path.iterdir()) == []


def test_stream_to_the_wrong_port_raises_wrong_peer(controller: Controller) -> None:
    ports = {**controller.ports, "realtime": controller.ports["secondary"]}
    with urlink.connect(str(RobotAddress(controller.host, ports)), backoff=QUICK) as robot:
        with pytest.raises(urlink.WrongPeer, match="primary or secondary"):
            next(iter(robot.realtime))
        with pytest.raises(urlink.WrongPeer, match="primary or secondary"):
            robot.realtime.wait(5)


def test_wait_timeout_names_the_cause(controller: Controller, robot: urlink.Robot) -> None:
    robot.realtime.wait(5)
    controller.close()
    until(lambda: robot.realtime.connection is not ConnectionState.CONNECTED)
    with pytest.raises(urlink.LinkTimeout, match=r"not connected: .*refused"):
        robot.realtime.wait(0.2)
    with pytest.raises(urlink.LinkTimeout):
        next(iter(robot.realtime.iterate(timeout=0.05)))


def test_of_refuses_types_that_are_not_packets(robot: urlink.Robot) -> None:
    with pytest.raises(urlink.BadValue, match="expected a class of packets such as RobotState"):
        robot.primary.of(RobotMode)


def test_one_process_can_read_several_robots() -> None:
    with urlink.connect("sim://ur3e?firmware=5.4") as one, urlink.connect("sim://ur10?firmware=3.10") as two:
        assert len(bytes(one.realtime.wait(5))) == 1116
        assert len(bytes(two.realtime.wait(5))) == 1116
        assert (one.model, two.model) == ("UR3e", "UR10")


def test_close_is_idempotent_and_quick(controller: Controller) -> None:
    robot = connect(controller)
    for _ in robot.realtime:
        break
    robot.primary.subscribe(lambda state: None)
    began = time.monotonic()
    robot.close()
    robot.close()
    assert time.monotonic() - began < 2.5
    with pytest.raises(urlink.Closed):
        robot.realtime.wait(1)


def frames(caught: pytest.ExceptionInfo[BaseException]) -> int:
    """Return the number of frames that a traceback shows, including frames of causes."""
    shown = traceback.format_exception(caught.type, caught.value, caught.tb)
    return sum(line.startswith("  File ") for line in shown)


def test_connect_raises_connect_failed_when_all_ports_are_closed() -> None:
    with Controller() as controller:
        ports = dict(controller.ports)
    query = "&".join(f"{name}={number}" for name, number in ports.items())
    # The message names the port that was tried first, although the secondary interface was tried after it.
    first = f"^cannot connect to 127.0.0.1:{ports['primary']}: connection refused"
    with pytest.raises(urlink.ConnectFailed, match=first) as caught:
        urlink.connect(f"ur://127.0.0.1?{query}", timeout=2)
    assert frames(caught) == 2  # here, and in `connect`

    async def connected() -> None:
        await urlink.connect_async(f"ur://127.0.0.1?{query}", timeout=2)

    with pytest.raises(urlink.ConnectFailed, match=first):
        asyncio.run(connected())


def test_connect_times_out_when_nothing_is_sent() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        where = f"127.0.0.1?primary={server.getsockname()[1]}"
        with pytest.raises(urlink.LinkTimeout, match="sent nothing within 1 s") as caught:
            urlink.connect(f"ur://{where}", timeout=1)
    assert frames(caught) == 2  # here, and in `connect`


def test_connect_refuses_bad_arguments() -> None:
    with pytest.raises(urlink.BadValue, match="timeout"):
        urlink.connect("sim://", timeout=0)
    with pytest.raises(urlink.BadAddress):
        urlink.connect("ftp://robot")


# -- faults: the stream recovers automatically, and the counters add up ----------------------------


class Watch:
    """Subscriber that keeps its states and events, and can wait for new states."""

    def __init__(self, robot: urlink.Robot) -> None:
        self.stream = robot.realtime
        self.states: list[RealtimeState] = []
        self.events: list[ConnectionEvent] = []
        robot.realtime.subscribe(self.events.append, ConnectionEvent)
        self.subscription = robot.realtime.subscribe(self.states.append, policy=urlink.block)
        self.goes_on()

    def goes_on(self, condition: Callable[[RealtimeState], object] = lambda state: True) -> None:
        """Wait until a new packet meets the condition."""
        seen = len(self.states)
        until(lambda: any(condition(state) for state in self.states[seen:]), 15)
        adds_up(self.stream.stats)
        assert self.subscription.stats.dropped == self.subscription.stats.raised == 0


@pytest.fixture
def watch(robot: urlink.Robot) -> Watch:
    return Watch(robot)


@pytest.mark.parametrize(("address", "is_moving"), [("sim://", False), ("sim://ur10?firmware=3.4&motion=demo", True)])
def test_simulated_arm_moves_only_on_request(address: str, is_moving: bool) -> None:
    with urlink.connect(address) as robot:
        first = robot.realtime.wait()
        until(lambda: robot.realtime.wait().time > first.time + 0.5)
        state = robot.realtime.wait()
        assert (state.q_target != first.q_target).any() == is_moving
        assert robot.primary.of(urlink.packets.RobotModeData).wait().is_program_running is is_moving


def test_realtime_shows_a_protective_stop(controller: Controller, watch: Watch) -> None:
    controller.faults.protective_stop()
    watch.goes_on(lambda state: state.safety_mode is SafetyMode.PROTECTIVE_STOP)
    watch.goes_on(lambda state: not state.qd_target.any())
    controller.faults.clear()
    watch.goes_on(lambda state: state.safety_mode is SafetyMode.NORMAL and state.qd_target.any())
    assert watch.stream.stats.reconnects == 0


def test_realtime_shows_an_emergency_stop(controller: Controller, watch: Watch) -> None:
    controller.faults.emergency_stop()
    watch.goes_on(lambda state: state.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP)
    watch.goes_on(lambda state: state.robot_mode is RobotMode.POWER_OFF)
    controller.faults.clear()
    controller.faults.power_on()
    watch.goes_on(lambda state: state.robot_mode is RobotMode.RUNNING)
    assert watch.stream.stats.reconnects == 0


def test_realtime_shows_power_off_and_on(controller: Controller, watch: Watch) -> None:
    controller.faults.power_off()
    watch.goes_on(lambda state: state.robot_mode is RobotMode.POWER_OFF)
    controller.faults.power_on()
    watch.goes_on(lambda state: state.robot_mode is RobotMode.RUNNING)


def test_realtime_reconnects_after_a_cut(controller: Controller, watch: Watch) -> None:
    controller.faults.cut()
    until(lambda: watch.stream.stats.reconnects == 1)
    watch.goes_on()
    assert [event.state for event in watch.events if event.state is ConnectionState.LOST]
    assert watch.stream.stats.skipped < len(bytes(watch.states[0]))


def test_robot_adopts_the_firmware_after_a_reboot(controller: Controller, robot: urlink.Robot, watch: Watch) -> None:
    modes: list[RobotModeData] = []
    robot.primary.subscribe(modes.append, RobotModeData)
    before = robot.realtime.latest
    assert before is not None
    controller.faults.reboot(firmware="5.4", downtime=0.05)
    size = release_of(Firmware(5, 4)).realtime
    watch.goes_on(lambda state: len(bytes(state)) == size)
    assert robot.firmware == Firmware(5, 4)
    assert watch.states[-1].payload_mass is None
    assert watch.states[0].payload_mass is not None
    seen = len(modes)
    until(lambda: len(modes) > seen)
    adds_up(robot.primary.stats)


def test_realtime_reconnects_after_a_stall(controller: Controller) -> None:
    with connect(controller, silence=0.1) as robot:
        watch = Watch(robot)
        late = threading.Event()
        robot.realtime.subscribe(lambda state: None, deadline=0.05, on_deadline=lambda age: late.set())
        controller.faults.stall(0.5)
        assert late.wait(10)
        until(lambda: robot.realtime.connection is not ConnectionState.CONNECTED or robot.realtime.latest is None)
        watch.goes_on()
        lost = [event.error for event in watch.events if event.state is ConnectionState.LOST]
        assert isinstance(lost[0], urlink.LinkTimeout)


@pytest.mark.parametrize("sizes", [[1], [700, 1, 3], [1460]])
def test_realtime_decodes_split_packets(controller: Controller, watch: Watch, sizes: list[int]) -> None:
    controller.faults.split(sizes)
    watch.goes_on()
    watch.goes_on()
    controller.faults.heal()
    watch.goes_on()
    stats = watch.stream.stats
    assert (stats.skipped, stats.failed, stats.reconnects) == (0, 0, 0)
    in_order([state.time for state in watch.states])


def test_realtime_decodes_merged_packets(controller: Controller, watch: Watch) -> None:
    controller.faults.merge(16)
    watch.goes_on()
    watch.goes_on()
    controller.faults.heal()
    watch.goes_on()
    stats = watch.stream.stats
    assert (stats.skipped, stats.failed, stats.reconnects) == (0, 0, 0)
    in_order([state.time for state in watch.states])


def in_order(times: list[float]) -> None:
    """Check that the times contain every cycle exactly once."""
    steps = np.round(np.diff(times) * 500).astype(int)
    assert set(steps.tolist()) == {1}


@pytest.mark.parametrize("garbage", [b"\x00", b"\xff" * 560, b"\x00\x00\x04\xc4", 4000], ids=repr)
def test_realtime_skips_garbage_between_packets(controller: Controller, watch: Watch, garbage: bytes | int) -> None:
    controller.faults.garbage(garbage)
    watch.goes_on(lambda state: watch.stream.stats.resyncs)
    stats = watch.stream.stats
    assert stats.reconnects == stats.failed == 0
    assert stats.skipped >= (garbage if isinstance(garbage, int) else len(garbage))


def test_realtime_resyncs_after_garbage_inside_a_packet(controller: Controller, watch: Watch) -> None:
    controller.faults.garbage(b"\xde\xad\xbe\xef", inside=True)
    watch.goes_on(lambda state: watch.stream.stats.resyncs)
    assert watch.stream.stats.reconnects == 0


def test_primary_resyncs_after_garbage(controller: Controller, robot: urlink.Robot) -> None:
    states: list[RobotState] = []
    robot.primary.subscribe(states.append, policy=urlink.block)
    until(lambda: states)
    for inside in (False, True):
        controller.faults.garbage(300, inside=inside)
        seen, resyncs = len(states), robot.primary.stats.resyncs
        until(lambda seen=seen, resyncs=resyncs: robot.primary.stats.resyncs > resyncs and len(states) > seen)  # type: ignore[misc]
    adds_up(robot.primary.stats)
    assert robot.primary.stats.reconnects == 0


def test_appended_bytes_are_kept_as_tails(controller: Controller, robot: urlink.Robot) -> None:
    controller.faults.append(b"\x01" * 16)
    state = robot.realtime.wait(5)
    # In a later release, the first of these bytes may belong to fields.
    assert state.tail
    assert bytes(state).endswith(b"\x01" * 16)
    assert state.payload_inertia is not None
    assert robot.realtime.stats.tails > 0
    whole = robot.primary.wait(5)
    # The configuration has had 4 more bytes since 5.25, so its tail is 4 bytes shorter.
    tails = {len(package.tail) for package in whole if not isinstance(package, urlink.packets.ConfigurationData)}
    assert tails == {16}
    assert whole.robot_mode_data is not None
    assert whole.robot_mode_data.robot_mode is RobotMode.RUNNING


def test_primary_delivers_unknown_packages(controller: Controller, robot: urlink.Robot) -> None:
    others: list[urlink.packets.OtherPackage] = []
    robot.primary.of(urlink.packets.OtherPackage).subscribe(others.append)
    robot.primary.wait(5)
    controller.faults.unknown_package(99, b"something new")
    controller.faults.unknown_sub_package(77, b"a new part")
    until(lambda: others)
    assert (others[0].type, others[0].payload) == (99, b"something new")
    state = robot.primary.wait(5)
    unknown = [package for package in state if isinstance(package, urlink.packets.UnknownSubPackage)]
    assert (unknown[0].type, unknown[0].payload) == (77, b"a new part")
    assert robot.primary.stats.failed == 0
    assert robot.primary.stats.unknown >= 2


def test_recording_replays_a_fault(controller: Controller, robot: urlink.Robot, tmp_path: Path) -> None:
    """For a bug report, a user records a fault and replays the recording without the robot."""
    path = f"{tmp_path}/fault.urlog"
    with robot.record(path, ["realtime"]):
        watch = Watch(robot)
        controller.faults.cut()
        until(lambda: robot.realtime.stats.reconnects == 1)
        watch.goes_on()
    with urlink.connect(f"replay://{path}?rate=max") as replayed:
        assert (replayed.firmware, replayed.model) == (robot.firmware, robot.model)
        states = list(replayed.realtime)
        assert replayed.realtime.stats.reconnects == 1
    seen, recorded = list(map(bytes, watch.states)), list(map(bytes, states))
    begin = recorded.index(seen[0])  # the recorder started first and ended first
    assert recorded[begin:] == seen[: len(recorded) - begin]


@pytest.mark.slow
def test_twenty_robots_lose_no_state() -> None:
    """All twenty controllers, at 125 Hz, and their twenty clients are in this process."""
    controllers = [Controller("UR5", "3.4") for _ in range(20)]
    robots: list[urlink.Robot] = []
    try:
        for controller in controllers:
            controller.start()
            robots.append(connect(controller))
        seen: list[list[float]] = [[] for _ in robots]
        for robot, times in zip(robots, seen, strict=True):
            robot.realtime.subscribe(lambda state, times=times: times.append(state.time), policy=urlink.block)  # type: ignore[misc]
        until(lambda: all(len(times) >= 250 for times in seen), 30)
        for robot, times, controller in zip(robots, seen, controllers, strict=True):
            robot.realtime.close()
            stats = robot.realtime.stats
            adds_up(stats)
            assert (stats.failed, stats.skipped, stats.reconnects) == (0, 0, 0)
            assert controller.counters.dropped == 0
            steps = np.round(np.diff(times) * 125).astype(int)
            # The simulator skips cycles when it is late, and never sends their states.
            assert (steps.sum() - len(steps)) <= controller.counters.skipped
    finally:
        for robot in robots:
            robot.close()
        for controller in controllers:
            controller.close()


def test_concurrent_first_accesses_share_one_rtde_client(monkeypatch: pytest.MonkeyPatch) -> None:
    made, barrier = urlink.rtde.Rtde, threading.Barrier(2)

    def slow(*arguments: Any, **options: Any) -> urlink.rtde.Rtde:
        barrier.wait(10)
        return made(*arguments, **options)

    monkeypatch.setattr(urlink.rtde, "Rtde", slow)
    found: list[object] = []
    with urlink.connect("sim://") as robot:
        threads = [threading.Thread(target=lambda: found.append(robot.rtde)) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(20)
        assert found == [robot.rtde] * 2
        assert robot.registers is robot.registers


@pytest.mark.simulated_time
def test_view_and_record_name_the_missing_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: ())
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        with pytest.raises(urlink.LocalError, match=r"view in a browser needs the .* pip install urlink-view$"):
            robot.view()
        with pytest.raises(urlink.LocalError, match=r"\.mcap file live needs the .* pip install urlink-view$"):
            robot.record(tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []
