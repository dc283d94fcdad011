"""A calibration is recovered from joint positions and poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from linkcore.errors import BadValue
from packages.accept.tests.identification.planted import motion
from tests.urlink.arm.arms import calibrated
from urlink.arm.arm_file import read_arm_file
from urlink.arm.kinematics import Arm
from urlink.arm.poses import compose
from urlink.cli import main
from urlink_accept.identification.calibration import fit_calibration, fit_measured

TCP = (0.01, -0.02, 0.15, 0.1, 0.2, -0.3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["UR3e", "UR5e", "UR10"])
def test_fit_recovers_calibrated_arm(name: str) -> None:
    arm = calibrated(name, 3)
    _, q, _, _ = motion(rate=20.0)
    found = fit_calibration(arm.model, q[::2], arm.forward(q[::2], TCP))
    assert found.rms < 1e-8
    again = Arm.calibrated(arm.model, found.table).forward(q[1::2], found.tcp)
    np.testing.assert_allclose(again[:, :3], arm.forward(q[1::2], TCP)[:, :3], atol=1e-7)


@pytest.mark.slow
def test_fit_recovers_published_arm() -> None:
    _, q, _, _ = motion(rate=10.0)
    found = fit_calibration(Arm("UR5e").model, q, Arm("UR5e").forward(q, TCP))
    again = Arm.calibrated("UR5e", found.table)
    np.testing.assert_allclose(again.forward(q, found.tcp), Arm("UR5e").forward(q, TCP), atol=1e-7)


def test_fit_rejects_small_motions() -> None:
    _, q, _, _ = motion(rate=10.0)
    q[:, 1:3] = -1.0
    with pytest.raises(BadValue, match=r"less than 0\.2 rad: 1, 2"):
        fit_calibration(Arm("UR5e").model, q, Arm("UR5e").forward(q))


@pytest.mark.parametrize("columns", [3, 6], ids=["positions", "poses"])
def test_measured_poses_in_another_frame_recover_the_arm(columns: int) -> None:
    """With 0.05 mm of noise along each axis, the noise alone is 0.087 mm."""
    arm, rng = calibrated("UR10", 3), np.random.default_rng(0)
    q = np.array([0.3, -1.4, 1.6, -1.2, -1.5, 0.4]) + rng.uniform(-1.0, 1.0, (80, 6))
    base = np.array([1.0, -2.0, 0.5, 0.3, -0.2, 2.0])
    poses = np.array([compose(base, pose) for pose in arm.forward(q, (0.03, 0.02, 0.17, 0.0, 0.0, 0.0))])
    poses[:, :3] += 5e-5 * rng.standard_normal((80, 3))
    found = fit_measured(arm.model, q, poses[:, :columns])
    assert found.published > 1e-3
    assert found.rms < 1.5e-4
    assert found.base[:3] == pytest.approx(base[:3], abs=5e-3)


def test_measured_poses_in_mm_are_rejected() -> None:
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 6))
    with pytest.raises(BadValue, match=r"expected m \(in mm\?\)"):
        fit_measured(Arm("UR5e").model, q, 1e3 * Arm("UR5e").forward(q)[:, :3])


def test_calibration_command_writes_the_arm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm, path = calibrated("UR5e", 2), tmp_path / "tracker.csv"
    q = np.array([0.3, -1.4, 1.6, -1.2, -1.5, 0.4]) + np.random.default_rng(1).uniform(-1.0, 1.0, (60, 6))
    rows = np.hstack((q, arm.forward(q, (0.0, 0.03, 0.1, 0.0, 0.0, 0.0))[:, :3])).tolist()
    head = [*(f"actual_q_{joint}" for joint in range(6)), "x", "y", "z"]
    path.write_text("\n".join([" ".join(head), *(" ".join(map(repr, row)) for row in rows)]))
    out, words = tmp_path / "arm.json", ["identify", str(path), "--calibration", "--model", "UR5e"]
    assert main(words) == 1
    assert "--map measured_pose=x,y,z" in capsys.readouterr().err
    assert main([*words, "--map", "measured_pose=x,y,z", "--out", str(out)]) == 0
    assert "fitted arm" in capsys.readouterr().out
    assert read_arm_file(out).calibration is not None
