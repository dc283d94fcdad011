"""Parameters of an impedance: ranges and defaults of each axis, and restrictions of the firmware."""

from __future__ import annotations

import contextlib
from functools import partial
from typing import Any

import numpy as np
import pytest

from linkcore.errors import BadValue, LocalError
from urlink.arm.models import Model, model
from urlink.arm.vectors import JOINTS
from urlink.motion.servo.impedance_parameters import ImpedanceParameters
from urlink.protocol.firmware import Firmware
from urlink.script.springs import Springs

UR5E = model("UR5e")
DIRECT, MEASURED, NONE = Firmware(5, 23), Firmware(5, 10), Firmware(5, 9)


def parameters(frame: Any, **given: Any) -> ImpedanceParameters:
    numbers = dict.fromkeys(("stiffness", "torque", "speed", "error", "force", "posture_stiffness"))
    return ImpedanceParameters(
        frame, **{**numbers, "damping": 1.0, "friction_compensation": True, "watchdog": 1.0, **given}
    )


def asked(frame: Any = "joints", firmware: Firmware = DIRECT, arm: Model = UR5E, **given: Any) -> partial[list[str]]:
    program, _, _ = parameters(frame, **given).program(firmware, arm)
    assert isinstance(program, partial)
    return program


def springs(frame: Any = "joints", **given: Any) -> Springs:
    found: Springs = asked(frame, **given).keywords["springs"]
    return found


#: smallest and largest allowed value of each axis, (6,)
RANGES: list[tuple[str, str, list[float], list[float]]] = [
    ("joints", "stiffness", [0.0] * 6, [10_000.0] * 6),
    ("joints", "damping", [0.0] * 6, [3.0] * 6),
    ("joints", "speed", [0.01] * 6, UR5E.max_speed.tolist()),
    ("joints", "error", [0.0] * 6, [3.0] * 6),
    ("joints", "torque", [0.0] * 6, (0.5 * UR5E.max_torque).tolist()),
    ("base", "stiffness", [0.0] * 6, [5_000.0] * 3 + [200.0] * 3),
    ("tool", "damping", [0.0] * 6, [3.0] * 6),
    ("base", "speed", [0.01] * 6, [5.0] * 3 + [10.0] * 3),
    ("tool", "error", [0.0] * 6, [0.5] * 3 + [1.5] * 3),
    ("base", "force", [0.0] * 6, [200.0] * 3 + [30.0] * 3),
    ("base", "posture_stiffness", [0.0] * 6, [200.0] * 6),
]


@pytest.mark.parametrize(("frame", "name", "least", "most"), RANGES, ids=lambda value: str(value)[:12])
def test_each_axis_is_limited_to_a_range(frame: str, name: str, least: list[float], most: list[float]) -> None:
    axes = JOINTS if frame == "joints" or name == "posture_stiffness" else ("x", "y", "z", "rx", "ry", "rz")
    asked(frame, DIRECT, UR5E, **{name: least})
    asked(frame, DIRECT, UR5E, **{name: most})
    for axis in range(6):
        for bound, beyond in ((least, -1e-6), (most, 1e-6)):
            values = [(low + high) / 2 for low, high in zip(least, most, strict=True)]
            values[axis] = bound[axis] + beyond
            with pytest.raises(BadValue, match=rf"^{name}\[{axis}\] \({axes[axis]}\) is .*; expected"):
                asked(frame, DIRECT, UR5E, **{name: values})


@pytest.mark.parametrize(("seconds", "is_in"), [(0.05, True), (0.0499, False), (10.0, True), (10.01, False)])
def test_watchdog_is_limited_to_a_range(seconds: float, is_in: bool) -> None:
    with contextlib.nullcontext() if is_in else pytest.raises(BadValue, match="watchdog"):
        assert springs(watchdog=seconds).watchdog == seconds


