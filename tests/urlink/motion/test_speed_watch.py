"""Watch of an arm at a speed: its quick checks decide like the slow ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from urlink import LimitExceeded, SessionLimits
from urlink.arm.kinematics import Arm
from urlink.arm.vectors import FloatArray
from urlink.motion.limited import LimitedArm
from urlink.motion.servo.following import AHEAD
from urlink.motion.servo.speed_watch import SpeedWatch
from urlink.session.session_limits import MARGIN

#: Joint positions near all drawn states, in rad: elbow up, tool down.
READY = np.array([0.0, -1.6, 1.9, -1.9, -1.57, 0.0])
BOX = ((-0.75, -0.40, 0.10), (-0.25, 0.25, 0.60))
#: Limits of the drawn arms: together, and one by one.
LIMITS = (
    SessionLimits(tool_speed=0.25, joint_speed=1.0, box=BOX),
    SessionLimits(tool_speed=0.25),
    SessionLimits(joint_speed=0.3),
    SessionLimits(box=BOX),
)


def drawn(rng: np.random.Generator) -> tuple[LimitedArm, Any]:
    """Draw an arm with limits, and a state in which it moves."""
    arm = Arm(str(rng.choice(["UR3", "UR5", "UR10e"])))
    identity = SimpleNamespace(
        arm=arm.model, kinematics=arm, firmware=SimpleNamespace(rate=float(rng.choice([125.0, 500.0])))
    )
    who: Any = SimpleNamespace(identity=identity)
    moving = float(np.exp(rng.uniform(np.log(1e-3), np.log(1.0))))
    state: Any = SimpleNamespace(
        q_target=READY + rng.uniform(-0.5, 0.5, 6), qd_target=rng.normal(size=6) * moving * rng.integers(0, 2)
    )
    tcp = np.concatenate([rng.uniform(-0.1, 0.2, 3), rng.uniform(-1.0, 1.0, 3)]) * float(rng.integers(0, 2))
    return LimitedArm(LIMITS[rng.integers(len(LIMITS))], who, state, lambda arm, state: tcp), state


def refusal(watch: SpeedWatch, state: Any, speeds: FloatArray) -> str | None:
    """Return the limit that a state exceeds; None if the watch accepts it."""
    try:
        watch.check(state, speeds)
    except LimitExceeded as error:
        return error.limit
    return None


def sampled(limited: LimitedArm, speeds: FloatArray, acceleration: float) -> tuple[FloatArray, float, float]:
    """Return the places of the TCP in m in the samples of the slow check, and its largest speeds in m/s and rad/s."""
    rows: list[tuple[FloatArray, FloatArray]] = []

    class Recording(LimitedArm):
        def check(self, q: FloatArray, qd: FloatArray | None = None, margin: float = 0.0) -> None:
            assert qd is not None
            rows.append((q, qd))

    recording = Recording.__new__(Recording)
    vars(recording).update(vars(limited))
    recording.check_joint_speed(speeds, acceleration, AHEAD * limited.cycle)
    q, qd = rows[0]
    return limited.arm.forward(q, limited.tcp)[:, :3], float(limited.tool_speeds(q, qd).max()), float(np.abs(qd).max())


def test_speed_watch_accepts_joints_only_if_samples_do(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(45)
    slow: list[FloatArray] = []
    quick = 0
    for number in range(400):
        limited, state = drawn(rng)
        acceleration = float(rng.uniform(0.3, 5.0))
        if number % 4 == 0:
            # The joints move, but at first they do not move the TCP, so that it is fastest while it brakes.
            still = np.linalg.svd(limited.arm.jacobian(state.q_target, limited.tcp)[:3])[2][3:]
            limited.qd = state.qd_target = rng.normal(size=3) @ still
        # Half of the arms continue at the same speed.
        speeds = state.qd_target + rng.normal(size=6) * float(rng.choice([0.0, 0.3]))
        places, fastest, turning = sampled(limited, speeds, acceleration)
        low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN
        with monkeypatch.context() as patch:
            patch.setattr(LimitedArm, "check_joint_speed", lambda arm, qd, *how: slow.append(qd))
            watch = SpeedWatch(limited, acceleration, is_tool=False)
            # Limits that the motion just exceeds: an upper bound must not accept it.
            for narrow in exceeded(low, high, fastest, turning):
                slow.clear()
                limited.limits = narrow
                watch.check(state, speeds)
                assert slow, f"state {number}: an upper bound accepted a motion that exceeds {narrow}"
            slow.clear()
            room = 0.05 + 0.2 * (high - low).max()
            limited.limits = SessionLimits(tool_speed=1.3 * fastest + 0.05, box=(tuple(low - room), tuple(high + room)))
            watch.check(state, speeds)
            quick += not slow
    assert quick > 250


def exceeded(low: FloatArray, high: FloatArray, fastest: float, turning: float) -> list[SessionLimits]:
    """Return limits that a motion just exceeds: between two corners in m, with these speeds in m/s and rad/s."""
    found = []
    if fastest > 0.01:
        found.append(SessionLimits(tool_speed=fastest * (1.0 - 1e-3)))
    if turning > 0.01:
        found.append(SessionLimits(joint_speed=turning * (1.0 - 1e-3)))
    for axis in range(3):
        for corner, change in ((0, 1e-6), (1, -1e-6)):
            corners = np.array([low - 1.0, high + 1.0])
            corners[corner, axis] = (low, high)[corner][axis] + change
            found.append(SessionLimits(box=(tuple(corners[0]), tuple(corners[1]))))
    return found


def stops_tool(limited: LimitedArm, xd: FloatArray, acceleration: float) -> str | None:
    """Return the limit that a tool at a speed exceeds until it is at rest: the slow check, with arrays."""
    seconds = AHEAD * limited.cycle
    q, arm, limits = limited.q, limited.arm, limited.limits
    before = arm.velocity(q, limited.qd, limited.tcp)
    reached, ways = np.empty(6), []
    for part in (slice(0, 3), slice(3, 6)):
        change = xd[part] - before[part]
        ways.append(float(np.linalg.norm(change)))
        reached[part] = before[part] + change * min(1.0, acceleration * seconds / max(ways[-1], 1e-12))
    braking = np.array([np.linalg.norm(reached[part]) for part in (slice(0, 3), slice(3, 6))]) / acceleration
    rise = min(ways[0] / acceleration, seconds)
    place = arm.forward(q, limited.tcp)[:3]
    meet = place + 0.5 * rise * before[:3]
    end = meet + (seconds - 0.5 * rise) * reached[:3]
    points = [place, meet, meet + 0.5 * rise * reached[:3], end, end + 0.5 * braking[0] * reached[:3]]
    qd = np.linalg.inv(arm.jacobian(q, limited.tcp)) @ reached
    rows = [qd]
    for time, share in ((seconds, 1.0), (seconds + 0.375 * braking.max(), 0.5)):
        rows.append(np.linalg.inv(arm.jacobian(q + time * qd, limited.tcp)) @ (share * reached))
    try:
        limits.check_places(np.array(points))
        limits.check_joint_speeds(np.array(rows))
        limits.check_tool_speeds(np.array([braking[0] * acceleration]))
    except LimitExceeded as error:
        return error.limit
    return None


def test_speed_watch_refuses_tool_speeds_like_slow_check() -> None:
    rng = np.random.default_rng(46)
    found = []
    for _ in range(800):
        limited, state = drawn(rng)
        acceleration = float(rng.uniform(0.3, 3.0))
        xd = np.concatenate([rng.normal(size=3) * 0.12, rng.normal(size=3) * 0.5])
        found.append(refusal(SpeedWatch(limited, acceleration, is_tool=True), state, xd))
        assert found[-1] == stops_tool(limited, xd, acceleration)
    for limit in (None, "box", "joint_speed", "tool_speed"):
        assert found.count(limit) > 15, limit


def test_watch_stops_a_yielding_arm_below_the_limit_of_a_joint() -> None:
    """In force mode, the joints become faster close to a singularity, until the arm brakes."""
    arm = Arm("UR5")
    identity = SimpleNamespace(arm=arm.model, kinematics=arm, firmware=SimpleNamespace(rate=125.0))
    who: Any = SimpleNamespace(identity=identity)
    state: Any = SimpleNamespace(q_target=READY, qd_target=np.zeros(6))
    limited = LimitedArm(SessionLimits(joint_speed=1.0), who, state, lambda arm, state: np.zeros(6))
    slow, fast = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.97]), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.99])
    limited.watch(READY, fast)
    limited.watch(READY, slow, yields=True)
    with pytest.raises(LimitExceeded, match=r"wrist 3 \(joint 5\) would turn at 1\.01 rad/s"):
        limited.watch(READY, fast, yields=True)
