"""Identification of a simulated arm with planted parameters, and its file in the simulator."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

import urlink
from linkcore.errors import BadRecording, BadValue
from packages.accept.tests.identification.planted import MODEL, PAYLOAD, planted, recorded
from urlink.arm.arm_file import ArmFile, Estimate, read_arm_file
from urlink.cli import main
from urlink.simulator import Controller
from urlink_accept.identification import identify
from urlink_accept.identification.comparison import compare
from urlink_accept.identification.samples import Samples, read_samples


@pytest.fixture(scope="module")
def samples() -> Samples:
    return recorded(planted())


@pytest.mark.slow
def test_identify_recovers_planted_arm(samples: Samples) -> None:
    assert samples["timestamp"][-1] == pytest.approx(10.2, abs=0.1)
    found, expected = identify(samples), planted()
    for name, each in expected.estimates.items():
        for estimate, truth in zip(found.estimates[name], each, strict=True):
            # The slow part of the current's error has few independent values in a recording.
            share = 0.25 if name == "current_noise" else 0.05
            near = 2e-3 if name == "payload_cog" else share * abs(truth.value)
            assert estimate.value == pytest.approx(truth.value, abs=near), (name, estimate)
    assert found.tcp == pytest.approx(expected.tcp, abs=0.02)  # a part of the flange may count as part of the tool
    assert found.estimates["calibration"][0].value < 1e-7
    assert min(found.torque_r2) > 0.999
    assert min(found.current_r2) > 0.99
    assert "servoj" in found.estimates["servoj_gain"][0].needs


@pytest.mark.slow
@pytest.mark.real_time
def test_arm_file_configures_simulator(samples: Samples, tmp_path: Path) -> None:
    found = identify(samples)
    found.write(tmp_path / "arm.json")
    assert read_arm_file(tmp_path / "arm.json").motors == found.motors
    with urlink.connect(f"sim://ur5e?firmware=5.11&like={tmp_path / 'arm.json'}") as robot:
        arm = robot.controller.arm
        assert arm.motors == found.motors
        assert arm.payload == pytest.approx(PAYLOAD, rel=0.01)
        q = samples["target_q"][0].tolist()
        pose = arm.kinematics.forward(q, arm.tcp)
        assert pose[:3] == pytest.approx(samples["target_TCP_pose"][0][:3], abs=1e-6)


def test_arm_file_of_other_model_or_format_is_rejected(tmp_path: Path) -> None:
    planted().write(tmp_path / "arm.json")
    with pytest.raises(BadValue, match="model='UR10e'; expected 'UR5e'"):
        Controller("UR10e", like=read_arm_file(tmp_path / "arm.json"))
    whole = json.loads((tmp_path / "arm.json").read_text())
    shorter = whole | {"parameters": {"rotor_inertia": []}}
    for broken in ("{", "[]", "[" * 100_000, json.dumps(whole | {"version": 2}), json.dumps(shorter)):
        (tmp_path / "arm.json").write_text(broken)
        with pytest.raises(BadValue, match=r"arm\.json"):
            read_arm_file(tmp_path / "arm.json")


@pytest.mark.slow
def test_identify_command_prints_and_writes_results(
    samples: Samples, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.csv"
    with path.open("w", newline="") as file:
        names = [name if each.ndim == 1 else [f"{name}_{i}" for i in range(6)] for name, each in samples.items()]
        writer = csv.writer(file)
        writer.writerow(np.hstack(names))
        writer.writerows(np.column_stack(list(samples.values())).tolist())
    assert main(["identify", str(path), "--model", "UR5e", "--out", str(tmp_path / "arm.json")]) == 0
    shown = capsys.readouterr().out
    assert "rotor_inertia 3" in shown
    assert "servoj_gain" in shown
    assert "unknown; needs" in shown
    assert read_arm_file(tmp_path / "arm.json").model == "UR5e"
    assert main(["identify", str(path)]) == 1
    assert "does not contain the model" in capsys.readouterr().err
    assert main(["identify", str(path), "--model", "UR5e", "--json"]) == 0
    first = json.loads(capsys.readouterr().out.splitlines()[0])
    assert first["name"] == "payload"
    assert first["low"] < PAYLOAD < first["high"]


def test_read_samples_rejects_other_files(tmp_path: Path) -> None:
    with pytest.raises(BadRecording, match="No such file"):
        read_samples(tmp_path / "none.csv")
    (tmp_path / "short.csv").write_text("timestamp,x\n1,2\n")
    with pytest.raises(BadRecording, match="neither target_q nor actual_q"):
        read_samples(tmp_path / "short.csv")
    (tmp_path / "text.csv").write_text("timestamp,x\n1,hello\n")
    with pytest.raises(BadRecording, match="its columns are timestamp"):
        read_samples(tmp_path / "text.csv")
    assert math.isnan(Estimate.unknown("motion").value)
    assert MODEL.name == "UR5e"


@pytest.mark.slow
def test_compare_measures_difference_from_simulator(samples: Samples) -> None:
    """The recording differs from the same arm only by noise, but much from the published arm."""
    parts: list[float] = []
    same, other = compare(samples, planted(), parts.append), compare(samples, ArmFile("UR5e", {}))
    assert parts == [each.begin / len(samples["timestamp"]) for each in same.movements]
    assert [each.command.partition("(")[0] for each in same.movements] == ["movej"] * 5
    assert max(abs(each.late) for each in same.movements) < 0.003
    # The ramp of the planted arm is 200 ms long instead of 160 ms.
    assert max(each.late for each in other.movements) < -0.003
    assert max(same.rms["target_moment"]) < 0.2
    assert max(other.rms["target_moment"]) > 5.0 * max(same.rms["target_moment"])
