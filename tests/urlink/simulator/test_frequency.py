"""Tests of simulated controllers that execute fewer cycles per second than real controllers."""

from __future__ import annotations

import asyncio
import copy
import math
import pickle
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadRecording
from urlink import Joint
from urlink.arm.vectors import FloatArray
from urlink.protocol.enums import SafetyMode
from urlink.protocol.firmware import FREQUENCIES, LAST_CB3, NEWEST, Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.session.identity import Identity, described_identity
from urlink.simulator import Controller, Plane, Still
from urlink.tools import RobotAddress, SimulatorAddress, parse_address

READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)
AWAY = (0.6, -1.4, 1.4, -1.6, -1.6, 0.5)
E_SERIES, CB3 = ("UR5e", "5.11"), ("UR5", "3.15")
#: Model, firmware and frequency of each slow controller that the tests compare with the real frequency.
SLOW = [(*E_SERIES, 250), (*E_SERIES, 125), (*E_SERIES, 50), (*CB3, 25)]


class Outcome(NamedTuple):
    """Result of a motion: the time for which the arm moved, in s, and the joint targets at its end, in rad."""

    seconds: float
    q: FloatArray


def controller_of(model: str, firmware: str, frequency: int | None) -> Controller:
    """Return a controller whose arm is at `READY`."""
    motion = Still(READY)
    return Controller(model, firmware, motion=motion, frequency=frequency)


class Observer:
    """Client that counts the states in which the arm moves, or in which digital output 1 is on."""

    def __init__(self, robot: urlink.Robot) -> None:
        self._robot = robot
        self._states: list[RealtimeState] = []
        robot.realtime.subscribe(self._states.append, inline=True)

    def outcome(self, motion: urlink.Motion) -> Outcome:
        """Wait for the end of a motion, and return its outcome."""
        motion.wait(20.0)
        return self._counted(lambda state: bool(state.qd_target.any()))

    def pause(self) -> Outcome:
        """Run a program that switches an output on for half a second."""
        program = "def pause():\n  set_digital_out(1, True)\n  sleep(0.5)\n  set_digital_out(1, False)\n  sync()\nend"
        self._robot.script.run(program).wait(20.0)
        return self._counted(lambda state: bool(int(state.digital_output_bits or 0) & 2))

    def _counted(self, is_counted: Callable[[RealtimeState], bool]) -> Outcome:
        last = self._robot.realtime.wait(1.0)
        states = [state for state in self._states if state.time <= last.time]
        self._states.clear()
        return Outcome(sum(map(is_counted, states)) / self._robot.firmware.rate, last.q_target)


@cache
def moves(model: str, firmware: str, frequency: int | None) -> dict[str, Outcome]:
    """Run the motions of a cell program, and return the outcome of each."""
    with (
        urlink.simulated_time(1),
        controller_of(model, firmware, frequency) as controller,
        urlink.connect(controller.address) as robot,
    ):
        motion, observer = robot.motion, Observer(robot)
        robot.primary.wait(1.0)
        corners = [Joint((0.1 * k, -1.6, 1.6, -1.6, -1.6, 0.0), blend=0.01) for k in (1, 2)]
        found = {
            "move_joints": observer.outcome(motion.move_joints(AWAY)),
            "pause": observer.pause(),
            "move_linear": observer.outcome(motion.move_linear(robot.kinematics.forward(READY))),
            "speed_joints": observer.outcome(motion.speed_joints([0.2, 0, 0, 0, 0, 0.1], duration=0.8)),
            "back": observer.outcome(motion.move_joints(READY)),
            "path": observer.outcome(motion.path([*corners, Joint(AWAY)])),
        }
        robot.io.set_digital_out(0, True)
        assert controller.signals.digital_outputs & 1
        assert robot.realtime.stats.missed == robot.primary.stats.missed == 0
    return found


slow = pytest.mark.parametrize(("model", "firmware", "frequency"), SLOW)


