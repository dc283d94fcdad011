"""Stage 3 on simulated arms: its results, consent for each joint, and detected defects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import urlink
from packages.accept.tests.acceptance.defects import Defect, Plant, Values, planted, rt
from urlink.arm.arm_file import ArmFile, Estimate
from urlink.arm.models import MODELS
from urlink.cli import main
from urlink.simulator import Controller
from urlink_accept.acceptance import swings
from urlink_accept.acceptance.bundle import opened, pack
from urlink_accept.acceptance.causes import likely_causes
from urlink_accept.acceptance.evidence import Evidence
from urlink_accept.acceptance.logbook import Logbook
from urlink_accept.acceptance.person import OfTheSimulator
from urlink_accept.acceptance.report import Verdict, as_text, judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.acceptance.stages import run
from urlink_accept.acceptance.swings import swing

OWN = {name: each for name, each in requirements().items() if each.stage == 3}
SWUNG = ("elbow", "wrist 1")


def consent(number: int, does: str) -> str:
    """Consent to two of the joints."""
    return "" if does.startswith("MOVES") or any(f"the {name} alone" in does for name in SWUNG) else "not this one"


def verdicts(evidence: Evidence) -> dict[str, Verdict]:
    return {each.requirement.name: each for each in judge(evidence, OWN)}


def exactly(*values: float) -> tuple[Estimate, ...]:
    return tuple(Estimate(value, value, value) for value in values)


@pytest.fixture(scope="module")
def logbook(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logbook of a sound arm, two joints of which have swung."""
    path: Path = tmp_path_factory.mktemp("swung") / "run.urlog"
    with urlink.simulated_time(seed=3):
        run("sim://ur5?firmware=3.5", path, (3,), consent)
    return path


@pytest.fixture
def sound(logbook: Path) -> Evidence:
    return Evidence(logbook)


@pytest.mark.slow
def test_correct_arm_meets_all_requirements(sound: Evidence) -> None:
    found = verdicts(sound)
    expected = dict.fromkeys(OWN, "held") | {"swing-force": "not tried"}  # a CB3 has no force sensor
    assert {name: each.state for name, each in found.items()} == expected
    assert [each.contradicts for each in found.values() if each.contradicts] == []
    assert found["swing-moments"].seen == "explained by masses and rotors: elbow 1.00000, wrist 1 1.00000"


@pytest.mark.slow
def test_only_joints_with_consent_move(sound: Evidence) -> None:
    q = sound.realtime.column(lambda state: state.q_target)
    assert q is not None
    assert np.ptp(q, axis=0) == pytest.approx([0.0, 0.0, 0.6, 0.6, 0.0, 0.0], abs=1e-3)
    assert sound.last("swing-base") == {"event": "end", "skipped": "not this one"}


@pytest.mark.slow
def test_replay_gives_identical_report(logbook: Path, tmp_path: Path) -> None:
    pack(logbook, tmp_path / "run.zip", requirements(), {})
    pages = []
    for _ in range(2):
        with opened(tmp_path / "run.zip") as bundle:
            pages.append(as_text(bundle.evidence, judge(bundle.evidence, bundle.requirements), {}, bundle.digest))
    assert pages[0] == pages[1]
    assert "explained by masses and rotors" in pages[0]


@pytest.mark.slow
def test_identify_reads_bundle_like_its_recording(
    logbook: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pack(logbook, tmp_path / "run.zip", requirements(), {})
    printed = []
    for path in (logbook, tmp_path / "run.zip"):
        assert main(["identify", str(path), "--model", "UR5"]) == 0
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1]
    assert "rotor_inertia 3" in printed[0]


@pytest.mark.slow
@pytest.mark.simulated_time
def test_contradictions_name_parameter_and_measured_value(tmp_path: Path) -> None:
    """Only these parameters are contradicted."""
    estimates = {
        "rotor_inertia": exactly(1.862, 1.862, 1.4, 0.211, 0.211, 0.211),
        "viscous_current": exactly(0.97, 0.97, 0.97, 0.5, 0.216, 0.216),
        "start_rate": exactly(9.0),
        "tracking_lag": exactly(0.002),
        "position_noise": exactly(5e-5),
    }
    ArmFile("UR5", estimates).write(tmp_path / "arm.json")
    run(f"sim://?firmware=3.5&like={tmp_path / 'arm.json'}", tmp_path / "run.urlog", (3,), consent)
    evidence = Evidence(tmp_path / "run.urlog")
    found = verdicts(evidence)
    said = {name: each.contradicts for name, each in found.items() if each.contradicts}
    assert {name: len(each) for name, each in said.items()} == dict.fromkeys(
        ("swing-moments", "swing-currents", "swing-lag", "swing-ramp", "swing-noise"), 1
    )
    assert said["swing-moments"][0].startswith("rotor_inertia of size 3, the elbow: measured 1.4 (1.4 to 1.4) kg m²")
    assert "the table has 1.7 to 1.95 (log: UR10e" in said["swing-moments"][0]
    assert said["swing-currents"][0].startswith("viscous_current of size 1, the wrist 1: measured 0.5 ")
    page = as_text(evidence, list(found.values()), {})
    assert page.count("CONTRADICTS the parameter") == 5


