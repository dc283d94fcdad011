"""Tests of typical mistakes: each raises an error with advice before anything is sent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

import urlink
from linkcore.errors import LinkError, LocalError
from linkcore.names import StrictAttributes
from urlink.errors.foreign_names import _OWN, own_name
from urlink.protocol.field_names import QUANTITIES
from urlink.protocol.primary.robot_state import SUB_PACKAGES, snake_case
from urlink.protocol.rtde.variables import OUTPUTS
from urlink.simulator import Controller, Still

Q = [0, -1.57, 1.57, -1.57, -1.57, 0]
POSE = [-0.49, -0.13, 0.49, 0.0, 3.14, 0.0]


@pytest.fixture(scope="module")
def robot() -> Iterator[Any]:
    """Provide a robot as `Any`, because type checkers refuse most of these calls."""
    with (
        Controller("UR5e", "5.11", motion=Still()) as controller,
        urlink.connect(controller.address) as robot,
    ):
        robot.realtime.wait(10)
        robot.primary.wait(10)
        yield robot


Try = Callable[[Any], object]
#: (Mistake, type of the error, part of its message)
MISTAKES: list[tuple[Try, type[Exception], str]] = [
    # names of URScript, ur_rtde and urx
    (lambda r: r.motion.movej(Q), AttributeError, r"equivalent here: robot.motion.move_joints\(q\)"),
    (lambda r: r.motion.movel(POSE), AttributeError, "move_linear"),
    (lambda r: r.motion.movec(POSE, POSE), AttributeError, "move_circular"),
    (lambda r: r.motion.movep(POSE), AttributeError, r"robot.motion.path\("),
    (lambda r: r.movej(Q), AttributeError, "move_joints"),
    (lambda r: r.move_j(Q), AttributeError, "move_joints"),
    (lambda r: r.moveJ(Q), AttributeError, "move_joints"),
    (lambda r: r.moveL(POSE), AttributeError, "move_linear"),
    (lambda r: r.servoJ(Q, 0, 0, 0.002, 0.1, 300), AttributeError, "robot.motion.servo"),
    (lambda r: r.speedL(Q), AttributeError, "speed_linear"),
    (lambda r: r.stopj(2), AttributeError, "robot.motion.stop"),
    (lambda r: r.stop(), AttributeError, "robot.motion.stop"),
    (lambda r: r.forceMode(), AttributeError, "force_mode"),
    (lambda r: r.getActualQ(), AttributeError, r"robot.realtime.wait\(\).q_actual"),
    (lambda r: r.getActualTCPPose(), AttributeError, "tool_vector_actual"),
    (lambda r: r.get_actual_tcp_pose(), AttributeError, "tool_vector_actual"),
    (lambda r: r.getl(), AttributeError, "tool_vector_actual"),
    (lambda r: r.get_inverse_kin(POSE), AttributeError, "kinematics.inverse"),
    (lambda r: r.setStandardDigitalOut(0, True), AttributeError, "robot.io.set_digital_out"),
    (lambda r: r.set_digital_out(0, True), AttributeError, "robot.io.set_digital_out"),
    (lambda r: r.io.getDigitalIn(0), AttributeError, "robot.io.digital_in"),
    (lambda r: r.zeroFtSensor(), AttributeError, "zero_force_sensor"),
    (lambda r: r.send_program("movej"), AttributeError, "robot.script.run"),
    (lambda r: r.power_on(), AttributeError, "robot.dashboard.power_on"),
    (lambda r: r.disconnect(), AttributeError, "robot.close"),
    (lambda r: r.safety.unlock_protective_stop(), AttributeError, "robot.dashboard.unlock"),
    (lambda r: r.motion.home(), AttributeError, "move_joints"),
    # misspelt names
    (lambda r: r.moton, AttributeError, "did you mean 'motion'"),
    (lambda r: r.motion.move_joint(Q), AttributeError, "did you mean 'move_joints'"),
    (lambda r: r.safety.enabel(), AttributeError, "did you mean 'enable'"),
    (lambda r: r.io.set_digital_output(0, True), AttributeError, "did you mean 'set_digital_out'"),
    (lambda r: urlink.conect("sim://"), AttributeError, "did you mean 'connect'"),  # type: ignore[attr-defined]
    (lambda r: r.rtde.outputs("actual_Q").wait(5), urlink.NoSuchVariable, "did you mean actual_q"),
    # values
    (lambda r: r.motion.move_joints("home"), LocalError, "q is 'home'; expected numbers"),
    (lambda r: r.motion.move_joints(["0"] * 6), LocalError, "q: expected numbers"),
    (lambda r: r.motion.move_joints(0.5), LocalError, "expected six numbers"),
    (lambda r: r.motion.move_joints(Q[:5]), LocalError, "expected six numbers"),
    (lambda r: r.motion.move_joints([*Q, 0]), LocalError, "expected six numbers"),
    (lambda r: r.motion.move_joints([*Q[:5], None]), LocalError, "q: expected numbers"),
    (lambda r: r.motion.move_joints([*Q[:5], float("nan")]), LocalError, "is not finite"),
    (lambda r: r.motion.move_joints({0: 1.0}), LocalError, "q: expected numbers"),
    (lambda r: r.motion.move_joints(Q, speed=0), LocalError, "speed is 0 rad/s"),
    (lambda r: r.motion.move_joints(Q, speed="fast"), LocalError, "speed is 'fast'; expected a number"),
    (lambda r: r.motion.move_joints(Q, acceleration=-1), LocalError, "acceleration is -1 rad/s²"),
    (lambda r: r.motion.move_joints(Q, wait="yes"), LocalError, "wait='yes'; expected"),
    (lambda r: r.motion.move_linear(POSE[:3]), LocalError, "expected six numbers"),
    (lambda r: r.motion.path(Q), LocalError, "expected a Joint, Linear or Circular"),
    (lambda r: r.motion.path([]), LocalError, "expected 1 to"),
    (lambda r: r.motion.follow([Q, Q]), LocalError, "is not a Trajectory"),
    (lambda r: r.motion.jog("world"), LocalError, "frame='world'; expected"),
    (lambda r: r.motion.until_contact("down"), LocalError, "direction is 'down'; expected numbers"),
    (lambda r: r.motion.force_mode("flange", Q, Q, Q), LocalError, "expected 'base', 'tool', or a pose"),
    (lambda r: r.io.set_digital_out(8, True), LocalError, "expected a whole number from 0 to 7"),
    (lambda r: r.io.set_digital_out(0, "on"), LocalError, "expected True or False"),
    (lambda r: r.io.set_analog_out(0, 10), LocalError, "0 to 1"),
    (lambda r: r.io.set_tool_voltage(5), LocalError, "expected 0, 12 or 24"),
    (lambda r: r.set_speed_slider(50), LocalError, "0 to 1"),
    (lambda r: r.set_payload("1 kg"), LocalError, "payload mass is '1 kg'; expected a number"),
    (lambda r: r.set_tcp([0, 0, 0.1]), LocalError, "expected six numbers"),
    (lambda r: r.script.run(""), LocalError, "program"),
    (lambda r: r.script.run("movej(["), LocalError, "ends in the middle of a statement"),
    (lambda r: r.script.run(None), LocalError, "program"),
    (lambda r: r.script.run("pick.script"), LocalError, "is a file name"),
    (lambda r: r.script.run("programs/my pick.script"), LocalError, "pass pathlib.Path"),
    (lambda r: r.realtime.wait(timeout=True), LocalError, "timeout=True; expected a number of seconds"),
    (lambda r: r.realtime.wait("5"), LocalError, "timeout='5'; expected a number of seconds"),
    (lambda r: r.realtime.subscribe("print"), LocalError, "expected a function"),
    (lambda r: r.realtime.of("RobotModeData"), LocalError, "RobotModeData"),
    (lambda r: r.kinematics.inverse(POSE[:3], Q), LocalError, "must be 6 finite numbers"),
    (lambda r: r.record("run.csv"), LocalError, "record a .urlog"),
    (lambda r: urlink.connect("192.168.56.101:30003"), LocalError, "30003"),
    (lambda r: urlink.connect("sim://ur7"), LocalError, "expected one of"),
    (lambda r: urlink.connect("sim://", timeout=True), LocalError, "timeout is True; expected a number"),
    (lambda r: urlink.connect(""), LocalError, "address"),
    (lambda r: urlink.load("no such file.urlog"), LocalError, "no such file"),
]


@pytest.mark.parametrize("name", ["movej", "moton"])
def test_attribute_error_disables_pythons_suggestions(name: str) -> None:
    with pytest.raises(AttributeError) as caught:
        getattr(StrictAttributes(), name)
    assert (caught.value.name, caught.value.obj) == (name, None)


@pytest.mark.parametrize(("attempt", "kind", "advice"), MISTAKES, ids=[advice for _, _, advice in MISTAKES])
@pytest.mark.real_time
def test_common_mistake_raises_an_error_with_advice(
    robot: Any, attempt: Try, kind: type[Exception], advice: str
) -> None:
    with pytest.raises(kind, match=advice):
        attempt(robot)
    assert robot.motion.current is None


@pytest.mark.real_time
def test_advice_names_existing_attributes(robot: Any) -> None:
    """Each dotted name in the table is an attribute of a robot or of the library."""
    for name, advice in _OWN.items():
        assert name == name.lower().replace("_", "")
        for word in advice.replace("(", " ").replace(",", " ").split():
            owner, *parts = word.split(".")
            if owner not in ("robot", "urlink") or not parts:
                continue
            value = robot if owner == "robot" else urlink
            if parts == ["realtime", "wait"]:
                value = value.realtime.wait(5)
                parts = [part.rstrip(",") for part in advice.partition("wait().")[2].split()[:1]]
            for part in parts:
                value = getattr(value, part)
    assert own_name("no_such_name") is None


def test_quantities_have_the_listed_names_on_each_interface() -> None:
    parts = {snake_case(kind.__name__): kind for kinds in SUB_PACKAGES.values() for kind in kinds}
    for realtime, rtde, primary in QUANTITIES:
        assert realtime in urlink.RealtimeState.FIELDS, f"{realtime}: not real-time; correct it in field_names.py"
        assert rtde in OUTPUTS, f"{rtde}: not a variable of RTDE; correct it in field_names.py"
        if primary != "-":
            part, _, field = primary.partition(".")
            assert field in parts[part].FIELDS, f"{primary}: not a field; correct it in field_names.py"


@pytest.mark.simulated_time
def test_names_of_other_interfaces_raise_errors_with_advice() -> None:
    with urlink.connect("sim://") as robot:
        held: Any = robot
        outputs: Any = held.rtde.outputs("actual_q")
        realtime, primary = held.realtime.wait(), held.primary.wait()
        for owner, name, hint in (
            (realtime, "actual_q", "RealtimeState has no 'actual_q'; equivalent here: q_actual"),
            (realtime, "actual_TCP_pose", "equivalent here: tool_vector_actual"),
            (realtime, "T_motor", "equivalent here: motor_temperatures"),
            (realtime, "tcp", "equivalent here: tool_vector_actual"),
            (primary, "q_actual", "RobotState has no 'q_actual'; equivalent here: joint_data.q_actual"),
            (primary.joint_data, "actual_q", "JointData has no 'actual_q'; equivalent here: q_actual"),
            (outputs.wait(), "q_actual", "Outputs has no 'q_actual'; equivalent here: actual_q"),
            (outputs, "q_actual", r"it is a field of the packets: use wait\(\).actual_q"),
            (outputs, "qd_actual", r"request it with robot.rtde.outputs\('actual_qd'\)"),
            (held.realtime, "q_actual", r"it is a field of the packets: use wait\(\).q_actual"),
            (held.realtime, "actual_q", r"it is a field of the packets: use wait\(\).q_actual"),
            (held.primary, "q_actual", r"it is a field of the packets: use wait\(\).joint_data.q_actual"),
            (held, "actual_q", r"robot.realtime.wait\(\).q_actual, or robot.rtde.outputs\('actual_q'\)"),
            (held.dashboard, "poweron", r"robot.dashboard.power_on\(\)"),
            (held.kinematics, "ik", "robot.kinematics.inverse"),
            (urlink, "Simulator", r"urlink.connect\('sim://ur5e'\)"),
            (urlink, "movej", "robot.motion.move_joints"),
        ):
            assert not hasattr(owner, name)
            assert name not in dir(owner)
            with pytest.raises(AttributeError, match=hint):
                getattr(owner, name)


@pytest.mark.real_time
def test_private_names_get_no_advice(robot: Any) -> None:
    with pytest.raises(AttributeError, match=r"Robot has no attribute '_repr_png_'$"):
        robot._repr_png_()
    assert not hasattr(robot, "_ipython_display_")


@pytest.mark.real_time
@pytest.mark.parametrize("part", ["", "motion", "safety", "io"])
def test_repr_html_shows_the_robot_and_its_parts(robot: Any, part: str) -> None:
    shown = (getattr(robot, part) if part else robot)._repr_html_()
    wanted = {"": "5.11", "motion": "move_joints", "safety": "permitted", "io": "digital outputs"}[part]
    assert wanted in shown
    assert shown.count("<tr>") >= 2


@pytest.mark.simulated_time
def test_repr_html_shows_a_robot_without_open_streams() -> None:
    with urlink.connect("sim://ur10e?firmware=5.11") as robot:
        assert "<td>UR10e</td>" in robot._repr_html_()
        assert "the first use of robot.realtime connects it" in robot._repr_html_()


def test_every_error_is_importable_from_its_module_and_urlink() -> None:
    """The page of errors states that `urlink` has every error. A traceback shows the module of an error."""
    import importlib
    from pathlib import Path

    import urlink.arm.kinematics
    import urlink.rtde

    def kinds(of: type[LinkError]) -> Iterator[type[LinkError]]:
        for kind in of.__subclasses__():
            yield kind
            yield from kinds(kind)

    page = (Path(__file__).parents[2] / "docs" / "errors.md").read_text(encoding="utf-8")
    found = [kind for kind in kinds(LinkError) if kind.__module__.partition(".")[0] in ("urlink", "linkcore")]
    assert len(found) > 30
    for kind in found:
        assert getattr(importlib.import_module(kind.__module__), kind.__name__) is kind
        assert getattr(urlink, kind.__name__) is kind
        assert kind.__name__ in page, kind


@pytest.mark.real_time
def test_type_hints_refuse_text_as_joints(robot: urlink.Robot) -> None:
    """An unused `type: ignore` is an error, so type checkers must refuse each line."""
    with pytest.raises(LocalError, match="q is 'home'; expected numbers"):
        robot.motion.move_joints("home")  # type: ignore[arg-type]
    with pytest.raises(LocalError, match="pose is 'home'; expected numbers"):
        robot.motion.move_linear("home")  # type: ignore[arg-type]
    with pytest.raises(LocalError, match="q is 'home'; expected numbers"):
        urlink.Joint("home")  # type: ignore[arg-type]
    with pytest.raises(LocalError, match="pose is 'home'; expected numbers"):
        urlink.Linear("home")  # type: ignore[arg-type]
