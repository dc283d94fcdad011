"""Ranges of arguments of motions: limits are accepted, values beyond them are rejected before sending."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from linkcore.errors import BadValue, LocalError
from tests.fakes.rehearsal import HOME, Rehearsal, freedrive, turned
from tests.urlink.motion.test_servo import opened
from urlink import Linear
from urlink.arm.models import model
from urlink.motion.moves.trajectory import Trajectory

pytestmark = pytest.mark.simulated_time

UR5E = model("UR5e")
PATH = Trajectory.from_arrays([0.0, 1.0], [HOME, turned(0.1)])
POSES = [[0.1, 0.2, 0.3, 0, 0, 0], [0.3, 0.2, 0.4, 0, 0, 0]]
SIX = [[1] * 6, [0] * 6, [1] * 6]

Call = Callable[[Any, Any], object]
#: (name in the error, call, minimum, maximum)
RANGES: list[tuple[str, Call, float, float]] = [
    ("speed", lambda m, x: m.move_joints(HOME, x), 1e-3, math.pi),
    ("acceleration", lambda m, x: m.move_joints(HOME, acceleration=x), 1e-3, 40),
    ("time", lambda m, x: m.move_joints(HOME, time=x), 1e-3, 3600),
    ("speed", lambda m, x: m.move_linear(POSES[0], x), 1e-3, 5),
    ("acceleration", lambda m, x: m.move_linear(POSES[0], acceleration=x), 1e-3, 40),
    ("time", lambda m, x: m.move_linear(POSES[0], time=x), 1e-3, 3600),
    ("speed", lambda m, x: m.move_circular(*POSES, x), 1e-3, 5),
    ("acceleration", lambda m, x: m.move_circular(*POSES, acceleration=x), 1e-3, 40),
    ("acceleration", lambda m, x: m.speed_joints([0] * 6, x), 1e-3, 40),
    ("duration", lambda m, x: m.speed_joints([0] * 6, duration=x), 1e-3, 3600),
    ("acceleration", lambda m, x: m.speed_linear([0] * 6, x), 1e-3, 40),
    ("duration", lambda m, x: m.speed_linear([0] * 6, duration=x), 1e-3, 3600),
    ("acceleration", lambda m, x: m.stop(x), 1e-3, 40),
    ("path_tolerance", lambda m, x: m.follow(PATH, path_tolerance=x), 1e-6, 100),
    ("goal_tolerance", lambda m, x: m.follow(PATH, goal_tolerance=x), 1e-6, 100),
    ("goal_time", lambda m, x: m.follow(PATH, goal_time=x), 0, 3600),
    ("start_tolerance", lambda m, x: m.follow(PATH, start_tolerance=x), 1e-6, 1),
    ("delay", lambda m, x: m.follow(PATH, delay=x), 0, 1),
    ("watchdog", lambda m, x: m.follow(PATH, watchdog=x), 0.01, 10),
    ("lookahead_time", lambda m, x: m.follow(PATH, lookahead_time=x), 0.03, 0.2),
    ("gain", lambda m, x: m.follow(PATH, gain=x), 100, 2000),
    ("rate", lambda m, x: m.servo(x), 0.1, 500),
    ("rate", lambda m, x: m.servo(x, target_filter="jerk_limited"), 0.1, 10_000),
    ("watchdog", lambda m, x: m.jog(watchdog=x), 0.01, 10),
    ("timeout", lambda m, x: m.jog(timeout=x), 0.01, 60),
    ("buffer", lambda m, x: m.stream(x), 0.05, 10),
    ("watchdog", lambda m, x: m.stream(watchdog=x), 0.1, 2),
    ("acceleration", lambda m, x: m.jog(acceleration=x), 1e-3, 40),
    ("speed", lambda m, x: m.until_contact([0, 0, 1], x), 1e-3, 1),
    ("distance", lambda m, x: m.until_contact([0, 0, 1], distance=x), 1e-3, 10),
    ("force", lambda m, x: m.until_contact([0, 0, 1], force=x), 1, 500),
    (r"limits\[rx\]", lambda m, x: m.force_mode("base", *SIX[:2], [1, 1, 1, x, 1, 1]), 1e-6, 10),
    (r"wrench\[ry\]", lambda m, x: m.force_mode("base", SIX[0], [0, 0, 0, 0, x, 0], SIX[2]), -1000, 1000),
    ("damping", lambda m, x: m.force_mode("base", *SIX, damping=x), 0, 1),
    ("gain", lambda m, x: m.force_mode("base", *SIX, gain=x), 0, 2),
    ("watchdog", lambda m, x: m.force_mode("base", *SIX, watchdog=x), 0.05, 10),
    ("watchdog", lambda m, x: freedrive(m, watchdog=x), 0.05, 10),
    ("watchdog", lambda m, x: m.torque(watchdog=x), 0.01, 1),
    ("watchdog", lambda m, x: m.impedance(watchdog=x), 0.05, 10),
    (r"stiffness\[0\] \(base\)", lambda m, x: m.impedance(stiffness=x), 0, 10_000),
    (r"damping\[5\] \(wrist 3\)", lambda m, x: m.impedance(damping=[1, 1, 1, 1, 1, x]), 0, 3),
    (r"torque\[4\] \(wrist 2\)", lambda m, x: m.impedance(torque=[1, 1, 1, 1, x, 1]), 0, UR5E.max_torque[4] / 2),
    (r"speed\[1\] \(shoulder\)", lambda m, x: m.impedance(speed=[1, x, 1, 1, 1, 1]), 0.01, UR5E.max_speed[1]),
    (r"error\[2\] \(elbow\)", lambda m, x: m.impedance(error=[1, 1, x, 1, 1, 1]), 0, 3),
    (r"stiffness\[0\] \(x\)", lambda m, x: m.impedance("base", stiffness=[x, 1, 1, 1, 1, 1]), 0, 5000),
    (r"stiffness\[5\] \(rz\)", lambda m, x: m.impedance("tool", stiffness=[1, 1, 1, 1, 1, x]), 0, 200),
    (r"force\[2\] \(z\)", lambda m, x: m.impedance("base", force=[1, 1, x, 1, 1, 1]), 0, 200),
    (r"error\[1\] \(y\)", lambda m, x: m.impedance("base", error=[0.1, x, 0.1, 0.1, 0.1, 0.1]), 0, 0.5),
    (r"speed\[0\] \(x\)", lambda m, x: m.impedance("base", speed=[x, 0.1, 0.1, 0.1, 0.1, 0.1]), 0.01, 5),
    (
        r"posture_stiffness\[3\] \(wrist 1\)",
        lambda m, x: m.impedance("tool", posture_stiffness=[1, 1, 1, x, 1, 1]),
        0,
        200,
    ),
    (r"limits\[3\] \(wrist 1\)", lambda m, x: m.torque(limits=[1, 1, 1, x, 1, 1]), 0, UR5E.max_torque[3]),
]
#: for an unknown arm, whose joints have no known limits
UNKNOWN: list[tuple[str, Call, float, float]] = [
    ("speed", lambda m, x: m.move_joints(HOME, x), 1e-3, math.tau),
    ("speed", lambda m, x: m.path([Linear(POSES[0])], x), 1e-3, 5),
    ("acceleration", lambda m, x: m.path([Linear(POSES[0])], acceleration=x), 1e-3, 40),
    ("joint_speed", lambda m, x: m.path([Linear(POSES[0])], joint_speed=x), 1e-3, math.tau),
    ("joint_acceleration", lambda m, x: m.path([Linear(POSES[0])], joint_acceleration=x), 1e-3, 40),
    (r"limits\[0\] \(base\)", lambda m, x: m.torque(limits=[x, 1, 1, 1, 1, 1]), 0, 1000),
    ("delay", lambda m, x: m.servo(delay=x), 0, 1),
]


@pytest.mark.parametrize(("arm", "ranges"), [("UR5e", RANGES), ("UR9000", UNKNOWN)], ids=["UR5e", "unknown"])
def test_minimum_and_maximum_are_accepted(
    rehearsal: Callable[..., Rehearsal], arm: str, ranges: list[tuple[str, Call, float, float]]
) -> None:
    robot = rehearsal("5.25", arm)
    for name, call, least, most in ranges:
        for taken in (least, most):
            call(robot.motion, taken)
        sent = len(robot.sent)
        for refused in (np.nextafter(least, -math.inf), np.nextafter(most, math.inf)):
            with pytest.raises(BadValue, match=rf"^{name} is "):
                call(robot.motion, refused)
        assert len(robot.sent) == sent


@pytest.mark.parametrize("joint", range(6))
def test_each_joint_has_a_separate_speed_limit(rehearsal: Callable[..., Rehearsal], joint: int) -> None:
    robot = rehearsal("5.25", "UR10e")
    limits = model("UR10e").max_speed
    for limit in (limits[joint], -limits[joint]):
        qd = [0.0] * 6
        qd[joint] = limit
        robot.motion.speed_joints(qd).cancel()
        qd[joint] = np.nextafter(limit, 2.0 * limit)
        with pytest.raises(BadValue, match=rf"qd\[{joint}\]"):
            robot.motion.speed_joints(qd)


def test_arguments_of_measure_delay_are_limited(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[tuple[int, float, float]] = []
    monkeypatch.setattr("urlink.motion.servo.servo.measure", lambda states, send, *how: measured.append(how))
    ranges: list[tuple[str, Call, float, float]] = [
        ("joint", lambda s, x: s.measure_delay(x), 0, 5),
        ("amplitude", lambda s, x: s.measure_delay(amplitude=x), -0.5, 0.5),
        ("duration", lambda s, x: s.measure_delay(duration=x), 0.1, 60),
    ]
    with opened(robot) as servo:
        for name, call, least, most in ranges:
            call(servo, least)
            call(servo, most)
            by_one = name == "joint"
            beyond = (least - 1, most + 1) if by_one else (np.nextafter(least, -9), np.nextafter(most, 99))
            for refused in (*beyond, np.nextafter(most, 99), None):
                with pytest.raises(BadValue, match=f"^{name} is "):
                    call(servo, refused)
        servo.measure_delay()
    assert measured == [
        *((0, 0.05, 1.0), (5, 0.05, 1.0)),
        *((5, -0.5, 1.0), (5, 0.5, 1.0)),
        *((5, 0.05, 0.1), (5, 0.05, 60.0)),
        (5, 0.05, 1.0),
    ]


# -- required firmware -----------------------------------------------------------------------------------

TRY: dict[str, Callable[[Any], object]] = {
    "registers": lambda m: m.servo(link="rtde"),
    "until_contact": lambda m: m.until_contact([0, 0, 1]),
    "low_bandwidth": lambda m: m.follow(PATH, low_bandwidth=True),
    "force_mode": lambda m: m.force_mode("base", *SIX),
    "damping": lambda m: m.force_mode("base", *SIX, damping=0.1),
    "gain": lambda m: m.force_mode("base", *SIX, gain=1),
    "freedrive": freedrive,
    "axes": lambda m: freedrive(m, [1, 0, 0, 0, 0, 0]),
    "torque": lambda m: m.torque(),
    "impedance": lambda m: m.impedance(),
    "impedance of the tool": lambda m: m.impedance("base"),
}


@pytest.mark.parametrize(
    ("what", "last_without", "first_with"),
    [
        ("registers", "3.8", "3.9"),
        ("registers", "5.2", "5.3"),
        ("until_contact", "3.2", "3.3"),
        ("low_bandwidth", "1.8", "3.0"),
        ("force_mode", "1.8", "3.0"),
        ("damping", "3.4", "3.5"),
        ("gain", "3.15", "5.0"),
        ("freedrive", "1.8", "3.0"),
        ("axes", "5.9", "5.10"),
        ("torque", "5.22", "5.23"),
        ("torque", "10.10", "10.11"),
        ("impedance", "5.22", "5.23"),
        ("impedance", "10.10", "10.11"),
        ("impedance of the tool", "5.9", "5.10"),
    ],
)
def test_call_is_rejected_before_first_firmware_with_its_feature(
    rehearsal: Callable[..., Rehearsal], what: str, last_without: str, first_with: str
) -> None:
    before, since = (
        rehearsal(each, "UR5" if each[0] in "13" and "10" not in each else "UR5e")
        for each in (last_without, first_with)
    )
    with pytest.raises(LocalError, match=last_without):
        TRY[what](before.motion)
    assert before.sent == []
    TRY[what](since.motion)


def test_contact_has_a_default_force_for_each_arm(rehearsal: Callable[..., Rehearsal]) -> None:
    """The controller detects contacts since 5.4; on older firmware, a contact is a force of 20 N."""
    for firmware, expected in (("5.3", "if against >= 20.0:"), ("5.4", "tool_contact(direction=[0.0, 0.6, -0.8, ")):
        robot = rehearsal(firmware)
        robot.motion.until_contact([0, 3, -4])
        assert expected in robot.uploaded
        assert "speedl([0.0, 0.012, -0.016, 0.0, 0.0, 0.0], 0.5, 0.002)" in robot.uploaded
        assert ("movej(q" in robot.uploaded) is True
        robot.motion.until_contact([0, 3, -4], force=7, retract=False)
        assert "if against >= 7.0:" in robot.uploaded
        assert "movej(q" not in robot.uploaded