def test_default_parameters_of_joints() -> None:
    joints = springs()
    assert joints.tool is None
    assert joints.speed == [1.0] * 6
    assert joints.error == [0.2] * 6
    assert joints.damping == [1.0] * 6
    assert 0.0 < max(joints.stiffness) < 10_000.0
    assert np.all(np.array(joints.torque) <= 0.5 * UR5E.max_torque)
    assert joints.braking == np.minimum(4.0 * np.array(joints.torque), UR5E.max_torque).tolist()
    assert (joints.lowest, joints.highest) == tuple(UR5E.position_limits.T.tolist())
    assert springs(torque=1.0).braking == [4.0] * 6
    assert springs(torque=(0.5 * UR5E.max_torque).tolist()).braking == UR5E.max_torque.tolist()
    assert (joints.friction_compensation, springs(friction_compensation=False).friction_compensation) == (True, False)


def test_endless_joint_has_a_finite_limit() -> None:
    endless = [i for i, (low, high) in enumerate(model("UR3e").position_limits.tolist()) if not np.isfinite(low + high)]
    found: Springs = asked(arm=model("UR3e")).keywords["springs"]
    assert endless == [5]
    assert (found.lowest[5], found.highest[5]) == (-1e6, 1e6)


def test_arm_without_defaults_requires_parameters() -> None:
    for name in ("stiffness", "torque"):
        others = {"stiffness": 100.0, "torque": 10.0}
        del others[name]
        with pytest.raises(BadValue, match=f"^{name} has no default for a UR20; expected one number or six"):
            asked("joints", DIRECT, model("UR20"), **others)
    asked("joints", DIRECT, model("UR20"), stiffness=100.0, torque=10.0)


@pytest.mark.parametrize("frame", ["base", "tool"])
def test_default_parameters_of_tool(frame: str) -> None:
    found = springs(frame)
    assert found.stiffness == [500.0] * 3 + [30.0] * 3
    assert found.error == [0.1] * 3 + [0.5] * 3
    assert found.speed == np.minimum(1.5, UR5E.max_speed).tolist()
    tool = found.tool
    assert tool is not None
    assert tool.in_tool is (frame == "tool")
    assert tool.force == [50.0] * 3 + [5.0] * 3
    assert tool.posture == [0.5] * 6


def test_tool_parameters_are_rejected_for_joints() -> None:
    for name in ("force", "posture_stiffness"):
        with pytest.raises(BadValue, match=f"^{name} applies only to springs of the tool .*; omit it"):
            asked("joints", DIRECT, UR5E, **{name: 1.0})


def test_firmware_without_direct_torque_uses_admittance() -> None:
    for frame in ("base", "tool"):
        led = asked(frame, MEASURED)
        assert led.func.__name__ == "admittance"
        assert led.keywords["stiffness"] == [500.0] * 3 + [30.0] * 3
        assert led.keywords["error"] == [0.1] * 3 + [0.5] * 3
        assert led.keywords["watchdog"] == 1.0
    for name in ("torque", "posture_stiffness"):
        with pytest.raises(BadValue, match=f"^{name} has no effect: firmware 5.10 has no direct torque"):
            asked("tool", MEASURED, UR5E, **{name: 1.0})
    with pytest.raises(LocalError, match="which springs of the joints need"):
        asked("joints", MEASURED)
    for frame in ("joints", "tool"):
        with pytest.raises(LocalError, match="springs of the tool need the force sensor"):
            asked(frame, NONE)


def test_program_reports_stiffness_and_posture_support() -> None:
    for frame, firmware, takes in (("joints", DIRECT, False), ("tool", DIRECT, True), ("tool", MEASURED, False)):
        _, stiffness, takes_posture = parameters(frame, stiffness=20.0).program(firmware, UR5E)
        assert stiffness.tolist() == [20.0] * 6
        assert takes_posture is takes
    with pytest.raises(LocalError, match="does not report the model of the arm"):
        parameters("joints").program(DIRECT, None)
