"""Kinematics and dynamics compared with the third-party libraries ur-analytic-ik, Pinocchio and MuJoCo.

`nox -f nightly.py -s kinematics` installs them. In other environments, tests of missing libraries are skipped.
"""

from __future__ import annotations

import contextlib
import importlib
import math
from typing import Any

import numpy as np
import pytest

from tests.urlink.arm.arms import calibrated
from urlink.arm.dynamics import GRAVITY, Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.mjcf import to_mjcf
from urlink.arm.models import MODELS
from urlink.arm.motors import motors_of
from urlink.arm.poses import from_matrix, to_matrix
from urlink.arm.urdf import to_urdf

EVERY = pytest.mark.parametrize("name", MODELS)
BOTH = pytest.mark.parametrize("is_calibrated", [False, True], ids=["published", "calibrated"])
ROWS = 300

# The first import of MuJoCo starts a process that looks for glfw. Import it here, because a test must not start one.
with contextlib.suppress(ImportError):
    importlib.import_module("mujoco")


def postures(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (ROWS, 6))


class TestAnalytic:
    """Comparison with ur-analytic-ik, a closed-form solution in C++."""

    @pytest.fixture
    def theirs(self, name: str) -> Any:
        module: Any = pytest.importorskip("ur_analytic_ik")
        return getattr(module, name.lower().replace(" ", ""))

    def test_ur_analytic_ik_has_every_arm_of_the_library(self) -> None:
        module: Any = pytest.importorskip("ur_analytic_ik")
        assert {arm for arm in dir(module) if arm.startswith("ur")} == {
            name.lower().replace(" ", "") for name in MODELS
        }

    @EVERY
    def test_forward_kinematics_equals_ur_analytic_ik(self, theirs: Any, name: str) -> None:
        q = postures(1)
        expected = np.array([theirs.forward_kinematics(*row) for row in q.tolist()])
        np.testing.assert_allclose(to_matrix(Arm(name).forward(q)), expected, rtol=0.0, atol=1e-12)

    @EVERY
    def test_inverse_solutions_include_those_of_ur_analytic_ik(self, theirs: Any, name: str) -> None:
        arm = Arm(name)
        compared = 0
        for matrix in to_matrix(arm.forward(postures(2))):
            ours = arm.solutions(from_matrix(matrix))
            others = np.array(theirs.inverse_kinematics(np.ascontiguousarray(matrix)))
            # ur-analytic-ik omits solutions that do not reproduce the pose closely enough, and has another order.
            for q in others.reshape(-1, 6):
                turned = np.angle(np.exp(1j * (ours - q)))
                assert np.abs(turned).max(axis=1).min() < 1e-6
            compared += len(others)
        assert compared > 4 * ROWS


