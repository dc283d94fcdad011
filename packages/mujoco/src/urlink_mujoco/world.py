"""World of a MuJoCo scene file, with the arms of one or several controllers.

The controllers define the time: in each of their cycles, the world advances by the same time, in equal steps of at most
one millisecond. With several controllers, the world follows the controller whose time is furthest ahead. So a
controller that reboots, or is stepped less often, does not delay the others. Nothing is random: the same file,
controllers and calls give the same states to the last bit, on the same computer with the same release of MuJoCo.

These rules apply to the file:

- A site with the name of an arm (`arm` for a single arm) is its base frame. Without such a site, the base frame is at
  the origin.
- The friction cones are elliptic, and the integrator is `implicitfast`. Both are set here and override the file. With
  MuJoCo's default, pyramids, objects slide more easily in one direction than in another. A part creeps out of a grasp
  unless the friction is stiffer than the normal force, so `impratio` is at least 10.
- If a geom has MuJoCo's default `solimp`, this value is replaced, so that the force of a contact starts at zero. With
  the default, 90 % of the stiffness apply at a depth of 0, so contacts that come and go push in jerks. A box of 2 kg
  that is pushed at 0.05 m/s then answers with 7 +- 2.4 N along and +- 5 N across; with the change, it is 5.89 N and
  less than 0.02 N.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from urlink import BadValue, LocalError
from urlink.arm.mjcf import to_mjcf
from urlink.arm.poses import quaternion_to_rotvec, rotvec_to_quaternion

from .arms import MountedArm
from .drawing import STATE, Drawing
from .fingers import COG, MASS, TCP, TOOL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from urlink.simulator import Controller

__all__ = ["MujocoWorld"]

#: Longest step, in s.
_STEP = 1e-3
#: `solimp`: MuJoCo's default, and the value that replaces it.
_ABRUPT, _GRADUAL = (0.9, 0.95, 0.001, 0.5, 2.0), (0.0, 0.95, 0.001, 0.5, 2.0)


class MujocoWorld:
    """Bodies, and the arms among them.

    Args:
        scene: Path of the MJCF file.
        arms: A controller, whose arm is named "arm", or several controllers by the names of their arms. This world
            becomes their scene. A gripper is mounted if the controller has one. If TCP and payload are still zero, they
            are set to the values of the gripper, as in an installation.

    Attributes:
        arms: Arms by name.
        model, data: MuJoCo's model and data. While controllers run, read them only under `lock`.
        lock: Lock that is held while the world moves.

    Raises:
        LocalError: If MuJoCo cannot read the file, or cannot combine it with these arms.
        BadValue: If there is no arm, or a name is not an identifier.
    """

    def __init__(self, scene: str | os.PathLike[str], arms: Controller | Mapping[str, Controller]) -> None:
        controllers = dict(arms) if isinstance(arms, Mapping) else {"arm": arms}
        if not controllers or not all(name.isidentifier() for name in controllers):
            raise BadValue(f"arms are named {list(controllers)!r}; expected at least one identifier such as 'left'")
        self.lock = threading.RLock()
        self.model = _compiled(os.fspath(scene), controllers, self.has_gripper)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self._time = 0.0
        self._drawing = Drawing(self.model)
        self.arms = {name: MountedArm(self, name, controller) for name, controller in controllers.items()}
        mujoco.mj_forward(self.model, self.data)
        self._first = self.state()
        for arm in self.arms.values():
            arm.controller.call(partial(_mount, arm, self.has_gripper(arm.controller)))

    @staticmethod
    def has_gripper(controller: Controller) -> bool:
        """Whether a controller has a gripper. If it has, the gripper is mounted."""
        try:
            return controller.gripper is not None
        except LocalError:
            return False

    # -- time ----------------------------------------------------------------------------------------

    def advance_to(self, time: float) -> None:
        """Advance the world to the time of an arm, in s. The lock must be held."""
        seconds = time - self._time
        if seconds < 1e-9:
            return
        model, data, arms = self.model, self.data, self.arms.values()
        steps = max(math.ceil(seconds / _STEP - 1e-6), 1)
        model.opt.timestep = step = seconds / steps
        times = self._time + step * np.arange(steps)
        for arm in arms:
            arm.command_fingers(seconds)
            arm.plan(times)
        for i in range(steps):
            mujoco.mj_step1(model, data)
            for arm in arms:
                arm.drive(i)
            mujoco.mj_step2(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            for arm in arms:
                arm.feel()
        self._time = time

    # -- state ---------------------------------------------------------------------------------------

    def state(self) -> NDArray[np.float64]:
        """Return MuJoCo's complete state as numbers for `reset`."""
        with self.lock:
            state = np.zeros(mujoco.mj_stateSize(self.model, STATE))
            mujoco.mj_getState(self.model, self.data, state, STATE)
        return state

    def reset(self, state: NDArray[np.float64] | None = None) -> None:
        """Restore everything except the arms to a state, or to the first state.

        Controllers are not reset: each arm stays at its controller's position, and each gripper keeps its commands.

        Raises:
            BadValue: If `state` is not a state of this world.
        """
        with self.lock:
            wanted = self._first if state is None else np.asarray(state, dtype=np.float64)
            if wanted.shape != self._first.shape:
                raise BadValue(f"state has shape {wanted.shape}; expected ({self._first.size},), a state of this world")
            mujoco.mj_setState(self.model, self.data, wanted, STATE)
            for arm in self.arms.values():
                arm.put()
            mujoco.mj_forward(self.model, self.data)

    def pose(self, body: str) -> NDArray[np.float64]:
        """Return the pose of a body in the world, shape (6,): m, and rotation vector in rad.

        Raises:
            BadValue: If the body does not exist.
        """
        with self.lock:
            found = self._body(body)
            mujoco.mj_kinematics(self.model, self.data)
            w, x, y, z = found.xquat
            return np.array((*found.xpos, *quaternion_to_rotvec((x, y, z, w))))

    def place(self, body: str, pose: Sequence[float]) -> None:
        """Put a body with a free joint at a pose in the world, shape (6,), at rest.

        Raises:
            BadValue: If the body does not exist or has no free joint, or `pose` is not six finite numbers.
        """
        numbers = np.asarray(pose, dtype=np.float64)
        if numbers.shape != (6,) or not np.isfinite(numbers).all():
            raise BadValue(f"pose={pose!r}; expected six finite numbers")
        with self.lock:
            joint = int(self.model.body_jntadr[self._body(body).id])
            if joint < 0 or self.model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
                raise BadValue(f"{body} has no free joint, so it cannot be placed")
            at, dof = int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])
            x, y, z, w = rotvec_to_quaternion(numbers[3:])
            self.data.qpos[at : at + 7] = *numbers[:3], w, x, y, z
            self.data.qvel[dof : dof + 6] = 0.0
            mujoco.mj_forward(self.model, self.data)

    def _body(self, name: str) -> Any:
        try:
            return self.data.body(name)
        except KeyError:
            known = ", ".join(filter(None, (self.model.body(i).name for i in range(1, self.model.nbody))))
            raise BadValue(f"unknown body {name!r}; expected one of {known}") from None

    # -- images --------------------------------------------------------------------------------------

    def picture(
        self, camera: str, *, width: int = 640, height: int = 480, depth: bool = False
    ) -> NDArray[np.uint8] | NDArray[np.float32]:
        """Return the image of a camera, shape (height, width, 3), with values of 0 to 255.

        With `depth`, return distances in m, shape (height, width). This can be called from any thread. MuJoCo draws
        with OpenGL; without a screen, set `MUJOCO_GL=egl`.

        Raises:
            BadValue: If the camera does not exist.
            LocalError: If there is no OpenGL, or the image is larger than the file allows (`offwidth`, `offheight`).
        """
        if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_CAMERA, camera) < 0:
            known = ", ".join(self.model.camera(i).name for i in range(self.model.ncam)) or "none"
            raise BadValue(f"unknown camera {camera!r}; expected one of {known}")
        try:
            return self._drawing.picture(self.state(), camera, (height, width), depth)
        except Exception as error:  # OpenGL, its platform and MuJoCo each raise their own errors
            raise LocalError(f"MuJoCo cannot draw {width} x {height}: {error}") from error

    def __repr__(self) -> str:
        return f"<MujocoWorld {list(self.arms)}, {self.model.nbody} bodies>"