@pytest.mark.slow
@pytest.mark.simulated_time
def test_ramp_is_not_contradicted_when_slider_is_at_50_percent(tmp_path: Path) -> None:
    with Controller("UR5", "3.15") as controller:
        controller.speed_fraction = 0.5
        run(controller.address, tmp_path / "run.urlog", (3,), consent, person=OfTheSimulator(controller))
    ramp = verdicts(Evidence(tmp_path / "run.urlog"))["swing-ramp"]
    assert (ramp.state, ramp.contradicts) == ("held", ()), ramp.seen


@pytest.mark.parametrize("name", ["rotor_inertia", "torque_constant", "coulomb_current", "viscous_current"])
def test_parameters_are_not_contradicted_by_rounding_errors(name: str) -> None:
    """This also holds if the value is an end of the interval, as for the UR10e."""
    for arm in MODELS:
        for row in swings.rows_of(name, arm):
            for off in (-1e-9, 1e-9):
                value = float(row.value) * (1.0 + off)
                assert swings.contradictions([(row, Estimate(value, value, value))]) == ()
            assert row.low is not None
            wrong = 0.9 * row.low
            assert len(swings.contradictions([(row, Estimate(wrong, wrong, wrong))])) == 1


def _of_joint(joint: int, change: Callable[[float], float]) -> Callable[[Values], Values]:
    def changed(values: Values) -> Values:
        values[joint] = change(values[joint])
        return values

    return changed


def _late() -> Plant:
    """Delay positions by 30 packets."""
    before: list[Values] = []

    def changed(values: Values) -> Values:
        before.append(values.copy())
        return before[-31:][0]

    return rt("q_actual", changed)


def _noisy() -> Plant:
    signs = [1.0]

    def changed(values: Values) -> Values:
        signs.append(-signs[-1])
        return values + 0.0018 * signs[-1]

    return rt("q_actual", changed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "named", "said"),
    [
        (rt("q_actual", _of_joint(2, lambda q: q + 0.1)), "swing-box", "the elbow"),
        (rt("q_actual", _of_joint(0, lambda q: q + 0.01)), "swing-alone", "swung"),
        (rt("M_target", _of_joint(3, abs)), "swing-moments", "wrist 1 -"),
        (rt("I_target", _of_joint(2, round)), "swing-currents", "elbow 0."),
        (_late(), "swing-lag", "behind the targets"),
        (_noisy(), "swing-noise", "0.0018"),
    ],
)
def test_requirement_detects_defect_of_swing(sound: Evidence, plant: Plant, named: str, said: str) -> None:
    found = verdicts(planted(sound, Defect(plant, named)))
    assert found[named].state == "not held", found[named]
    assert said in found[named].seen


@pytest.mark.slow
def test_force_is_compared_in_several_postures(tmp_path: Path) -> None:
    with urlink.simulated_time(seed=3):
        run("sim://ur5e?firmware=5.11", tmp_path / "run.urlog", (3,), consent)
    sound = Evidence(tmp_path / "run.urlog")
    assert verdicts(sound)["swing-force"].state == "held", verdicts(sound)["swing-force"]
    weight = Defect(rt("tcp_force", lambda wrench: wrench - np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])), "swing-force")
    found = verdicts(planted(Evidence(tmp_path / "run.urlog"), weight))["swing-force"]
    assert found.state == "not held", found
    assert "in the base frame" in found.seen
    assert likely_causes([found])[0].startswith("The force is in a wrong frame, or the payload is set wrongly")


@pytest.mark.simulated_time
def test_arm_does_not_move_before_switch_is_held(tmp_path: Path) -> None:
    with Controller("UR5", "3.15") as controller:
        before = np.array(controller.arm.sample.q_target)
        logbook = Logbook(tmp_path / "run.urlog", controller.ports)
        with (
            logbook,
            urlink.connect(controller.address) as robot,
            pytest.raises(urlink.Cancelled, match="not held"),
        ):
            swing(robot, logbook, lambda state: False, lambda does: "")
        assert (np.array(controller.arm.sample.q_target) == before).all()


@pytest.mark.simulated_time
def test_releasing_switch_stops_swing_and_further_joints(tmp_path: Path) -> None:
    with Controller("UR5", "3.15") as controller:
        asked: list[str] = []

        def ask(does: str) -> str:
            asked.append(does)
            return ""

        logbook = Logbook(tmp_path / "run.urlog", controller.ports)
        with (
            logbook,
            urlink.connect(controller.address) as robot,
            pytest.raises(urlink.Cancelled, match="was released"),
        ):
            swing(robot, logbook, lambda state: bool(state.qd_target.max() < 0.1), ask)
        assert len(asked) == 1
        assert "moves the base alone, by 17 degrees to either side" in asked[0]
        assert "x -" in asked[0]
    assert Evidence(tmp_path / "run.urlog").last("guard") is not None


@pytest.mark.simulated_time
def test_arm_without_model_is_not_swung(tmp_path: Path) -> None:
    run("sim://?firmware=1.8", tmp_path / "run.urlog", (3,), lambda number, does: "")
    found = verdicts(Evidence(tmp_path / "run.urlog"))
    assert {each.seen for each in found.values()} == {"this firmware does not report which arm it has"}