@slow
def test_moves_last_as_long_at_a_lower_frequency(model: str, firmware: str, frequency: int) -> None:
    found = moves(model, firmware, frequency)
    for name, expected in moves(model, firmware, None).items():
        assert found[name].seconds == pytest.approx(expected.seconds, abs=2.0 / frequency), name
        # The end of `speed_joints` is a moment, up to two cycles earlier or later at 0.2 rad/s.
        tolerance = 0.2 * 2.0 / frequency if name == "speed_joints" else 1e-9
        assert found[name].q == pytest.approx(expected.q, abs=tolerance), name


@pytest.mark.simulated_time
@slow
def test_servo_sends_one_setpoint_in_each_slow_cycle(model: str, firmware: str, frequency: int) -> None:
    with controller_of(model, firmware, frequency) as controller, urlink.connect(controller.address) as robot:
        with robot.motion.servo() as servo:
            begun, q = robot.realtime.wait(1.0).time, np.array(READY)
            for state in robot.realtime:
                if state.time - begun > 1.0:
                    break
                q[5] = 0.1 * (1.0 - math.cos(math.pi * (state.time - begun)))
                servo.send(q)
        assert servo.stats.count == pytest.approx(frequency, abs=2)
        assert servo.stats.late == 0
        assert robot.realtime.wait(1.0).q_target[5] == pytest.approx(0.2, abs=0.01)
        assert robot.realtime.stats.missed == 0


@pytest.mark.simulated_time
@slow
def test_servo_drives_to_a_target_at_a_lower_frequency(model: str, firmware: str, frequency: int) -> None:
    with (
        controller_of(model, firmware, frequency) as controller,
        urlink.connect(controller.address) as robot,
        robot.motion.servo() as servo,
    ):
        reached = servo.schedule([*READY[:5], 0.2], robot.realtime.wait(1.0).time + 1.0)
        assert reached is not None
        state = robot.realtime.wait_until(lambda state: state.time > reached + 0.2, 5.0)
        assert state.q_target[5] == pytest.approx(0.2, abs=1e-3)


@pytest.mark.simulated_time
@slow
def test_trajectory_is_followed_at_a_lower_frequency(model: str, firmware: str, frequency: int) -> None:
    points = [urlink.TrajectoryPoint(READY, 0.0), urlink.TrajectoryPoint(AWAY, 2.0)]
    with controller_of(model, firmware, frequency) as controller, urlink.connect(controller.address) as robot:
        robot.motion.follow(urlink.Trajectory(points)).wait(10.0)
        assert robot.realtime.wait(1.0).q_target == pytest.approx(AWAY, abs=1e-3)
        assert robot.realtime.stats.missed == 0


@pytest.mark.simulated_time
@slow
def test_contact_is_found_at_a_lower_frequency(model: str, firmware: str, frequency: int) -> None:
    controller = controller_of(model, firmware, frequency)
    x, y, z = controller.arm.kinematics.forward(READY)[:3]
    controller.world.add(Plane((x, y, z - 0.01)))
    with controller, urlink.connect(controller.address) as robot:
        motion = robot.motion.until_contact([0, 0, -1], speed=0.02)
        motion.wait(20.0)
        assert motion.contact is not None
        assert motion.contact.pose is not None
        assert z - motion.contact.pose[2] == pytest.approx(0.01, abs=0.002 + 0.02 * 2.0 / frequency)


@pytest.mark.simulated_time
@slow
def test_freedrive_yields_to_a_push_at_a_lower_frequency(model: str, firmware: str, frequency: int) -> None:
    with controller_of(model, firmware, frequency) as controller, urlink.connect(controller.address) as robot:
        q = robot.realtime.wait(1.0).q_target
        with robot.freedrive():
            controller.push([0, 0, 20, 0, 0, 0])
            robot.realtime.wait_until(lambda state: float(np.abs(state.q_target - q).max()) > 0.05, 10.0)
            controller.push([0.0] * 6)
        assert robot.realtime.wait(1.0).safety_mode in (None, SafetyMode.NORMAL)


