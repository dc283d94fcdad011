"""Tests of the models of arm and controller against the log of a real UR3e.

No model is tested on the rows that it was fitted to. The table of parameters was fitted to the first 300 rows. Models
fitted in these tests are fitted to the first half, and tested on the second half.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from packages.accept.tests.identification.halves import DISJOINT, WIDTH, agreement
from tests import real_captures
from urlink.arm.arm_file import MOTORS, ArmFile
from urlink.arm.dynamics import GRAVITY, Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS
from urlink.arm.motors import friction, motors_of
from urlink.arm.poses import rotvec_to_matrix
from urlink.arm.vectors import FloatArray
from urlink.simulator import Controller, Still
from urlink_accept.identification.calibration import Calibration, fit_calibration
from urlink_accept.identification.joints import fit_joints
from urlink_accept.identification.samples import read_samples

pytestmark = pytest.mark.captures("real")

MODEL = MODELS["UR3e"]
#: Payload that was set in the controller, in kg, and its centre of gravity in the frame of the flange, in m.
PAYLOAD, COG = 1.07, (0.0, 0.0, 0.058)
#: Number of rows of the log that the table of parameters was fitted to.
TABLE_ROWS = 300


class Log:
    """Columns of the log by their RTDE names, with shape (n,) or (n, 6)."""

    def __init__(self) -> None:
        path = real_captures.folder("real") / "ur3e_rtde.csv"
        head, *lines = path.read_text(encoding="utf-8").splitlines()
        self._names = head.split(",")
        self._rows = np.loadtxt(lines, delimiter=",")

    def __getitem__(self, name: str) -> FloatArray:
        if name in self._names:
            return np.asarray(self._rows[:, self._names.index(name)])
        return np.asarray(self._rows[:, [i for i, each in enumerate(self._names) if each.rsplit("_", 1)[0] == name]])

    @property
    def is_rest(self) -> np.ndarray:
        return np.asarray(~self["target_qd"].any(axis=1))


@pytest.fixture
def log() -> Log:
    return Log()


def r2(measured: FloatArray, modelled: FloatArray) -> FloatArray:
    left = ((measured - modelled) ** 2).sum(axis=0)
    return np.asarray(1.0 - left / ((measured - measured.mean(axis=0)) ** 2).sum(axis=0))


def calibration(log: Log) -> Calibration:
    half = len(log["timestamp"]) // 2
    return fit_calibration(MODEL, log["target_q"][:half], log["target_TCP_pose"][:half])


@pytest.mark.slow
def test_fitted_calibration_reproduces_the_tool_poses(log: Log) -> None:
    fitted = calibration(log)
    half = len(log["timestamp"]) // 2
    found = Arm.calibrated(MODEL, fitted.table).forward(log["target_q"][half:], fitted.tcp)
    off = np.linalg.norm(found[:, :3] - log["target_TCP_pose"][half:, :3], axis=1)
    assert off.max() < 1e-8
    published = Arm(MODEL).forward(log["target_q"], fitted.tcp)[:, :3] - log["target_TCP_pose"][:, :3]
    assert 2e-4 < np.linalg.norm(published, axis=1).mean() < 1e-3


@pytest.mark.slow
def test_gravity_torque_matches_the_log_at_rest(log: Log) -> None:
    rest = log.is_rest
    held = Dynamics(MODEL, payload=PAYLOAD, payload_cog=COG).gravity_torque(log["actual_q"][rest])
    assert np.abs(held - log["target_moment"][rest]).max() < 0.002
    fitted = Arm.calibrated(MODEL, calibration(log).table)
    calibrated = Dynamics(fitted, payload=PAYLOAD, payload_cog=COG).gravity_torque(log["actual_q"][rest])
    assert np.abs(calibrated - log["target_moment"][rest]).max() > 0.02


def test_torque_matches_the_logged_moments(log: Log) -> None:
    moving = log["target_q"], log["target_qd"], log["target_qdd"]
    rows = np.arange(TABLE_ROWS, len(moving[0]))
    for rotors, least in ((True, np.array([0.9995, 0.9995, 0.9995, 0.9995, 0.999, 0.9995])), (False, None)):
        dynamics = Dynamics(MODEL, payload=PAYLOAD, payload_cog=COG, rotors=rotors)
        explained = r2(log["target_moment"][rows], dynamics.torque(*(each[rows] for each in moving)))
        if least is None:
            assert explained[[0, 4, 5]].max() < 0.7
        else:
            assert (explained > least).all(), explained


def test_currents_are_moments_plus_friction(log: Log) -> None:
    assert (log["joint_control_output"] == log["target_current"]).all()
    motors = motors_of("UR3e")
    rows = np.arange(TABLE_ROWS, len(log["timestamp"]))
    qd = log["target_qd"][rows]
    joints = list(zip(motors.coulomb, motors.viscous, strict=True))
    rub = np.array([[friction(c, b, v) for (c, b), v in zip(joints, row, strict=True)] for row in qd.tolist()])
    found = log["target_moment"][rows] / np.array(motors.torque_constants) + rub
    assert (r2(log["target_current"][rows], found) > 0.998).all()


def test_fit_joints_predicts_the_second_half_of_the_log(log: Log) -> None:
    names = ("target_q", "target_qd", "target_qdd", "target_moment", "target_current")
    half = len(log["timestamp"]) // 2
    fitted = fit_joints(MODEL, {name: log[name][:half] for name in names})
    assert fitted.payload.low < PAYLOAD < fitted.payload.high
    assert [each.value for each in fitted.payload_cog] == pytest.approx(COG, abs=5e-4)
    known = [[each.value for each in estimates] for estimates in (fitted.payload_cog, fitted.rotor_inertias)]
    dynamics = Dynamics(MODEL, payload=fitted.payload.value, payload_cog=known[0], rotors=known[1])
    torque = dynamics.torque(*(log[name][half:] for name in names[:3]))
    assert (r2(log["target_moment"][half:], torque) > 0.999).all()
    own = ArmFile(MODEL.name, {in_file: getattr(fitted, field) for field, in_file in MOTORS.items()}).motors
    rows = zip(torque, log["target_qd"][half:], strict=True)
    current = np.array([own.current(moment, qd) for moment, qd in rows])
    assert (r2(log["target_current"][half:], current) > 0.99).all()
    # Wrist 3 bears almost no load, so the log does not determine its torque constant.
    assert "wrist 3" in fitted.torque_constants[5].needs


def test_accelerometer_at_rest_shows_gravity(log: Log) -> None:
    rest = np.flatnonzero(log.is_rest)
    up = np.swapaxes(rotvec_to_matrix(log["actual_TCP_pose"][rest, 3:]), 1, 2) @ np.array([0.0, 0.0, GRAVITY])
    off = log["actual_tool_accelerometer"][rest] - up
    # The first rest gives the bias of this sensor.
    first = rest < rest[np.flatnonzero(np.diff(rest) > 1)[0]]
    off = off[~first] - off[first].mean(axis=0)
    assert np.sqrt((off**2).mean(axis=0)).max() < 0.3
    assert np.abs(off + 2.0 * up[~first]).max() > 15.0


class Command(NamedTuple):
    """A command that moved the arm in the log."""

    line: str
    acceleration: float
    speed: float


#: Row before the start of a movement -> its command, as its speeds show. The others are movej at 120 deg/s², 60 deg/s.
OTHERS = {
    422: Command("movel", 0.16, 0.25),
    459: Command("movel", 0.04, 0.25),
    484: Command("movej", math.radians(20), math.radians(10)),
}
USUAL = Command("movej", math.radians(120), math.radians(60))


def test_simulated_moves_take_the_logged_time(log: Log) -> None:
    """In each row of the 18 movements, the simulator needs the same time as the arm to reach the same position."""
    fitted = calibration(log)
    q, times, rest, poses = log["target_q"], log["timestamp"], log.is_rest, log["target_TCP_pose"]
    # The last movement has not ended at the end of the log.
    begins = [int(i) for i in np.flatnonzero(rest[:-1] & ~rest[1:]) if rest[i + 1 :].any()]
    spreads = {}
    for begin in begins:
        end = begin + 1 + int(np.argmax(rest[begin + 1 :]))
        kind, a, v = OTHERS.get(begin, USUAL)
        to = f"{q[end].tolist()}" if kind == "movej" else f"p{poses[end].tolist()}"
        controller = Controller("UR3e", noise=False, motion=Still(q[begin].tolist()), calibration=fitted.table)
        controller.arm.tcp = fitted.tcp.tolist()
        controller.take(f"def p():\n  {kind}({to}, a={a!r}, v={v!r})\nend\n")
        lead = int(np.argmax(np.abs(q[end] - q[begin])))
        places, speeds = [], []
        for _ in range(20 * (end - begin) + 100):
            controller.step()
            places.append(controller.arm.setpoint.q[lead])
            speeds.append(controller.arm.setpoint.qd[lead])
        moved = np.flatnonzero(speeds)
        span = slice(int(moved[0]), int(moved[-1]) + 1)
        way = math.copysign(1.0, q[end, lead] - q[begin, lead])
        rows = np.arange(begin + 1, end)
        rows = rows[np.abs(log["target_qd"][rows, lead]) > 0.03]
        simulated = np.interp(way * q[rows, lead], way * np.array(places)[span], 0.002 * np.arange(len(places))[span])
        spreads[begin] = float(np.ptp(times[rows] - simulated))
    assert len(spreads) == 18
    assert max(spreads.values()) < 0.002, spreads


@pytest.mark.slow
def test_identified_intervals_of_parts_of_the_log_overlap() -> None:
    """The limits are those of `halves`. The widths depend on the draw of the random halves: mean 1.35 to 1.55."""
    samples = read_samples(real_captures.folder("real") / "ur3e_rtde.csv")
    found = [agreement(samples, "UR3e", seed) for seed in range(2)]
    assert found[0].compared >= 36
    assert len(found[0].ordered) <= DISJOINT * found[0].compared, found[0].ordered
    at_random = sum(len(each.random) for each in found) / sum(each.compared_at_random for each in found)
    assert at_random <= DISJOINT
    widths = [width for each in found for width in each.widths.values()]
    assert 0.5 < np.mean(widths) <= WIDTH
