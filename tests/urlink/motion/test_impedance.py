"""The uploaded program of an impedance, on a simulated controller that the test steps."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from types import FrameType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.matrix import trials
from tests.urlink.motion.test_force_control_programs import LINK, Bench
from tests.urlink.simulator.test_impedance import HORIZONTAL
from tests.urlink.simulator.test_impedance import program as circle
from urlink.arm.models import model
from urlink.arm.vectors import FloatArray
from urlink.script.links import FOLLOW, STOP
from urlink.script.springs import GAINS, LOOSE, MARGIN, TOP, Springs, impedance
from urlink.script.wrapping import program
from urlink.simulator import Controller, Plane, Spring, Still

READY = (0.0, -1.5, 2.0, -2.0, -1.57, 0.3)
STIFFNESS, TORQUE = (1000.0, 1000.0, 500.0, 100.0, 100.0, 100.0), (28.0, 28.0, 14.0, 4.5, 4.5, 4.5)


class Soft(Bench):
    """Arm with an impedance; each cycle repeats the current message.

    Args:
        name, firmware: Model and firmware of the arm.
        q: Start position, shape (6,), in rad.
        options: Options of `Springs`.
    """

    def __init__(self, name: str = "UR5e", firmware: str = "5.25", q: Sequence[float] = READY, **options: Any) -> None:
        self.controller = Controller(name, firmware, motion=Still(q), noise=False)
        self.controller.step()
        self.firmware = self.controller.firmware
        self.arm = self.controller.arm
        self.start = self.pose
        self._count = self._number = 0
        self._target: Sequence[float] = [0.0] * 6
        arm = model(name)
        low, high = np.clip(arm.position_limits, -1e6, 1e6).T
        torque = np.array(options.pop("torque", TORQUE))
        values: dict[str, Any] = {
            "stiffness": STIFFNESS,
            "damping": [1.0] * 6,
            "speed": [1.0] * 6,
            "torque": torque.tolist(),
            "braking": np.minimum(4.0 * torque, arm.max_torque).tolist(),
            "error": [0.2] * 6,
            "lowest": low.tolist(),
            "highest": high.tolist(),
            "friction_compensation": True,
            "watchdog": 0.5,
        }
        self.springs = Springs(**(values | options))
        self.inertia = np.diag(self.arm.dynamics.mass_matrix(self.q))
        self.controller.take(self.observed(program("tried", impedance(self.firmware, LINK, self.springs), None).text))
        self.go(0.1)

    def observed(self, text: str) -> str:
        """Return the program, with additions that a test needs to observe it."""
        return text

    @property
    def q(self) -> FloatArray:
        return np.array(self.arm.setpoint.q)

    @property
    def qd(self) -> FloatArray:
        return np.array(self.arm.setpoint.qd)

    @property
    def is_stopped(self) -> bool:
        return self.controller.modes.safety_mode.name != "NORMAL"

    def _say(self, first: Sequence[float], second: Sequence[float], seconds: float, mode: int = FOLLOW) -> None:
        for i, value in enumerate(second):
            self.controller.registers.inputs.floats[LINK.first_float + 6 + i] = value
        self.write_messages(first, seconds, mode)

    def go(self, seconds: float = 0.002) -> None:
        """Keep the target for some time."""
        self._say(self._target, [self._number, 0, 0, 0, 0, 0], seconds)

    def lead(self, target: Sequence[float] | FloatArray, seconds: float = 0.002) -> None:
        """Set a new target, and keep it for some time."""
        self._target, self._number = list(target), self._number + 1
        self.go(seconds)

    def gain(self, stiffness: Sequence[float], damping: Sequence[float]) -> None:
        self._say([each / 1000.0 for each in stiffness], damping, 0.002, GAINS)

    def end(self, seconds: float = 1.0) -> None:
        self._say([0.0] * 6, [0.0] * 6, 0.002, STOP)
        self.silent(seconds - 0.002)

    def static(self, q: FloatArray, aim: FloatArray) -> FloatArray:
        """Return the spring torques at rest, shape (6,), in Nm, including the limits at the ends of joint ranges."""
        s = self.springs
        spring = np.array(s.stiffness) * np.clip(aim - q, np.negative(s.error), s.error)
        spring = np.clip(spring, np.negative(s.torque), s.torque)
        top = TOP * np.array(s.speed)
        fastest = np.clip(5.0 * (np.array(s.highest) - MARGIN - q), -top, top)
        slowest = np.clip(5.0 * (np.array(s.lowest) + MARGIN - q), -top, top)
        spring = np.clip(spring, 75.0 * self.inertia * slowest, 75.0 * self.inertia * fastest)
        clipped: FloatArray = np.clip(spring, np.negative(s.braking), s.braking)
        return clipped


def turned(q: FloatArray, angle: float) -> FloatArray:
    """Return the same joint positions, with the base turned by `angle` rad."""
    there = q.copy()
    there[0] += angle
    return there


@pytest.mark.slow
@pytest.mark.matrix(3)
@pytest.mark.parametrize("axis", range(6))
def test_displacement_of_joints_is_torque_divided_by_stiffness(axis: int) -> None:
    soft = Soft()
    wrench = [0.0] * 6
    wrench[axis] = 15.0 if axis < 3 else 2.0
    jacobian = soft.arm.kinematics.jacobian(soft.q, soft.arm.tcp)
    compliance = jacobian @ np.diag(1.0 / np.array(STIFFNESS)) @ jacobian.T
    start = np.array(soft.pose[:3])
    begin = soft.q
    soft.controller.push(wrench)
    soft.go(1.2)
    moved = jacobian @ (soft.q - begin)
    expected = compliance @ wrench
    assert np.abs(moved - expected).max() < 0.05 * np.abs(expected).max()
    assert np.linalg.norm(np.array(soft.pose[:3]) - start - expected[:3]) < 0.05 * np.linalg.norm(expected)
    assert moved[axis] > 0.0


def test_arm_reaches_target_and_rests_after_end() -> None:
    soft = Soft()
    goal = soft.q + np.array([0.3, 0.1, -0.2, 0.2, 0.5, 1.0])
    fastest = 0.0
    soft.lead(goal)
    for _ in range(1100):
        soft.go()
        fastest = max(fastest, float(np.abs(soft.qd).max()))
    np.testing.assert_allclose(soft.q, goal, rtol=0.0, atol=1e-3)
    # The largest speed is 0.7 of the joint limit, and a little more at the start.
    assert 0.7 <= fastest < 0.8
    soft.end(0.5)
    assert not soft.is_running
    rests = soft.q
    soft.controller.push([0, 0, 30.0, 0, 0, 0])
    soft.silent(0.2)
    assert soft.q.tolist() == rests.tolist()


@pytest.mark.slow
def test_gains_change_without_jump() -> None:
    soft = Soft()
    soft.controller.push([0, 15.0, 0, 0, 0, 0])
    soft.go(1.0)
    away = float(soft.q[0])
    soft.gain([0.5 * each for each in STIFFNESS], [1.0] * 6)
    hardest = 0.0
    for _ in range(600):
        before = soft.qd
        soft.go()
        hardest = max(hardest, float(np.abs(soft.qd - before).max() * 500))
    assert soft.q[0] == pytest.approx(2.0 * away, rel=0.05)
    assert hardest < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.1, 0.3, 1.0])
def test_oscillation_of_joints_matches_the_damping_ratio(ratio: float) -> None:
    """Release the base 30 mrad from its aim: the damping ratio determines how much each swing shrinks.

    The other joints are stiff, so that the arm is one mass. Damping in addition to the ratio is taken into account.
    """
    soft = Soft(stiffness=[200.0, 3000.0, 3000.0, 1000.0, 1000.0, 1000.0], damping=[ratio, 1, 1, 1, 1, 1])
    aim = soft.q
    soft.controller.world.push_joints([6.0, 0, 0, 0, 0, 0])
    soft.go(3.0)
    away = soft.q[0] - aim[0]
    assert away == pytest.approx(0.03, rel=0.05)
    soft.controller.world.push_joints([0.0] * 6)
    places = []
    for _ in range(1000):
        soft.go()
        places.append(soft.q[0] - aim[0])
    whole = ratio + LOOSE / (2.0 * math.sqrt(200.0 / soft.inertia[0]))
    swing = math.exp(-math.pi * whole / math.sqrt(1.0 - whole**2)) if whole < 1.0 else 0.0
    assert -min(places) / away == pytest.approx(swing, abs=0.03)


# -- limits ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_joint_speed_is_limited_when_contact_ends() -> None:
    soft = Soft(damping=[0.0] * 6, torque=[40.0, 40.0, 40.0, 10.0, 10.0, 10.0], speed=[0.5] * 6)
    way = soft.arm.kinematics.jacobian(soft.q, soft.arm.tcp)[:3, 0]
    wall = soft.controller.world.add(Plane(soft.pose[:3], (-way).tolist()))
    soft.lead(turned(soft.q, 0.5), 0.8)
    assert abs(soft.q[0]) < 0.1
    soft.controller.world.remove(wall)
    fastest = 0.0
    for _ in range(200):
        soft.go()
        fastest = max(fastest, float(np.abs(soft.qd).max()))
    assert 0.4 < fastest < 0.5
    assert not soft.is_stopped


@pytest.mark.slow
def test_joint_is_turned_back_before_end_of_range() -> None:
    high = float(model("UR5e").position_limits[2, 1])
    soft = Soft(q=[0.0, -1.5, high - 0.3, -2.0, -1.57, 0.3], stiffness=[1000, 1000, 0, 100, 100, 100])
    soft.controller.world.push_joints([0, 0, 12.0, 0, 0, 0])
    highest = 0.0
    for _ in range(500):
        soft.go()
        highest = max(highest, float(soft.q[2]))
    assert high - 2 * MARGIN < highest < high
    assert not soft.is_stopped


@pytest.mark.slow
def test_arm_moved_during_pause_stays_in_place() -> None:
    soft = Soft()
    soft.lead(soft.q, 0.5)
    pendant = soft.controller.pendant
    assert pendant.pause()
    soft.go(0.3)
    elsewhere = turned(soft.q, 0.2)
    assert pendant.jog(elsewhere.tolist())
    soft.go(1.0)
    np.testing.assert_allclose(soft.q, elsewhere, rtol=0.0, atol=1e-6)
    assert pendant.play()
    soft.go(0.5)
    np.testing.assert_allclose(soft.q, elsewhere, rtol=0.0, atol=1e-3)
    assert soft.is_running
    soft.lead(turned(elsewhere, 0.1), 1.5)
    assert soft.q[0] == pytest.approx(elsewhere[0] + 0.1, abs=1e-3)


@pytest.mark.slow
def test_motion_to_target_follows_speed_slider() -> None:
    soft = Soft()
    soft.controller.speed_fraction = 0.5
    soft.lead(turned(soft.q, 2.0), 1.0)
    assert soft.qd[0] == pytest.approx(0.35, abs=0.03)
    soft.controller.speed_fraction = 0.0
    soft.go(0.5)
    assert np.abs(soft.qd).max() < 0.02
    soft.controller.speed_fraction = 1.0
    soft.go(3.0)
    assert soft.q[0] == pytest.approx(2.0, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0.2, 0.4])
def test_impedance_continues_without_messages_for_watchdog_time(gap: float) -> None:
    soft = Soft()
    soft.lead(turned(soft.q, 0.2), 0.05)
    soft.silent(gap)
    running = [soft.is_running]
    assert soft.q[0] > 0.05
    soft.go(0.1)
    soft.silent(1.0)
    running.append(soft.is_running)
    assert running == [True, False]
    assert not soft.is_stopped
    assert not soft.qd.any()


# -- contact -------------------------------------------------------------------------------------------------


def pressed(soft: Soft, depth: float, friction: float = 0.0) -> None:
    """Put a table under the tool, move the tool `depth` m into it, and wait until it rests."""
    x, y, z = soft.pose[:3]
    soft.controller.world.add(Plane((x, y, z), friction=friction))
    soft.lead(below(soft, soft.pose, depth), 1.2)


def below(soft: Soft, pose: Sequence[float], depth: float) -> list[float]:
    """Return joint positions for a pose that is `depth` m below the start."""
    place = [*pose[:2], soft.start[2] - depth, *soft.start[3:]]
    q: list[float] = soft.arm.kinematics.inverse(place, soft.q, soft.arm.tcp).tolist()
    return q


@pytest.mark.parametrize("end", ["stopped", pytest.param("silent", marks=pytest.mark.slow)])
def test_end_in_contact_causes_no_jump(end: str) -> None:
    soft = Soft()
    pressed(soft, 0.01)
    force, z = soft.arm.wrench[2], soft.pose[2]
    assert 5.0 < force < 100.0
    if end == "stopped":
        soft.end(0.002)
    forces, places, fastest = [], [], 0.0
    for _ in range(600):
        soft.silent(0.002)
        forces.append(soft.arm.wrench[2])
        places.append(soft.pose[2])
        fastest = max(fastest, float(np.abs(soft.qd).max()))
    assert not soft.is_running
    assert max(forces) < 1.02 * force
    # The tool rises while the table springs back, but no further.
    assert max(places) - z < force / 20_000.0 + 0.0005
    assert fastest < 0.02
    assert not soft.is_stopped


@pytest.mark.slow
def test_protective_stop_in_contact_keeps_arm_in_place() -> None:
    soft = Soft()
    pressed(soft, 0.01)
    force, place = soft.arm.wrench[2], soft.pose[2]
    controller = soft.controller
    controller.faults.protective_stop()
    soft.go(0.5)
    assert soft.is_stopped
    assert not soft.qd.any()
    assert soft.pose[2] == pytest.approx(place, abs=1e-4)
    assert soft.arm.wrench[2] == pytest.approx(force, rel=0.1)
    # The program is paused. When it resumes, the springs are where they were.
    controller.faults.clear()
    soft.go(0.5)
    assert soft.pose[2] == pytest.approx(place, abs=1e-4)


@pytest.mark.slow
def test_zeroing_force_sensor_in_contact_does_not_move_arm() -> None:
    soft = Soft()
    pressed(soft, 0.01)
    place, force = soft.pose[2], soft.arm.wrench[2]
    soft.controller.arm.zero_force()
    soft.go(0.5)
    assert abs(soft.arm.wrench[2]) < 0.05 * force
    assert soft.pose[2] == pytest.approx(place, abs=1e-4)


def slid(intervals: Sequence[tuple[float, bool]]) -> tuple[float, float]:
    """Slide over a table at 0.1 m/s; return the largest and the mean force of the last half.

    Args:
    intervals: Time between two targets in s, and whether no message arrives in that time.
    """
    soft = Soft(q=(0.5, *READY[1:]))
    pressed(soft, 0.01, friction=0.3)
    place, seconds = list(soft.start), sum(seconds for seconds, _ in intervals)
    forces, past = [], 0.0
    for interval, is_busy in intervals:
        place[1] += 0.1 * interval
        soft.lead(below(soft, place, 0.01))
        for cycle in range(round(interval * 500)):
            if cycle:
                (soft.silent if is_busy else soft.go)(0.002)
            past += 0.002
            if past > 0.5 * seconds:
                forces.append(math.hypot(*soft.arm.wrench[:3]))
    assert soft.is_running
    assert not soft.is_stopped
    return max(forces), float(np.mean(forces))


@pytest.mark.slow
def test_irregular_targets_press_as_hard_as_steady_targets() -> None:
    _, steady = slid([(0.004, False)] * 500)
    draw = np.random.default_rng(3)
    rough = [(0.2, True) if draw.random() < 0.2 else (float(draw.uniform(0.08, 0.12)), False) for _ in range(18)]
    assert sum(is_busy for _, is_busy in rough) >= 3
    largest, mean = slid(rough)
    assert largest < 1.2 * steady
    assert mean == pytest.approx(steady, rel=0.1)


# -- cost of a cycle --------------------------------------------------------------------------------------


#: URScript functions that compute with the masses and positions of all links.
DYNAMICS = {
    *("get_mass_matrix", "get_coriolis_and_centrifugal_torques"),
    *("get_jacobian", "get_jacobian_time_derivative", "get_forward_kin"),
}


class Counted:
    """Work of the interpreter in one cycle.

    `steps` counts all calls, `lists` counts operations on whole lists and matrices, and `dynamics` counts functions
    that compute with the arm.
    """

    def __init__(self) -> None:
        self.steps = self.lists = self.dynamics = 0

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        if event != "call":
            return
        file, name = frame.f_code.co_filename, frame.f_code.co_name
        if "simulator/urscript" not in file.replace("\\", "/"):
            return
        self.steps += 1
        if name in ("_slow", "transpose", "inv"):
            self.lists += 1
        elif name in DYNAMICS:
            self.dynamics += 1


def hardest_cycle(step: Any, cycles: int) -> tuple[int, int, int]:
    """Return the largest value of each count over some cycles."""
    most = [0, 0, 0]
    for _ in range(cycles):
        counted = Counted()
        sys.setprofile(counted)
        try:
            step()
        finally:
            sys.setprofile(None)
        most = [max(pair) for pair in zip(most, (counted.steps, counted.lists, counted.dynamics), strict=True)]
    return most[0], most[1], most[2]


@pytest.mark.slow
def test_cycle_costs_at_most_twice_the_vendor_example() -> None:
    example = Controller("UR5e", "5.25", motion=Still(), files={"circle.urp": circle(HORIZONTAL)})
    example.step(10)
    example.dashboard.reply("load circle.urp")
    example.dashboard.reply("play")
    example.step(200)
    limits = hardest_cycle(example.step, 20)
    assert limits[1] > 10
    assert limits[2] > 3
    soft = Soft()

    def step() -> None:
        soft.lead(soft.q)

    cost = hardest_cycle(step, 20)
    assert all(mine <= 2 * theirs for mine, theirs in zip(cost, limits, strict=True)), (cost, limits)


# -- energy ------------------------------------------------------------------------------------------------


class World:
    """A random arm with random gains among random objects, and its energy.

    Args:
    seed: Seed of all random values.
    """

    def __init__(self, seed: int) -> None:
        draw = np.random.default_rng(seed)
        name = str(draw.choice(["UR3e", "UR5e", "UR10e"]))
        scale = {"UR3e": 0.5, "UR5e": 1.0, "UR10e": 1.3}[name]
        q = np.array(READY) + draw.uniform(-0.7, 0.7, 6)
        self.soft = self.soften(draw, name, scale, q.tolist())
        self.aim = self.soft.q
        world, place = self.soft.controller.world, np.array(self.soft.pose[:3])
        world.force_limit = 1e4
        self.things: list[Plane | Spring] = []
        for _ in range(int(draw.integers(0, 3))):
            normal = draw.normal(size=3)
            normal /= np.linalg.norm(normal)
            self.things.append(
                Plane(
                    (place - normal * draw.uniform(0.0, 0.03)).tolist(),
                    normal.tolist(),
                    stiffness=10 ** draw.uniform(2.5, 4.0),
                    damping=draw.uniform(0.0, 100.0),
                    friction=draw.uniform(0.0, 0.6),
                )
            )
        if draw.integers(2):
            self.things.append(
                Spring((place + draw.normal(size=3) * 0.05).tolist(), draw.uniform(50, 1000), draw.uniform(0, 20))
            )
        for thing in self.things:
            world.add(thing)
        self.wrench = np.concatenate((draw.normal(size=3) * 25.0, draw.normal(size=3) * 2.0))
        self.pushed = draw.uniform(0.05, 0.4)

    def soften(self, draw: np.random.Generator, name: str, scale: float, q: Sequence[float]) -> Soft:
        """Return the arm on its springs."""
        return Soft(
            name,
            q=q,
            stiffness=(np.array(STIFFNESS) * scale * draw.uniform(0.0, 1.5, 6)).tolist(),
            damping=draw.uniform(0.0, 1.5, 6).tolist(),
            torque=(np.array(TORQUE) * scale * draw.uniform(0.3, 1.0, 6)).tolist(),
            error=draw.uniform(0.02, 0.3, 6).tolist(),
            friction_compensation=bool(draw.integers(2)),
        )

    def run(self, seconds: float) -> tuple[FloatArray, float]:
        """Return the energy after each cycle and its largest value, in J, without the work of external forces.

        The energy belongs to the arm and its springs. The run ends if the controller stops the arm. Only a push that is
        stronger than the braking torque of a joint may cause a stop. The torques of one cycle make the speed of the
        next cycle, and the arm moves at that speed. Therefore that speed belongs to the middle between two positions.
        """
        soft, arm = self.soft, self.soft.arm
        done, potential, largest, energies, last = 0.0, 0.0, 0.0, [], np.zeros(6)
        soft.controller.push(self.wrench.tolist())
        for cycle in range(round(seconds * 500)):
            if cycle >= self.pushed * 500:
                soft.controller.push([0.0] * 6)
            before, spring, outside = soft.q, soft.static(soft.q, self.aim), np.array(arm.external_torques)
            soft.go()
            if soft.is_stopped:
                assert (np.abs(outside) > soft.springs.braking).any()
                break
            way = soft.q - before
            given = -0.5 * float((spring + soft.static(soft.q, self.aim)) @ way)
            moving = 0.5 * float(soft.qd @ arm.dynamics.mass_matrix(before + 0.5 * way) @ soft.qd)
            there = moving + potential + 0.5 * given
            # The torques of this cycle have changed the speed of the previous cycle to the speed of this cycle.
            done += 0.5 * float(outside @ (last + way))
            energies.append(there - done)
            largest, last = max(largest, there), way
            potential += given
        return np.array(energies), largest


@pytest.mark.slow
@pytest.mark.property
@settings(max_examples=trials(5, 1000))
@given(st.integers(0, 2**31))
def test_energy_never_grows_without_external_work(seed: int) -> None:
    world = World(seed)
    energies, largest = world.run(0.5)
    assert world.soft.is_running
    grown = float((energies - np.minimum.accumulate(energies)).max())
    assert grown <= 0.001 * largest + 1e-5, (seed, grown, largest)
