"""An arm among the bodies: position control of its joints, and measurement of the contact forces.

The controller commands the arm. Its joints follow the set-points with a position control that includes the masses
(computed torque). The control is as stiff as a spring on which the arm's own mass would oscillate at 16 Hz, and it is
critically damped. So an arm that presses on an object yields by some tenths of a millimetre, like a real arm, and the
rest depends on the object. The joints have no friction here, because the controller's own model of the arm includes it
when joints are free.

The wrench contains all contacts beyond the joint of wrist 3. It is averaged over the steps of a cycle, and smoothed
with 20 ms, similar to sensors and their electronics. Contacts of the earlier links are torques of the joints, which are
smoothed too. Without smoothing, force mode oscillates: it brakes according to the change of the force, and a contact
answers a change of speed with a change of force within one step. With cycles of 8 ms, force mode still oscillates on a
table (30 +- 5 N at 166 Hz), but pushes a box of 2 kg steadily. The weight of the gripper is neither in the wrench nor
in the torques, because the controller receives it as a load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from urlink.arm.urdf import JOINTS, LINKS
from urlink.simulator import Reaction, Setpoint

from .fingers import Fingers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from urlink.simulator import Controller

    from .world import MujocoWorld

__all__ = ["MountedArm"]

#: Natural frequency of the position control, in rad/s: 16 Hz.
_STIFF = 100.0
#: Time constant, in s, for smoothing wrench and torques.
_SMOOTHED = 0.02


class MountedArm:
    """Arm of one controller, as its `Scene`; made by `MujocoWorld`.

    Attributes:
        world: World that contains the arm.
        name: Name of the arm in the world.
        controller: Controller of the arm.
        time: Time, in s, since the arm was mounted, by the controller's clock.
    """

    def __init__(self, world: MujocoWorld, name: str, controller: Controller) -> None:
        self.world, self.name, self.controller = world, name, controller
        self.time = 0.0
        model, prefix = world.model, f"{name}/"
        joints = [model.joint(prefix + joint) for joint in JOINTS]
        self._places = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._driven = self._dofs
        self._fingers: Fingers | None = None
        if world.has_gripper(controller):
            self._fingers = Fingers(model, prefix, controller)
            self._fingers.put(world.data)
            self._driven = np.concatenate((self._dofs, self._fingers.dofs))
        base = world.data.body(f"{prefix}base_link")
        # rotation from the world to the base frame
        self._base, self._turn, self._root = base.xpos.copy(), base.xmat.reshape(3, 3).T.copy(), base.id
        links = [model.body(prefix + link).id for link in LINKS]
        self._links, self._tool = np.array(links[:5]), np.array(_subtree(model, links[5]))
        self._wanted = np.zeros(model.nv)
        self._torque = np.zeros(model.nv)
        self._targets = np.zeros((3, 1, 6))
        # The cycle: set-points at its start and its end, and its length.
        setpoint = controller.arm.setpoint
        self._begin = self._end = _row(setpoint)
        self._seconds = 0.0
        # Sums over the steps since the last call, and their smoothed values: moments, forces, torques.
        self._felt, self._steps = np.zeros(12), 0
        self._shown = np.zeros(12)
        self.put()

    def advance(self, setpoint: Setpoint, pose: Sequence[float], seconds: float) -> Reaction:
        """Advance the world by one cycle and return the reaction; see `urlink.simulator.Scene`."""
        with self.world.lock:
            self._begin, self._end, self._seconds = self._end, _row(setpoint), seconds
            self.time += seconds
            self.world.advance_to(self.time)
            return self._reaction(pose, seconds)

    def put(self) -> None:
        """Put the arm at its controller's position, at rest; the fingers stay where they are."""
        data = self.world.data
        data.qpos[self._places], data.qvel[self._driven] = self._end[0], 0.0

    def command_fingers(self, seconds: float) -> None:
        """Command the fingers for the coming `seconds`."""
        if self._fingers is not None:
            self._fingers.command(self.world.data, seconds)

    def plan(self, times: NDArray[np.floating[Any]]) -> None:
        """Prepare steps that begin at these times of the world, in s.

        The set-points lie on the cubic curve through both ends of the cycle, and continue after it at the same speed.
        """
        (q0, v0, _), (q, qd, qdd), t = self._begin, self._end, self._seconds
        left = (self.time - times)[:, np.newaxis]
        later = np.minimum(left, 0.0)
        if t == 0.0:
            self._targets = np.stack((q - later * qd, qd + 0.0 * left, qdd + 0.0 * left))
            return
        u = np.clip(1.0 - left / t, 0.0, 1.0)
        way = q - q0
        a, b = t * (v0 + qd) - 2.0 * way, 3.0 * way - t * (2.0 * v0 + qd)
        self._targets = np.stack(
            (
                q0 + u * (t * v0 + u * (b + u * a)) - later * qd,
                v0 + u * (2.0 * b + 3.0 * u * a) / t,
                (2.0 * b + 6.0 * u * a) / t**2,
            )
        )

    def drive(self, step: int) -> None:
        """Set the torques that drive the arm in a planned step, with known positions and speeds."""
        model, data = self.world.model, self.world.data
        q, qd, qdd = self._targets[:, step]
        off, slow = q - data.qpos[self._places], qd - data.qvel[self._dofs]
        self._wanted[self._dofs] = qdd + _STIFF * (_STIFF * off + 2.0 * slow)
        mujoco.mj_mulM(model, data, self._torque, self._wanted)
        data.qfrc_applied[self._driven] = self._torque[self._driven] + data.qfrc_bias[self._driven]

    # -- contact forces ------------------------------------------------------------------------------

    def feel(self) -> None:
        """Add the contact forces of this step, about the centre of mass of the tree in MuJoCo."""
        data = self.world.data
        self._steps += 1
        self._felt[:6] += data.cfrc_ext[self._tool].sum(0)
        touched = data.cfrc_ext[self._links]
        if touched.any():
            # The torque of a joint comes from all contacts on the links beyond it.
            beyond = touched[::-1].cumsum(0)[::-1]
            self._felt[6:11] += (beyond * data.cdof[self._dofs[:5]]).sum(1)

    def _reaction(self, pose: Sequence[float], seconds: float) -> Reaction:
        """Return the contact forces since the last call, smoothed."""
        if self._steps:
            self._shown += (1.0 - math.exp(-seconds / _SMOOTHED)) * (self._felt / self._steps - self._shown)
            self._shown[np.abs(self._shown) < 1e-9] = 0.0
            self._felt, self._steps = np.zeros(12), 0
        if not self._shown.any():
            return Reaction((0.0,) * 6)
        # MuJoCo lists moments before forces.
        x, y, z = (self._turn @ self._shown[3:6]).tolist()
        mx, my, mz = (self._turn @ self._shown[:3]).tolist()
        # Move the moment from the centre of mass to the TCP.
        centre = self._turn @ (self.world.data.subtree_com[self._root] - self._base)
        cx, cy, cz = (c - p for c, p in zip(centre.tolist(), pose[:3], strict=True))
        moment = (mx + cy * z - cz * y, my + cz * x - cx * z, mz + cx * y - cy * x)
        return Reaction((x, y, z, *moment), self._shown[6:].tolist())


def _row(setpoint: Setpoint) -> NDArray[np.float64]:
    return np.array((setpoint.q, setpoint.qd, setpoint.qdd))


def _subtree(model: Any, root: int) -> list[int]:
    """Return a body and all its descendants; a descendant has a larger number than its parent."""
    found = [root]
    for body in range(root + 1, model.nbody):
        if model.body_parentid[body] in found:
            found.append(body)
    return found
