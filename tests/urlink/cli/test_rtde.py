"""`urlink rtde` and `urlink doctor` against the simulated controller."""

from __future__ import annotations

import json
import re
import threading
from pathlib import Path

import pytest

import urlink
from tests.harm import strict
from urlink.cli import doctor
from urlink.simulator import Controller

from .conftest import Run

pytestmark = pytest.mark.simulated_time


def test_rtde_prints_variables_line_by_line(run: Run, address: str) -> None:
    status, out, err = run("rtde", address, "robot_mode", "actual_q", "--count", "2", "--frequency", "100")
    assert (status, err) == (0, "")
    assert [line.partition(" actual_q=[")[0] for line in out.splitlines()] == ["robot_mode=RUNNING"] * 2


def test_rtde_prints_json_and_csv(run: Run, address: str) -> None:
    (record,) = map(strict, run("rtde", address, "robot_mode", "actual_q", "--count", "1", "--json")[1].splitlines())
    assert record["robot_mode"] == "RUNNING"
    assert len(record["actual_q"]) == 6
    head, row = run("rtde", address, "robot_mode", "actual_q", "--count", "1", "--csv")[1].splitlines()
    assert head == "received,robot_mode," + ",".join(f"actual_q_{number}" for number in range(6))
    assert row.split(",")[1] == "RUNNING"
    assert len(row.split(",")) == 8


def test_rtde_leaves_out_missing_variables(run: Run) -> None:
    with Controller("UR5e", "5.4") as controller:
        status, _, err = run("rtde", controller.address, "payload", "timestamp", "--count", "1")
        assert status == 1
        assert "does not have payload" in err
        status, out, err = run("rtde", controller.address, "payload", "robot_mode", "--count", "1", "--leave-out")
        assert (status, out) == (0, "payload=- robot_mode=RUNNING\n")
        assert "does not have payload" in err
        status, out, _ = run(
            "rtde", controller.address, "payload", "robot_mode", "--count", "1", "--leave-out", "--csv"
        )
        assert out.splitlines()[0] == "received,payload,robot_mode"


def test_rtde_lists_variables(run: Run, address: str) -> None:
    status, out, _ = run("rtde", address, "--list")
    assert status == 0
    assert "  actual_q                                   VECTOR6D      actual joint positions [rad]" in out
    there, _, other = out.partition("outputs of other firmware")
    assert "actual_current_as_torque" in other
    assert "actual_current_as_torque" not in there
    assert "speed_slider_mask" in there.partition("inputs")[2]


def test_rtde_records_and_measures_rate(run: Run, address: str, tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    status, out, _ = run("rtde", address, "timestamp", "--record", str(path), "--count", "20")
    assert (status, out.count("\n")) == (0, 20)
    status, out, _ = run("rtde", f"replay://{path}?rate=max", "--json")
    assert status == 0
    assert len(out.splitlines()) >= 20
    status, _, err = run("rtde", f"replay://{path}?rate=max", "--list")
    assert status == 1
    assert "it contains timestamp" in err
    status, out, _ = run("rtde", address, "timestamp", "--hz", "--duration", "0.3")
    assert status == 0
    assert "Hz | period min" in out
    status, out, _ = run("rtde", address, "timestamp", "--hz", "--count", "1", "--duration", "5")
    assert (status, out.count("\n")) == (0, 1)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["actual q"], "is not a valid name of a variable"),
        ([], "expected the names"),
        (["timestamp", "--frequency", "501"], "1 to 500"),
    ],
)
def test_rtde_rejects_invalid_requests(run: Run, address: str, arguments: list[str], error: str) -> None:
    status, out, err = run("rtde", address, *arguments)
    assert (status, out) == (1, "")
    assert error in err


