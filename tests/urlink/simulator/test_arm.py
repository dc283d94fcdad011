from __future__ import annotations

import inspect
import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from urlink.arm.dynamics import GRAVITY, Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS
from urlink.arm.motors import motors_of
from urlink.arm.parameters import number
from urlink.protocol.realtime.packets import RealtimeState
from urlink.simulator import Controller
from urlink.simulator.robot.characteristics import SensorParameters
from urlink.simulator.robot.sensors import Progress, Sample, Sensors
from urlink.simulator.robot.setpoint_sources import HOME, Demonstration, Setpoint, Still
from urlink.simulator.rtde_variables import robot_current

ANGLES = st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6)


def run(controller: Controller, cycles: int) -> list[RealtimeState]:
    """Step the controller and return one decoded real-time packet per cycle."""
    states = []
    for _ in range(cycles):
        controller.step()
        states.append(RealtimeState.LAYOUTS.decode(controller.realtime_packet(), controller.firmware))
    return states


def column(states: list[RealtimeState], name: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.array([getattr(state, name) for state in states])


@pytest.mark.parametrize("name", MODELS)
def test_tool_vectors_match_the_forward_kinematics(name: str) -> None:
    controller = Controller(name, motion=Demonstration())
    controller.arm.tcp = [0.01, -0.02, 0.15, 0.3, -0.2, 0.1]
    controller.step(500)
    for state in run(controller, 3):
        for joints, tool in [(state.q_actual, state.tool_vector_actual), (state.q_target, state.tool_vector_target)]:
            assert tool == pytest.approx(Arm(controller.model).forward(joints, controller.arm.tcp), abs=1e-12)
        jacobian = Arm(controller.model).jacobian(state.q_actual, controller.arm.tcp)
        assert state.tcp_speed_actual == pytest.approx(jacobian @ state.qd_actual, abs=1e-12)
        jacobian = Arm(controller.model).jacobian(state.q_target, controller.arm.tcp)
        assert state.tcp_speed_target == pytest.approx(jacobian @ state.qd_target, abs=1e-12)
        elbow = Arm(controller.model).frames(state.q_actual)[2][:3, 3]
        assert state.elbow_position == pytest.approx(elbow, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "firmware"), [("UR5e", "5.11"), ("UR10", "3.14"), ("UR5", "1.8")])
