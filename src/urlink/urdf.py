"""An arm as URDF, the robot description that most other software reads.

Links and joints have the names and frames of the vendor's ROS description (`ur_description`), so that what was written
for that one finds its way: `base_link`, `shoulder_pan_joint`, `shoulder_link` and so on to `wrist_3_joint`,
`wrist_3_link` and `tool0`, which is the flange as the controller reports it. Other than there, `base_link` is the
controller's base frame and not turned by 180 degrees about z.

The geometry is that of the arm at hand, calibrated or not. Limits, masses and inertias are those of `urlink.models`,
also for a calibrated arm. There are no shapes: the meshes belong to the vendor's description.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree

from . import rigid
from .kinematics import Arm
from .kinematics.geometry import Link
from .models import Model
from .poses import rotvec_to_rpy
from .rigid import Rigid

__all__ = ["JOINTS", "to_urdf"]

_LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")
#: The joints, from the base on.
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


def to_urdf(arm: Arm | Model | str, *, name: str | None = None) -> str:
    """The arm as the text of a URDF file.

    Args:
        arm: an `Arm`, which may be calibrated, or the name of a model, or a `Model`.
        name: of the robot in the file; by default that of the model, in lower case.

    Returns:
        XML; write it to a file with the ending `.urdf`.

    Raises:
        UnknownModel: no arm is called that.

    >>> text = to_urdf("UR5e")
    >>> text.splitlines()[1]
    '<robot name="ur5e">'
    """
    arm = arm if isinstance(arm, Arm) else Arm(arm)
    model = arm.model
    root = ElementTree.Element("robot", name=name or model.name.lower().replace(" ", ""))
    ElementTree.SubElement(root, "link", name="base_link")
    parent, origin = "base_link", rigid.IDENTITY
    for i, (link, child, joint) in enumerate(zip(arm.geometry.links, _LINKS, JOINTS, strict=True)):
        # The joint turns about the z axis of the frame before the link. Along that axis a joint may sit anywhere: as in
        # the vendor's description, it sits where the link begins, at the link's offset d.
        origin = rigid.product(origin, rigid.from_pose([0.0, 0.0, link.d, 0.0, 0.0, link.offset]))
        _add_joint(root, model, i, joint, parent, child, origin)
        element = ElementTree.SubElement(root, "link", name=child)
        origin = _end(link)
        _add_inertial(element, model, i, origin)
        parent = child
    ElementTree.SubElement(root, "link", name="tool0")
    fixed = ElementTree.SubElement(root, "joint", name="wrist_3_link-tool0", type="fixed")
    ElementTree.SubElement(fixed, "parent", link=parent)
    ElementTree.SubElement(fixed, "child", link="tool0")
    _add_origin(fixed, origin)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _end(link: Link) -> Rigid[float]:
    """The end of a link in the frame that turns with its joint."""
    ca, sa, cb, sb = link.turns
    return (cb, 0.0, sb, sa * sb, ca, -sa * cb, -ca * sb, sa, ca * cb, link.a, 0.0, 0.0)


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
    limits = {} if endless else {"lower": _number(low), "upper": _number(high)}
    most = {"effort": _number(float(model.max_torque[i])), "velocity": _number(float(model.max_speed[i]))}
    ElementTree.SubElement(joint, "limit", {**limits, **most})


def _add_inertial(element: ElementTree.Element, model: Model, i: int, end: Rigid[float]) -> None:
    # Masses are given in the frame at the end of the link.
    cog = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, *model.link_cogs[i].tolist())
    inertial = ElementTree.SubElement(element, "inertial")
    _add_origin(inertial, rigid.product(end, cog))
    ElementTree.SubElement(inertial, "mass", value=_number(float(model.link_masses[i])))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = model.link_inertias[i].tolist()
    tensor = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ElementTree.SubElement(inertial, "inertia", {key: _number(value) for key, value in tensor.items()})


def _add_origin(element: ElementTree.Element, origin: Rigid[float]) -> None:
    roll, pitch, yaw = rotvec_to_rpy(rigid.rotation_vector(origin)).tolist()
    xyz = " ".join(map(_number, origin[9:]))
    ElementTree.SubElement(element, "origin", xyz=xyz, rpy=" ".join(map(_number, (roll, pitch, yaw))))


def _number(value: float) -> str:
    """With all its digits, and no -0."""
    return repr(value + 0.0)
