"""Forces on the simulated arm and its reactions: contacts, force mode, freedrive and torque, on a stepped clock."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence
from textwrap import indent

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue
from urlink.arm.dynamics import Dynamics
from urlink.arm.poses import rotvec_to_matrix
from urlink.protocol.enums import ControlMode, SafetyMode
from urlink.simulator import Controller, Demonstration, Plane, Spring, Still
from urlink.simulator.robot.sensors import Sample

DOWN = "p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,{force},0,0,0]"


class Bench:
    """Controller whose arm is at rest in its home posture, with the tool pointing down."""

    def __init__(self, firmware: str = "3.15") -> None:
        self.controller = Controller(None, firmware, motion=Still(), noise=False)
        self.controller.step()
        self.world = self.controller.world
        self.start: list[float] = self.pose

    @property
    def pose(self) -> list[float]:
        arm = self.controller.arm
        return list(arm.kinematics.forward(arm.setpoint.q, arm.tcp).tolist())

    @property
    def moved(self) -> list[float]:
        return [a - b for a, b in zip(self.pose, self.start, strict=True)]

    @property
    def force(self) -> Sequence[float]:
        return self.controller.arm.wrench

    def is_stopped(self) -> bool:
        return self.controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP

    def run(self, body: str, seconds: float = 0.0) -> None:
        self.controller.take(f"def p():\n{indent(body, '  ')}\nend")
        self.go(seconds)

    def go(self, seconds: float) -> None:
        self.controller.step(max(round(seconds * self.controller.firmware.rate), 1))

    def press(self, force: float, limits: str = "[0.1,0.1,0.1,0.5,0.5,0.5]", seconds: float = 2.0) -> None:
        self.run(f"force_mode({DOWN.format(force=-force)}, 2, {limits})\nsleep(60)", seconds)

    def table(self, below: float = 0.002, **figures: float) -> Plane:
        x, y, z = self.start[:3]
        plane = Plane((x, y, z - below), (0, 0, 2), **figures)
        self.world.add(plane)
        return plane


# -- contacts and the sensor -----------------------------------------------------------------------------


def test_plane_pushes_along_its_normal_with_friction() -> None:
    plane = Plane((0, 0, 1), (0, 3, 4), stiffness=1000.0, damping=10.0, friction=0.5)
    assert plane.force((5, 0, 1.01), (0, 0, -1)) == (0.0, 0.0, 0.0)
    inside = np.array((0.0, 0.0, 1.0)) - 0.02 * np.array((0.0, 0.6, 0.8))
    assert plane.force(inside.tolist(), (0, 0, 0)) == pytest.approx((0.0, 12.0, 16.0))
    sliding = plane.force(inside.tolist(), (1.0, 0.0, 0.0))
    assert sliding == pytest.approx((-10.0, 12.0, 16.0), abs=1e-6)
    # The plane never pulls, even if the tool leaves it faster than the contact could follow.
    assert plane.force(inside.tolist(), (0.0, 6.0, 8.0)) == (0.0, 0.0, 0.0)


@pytest.mark.property
@given(
    normal=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda n: math.hypot(*n) > 0.1),
    position=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    velocity=st.tuples(*[st.floats(-1, 1)] * 3),
    friction=st.floats(0, 1),
)
def test_contact_gives_energy_only_by_its_spring(
    normal: tuple[float, ...], position: tuple[float, ...], velocity: tuple[float, ...], friction: float
) -> None:
    plane = Plane((0, 0, 0), normal, 1000.0, 10.0, friction)
    force, n = np.array(plane.force(position, velocity)), np.array(plane.normal)
    pressed = float(force @ n)
    assert pressed >= -1e-9
    across = force - pressed * n
    assert float(np.linalg.norm(across)) <= friction * pressed + 1e-9
    assert float(across @ np.array(velocity)) <= 1e-9


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Plane((0, 0), (0, 0, 1)),
        lambda: Plane((0, 0, 0), (0, 0, 0)),
        lambda: Plane((0, 0, 0), stiffness=-1.0),
        lambda: Spring((0, 0, math.nan)),
        lambda: Bench().world.add(object()),  # type: ignore[arg-type]
        lambda: Bench().world.remove(Plane((0, 0, 0))),
        lambda: Bench().world.push([1, 2, 3]),
        lambda: Bench().world.carry(-1.0),
    ],
)
def test_world_rejects_invalid_values(wrong: object) -> None:
    with pytest.raises(BadValue):
        wrong()  # type: ignore[operator]


def test_contacts_are_felt_until_they_are_removed() -> None:
    bench = Bench()
    spring = bench.world.add(Spring([a + b for a, b in zip(bench.start[:3], (0.1, 0, 0), strict=True)], 200.0))
    plane = bench.table(-0.001, stiffness=5000.0)
    assert bench.world.contacts == (spring, plane)
    bench.controller.push([0, 7.0, 0, 0, 0, 0.5])
    bench.go(0.1)
    assert bench.force == pytest.approx([20.0, 7.0, 5.0, 0, 0, 0.5], abs=1e-6)
    # A controller that holds its arm does not let the force move it.
    assert bench.moved == [0.0] * 6
    sample = bench.controller.arm.sample
    assert sample.force == pytest.approx(list(bench.force), abs=0.5)
    # The motors compensate for the force.
    across = bench.controller.arm.kinematics.jacobian(bench.controller.arm.setpoint.q).T @ np.array(bench.force)
    more = (np.array(sample.I_target) - np.array(sample.I_control)) * bench.controller.arm.motors.torque_constants
    assert more == pytest.approx(across, abs=1e-6)
    bench.world.remove(spring)
    bench.go(0.0)
    assert bench.force[0] == 0.0
    bench.world.clear()
    bench.go(0.0)
    assert bench.force == [0.0] * 6


def test_undeclared_load_is_felt_until_the_sensor_is_zeroed() -> None:
    bench = Bench()
    bench.world.carry(1.0, (0.0, 0.0, 0.1))
    bench.run("set_payload(0.5, [0, 0, 0.1])\nzero = False", 0.1)
    assert bench.force[:3] == pytest.approx([0.0, 0.0, -0.5 * 9.82])
    bench.run("zero_ftsensor()", 0.1)
    assert bench.force == pytest.approx([0.0] * 6, abs=1e-9)
    assert bench.controller.arm.raw_wrench[2] == pytest.approx(-0.5 * 9.82, abs=0.5)
    bench.controller.push([0, 0, 3.0, 0, 0, 0])
    bench.go(0.1)
    assert bench.force[2] == pytest.approx(3.0)


def test_excessive_force_stops_the_arm_and_it_can_retreat() -> None:
    bench = Bench()
    bench.table(0.01)
    x, y, z, *rest = bench.start
    bench.run(f"movel(p[{x},{y},{z - 0.05},{','.join(map(str, rest))}], v=0.1)", 3.0)
    assert bench.is_stopped()
    assert 150.0 < bench.force[2] < 400.0
    bench.controller.faults.clear()
    bench.run("stopj(2)\nspeedl([0,0,0.05,0,0,0], 0.5, 1)", 2)
    assert not bench.is_stopped()
    assert bench.force[2] == 0.0


# -- force mode ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("firmware", "stiffness"), [("3.15", 2e3), ("3.15", 100e3), ("5.11", 20e3)])
def test_peg_pressed_on_a_plane_settles(firmware: str, stiffness: float) -> None:
    bench = Bench(firmware)
    bench.table(0.005, stiffness=stiffness)
    bench.press(10.0, seconds=2.0 if stiffness < 1e4 else 1.0)
    for _ in range(20):
        bench.go(0.04)
        assert abs(bench.force[2] - 10.0) < 0.5
    assert abs(bench.force[2] - 10.0) < 0.05
    assert not bench.is_stopped()
    readings = []
    for _ in range(50):
        bench.go(0.0)
        readings.append(bench.controller.arm.sample.force[2])
    assert max(abs(each - 10.0) for each in readings) < 0.5


def test_force_mode_keeps_moving_along_the_other_axes() -> None:
    bench = Bench()
    bench.table(0.001, friction=0.3)
    x, y, z = bench.start[:3]
    rest = ",".join(map(str, bench.start[3:]))
    move = f"movel(p[{x},{y + 0.1},{z},{rest}], v=0.1)"
    bench.run(f"force_mode({DOWN.format(force=-20.0)}, 2, [0.1,0.1,0.1,0.5,0.5,0.5])\nsleep(1)\n{move}\nsleep(60)", 1.7)
    # The arm slides while the pressing force stays the same.
    assert bench.force[2] == pytest.approx(20.0, abs=0.5)
    assert bench.force[1] == pytest.approx(-6.0, abs=0.3)
    bench.go(0.8)
    assert bench.moved[1] == pytest.approx(0.1, abs=5e-4)
    assert bench.force[2] == pytest.approx(20.0, abs=0.1)
    assert bench.moved[3:] == pytest.approx([0.0] * 3, abs=1e-6)


@pytest.mark.slow
def test_force_mode_honours_speed_damping_and_gain() -> None:
    limited = Bench()
    limited.press(50.0, "[1,1,0.03,1,1,1]", 0.3)
    assert limited.controller.arm.sample.speed_target[2] == pytest.approx(-0.03, abs=1e-4)
    assert not limited.is_stopped()

    def speed(settings: str, seconds: float = 0.5) -> float:
        bench = Bench("5.11")
        bench.run(f"{settings}\nforce_mode({DOWN.format(force=-5.0)}, 2, [1,1,1,1,1,1])\nsleep(60)", seconds)
        return float(bench.controller.arm.sample.speed_target[2])

    usual = speed("force_mode_set_damping(0.005)")
    assert usual == pytest.approx(speed("set_flag(1, True)"), rel=1e-6)
    assert speed("force_mode_set_damping(0.1)") == pytest.approx(-5.0 / 30.0 / 50.0, rel=0.1)
    assert speed("force_mode_set_gain_scaling(0.5)") == pytest.approx(0.5 * usual, rel=0.01)
    assert speed("force_mode_set_damping(0)") == pytest.approx(0.5 * -5.0 / 30.0, rel=0.02)


def test_force_mode_limits_stop_the_arm() -> None:
    aside = Bench()
    aside.controller.push([60.0, 0, 0, 0, 0, 0])
    aside.press(0.0, "[0.002,0.1,0.1,0.5,0.5,0.5]", 1.0)
    assert aside.is_stopped()
    held = Bench()
    held.controller.push([60.0, 0, 0, 0, 0, 0])
    held.press(0.0, "[0.004,0.1,0.1,0.5,0.5,0.5]", 1.0)
    assert not held.is_stopped()
    assert held.moved[0] == pytest.approx(0.003, abs=1e-5)
    pushed = Bench()
    pushed.press(0.0, "[0.1,0.1,0.05,0.5,0.5,0.5]", 0.2)
    pushed.controller.push([0, 0, -60.0, 0, 0, 0])
    pushed.go(1.0)
    assert pushed.is_stopped()
    # Only the force of the arm itself acts, so the arm is held at the limit.
    assert pushed.controller.program_name == "p"


def test_force_mode_ends_with_its_program() -> None:
    bench = Bench()
    bench.table()
    bench.press(10.0, seconds=0.5)
    bench.controller.take("def q():\n  sleep(60)\nend")
    bench.go(0.5)
    at = bench.pose
    bench.controller.push([0, 0, 50.0, 0, 0, 0])
    bench.go(0.5)
    assert bench.pose == at
    bench.controller.push([0] * 6)
    bench.run(f"force_mode({DOWN.format(force=-10.0)}, 2, [1,1,1,1,1,1])\nsleep(0.4)\nend_force_mode()\nsleep(9)", 1.0)
    at = bench.pose
    bench.controller.push([0, 0, 50.0, 0, 0, 0])
    bench.go(0.5)
    assert bench.pose == at


def test_force_frame_turns_with_the_tool_or_its_path() -> None:
    # Kind 1: y points towards the origin of the frame, which is to the left of the tool.
    bench = Bench()
    x, y, z = bench.start[:3]
    bench.run(f"force_mode(p[{x},{y + 1},{z},0,0,0], [0,1,0,0,0,0], [0,10,0,0,0,0], 1, [1,1,1,1,1,1])\nsleep(9)", 0.5)
    assert bench.moved[1] > 0.01
    assert bench.moved[::2][0] == pytest.approx(0.0, abs=1e-6)
    # Kind 3: x is along the motion, which is towards y.
    bench = Bench()
    bench.controller.push([0, -30.0, 0, 0, 0, 0])
    bench.run(
        "force_mode(p[0,0,0,0,0,0], [0,1,0,0,0,0], [0,0,0,0,0,0], 3, [1,1,1,1,1,1])\nspeedl([0,0.1,0,0,0,0], 1, 1)", 1.0
    )
    assert abs(bench.moved[0]) < 1e-3
    assert bench.moved[1] > 0.05


@pytest.mark.parametrize(
    "call",
    [
        f"force_mode({DOWN.format(force=1)}, 4, [1,1,1,1,1,1])",
        f"force_mode({DOWN.format(force=1)}, 2, [1,1,-1,1,1,1])",
        "force_mode(p[0,0,0,0,0,0], [0,0,2,0,0,0], [0,0,0,0,0,0], 2, [1,1,1,1,1,1])",
        "force_mode_set_damping(1.5)",
        "freedrive_mode([1,1,1,1,1,0.5])",
    ],
)
def test_invalid_force_mode_call_ends_the_program(call: str) -> None:
    bench = Bench()
    bench.run(f"{call}\nsleep(60)", 0.1)
    assert bench.controller.program_name is None
    assert bench.moved == [0.0] * 6


# -- contact detection -----------------------------------------------------------------------------------


def test_contact_is_found_and_the_arm_returns_to_it() -> None:
    bench = Bench("5.4")
    bench.table(0.02)
    bench.run(
        """
        steps = 0
        while steps == 0:
          steps = tool_contact(direction=[0,0,-1,0,0,0])
          speedl([0,0,-0.05,0,0,0], 1, t=get_steptime())
        end
        q = get_actual_joint_positions_history(steps)
        stopl(5)
        movej(q)
        set_flag(3, tool_contact(direction=[0,0,1,0,0,0]) > 0)
        """,
        2.0,
    )
    assert bench.controller.program_name is None
    assert bench.moved[2] == pytest.approx(-0.02, abs=3e-4)
    assert not bench.controller.flags[3]


# -- freedrive -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("firmware", "mode"), [("3.15", "freedrive_mode()"), ("3.15", "teach_mode()"), ("5.25", "freedrive_mode()")]
)
def test_arm_follows_a_push_in_freedrive(firmware: str, mode: str) -> None:
    bench = Bench(firmware)
    bench.run(f"{mode}\nsleep(60)", 0.5)
    assert bench.moved == [0.0] * 6
    bench.controller.push([0.0, 20.0, 0, 0, 0, 0])
    bench.go(1.0)
    bench.controller.push([0.0] * 6)
    assert bench.moved[1] > 0.03
    bench.go(1.5)
    at = bench.pose
    bench.go(0.1)
    assert bench.pose == pytest.approx(at, abs=1e-5)
    bench.controller.push([0.0] * 6, [0, 0, 0, 0, 0, 4.0])
    before = bench.controller.arm.setpoint.q[5]
    bench.go(0.5)
    assert bench.controller.arm.setpoint.q[5] > before + 0.1
    bench.controller.push([0.0] * 6)
    assert not bench.is_stopped()


def test_freedrive_yields_to_the_wrench_that_replaces_the_sensor() -> None:
    """An offset of the sensor does not move the arm, but a wrench that a client has set does."""
    controller = Controller("UR3e", "5.11", motion=Still())
    controller.step()
    controller.take("def p():\n  freedrive_mode()\n  sleep(60)\nend")
    controller.step(250)
    before = list(controller.arm.setpoint.q)
    controller.step(250)
    assert controller.arm.setpoint.q == before
    controller.arm.uses_external_force, controller.arm.external_force = True, [0.0, 20.0, 0.0, 0.0, 0.0, 0.0]
    controller.step(250)
    assert np.abs(np.subtract(controller.arm.setpoint.q, before)).max() > 0.02


def test_freedrive_moves_only_along_the_chosen_axes() -> None:
    bench = Bench("5.10")
    bench.run("freedrive_mode(freeAxes=[1,0,0,0,0,0], feature=p[0,0,0,0,0,0])\nsleep(60)", 0.1)
    bench.controller.push([15.0, 15.0, 0, 0, 0, 0])
    bench.go(1.0)
    assert bench.moved[0] > 0.02
    assert abs(bench.moved[1]) < 1e-3
    assert not bench.is_stopped()


def test_freedrive_stops_when_pushed_too_hard_or_too_fast() -> None:
    for wrench in ([0, 160.0, 0, 0, 0, 0], [0, 0, 140.0, 0, 0, 0]):
        bench = Bench()
        bench.run("freedrive_mode()\nsleep(60)", 0.1)
        bench.controller.push(wrench)
        bench.go(1.0)
        assert bench.is_stopped()
        # The stop also ends freedrive.
        bench.controller.push([0.0] * 6)
        bench.go(1.0)
        assert not any(bench.controller.arm.setpoint.qd)


# -- torque ----------------------------------------------------------------------------------------------


def test_direct_torque_accelerates_the_arm_by_its_dynamics() -> None:
    bench = Bench("5.25")
    q = bench.controller.arm.setpoint.q
    torque = [1.0, -2.0, 1.5, 0.3, 0.2, 0.1]
    expected = np.linalg.solve(Dynamics("UR5e", rotors=True).mass_matrix(q), torque)
    bench.run(f"while True:\ndirect_torque({torque})\nend", 0.0)
    for _ in range(3):
        bench.go(0.0)
        if any(bench.controller.arm.setpoint.qdd):
            break
    assert bench.controller.arm.setpoint.qdd == pytest.approx(expected.tolist(), rel=1e-4)
    # The next program sends no torques, so the arm brakes.
    bench.controller.take("def q():\n  sleep(60)\nend")
    bench.go(1.0)
    assert not any(bench.controller.arm.setpoint.qd)


@pytest.mark.slow
def test_direct_torque_of_zero_lets_the_arm_be_pushed() -> None:
    bench = Bench("5.25")
    bench.run("while True:\ndirect_torque([0,0,0,0,0,0])\nend", 1.0)
    assert bench.moved == pytest.approx([0.0] * 6, abs=1e-9)
    bench.controller.push([0, 0, 10.0, 0, 0, 0])
    bench.go(0.2)
    assert bench.moved[2] > 0.01


@pytest.mark.parametrize(
    ("body", "mode"),
    [
        ("sleep(9)", "POSITION"),
        (f"force_mode({DOWN.format(force=0)}, 2, [1,1,1,1,1,1])\nsleep(9)", "FORCE"),
        ("freedrive_mode()\nsleep(9)", "TEACH"),
        ("freedrive_mode([1,0,0,0,0,0])\nsleep(9)", "TEACH"),
        ("freedrive_mode()\nend_freedrive_mode()\nsleep(9)", "POSITION"),
        ("while True:\n  direct_torque([0,0,0,0,0,0])\nend", "TORQUE"),
    ],
)
def test_robot_state_reports_the_control_mode(body: str, mode: str) -> None:
    bench = Bench("5.25")
    bench.run(body, 0.02)
    (state,) = urlink.decode(bench.controller.state_package(), "primary", "5.25")
    assert isinstance(state, urlink.packets.RobotState)
    assert state.robot_mode_data is not None
    assert state.robot_mode_data.control_mode is ControlMode[mode]
    # The mode returns to POSITION when the program has ended.
    bench.controller.take("def q():\n  sync()\nend")
    bench.go(0.05)
    (state,) = urlink.decode(bench.controller.state_package(), "primary", "5.25")
    assert isinstance(state, urlink.packets.RobotState)
    assert state.robot_mode_data is not None
    assert state.robot_mode_data.control_mode is ControlMode.POSITION


def test_optimised_moves_reach_their_goals() -> None:
    bench = Bench("5.25")
    x, y, z = bench.start[:3]
    rest = ",".join(map(str, bench.start[3:]))
    bench.run(f"optimovel(p[{x},{y},{z + 0.05},{rest}], 0.5, 0.5)", 1.5)
    assert bench.moved[2] == pytest.approx(0.05, abs=1e-9)
    bench.run("optimovej([0,-1.57,1.57,-1.57,-1.57,0.5], 0.5, 0.5)", 3.0)
    assert bench.controller.arm.setpoint.q[5] == pytest.approx(0.5)


@pytest.mark.slow
def test_offset_of_a_zeroed_sensor_turns_with_the_tool() -> None:
    """The offset turns with the tool, so half a turn makes a weight count twice."""
    bench = Bench()
    bench.world.carry(1.0)
    bench.go(0.0)
    bench.run("zero_ftsensor()", 0.1)
    q = list(bench.controller.arm.setpoint.q)
    bench.run("movej([{},{},{},{},{},{}])".format(*q[:3], q[3] + 1.0, *q[4:]), 3.0)
    turned = rotvec_to_matrix(bench.pose[3:]) @ rotvec_to_matrix(bench.start[3:]).T
    weight = np.array((0.0, 0.0, -9.82))
    assert bench.force[:3] == pytest.approx((weight - turned @ weight).tolist(), abs=1e-9)


@pytest.mark.parametrize("zeroes", [False, True])
def test_offset_of_the_sensor_is_zeroed_at_program_start_when_asked(zeroes: bool) -> None:
    controller = Controller("UR3e", "5.11", motion=Still(), zeroes_force=zeroes)
    controller.step(10)
    assert 74.0 < np.linalg.norm(controller.arm.sample.force[:3]) < 80.0
    controller.take("def f():\n  sleep(1)\nend\n")
    controller.step(10)
    assert bool(np.linalg.norm(controller.arm.sample.force[:3]) < 1.0) is zeroes
    controller.arm.zero_force()
    assert np.linalg.norm(controller.arm.sample.force[:3]) < 1.0
    assert np.linalg.norm(controller.arm.raw_wrench[:3]) > 74.0


def test_sensor_errors_do_not_depend_on_when_they_are_read() -> None:
    read, unread = (Controller("UR5e", "5.11", motion=Demonstration(), seed=4) for _ in range(2))
    for _ in range(300):
        read.step(7)
        assert read.arm.sample.force
    unread.step(2100)
    values = [name for name in Sample.__slots__ if name not in inspect.signature(Sample).parameters]
    assert all(getattr(read.arm.sample, name) == getattr(unread.arm.sample, name) for name in values)
