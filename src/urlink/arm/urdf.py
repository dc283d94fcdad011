"""Conversion of an arm to URDF, the robot description format that most other software reads.

Links and joints have the names and frames of the vendor's ROS description (`ur_description`), so that software for that
description also works with this file. The names are `base_link`, `shoulder_pan_joint`, `shoulder_link` and so on, to
`wrist_3_joint`, `wrist_3_link` and `tool0`. The frame `tool0` is the flange as the controller reports it. There is one
difference. Here, `base_link` is the base frame of the controller. In the vendor's description, `base_link` is turned by
180 degrees about z.

The geometry is that of the given arm, either published or calibrated. Limits, masses and inertias are those of
`urlink.models`, even for a calibrated arm. Meshes are not included, because they are part of the vendor's description.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from . import rigid
from .kinematics import Arm
from .models import Model
from .poses import compose, rotvec_to_rpy
from .rigid import Rigid

__all__ = ["JOINTS", "LINKS", "link_frames", "link_poses", "to_urdf"]

#: Radius of the spheres that represent links for viewers, in m. The cylinders are thinner.
RADIUS = 0.05

#: Names of the moving links, starting at the shoulder.
LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")
#: Names of the joints, starting at the base.
JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")


def to_urdf(arm: Arm | Model | str, *, name: str | None = None, shapes: bool = False) -> str:
    """Return the arm as the text of a URDF file.

    Args:
        arm: Calibrated or published `Arm`, `Model`, or name of a model.
        name: Name of the robot in the file; by default the name of the model in lower case.
        shapes: Whether the links have cylinders and spheres, for viewers. These shapes follow the geometry of the arm,
            but they neither look like the arm nor enclose it.

    Returns:
        Text of an XML file, which should have the ending `.urdf`.

    Raises:
        UnknownModel: If no arm has this name.

    >>> text = to_urdf("UR5e")
    >>> text.splitlines()[1]
    '<robot name="ur5e">'
    """
    arm = arm if isinstance(arm, Arm) else Arm(arm)
    model = arm.model
    root = ElementTree.Element("robot", name=name or model.name.lower().replace(" ", ""))
    parent_element = ElementTree.SubElement(root, "link", name="base_link")
    parent, origin = "base_link", rigid.IDENTITY
    for i, ((begin, origin), child, joint) in enumerate(zip(link_frames(arm), LINKS, JOINTS, strict=True)):
        if shapes:
            _add_shapes(parent_element, begin)
        _add_joint(root, model, i, joint, parent, child, begin)
        element = ElementTree.SubElement(root, "link", name=child)
        _add_inertial(element, model, i, origin)
        parent, parent_element = child, element
    if shapes:
        _add_shapes(parent_element, origin)
    ElementTree.SubElement(root, "link", name="tool0")
    fixed = ElementTree.SubElement(root, "joint", name="wrist_3_link-tool0", type="fixed")
    ElementTree.SubElement(fixed, "parent", link=parent)
    ElementTree.SubElement(fixed, "child", link="tool0")
    _add_origin(fixed, origin)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def link_frames(arm: Arm) -> Iterator[tuple[Rigid[float], Rigid[float]]]:
    """Yield two frames of each link: its beginning in the previous link at joint position 0, and its end in the link.

    The joint turns about the z axis of the previous DH frame. A description can put the joint at any position along
    this axis. As in the vendor's description, the joint is put at the beginning of the link, at the link offset d.
    """
    end = rigid.IDENTITY
    for link in arm.geometry.links:
        # Pose of the joint in the previous DH frame, at joint position 0.
        joint = rigid.from_pose([0.0, 0.0, link.d, 0.0, 0.0, link.offset])
        begin = rigid.product(end, joint)
        # End of the link in the frame that turns with the joint.
        ca, sa, cb, sb = link.turns
        end = (cb, 0.0, sb, sa * sb, ca, -sa * cb, -ca * sb, sa, ca * cb, link.a, 0.0, 0.0)
        yield begin, end


def link_poses(arm: Arm, q: NDArray[np.float64]) -> Iterator[tuple[str, str, NDArray[np.float64]]]:
    """Yield the pose of each URDF frame in the previous frame, for joint positions of shape (n, 6), in rad.

    Yields the name of the previous frame, the name of the frame, and its poses, shape (n, 6): position in m, and
    rotation vector in rad.
    """
    frames, parent = list(link_frames(arm)), "base_link"
    for i, ((begin, _), child) in enumerate(zip(frames, LINKS, strict=True)):
        turned = np.zeros((len(q), 6))
        turned[:, 5] = q[:, i]
        yield parent, child, compose(rigid.to_pose(begin), turned)
        parent = child
    yield parent, "tool0", np.tile(rigid.to_pose(frames[-1][1]), (len(q), 1))


def _add_joint(
    root: ElementTree.Element, model: Model, i: int, name: str, parent: str, child: str, origin: Rigid[float]
) -> None:
    low, high = model.position_limits[i].tolist()
    endless = math.isinf(high)
    joint = ElementTree.SubElement(root, "joint", name=name, type="continuous" if endless else "revolute")
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    _add_origin(joint, origin)
    ElementTree.SubElement(joint, "axis", xyz="0 0 1")
    limits = {} if endless else {"lower": numbers(low), "upper": numbers(high)}
    most = {"effort": numbers(float(model.max_torque[i])), "velocity": numbers(float(model.max_speed[i]))}
    ElementTree.SubElement(joint, "limit", {**limits, **most})


def _add_shapes(element: ElementTree.Element, end: Rigid[float]) -> None:
    """Add a sphere at the beginning of a link, and a cylinder from there to the end of the link."""
    x, y, z = end[9:]
    length = math.hypot(x, y, z)
    turned = (math.atan2(math.hypot(x, y), z), math.atan2(y, x))
    for shape, sizes, xyz, (pitch, yaw) in (
        ("sphere", {"radius": RADIUS}, (0.0, 0.0, 0.0), (0.0, 0.0)),
        ("cylinder", {"radius": 0.8 * RADIUS, "length": length}, (x / 2, y / 2, z / 2), turned),
    ):
        if shape == "cylinder" and length < RADIUS:
            continue
        visual = ElementTree.SubElement(element, "visual")
        ElementTree.SubElement(visual, "origin", xyz=numbers(*xyz), rpy=numbers(0.0, pitch, yaw))
        geometry = ElementTree.SubElement(visual, "geometry")
        ElementTree.SubElement(geometry, shape, {key: numbers(value) for key, value in sizes.items()})


def _add_inertial(element: ElementTree.Element, model: Model, i: int, end: Rigid[float]) -> None:
    # The model gives the centre of mass and the inertia in the frame at the end of the link.
    cog = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, *model.link_cogs[i].tolist())
    inertial = ElementTree.SubElement(element, "inertial")
    _add_origin(inertial, rigid.product(end, cog))
    ElementTree.SubElement(inertial, "mass", value=numbers(float(model.link_masses[i])))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = model.link_inertias[i].tolist()
    tensor = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ElementTree.SubElement(inertial, "inertia", {key: numbers(value) for key, value in tensor.items()})


def _add_origin(element: ElementTree.Element, origin: Rigid[float]) -> None:
    rpy = rotvec_to_rpy(rigid.rotation_vector(origin)).tolist()
    ElementTree.SubElement(element, "origin", xyz=numbers(*origin[9:]), rpy=numbers(*rpy))


def numbers(*values: float) -> str:
    """Return the numbers as text with all digits, separated by spaces. The number -0.0 becomes 0.0."""
    return " ".join(repr(value + 0.0) for value in values)
