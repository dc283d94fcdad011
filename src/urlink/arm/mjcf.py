"""Conversion of an arm to MJCF, the description format of the physics engine MuJoCo.

Links and joints have the names and frames of `urlink.urdf`, with the same geometry, limits, masses and inertias. MJCF
also contains values for which URDF has no place: the inertia of each rotor, as `armature`, and the friction of motors
and gears (`urlink.arm.motors`), as `frictionloss` and `damping`. The shapes are similar to those of `urlink.urdf`: they
follow the geometry of the arm, but they neither look like the arm nor enclose it.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np

from . import rigid
from .dynamics import GRAVITY
from .kinematics import Arm
from .models import Model
from .motors import Motors, motors_of
from .poses import rotvec_to_quaternion
from .rigid import Rigid
from .urdf import JOINTS, LINKS, RADIUS, link_frames, numbers


def to_mjcf(
    arm: Arm | Model | str, *, name: str | None = None, motors: Motors | None = None, shapes: bool = False
) -> str:
    """Return the arm as the text of an MJCF file.

    Args:
        arm: Calibrated or published `Arm`, `Model`, or name of a model.
        name: Name of the model in the file; by default the name of the arm in lower case.
        motors: Motors of the joints; None for the motors of the model.
        shapes: Whether the links have spheres and capsules for collisions. Neighbouring links also collide with each
            other.

    Returns:
        Text of an XML file, which should have the ending `.xml`. The site `tool0` is the flange as the controller
        reports it. Each joint has a motor with the same name. The control input of a motor is a torque in Nm.

    Raises:
        UnknownModel: If no arm has this name.

    >>> text = to_mjcf("UR10e")
    >>> text.splitlines()[1], text.count("armature=")
    ('<mujoco model="ur10e">', 6)
    """
    arm = arm if isinstance(arm, Arm) else Arm(arm)
    model, known = arm.model, motors or motors_of(arm.model)
    root = ElementTree.Element("mujoco", model=name or model.name.lower().replace(" ", ""))
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true")
    ElementTree.SubElement(root, "option", gravity=f"0 0 {-GRAVITY}")
    parent = ElementTree.SubElement(ElementTree.SubElement(root, "worldbody"), "body", name="base_link")
    actuators = ElementTree.SubElement(root, "actuator")
    end = rigid.IDENTITY
    for i, (origin, end) in enumerate(link_frames(arm)):
        if shapes:
            _add_shapes(parent, origin)
        parent = ElementTree.SubElement(parent, "body", {"name": LINKS[i], **_place(origin)})
        _add_inertial(parent, model, i, end)
        _add_joint(parent, model, known, i)
        most = float(model.max_torque[i])
        ElementTree.SubElement(actuators, "motor", name=JOINTS[i], joint=JOINTS[i], ctrlrange=numbers(-most, most))
    if shapes:
        _add_shapes(parent, end)
    ElementTree.SubElement(parent, "site", {"name": "tool0", **_place(end)})
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _add_shapes(body: ElementTree.Element, end: Rigid[float]) -> None:
    """Add a sphere at the beginning of a link, and a capsule from there to the end of the link."""
    ElementTree.SubElement(body, "geom", type="sphere", size=numbers(RADIUS))
    if math.hypot(*end[9:]) >= RADIUS:
        way = numbers(0.0, 0.0, 0.0, *end[9:])
        ElementTree.SubElement(body, "geom", type="capsule", size=numbers(0.8 * RADIUS), fromto=way)


def _add_joint(body: ElementTree.Element, model: Model, motors: Motors, i: int) -> None:
    constant = motors.torque_constants[i]
    joint = ElementTree.SubElement(body, "joint", name=JOINTS[i], type="hinge", axis="0 0 1")
    low, high = model.position_limits[i].tolist()
    if not math.isinf(high):
        joint.set("range", numbers(low, high))
    joint.set("armature", numbers(motors.rotor_inertias[i]))
    joint.set("frictionloss", numbers(constant * motors.coulomb[i]))
    joint.set("damping", numbers(constant * motors.viscous[i]))


def _add_inertial(body: ElementTree.Element, model: Model, i: int, end: Rigid[float]) -> None:
    # The model gives the centre of mass and the inertia in the frame at the end of the link. MJCF needs them in the
    # frame of the body, which is at the beginning of the link.
    turn = np.array(end[:9]).reshape(3, 3)
    x, y, z = (turn @ model.link_cogs[i] + np.array(end[9:])).tolist()
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (turn @ model.link_inertias[i] @ turn.T).tolist()
    inertial = ElementTree.SubElement(body, "inertial", pos=numbers(x, y, z))
    inertial.set("mass", numbers(float(model.link_masses[i])))
    inertial.set("fullinertia", numbers(xx, yy, zz, xy, xz, yz))


def _place(frame: Rigid[float]) -> dict[str, str]:
    x, y, z, w = rotvec_to_quaternion(rigid.rotation_vector(frame)).tolist()
    return {"pos": numbers(*frame[9:]), "quat": numbers(w, x, y, z)}
