"""An arm among the bodies: where it is led, and what acts on it.

The controller leads it: its joints follow the set-points by a position control that knows the masses (computed
torque), as stiff as a spring of the arm's own mass that swings at 16 Hz, and critically damped. So the arm gives way by
some tenths of a millimetre where it presses on something, as a real one does, and what it presses on decides about the
rest. Its friction is taken out here: the controller's own arm has it where the joints are free.

The wrench is what touches anything beyond the joint of wrist 3, averaged over the steps of a cycle and smoothed with
8 ms, as a sensor and its electronics do; what touches the links before is a torque of the joints, smoothed too. Without
that, force mode trembles on what it pushes: it brakes by the change of the force, and contacts answer a change of speed
by one of their force within a step. The weight of the gripper is in neither: the controller is told of it as a load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from urlink.simulator import Reaction, Setpoint
from urlink.urdf import JOINTS

from .fingers import Fingers

if TYPE_CHECKING:
    from urlink.simulator import Controller
    from urlink.vectors import FloatArray

    from .world import MujocoWorld

__all__ = ["MountedArm"]

#: rad/s of the position control: 16 Hz.
_STIFF = 100.0
#: s over which wrench and torques are smoothed.
_SMOOTHED = 0.008
#: Where a contact is felt: nowhere on this arm, in the tool, at a link.
_TOOL, _LINK = 1, 2


class MountedArm:
    """The arm of one controller, as its `Scene`; made by `MujocoWorld`.

    Attributes:
        world: it stands in.
        name: of the arm in it.
        controller: that leads it.
        time: s since it was mounted, by its controller.
    """

    def __init__(self, world: MujocoWorld, name: str, controller: Controller) -> None:
        self.world, self.name, self.controller = world, name, controller
        self.time = 0.0
        model, prefix = world.model, f"{name}/"
        joints = [model.joint(prefix + joint) for joint in JOINTS]
        self._places = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._led = self._dofs
        self._fingers: Fingers | None = None
        if world.has_gripper(controller):
            self._fingers = Fingers(model, prefix, controller)
            self._led = np.concatenate((self._dofs, self._fingers.dofs))
        base = world.data.body(f"{prefix}base_link")
        self._base, self._turn = base.xpos.copy(), base.xmat.reshape(3, 3).copy()
        self._sides = _sides(model, prefix)
        self._wanted = np.zeros(model.nv)
        self._torque = np.zeros(model.nv)
        self._jacobian = np.zeros((3, model.nv))
        # The cycle: where it began and ends, its length, and the time at its end.
        setpoint = controller.arm.setpoint
        self._begin = self._end = _row(setpoint)
        self._seconds = 0.0
        # Sums over the steps since the last call, and what is smoothed: wrench about the origin of the world, torques.
        self._felt, self._steps = np.zeros(12), 0
        self._shown = np.zeros(12)
        self.put()

    def advance(self, setpoint: Setpoint, pose: Sequence[float], seconds: float) -> Reaction:
        """Let a cycle pass, and say what acts on the arm at its end; see `urlink.simulator.Scene`."""
        with self.world.lock:
            self._begin, self._end, self._seconds = self._end, _row(setpoint), seconds
            self.time += seconds
            self.world.advance_to(self.time)
            return self._reaction(pose, seconds)

    def put(self) -> None:
        """Put the arm where the controller has it, at rest; the fingers stay where they are."""
        data = self.world.data
        data.qpos[self._places], data.qvel[self._led] = self._end[0], 0.0

    def lead_fingers(self, seconds: float) -> None:
        """Tell the fingers where to go in the coming seconds."""
        if self._fingers is not None:
            self._fingers.lead(self.world.data, seconds)

    def lead(self, time: float) -> None:
        """Set the torques that lead the arm, where the positions and speeds of this step are known."""
        model, data = self.world.model, self.world.data
        q, qd, qdd = self._target(time)
        off, slow = q - data.qpos[self._places], qd - data.qvel[self._dofs]
        self._wanted[self._dofs] = qdd + _STIFF * (_STIFF * off + 2.0 * slow)
        mujoco.mj_mulM(model, data, self._torque, self._wanted)
        data.qfrc_applied[self._led] = self._torque[self._led] + data.qfrc_bias[self._led]

    def _target(self, time: float) -> FloatArray:
        """(3, 6): positions, speeds and accelerations, by the cubic curve through both ends of the cycle."""
        q, qd, qdd = self._end
        left = self.time - time
        if left <= 0.0 or self._seconds == 0.0:
            return np.stack((q - left * qd, qd, qdd)) if self._seconds else self._end
        (q0, v0, _), t = self._begin, self._seconds
        u = max(1.0 - left / t, 0.0)
        way = q - q0
        a, b = t * (v0 + qd) - 2.0 * way, 3.0 * way - t * (2.0 * v0 + qd)
        place = q0 + u * (t * v0 + u * (b + u * a))
        speed = v0 + u * (2.0 * b + 3.0 * u * a) / t
        return np.stack((place, speed, (2.0 * b + 6.0 * u * a) / t**2))

    # -- what acts on it -----------------------------------------------------------------------------

    def feel(self, geoms: Any) -> None:
        """Add what touches the arm in this step.

        Args:
            geoms: (n, 2) of the contacts.
        """
        self._steps += 1
        sides = self._sides[geoms]
        touching = np.flatnonzero(sides[:, 0] != sides[:, 1])
        if not len(touching):
            return
        model, data, raw = self.world.model, self.world.data, np.zeros(6)
        for i in touching.tolist():
            mujoco.mj_contactForce(model, data, i, raw)
            # On the second geom, in the axes of the contact, which are the rows of its frame.
            sign = 1.0 if sides[i, 1] else -1.0
            contact = data.contact[i]
            axes = contact.frame.reshape(3, 3)
            force, moment = sign * (raw[:3] @ axes), sign * (raw[3:] @ axes)
            if _TOOL in sides[i]:
                self._felt[:3] += force
                self._felt[3:6] += moment + np.cross(contact.pos, force)
            else:
                body = model.geom_bodyid[geoms[i, 1 if sides[i, 1] else 0]]
                mujoco.mj_jac(model, data, self._jacobian, None, contact.pos, body)
                self._felt[6:] += force @ self._jacobian[:, self._dofs]

    def _reaction(self, pose: Sequence[float], seconds: float) -> Reaction:
        """What was felt since the last call, smoothed."""
        if self._steps:
            self._shown += (1.0 - math.exp(-seconds / _SMOOTHED)) * (self._felt / self._steps - self._shown)
            self._shown[np.abs(self._shown) < 1e-9] = 0.0
            self._felt, self._steps = np.zeros(12), 0
        if not self._shown.any():
            return Reaction((0.0,) * 6)
        turn, felt = self._turn, self._shown
        force = turn.T @ felt[:3]
        moment = turn.T @ (felt[3:6] - np.cross(self._base, felt[:3])) - np.cross(pose[:3], force)
        return Reaction((*force.tolist(), *moment.tolist()), felt[6:].tolist())


def _row(setpoint: Setpoint) -> FloatArray:
    return np.array((setpoint.q, setpoint.qd, setpoint.qdd))


def _sides(model: Any, prefix: str) -> Any:
    """Of each geom, on which side of the wrist it is: (ngeom,) small integers."""
    bodies = np.zeros(model.nbody, dtype=np.int8)
    for body in range(1, model.nbody):
        name = model.body(body).name
        if name == f"{prefix}wrist_3_link" or bodies[model.body_parentid[body]] == _TOOL:
            bodies[body] = _TOOL
        elif name.startswith(prefix):
            bodies[body] = _LINK
    return bodies[model.geom_bodyid]
