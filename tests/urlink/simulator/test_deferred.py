"""Packets whose bytes are made when they are read: they must have the values of the bytes, whatever is read."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st

import urlink
from linkcore.clock import Stamp
from linkcore.deferred import Deferred, SteadyBytes
from linkcore.simulated import Simulation
from tests.urlink.simulator.rtde_peer import Peer, step
from urlink.motion.servo.linked_program import LinkedProgram
from urlink.protocol.enums import ProgramState, SafetyMode
from urlink.protocol.primary.robot_state import JointData, RobotModeData
from urlink.protocol.realtime.packets import RealtimeState
from urlink.rtde.claims import HOLD
from urlink.simulator import Controller, server
from urlink.simulator.interfaces.interface import InterfaceReceiver

NAMES = list(RealtimeState.FIELDS)
FIRMWARE = ["1.8", "3.1", "3.15", "5.3", "5.11", "10.7"]
HOME, AWAY = [0.0, -1.6, 1.6, -1.6, -1.6, 0.0], [0.3, -1.5, 1.5, -1.6, -1.6, 0.2]


def equal(one: Any, other: Any) -> bool:
    return type(one) is type(other) and np.array_equal(one, other)


@pytest.mark.property
@given(names=st.lists(st.sampled_from(NAMES)), firmware=st.sampled_from(FIRMWARE), cycles=st.integers(1, 200))
def test_deferred_state_equals_the_state_of_its_bytes(names: list[str], firmware: str, cycles: int) -> None:
    controller = Controller(firmware=firmware)
    controller.take("movej([0.1, -1.5, 1.5, -1.6, -1.6, 0.2], a=5, v=3)\n")
    controller.step(cycles)
    packet = controller._realtime.packet()
    controller.step()  # later cycles must not change the values
    stamp = Stamp(1.0, 2.0)
    state = packet.state(stamp)
    read = {name: getattr(state, name) for name in names}
    decoded = RealtimeState.LAYOUTS.decode(bytes(packet), controller.firmware)
    for name in names:
        assert equal(read[name], getattr(decoded, name)), name
    assert all(equal(getattr(state, name), getattr(decoded, name)) for name in NAMES)
    assert (state, hash(state), bytes(state), state.tail) == (decoded, hash(decoded), bytes(decoded), b"")
    assert state.received == stamp
    assert len(packet) == len(bytes(packet))


def test_deferred_array_is_read_only() -> None:
    state = Controller()._realtime.packet().state(None)
    with pytest.raises(ValueError, match="read-only"):
        state.q_actual[0] = 1.0


def test_deferred_packet_is_not_a_buffer() -> None:
    """Code that expects bytes must fail, instead of reading wrong ones."""
    packet: Any = Controller()._realtime.packet()
    with pytest.raises(TypeError, match="bytes-like"):
        memoryview(packet)


def program(robot: urlink.Robot, sim: Simulation) -> None:
    for q in (AWAY, HOME):
        robot.motion.move_joints(q, speed=2.0, acceleration=5.0).wait()
        robot.io.set_digital_out(0, q is AWAY)
        time.sleep(0.3)


def states_of(run: Callable[[urlink.Robot, Simulation], object], seed: int, firmware: str) -> list[bytes]:
    """Run a program; return the bytes of the states that the diagnosis has kept."""
    with urlink.simulated_time(seed) as sim, urlink.connect(f"sim://?firmware={firmware}") as robot:
        robot.realtime.wait(1.0)
        run(robot, sim)
        flight = robot.realtime._connection.flight
        assert flight is not None
        data, times = flight.since(0.0)
        assert times == sorted(times)
        assert data[0] == b""  # the beginning of the connection
        stats = robot.realtime.stats
        assert (stats.missed, stats.failed, stats.duplicates) == (0, 0, 0)
        assert stats.received == stats.decoded
        return data[1:]


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["3.15", "5.11"])
def test_running_ahead_sends_the_same_states(firmware: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same cycles must give the same bytes, whether the controller executes them early or when they are due."""
    ahead = states_of(program, 1, firmware)
    monkeypatch.setattr(server, "LONGEST_BATCH", 0.0)
    on_time = states_of(program, 1, firmware)
    # A command might arrive a cycle earlier or later, because more random numbers are drawn. So compare the cycles
    # before the first command.
    times = [RealtimeState.LAYOUTS.decode(data, firmware_of(firmware)).time for data in ahead]
    assert np.allclose(np.diff(times), times[1] - times[0])
    before = round(0.5 / (times[1] - times[0]))
    assert hashes(ahead[:before]) == hashes(on_time[:before])