class TestPinocchio:
    """Comparison with Pinocchio, which reads the URDF that urlink writes; so the URDF is tested as well."""

    @pytest.fixture
    def arm(self, name: str, is_calibrated: bool) -> Arm:
        return calibrated(name, 1) if is_calibrated else Arm(name)

    @pytest.fixture
    def pin(self, arm: Arm) -> tuple[Any, Any, Any]:
        pinocchio: Any = pytest.importorskip("pinocchio")
        model = pinocchio.buildModelFromXML(to_urdf(arm))
        model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
        return pinocchio, model, model.createData()

    @staticmethod
    def configuration(model: Any, q: np.ndarray) -> np.ndarray:
        """Return joint positions for Pinocchio, in which a continuous joint has a cosine and a sine."""
        parts = [[math.cos(x), math.sin(x)] if model.joints[i + 1].nq == 2 else [x] for i, x in enumerate(q.tolist())]
        return np.concatenate(parts)

    @EVERY
    @BOTH
    def test_forward_and_jacobian_equal_pinocchio(self, pin: tuple[Any, Any, Any], arm: Arm) -> None:
        pinocchio, model, data = pin
        flange = model.getFrameId("tool0")
        for q in postures(3)[:50]:
            x = self.configuration(model, q)
            pinocchio.forwardKinematics(model, data, x)
            pinocchio.updateFramePlacements(model, data)
            np.testing.assert_allclose(to_matrix(arm.forward(q)), data.oMf[flange].homogeneous, rtol=0.0, atol=1e-12)
            theirs = pinocchio.computeFrameJacobian(model, data, x, flange, pinocchio.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(arm.jacobian(q), theirs, rtol=0.0, atol=1e-12)

    @EVERY
    @BOTH
    def test_dynamics_equal_pinocchio(self, pin: tuple[Any, Any, Any], arm: Arm) -> None:
        pinocchio, model, data = pin
        ours = Dynamics(arm)
        rng = np.random.default_rng(4)
        for q in postures(5)[:50]:
            x, qd, qdd = self.configuration(model, q), rng.uniform(-3.0, 3.0, 6), rng.uniform(-10.0, 10.0, 6)
            upper = np.triu(pinocchio.crba(model, data, x))
            np.testing.assert_allclose(ours.mass_matrix(q), upper + np.triu(upper, 1).T, rtol=0.0, atol=1e-10)
            gravity = pinocchio.computeGeneralizedGravity(model, data, x)
            np.testing.assert_allclose(ours.gravity_torque(q), gravity, rtol=0.0, atol=1e-10)
            coriolis = pinocchio.computeCoriolisMatrix(model, data, x, qd) @ qd
            np.testing.assert_allclose(ours.coriolis_torque(q, qd), coriolis, rtol=0.0, atol=1e-10)
            torque = pinocchio.rnea(model, data, x, qd, qdd)
            np.testing.assert_allclose(ours.torque(q, qd, qdd), torque, rtol=0.0, atol=1e-10)
            back = pinocchio.aba(model, data, x, qd, torque)
            np.testing.assert_allclose(ours.acceleration(q, qd, torque), back, rtol=1e-8, atol=1e-7)


class TestMujoco:
    """Comparison with MuJoCo, which reads the MJCF with the rotors, and the URDF, which cannot contain rotors."""

    @pytest.fixture
    def arm(self, name: str, is_calibrated: bool) -> Arm:
        return calibrated(name, 1) if is_calibrated else Arm(name)

    @staticmethod
    def compare(arm: Arm, text: str, rotors: bool) -> None:
        mujoco: Any = pytest.importorskip("mujoco")
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        # Switch off friction, which is not part of the rigid-body dynamics.
        model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
        model.opt.gravity[:] = 0.0, 0.0, -GRAVITY
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        ours = Dynamics(arm, rotors=rotors)
        rng = np.random.default_rng(6)
        for q in postures(7)[:50]:
            qd, qdd = rng.uniform(-3.0, 3.0, 6), rng.uniform(-10.0, 10.0, 6)
            data.qpos[:], data.qvel[:], data.qacc[:] = q, 0.0, 0.0
            mujoco.mj_inverse(model, data)
            np.testing.assert_allclose(ours.gravity_torque(q), data.qfrc_inverse, rtol=0.0, atol=1e-10)
            data.qvel[:], data.qacc[:] = qd, qdd
            mujoco.mj_inverse(model, data)
            np.testing.assert_allclose(ours.torque(q, qd, qdd), data.qfrc_inverse, rtol=0.0, atol=1e-10)
            matrix = np.column_stack([_times(mujoco, model, data, axis) for axis in np.eye(6)])
            np.testing.assert_allclose(ours.mass_matrix(q), matrix, rtol=0.0, atol=1e-10)
            if model.nsite:
                found = np.eye(4)
                found[:3, :3], found[:3, 3] = data.site_xmat[0].reshape(3, 3), data.site_xpos[0]
                np.testing.assert_allclose(to_matrix(arm.forward(q)), found, rtol=0.0, atol=1e-10)

    @EVERY
    @BOTH
    def test_mjcf_dynamics_equal_mujoco(self, arm: Arm) -> None:
        self.compare(arm, to_mjcf(arm), rotors=True)

    @EVERY
    @BOTH
    def test_urdf_dynamics_equal_mujoco(self, arm: Arm) -> None:
        self.compare(arm, to_urdf(arm), rotors=False)

    def test_mjcf_friction_equals_the_motor_friction(self) -> None:
        mujoco: Any = pytest.importorskip("mujoco")
        model, motors = mujoco.MjModel.from_xml_string(to_mjcf("UR10e")), motors_of("UR10e")
        np.testing.assert_allclose(model.dof_frictionloss, np.multiply(motors.torque_constants, motors.coulomb))
        np.testing.assert_allclose(model.dof_damping, np.multiply(motors.torque_constants, motors.viscous))


def _times(mujoco: Any, model: Any, data: Any, vector: np.ndarray) -> np.ndarray:
    """Return the mass matrix times a vector."""
    found = np.zeros(6)
    mujoco.mj_mulM(model, data, found, vector)
    return found