@pytest.mark.simulated_time
@slow
def test_force_mode_presses_on_a_plane_at_a_lower_frequency(model: str, firmware: str, frequency: int) -> None:
    controller = controller_of(model, firmware, frequency)
    x, y, z = controller.arm.kinematics.forward(READY)[:3]
    controller.world.add(Plane((x, y, z - 0.002)))
    with controller, urlink.connect(controller.address) as robot:
        with robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0, 0, -20, 0, 0, 0], [0.1] * 6):
            begun = robot.realtime.wait(1.0).time
            robot.realtime.wait_until(lambda state: state.time > begun + 3.0, 10.0)
            forces = [robot.realtime.wait(1.0).tcp_force[2] for _ in range(frequency)]
        assert np.mean(forces) == pytest.approx(20.0, abs=3.0)


@pytest.mark.simulated_time
@slow
def test_rtde_uses_the_lower_frequency(model: str, firmware: str, frequency: int) -> None:
    with controller_of(model, firmware, frequency) as controller, urlink.connect(controller.address) as robot:
        with pytest.raises(urlink.BadValue, match=f"expected 1 to {frequency} packages"):
            robot.rtde.outputs("timestamp", frequency=2.0 * frequency)
        with (
            robot.rtde.outputs("timestamp", "actual_q") as all_cycles,
            robot.rtde.outputs("timestamp", frequency=frequency / 5) as some,
        ):
            all_cycles.start()
            some.start()
            times = [all_cycles.wait(1.0).timestamp for _ in range(25)]
            assert np.diff(times) == pytest.approx(1.0 / frequency)
            times = [some.wait(1.0).timestamp for _ in range(5)]
            assert np.diff(times) == pytest.approx(5.0 / frequency)
            assert all_cycles.stats.missed == some.stats.missed == 0
        robot.registers.write_integer(24, 7)
        time.sleep(0.2)
        assert controller.registers.inputs.integers[24] == 7
        controller.call(lambda: controller.registers.outputs.integers.__setitem__(25, 8))
        assert robot.registers.read_integer(25) == 8


