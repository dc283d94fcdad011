"""Simulated arm with a calibration: its motions match its DH parameters, and it reports these parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue
from tests.urlink.arm.arms import calibration
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, model
from urlink.arm.poses import compose, invert
from urlink.simulator import Controller, Still

TABLE = calibration(model("UR5e"), 1)


def test_poses_match_the_calibrated_geometry() -> None:
    controller = Controller("UR5e", calibration=TABLE)
    ours, published = Arm.calibrated("UR5e", TABLE), Arm("UR5e")
    controller.step(2000)
    sample = controller.arm.sample
    assert sample.pose_actual == pytest.approx(ours.forward(sample.q_actual), abs=1e-12)
    assert sample.pose_actual != pytest.approx(published.forward(sample.q_actual), abs=1e-4)
    expected = ours.jacobian(sample.q_target) @ sample.qd_target
    assert sample.speed_target == pytest.approx(expected, abs=1e-12)


def test_movel_of_a_calibrated_arm_ends_at_the_pose() -> None:
    controller = Controller("UR5e", "5.11", motion=Still(), calibration=TABLE)
    arm = Arm.calibrated("UR5e", TABLE)
    goal = arm.forward(controller.arm.setpoint.q) + np.array([0.05, -0.05, 0.05, 0.0, 0.0, 0.0])
    controller.take(f"movel(p{goal.tolist()}, a=1.2, v=0.25)\n")
    controller.step(1000)
    reached = arm.forward(controller.arm.setpoint.q)
    np.testing.assert_allclose(compose(invert(reached), goal), 0.0, atol=1e-9)
    assert not any(controller.arm.setpoint.qd)


@pytest.mark.parametrize(("model", "firmware"), [("UR5", "1.8"), ("UR5", "3.15"), ("UR5e", "5.11")])
@pytest.mark.simulated_time
def test_client_uses_the_calibrated_kinematics(model: str, firmware: str) -> None:
    table = calibration(MODELS[model], 1)
    with Controller(model, firmware, calibration=table) as controller, urlink.connect(controller.address) as robot:
        mine = robot.kinematics
        assert robot.kinematics is mine
        assert repr(mine) == f"<Arm {model}, calibrated>"
        state = robot.realtime.wait(timeout=5.0)
        np.testing.assert_allclose(mine.forward(state.q_actual), state.tool_vector_actual, rtol=0.0, atol=1e-12)


@pytest.mark.simulated_time
def test_recording_contains_the_calibration(tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    with Controller("UR5e", calibration=TABLE) as controller, urlink.connect(controller.address) as robot:
        # The stream is already connected, so the first state of its connection is not in the recording.
        robot.primary.wait(timeout=5.0)
        with robot.record(path, ["primary"]):
            pass
        expected = robot.kinematics.forward([0.1] * 6)
    with urlink.connect(path) as replayed:
        np.testing.assert_array_equal(replayed.kinematics.forward([0.1] * 6), expected)


def test_calibration_of_another_model_is_rejected() -> None:
    with pytest.raises(BadValue, match="DH table of a UR10e"):
        Controller("UR10e", calibration=TABLE)


def test_get_jacobian_uses_the_calibration() -> None:
    controller = Controller("UR5e", "5.25", motion=Still(), calibration=TABLE)
    entries = "\n".join(f"write_output_float_register({n}, j[{n // 6}, {n % 6}])" for n in range(36))
    q = [0.1, -1.2, 1.4, -0.3, 0.7, 0.2]
    controller.take(f"def prog():\nj = get_jacobian({q})\n{entries}\nend\n")
    controller.step(100)
    expected = Arm.calibrated("UR5e", TABLE).jacobian(q)
    found = np.reshape(controller.registers.outputs.floats[:36], (6, 6))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)