def firmware_of(text: str) -> Any:
    from urlink.protocol.firmware import Firmware

    return Firmware.parse(text)


def hashes(states: list[bytes]) -> str:
    return hashlib.sha256(b"".join(states)).hexdigest()


@pytest.mark.simulated_time
def test_newest_state_is_current_while_the_controller_runs_ahead() -> None:
    with urlink.connect("sim://?firmware=5.11") as robot:
        robot.realtime.wait(1.0)
        handle = robot.motion.move_joints(AWAY, speed=0.5)
        for _ in range(50):
            time.sleep(0.0137)
            state, controller = robot.realtime.latest, robot.controller
            assert state is not None
            assert state.received is not None
            assert state.received.age < 0.0045
            assert controller.time - state.time < 0.0045
        handle.wait()


@pytest.mark.simulated_time
def test_callback_of_the_user_gets_each_state_when_it_is_sent() -> None:
    ages, times = [], []

    def look(state: RealtimeState) -> None:
        assert state.received is not None
        ages.append(state.received.age)
        times.append(state.time)

    with urlink.connect("sim://?firmware=5.11") as robot:
        robot.realtime.wait(1.0)
        with robot.realtime.subscribe(look), robot.realtime.subscribe(look, inline=True):
            robot.motion.move_joints(AWAY, speed=2.0, acceleration=5.0).wait()
    assert max(ages) < 1e-3
    assert sorted({round(1e3 * step) for step in np.diff(sorted(set(times)))}) == [2]


@pytest.mark.simulated_time
def test_stop_of_a_callback_takes_effect_in_the_next_cycles() -> None:
    """A callback that reacts must find the controller in the cycle of its state, and not in a later one."""
    lags = []

    with urlink.connect("sim://?firmware=5.11") as robot:
        robot.realtime.wait(1.0)

        def look(state: RealtimeState) -> None:
            lags.append(robot.controller.time - state.time)

        with robot.realtime.subscribe(look):
            robot.motion.move_joints(AWAY, speed=2.0, acceleration=5.0).wait()
    assert max(lags) < 1e-9