@pytest.mark.simulated_time
@slow
def test_recording_keeps_the_lower_frequency(model: str, firmware: str, frequency: int, tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    with (
        controller_of(model, firmware, frequency) as controller,
        urlink.connect(controller.address) as robot,
        robot.rtde.outputs("timestamp", "actual_q") as outputs,
        robot.record(path, ["realtime", "primary", outputs]),
    ):
        robot.motion.move_joints(AWAY).wait(20.0)
    recording = urlink.load(path)
    assert recording.firmware is not None
    assert recording.firmware.rate == frequency
    assert recording.missing == ()
    assert not recording.realtime.gaps
    assert not recording.rtde.gaps
    with urlink.connect(f"replay://{path}?rate=max") as replay:
        times = [state.time for state in replay.realtime]
        assert np.diff(times) == pytest.approx(1.0 / frequency)
        assert replay.firmware.rate == frequency
        assert replay.realtime.stats.missed == 0


@pytest.mark.simulated_time
def test_missed_cycles_are_counted_at_a_lower_frequency() -> None:
    with controller_of(*E_SERIES, 50) as controller, urlink.connect(controller.address) as robot:
        robot.realtime.wait(1.0)
        controller.faults.stall(0.2, "realtime")
        robot.realtime.wait_until(lambda state: bool(robot.realtime.stats.missed), 5.0)
        assert robot.realtime.stats.missed == pytest.approx(10, abs=1)


@pytest.mark.simulated_time
def test_rebooted_controller_keeps_its_frequency() -> None:
    with controller_of(*E_SERIES, 125) as controller, urlink.connect(controller.address) as robot:
        robot.realtime.wait(1.0)
        controller.faults.reboot("5.12", 0.5)
        robot.realtime.wait_until(lambda state: robot.realtime.stats.reconnects > 0, 20.0)
        assert (robot.firmware, robot.firmware.rate) == (Firmware(5, 12), 125)
        assert controller.firmware.rate == 125


@pytest.mark.simulated_time
def test_sim_address_sets_the_frequency() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11&frequency=125") as robot:
        assert robot.controller is not None
        assert robot.firmware.rate == robot.controller.firmware.rate == 125
        times = [robot.realtime.wait(1.0).time for _ in range(10)]
        assert np.diff(times) == pytest.approx(0.008)


@pytest.mark.simulated_time
def test_connect_async_uses_the_lower_frequency() -> None:
    async def times() -> list[float]:
        async with urlink.connect_async("sim://ur5e?firmware=5.11&frequency=50") as robot:
            assert robot.firmware.rate == 50
            found = [(await robot.realtime.wait(1.0)).time for _ in range(10)]
            assert robot.realtime.stats.missed == 0
            return found

    assert np.diff(asyncio.run(times())) == pytest.approx(0.02)


@pytest.mark.simulated_time
@pytest.mark.urlink(firmware="5.11", frequency=50)
def test_marker_sets_the_frequency(simulated_time: urlink.Simulation, urlink_robot: urlink.Robot) -> None:
    assert urlink_robot.firmware.rate == 50
    assert np.diff([urlink_robot.realtime.wait(1.0).time for _ in range(10)]) == pytest.approx(0.02)


def test_stepped_controller_advances_by_slow_cycles() -> None:
    controller = Controller("UR5e", "5.11", frequency=100)
    controller.step(150)
    assert controller.time == pytest.approx(1.5)
    program = "def steps():\n  write_output_float_register(0, get_steptime())\nend\n"
    controller.take(program)
    controller.step(10)
    assert controller.registers.outputs.floats[0] == pytest.approx(0.01)


@pytest.mark.parametrize("frequency", [25, 50, 100, 125, 250, 500])
def test_robot_states_are_sent_ten_times_a_second(frequency: int) -> None:
    controller = Controller("UR5e", "5.11", frequency=frequency)
    sent = set()
    for _ in range(10 * frequency):
        controller.step()
        sent.add(controller._states.next_cycle(controller.cycle))
    steps = np.diff(sorted(sent)) / frequency
    assert np.mean(steps) == pytest.approx(0.1, abs=0.001)
    assert np.max(steps) <= 0.12


@pytest.mark.parametrize(("model", "firmware"), [E_SERIES, CB3])
def test_real_frequency_is_the_default(model: str, firmware: str) -> None:
    default, explicit = (
        Controller(model, firmware, seed=3, frequency=each) for each in (None, Firmware.parse(firmware).rate)
    )
    for _ in range(50):
        default.step()
        explicit.step()
        assert default.realtime_packet() == explicit.realtime_packet()
    assert type(default.firmware) is type(explicit.firmware) is Firmware
    assert default.firmware.rate == (500 if model == "UR5e" else 125)


@pytest.mark.simulated_time
def test_default_address_has_no_frequency() -> None:
    with Controller(*E_SERIES) as controller:
        assert "frequency" not in controller.address
        assert parse_address(controller.address).frequency is None  # type: ignore[union-attr]
    with Controller(*E_SERIES, frequency=500) as controller:
        assert "frequency" not in controller.address


@pytest.mark.parametrize(
    ("model", "firmware", "frequency"),
    [
        (*E_SERIES, 0),
        (*E_SERIES, -125),
        (*E_SERIES, 10),
        (*E_SERIES, 200),
        (*E_SERIES, 1000),
        (*E_SERIES, True),
        (*E_SERIES, "125"),
        (*E_SERIES, 62.5),
        (*E_SERIES, math.nan),
        (*CB3, 50),
        (*CB3, 500),
    ],
)
def test_other_frequencies_are_rejected(model: str, firmware: str, frequency: int) -> None:
    allowed = "25, 50, 100, 125, 250, 500" if model == "UR5e" else "25, 125"
    with pytest.raises(urlink.BadValue, match=f"frequency=.*; expected one of {allowed} Hz for firmware {firmware}"):
        Controller(model, firmware, frequency=frequency)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sim://?frequency=", "frequency=''; expected one of 25, 50, 100, 125, 250, 500 Hz"),
        ("sim://?frequency=60", "frequency='60'; expected one of 25, 50"),
        ("sim://?frequency=125.0", "frequency='125.0'; expected one of 25, 50"),
        ("sim://?frequency=0125", "frequency='0125'; expected one of 25, 50"),
        ("sim://?frequency=\u0661\u0662\u0665", "expected one of 25, 50"),
        ("sim://?frequency=" + "9" * 5000, "expected one of 25, 50"),
        ("sim://ur5?firmware=3.15&frequency=50", "frequency=50; expected one of 25, 125 Hz for firmware 3.15"),
        ("ur://host?frequency=60", "frequency='60'; expected one of 25, 50"),
    ],
)
def test_address_with_another_frequency_is_rejected(text: str, message: str) -> None:
    with pytest.raises(urlink.BadAddress, match=message):
        parse_address(text)


