"""An arm among the bodies: where it is led, and what acts on it.

The controller leads it: its joints follow the set-points by a position control that knows the masses (computed
torque), as stiff as a spring of the arm's own mass that swings at 16 Hz, and critically damped. So the arm gives way by
some tenths of a millimetre where it presses on something, as a real one does, and what it presses on decides about the
rest. Its friction is taken out here: the controller's own arm has it where the joints are free.

The wrench is what touches anything beyond the joint of wrist 3, averaged over the steps of a cycle and smoothed with
20 ms, as sensors and their electronics do; what touches the links before is a torque of the joints, smoothed too.
Without that, force mode trembles: it brakes by the change of the force, and contacts answer a change of speed by one of
their force within a step. At 8 ms it still does on a table (30 +- 5 N at 166 Hz); a box of 2 kg is pushed calmly then.
The weight of the gripper is in neither: the controller is told of it as a load.
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

#: rad/s of the position control: 16 Hz.
_STIFF = 100.0
#: s over which wrench and torques are smoothed.
_SMOOTHED = 0.02


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
            self._fingers.put(world.data)
            self._led = np.concatenate((self._dofs, self._fingers.dofs))
        base = world.data.body(f"{prefix}base_link")
        # From the world to the base frame.
        self._base, self._turn, self._root = base.xpos.copy(), base.xmat.reshape(3, 3).T.copy(), base.id
        links = [model.body(prefix + link).id for link in LINKS]
        self._links, self._tool = np.array(links[:5]), np.array(_subtree(model, links[5]))
        self._wanted = np.zeros(model.nv)
        self._torque = np.zeros(model.nv)
        self._targets = np.zeros((3, 1, 6))
        # The cycle: where it began and ends, its length, and the time at its end.
        setpoint = controller.arm.setpoint
        self._begin = self._end = _row(setpoint)
        self._seconds = 0.0
        # Sums over the steps since the last call, and what is smoothed: moments, forces, torques.
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

    def plan(self, times: NDArray[np.floating[Any]]) -> None:
        """Prepare for steps that begin at these times of the world, s: on the cubic curve through both ends of the
        cycle, and on from there at the same speed."""
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

    def lead(self, step: int) -> None:
        """Set the torques that lead the arm in a planned step, whose positions and speeds are known."""
        model, data = self.world.model, self.world.data
        q, qd, qdd = self._targets[:, step]
        off, slow = q - data.qpos[self._places], qd - data.qvel[self._dofs]
        self._wanted[self._dofs] = qdd + _STIFF * (_STIFF * off + 2.0 * slow)
        mujoco.mj_mulM(model, data, self._torque, self._wanted)
        data.qfrc_applied[self._led] = self._torque[self._led] + data.qfrc_bias[self._led]

    # -- what acts on it -----------------------------------------------------------------------------

    def feel(self) -> None:
        """Add what touches the arm in this step: forces in MuJoCo's frame of its tree, about the centre of its mass."""
        data = self.world.data
        self._steps += 1
        self._felt[:6] += data.cfrc_ext[self._tool].sum(0)
        touched = data.cfrc_ext[self._links]
        if touched.any():
            # On each joint: all that touches the links from it on.
            beyond = touched[::-1].cumsum(0)[::-1]
            self._felt[6:11] += (beyond * data.cdof[self._dofs[:5]]).sum(1)

    def _reaction(self, pose: Sequence[float], seconds: float) -> Reaction:
        """What was felt since the last call, smoothed."""
        if self._steps:
            self._shown += (1.0 - math.exp(-seconds / _SMOOTHED)) * (self._felt / self._steps - self._shown)
            self._shown[np.abs(self._shown) < 1e-9] = 0.0
            self._felt, self._steps = np.zeros(12), 0
        if not self._shown.any():
            return Reaction((0.0,) * 6)
        # MuJoCo has moments before forces.
        x, y, z = (self._turn @ self._shown[3:6]).tolist()
        mx, my, mz = (self._turn @ self._shown[:3]).tolist()
        # From the centre to the TCP.
        centre = self._turn @ (self.world.data.subtree_com[self._root] - self._base)
        cx, cy, cz = (c - p for c, p in zip(centre.tolist(), pose[:3], strict=True))
        moment = (mx + cy * z - cz * y, my + cz * x - cx * z, mz + cx * y - cy * x)
        return Reaction((x, y, z, *moment), self._shown[6:].tolist())


def _row(setpoint: Setpoint) -> NDArray[np.float64]:
    return np.array((setpoint.q, setpoint.qd, setpoint.qdd))


def _subtree(model: Any, root: int) -> list[int]:
    """A body and all that hang on it, of which each has a larger number than what it hangs on."""
    found = [root]
    for body in range(root + 1, model.nbody):
        if model.body_parentid[body] in found:
            found.append(body)
    return found
