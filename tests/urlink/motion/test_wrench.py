"""Compensated wrenches: frames, payload that changes, offset, and zero."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue
from tests.waiting import until
from urlink import poses
from urlink.robot import Robot
from urlink.simulator import Controller, Still

from .payloads_drawn import exact_payload

pytestmark = pytest.mark.simulated_time

TIMEOUT = 60.0
MASS, CENTRE = 1.5, (0.02, -0.01, 0.07)
PUSH = np.array([3.0, -4.0, 12.0, 0.2, -0.3, 0.4])
TCP = [0.01, 0.02, 0.1, 0.0, 0.3, 0.5]
FRAME = [0.3, -0.2, 0.1, 0.4, -0.2, 1.0]
#: Largest differences by noise and wander of the simulated sensor, in N and Nm.
NEAR = np.array([2.5] * 3 + [0.15] * 3)


@pytest.fixture
def arm() -> Iterator[tuple[Controller, Robot]]:
    with Controller("UR5e", "5.11", motion=Still()) as controller, urlink.connect(controller.address) as robot:
        robot.set_tcp(TCP)
        # The sensor of the simulator might have an offset.
        robot.zero_force_sensor()
        begun = controller.cycle
        until(lambda: controller.cycle > begun + 50, TIMEOUT)
        controller.world.carry(MASS, CENTRE)
        controller.push(PUSH.tolist())
        cycle = controller.cycle
        until(lambda: controller.cycle > cycle + 10, TIMEOUT)
        yield controller, robot


def expected(state: urlink.RealtimeState, frame: str | list[float]) -> np.ndarray:
    force, torque = PUSH[:3], PUSH[3:]
    if frame == "base":
        return PUSH
    pose = state.tool_vector_actual if frame == "tcp" else np.array(frame, dtype=float)
    turn = poses.rotvec_to_matrix(pose[3:]).T
    lever = state.tool_vector_actual[:3] - pose[:3]
    return np.concatenate((turn @ force, turn @ (torque + np.cross(lever, force))))


@pytest.mark.parametrize("frame", ["tcp", "base", FRAME])
def test_wrench_is_the_push_in_each_frame(arm: tuple[Controller, Robot], frame: str | list[float]) -> None:
    _, robot = arm
    wrench = robot.wrench(exact_payload(MASS, CENTRE), frame).wait()
    assert (abs(wrench.values - expected(wrench.state, frame)) < NEAR * (1.0 if frame != FRAME else 5.0)).all()
    # The raw wrench still has the weight.
    assert wrench.raw[2] == pytest.approx(PUSH[2] - 9.82 * MASS, abs=2.5)
    assert (wrench.raw == wrench.state.tcp_force).all()


@pytest.mark.parametrize("frame", ["tcp", "base", FRAME])
def test_wrench_subtracts_the_offset_that_turns_with_the_flange(
    arm: tuple[Controller, Robot], frame: str | list[float]
) -> None:
    _, robot = arm
    offset = np.array([5.0, -20.0, 70.0, 0.5, -0.4, 0.3])
    state = robot.realtime.wait()
    plain = robot.wrench(exact_payload(MASS, CENTRE), frame).compensate(state).values
    less = robot.wrench(exact_payload(MASS, CENTRE, tuple(offset)), frame).compensate(state).values
    flange = robot.kinematics.forward(state.q_actual)
    turn = poses.rotvec_to_matrix(flange[3:])
    force, torque = turn @ offset[:3], turn @ offset[3:]
    origin = {"tcp": state.tool_vector_actual, "base": state.tool_vector_actual}.get(str(frame), np.array(FRAME))
    axes = np.eye(3) if frame == "base" else poses.rotvec_to_matrix(origin[3:]).T
    about = torque + np.cross(flange[:3] - origin[:3], force)
    assert plain - less == pytest.approx(np.concatenate((axes @ force, axes @ about)), abs=2e-3)


def test_wrench_follows_the_payload_of_the_controller(arm: tuple[Controller, Robot]) -> None:
    _, robot = arm
    stream = robot.wrench(exact_payload(MASS, CENTRE), "base")
    for mass, centre in ((MASS, CENTRE), (0.7, (0.0, 0.0, 0.1))):
        robot.set_payload(mass, centre)
        wrench = stream.wait_until(lambda wrench, mass=mass: wrench.state.payload_mass == pytest.approx(mass))  # type: ignore[misc]
        assert (abs(wrench.values - PUSH) < NEAR).all()


def test_zero_removes_what_acts_now(arm: tuple[Controller, Robot]) -> None:
    _, robot = arm
    for frame in ("tcp", "base", FRAME):
        stream = robot.wrench(exact_payload(MASS, CENTRE), frame)
        stream.zero(0.2)
        assert (abs(stream.wait().values) < NEAR * (1.0 if frame != FRAME else 5.0)).all()
    with pytest.raises(BadValue, match="duration"):
        stream.zero(0.0)


def test_iteration_and_latest_give_wrenches(arm: tuple[Controller, Robot]) -> None:
    _, robot = arm
    stream = robot.wrench(exact_payload(MASS, CENTRE))
    for wrench in stream:
        assert wrench.frame == "tcp"
        break
    latest = stream.latest
    assert latest is not None
    assert repr(latest).startswith("<Wrench tcp: ")
    assert repr(stream).startswith("<WrenchStream tcp: 1.500 ± 0.000 kg")


@pytest.mark.parametrize(
    ("frame", "message"), [("tool", "frame is 'tool'; expected 'tcp', 'base'"), ([300, 0, 0, 0, 0, 0], "frame")]
)
def test_wrench_rejects_unknown_frames(arm: tuple[Controller, Robot], frame: str | list[float], message: str) -> None:
    with pytest.raises(BadValue, match=message):
        arm[1].wrench(exact_payload(MASS, CENTRE), frame)


def test_wrench_rejects_a_payload_that_was_not_measured(arm: tuple[Controller, Robot]) -> None:
    with pytest.raises(BadValue, match=r"payload is 1\.5; expected the result of measure_payload"):
        arm[1].wrench(1.5)  # type: ignore[arg-type]
