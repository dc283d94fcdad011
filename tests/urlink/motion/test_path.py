"""Paths of several movements: rejected paths, sent programs, and progress."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import urlink
from linkcore.errors import BadValue, Cancelled, LinkTimeout
from linkcore.handle import Phase
from tests.fakes.rehearsal import HOME, TIMEOUT, Rehearsal
from tests.urlink.motion.bench import Bench
from tests.waiting import interrupted, until
from urlink import Circular, Joint, Linear
from urlink.arm.curves import Arc
from urlink.arm.kinematics import Arm
from urlink.arm.poses import compose
from urlink.arm.vectors import FloatArray
from urlink.motion.moves import path
from urlink.motion.moves.path import PathSection, Plan, Rates, Waypoint, plan
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState

ARM = Arm("UR5e")
#: Joint positions in rad: elbow up, tool down.
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])
POSE = ARM.forward(READY)
TCP = (0.0, 0.02, 0.1, 0.0, 0.3, 0.0)
JOINT_RATES, TOOL_RATES = Rates(1.05, 1.4), Rates(0.25, 1.2)


def state_at(q: FloatArray, arm: Arm = ARM) -> RealtimeState:
    """Return the state of an arm at rest, with a tool."""
    return RealtimeState("5.11", q_target=q, q_actual=q, tool_vector_actual=arm.forward(q, TCP))


def planned(waypoints: list[Waypoint], rates: Rates = TOOL_RATES, arm: Arm | None = ARM) -> Plan:
    return plan(waypoints, JOINT_RATES, rates, arm, state_at(READY))


def shifted(pose: FloatArray, *way: float) -> FloatArray:
    """Return a pose that is shifted in the base frame, in m."""
    there = pose.copy()
    there[: len(way)] += way
    return there


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> list[float]:
    """Return the pose of the tool at `READY`, shifted in the base frame, in m."""
    pose: list[float] = shifted(ARM.forward(READY, TCP), x, y, z).tolist()
    return pose


# -- sent programs -------------------------------------------------------------------------------------


def test_each_waypoint_is_sent_with_given_options() -> None:
    body = planned(
        [
            Linear(moved(z=0.1), blend=0.02),
            Circular(moved(0.02, 0.05, 0.1), moved(0.0, 0.1, 0.1), blend=0.01, speed=0.1, acceleration=0.5),
            Joint(READY, speed=0.5),
        ]
    ).body
    assert [line.split("(")[0] for line in body] == ["textmsg", "movel", "textmsg", "movec", "textmsg", "movej"]
    assert [line.partition("], a=")[2] for line in body[1::2]] == [
        "1.2, v=0.25, r=0.02)",
        "0.5, v=0.1, r=0.01)",
        "1.4, v=0.5)",
    ]


# -- rejected paths ------------------------------------------------------------------------------------

REFUSED: list[tuple[list[Waypoint], str]] = [
    ([], "the path has 0 waypoints"),
    ([Joint(READY)] * 1001, "the path has 1001 waypoints"),
    ([[0.0] * 6], r"waypoint 0 is \[0.0, .*; expected a Joint, Linear or Circular"),  # type: ignore[list-item]
    ([Linear(moved(z=0.1), blend=0.01)], "waypoint 0 is the last"),
    ([Joint(READY), Joint([7.0, *READY[1:]])], r"waypoint 1: q\[0\] \(base\) is 7 rad"),
    ([Joint(READY, speed=4.0)], "waypoint 0: speed is 4 rad/s"),
    ([Linear(moved(x=-3.0))], "waypoint 0: the path to this waypoint is out of reach: a UR5e cannot bring its tool to"),
    # The end can be reached, but the path to it leads through the base.
    ([Linear(compose([0, 0, 0, 0, 0, math.pi], moved()))], "out of reach: .* from the axis of the base"),
    (
        [Linear(moved(z=0.1), blend=0.06), Linear(moved(y=0.1, z=0.1), blend=0.05), Joint(READY)],
        r"waypoint 1: blends of 0.06 m at the beginning and 0.05 m at the end do not fit on a segment of 0.1 m",
    ),
    ([Joint(READY, blend=0.01), Linear(moved(z=0.1))], "do not fit on a segment of 0 m"),
    ([Circular(moved(z=0.05), moved(z=0.1))], "waypoint 0: .* are on a straight line"),
]


@pytest.mark.parametrize(("waypoints", "why"), REFUSED, ids=[why[:40] for _, why in REFUSED])
def test_impossible_path_is_rejected(waypoints: list[Waypoint], why: str) -> None:
    with pytest.raises(BadValue, match=why):
        planned(waypoints)


@pytest.mark.parametrize("bad", [{"blend": -0.1}, {"blend": 20.0}, {"speed": 0.0}, {"acceleration": math.nan}])
def test_invalid_waypoint_options_are_rejected(bad: dict[str, float]) -> None:
    with pytest.raises(BadValue, match=next(iter(bad))):
        Linear(moved(), **bad)


def test_waypoint_options_are_limited_to_ranges() -> None:
    planned([Linear(moved(), blend=2.0, speed=5.0, acceleration=1e-3), *[Joint(READY)] * 999], arm=None)
    for bad in ({"blend": 2.1}, {"speed": 6.3}, {"speed": 9e-4}, {"acceleration": 41.0}, {"acceleration": 9e-4}):
        with pytest.raises(BadValue, match=next(iter(bad))):
            Joint(READY, **bad)


def test_waypoint_with_options_becomes_a_separate_movement() -> None:
    assert not Joint(READY).has_motion_of_its_own
    for own in ({"blend": 0.1}, {"speed": 0.1}, {"acceleration": 0.1}):
        assert Joint(READY, **own).has_motion_of_its_own


def from_there(q: list[float], waypoint: Waypoint, rates: Rates = TOOL_RATES, arm: Arm = ARM) -> PathSection:
    """Return the section for one movement from joint positions, of an arm without a tool."""
    state = RealtimeState("5.11", q_target=q, q_actual=q, tool_vector_actual=arm.forward(q))
    (section,) = plan([waypoint], JOINT_RATES, rates, arm, state).sections
    return section


def turned_in_place(q: list[float], angle: float, x: float = 0.0) -> Linear:
    """Return a waypoint: the tool turned about its own axis, and shifted in the base frame, in m."""
    return Linear(compose(shifted(ARM.forward(q), x, 0.0, 0.0), [0.0, 0.0, 0.0, 0.0, 0.0, angle]))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_joint_leaving_range_on_path_is_rejected(sign: float) -> None:
    q = [*READY[:5], sign * 6.15]
    from_there(q, turned_in_place(q, sign * 0.13))
    with pytest.raises(BadValue, match=rf"wrist 3 would be at {sign * 6.3:.3f} rad at 75% of the path; a UR5e reaches"):
        from_there(q, turned_in_place(q, sign * 0.2))


@pytest.mark.parametrize(("rates", "name"), [(Rates(3.2, 1.0), "speed"), (Rates(1.0, 40.1), "acceleration")])
def test_joint_movement_faster_than_arm_is_rejected(rates: Rates, name: str) -> None:
    state = RealtimeState("5.11", q_target=READY, q_actual=READY, tool_vector_actual=POSE)
    with pytest.raises(BadValue, match=f"^waypoint 0: {name} is .* UR5e$"):
        plan([Joint(READY + 0.1)], rates, TOOL_RATES, ARM, state)


def test_tool_turning_in_place_has_assumed_duration() -> None:
    """The speed of such a turn is unknown; the assumed time (0.25 m per rad) rejects no path."""
    q = READY.tolist()
    for way in (0.0, 9e-4):
        assert from_there(q, turned_in_place(q, 1.0, way)).seconds == pytest.approx(TOOL_RATES.seconds(0.25))
        from_there(q, turned_in_place(q, 1.0, way), Rates(100.0, 100.0))
    # If the tool also moves a little, the assumed time counts: the path is rejected if even this time is too short.
    assert from_there(q, turned_in_place(q, 1.0, 0.0015)).seconds == pytest.approx(TOOL_RATES.seconds(0.25))
    with pytest.raises(BadValue, match="would have to turn at"):
        from_there(q, turned_in_place(q, 1.0, 0.0015), Rates(100.0, 100.0))


def test_path_through_singularity_is_rejected_at_any_speed() -> None:
    q = [*READY[:4], -0.001, READY[5]]
    with pytest.raises(BadValue, match=r"elbow would jump by 0\.5\d rad at 0% of the path: .* singularity"):
        from_there(q, Linear(shifted(ARM.forward(q), 0.0, 0.05, 0.0)), Rates(1e-3, 10.0))


class Watched(Arm):
    """Arm that records the poses of `inverse_path`."""

    def inverse_path(self, poses: ArrayLike, *arguments: Any) -> FloatArray:
        self.poses = np.array(poses)
        return super().inverse_path(poses, *arguments)


def test_blend_makes_path_fast_at_start_or_end() -> None:
    """Close to the axis of the base, the joints turn fastest. Only an arm that stops there is slow enough."""
    pose = shifted(ARM.forward(READY), 0.25)
    across = 0.25 * np.array([pose[1], -pose[0]]) / np.hypot(*pose[:2])
    near, away = ARM.inverse(pose, READY), shifted(pose, *across)
    rates = Rates(4.0, 2.5)
    for blend in (0.0, 0.01):
        out: list[Waypoint] = [Joint(near, blend=blend, speed=1.0), Linear(away)]
        back: list[Waypoint] = [Linear(pose, blend=blend), Joint(READY)]
        for start, waypoints, which, part in (
            (READY, out, "waypoint 1", "0%"),
            (ARM.inverse(away, near), back, "waypoint 0", "98%"),
        ):
            state = RealtimeState("5.11", q_target=start, q_actual=start, tool_vector_actual=ARM.forward(start))
            if not blend:
                plan(waypoints, JOINT_RATES, rates, ARM, state)
                continue
            with pytest.raises(BadValue, match=f"{which}: base would have to turn at .* at {part} of the path"):
                plan(waypoints, JOINT_RATES, rates, ARM, state)


def test_progress_of_joint_movement_without_distance_is_1() -> None:
    (section,) = planned([Joint(READY)]).sections
    assert (section.seconds, section.part(state_at(READY))) == (0.0, 1.0)


def test_path_is_sampled_with_limited_step_and_count() -> None:
    arm = Watched("UR5e")
    q = READY.tolist()
    from_there(q, Linear(shifted(arm.forward(q), 0.0, 0.0, 0.0975)), arm=arm)
    assert np.linalg.norm(np.diff(arm.poses[:, :3], axis=0), axis=1) == pytest.approx([0.0975 / 20] * 20)
    assert arm.poses[[0, -1], 2] == pytest.approx(arm.forward(q)[2] + [0.0, 0.0975])
    from_there(q, turned_in_place(q, 0.49, 0.001), arm=arm)
    assert len(arm.poses) == 11
    from_there(q, Linear(arm.forward(q)), arm=arm)
    assert len(arm.poses) == 2
    with pytest.raises(BadValue, match="out of reach"):
        from_there(q, Linear([9.9, 0, 0, 0, 0, 0]), arm=arm)
    assert len(arm.poses) == 2001


def test_duration_includes_acceleration_from_rest_and_braking() -> None:
    assert Rates(0.5, 2.0).seconds(1.0) == pytest.approx(2.0 + 0.25)
    assert Rates(0.5, 2.0).seconds(0.08) == pytest.approx(2.0 * 0.2)
    assert Rates(2.0, 1.0).seconds(3.0) == pytest.approx(2.0 * math.sqrt(3.0))
    assert Rates(1.0, 2.0).seconds(0.6) == pytest.approx(0.6 + 0.5, rel=1e-9)
    joints = planned([Joint(np.add(READY, [0.1, -0.8, 0.2, 0.0, 0.0, 0.0]))])
    assert joints.sections[0].seconds == pytest.approx(JOINT_RATES.seconds(0.8))


@pytest.mark.parametrize(
    ("is_fast_at_start", "is_fast_at_end", "speeds"),
    [
        (False, False, [2, 3, 3, 2]),
        (True, False, [3, 3, 3, 2]),
        (False, True, [2, 3, 3, 3]),
        (True, True, [3, 3, 3, 3]),
    ],
)
def test_tool_speed_along_path_follows_from_its_acceleration(
    is_fast_at_start: bool, is_fast_at_end: bool, speeds: list[float]
) -> None:
    """At 2 m/s², the speed is 2 m/s after one metre, the middle of the first of four steps, and 3 m/s after 2.25 m."""
    found = path._speed_along(8.0, Rates(3.0, 2.0), 4, is_fast_at_start, is_fast_at_end)
    assert found[:, 0] == pytest.approx(speeds)


def test_line_past_singular_wrist_is_rejected_unless_slow() -> None:
    near = READY.copy()
    near[4] = -0.06
    start, end = ARM.forward(near), ARM.forward([*near[:4], 0.06, *near[5:]])
    state = RealtimeState("5.11", q_target=near, q_actual=near, tool_vector_actual=start)
    # The line passes sideways the place where joints 4 and 6 turn about the same axis, so they have to turn around.
    sideways = [*(start[:3] + 0.2 * (end - start)[:3] / np.linalg.norm((end - start)[:3])), *start[3:]]
    with pytest.raises(BadValue, match=r"waypoint 0: .* would have to turn at .* at \d+% of the path"):
        plan([Linear(sideways)], JOINT_RATES, Rates(1.0, 10.0), ARM, state)
    plan([Linear(sideways)], JOINT_RATES, Rates(0.002, 10.0), ARM, state)


def test_unknown_arm_checks_numbers_only() -> None:
    found = planned([Linear(moved(x=-3.0)), Joint(READY)], arm=None)
    assert [section.part(state_at(READY)) for section in found.sections] == [0.0, 0.0]
    with pytest.raises(BadValue, match="is the last"):
        planned([Linear(moved(), blend=0.1)], arm=None)


# -- accepted paths are executed -----------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("firmware", ["3.15", "5.11"])
def test_accepted_path_respects_limits(seed: int, firmware: str) -> None:
    """The simulated arm rejects motions beyond its joints, and reaches each waypoint as closely as its blend allows."""
    rng = np.random.default_rng(seed)
    rates = Rates(1.0, 5.0)
    version = Firmware.parse(firmware)
    arm = ARM if version.is_e_series else Arm("UR5")
    start = arm.forward(READY)
    waypoints: list[Waypoint] = []
    while len(waypoints) < 5:
        place = [*(start[:3] + rng.uniform(-0.2, 0.2, 3)), *start[3:]]
        kind = rng.integers(3)
        blend = float(rng.choice([0.0, 0.01]))
        if kind == 0:
            further: Waypoint = Joint(READY + rng.uniform(-0.4, 0.4, 6), blend=blend, speed=2.0, acceleration=10.0)
        elif kind == 1:
            further = Linear(place, blend=blend)
        else:
            further = Circular([*(start[:3] + rng.uniform(-0.2, 0.2, 3)), *start[3:]], place, blend=blend)
        state = RealtimeState(version, q_target=READY, q_actual=READY, tool_vector_actual=start)
        try:
            found = plan([*waypoints, further, Joint(READY)], JOINT_RATES, rates, arm, state)
        except BadValue:
            continue
        waypoints.append(further)
    bench = Bench(found.body, version, READY.tolist())
    bench.run(20_000)
    assert bench.has_finished
    assert len(bench.said) == len(waypoints) + 1
    poses = arm.forward(np.array(bench.path))
    for waypoint in waypoints:
        if isinstance(waypoint, Joint):
            away = np.abs(np.array(bench.path) - waypoint.q).max(axis=1)
        else:
            to = waypoint.to if isinstance(waypoint, Circular) else waypoint.pose  # type: ignore[attr-defined]
            away = np.linalg.norm(poses[:, :3] - to[:3], axis=1)
        assert away.min() < (0.05 if waypoint.blend else 1e-4)


# -- progress ------------------------------------------------------------------------------------------


@pytest.mark.simulated_time
def test_progress_follows_segments(robot: Rehearsal) -> None:
    up, down = [*HOME[:5], 0.4], list(HOME)
    motion = robot.motion.path([Joint(up), Joint(down), Joint([*HOME[:5], 0.1])])
    long, short = JOINT_RATES.seconds(0.4), JOINT_RATES.seconds(0.1)
    whole = 2.0 * long + short
    assert motion.segments == 3
    robot.begin()
    robot.show()
    assert (motion.segment, motion.progress) == (0, 0.0)
    for angle, part in ((-0.2, 0.0), (0.2, 0.5), (0.6, 1.0), (0.3, 0.75)):
        robot.q = [*HOME[:5], angle]
        robot.show()
        assert motion.progress == pytest.approx(part * long / whole)
    robot.text("urlink: segment 1")
    until(lambda: motion.segment == 1)
    assert motion.progress == pytest.approx(1.25 * long / whole)
    robot.q = list(HOME)
    robot.show()
    # Messages of other programs are ignored.
    for text in ("urlink: segment 7", "urlink: segment 3", "urlink: segment", "urlink: segment 2 or so"):
        motion._on_text(text)
        assert motion.segment == 1
    robot.text("urlink: segment 2")
    until(lambda: motion.segment == 2)
    assert motion.progress == pytest.approx(2.0 * long / whole)
    robot.q = [*HOME[:5], 0.05]
    robot.show()
    assert motion.progress == pytest.approx((2.0 * long + 0.5 * short) / whole)
    motion._newest = lambda: None
    assert motion.progress == pytest.approx(2.0 * long / whole)
    robot.finish()
    motion.wait(TIMEOUT)
    assert motion.progress == 1.0


@pytest.mark.simulated_time
def test_rejected_path_sends_nothing(robot: Rehearsal) -> None:
    with pytest.raises(BadValue, match="waypoint 0"):
        robot.motion.path([Joint([9.0] * 6)])
    assert robot.sent == []
    assert robot.motion.current is None


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "firmware"), [("ur5", "1.8"), ("ur5", "3.15"), ("ur5e", "5.11"), ("ur5e", "10.12")])
@pytest.mark.simulated_time
def test_path_runs_on_simulated_arm(arm: str, firmware: str) -> None:
    with urlink.connect(f"sim://{arm}?firmware={firmware}", stale_after=20.0, silence=30.0) as robot:
        robot.motion.move_joints(READY, speed=3.0, acceleration=20.0, wait=TIMEOUT)
        here = robot.realtime.wait(TIMEOUT).tool_vector_actual
        up, aside = shifted(here, 0, 0, 0.05), shifted(here, 0, 0.05, 0.05)
        motion = robot.motion.path(
            [Linear(up, blend=0.01), Circular(shifted(here, 0, 0.03, 0.06), aside), Joint(READY)],
            speed=0.3,
            acceleration=2.0,
        )
        seen: list[tuple[int, float]] = []
        while not motion.done:
            seen.append((motion.segment, motion.progress))
            robot.realtime.wait(TIMEOUT)
        motion.wait(0.0)
        assert motion.phase is Phase.DONE
        assert {segment for segment, _ in seen} == {0, 1, 2}
        # With a blend, a movement ends a little before its target.
        assert all(later >= before - 1e-3 for (_, before), (_, later) in pairwise(seen))
        robot.motion.move_linear(up, speed=0.3, wait=TIMEOUT)
        motion_round = robot.motion.move_circular(shifted(here, 0, 0.03, 0.06), aside, speed=0.5)
        until(lambda: motion_round.done, TIMEOUT)
        assert robot.realtime.wait(TIMEOUT).tool_vector_actual[:3] == pytest.approx(aside[:3], abs=1e-3)


@pytest.mark.simulated_time
def test_progress_of_circle_is_measured_along_arc(robot: Rehearsal) -> None:
    start = robot.pose
    via, to = shifted(start, 0, 0.05, 0.05), shifted(start, 0, 0.1, 0)
    motion = robot.motion.move_circular(via, to)
    robot.begin()
    arc = Arc(start.tolist(), via.tolist(), to.tolist())
    for part in (0.0, 0.25, 0.8):
        robot.q = ARM.inverse(arc.pose(part), robot.q).tolist()
        robot.show()
        assert motion.progress == pytest.approx(part, abs=1e-6)
    robot.finish()
    motion.wait(TIMEOUT)


@pytest.mark.simulated_time
def test_circle_rejects_points_on_a_line(robot: Rehearsal) -> None:
    with pytest.raises(BadValue, match="are on a straight line"):
        robot.motion.move_circular(shifted(robot.pose, 0, 0.1, 0), shifted(robot.pose, 0, 0.2, 0))
    assert robot.sent == []


# -- waiting -------------------------------------------------------------------------------------------

WAITING: list[Callable[[Rehearsal, float], object]] = [
    lambda r, wait: r.motion.move_joints(HOME, wait=wait),
    lambda r, wait: r.motion.move_linear(r.pose, wait=wait),
    lambda r, wait: r.motion.move_circular(shifted(r.pose, 0, 0, 0.1), shifted(r.pose, 0, 0.1, 0.1), wait=wait),
    lambda r, wait: r.motion.path([Joint(HOME)], wait=wait),
    lambda r, wait: r.motion.stop(wait=wait),
]


@pytest.mark.parametrize("move", WAITING)
@pytest.mark.simulated_time
def test_wait_option_waits_for_end(robot: Rehearsal, move: Callable[[Rehearsal, float], object]) -> None:
    def play() -> None:
        until(lambda: robot.sent)
        robot.begin()
        robot.finish()

    thread = threading.Thread(target=play)
    thread.start()
    motion = move(robot, TIMEOUT)
    thread.join(TIMEOUT)
    assert isinstance(motion, urlink.Motion)
    assert motion.phase is Phase.DONE
    robot.show()
    with pytest.raises(LinkTimeout, match="and continues"):
        move(robot, 0.01)
    with pytest.raises(BadValue, match="wait="):
        move(robot, -1.0)


@pytest.mark.parametrize(
    "waiting",
    [
        lambda robot: robot.motion.move_joints(HOME, wait=TIMEOUT),
        lambda robot: robot.motion.move_joints(HOME).wait(TIMEOUT),
        lambda robot: robot.motion.stop().wait(TIMEOUT),
    ],
    ids=["wait=True", "wait()", "stop"],
)
@pytest.mark.real_time
def test_interrupted_wait_cancels_motion(robot: Rehearsal, waiting: Callable[[Rehearsal], object]) -> None:
    def begins() -> bool:
        if robot.motion.current is None:
            return False
        robot.begin()
        begun.append(robot.uploaded)
        return True

    begun: list[str] = []
    interrupted(lambda: waiting(robot), begins)
    until(lambda: "stopj" in robot.uploaded and robot.uploaded not in begun)
    assert robot.motion.current is None


@pytest.mark.real_time
def test_interrupted_wait_can_keep_motion(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    interrupted(lambda: motion.wait(TIMEOUT, cancel=False))
    assert robot.motion.current is motion


@pytest.mark.simulated_time
def test_wait_raises_reason_of_end(robot: Rehearsal) -> None:
    def preempt() -> None:
        until(lambda: robot.motion.current is not None)
        robot.begin()
        robot.motion.stop()
        robot.begin()

    thread = threading.Thread(target=preempt)
    thread.start()
    with pytest.raises(Cancelled, match="preempted by stop"):
        robot.motion.move_joints(HOME, wait=TIMEOUT)
    thread.join(TIMEOUT)
