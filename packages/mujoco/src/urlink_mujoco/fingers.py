"""Fingers of a gripper: bodies with the dimensions of a Robotiq 2F-85, driven by the simulated controller's gripper.

Two plates slide along the y axis of the flange, always by the same distance. The controller's gripper sets their target
and their maximum force (`FOR`: 20 to 235 N, from the data sheet). If an object blocks them, the gripper is notified of
an object of this width (`SimulatedGripper.place`), so that clients see the same values as of a real gripper. Real
fingers pivot and have soft pads; the shape of these fingers is assumed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from urlink.simulator import Controller

__all__ = ["COG", "MASS", "TCP", "TOOL", "Fingers"]

#: Mass, in kg, and centre of gravity in the flange frame, in m, approximately from the data sheet; pose of the point
#: between the pads, in m and as a rotation vector.
MASS, COG, TCP = 0.925, (0.0, 0.0, 0.058), (0.0, 0.0, 0.145, 0.0, 0.0, 0.0)
#: Distance between the open fingers, in m.
_STROKE = 0.085
#: Force, in N, for `FOR` of 0 and of 255.
_WEAKEST, _STRONGEST = 20.0, 235.0
#: Stiffness of the servo, in N/m, and moving mass of the drive of a finger, in kg (assumed). The damping, in N per m/s,
#: is critical for this mass.
_STIFFNESS, _DRIVE = 20_000.0, 0.8
_DAMPING = 2.0 * (_STIFFNESS * (_DRIVE + 0.1)) ** 0.5
#: Fingers count as blocked if they are behind by the first value, in m, and slower than the second, in m/s, for the
#: third, in s.
_BEHIND, _SLOW, _HELD_FOR = 0.0015, 0.002, 0.01
#: Distance, in m, that fingers must move on from an object until it counts as removed.
_GONE = 0.003

#: The pads have priority, so a grasped object has their friction. They are stiffer than MuJoCo's default. Otherwise the
#: fingers would sink into light objects, because the stiffness of a contact is proportional to the masses in it.
TOOL = f"""
<mujoco>
  <compiler autolimits="true"/>
  <default>
    <geom rgba=".2 .2 .2 1"/>
    <joint type="slide" range="0 {_STROKE / 2}" armature="{_DRIVE}"/>
    <position kp="{_STIFFNESS}" kv="{_DAMPING}" forcerange="-{_WEAKEST} {_WEAKEST}"/>
    <default class="pad"><geom type="box" size=".011 .004 .02" priority="1" friction="1 .02 .001" condim="4"
      solref=".006 1" solimp="0 .99 .001" rgba=".5 .5 .5 1"/></default>
  </default>
  <worldbody>
    <body name="gripper">
      <inertial pos="0 0 .05" mass="{MASS - 0.2}" diaginertia=".001 .001 .0005"/>
      <geom type="box" pos="0 0 .045" size=".035 .06 .045"/>
      <body name="left_finger" pos="0 {_STROKE / 2} .145">
        <inertial pos="0 .004 -.02" mass=".1" diaginertia=".00005 .00005 .00002"/>
        <joint name="left_finger" axis="0 -1 0"/>
        <geom name="left_pad" class="pad" pos="0 .004 0"/>
        <geom type="box" pos="0 .012 -.0275" size=".009 .004 .0275"/>
      </body>
      <body name="right_finger" pos="0 -{_STROKE / 2} .145">
        <inertial pos="0 -.004 -.02" mass=".1" diaginertia=".00005 .00005 .00002"/>
        <joint name="right_finger" axis="0 1 0"/>
        <geom name="right_pad" class="pad" pos="0 -.004 0"/>
        <geom type="box" pos="0 -.012 -.0275" size=".009 .004 .0275"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="left_finger" joint2="right_finger" solref=".004 1"/></equality>
  <actuator>
    <position name="left_finger" joint="left_finger"/>
    <position name="right_finger" joint="right_finger"/>
  </actuator>
</mujoco>
"""


class Fingers:
    """Fingers of one arm.

    Args:
        model: MuJoCo model.
        prefix: Prefix of the names of the arm in the model.
        controller: Controller whose gripper drives the fingers.
    """

    def __init__(self, model: Any, prefix: str, controller: Controller) -> None:
        self._model, self._gripper = model, controller.gripper
        names = f"{prefix}tool/left_finger", f"{prefix}tool/right_finger"
        self._actuators = [model.actuator(name).id for name in names]
        self.dofs = [int(model.joint(name).dofadr[0]) for name in names]
        self._places = [int(model.joint(name).qposadr[0]) for name in names]
        #: position at which an object blocked the fingers, in m from open; direction: 1 if they were closing, -1 if
        #: opening
        self._held: float | None = None
        self._direction = 1.0
        self._waited = 0.0

    def put(self, data: Any) -> None:
        """Put the fingers at the position of the gripper."""
        data.qpos[self._places] = _way(self._gripper.position)

    def command(self, data: Any, seconds: float) -> None:
        """Set the servo's target for the coming cycle, and notify the gripper of a grasped object."""
        registers, place = self._gripper.registers, float(data.qpos[self._places[0]])
        most = _WEAKEST + (_STRONGEST - _WEAKEST) * registers["FOR"] / 255
        asked, goal = _way(registers["POS"]), _way(self._gripper.position)
        if self._held is None:
            is_held_up = abs(goal - place) > _BEHIND and abs(data.qvel[self.dofs[0]]) < _SLOW
            self._waited = self._waited + seconds if is_held_up else 0.0
            if self._waited >= _HELD_FOR:
                self._held, self._direction, self._waited = place, 1.0 if goal > place else -1.0, 0.0
                width = min(max(_STROKE - 2.0 * place, 0.0), _STROKE)
                self._gripper.place(width, inside=goal < place)
        elif self._direction * (asked - self._held) <= 0.0 or self._direction * (place - self._held) > _GONE:
            self._gripper.take_away()
            self._held = None
        if self._held is not None:
            # Apply the requested force, even if the requested position is close to the position of the fingers.
            goal = asked + self._direction * most / _STIFFNESS
        for actuator in self._actuators:
            self._model.actuator_forcerange[actuator] = -most, most
            data.ctrl[actuator] = goal


def _way(position: float) -> float:
    """Return the distance of each finger from open, in m; `position` is 0 to 255."""
    return _STROKE / 2 * position / 255