@pytest.mark.simulated_time
def test_servo_needs_no_second_thread_for_its_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a servo loop, steady states are processed in place of the thread that answers states."""
    look, looks = LinkedProgram._look, []

    def counting(self: LinkedProgram, link: Any, sent: float, state: RealtimeState) -> None:
        looks.append(state.time)
        look(self, link, sent, state)

    monkeypatch.setattr(LinkedProgram, "_look", counting)
    with urlink.connect("sim://?firmware=5.11") as robot, robot.motion.servo() as servo:
        q = robot.realtime.wait(1.0).q_target.copy()
        begin = q[5]

        def move(there: float, back: float, cycles: int) -> None:
            for cycle in range(cycles + 1):
                robot.realtime.wait(1.0)
                share = 0.5 - 0.5 * math.cos(math.pi * cycle / cycles)
                q[5] = begin + there + share * (back - there)
                servo.send(q)

        move(0.0, 0.3, 300)
        move(0.3, 0.3, 50)
        assert len(looks) < 20
        robot.dashboard.pause()
        robot.realtime.wait_until(lambda state: state.program_state == ProgramState.PAUSED)
        assert servo._program.is_paused
        time.sleep(0.2)
        robot.dashboard.play()
        robot.realtime.wait_until(lambda state: state.program_state == ProgramState.PLAYING)
        move(0.3, 0.3, 300)
        paused = len(looks)
        move(0.3, 0.0, 300)
        # Only the states of the pause, and the first ones after it, are for the thread.
        assert 20 < paused == len(looks) < 200
        move(0.0, 0.0, 50)
        assert robot.realtime.wait(1.0).q_target[5] == pytest.approx(begin, abs=1e-3)


@pytest.mark.simulated_time
def test_fault_during_a_pause_is_seen_in_its_cycle() -> None:
    with urlink.connect("sim://?firmware=5.11") as robot:
        robot.realtime.wait(1.0)
        stops: list[float] = []
        robot.safety.on_stop(lambda error: stops.append(robot.controller.time))
        robot.motion.move_joints(AWAY, speed=2.0, acceleration=5.0).wait()
        time.sleep(0.5)
        begun = robot.controller.time
        robot.controller.faults.protective_stop()
        time.sleep(0.5)
        assert len(stops) == 1
        assert 0.0 <= stops[0] - begun < 0.02


def test_fault_at_a_simulated_time_does_not_disturb_a_sleep() -> None:
    """The call waits for the thread of the controller, in place of a thread that already waits."""
    with urlink.simulated_time(0) as sim, urlink.connect("sim://?firmware=5.11") as robot:
        robot.realtime.wait(1.0)
        sim.at(sim.now + 1.0, robot.controller.faults.protective_stop)
        begun = sim.now
        for _ in range(40):
            time.sleep(0.05)
        assert sim.now - begun == pytest.approx(2.0, abs=0.01)
        assert robot.realtime.wait(1.0).safety_mode == SafetyMode.PROTECTIVE_STOP


#: Program with joint motions, pauses, outputs, a blend, and the history of the joint positions.
SCRIPT = """def cell():
  movej([0.5, -1.4, 1.5, -1.5, -1.6, 0.3], a={a}, v={v})
  sleep(0.1)
  set_digital_out(1, True)
  movej([0.5, -1.2, 1.5, -1.5, -1.6, 0.3], a=3, v=2)
  old = get_actual_joint_positions_history(7)
  movej(get_inverse_kin(get_forward_kin()), a=1, v=1)
  movej([0.2, -1.3, 1.6, -1.5, -1.5, 0.1], a={a}, v={v}, r={r})
  movej([0, -1.5, 2, -2, -1.57, 0], t=0.7)
  textmsg(to_str(old))
