"""An arm as MJCF: its geometry and its rotors. `tests/interop/test_kinematics.py` loads it in MuJoCo."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from tests.urlink.arm.arms import calibrated
from urlink.arm.kinematics import Arm
from urlink.arm.mjcf import to_mjcf
from urlink.arm.models import MODELS
from urlink.arm.motors import Motors, motors_of
from urlink.arm.poses import compose, quaternion_to_rotvec


def placed(element: ElementTree.Element) -> np.ndarray:
    w, x, y, z = map(float, element.get("quat", "").split())
    return np.array([*map(float, element.get("pos", "").split()), *quaternion_to_rotvec([x, y, z, w])])


@pytest.mark.parametrize("arm", [Arm("UR3e"), Arm("UR8 Long"), calibrated("UR10", 2)], ids=lambda arm: arm.model.name)
def test_mjcf_frames_end_at_the_flange(arm: Arm) -> None:
    root = ElementTree.fromstring(to_mjcf(arm))
    pose = np.zeros(6)
    body = root.find("worldbody/body")
    assert body is not None
    while (inner := body.find("body")) is not None:
        pose, body = compose(pose, placed(inner)), inner
    site = body.find("site")
    assert site is not None
    np.testing.assert_allclose(compose(pose, placed(site)), arm.forward(np.zeros(6)), atol=1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_each_joint_has_inertia_of_rotor(name: str) -> None:
    joints = list(ElementTree.fromstring(to_mjcf(name)).iter("joint"))
    assert [float(joint.get("armature", "")) for joint in joints] == list(motors_of(name).rotor_inertias)


def test_motors_can_be_replaced() -> None:
    own = Motors((1.0,) * 6, (10.0,) * 6, (0.5,) * 6, (0.25,) * 6)
    root = ElementTree.fromstring(to_mjcf("UR5e", name="mine", motors=own))
    assert root.get("model") == "mine"
    for joint in root.iter("joint"):
        assert (joint.get("armature"), joint.get("frictionloss"), joint.get("damping")) == ("1.0", "5.0", "2.5")
