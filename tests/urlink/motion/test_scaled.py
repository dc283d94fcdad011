"""Trajectories on a robot with scaled speed: the arm stays on its path, and each motion ends correctly."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue, LocalError
from linkcore.handle import Motion, Phase
from tests.urlink.motion.bench import PLAYING, Bench
from urlink.arm.models import model
from urlink.arm.vectors import FloatArray
from urlink.errors import ToleranceExceeded
from urlink.motion import TrajectoryFeedback
from urlink.motion.moves.speed_limit import largest_speeds
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.servo.follower import Follower
from urlink.motion.servo.following import Tolerances
from urlink.motion.servo.setpoints import Servoing
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.robot import Robot
from urlink.script.links import ReverseSocket
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.simulated_time

TIMEOUT = 120.0
#: Largest distance of the arm from its path in rad, apart from the lag.
NEAR = 0.0015

WAYS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "streamed at 500 Hz": ("UR5e", "5.11", {}),
    "streamed at 125 Hz": ("UR5", "3.15", {}),
    "registers at 500 Hz": ("UR5e", "5.11", {"link": "rtde"}),
    "registers at 125 Hz": ("UR5", "3.15", {"link": "rtde"}),
    "points at 500 Hz": ("UR5e", "5.11", {"low_bandwidth": True}),
    "points at 125 Hz": ("UR5", "3.4", {"low_bandwidth": True}),
}


_NOISE = np.random.default_rng(2).random(10_000)


def slider(t: float) -> float:
    """Return the slider (0 to 1) at `t` s after the start: a half, a step, 0 for 2 s, steps, noise, a ramp."""
    if t < 0.5:
        return 0.5
    if t < 0.9:
        return 1.0
    if t < 2.9:
        return 0.0
    if t < 3.3:
        return float(_NOISE[int(t / 0.1)])
    if t < 3.9:
        return float(_NOISE[int(t / 0.002)])
    return min(0.2 + 0.5 * (t - 3.9), 1.0)


#: Joint positions in rad: elbow up, tool down.
READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)


def curve(seconds: float = 2.0) -> Trajectory:
    """Return a closed curve of six joints that bends everywhere, from rest to rest, up to 2 rad/s."""
    t = np.linspace(0.0, seconds, 33)
    u = t / seconds
    angle = 2.0 * np.pi * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    rate = 2.0 * np.pi * 30.0 * (u * (1.0 - u)) ** 2 / seconds
    sizes = np.array([0.3, 0.15, 0.1, 0.15, 0.2, 0.3])
    cycles = np.array([1.0, 1.0, 2.0, 2.0, 1.0, 1.0])
    shift = np.array([0.0, 0.5, 0.0, 0.5, 0.25, 0.25]) * np.pi
    phase = np.outer(angle, cycles) + shift
    q = READY + sizes * (np.sin(phase) - np.sin(shift))
    return Trajectory.from_arrays(t, q, sizes * cycles * np.cos(phase) * rate[:, None])


class Cell:
    """A robot in simulated time, and its commanded positions: `path` has one row per cycle, in rad."""

    def __init__(self, arm: str, firmware: str) -> None:
        self.controller = Controller(arm, firmware, motion=Still(READY)).start()
        self.robot: Robot = urlink.connect(self.controller.address)
        self.path: list[list[float]] = []
        self.robot.realtime.subscribe(self._see, inline=True)
        self.robot.realtime.wait()

    def _see(self, state: RealtimeState) -> None:
        self.path.append(state.q_target.tolist())

    def close(self) -> None:
        self.robot.close()
        self.controller.close()

    @contextmanager
    def slider(self, profile: Callable[[float], float]) -> Iterator[None]:
        """Move the slider, from now until the block is left."""
        began, over = time.monotonic(), threading.Event()

        def move() -> None:
            while not over.wait(1.0 / self.controller.firmware.rate):
                self.controller.speed_fraction = profile(time.monotonic() - began)

        self.controller.speed_fraction = profile(0.0)
        thread = threading.Thread(target=move)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            self.controller.speed_fraction = 1.0


@pytest.fixture
def cell() -> Iterator[Callable[[str, str], Cell]]:
    made: list[Cell] = []

    def make(arm: str = "UR5e", firmware: str = "5.11") -> Cell:
        made.append(Cell(arm, firmware))
        return made[-1]

    yield make
    for each in made:
        each.close()


def distance(path: FloatArray, reference: FloatArray) -> float:
    """Return the largest distance of any joint from the reference curve, in rad, for rows in order along it."""
    furthest, at = 0.0, 0
    for row in path:
        low = max(at - 10, 0)
        begin = reference[low : at + 30]
        way = reference[low + 1 : at + 31] - begin[: len(reference) - low - 1]
        begin = begin[: len(way)]
        share = np.clip(((row - begin) * way).sum(1) / np.maximum((way * way).sum(1), 1e-30), 0.0, 1.0)
        errors = np.abs(row - begin - share[:, None] * way).max(1)
        nearest = int(errors.argmin())
        furthest, at = max(furthest, float(errors[nearest])), low + nearest
    return furthest


def moving(path: list[list[float]]) -> FloatArray:
    """Return the rows of a path in which the arm moves."""
    rows = np.array(path)
    moved: FloatArray = rows[1:][np.abs(np.diff(rows, axis=0)).max(1) > 1e-7]
    return moved


def followed(cell: Cell, **options: Any) -> tuple[Motion, list[TrajectoryFeedback], FloatArray]:
    reported: list[TrajectoryFeedback] = []
    cell.path.clear()
    motion = cell.robot.motion.follow(curve(), feedback=reported.append, **options)
    motion.wait(TIMEOUT)
    time.sleep(0.1)
    return motion, reported, moving(cell.path)


@pytest.mark.slow
@pytest.mark.matrix(3)
@pytest.mark.parametrize("way", WAYS)
def test_arm_stays_on_path_whatever_the_slider_does(cell: Callable[[str, str], Cell], way: str) -> None:
    """The path at full speed includes the lag of ``servoj``, so it is the reference for the others."""
    arm, firmware, options = WAYS[way]
    one = cell(arm, firmware)
    _, reported, full = followed(one, **options)
    usual = max(float(np.abs(each.error).max()) for each in reported)
    assert all(each.trajectory_time == pytest.approx(each.time, abs=0.1) for each in reported)
    with one.slider(slider):
        motion, reported, path = followed(one, path_tolerance=2.0 * usual, goal_time=0.5, **options)
    assert motion.phase is Phase.DONE
    assert distance(path, full) < NEAR
    times = np.array([[each.time, each.trajectory_time] for each in reported])
    assert np.diff(times, axis=0).min() >= -0.005  # while a state is later than the last answered state
    assert times[-1, 0] > times[-1, 1] + 2.5


@pytest.mark.slow
def test_goal_time_counts_in_the_time_of_the_trajectory(cell: Callable[[str, str], Cell]) -> None:
    """At a tenth of the speed, the arm has ten times as long to arrive. At 0, no time passes."""
    one = cell("UR5", "3.15")
    # At the end of a trajectory that stops from full speed, the lag is 30 ms at most.
    path = Trajectory.from_arrays([0.0, 0.3], [READY, (*READY[:5], 0.1)])
    one.controller.speed_fraction = 0.1
    one.robot.motion.follow(path, goal_tolerance=0.001, goal_time=0.05).wait(TIMEOUT)
    motion = one.robot.motion.follow(Trajectory.from_arrays([0.0, 0.3], [path.q[1], READY]), goal_time=0.05)
    time.sleep(1.5)
    assert 0.1 < motion.progress < 0.6
    one.controller.speed_fraction = 0.0
    time.sleep(20.0)
    assert not motion.done
    one.controller.speed_fraction = 1.0
    motion.wait(TIMEOUT)
    assert one.robot.realtime.wait().q_actual == pytest.approx(READY, abs=0.001)


@pytest.mark.slow
def test_arm_leaves_path_if_scaling_is_ignored(cell: Callable[[str, str], Cell]) -> None:
    """The cost of `scaling="ignore"`: the arm cuts off the skipped set-points, and catches up at a higher speed."""
    one = cell("UR5e", "5.11")
    _, _, full = followed(one)
    with one.slider(lambda t: 0.25):
        _, reported, path = followed(one, scaling="ignore", goal_time=5.0)
        assert distance(path, full) > 0.05
        assert all(each.trajectory_time == pytest.approx(each.time) for each in reported)
    with one.slider(lambda t: 0.0 if 0.6 < t < 1.2 else 1.0):
        _, _, path = followed(one, scaling="ignore", goal_time=5.0)
    fastest, caught_up = (np.abs(np.diff(each, axis=0)).max() for each in (full, path))
    assert caught_up > 1.5 * fastest
    one.controller.speed_fraction = 0.25
    with pytest.raises(ToleranceExceeded, match="into its path"):
        one.robot.motion.follow(curve(), scaling="ignore", path_tolerance=0.05).wait(TIMEOUT)


def test_low_bandwidth_rejects_scaling_ignore(cell: Callable[[str, str], Cell]) -> None:
    one = cell("UR5e", "5.11")
    with pytest.raises(LocalError, match="in its own time"):
        one.robot.motion.follow(curve(), low_bandwidth=True, scaling="ignore")
    with pytest.raises(BadValue, match="scaling"):
        one.robot.motion.follow(curve(), scaling="wall")  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.property
@settings(max_examples=max(settings().max_examples // 8, 2))
@given(
    st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.004, 0.6)), min_size=1, max_size=20),
    st.sampled_from(["3.4", "5.11"]),
    st.integers(0, 3),
)
def test_arm_stays_on_path_for_any_slider_profile(profile: list[tuple[float, float]], version: str, late: int) -> None:
    """Run the program on an arm without a network; states and set-points are up to 3 cycles late."""
    full = rehearsed([], version, 0)
    assert distance(rehearsed(profile, version, late), full) < NEAR


def rehearsed(profile: list[tuple[float, float]], version: str, late: int) -> FloatArray:
    """Return the path of the arm if the slider has each fraction for some s, and 1 afterwards."""
    firmware = Firmware.parse(version)
    arm = model("UR5e" if firmware.is_e_series else "UR5")
    path, how = curve(), Servoing(firmware, largest_speeds(arm), 0.1, 0.03, 300.0)
    led = Follower(path, Tolerances(None, 0.01, 1.0, 0.05), how)
    bench = Bench(led.body(ReverseSocket("10.0.0.1", 50001, 7)), firmware, READY)
    bench.run(2)
    fractions = [fraction for fraction, seconds in profile for _ in range(round(seconds * firmware.rate))]
    states: list[RealtimeState] = []
    while not led.is_over:
        at, n = bench.motion.setpoint, bench.cycle
        bench.motion.speed_fraction = fractions[n] if n < len(fractions) else 1.0
        q, qd = np.array(at.q), np.array(at.qd)
        shown = PLAYING | {"speed_scaling": bench.motion.scaling}
        seen = SimpleNamespace(
            time=50.0 + n * bench.period, q_target=q, q_actual=q, qd_target=qd, qd_actual=qd, **shown
        )
        states.append(cast(RealtimeState, seen))
        if n >= late + 2:
            bench.deliver(led.step(b"", states[-1 - late], 1000.0 + n * bench.period))
        bench.run()
        assert bench.cycle < 30 * firmware.rate
    assert bench.said == []
    return moving(bench.path)