def test_speeds_are_the_derivatives_of_positions(name: str, firmware: str) -> None:
    controller = Controller(name, firmware, motion=Demonstration())
    # The recording starts after the ramp and is long enough for every joint to reverse once.
    states = run(controller, 14 * controller.firmware.rate)
    dt = 1.0 / controller.firmware.rate
    assert np.ptp(column(states, "qd_target"), axis=0).min() > 0.1

    def central(name: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        values = column(states, name)
        return (values[2:] - values[:-2]) / (2.0 * dt)

    assert np.abs(central("q_target") - column(states, "qd_target")[1:-1]).max() < 1e-4
    assert np.abs(central("qd_target") - column(states, "qdd_target")[1:-1]).max() < 0.02
    # The sensors are noisy. Averaged over 0.1 s, the noise of both values is well below this limit.
    tenth = controller.firmware.rate // 10
    q, qd = column(states, "q_actual"), column(states, "qd_actual")
    mean = np.array([qd[i : i + tenth].mean(axis=0) for i in range(len(qd) - tenth)])
    moved = (q[tenth:] - q[:-tenth]) / (tenth * dt)
    assert np.abs(moved - mean).max() < 0.02
    if not controller.firmware.is_cb2:
        tool = central("tool_vector_target")[:, :3]
        assert np.abs(tool - column(states, "tcp_speed_target")[1:-1, :3]).max() < 1e-4
    if controller.firmware >= (3, 5):
        # The noise of the elbow is the combined noise of two joints.
        elbow = column(states, "elbow_position")
        mean = np.array(
            [column(states, "elbow_velocity")[i : i + tenth].mean(axis=0) for i in range(0, len(qd) - tenth, tenth)]
        )
        moved = ((elbow[tenth:] - elbow[:-tenth]) / (tenth * dt))[::tenth]
        assert np.abs(moved - mean[: len(moved)]).max() < 4e-3


@pytest.mark.parametrize("name", MODELS)
def test_demonstration_stays_within_gentle_limits(name: str) -> None:
    model = MODELS[name]
    motion = Demonstration()
    steps = [motion.advance(0.008) for _ in range(4000)]
    q, qd, qdd = (np.array(each) for each in zip(*steps, strict=True))
    assert np.abs(qd[0]).max() < 1e-3
    assert q[0] == pytest.approx(HOME, abs=1e-4)
    assert 0.3 < np.abs(qd).max() <= 0.45
    assert np.abs(qdd).max() <= 0.7
    assert (np.abs(qd) < 0.5 * model.max_speed).all()
    assert (q > model.position_limits[:, 0] + 1.0).all()
    assert (q < model.position_limits[:, 1] - 1.0).all()
    for row in q[::40]:
        # The arm stays away from singular postures and from the floor.
        assert np.linalg.cond(Arm(model).jacobian(row)) < 40.0
        assert Arm(model).frames(row)[1:, 2, 3].min() > 0.05


@pytest.mark.parametrize("name", ["UR5", "UR5e", "UR10e", "UR16e"])
@pytest.mark.parametrize(("sideways", "across"), [(0.25, 0), (-0.25, 0), (0.25, 2), (-0.25, 2)])
def test_large_circle_from_home_avoids_singularities(name: str, sideways: float, across: int) -> None:
    arm = Arm(MODELS[name])
    begin, q = arm.forward(HOME), list(HOME)
    for angle in np.linspace(0.0, 2.0 * np.pi, 121):
        pose = begin.copy()
        pose[1] += sideways * (1.0 - np.cos(angle))
        pose[across] += 0.25 * np.sin(angle)
        q = arm.inverse(pose, q, is_limited=False).tolist()
        assert np.linalg.svd(arm.jacobian(q))[1].min() > 0.05


def test_demonstration_starts_from_any_posture() -> None:
    motion = Demonstration()
    start = [1.0, -1.0, 1.0, -2.0, -1.0, 3.0]
    motion.start(start)
    steps = [motion.advance(0.002) for _ in range(10000)]
    assert steps[0].q == pytest.approx(start, abs=1e-5)
    speeds = np.array([step.qd for step in steps])
    assert np.abs(speeds[0]).max() < 1e-3
    assert np.abs(speeds).max() <= 0.4501
    assert np.abs(np.diff(speeds, axis=0)).max() < 0.002


@pytest.mark.parametrize(("name", "firmware"), [("UR20", "5.14"), ("UR5", "1.8")])
@pytest.mark.parametrize("fault", ["protective_stop", "emergency_stop", "power_off"])
def test_stop_brakes_gradually(name: str, firmware: str, fault: str) -> None:
    controller = Controller(name, firmware, motion=Demonstration())
    controller.step(3 * controller.firmware.rate)
    states = run(controller, 1)
    getattr(controller.faults, fault)()
    states += run(controller, controller.firmware.rate)
    speeds, dt = column(states, "qd_target"), 1.0 / controller.firmware.rate
    assert np.abs(speeds[0]).max() > 0.2
    assert not speeds[-1].any()
    assert np.abs(np.diff(speeds, axis=0)).max() <= 0.3 * controller.model.max_acceleration.max() * dt
    moved = np.diff(column(states, "q_target"), axis=0) / dt
    assert np.abs(moved - (speeds[1:] + speeds[:-1]) / 2.0).max() < 0.03
    # The arm comes to rest within a quarter of a second, but not immediately.
    resting = next(i for i, row in enumerate(speeds) if not row.any())
    assert 0.02 < resting * dt < 0.25
    after = column(states, "q_target")[resting:]
    assert (after == after[0]).all()


@pytest.mark.slow
def test_motion_resumes_from_rest_after_protective_stop() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    controller.step(1500)
    controller.faults.protective_stop()
    before = run(controller, 500)[-1]
    controller.faults.clear()
    states = run(controller, 3000)
    assert states[0].q_target == pytest.approx(before.q_target, abs=1e-5)
    assert np.abs(np.diff(column(states, "qd_target"), axis=0)).max() < 0.01
    assert np.abs(column(states, "qd_target")).max() > 0.2


def test_arm_brakes_before_it_follows_another_motion() -> None:
    class Wave:
        is_program = True

        def __init__(self) -> None:
            self.time = 0.0
            self.begin = [0.0] * 6

        def start(self, q: list[float]) -> None:  # type: ignore[override, unused-ignore]
            self.time, self.begin = 0.0, list(q)

        def advance(self, seconds: float) -> Setpoint:
            self.time += seconds
            turn = 0.1 * (1.0 - math.cos(self.time))
            speed, change = 0.1 * math.sin(self.time), 0.1 * math.cos(self.time)
            return Setpoint([self.begin[0] + turn, *self.begin[1:]], [speed] + [0.0] * 5, [change] + [0.0] * 5)

    controller = Controller("UR5e", motion=Demonstration())
    controller.step(1500)
    before = run(controller, 1)
    assert np.abs(column(before, "qd_target")).max() > 0.1
    controller.follow(Wave())  # type: ignore[arg-type, unused-ignore]
    states = before + run(controller, 1000)
    # The arm brakes first, so no speed jumps.
    assert np.abs(np.diff(column(states, "qd_target"), axis=0)).max() < 0.03
    assert not column(states, "qd_target")[-1, 1:].any()
    assert states[-1].qd_target[0] > 0.05


def test_arm_without_program_stays_at_rest() -> None:
    controller = Controller("UR5e", "5.11", motion=Still())
    states = run(controller, 50)
    assert not column(states, "qd_actual").any()
    assert states[-1].program_state is not None
    assert states[-1].program_state.name == "STOPPED"
    assert states[-1].speed_scaling == 0.0
    noise = column(states, "q_actual") - column(states, "q_target")
    assert 0.0 < np.abs(noise).max() < 2e-4
    # The constant part of the error exceeds the mean that the changing noise alone would have.
    assert np.abs(noise.mean(axis=0)).max() > 1e-5
    # The encoders of the first four joints have a finite resolution.
    steps = column(states, "q_actual")[:, :4] / (math.tau / 2**19)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_gravity_affects_moments_currents_and_accelerometer() -> None:
    controller = Controller("UR5e", "5.11", motion=Still())
    empty = run(controller, 1)[0]
    assert empty.M_target == pytest.approx(Dynamics(controller.model).gravity_torque(empty.q_target))
    assert empty.M_target[1] < -15.0
    assert (np.sign(empty.I_target[1:3]) == np.sign(empty.M_target[1:3])).all()
    assert empty.I_control == pytest.approx(empty.I_target, abs=0.0)
    # Static friction also holds a joint that is at rest.
    coulomb = np.array(motors_of("UR5e").coulomb)
    assert 0.0 < (np.abs(empty.I_actual - empty.I_target) / coulomb).max() < 2.5
    # The tool points down, so the supporting acceleration is along its negative z axis.
    assert empty.tool_accelerometer == pytest.approx([0.0, 0.0, -GRAVITY], abs=0.2)
    controller.arm.payload = 4.0
    loaded = run(controller, 1)[0]
    assert loaded.M_target[1] < empty.M_target[1] - 5.0
    assert loaded.I_actual[1] < empty.I_actual[1] - 0.5
    assert loaded.payload_mass == 4.0


def test_moments_and_currents_match_the_dynamics() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    states = run(controller, 1000)
    for state in states[::100]:
        whole = Dynamics(controller.model, rotors=True).torque(state.q_target, state.qd_target, state.qdd_target)
        assert state.M_target == pytest.approx(whole)
        assert state.I_target == pytest.approx(motors_of("UR5e").current(list(whole), list(state.qd_target)))


def test_momentum_is_that_of_the_moving_mass() -> None:
    controller = Controller("UR10e", "5.11", motion=Demonstration())
    controller.step(1500)
    (moving,) = run(controller, 1)
    most = controller.model.link_masses.sum() * np.linalg.norm(moving.tcp_speed_actual[:3])
    assert moving.linear_momentum_norm is not None
    assert 0.2 * most < moving.linear_momentum_norm < most
    controller.faults.protective_stop()
    # The joints still creep for about a second.
    assert run(controller, 1500)[-1].linear_momentum_norm == 0.0


@pytest.mark.slow
def test_temperatures_are_those_of_an_arm_that_was_on_and_rise_slowly() -> None:
    controller = Controller("UR5", "3.14", motion=Demonstration())
    cold = run(controller, 1)[0].motor_temperatures
    controller.step(60 * 125)
    warmer = run(controller, 1)[0].motor_temperatures
    controller.step(600 * 125)
    warm = run(controller, 1)[0].motor_temperatures
    assert (cold > 33.0).all()
    assert (cold <= warmer).all()
    assert (warmer <= warm).all()
    assert (cold < warm).any()
    assert warm.max() < 45.0


def test_arm_without_power_has_no_current() -> None:
    controller = Controller("UR5e", "5.11", motion=Demonstration())
    controller.step(100)
    controller.faults.power_off()
    state = run(controller, 500)[-1]
    assert not state.I_actual.any()
    assert not state.M_target.any()
    assert state.V_robot == 0.0
    assert state.I_robot == 0.0
    assert (state.q_actual == state.q_target).all()


@pytest.mark.slow
def test_same_seed_gives_same_bytes_however_often_read() -> None:
    def last(seed: int, looks: int) -> tuple[bytes, bytes]:
        controller = Controller("UR10e", "5.11", seed=seed, motion=Demonstration())
        controller.schedule("protective_stop@1", "clear@1.5")
        for cycle in range(1500):
            controller.step()
            if looks and cycle % looks == 0:
                controller.realtime_packet()
        return controller.realtime_packet(), controller.state_package(first=True)

    assert last(7, 0) == last(7, 1) == last(7, 13)
    assert last(7, 0)[0] != last(8, 0)[0]


def test_joint_properties_match_the_sample() -> None:
    controller = Controller("UR5e", motion=Demonstration())
    arm = controller.arm
    for stop in (controller.faults.clear, controller.faults.protective_stop, controller.faults.power_off):
        stop()
        for _ in range(300):
            controller.step()
            alone, speeds = arm.q_actual, arm.qd_actual
            assert alone == arm.sample.q_actual == arm.q_actual
            assert speeds == arm.sample.qd_actual == arm.qd_actual


def test_tcp_rejects_anything_but_six_finite_numbers() -> None:
    arm = Controller("UR5e").arm
    for wrong in itertools.chain([[0.0] * 5], [[0.0] * 5 + [math.nan]]):
        with pytest.raises(BadValue, match="six finite numbers"):
            arm.tcp = wrong


def test_signals_reject_wrong_numbers_and_values() -> None:
    signals = Controller().signals
    signals.set_digital_input(17, True)
    signals.set_digital_input(0, True)
    signals.set_digital_input(0, False)
    assert signals.digital_inputs == 1 << 17
    signals.set_analog_output(1, 0.02)
    assert signals.analog_outputs == [0.004, 0.02]
    with pytest.raises(BadValue, match="0 to 17"):
        signals.set_digital_output(18, True)
    with pytest.raises(BadValue, match="0 to 3"):
        signals.set_analog_input(4, 1.0)
    with pytest.raises(BadValue, match="output 0 or 1"):
        signals.set_analog_output(0, math.inf)


def test_sensors_recompute_cached_values_after_changes() -> None:
    """The values cached in the previous cycle must be reused only while their inputs are unchanged."""
    kinematics = Arm("UR5e")
    parts = kinematics, motors_of("UR5e"), SensorParameters(), HOME
    sensors = Sensors(*parts, seed=3, is_cb2=False)
    progress = Progress(0.002, 7, 0, 2, [2] * 6, 0, None)
    bare, loaded = Dynamics(kinematics), Dynamics(kinematics, payload=1.5, payload_cog=(0.0, 0.0, 0.05))
    at, elsewhere = Setpoint(list(HOME), [0.0] * 6, [0.0] * 6), Setpoint([q + 0.1 for q in HOME], [0.0] * 6, [0.0] * 6)
    flange, tool, pushed = [0.0] * 6, [0.0, 0.01, 0.2, 0.3, 0.0, 0.1], (1.0, 2.0, 3.0, 0, 0, 0)
    for setpoint, tcp, dynamics, external in (
        (at, flange, bare, [0.0] * 6),
        (at, flange, bare, [0.0] * 6),
        (at, tool, bare, [0.0] * 6),
        (at, tool, loaded, [0.0] * 6),
        (at, tool, loaded, pushed),
        (elsewhere, tool, loaded, pushed),
        (elsewhere._replace(qdd=[1.0] * 6), tool, loaded, pushed),
        (elsewhere._replace(qd=[0.1] * 6), tool, loaded, pushed),
        (at, flange, bare, [0.0] * 6),
    ):
        of_cycle = setpoint, tcp, dynamics, external, external, [0.0] * 6, progress, 1.0, True, [0.0] * 6
        used, new = (Sample(each, *of_cycle) for each in (sensors, Sensors(*parts, seed=3, is_cb2=False)))
        for name in VALUES:
            assert getattr(used, name) == getattr(new, name), name


#: Names of the values of a sample.
VALUES = [name for name in Sample.__slots__ if name not in inspect.signature(Sample).parameters]


@pytest.mark.property
@given(order=st.permutations(VALUES), count=st.integers(1, len(VALUES)), firmware=st.sampled_from(["5.11", "3.15"]))
def test_sample_values_are_equal_in_any_order(order: list[str], count: int, firmware: str) -> None:
    """A sample whose values are read later, in another order or partly, must have the values of its own cycle."""
    read_at_once, read_later = arms = [Controller(firmware=firmware) for _ in range(2)]
    kept, expected = [], []
    for controller in arms:
        controller.take("movej([0.1, -1.5, 1.5, -1.6, -1.6, 0.2], a=5, v=3)\n")
        controller.push([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    for cycle in range(60):
        for controller in arms:
            controller.step()
            if cycle == 40:
                controller.arm.tcp = [0.0, 0.0, 0.1, 0.0, 0.2, 0.0]
                controller.arm.zero_force()
        sample = read_at_once.arm.sample
        expected.append({name: getattr(sample, name) for name in VALUES})
        kept.append(read_later.arm.sample)
    for sample, values in zip(reversed(kept), reversed(expected), strict=True):
        for name in order[:count]:
            assert getattr(sample, name) == values[name], name


def test_robot_current_is_the_same_on_every_python() -> None:
    """`sum` of floats compensates rounding errors since Python 3.12, which would change the last bits of packets."""
    controller = Controller("UR5e", "5.11")
    state: Any = SimpleNamespace(arm=controller.arm, modes=controller.modes)
    state.arm.sample.I_actual = [1e8, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert robot_current(state) == number("robot_idle_current") + number("robot_current_of_heat") * 1e16
