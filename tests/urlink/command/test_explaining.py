"""Tests of `robot.safety.explain`, `SafetyStop.explanation`, `urlink explain` and `urlink doctor`."""

import asyncio
import copy
import json
import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest

import urlink
import urlink.cli
from linkcore import clock
from urlink import Robot, SafetyStop

pytestmark = pytest.mark.simulated_time

GOAL = [1.5, -1.5, 2.0, -2.0707963267948966, -1.5707963267948966, 0.0]


@pytest.fixture(params=["3.15", "5.11", "10.12"])
def robot(request: pytest.FixtureRequest) -> Iterator[Robot]:
    model = "ur5" if request.param == "3.15" else "ur5e"
    with urlink.connect(f"sim://{model}?firmware={request.param}") as robot:
        yield robot


def stopped(robot: Robot) -> SafetyStop:
    """Stop a motion because the base falls behind, and return the error."""
    motion = robot.motion.move_joints(GOAL, speed=0.5)
    robot.realtime.wait_until(lambda state: abs(state.qd_target[0]) > 0.3, timeout=10)
    robot.controller.faults.drag(0)
    with pytest.raises(SafetyStop) as caught:
        motion.wait(timeout=20)
    return caught.value


def test_explain_names_code_joint_and_excess(robot: Robot) -> None:
    assert robot.safety.explain() is None
    error = stopped(robot)
    found = robot.safety.explain(timeout=5)
    assert found is not None
    assert (found.kind, found.code, found.cause.name, found.cause.joint) == (
        "protective stop",
        "C153A0",
        "position deviation",
        "base",
    )
    assert found.cause.exceeded_by is not None
    assert found.cause.exceeded_by > 0.03
    assert any("joint speeds" in each for each in found.commanded)
    assert any("to primary" in each for each in found.commanded)
    assert found.code_evidence == "document"
    assert error.explanation is not None
    assert error.explanation.cause.name == "position deviation"


def test_new_motion_is_refused_with_the_same_explanation(robot: Robot) -> None:
    stopped(robot)
    robot.safety.explain(timeout=5)
    refusal = robot.safety.refusal
    assert isinstance(refusal, SafetyStop)
    assert refusal.explanation is robot.safety.explain()


def test_second_stop_has_its_own_explanation(robot: Robot) -> None:
    first = stopped(robot)
    robot.safety.explain(timeout=5)
    robot.controller.faults.clear()
    robot.safety.wait_until_clear(timeout=10)
    robot.controller.faults.safeguard_stop()
    assert robot.safety.wait_for_stop(timeout=10) is not None
    found = robot.safety.explain(timeout=5)
    assert found is not None
    assert found.cause.name == "safeguard"
    assert first.explanation is not None
    assert first.explanation.cause.name == "position deviation"


@pytest.mark.parametrize("seconds", [2.0, 12.0], ids=["recent", "older_than_the_record"])
def test_program_of_another_client_is_named(robot: Robot, seconds: float) -> None:
    motion = robot.motion.move_joints(GOAL, speed=0.07)
    clock.sleep(seconds)
    assert not motion.done
    for number in range(70):  # so many messages that the record drops those that are too old
        robot.io.set_digital_out(0, number % 2 == 0)
    robot.controller.take("def intruder():\n  sleep(3)\nend\n")
    with pytest.raises(urlink.LinkError):
        motion.wait(timeout=20)
    found = robot.safety.explain()
    assert found is not None
    assert (found.kind, found.cause.name) == ("program stopped", "another client")
    assert "intruder" in found.cause.text


def test_stop_before_the_connection_has_only_a_kind() -> None:
    with urlink.simulator.Controller("UR5e", "5.11") as controller:
        controller.faults.protective_stop()
        with urlink.connect(controller.address) as robot:
            found = robot.safety.explain(timeout=0)
    assert found is not None
    assert found.kind == "protective stop"
    assert any("before the stop" in each for each in found.missing)


def test_explanation_is_copied_but_not_pickled() -> None:
    explanation = urlink.StopExplanation("fault", (urlink.StopCause("unknown", 0.0, "Nothing."),))
    error = SafetyStop("stopped", "fault", lambda: explanation)
    assert copy.copy(error).explanation is explanation
    assert pickle.loads(pickle.dumps(error)).explanation is None
    assert SafetyStop("stopped", "fault").explanation is None


def test_async_explain_returns_the_same_class() -> None:
    async def run() -> urlink.StopExplanation | None:
        async with await urlink.connect_async("sim://ur5e?firmware=5.11") as robot:
            assert await robot.safety.explain() is None
            robot.controller.faults.emergency_stop()
            await robot.safety.wait_for_stop(timeout=10)
            return await robot.safety.explain(timeout=5)

    found = asyncio.run(run())
    assert found is not None
    assert found.cause.name == "emergency"


def test_command_explains_a_recording(robot: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with robot.record(tmp_path / "run.urlog"):
        robot.realtime.wait()
        stopped(robot)
        robot.safety.explain(timeout=5)
    assert urlink.cli.main(["explain", str(tmp_path / "run.urlog"), "--json", "-o", str(tmp_path / "stop.svg")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["code"], found["causes"][0]["name"]) == ("C153A0", "position deviation")
    assert (tmp_path / "stop.svg").exists()


def test_command_without_a_stop_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log.csv").write_text("time,safety_mode\n0,1\n1,1\n", encoding="utf-8")
    assert urlink.cli.main(["explain", str(tmp_path / "log.csv")]) == 1
    assert "no stop was found" in capsys.readouterr().err


def test_doctor_shows_the_active_stop(capsys: pytest.CaptureFixture[str]) -> None:
    with urlink.simulator.Controller("UR5e", "5.11") as controller:
        controller.faults.safeguard_stop()
        assert urlink.cli.main(["doctor", controller.address, "--duration", "0.2", "--json"]) == 1
    findings = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    (stop,) = [each for each in findings if each["topic"] == "stop"]
    assert "safeguard" in stop["seen"]