def _compiled(scene: str, controllers: Mapping[str, Controller], has_gripper: Any) -> Any:
    try:
        spec = mujoco.MjSpec.from_file(scene)
        for i, (name, controller) in enumerate(controllers.items()):
            _attach(spec, name, controller, i, has_gripper(controller))
        for geom in spec.geoms:
            if np.array_equal(geom.solimp, _ABRUPT):
                geom.solimp = _GRADUAL
        option = spec.option
        option.cone, option.integrator = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        option.impratio = max(option.impratio, 10.0)
        return spec.compile()
    except (ValueError, OSError, mujoco.FatalError) as error:
        raise LocalError(f"{scene}: {error}") from error


def _attach(spec: Any, name: str, controller: Controller, number: int, has_gripper: bool) -> None:
    arm = mujoco.MjSpec.from_string(to_mjcf(controller.arm.kinematics, motors=controller.arm.motors, shapes=True))
    for actuator in list(arm.actuators):
        arm.delete(actuator)
    for joint in arm.joints:
        # The controller's arm has the friction, and stops before the limits of its joints.
        joint.frictionloss, joint.limited = 0.0, mujoco.mjtLimited.mjLIMITED_FALSE
        joint.damping = np.zeros_like(joint.damping)
    if has_gripper:
        arm.attach(mujoco.MjSpec.from_string(TOOL), site=arm.site("tool0"), prefix="tool/")
    arm.option.gravity = spec.option.gravity
    # An arm does not touch itself, but touches everything else: other bodies have the first bit by default.
    own = 1 << (number + 1)
    for geom in arm.geoms:
        geom.contype, geom.conaffinity = own, 0x7FFFFFFF & ~own
    place = spec.site(name) or spec.worldbody.add_site(name=name)
    spec.attach(arm, site=place, prefix=f"{name}/")


def _mount(arm: MountedArm, has_gripper: bool) -> None:
    controller = arm.controller
    if has_gripper:
        controller.world.carry(MASS, COG)
        if not any(controller.arm.tcp):
            controller.arm.tcp = list(TCP)
        if controller.arm.payload == 0.0:
            controller.arm.payload, controller.arm.payload_cog = MASS, COG
    controller.world.scene = arm