@pytest.mark.slow
def test_doctor_finds_no_problem_on_healthy_controller(run: Run, controller: Controller, address: str) -> None:
    status, out, _ = run("doctor", address, "--duration", "0.5", "--json")
    findings = {finding["topic"]: finding for finding in map(json.loads, out.splitlines())}
    bad = [finding for finding in findings.values() if finding["state"] == "BAD"]
    assert all("data" in finding["topic"] for finding in bad), "only data may be BAD, because of a busy computer"
    assert status == bool(bad)
    for topic in ("controller", "robot mode", "safety", "control", "inputs"):
        assert findings[topic]["state"] == "ok", findings[topic]
    assert {topic for topic in findings if topic.startswith("port ")} == {
        f"port {controller.ports[name]}" for name in doctor._PORTS
    }
    assert "Hz of 500" in findings["realtime data"]["seen"]
    assert "woken" in findings["computer"]["seen"]


@pytest.mark.slow
def test_doctor_finds_missing_states(run: Run) -> None:
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        robot.realtime.wait()
        finished = threading.Event()

        def stall() -> None:
            while not finished.is_set():
                controller.faults.stall(0.05, "realtime")
                finished.wait(0.2)

        stalling = threading.Thread(target=stall)
        stalling.start()
        try:
            out = run("doctor", controller.address, "--duration", "1")[1]
        finally:
            finished.set()
            stalling.join()
    (line,) = (line for line in out.splitlines() if "realtime data" in line)
    assert not line.startswith("ok")
    assert re.search(r"\d+ of \d+ cycles are missing \(\d+ gaps?, the longest 0\.\d+ s\) by its own clock", line), line


def test_doctor_reports_protective_stop_and_closed_port(run: Run) -> None:
    with Controller("UR5e", "5.11") as controller:
        controller.remote_control = False
        controller.faults.protective_stop()
        ports = {**controller.ports}
        address = controller.address.replace(f"rtde={ports['rtde']}", "rtde=1")
        status, out, _ = run("doctor", address, "--duration", "0.3")
    assert status == 1
    lines = {line[6:19].strip(): line for line in out.splitlines()}
    assert lines["safety"].startswith("BAD")
    assert "PROTECTIVE_STOP" in lines["safety"]
    assert lines["control"].startswith("BAD")
    assert "switch to remote control" in lines["control"]
    assert lines["port 1"].startswith("BAD")
    assert "check whether the service is switched off" in lines["port 1"]
    assert lines["inputs"].startswith("look")


@pytest.mark.parametrize("firmware", ["1.8", "3.2"])
def test_doctor_and_rtde_report_missing_rtde(run: Run, firmware: str) -> None:
    with Controller("UR5", firmware) as controller:
        _, out, _ = run("doctor", controller.address, "--duration", "0.3")
        assert "rtde: closed; controllers before 3.3 have none" in out
        assert "inputs" not in out
        # A busy computer might delay the simulator, so its data may be BAD.
        assert all("data" in line for line in out.splitlines() if line.startswith("BAD")), out
        status, _, err = run("rtde", controller.address, "actual_q")
        assert status == 1
        assert ("has no RTDE; use robot.realtime" if firmware == "1.8" else "connection refused") in err


def test_doctor_fails_when_no_port_answers(run: Run) -> None:
    ports = "&".join(f"{name}=1" for name in ("primary", "secondary", "realtime", "rtde", "dashboard"))
    status, out, _ = run("doctor", f"ur://127.0.0.1?{ports}", "--connect-timeout", "1")
    assert status == 1
    assert "check that the controller is on" in out
    assert run("doctor", "replay:///nowhere.urlog")[0] == 1


@pytest.mark.parametrize("form", ["--csv", "--json", None])
def test_rtde_ends_after_duration(run: Run, address: str, form: str | None) -> None:
    status, out, _ = run("rtde", address, "timestamp", *([] if form is None else [form]), "--duration", "0.2")
    assert status == 0
    assert 5 < len(out.splitlines()) < 2000  # nominally 100 at 500 Hz, fewer on a busy computer


def test_rtde_list_rejects_duration(run: Run, silent_address: str) -> None:
    assert run("rtde", silent_address, "--list", "--duration", "1")[0] == 2
