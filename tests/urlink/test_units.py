"""Tests of numbers in the wrong unit: every call refuses them before anything is sent.

The error names the value, its unit and the limit. It also asks for the unit that was perhaps meant, if the value is
within the limit in that unit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

import urlink
from linkcore.arguments import other_unit
from linkcore.errors import BadValue
from urlink import Circular, Joint, Linear, Trajectory
from urlink.arm.kinematics import Arm, Unreachable
from urlink.simulator import Controller, Still
from urlink_compat import rtde_control, urx

ARM = Arm("UR5e")
HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]
POSE: list[float] = ARM.forward(HOME).tolist()
X, Y, Z, *TURN = POSE
#: `POSE` in millimetres and in degrees, and a pose slightly out of reach of this arm.
MM = [1e3 * X, 1e3 * Y, 1e3 * Z, *TURN]
DEGREES = [X, Y, Z, *np.degrees(TURN).tolist()]
FAR = [1.5, 0.0, 0.4, 0.0, 3.14, 0.0]
Q_DEGREES = [0, -90, 90, -90, -90, 0]
NEAR = [X, Y, Z + 0.02, *TURN]


class Tried(NamedTuple):
    """Robot for the calls, and the interfaces of two other libraries to the same controller."""

    robot: urlink.Robot
    control: rtde_control.RTDEControlInterface
    urx: urx.Robot


@pytest.fixture(scope="module")
def tried() -> Iterator[Tried]:
    with (
        Controller("UR5e", "5.11", motion=Still()) as controller,
        urlink.connect(controller.address) as robot,
        rtde_control.RTDEControlInterface(controller.address) as control,
        urx.Robot(controller.address) as other,
    ):
        robot.realtime.wait(10)
        yield Tried(robot, control, other)


IN_MM, IN_MM_S, IN_MM_S2 = r"\(in mm\?\)$", r"\(in mm/s\?\)$", r"\(in mm/s²\?\)$"
IN_DEGREES, IN_DEGREES_S, IN_DEGREES_S2 = r"\(in degrees\?\)$", r"\(in degrees/s\?\)$", r"\(in degrees/s²\?\)$"
AXIS = [0, 0, 1, 0, 0, 0]


def jogged(robot: urlink.Robot, frame: Any, speeds: list[float]) -> None:
    with robot.motion.jog(frame) as jog:
        jog.move(speeds)


def scheduled(robot: urlink.Robot, target: Any) -> None:
    with robot.motion.servo(watchdog=5.0) as servo:
        servo.schedule(target, robot.realtime.wait(5).time + 3.0)


def sent(robot: urlink.Robot, q: Any) -> None:
    with robot.motion.servo(watchdog=5.0) as servo:
        servo.send(q)


def pressed(robot: urlink.Robot, frame: Any = "base", limits: Any = (0.1,) * 6) -> None:
    robot.motion.force_mode(frame, AXIS, [0, 0, -5, 0, 0, 0], limits)


CASES: dict[str, tuple[Callable[[Tried], object], str]] = {
    # poses in mm, in degrees, and out of reach
    "move_linear mm": (lambda t: t.robot.motion.move_linear(MM), r"position in pose .* [0-9.]+ m; .* 10 m " + IN_MM),
    "move_linear degrees": (lambda t: t.robot.motion.move_linear(DEGREES), "6.284 rad " + IN_DEGREES),
    "move_linear far": (lambda t: t.robot.motion.move_linear(FAR), r"1.537 m from the shoulder.* at most 0.927 m$"),
    "move_linear inside": (lambda t: t.robot.motion.move_linear([0.0, 0.0, 0.3, 0, 3, 0]), "axis of the base"),
    "via mm": (lambda t: t.robot.motion.move_circular(MM, NEAR), "position in via .*" + IN_MM),
    "to mm": (lambda t: t.robot.motion.move_circular(NEAR, MM), "position in to .*" + IN_MM),
    "to degrees": (lambda t: t.robot.motion.move_circular(NEAR, DEGREES), "rotation vector in to .*" + IN_DEGREES),
    "to far": (lambda t: t.robot.motion.move_circular(NEAR, FAR), "cannot bring its tool"),
    "Linear mm": (lambda t: Linear(MM), IN_MM),
    "Linear degrees": (lambda t: Linear(DEGREES), IN_DEGREES),
    "Linear blend mm": (lambda t: Linear(POSE, blend=20), "blend is 20 m; expected .* 2 m " + IN_MM),
    "Circular via mm": (lambda t: Circular(MM, NEAR), IN_MM),
    "Circular degrees": (lambda t: Circular(POSE, DEGREES), IN_DEGREES),
    "path far": (lambda t: t.robot.motion.path([Linear(FAR)]), "waypoint 0: the path to this waypoint is out of reach"),
    "schedule degrees": (lambda t: scheduled(t.robot, Q_DEGREES), r"q\[1\] \(shoulder\) is -90 rad.*" + IN_DEGREES),
    "schedule far": (lambda t: scheduled(t.robot, Linear(FAR)), "cannot bring its tool"),
    "force frame mm": (lambda t: pressed(t.robot, MM), "position in frame .*" + IN_MM),
    "force frame degrees": (lambda t: pressed(t.robot, DEGREES), "rotation vector in frame .*" + IN_DEGREES),
    "freedrive frame mm": (lambda t: t.robot.freedrive(AXIS, frame=MM), "position in frame .*" + IN_MM),
    "teach frame mm": (lambda t: t.robot.teach(axes=AXIS, frame=MM), "position in frame .*" + IN_MM),
    "set_tcp mm": (lambda t: t.robot.set_tcp([0, 0, 120, 0, 0, 0]), "position in tcp .* 120 m; .* 5 m " + IN_MM),
    "set_tcp degrees": (lambda t: t.robot.set_tcp([0, 0, 0.1, 0, 0, 45]), "rotation vector in tcp .*" + IN_DEGREES),
    "cog mm": (lambda t: t.robot.set_payload(1, [0, 0, 40]), "z of the payload's cog is 40 m; .* 1 m " + IN_MM),
    "payload g": (lambda t: t.robot.set_payload(90.0), "mass is 90 kg; a UR5e or UR7e carries at most 7.5 kg$"),
    "payload 1500 g": (lambda t: t.robot.set_payload(1500.0), r"1500 kg; .* 100 kg \(in g\?\)$"),
    # joints
    "move_joints degrees": (lambda t: t.robot.motion.move_joints(Q_DEGREES), "the limits of a UR5e " + IN_DEGREES),
    "Joint degrees": (lambda t: t.robot.motion.path([Joint(Q_DEGREES)]), r"waypoint 0: .*" + IN_DEGREES),
    "servo degrees": (lambda t: sent(t.robot, Q_DEGREES), IN_DEGREES),
    "follow degrees": (
        lambda t: t.robot.motion.follow(Trajectory.from_arrays([0, 60], [Q_DEGREES, Q_DEGREES])),
        r"is -90.0000 rad; .* rad " + IN_DEGREES,
    ),
    "speed_joints degrees": (lambda t: t.robot.motion.speed_joints([30, 0, 0, 0, 0, 0]), "30 rad/s.*" + IN_DEGREES_S),
    "move_joints speed": (lambda t: t.robot.motion.move_joints(HOME, speed=60), "60 rad/s; .*" + IN_DEGREES_S),
    "move_joints acc": (lambda t: t.robot.motion.move_joints(HOME, acceleration=80), "40 rad/s², .*" + IN_DEGREES_S2),
    "joint_speed": (lambda t: t.robot.motion.path([Joint(HOME)], joint_speed=60), "joint_speed .*" + IN_DEGREES_S),
    "joint_acc": (lambda t: t.robot.motion.path([Joint(HOME)], joint_acceleration=80), IN_DEGREES_S2),
    "Joint speed": (lambda t: Joint(HOME, speed=60), IN_DEGREES_S),
    "stop": (lambda t: t.robot.motion.stop(80), "acceleration is 80 rad/s²; .*" + IN_DEGREES_S2),
    "servo filter": (lambda t: t.robot.motion.servo(target_filter="jerk_limited", speed=60), IN_DEGREES_S),
    "jog joints": (lambda t: jogged(t.robot, "joints", [30, 0, 0, 0, 0, 0]), IN_DEGREES_S),
    # speeds and accelerations of the tool
    "move_linear mm/s": (lambda t: t.robot.motion.move_linear(POSE, speed=50), "speed is 50 m/s; .* 5 m/s " + IN_MM_S),
    "move_linear mm/s²": (lambda t: t.robot.motion.move_linear(POSE, acceleration=500), "500 m/s²; .*" + IN_MM_S2),
    "move_circular mm/s": (lambda t: t.robot.motion.move_circular(NEAR, NEAR, speed=100), IN_MM_S),
    "path mm/s": (lambda t: t.robot.motion.path([Linear(POSE)], 250), IN_MM_S),
    "Linear mm/s": (lambda t: Linear(POSE, speed=250), IN_MM_S),
    "Linear mm/s²": (lambda t: Linear(POSE, acceleration=1200), IN_MM_S2),
    "speed_linear mm/s": (lambda t: t.robot.motion.speed_linear([0, 0, -50, 0, 0, 0]), "50 m/s; .* 5 m/s " + IN_MM_S),
    "speed_linear aslant": (lambda t: t.robot.motion.speed_linear([3, 3, 3, 0, 0, 0]), "5.19615 m/s; "),
    "speed_linear 5000 m/s": (lambda t: t.robot.motion.speed_linear([0, 5000, 0, 0, 0, 0]), "5000 m/s; .*" + IN_MM_S),
    "speed_linear degrees/s": (
        lambda t: t.robot.motion.speed_linear([0, 0, 0, 30, 0, 0]),
        "the turn .*" + IN_DEGREES_S,
    ),
    "jog mm/s": (lambda t: jogged(t.robot, "tool", [0, 0, 30, 0, 0, 0]), IN_MM_S),
    "jog degrees/s": (lambda t: jogged(t.robot, "base", [0, 0, 0, 0, 20, 0]), IN_DEGREES_S),
    "jog acceleration": (lambda t: t.robot.motion.jog("base", acceleration=500), IN_MM_S2),
    "until_contact mm/s": (lambda t: t.robot.motion.until_contact([0, 0, -1], speed=20), "20 m/s; .* 1 m/s " + IN_MM_S),
    "until_contact mm": (lambda t: t.robot.motion.until_contact([0, 0, -1], distance=300), "300 m; .*" + IN_MM),
    "until_contact mm/s²": (lambda t: t.robot.motion.until_contact([0, 0, -1], acceleration=500), IN_MM_S2),
    "force limits mm/s": (lambda t: pressed(t.robot, limits=[0.1, 0.1, 50, 1, 1, 1]), r"limits\[z\] .*" + IN_MM_S),
    "force limits mm": (lambda t: pressed(t.robot, limits=[50, 0.1, 0.1, 1, 1, 1]), r"limits\[x\] .*" + IN_MM),
    "force limits degrees": (
        lambda t: pressed(t.robot, limits=[0.1] * 3 + [30, 1, 1]),
        r"limits\[rx\] .*" + IN_DEGREES,
    ),
    "wrench": (
        lambda t: t.robot.motion.force_mode("base", AXIS, [0, 0, -10000, 0, 0, 0], [0.1] * 6),
        r"wrench\[z\] is -10000 N; expected a number from -1000 to 1000 N$",
    ),
    "time ms": (lambda t: t.robot.motion.move_linear(POSE, time=5000), r"5000 s; .*\(in ms\?\)$"),
    # kinematics
    "inverse mm": (lambda t: ARM.inverse(MM, HOME), r"it reaches at most [0-9.]+ m " + IN_MM),
    "inverse degrees": (lambda t: ARM.inverse(DEGREES, HOME), "6.284 rad " + IN_DEGREES),
    "inverse rows degrees": (lambda t: ARM.inverse([POSE, DEGREES], HOME), "row 1 of the poses .*" + IN_DEGREES),
    "inverse_path mm": (lambda t: ARM.inverse_path([POSE, MM], HOME), "row 1: .*" + IN_MM),
    "branches degrees": (lambda t: ARM.branches(DEGREES), IN_DEGREES),
    "solutions degrees": (lambda t: ARM.solutions(DEGREES), IN_DEGREES),
    "from_poses mm": (lambda t: Trajectory.from_poses([0, 1], [MM, MM], ARM, HOME), IN_MM),
    "from_poses degrees": (lambda t: Trajectory.from_poses([0, 1], [DEGREES] * 2, ARM, HOME), IN_DEGREES),
    # calls of other libraries
    "moveL mm": (lambda t: t.control.moveL(MM), IN_MM),
    "moveL mm/s": (lambda t: t.control.moveL(POSE, 250.0), IN_MM_S),
    "moveL path mm": (lambda t: t.control.moveL([[*MM, 0.1, 0.1, 0.0]]), IN_MM),
    "moveL degrees": (lambda t: t.control.moveL(DEGREES), IN_DEGREES),
    "moveJ degrees": (lambda t: t.control.moveJ(Q_DEGREES), IN_DEGREES),
    "speedL mm/s": (lambda t: t.control.speedL([0, 0, 50, 0, 0, 0]), IN_MM_S),
    "servoL mm": (lambda t: t.control.servoL(MM, 0, 0, 0.002, 0.1, 300), IN_MM),
    "moveUntilContact mm/s": (lambda t: t.control.moveUntilContact([0, 0, -20, 0, 0, 0]), IN_MM_S),
    "setTcp mm": (lambda t: t.control.setTcp([0, 0, 120, 0, 0, 0]), IN_MM),
    "setPayload mm": (lambda t: t.control.setPayload(1.0, [0, 0, 40]), IN_MM),
    "getInverseKinematics mm": (lambda t: t.control.getInverseKinematics(MM), IN_MM),
    "urx movel mm": (lambda t: t.urx.movel(MM), IN_MM),
    "urx movel mm/s": (lambda t: t.urx.movel(POSE, 0.1, 100), IN_MM_S),
    "urx movej degrees": (lambda t: t.urx.movej(Q_DEGREES), IN_DEGREES),
    "urx speedl mm/s": (lambda t: t.urx.speedl([0, 0, 50, 0, 0, 0], 0.5, 1), IN_MM_S),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.real_time
def test_calls_refuse_values_in_the_wrong_unit(tried: Tried, case: str) -> None:
    call, message = CASES[case]
    where = tried.robot.realtime.wait(5).q_actual
    with pytest.raises(BadValue, match=message):
        call(tried)
    assert tried.robot.motion.current is None
    assert tried.robot.realtime.wait(5).q_actual == pytest.approx(where, abs=1e-3)


@pytest.mark.real_time
def test_calls_accept_values_within_the_limits(tried: Tried) -> None:
    """The values are within 2 mm of the edge of the reach, at the largest speed, and a turn rounded to four digits."""
    tried.robot.motion.move_linear(NEAR, speed=5.0, acceleration=40.0).cancel()
    assert Linear([*POSE[:3], 0.0, 0.0, 6.2832]).pose[5] == 6.2832
    stretched = ARM.forward([0.0, 0.0, 0.002, 0.0, 1.0, 0.0])
    assert ARM.inverse(stretched, HOME).shape == (6,)


def test_unreachable_is_a_bad_value() -> None:
    assert issubclass(Unreachable, BadValue)


def test_inverse_returns_nan_for_unreachable_rows() -> None:
    """With many poses, each unreachable pose gives a row of NaN, at any distance."""
    assert np.isnan(ARM.inverse([FAR, MM], HOME)).all()


@pytest.mark.parametrize(
    ("value", "unit", "limits", "question"),
    [
        (50.0, "m/s", (0.0, 5.0), " (in mm/s?)"),
        (-50.0, "m/s", (-5.0, 5.0), " (in mm/s?)"),
        (5001.0, "m/s", (0.0, 5.0), ""),
        (90.0, "rad", (-3.2, 3.2), " (in degrees?)"),
        (90.0, "Nm", (-3.2, 3.2), ""),
        (90.0, "", (-3.2, 3.2), ""),
    ],
)
def test_other_unit_returns_a_question_about_the_likely_unit(
    value: float, unit: str, limits: tuple[float, float], question: str
) -> None:
    assert other_unit(value, unit, *limits) == question
