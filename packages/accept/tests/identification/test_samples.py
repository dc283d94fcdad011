"""Tables that people have: other names, separators and rates, missing columns, and copied ones."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from linkcore.errors import BadRecording, BadValue
from packages.accept.tests.identification.planted import MODEL, MOTORS, PAYLOAD, planted, recorded
from urlink.arm.vectors import FloatArray
from urlink.cli import main
from urlink_accept.identification import identify
from urlink_accept.identification.joints import fit_joints
from urlink_accept.identification.samples import Samples, read_samples

#: Largest bias of a rotor inertia, as a fraction, on the planted arm: with target_q, and with actual_q alone.
BIAS = {"target_q": 0.01, "actual_q": 0.03}
TARGETS = ("target_q", "target_qd", "target_qdd")


@pytest.fixture(scope="module")
def samples() -> Samples:
    return recorded(planted())


def without(samples: Samples, *names: str, **others: FloatArray) -> Samples:
    columns = {name: column for name, column in samples.items() if name not in names}
    return Samples(samples.path, columns | others, samples.model)


def write(path: Path, columns: dict[str, FloatArray], separator: str = ",", ending: str = "_{}") -> Path:
    names = []
    for name, column in columns.items():
        names += [name] if column.ndim == 1 else [name + ending.format(i) for i in range(column.shape[1])]
    rows = np.column_stack(list(columns.values())).tolist()
    lines = [separator.join(names), *(separator.join(map(repr, row)) for row in rows)]
    text = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
    return path


@pytest.mark.parametrize("name", ["run.csv", "run.txt", "run.csv.gz"])
@pytest.mark.parametrize("separator", [",", ";", "\t", " "], ids=["comma", "semicolon", "tab", "space"])
def test_table_with_any_separator_is_read(samples: Samples, tmp_path: Path, separator: str, name: str) -> None:
    path = write(tmp_path / name, {each: column[:40] for each, column in samples.items()}, separator)
    found = read_samples(path)
    assert found.keys() == samples.keys()
    assert (found["target_q"] == samples["target_q"][:40]).all()


def test_table_with_decimal_commas_is_read(tmp_path: Path) -> None:
    rows = [";".join(["0,01"] * 6) + f";{number},5" for number in range(40)]
    (tmp_path / "run.csv").write_text("\n".join(["q1;q2;q3;q4;q5;q6;t", *rows]))
    found = read_samples(tmp_path / "run.csv", names={"target_q": "q", "timestamp": "t"})
    assert found["target_q"][3].tolist() == [0.01] * 6
    assert found["timestamp"][3] == 3.5


@pytest.mark.parametrize("ending", ["_{}", "{}", "[{}]", ".{}"])
def test_mapped_names_are_read(samples: Samples, tmp_path: Path, ending: str) -> None:
    columns = {f"my_{name}": column[:40] for name, column in samples.items()}
    path = write(tmp_path / "run.csv", columns, ending=ending)
    names = {name: f"my_{name}" for name in samples}
    names["target_q"] = ",".join(f"my_target_q{ending.format(i)}" for i in range(6))
    found = read_samples(path, names=names)
    for name in samples:
        assert (found[name] == samples[name][:40]).all(), name


def test_unknown_mapped_name_is_an_error(samples: Samples, tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", {"target_q": samples["target_q"][:40]})
    with pytest.raises(BadValue, match="no column clock for timestamp; its columns are target_q"):
        read_samples(path, names={"timestamp": "clock"})


def test_all_missing_columns_are_named_at_once(tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", {"pressure": np.ones(40)})
    with pytest.raises(BadRecording) as raised:
        read_samples(path)
    for name in ("target_q", "actual_q", "timestamp", "target_moment", "target_current", "--map", "pressure"):
        assert name in str(raised.value)


def test_identify_command_names_what_is_missing(
    samples: Samples, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    columns = {f"joint_{name}": samples[name] for name in ("actual_q", "actual_current")}
    path = write(tmp_path / "run.csv", columns, " ")
    mapped = [text for name in ("actual_q", "actual_current") for text in ("--map", f"{name}=joint_{name}")]
    assert main(["identify", str(path), "--model", "UR5e", *mapped]) == 1
    assert "no timestamp and no speeds; give the rows per second with --rate" in capsys.readouterr().err
    assert main(["identify", str(path), "--model", "UR5e", *mapped, "--rate", "125"]) == 0
    shown = capsys.readouterr()
    for name in ("timestamp", *TARGETS, "target_moment", "target_current", "actual_TCP_force"):
        assert f"without {name}:" in shown.err
    assert "torque_constant 1" in shown.out


@pytest.mark.parametrize("every", [4, 5, 6], ids=["8 ms", "10 ms", "12 ms"])
@pytest.mark.parametrize("source", list(BIAS))
def test_differentiated_positions_have_no_bias(every: int, source: str) -> None:
    whole = recorded(planted(), every=every)
    found = without(whole, *(TARGETS[1:] if source == "target_q" else TARGETS))
    assert not found.remarks
    for estimate, truth in zip(fit_joints(MODEL, found.fitted).rotor_inertias, MOTORS.rotor_inertias, strict=True):
        assert estimate.value == pytest.approx(truth, rel=BIAS[source])


def test_differentiation_accepts_uneven_steps() -> None:
    whole = recorded(planted(), every=1)
    rows = np.cumsum(np.tile([5, 6], len(whole["timestamp"]) // 11))
    columns = {name: column[rows[rows < len(column)]] for name, column in whole.items() if name not in TARGETS[1:]}
    found = fit_joints(MODEL, Samples(whole.path, columns).fitted)
    for estimate, truth in zip(found.rotor_inertias, MOTORS.rotor_inertias, strict=True):
        assert estimate.value == pytest.approx(truth, rel=BIAS["target_q"])


def test_low_rate_is_a_warning() -> None:
    whole = recorded(planted(), every=20)
    assert not whole.remarks
    (remark,) = without(whole, "target_qdd").remarks
    assert "25 rows per second are too few" in remark


def test_missing_timestamp_follows_from_speeds(samples: Samples) -> None:
    found = without(samples, "timestamp")
    assert np.diff(found["timestamp"]) == pytest.approx(0.008, rel=1e-3)
    assert "125 rows per second" in found.remarks[0]


def test_repeated_rows_are_left_out(samples: Samples) -> None:
    twice = {name: np.repeat(column, 2, axis=0) for name, column in samples.items()}
    found = Samples(samples.path, twice)
    assert (found["target_q"] == samples["target_q"]).all()
    assert "timestamp does not grow" in found.remarks[0]


@pytest.mark.slow
def test_copied_columns_have_no_interval_of_zero_width(samples: Samples) -> None:
    copies = {
        "target_q": samples["actual_q"],
        "target_current": samples["joint_control_output"],
        "actual_current": samples["joint_control_output"],
        "actual_TCP_force": np.zeros_like(samples["actual_TCP_force"]),
    }
    found = without(samples, **copies)
    assert sum("is a copy of" in remark for remark in found.remarks) == 3
    estimates = identify(found, "UR5e").estimates
    assert not estimates["tracking_lag"][0].is_known
    assert not estimates["current_noise"][0].is_known
    assert not estimates["force_noise"][0].is_known
    for name, each in estimates.items():
        for estimate in each:
            assert not estimate.is_known or estimate.high - estimate.low > 1e-6 * abs(estimate.value), name


def test_missing_moments_leave_the_currents(samples: Samples) -> None:
    payload = np.full(len(samples["timestamp"]), PAYLOAD)
    found = fit_joints(MODEL, without(samples, "target_moment", payload=payload))
    assert "target_moment" in found.payload.needs
    assert found.torque_constants[1].value == pytest.approx(MOTORS.torque_constants[1], rel=0.05)


def test_compare_command_fails_if_nothing_can_be_compared(
    samples: Samples, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = {name: np.repeat(column[:1], 50, axis=0) for name, column in samples.items()}
    still["timestamp"] = np.linspace(0.0, 0.4, 50)
    planted().write(tmp_path / "arm.json")
    path = write(tmp_path / "still.csv", still)
    assert main(["compare", str(path), "--like", str(tmp_path / "arm.json")]) == 2
    assert "nothing to compare" in capsys.readouterr().err
