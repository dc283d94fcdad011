"""A calibration is recovered from joint positions and poses."""

from __future__ import annotations

import numpy as np
import pytest

from linkcore.errors import BadValue
from packages.accept.tests.identification.planted import motion
from tests.urlink.arm.arms import calibrated
from urlink.arm.kinematics import Arm
from urlink_accept.identification.calibration import fit_calibration

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