end
"""


@pytest.mark.property
@given(
    lengths=st.lists(st.integers(1, 64), min_size=1, max_size=40),
    a=st.floats(0.5, 8.0),
    v=st.floats(0.1, 3.0),
    r=st.sampled_from([0.0, 0.05]),
    slider=st.sampled_from([1.0, 0.4]),
    firmware=st.sampled_from(["3.15", "5.11", "10.12"]),
)
def test_cycles_executed_at_once_send_the_same_bytes(
    lengths: list[int], a: float, v: float, r: float, slider: float, firmware: str
) -> None:
    """Cycles that are executed at once, as arrays, must give the same packets and messages as single, full cycles."""
    step_by_step, at_once = (Controller(firmware=firmware, seed=len(lengths)) for _ in range(2))
    step_by_step._control._glides = lambda: False  # type: ignore[method-assign]
    for controller in (step_by_step, at_once):
        controller.speed_fraction = slider
        controller.take(SCRIPT.format(a=a, v=v, r=r))
    states: dict[int, bytes] = {}
    packets, count = [], 0
    for length in lengths * 4:
        at_once.step()
        packets.append(at_once.realtime_packet())
        begun = at_once.cycle
        at_once._states.of_cycle(begun)
        samples = at_once._control.advance_many(length)
        if samples is not None:
            packets += map(bytes, at_once._realtime.later_packets(samples)[1:])
            later = at_once._states.later(begun, samples, at_once.cycle)
            states.update({cycle: bytes(state) for cycle, state in later.items()})
            count += len(samples) - 1
    expected, expected_states = [], {}
    for _ in packets:
        step_by_step.step()
        expected.append(step_by_step.realtime_packet())
        if step_by_step.cycle in states:
            expected_states[step_by_step.cycle] = step_by_step.state_package()
    assert hashes(packets) == hashes(expected)
    assert states == expected_states
    assert at_once.take_messages() == step_by_step.take_messages()
    assert at_once.time == step_by_step.time
    event(f"{count // 100} hundred cycles at once")


def test_joint_motion_is_executed_at_once() -> None:
    controller = Controller(firmware="5.11")
    controller.take("movej([0.1, -1.5, 1.5, -1.6, -1.6, 0.2], a=1, v=1)\n")
    controller.step(100)
    samples = controller._control.advance_many(50)
    assert samples is not None
    assert len(samples) == 51
    assert samples[50].q_target != samples[0].q_target
    assert controller.arm.setpoint.q == samples[50].q_target


@pytest.mark.parametrize(
    "text",
    [
        "movel(p[-0.5, -0.1, 0.4, 0, 3.1, 0])",
        "speedj([0.1, 0, 0, 0, 0, 0], 1, 5)",
        "movej([1, -1.5, 1.5, -1.6, -1.6, 0.2], a=1, v=1, r=0.1)",
    ],
)
def test_other_motions_are_executed_cycle_by_cycle(text: str) -> None:
    controller = Controller(firmware="5.11")
    controller.take(f"{text}\n")
    controller.step(100)
    assert controller.arm.is_moving
    assert controller._control.advance_many(50) is None


def test_transition_to_a_joint_motion_is_executed_cycle_by_cycle() -> None:
    controller = Controller(firmware="5.11")
    controller.take(
        "def p():\n  speedj([0.8, 0, 0, 0, 0, 0], 5, 1.5)\n  movej([3.5, -1.5, 1.5, -1.6, -1.6, 0.2])\nend\n"
    )
    controller.step(810)
    assert controller._control.advance_many(50) is None
    controller.step(100)
    assert controller._control.advance_many(50) is not None


def test_program_with_two_threads_runs_cycle_by_cycle() -> None:
    controller = Controller(firmware="5.11")
    controller.take(
        "def p():\n  thread t():\n    while True:\n      sync()\n    end\n  end\n  run t()\n"
        "  movej([1, -1.5, 1.5, -1.6, -1.6, 0.2])\nend\n"
    )
    controller.step(100)
    assert controller.arm.is_moving
    assert controller._control.advance_many(50) is None


def test_change_of_the_modes_is_not_steady_when_it_is_sent() -> None:
    """A packet is steady only if the one that was sent before it shows the same modes."""
    controller = Controller(firmware="5.11")
    interface = controller._realtime
    controller.step()
    interface.packet()
    controller.step()
    assert interface.steady_packet() is not None
    controller.faults.protective_stop()
    controller.step()
    assert interface.steady_packet() is None
    assert not interface.packet().is_steady
    controller.step()
    assert interface.packet().is_steady


@pytest.mark.simulated_time
def test_state_stays_fresh_while_only_its_time_changes() -> None:
    """The safety state must not become outdated while every packet shows the same modes."""
    with urlink.connect("sim://?firmware=5.11") as robot:
        robot.motion.move_joints(HOME).wait()
        time.sleep(3.0)
        control = robot._control.made
        assert control is not None
        monitor = control._monitor
        with monitor.decision() as interlock:
            assert interlock.refusal_to_begin(monitor.clock()) is None
        robot.motion.move_joints(AWAY).wait()


@pytest.mark.parametrize("firmware", FIRMWARE)
def test_robot_state_read_later_has_the_values_of_its_cycle(firmware: str) -> None:
    controller = Controller(firmware=firmware)
    controller.take("movej([0.1, -1.5, 1.5, -1.6, -1.6, 0.2], a=5, v=3)\n")
    controller.step(50)
    expected = controller.state_package()
    state = controller._states.of_cycle(controller.cycle)
    controller.signals.set_digital_output(1, True)
    controller.arm.tcp = [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]
    controller.faults.protective_stop()
    controller.step(50)
    assert bytes(state) == expected
    assert (len(state), state.head) == (len(expected), expected[: len(state.head)])


def test_robot_state_is_steady_after_the_same_modes_and_signals() -> None:
    controller = Controller(firmware="5.11")
    states = controller._states

    def is_next_steady() -> bool:
        controller.step()
        return states.of_cycle(controller.cycle).is_steady

    assert not is_next_steady()
    assert is_next_steady()
    controller.signals.set_digital_output(1, True)
    assert not states.is_steady
    assert not is_next_steady()
    assert is_next_steady()
    # A new client has got a state that the others have not.
    controller.signals.set_digital_output(1, False)
    states.greeting()
    controller.signals.set_digital_output(1, True)
    assert not is_next_steady()
    assert is_next_steady()
    # The clients of the secondary interface have not got this state.
    controller.step()
    states.extra(controller.cycle)
    assert not is_next_steady()


@pytest.mark.simulated_time
@pytest.mark.parametrize("firmware", ["3.15", "5.11"])
def test_newest_robot_state_is_current_while_nobody_reads_states(firmware: str) -> None:
    with urlink.connect(f"sim://?firmware={firmware}") as robot:
        robot.motion.move_joints(AWAY, speed=0.5)
        for _ in range(20):
            time.sleep(0.137)
            state, mode, joints = (
                robot.primary.latest,
                robot.primary.of(RobotModeData).latest,
                robot.primary.of(JointData).latest,
            )
            assert state is not None
            assert (mode, joints) == (state.robot_mode_data, state.joint_data)
            assert state.received is not None
            assert state.received.age < 0.11
            assert mode is not None
            assert robot.controller.time - 1e-6 * mode.timestamp < 0.11
            assert joints is not None
            assert np.abs(joints.q_actual - robot.controller.arm.sample.q_actual).max() < 0.1
        stats = robot.primary.stats
        assert (stats.missed, stats.failed, stats.duplicates) == (0, 0, 0)
        assert 27 <= stats.received <= 40


@pytest.mark.simulated_time
@pytest.mark.parametrize("firmware", ["3.15", "5.11"])
def test_outputs_are_released_while_the_controller_runs_ahead(firmware: str) -> None:
    with urlink.connect(f"sim://?firmware={firmware}") as robot:
        robot.motion.move_joints(HOME).wait()
        robot.io.set_digital_out(0, True)
        sessions = robot.controller.rtde.sessions
        time.sleep(HOLD - 0.1)
        assert len(sessions) == 1
        time.sleep(0.15)
        assert not sessions


class Batches:
    """Client of the RTDE interface that keeps the packages that were sent to it before they were due."""

    last_quiet_cycle = 10_000

    def __init__(self, receiver: InterfaceReceiver) -> None:
        self.receiver = receiver
        self.sent: dict[int, bytes] = {}

    def send_batch(self, packets: Sequence[Deferred | SteadyBytes], cycles: Sequence[int]) -> None:
        self.sent.update(zip(cycles, map(bytes, packets), strict=True))


@pytest.mark.parametrize("frequency", [50.0, 500.0])
def test_time_sent_ahead_equals_the_time_sent_in_its_cycle(frequency: float) -> None:
    expected: dict[int, bytes] = {}
    on_time, ahead = Controller(firmware="5.11"), Controller(firmware="5.11")
    for controller in (on_time, ahead):
        peer = Peer(controller)
        peer.outputs("timestamp", frequency=frequency)
        peer.ask("S")
        if controller is on_time:
            for _ in range(100):
                step(controller)
                if peer.sent:
                    expected[controller.cycle] = bytes(peer.sent)
                    peer.sent.clear()
    client = Batches(peer.session)
    ahead.step(100)
    ahead.rtde.send_ahead(ahead.cycle, None, [client])
    assert client.sent == expected
    assert len(expected) == round(100 * frequency / 500)


@pytest.mark.simulated_time
def test_change_during_a_glide_is_sent_in_the_next_cycle() -> None:
    """A test may change the controller between two cycles, without a call in the controller's thread."""
    with urlink.connect("sim://?firmware=5.11") as robot:
        robot.realtime.wait(1.0)
        controller, seen = robot.controller, []

        def look(state: RealtimeState) -> None:
            seen.append((state.digital_output_bits, state.safety_mode))
            if len(seen) == 100:
                controller.signals.set_digital_output(3, True)
            if len(seen) == 200:
                controller.modes.protective_stop()

        with robot.realtime.subscribe(look):
            handle = robot.motion.move_joints(AWAY, speed=0.4)
            time.sleep(0.6)
        assert seen[99][0] == 0
        assert seen[100][0] == 8
        assert seen[199][1] == SafetyMode.NORMAL
        assert seen[200][1] == SafetyMode.PROTECTIVE_STOP
        with pytest.raises(urlink.SafetyStop):
            handle.wait(1.0)
