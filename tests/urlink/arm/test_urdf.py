"""The robot description, parsed by hand: positions of its joints, and masses of its links."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.urlink.arm.arms import Array, calibrated, joints, models, rotation_of
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, Model
from urlink.arm.poses import to_matrix
from urlink.arm.urdf import to_urdf


def vector(element: ElementTree.Element, path: str, name: str) -> Array:
    found = element.find(path)
    assert found is not None
    return np.array([float(number) for number in found.attrib[name].split()])


def origin(element: ElementTree.Element) -> Array:
    roll, pitch, yaw = vector(element, "origin", "rpy")
    matrix = np.eye(4)
    turns = [rotation_of(np.array(axis)) for axis in ([0.0, 0.0, yaw], [0.0, pitch, 0.0], [roll, 0.0, 0.0])]
    matrix[:3, :3] = turns[0] @ turns[1] @ turns[2]
    matrix[:3, 3] = vector(element, "origin", "xyz")
    return matrix


def flange(text: str, q: list[float]) -> Array:
    """Return the frame of tool0, along the tree from base_link."""
    at, matrix, angles = "base_link", np.eye(4), iter(q)
    by_parent = {vector_of(joint, "parent"): joint for joint in ElementTree.fromstring(text).findall("joint")}
    while at != "tool0":
        joint = by_parent[at]
        matrix = matrix @ origin(joint)
        if joint.attrib["type"] != "fixed":
            turn = np.eye(4)
            turn[:3, :3] = rotation_of(next(angles) * vector(joint, "axis", "xyz"))
            matrix = matrix @ turn
        at = vector_of(joint, "child")
    return matrix


def vector_of(joint: ElementTree.Element, path: str) -> str:
    found = joint.find(path)
    assert found is not None
    return found.attrib["link"]


@pytest.mark.property
@given(models, st.integers(-1, 3), joints)
def test_flange_matches_kinematics(of: Model, seed: int, q: list[float]) -> None:
    arm = Arm(of) if seed < 0 else calibrated(of.name, seed)
    np.testing.assert_allclose(flange(to_urdf(arm), q), to_matrix(arm.forward(q)), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_names_and_positions_match_vendor_description(name: str) -> None:
    root, model = ElementTree.fromstring(to_urdf(name)), MODELS[name]
    assert [link.attrib["name"] for link in root.findall("link")] == [
        "base_link",
        "shoulder_link",
        "upper_arm_link",
        "forearm_link",
        "wrist_1_link",
        "wrist_2_link",
        "wrist_3_link",
        "tool0",
    ]
    d1, a2, a3, d4, d5, d6 = model.dh_d[0], *model.dh_a[1:3], *model.dh_d[3:]
    places = {
        "shoulder_pan_joint": (0.0, 0.0, d1),
        "shoulder_lift_joint": (0.0, 0.0, 0.0),
        "elbow_joint": (a2, 0.0, 0.0),
        "wrist_1_joint": (a3, 0.0, d4),
        "wrist_2_joint": (0.0, -d5, 0.0),
        "wrist_3_joint": (0.0, d6, 0.0),
        "wrist_3_link-tool0": (0.0, 0.0, 0.0),
    }
    found = {joint.attrib["name"]: origin(joint)[:3, 3] for joint in root.findall("joint")}
    assert list(found) == list(places)
    for joint, place in places.items():
        np.testing.assert_allclose(found[joint], place, atol=1e-15)


@pytest.mark.parametrize("name", ["UR3e", "UR20"])
def test_urdf_cylinders_reach_from_joint_to_joint(name: str) -> None:
    """Each cylinder is as long as its link and ends where the next joint begins."""
    root = ElementTree.fromstring(to_urdf(name, shapes=True))
    joints = {vector_of(joint, "parent"): joint for joint in root.findall("joint")}
    drawn = 0
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            cylinder = visual.find("geometry/cylinder")
            if cylinder is not None:
                half = np.array([0.0, 0.0, float(cylinder.attrib["length"]) / 2, 1.0])
                end = origin(visual) @ half
                np.testing.assert_allclose(end[:3], origin(joints[link.attrib["name"]])[:3, 3], atol=1e-12)
                drawn += 1
    assert drawn == 5  # the shoulder has no length, and the flange is where the last link begins
    assert ElementTree.fromstring(to_urdf(name)).find("link/visual") is None


def test_masses_and_limits_match_model() -> None:
    root, model = ElementTree.fromstring(to_urdf("UR10e", name="left")), MODELS["UR10e"]
    assert root.attrib["name"] == "left"
    weighed = [float(mass.attrib["value"]) for mass in root.iter("mass")]
    assert weighed == model.link_masses.tolist()
    # In the frame of the joint, as in the vendor's description.
    shoulder = root.find("link[@name='shoulder_link']/inertial")
    assert shoulder is not None
    np.testing.assert_allclose(vector(shoulder, "origin", "xyz"), [0.021, -0.027, 0.0], atol=1e-15)
    np.testing.assert_allclose(vector(shoulder, "origin", "rpy"), [np.pi / 2.0, 0.0, 0.0], atol=1e-15)
    limits = [limit.attrib for limit in root.iter("limit")]
    assert [float(limit["effort"]) for limit in limits] == model.max_torque.tolist()
    assert [float(limit["velocity"]) for limit in limits] == model.max_speed.tolist()
    assert float(limits[0]["lower"]) == -float(limits[0]["upper"]) == -2.0 * np.pi


def test_endless_joint_is_continuous() -> None:
    joint = ElementTree.fromstring(to_urdf("UR3e")).find("joint[@name='wrist_3_joint']")
    assert joint is not None
    assert joint.attrib["type"] == "continuous"
    limit = joint.find("limit")
    assert limit is not None
    assert set(limit.attrib) == {"effort", "velocity"}
