"""The uploaded program of a tool impedance, on a simulated controller that the test steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.urlink.motion.test_impedance import READY, TORQUE, Soft, World, hardest_cycle, turned
from tests.urlink.simulator.test_impedance import HORIZONTAL
from tests.urlink.simulator.test_impedance import program as circle
from urlink.arm import poses
from urlink.arm.models import model
from urlink.arm.vectors import FloatArray
from urlink.script.springs import MARGIN, POSTURE, ToolSprings
from urlink.simulator import Controller, Plane, Still

STIFFNESS = (500.0, 500.0, 500.0, 30.0, 30.0, 30.0)


class SoftTool(Soft):
    """Arm with its tool on springs.

    Args:
        in_tool: Whether the axes are the axes of the tool.
        options: Options of `Springs` and of `ToolSprings`, whose speed is `tool_speed`.
    """

    def __init__(self, name: str = "UR5e", *, in_tool: bool = False, **options: Any) -> None:
        tool = ToolSprings(
            in_tool=in_tool,
            speed=options.pop("tool_speed", (0.25,) * 3 + (0.8,) * 3),
            force=options.pop("force", (50.0,) * 3 + (5.0,) * 3),
            posture=options.pop("posture", (0.5,) * 6),
        )
        values: dict[str, Any] = {
            "stiffness": STIFFNESS,
            "error": (0.1,) * 3 + (0.5,) * 3,
            "speed": (1.5,) * 6,
            "tool": tool,
        }
        super().__init__(name, **(values | options))
        self.tool = tool

    def observed(self, text: str) -> str:
        last = "  return made * (share * hold)"
        assert text.count(last) == 1
        seen = "  write_output_float_register(0, share)\n  write_output_float_register(1, saved)\n"
        return text.replace(last, seen + last)

    @property
    def share(self) -> float:
        """Share of the springs that acted in the last cycle."""
        return self.controller.registers.outputs.floats[0]

    @property
    def saved(self) -> float:
        """Saved energy in J, which permits the share of the springs to grow."""
        return self.controller.registers.outputs.floats[1]

    @property
    def jacobian(self) -> FloatArray:
        return self.arm.kinematics.jacobian(self.q, self.arm.tcp)

    def bend(self, q: Sequence[float]) -> None:
        """Set another posture."""
        self._say(q, [-1.0, 0, 0, 0, 0, 0], 0.002, POSTURE)

    def off(self, pose: Sequence[float]) -> FloatArray:
        """Return the difference from the tool pose to `pose` in the base frame, shape (6,), in m and rad."""
        here = self.pose
        turn = poses.compose([0.0, 0.0, 0.0, *pose[3:]], poses.invert([0.0, 0.0, 0.0, *here[3:]]))
        return np.array([*np.subtract(pose[:3], here[:3]), *turn[3:]])

    def stored(self, aim: Sequence[float], posture: FloatArray) -> float:
        """Return the energy of the springs in J, if nothing clamps the joints."""
        away, stiffness = self.off(aim), np.array(self.springs.stiffness)
        if self.tool.in_tool:
            away = np.kron(np.eye(2), poses.rotvec_to_matrix(aim[3:]).T) @ away
        angle = float(np.linalg.norm(away[3:]))
        away[3:] *= 2.0 * math.sin(0.5 * angle) / angle if angle > 1e-9 else 1.0
        pull = np.minimum(stiffness * np.abs(away), np.minimum(stiffness * self.springs.error, self.tool.force))
        energy = pull * np.abs(away)
        energy[stiffness > 0] -= 0.5 * pull[stiffness > 0] ** 2 / stiffness[stiffness > 0]
        bent = posture - self.q
        return float(energy.sum() + 0.5 * np.array(self.tool.posture) @ bent**2)


@pytest.mark.slow
@pytest.mark.matrix(3)
@pytest.mark.parametrize(("axis", "in_tool"), [(axis, bool(axis % 2)) for axis in range(6)])
def test_displacement_of_tool_is_force_divided_by_stiffness(axis: int, in_tool: bool) -> None:
    stiffness = [500.0, 400.0, 700.0, 30.0, 25.0, 40.0]
    soft = SoftTool(in_tool=in_tool, stiffness=stiffness)
    start = soft.pose
    axes = poses.rotvec_to_matrix(start[3:]) if in_tool else np.eye(3)
    wrench = np.zeros(6)
    wrench[axis] = 8.0 if axis < 3 else 1.0
    soft.controller.push([*(axes @ wrench[:3]), *(axes @ wrench[3:])])
    soft.go(2.0)
    moved = -soft.off(start)
    moved = np.concatenate((axes.T @ moved[:3], axes.T @ moved[3:]))
    expected = wrench / stiffness
    assert np.abs(moved - expected)[:3].max() < 0.05 * (expected[axis] if axis < 3 else 0.01)
    assert np.abs(moved - expected)[3:].max() < 0.05 * (expected[axis] if axis > 2 else 0.1)


def place(pose: Sequence[float], *way: float) -> list[float]:
    """Return a pose that is moved and turned in its own axes."""
    moved: list[float] = poses.compose(pose, way).tolist()
    return moved


@pytest.mark.slow
@pytest.mark.parametrize("in_tool", [False, True])
def test_tool_reaches_target_and_rests_after_end(in_tool: bool) -> None:
    soft = SoftTool(in_tool=in_tool)
    goal = place(soft.pose, 0.1, -0.05, 0.05, 0.0, 0.3, 1.5)
    soft.lead(goal)
    # The library sends the joint positions of each target, too.
    soft.bend(soft.arm.kinematics.inverse(goal, soft.q, soft.arm.tcp).tolist())
    fastest = np.zeros(6)
    for _ in range(1600):
        soft.go()
        fastest = np.maximum(fastest, np.abs(soft.jacobian @ soft.qd))
    assert np.abs(soft.off(goal)).max() < 5e-3
    # The slowest axis, which turns by 1.5 rad, reaches 0.7 of its speed.
    assert 0.4 < fastest[3:].max() < 0.7
    soft.end(0.5)
    assert not soft.is_running
    rests = soft.q
    soft.controller.push([0, 0, 30.0, 0, 0, 0])
    soft.silent(0.2)
    assert soft.q.tolist() == rests.tolist()


@pytest.mark.slow
def test_orientation_takes_the_short_path() -> None:
    """The rotation vectors of both may be far apart, as for tools that look down."""
    soft = SoftTool(q=(0.0, -1.5, 2.0, -2.07, -1.57, 0.0), posture=(0.0,) * 6)
    start = soft.pose
    assert np.linalg.norm(start[3:]) > 3.0
    goal = place(start, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0)
    back = place(start, 0.0, 0.0, 0.0, -0.3, 0.0, 0.0)
    assert np.linalg.norm(np.subtract(goal[3:], back[3:])) > 5.0
    for each in (goal, back):
        soft.lead(each)
        turned_by = 0.0
        for _ in range(1000):
            soft.go()
            turned_by = max(turned_by, float(np.linalg.norm(soft.off(start)[3:])))
        assert np.abs(soft.off(each)).max() < 0.015
        assert turned_by < 0.35


@pytest.mark.slow
def test_gains_change_without_jump() -> None:
    soft = SoftTool()
    start = soft.pose
    soft.controller.push([0, 10.0, 0, 0, 0, 0])
    soft.go(1.0)
    away = -soft.off(start)[1]
    soft.gain([0.5 * each for each in STIFFNESS], [1.0] * 6)
    hardest = 0.0
    for _ in range(700):
        before = soft.qd
        soft.go()
        hardest = max(hardest, float(np.abs(soft.qd - before).max() * 500))
    assert -soft.off(start)[1] == pytest.approx(2.0 * away, rel=0.07)
    assert hardest < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.1, 0.4])
def test_oscillation_of_tool_matches_the_damping_ratio(ratio: float) -> None:
    """Release the tool sideways on a soft spring. The other axes are stiff; they and the joints damp a little, too."""
    soft = SoftTool(
        stiffness=[1500.0, 200.0, 1500.0, 100.0, 100.0, 100.0],
        damping=[1.0, ratio, 1.0, 1.0, 1.0, 1.0],
        posture=(0.0,) * 6,
        force=(100.0,) * 3 + (20.0,) * 3,
    )
    start = soft.pose
    soft.controller.push([0, 6.0, 0, 0, 0, 0])
    soft.go(3.0)
    away = -soft.off(start)[1]
    assert away == pytest.approx(0.03, rel=0.05)
    soft.controller.push([0.0] * 6)
    places = []
    for _ in range(1000):
        soft.go()
        places.append(-soft.off(start)[1])
    swing = -math.log(-min(places) / away)
    found = swing / math.hypot(swing, math.pi)
    assert ratio - 0.02 < found < ratio + 0.2


# -- the posture, singular poses ---------------------------------------------------------------------------


@pytest.mark.slow
def test_posture_moves_axes_without_stiffness() -> None:
    """An axis without stiffness turns to the posture, and the tool stays in place."""
    soft = SoftTool(stiffness=[500.0, 500.0, 500.0, 0.0, 0.0, 0.0], posture=(2.0,) * 6)
    start = soft.pose
    posture = soft.q.copy()
    posture[5] += 0.8
    soft.bend(posture.tolist())
    soft.go(4.0)
    assert soft.q[5] == pytest.approx(posture[5], abs=0.02)
    assert np.abs(soft.off(start)[:3]).max() < 1e-3


@pytest.mark.slow
def test_stretched_arm_keeps_elbow_on_same_side() -> None:
    """An unreachable target, which `Impedance.send` rejects, stretches the arm a little beyond straight."""
    soft = SoftTool(q=(0.0, -0.3, 0.35, -1.57, -1.57, 0.0), posture=(2.0,) * 6, stiffness=(500.0,) * 3 + (0.0,) * 3)
    start, elbow, fastest = soft.pose, [], 0.0
    outwards = np.array(start[:3]) * (1.0 + 0.3 / np.linalg.norm(start[:3]))
    for goal, seconds in (([*outwards, *start[3:]], 2.4), (start, 4.0)):
        soft.lead(goal)
        for _ in range(round(seconds * 500)):
            soft.go()
            elbow.append(float(soft.q[2]))
            fastest = max(fastest, float(np.abs(soft.qd).max()))
    assert -0.1 < min(elbow) < 0.02
    assert elbow[-1] > 0.15
    assert np.abs(soft.off(start)[:3]).max() < 0.01
    assert fastest < 1.5
    assert not soft.is_stopped


# -- limits -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_tool_speed_is_limited_when_contact_ends() -> None:
    soft = SoftTool(damping=[0.0] * 6, tool_speed=(0.15,) * 3 + (0.8,) * 3)
    wall = soft.controller.world.add(Plane(soft.pose[:3], (0.0, -1.0, 0.0)))
    goal = soft.pose
    goal[1] += 0.2
    soft.lead(goal, 1.5)
    assert abs(soft.off(soft.start)[1]) < 0.01
    soft.controller.world.remove(wall)
    fastest = 0.0
    for _ in range(400):
        soft.go()
        fastest = max(fastest, float(np.abs(soft.jacobian @ soft.qd)[:3].max()))
    assert 0.09 < fastest < 0.15
    assert not soft.is_stopped


@pytest.mark.slow
def test_force_is_limited_for_any_distance_to_target() -> None:
    soft = SoftTool(force=(20.0,) * 3 + (5.0,) * 3, torque=(60.0, 60.0, 60.0, 14.0, 14.0, 14.0))
    x, y, z = soft.pose[:3]
    soft.controller.world.add(Plane((x, y, z)))
    goal = soft.pose
    goal[2] -= 0.3
    soft.lead(goal, 3.0)
    assert soft.arm.wrench[2] == pytest.approx(20.0, abs=1.5)


@pytest.mark.slow
def test_joint_is_turned_back_before_end_of_range() -> None:
    high = float(model("UR5e").position_limits[2, 1])
    soft = SoftTool(q=[0.0, -1.5, high - 0.3, -2.0, -1.57, 0.3], stiffness=[0.0] * 6, posture=(0.0,) * 6)
    soft.controller.world.push_joints([0, 0, 12.0, 0, 0, 0])
    highest = 0.0
    for _ in range(500):
        soft.go()
        highest = max(highest, float(soft.q[2]))
    assert high - 2 * MARGIN < highest < high
    assert not soft.is_stopped


@pytest.mark.slow
def test_arm_moved_during_pause_stays_in_place() -> None:
    soft = SoftTool()
    soft.lead(soft.pose, 0.3)
    pendant = soft.controller.pendant
    assert pendant.pause()
    soft.go(0.3)
    elsewhere = turned(soft.q, 0.2)
    assert pendant.jog(elsewhere.tolist())
    soft.go(1.5)
    assert pendant.play()
    soft.go(1.0)
    np.testing.assert_allclose(soft.q, elsewhere, rtol=0.0, atol=2e-3)
    assert soft.is_running


@pytest.mark.slow
@pytest.mark.parametrize("end", ["stopped", "silent"])
def test_end_in_contact_causes_no_jump(end: str) -> None:
    soft = SoftTool(stiffness=(2000.0,) * 3 + (50.0,) * 3)
    x, y, z = soft.pose[:3]
    soft.controller.world.add(Plane((x, y, z)))
    goal = soft.pose
    goal[2] -= 0.01
    soft.lead(goal, 2.0)
    force, height = soft.arm.wrench[2], soft.pose[2]
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
    assert max(places) - height < force / 20_000.0 + 0.0005
    assert fastest < 0.02
    assert not soft.is_stopped


def slid(intervals: Sequence[tuple[float, bool]]) -> tuple[float, float]:
    """Slide over a table at 0.1 m/s; return the largest and the mean force of the last half.

    Args:
    intervals: Time between two targets in s, and whether no message arrives in that time.
    """
    soft = SoftTool(q=(0.5, *READY[1:]), stiffness=(1500.0,) * 3 + (50.0,) * 3)
    x, y, z = soft.pose[:3]
    soft.controller.world.add(Plane((x, y, z), friction=0.3))
    goal, seconds = soft.pose, sum(seconds for seconds, _ in intervals)
    goal[2] -= 0.01
    soft.lead(goal, 2.0)
    forces, past = [], 0.0
    for interval, is_busy in intervals:
        goal[1] += 0.1 * interval
        soft.lead(goal)
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
    _, steady = slid([(0.004, False)] * 450)
    draw = np.random.default_rng(3)
    rough = [(0.2, True) if draw.random() < 0.2 else (float(draw.uniform(0.08, 0.12)), False) for _ in range(16)]
    assert sum(is_busy for _, is_busy in rough) >= 3
    largest, mean = slid(rough)
    assert largest < 1.2 * steady
    assert mean == pytest.approx(steady, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("in_tool", [False, True])
def test_cycle_costs_at_most_twice_the_vendor_example(in_tool: bool) -> None:
    example = Controller("UR5e", "5.25", motion=Still(), files={"circle.urp": circle(HORIZONTAL)})
    example.step(10)
    example.dashboard.reply("load circle.urp")
    example.dashboard.reply("play")
    example.step(200)
    steps, lists, dynamics = hardest_cycle(example.step, 20)
    soft = SoftTool(in_tool=in_tool)
    goal = soft.pose
    cost = hardest_cycle(lambda: soft.lead(goal), 20)
    assert cost[1] <= 2 * lists
    assert cost[2] <= dynamics
    # Only its loops over axes and joints take more calls.
    assert cost[0] <= 4 * steps


# -- energy --------------------------------------------------------------------------------------------------


class ToolWorld(World):
    """A random arm with its tool on random springs in random axes, among the objects of `World`."""

    def soften(self, draw: np.random.Generator, name: str, scale: float, q: Sequence[float]) -> SoftTool:
        stiffness = np.array(STIFFNESS) * scale * draw.uniform(0.0, 3.0, 6)
        stiffness[draw.random(6) < 0.1] = 0.0
        return SoftTool(
            name,
            q=q,
            in_tool=bool(draw.integers(2)),
            stiffness=stiffness.tolist(),
            damping=draw.uniform(0.0, 1.5, 6).tolist(),
            torque=(np.array(TORQUE) * scale * draw.uniform(0.3, 1.0, 6)).tolist(),
            error=(draw.uniform(0.2, 1.0, 6) * (0.1, 0.1, 0.1, 0.6, 0.6, 0.6)).tolist(),
            force=(draw.uniform(0.1, 1.0, 6) * (80.0, 80.0, 80.0, 8.0, 8.0, 8.0)).tolist(),
            posture=draw.uniform(0.0, 3.0, 6).tolist(),
            friction_compensation=bool(draw.integers(2)),
        )

    def run(self, seconds: float) -> tuple[FloatArray, float]:
        soft = self.soft
        assert isinstance(soft, SoftTool)
        arm, done, largest, energies, last = soft.arm, 0.0, 0.0, [], np.zeros(6)
        aim, posture = soft.start, self.aim
        stored = soft.stored(aim, posture)
        soft.controller.push(self.wrench.tolist())
        for cycle in range(round(seconds * 500)):
            if cycle >= self.pushed * 500:
                soft.controller.push([0.0] * 6)
            before, outside = soft.q, np.array(arm.external_torques)
            soft.go()
            if soft.is_stopped:
                assert (np.abs(outside) > 0.5 * np.array(soft.springs.braking)).any()
                break
            way, then = soft.q - before, soft.stored(aim, posture)
            moving = 0.5 * float(soft.qd @ arm.dynamics.mass_matrix(before + 0.5 * way) @ soft.qd)
            there = moving + 0.5 * soft.share * (stored + then) + soft.saved
            done += 0.5 * float(outside @ (last + way))
            energies.append(there - done)
            largest, last, stored = max(largest, there), way, then
        return np.array(energies), largest


@pytest.mark.slow
@pytest.mark.property
@settings(max_examples=max(settings.default.max_examples // 2, 5) if settings.default else 5)
@given(st.integers(0, 2**31))
def test_energy_never_grows_without_external_work(seed: int) -> None:
    world = ToolWorld(seed)
    energies, largest = world.run(0.5)
    assert world.soft.is_running
    grown = float((energies - np.minimum.accumulate(energies)).max())
    assert grown <= 0.001 * largest + 1e-5, (seed, grown, largest)
