"""The world: a scene file of MuJoCo with the arms of one or several controllers in it.

Time is that of the controllers: in each of their cycles the world goes on by the same time, in equal steps of at most a
millisecond. With several controllers the world goes with the one whose time is ahead, so that one that reboots or is
stepped less holds nobody up. Nothing is random: the same file, controllers and calls give the same states to the last
bit, on the same computer with the same release of MuJoCo.

In the file:

- a site of an arm's name (`arm`, if there is one) is its base frame; without one, that is the origin;
- friction is that of elliptic cones, and the integrator `implicitfast`; both are set here, whatever the file says.
  MuJoCo has pyramids as default, on which things slide easier along one direction than along another, and a part creeps
  out of a grasp unless the friction is stiffer than the normal force (`impratio`, here at least 10);
- a geom that has MuJoCo's own `solimp` begins its contacts without force. As that is, 90 % of the stiffness are there
  at a depth of 0, so that contacts that come and go push by jerks: a box of 2 kg that is pushed at 0.05 m/s answers
  with 7 +- 2.4 N along and +- 5 N across, and so with 5.89 N and less than 0.02 N.
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

#: s, the longest step.
_STEP = 1e-3
#: `solimp`: what MuJoCo has unless a file says otherwise, and what is put in its place.
_ABRUPT, _GRADUAL = (0.9, 0.95, 0.001, 0.5, 2.0), (0.0, 0.95, 0.001, 0.5, 2.0)


class MujocoWorld:
    """Bodies, and the arms among them.

    Args:
        scene: the MJCF file.
        arms: a controller, whose arm is called "arm", or several by the names of their arms. Their scene is this world
            from now on; a gripper is mounted if the controller has one, and if TCP and payload are still zero they
            become those of the gripper, as in an installation.

    Attributes:
        arms: the arms by name.
        model, data: of MuJoCo. While controllers run, read them under `lock`.
        lock: held while the world moves.

    Raises:
        LocalError: MuJoCo cannot read the file, or not with these arms in it.
        BadValue: no arm, or a name that is no identifier.
    """

    def __init__(self, scene: str | os.PathLike[str], arms: Controller | Mapping[str, Controller]) -> None:
        controllers = dict(arms) if isinstance(arms, Mapping) else {"arm": arms}
        if not controllers or not all(name.isidentifier() for name in controllers):
            raise BadValue(f"a world has arms with names such as 'left', not {list(controllers)!r}")
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
        """Whether a controller has a gripper, which is mounted then."""
        try:
            return controller.gripper is not None
        except LocalError:
            return False

    # -- time ----------------------------------------------------------------------------------------

    def advance_to(self, time: float) -> None:
        """Let time pass up to that of an arm, s; the lock is held."""
        seconds = time - self._time
        if seconds < 1e-9:
            return
        model, data, arms = self.model, self.data, self.arms.values()
        steps = max(math.ceil(seconds / _STEP - 1e-6), 1)
        model.opt.timestep = step = seconds / steps
        times = self._time + step * np.arange(steps)
        for arm in arms:
            arm.lead_fingers(seconds)
            arm.plan(times)
        for i in range(steps):
            mujoco.mj_step1(model, data)
            for arm in arms:
                arm.lead(i)
            mujoco.mj_step2(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            for arm in arms:
                arm.feel()
        self._time = time

    # -- state ---------------------------------------------------------------------------------------

    def state(self) -> NDArray[np.float64]:
        """All that MuJoCo goes on from, as numbers for `reset`."""
        with self.lock:
            state = np.zeros(mujoco.mj_stateSize(self.model, STATE))
            mujoco.mj_getState(self.model, self.data, state, STATE)
        return state

    def reset(self, state: NDArray[np.float64] | None = None) -> None:
        """Put everything but the arms where it was in a state, or in the beginning.

        Controllers go on: an arm is where its controller has it, and its gripper has been told what it has been told.

        Raises:
            BadValue: not a state of this world.
        """
        with self.lock:
            wanted = self._first if state is None else np.asarray(state, dtype=np.float64)
            if wanted.shape != self._first.shape:
                raise BadValue(f"a state of this world has {self._first.size} numbers, not {wanted.shape}")
            mujoco.mj_setState(self.model, self.data, wanted, STATE)
            for arm in self.arms.values():
                arm.put()
            mujoco.mj_forward(self.model, self.data)

    def pose(self, body: str) -> NDArray[np.float64]:
        """The pose of a body in the world, (6,): m, and rotation vector in rad.

        Raises:
            BadValue: no such body.
        """
        with self.lock:
            found = self._body(body)
            mujoco.mj_kinematics(self.model, self.data)
            w, x, y, z = found.xquat
            return np.array((*found.xpos, *quaternion_to_rotvec((x, y, z, w))))

    def place(self, body: str, pose: Sequence[float]) -> None:
        """Put a body with a free joint at a pose in the world, (6,), at rest.

        Raises:
            BadValue: no such body, it has no free joint, or not six finite numbers.
        """
        numbers = np.asarray(pose, dtype=np.float64)
        if numbers.shape != (6,) or not np.isfinite(numbers).all():
            raise BadValue(f"a pose is six finite numbers, not {pose!r}")
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
            raise BadValue(f"no body is called {name!r}; there are {known}") from None

    # -- pictures ------------------------------------------------------------------------------------

    def picture(
        self, camera: str, *, width: int = 640, height: int = 480, depth: bool = False
    ) -> NDArray[np.uint8] | NDArray[np.float32]:
        """What a camera of the file sees: (height, width, 3) of 0 to 255, or with `depth` (height, width) m.

        From any thread. MuJoCo draws with OpenGL, by `MUJOCO_GL=egl` without a screen.

        Raises:
            BadValue: no such camera.
            LocalError: there is no OpenGL, or the picture is larger than the file allows (`offwidth`, `offheight`).
        """
        if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_CAMERA, camera) < 0:
            known = ", ".join(self.model.camera(i).name for i in range(self.model.ncam)) or "none"
            raise BadValue(f"no camera is called {camera!r}; there is {known}")
        try:
            return self._drawing.picture(self.state(), camera, (height, width), depth)
        except Exception as error:  # of OpenGL, of its platform, of MuJoCo: each has its own
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
        # The controller's arm has the friction, and stops before the ends of its joints.
        joint.frictionloss, joint.limited = 0.0, mujoco.mjtLimited.mjLIMITED_FALSE
        joint.damping = np.zeros_like(joint.damping)
    if has_gripper:
        arm.attach(mujoco.MjSpec.from_string(TOOL), site=arm.site("tool0"), prefix="tool/")
    arm.option.gravity = spec.option.gravity
    # An arm does not touch itself, but all others: things have the first bit as default.
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