def test_frequency_that_the_default_firmware_lacks_is_rejected() -> None:
    with pytest.raises(urlink.BadValue, match="frequency=50; expected one of 25, 125 Hz"):
        urlink.connect("sim://ur10?frequency=50")


@pytest.mark.simulated_time
def test_connection_rejects_a_frequency_of_another_firmware() -> None:
    with Controller(*CB3) as controller, pytest.raises(urlink.BadValue, match="expected one of 25, 125 Hz"):
        urlink.connect(f"{controller.address}&frequency=50")


@given(
    st.sampled_from(["127.0.0.1", "robot", "::1"]),
    st.dictionaries(st.sampled_from(["primary", "realtime", "rtde"]), st.integers(1, 65535)),
    st.none() | st.sampled_from(FREQUENCIES),
)
def test_robot_address_round_trip_keeps_the_frequency(host: str, ports: dict[str, int], frequency: int | None) -> None:
    address = RobotAddress(host, {**RobotAddress(host).ports, **ports}, frequency)
    assert parse_address(str(address)) == address


@given(st.sampled_from([NEWEST, LAST_CB3, None]), st.sampled_from(FREQUENCIES))
def test_sim_address_contains_the_frequency(firmware: Firmware | None, frequency: int) -> None:
    text = f"sim://?frequency={frequency}" + (f"&firmware={firmware}" if firmware else "")
    if firmware is None or firmware.rate % frequency == 0:
        assert parse_address(text) == SimulatorAddress(firmware=firmware, frequency=frequency)
    else:
        with pytest.raises(urlink.BadAddress):
            parse_address(text)


@given(st.sampled_from([Firmware(3, 15, 8), Firmware(5, 11), Firmware(10, 12)]), st.data())
def test_firmware_at_a_frequency_equals_its_version(firmware: Firmware, data: st.DataObject) -> None:
    slow = firmware.at(data.draw(st.sampled_from(firmware.frequencies)))
    for each in (slow, copy.copy(slow), copy.deepcopy(slow), pickle.loads(pickle.dumps(slow))):
        assert (each, hash(each), str(each), each.rate) == (firmware, hash(firmware), str(firmware), slow.rate)
        assert each.frequencies == firmware.frequencies
        assert each.at(firmware.rate).rate == firmware.rate
    described = described_identity({"name": "realtime", **Identity(slow, True, "UR5e").description()})
    assert described.firmware.rate == slow.rate


@pytest.mark.parametrize("value", [60, "125", 125.0, True, [], 500.5])
def test_recording_with_another_frequency_is_rejected(value: object) -> None:
    with pytest.raises(BadRecording, match=r"controller_frequency is .*; expected one of 25, 50"):
        described_identity({"name": "realtime", "firmware": "5.11", "model": None, "controller_frequency": value})
    with pytest.raises(BadRecording, match="expected one of 25, 125 Hz"):
        described_identity({"name": "realtime", "firmware": "3.15", "model": None, "controller_frequency": 50})
