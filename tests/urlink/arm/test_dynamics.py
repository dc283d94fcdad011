"""Torques and inertias, compared with energies, with each other, and with reports of controllers."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from linkcore.errors import BadValue
from tests.urlink.arm.arms import Array, calibrated, joints, models
from urlink.arm.dynamics import GRAVITY, Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, Model
from urlink.arm.motors import motors_of

cogs = st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)
speeds = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)


def positions(arm: Arm, q: ArrayLike, cog: ArrayLike) -> Array:
    """Return the centres of mass of the six links and of a payload, shape (7, 3)."""
    frames = arm.frames(q)
    at = [frames[i + 1] @ [*arm.model.link_cogs[i], 1.0] for i in range(6)] + [frames[6] @ [*np.asarray(cog), 1.0]]
    return np.array(at)[:, :3]


def kinetic_energy(arm: Arm, q: Array, qd: Array, payload: float, cog: ArrayLike) -> float:
    """Return 1/2 m v² + 1/2 w I w, from the motion of the centres of mass and links, by differences."""
    step = 1e-6
    v = (positions(arm, q + step * qd, cog) - positions(arm, q - step * qd, cog)) / (2.0 * step)
    masses = np.array([*arm.model.link_masses, payload])
    energy = 0.5 * float(masses @ (v * v).sum(axis=1))
    frames = arm.frames(q)
    w = np.zeros(3)
    for i in range(6):
        w = w + qd[i] * frames[i][:3, 2]
        local = frames[i + 1][:3, :3].T @ w
        energy += 0.5 * float(local @ arm.model.link_inertias[i] @ local)
    return energy


@pytest.mark.property
@given(models, joints, st.floats(0.0, 35.0), cogs)
def test_gravity_torque_is_the_slope_of_the_potential_energy(
    of: Model, q: list[float], payload: float, cog: list[float]
) -> None:
    arm = Arm(of)
    masses = np.array([*of.link_masses, payload])

    def energy(at: Array) -> float:
        return GRAVITY * float(masses @ positions(arm, at, cog)[:, 2])

    step = 1e-5
    slope = [(energy(q + step * unit) - energy(q - step * unit)) / (2.0 * step) for unit in np.eye(6)]
    torque = Dynamics(arm, payload=payload, payload_cog=cog).gravity_torque(q)
    np.testing.assert_allclose(torque, slope, rtol=0.0, atol=1e-5)
    assert torque[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.property
@given(models, joints, speeds, st.floats(0.0, 35.0), cogs)
def test_mass_matrix_gives_kinetic_energy(
    of: Model, q: list[float], qd: list[float], payload: float, cog: list[float]
) -> None:
    arm = Arm(of)
    matrix = Dynamics(arm, payload=payload, payload_cog=cog).mass_matrix(q)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix).min() > 0.0
    expected = kinetic_energy(arm, np.array(q), np.array(qd), payload, cog)
    assert 0.5 * float(np.array(qd) @ matrix @ qd) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.property
@given(models, joints, speeds, speeds)
def test_parts_add_up_to_torque_and_give_acceleration(
    of: Model, q: list[float], qd: list[float], qdd: list[float]
) -> None:
    arm = Dynamics(of, payload=of.payload, payload_cog=(0.0, 0.02, 0.1), payload_inertia=(0.1, 0.2, 0.15, 0, 0.01, 0))
    torque = arm.torque(q, qd, qdd)
    parts = arm.mass_matrix(q) @ qdd + arm.coriolis_torque(q, qd) + arm.gravity_torque(q)
    np.testing.assert_allclose(torque, parts, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(arm.acceleration(q, qd, torque), qdd, rtol=1e-6, atol=1e-6)


@pytest.mark.property
@given(models, joints, speeds)
def test_coriolis_work_equals_change_of_kinetic_energy(of: Model, q: list[float], qd: list[float]) -> None:
    # Energy is conserved: qd' c(q, qd) is half the change of qd' M qd at constant speeds.
    arm = Dynamics(of)
    step = 1e-6
    ahead, behind = (arm.mass_matrix(np.array(q) + sign * step * np.array(qd)) for sign in (1.0, -1.0))
    change = np.array(qd) @ ((ahead - behind) / (2.0 * step)) @ qd
    work = float(np.array(qd) @ arm.coriolis_torque(q, qd))
    assert work == pytest.approx(0.5 * float(change), rel=1e-5, abs=1e-5)


def test_spinning_payload_adds_inertia() -> None:
    q = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
    bare, loaded = Dynamics("UR5e"), Dynamics("UR5e", payload_inertia=(0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
    # Joint 6 turns the flange about its z axis.
    assert loaded.mass_matrix(q)[5, 5] - bare.mass_matrix(q)[5, 5] == pytest.approx(0.3)


def test_gravity_torque_depends_on_mounting() -> None:
    q = [0.3, -1.0, 1.2, -0.7, 0.4, 0.1]
    upright = Dynamics("UR10e").gravity_torque(q)
    np.testing.assert_allclose(Dynamics("UR10e", gravity=(0, 0, GRAVITY)).gravity_torque(q), -upright)
    on_the_wall = Dynamics("UR10e", gravity=(-GRAVITY, 0, 0)).gravity_torque(q)
    assert abs(on_the_wall[0]) > 1.0
    np.testing.assert_allclose(Dynamics("UR10e", gravity=(0, 0, 0)).gravity_torque(q), 0.0)


def test_many_states_give_the_same_as_one_by_one() -> None:
    arm = Dynamics(calibrated("UR5e", 1), payload=2.0, payload_cog=(0.0, 0.0, 0.1))
    assert arm.arm.is_calibrated
    rng = np.random.default_rng(4)
    q, qd, qdd = rng.uniform(-3.0, 3.0, (3, 2, 4, 6))
    np.testing.assert_allclose(arm.torque(q, qd, qdd)[1, 2], arm.torque(q[1, 2], qd[1, 2], qdd[1, 2]), atol=1e-12)
    np.testing.assert_allclose(arm.torque(q, qd[0, 0], np.zeros(6))[1, 2], arm.torque(q[1, 2], qd[0, 0], np.zeros(6)))
    np.testing.assert_allclose(arm.gravity_torque(q)[1, 2], arm.gravity_torque(q[1, 2]), atol=1e-12)
    np.testing.assert_allclose(arm.coriolis_torque(q, qd)[1, 2], arm.coriolis_torque(q[1, 2], qd[1, 2]), atol=1e-12)
    np.testing.assert_allclose(arm.mass_matrix(q)[1, 2], arm.mass_matrix(q[1, 2]), atol=1e-12)
    assert arm.mass_matrix(q).shape == (2, 4, 6, 6)
    assert arm.acceleration(q, qd, qdd).shape == (2, 4, 6)


@pytest.mark.parametrize("of", MODELS.values(), ids=MODELS)
def test_rotor_inertias_are_added_to_the_mass_matrix_diagonal(of: Model) -> None:
    q, qd, qdd = np.full(6, 0.3), np.full(6, 0.5), np.arange(6.0)
    bare, whole, own = Dynamics(of), Dynamics(of, rotors=True), Dynamics(of, rotors=[1, 2, 3, 4, 5, 6])
    rotors = np.array(motors_of(of).rotor_inertias)
    for q_ in (q, np.tile(q, (3, 1))):
        np.testing.assert_allclose(
            whole.mass_matrix(q_) - bare.mass_matrix(q_), np.broadcast_to(np.diag(rotors), (*q_.shape, 6)), atol=1e-12
        )
        np.testing.assert_allclose(
            whole.torque(q_, qd, qdd) - bare.torque(q_, qd, qdd), np.broadcast_to(rotors * qdd, q_.shape), atol=1e-12
        )
    np.testing.assert_allclose(own.torque(q, qd, qdd) - bare.torque(q, qd, qdd), [0, 2, 6, 12, 20, 30], atol=1e-12)
    np.testing.assert_allclose(whole.acceleration(q, qd, whole.torque(q, qd, qdd)), qdd, atol=1e-9)
    with pytest.raises(BadValue, match="rotor inertia"):
        Dynamics(of, rotors=[1, 1, 1, 1, 1, -1])


@pytest.mark.parametrize("bad", [-1.0, float("nan"), float("inf"), "2", True, None])
def test_payload_must_be_a_mass(bad: Any) -> None:
    with pytest.raises(BadValue, match="payload"):
        Dynamics("UR5e", payload=bad)


def test_vectors_of_wrong_size_are_rejected() -> None:
    with pytest.raises(BadValue, match="a centre of mass must be 3 finite numbers"):
        Dynamics("UR5e", payload=1.0, payload_cog=[0.0, 0.0])
    with pytest.raises(BadValue, match="an inertia must be 6 finite numbers"):
        Dynamics("UR5e", payload=1.0, payload_inertia=[0.0, 0.0, 0.0])
    with pytest.raises(BadValue, match="a gravity must be 3 finite numbers"):
        Dynamics("UR5e", gravity=9.82)
    with pytest.raises(BadValue, match="joint speeds"):
        Dynamics("UR5e").coriolis_torque([0.0] * 6, [0.0] * 5)
    with pytest.raises(BadValue, match="do not broadcast"):
        Dynamics("UR5e").torque(np.zeros((3, 6)), np.zeros((2, 6)), np.zeros(6))


# --- real bytes, parsed by hand, independently of the schemas ---


@pytest.mark.captures("ur")
@pytest.mark.parametrize(
    ("name", "model", "alike"),
    [
        # Joints with the same drive: shoulder and elbow, or wrists 1 and 2; each pair has one size.
        ("eseries_secondary_state_716.bin", MODELS["UR3e"], [(3, 4)]),
        ("ursim_5.8_primary_state_1386.bin", MODELS["UR5e"], [(1, 2), (3, 4)]),
    ],
    ids=["UR3e", "UR5e"],
)
def test_currents_of_controller_are_proportional_to_torques(
    captures: Path, name: str, model: Model, alike: list[tuple[int, int]]
) -> None:
    state, at = (captures / name).read_bytes(), 5
    while state[at + 4] != 1:  # the sub-package of the joints: six blocks of 41 bytes
        at += struct.unpack_from(">i", state, at)[0]
    blocks = [struct.unpack_from(">dddf", state, at + 5 + 41 * i) for i in range(6)]
    torques = Dynamics(model).gravity_torque([block[0] for block in blocks])
    currents = [block[3] for block in blocks]
    for one, other in alike:
        assert torques[one] / currents[one] > 0.0
        assert torques[one] / currents[one] == pytest.approx(torques[other] / currents[other], rel=1e-5)


@pytest.mark.captures("ur")
def test_gravity_torques_match_a_real_arm(captures: Path) -> None:
    # A CB2 UR5 at rest; its payload is not in the packet.
    packet = (captures / "cb2_rt_812.bin").read_bytes()
    q, torques = (np.frombuffer(packet, ">f8", 6, offset=at).astype(np.float64) for at in (12, 204))
    ours = Dynamics("UR5").gravity_torque(q)
    np.testing.assert_allclose(ours, torques, rtol=0.0, atol=1.5)
    np.testing.assert_allclose(ours[1:3], torques[1:3], rtol=0.07)
